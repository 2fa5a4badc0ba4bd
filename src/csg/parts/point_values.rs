//! Distances and gradients of a shape at many points.
//!
//! Points are evaluated in batches of [`LANES`]. If a shape has many leaves, the points are halved across the longest
//! side of their box until the batches remain, so a batch is compact and evaluates the leaves near it alone
//! ([`super::pruning`]). The tokens of a batch are pruned from the tokens of the larger sets around it. The values are
//! the same, bit for bit.

use super::pruning::{Ball, Pruning, PruningScratch};
use super::solid::{LANES, Solid, run_wide, saturated};
use crate::csg::evaluation::program::Stack;
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use crate::csg::tree::primitive::Primitive;
use crate::error::{Error, ShapeError};
use crate::memory::zeroed_rows;
use crate::progress::Progress;
use bytemuck::Zeroable;
use glam::DVec3;
use rayon::prelude::*;

/// Number of points of a piece of work.
const CHUNK_POINTS: usize = 16 * LANES;

/// Least number of leaves of a shape, and of points, for which the points are divided. With fewer leaves that takes
/// longer than it saves.
const MANY_LEAVES: usize = 64;
const MANY_POINTS: usize = 4 * LANES;

/// Tokens are pruned again for a set of at most one of this many of the points for which they were pruned last.
const FEWER_POINTS: usize = 8;
/// Largest number of tokens that are not pruned further.
const FEW_TOKENS: usize = 16;

/// Rounding of the distances of a leaf from a point, relative to the distance of the point from the origin.
const ROUNDING: f64 = 1e-12;

/// Half the step of a gradient's central differences, local units: the cube root of float64's rounding. There the
/// errors by the rounding of the field and by the curvature of the surface are equal, about 1e-10.
const GRADIENT_STEP: f64 = 6e-6;

/// Number of points whose gradients are evaluated together: six lanes each.
const GRADIENTS: usize = LANES / 6;

impl Solid {
    /// Signed distance, or a bound on it, at world points.
    pub fn distances(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<f32>, Error> {
        self.distances_as(points, saturated, progress)
    }

    /// [`Solid::distances`] in float64. A baked volume has float32 samples, so a shape with one is refused.
    pub fn precise_distances(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<f64>, Error> {
        if self.model.leaves.iter().any(|leaf| matches!(leaf.primitive, Primitive::Volume(_))) {
            let problem = "\"float64\" does not apply to a shape with a volume_shape, whose samples are float32";
            return Err(ShapeError::argument("dtype", problem).into());
        }
        self.distances_as(points, |value| value.clamp(-f64::from(f32::MAX), f64::from(f32::MAX)), progress)
    }

    fn distances_as<T: Copy + Send + Sync + Zeroable>(
        &self,
        points: &[DVec3],
        rounded: impl Fn(f64) -> T + Sync,
        progress: &Progress,
    ) -> Result<Vec<T>, Error> {
        self.batches(points, LANES, progress, |tokens, points, stack, out| {
            let mut at = [[0.0; LANES]; 3];
            for (i, p) in points.iter().enumerate() {
                (at[0][i], at[1][i], at[2][i]) = (p.x, p.y, p.z);
            }
            let values = run_wide(self.precise(), tokens, &at, stack);
            for (out, value) in out.iter_mut().zip(values) {
                *out = rounded(value * self.frame.scale);
            }
        })
    }

    /// Gradient of the field at world points; zero where it is undefined.
    pub fn gradients(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<[f32; 3]>, Error> {
        self.batches(points, LANES / GRADIENTS * GRADIENTS, progress, |tokens, points, stack, out| {
            for (out, points) in out.chunks_mut(GRADIENTS).zip(points.chunks(GRADIENTS)) {
                let (mut at, mut steps) = ([[0.0; LANES]; 3], [0.0; GRADIENTS]);
                for (i, local) in points.iter().enumerate() {
                    // The step is proportional to the rounding of positions far away.
                    steps[i] = GRADIENT_STEP * local.abs().max_element().max(1.0);
                    for axis in 0..3 {
                        at[axis][6 * i..6 * i + 6].fill(local[axis]);
                        at[axis][6 * i + 2 * axis] += steps[i];
                        at[axis][6 * i + 2 * axis + 1] -= steps[i];
                    }
                }
                let values = run_wide(self.precise(), tokens, &at, stack);
                for ((out, values), step) in out.iter_mut().zip(values.chunks_exact(6)).zip(steps) {
                    let across = |axis: usize| (values[2 * axis] - values[2 * axis + 1]) / (2.0 * step);
                    *out = [across(0) as f32, across(1) as f32, across(2) as f32];
                }
            }
        })
    }

    /// The results of `evaluate` at world points. It receives batches of up to [`LANES`] points in local units, or of
    /// `size` points if there are few leaves, and tokens that decide the field around them.
    fn batches<T: Copy + Send + Sync + Zeroable>(
        &self,
        points: &[DVec3],
        size: usize,
        progress: &Progress,
        evaluate: impl Fn(&[Token], &[DVec3], &mut Stack<f64, LANES>, &mut [T]) + Sync,
    ) -> Result<Vec<T>, Error> {
        progress.set_total(points.len() as u64);
        let mut results: Vec<T> = zeroed_rows("results", points.len())?;
        let tokens = &self.model.tokens[..];
        if Model::leaf_count(tokens) < MANY_LEAVES || points.len() < MANY_POINTS {
            let chunks = results.par_chunks_mut(CHUNK_POINTS).zip(points.par_chunks(CHUNK_POINTS));
            chunks.try_for_each_init(Stack::default, |stack, (results, points)| {
                for (results, points) in results.chunks_mut(size).zip(points.chunks(size)) {
                    let (mut batch, count) = ([DVec3::ZERO; LANES], points.len());
                    batch.iter_mut().zip(points).for_each(|(local, &point)| *local = self.frame.local(point));
                    evaluate(tokens, &batch[..count], stack, results);
                }
                progress.advance(points.len() as u64)
            })?;
            return Ok(results);
        }
        let mut placed: Vec<Placed> = zeroed_rows("points", points.len())?;
        placed.par_iter_mut().zip(points).enumerate().for_each(|(row, (placed, &point))| {
            *placed = Placed { place: self.frame.local(point), row: row as u64 };
        });
        let division = Division { solid: self, pruning: &Pruning::new(self), evaluate: &evaluate, progress };
        division.visit(&mut placed, &mut results, tokens, usize::MAX)?;
        let mut values = zeroed_rows("results", points.len())?;
        placed.iter().zip(results).for_each(|(placed, result)| values[placed.row as usize] = result);
        Ok(values)
    }
}

/// A point in local units, and its row in the input.
#[derive(Clone, Copy, Zeroable)]
#[repr(C)]
struct Placed {
    place: DVec3,
    row: u64,
}

/// Buffers that are kept between the batches of a piece.
#[derive(Default)]
struct Scratch {
    stack: Stack<f64, LANES>,
    pruning: PruningScratch,
}

/// The division of points into compact batches.
struct Division<'a, E> {
    solid: &'a Solid,
    pruning: &'a Pruning,
    evaluate: &'a E,
    progress: &'a Progress,
}

impl<E> Division<'_, E> {
    /// Evaluates some points on all threads, in any order. `tokens` decide the field around them; they were pruned for
    /// `pruned_for` points.
    fn visit<T: Send>(
        &self,
        points: &mut [Placed],
        results: &mut [T],
        tokens: &[Token],
        pruned_for: usize,
    ) -> Result<(), Error>
    where
        E: Fn(&[Token], &[DVec3], &mut Stack<f64, LANES>, &mut [T]) + Sync,
    {
        self.progress.check()?;
        let count = points.len();
        if count <= CHUNK_POINTS {
            self.visit_alone(points, results, tokens, pruned_for, &mut Scratch::default());
            return self.progress.advance(count as u64);
        }
        let corners = corners_of(points);
        let near = self.near(tokens, pruned_for, count, corners, &mut PruningScratch::default());
        let (tokens, pruned_for) = near.as_ref().map_or((tokens, pruned_for), |near| (near, count));
        let middle = divide(points, corners);
        let (left, right) = points.split_at_mut(middle);
        let (left_results, right_results) = results.split_at_mut(middle);
        let (left, right) = rayon::join(
            || self.visit(left, left_results, tokens, pruned_for),
            || self.visit(right, right_results, tokens, pruned_for),
        );
        left.and(right)
    }

    /// [`Self::visit`] on this thread.
    fn visit_alone<T>(
        &self,
        points: &mut [Placed],
        results: &mut [T],
        tokens: &[Token],
        pruned_for: usize,
        scratch: &mut Scratch,
    ) where
        E: Fn(&[Token], &[DVec3], &mut Stack<f64, LANES>, &mut [T]),
    {
        let count = points.len();
        let corners = corners_of(points);
        let near = self.near(tokens, pruned_for, count, corners, &mut scratch.pruning);
        let (tokens, pruned_for) = near.as_ref().map_or((tokens, pruned_for), |near| (near, count));
        if count <= LANES {
            let mut batch = [DVec3::ZERO; LANES];
            batch.iter_mut().zip(&*points).for_each(|(place, point)| *place = point.place);
            return (self.evaluate)(tokens, &batch[..count], &mut scratch.stack, results);
        }
        let middle = divide(points, corners);
        let (left, right) = points.split_at_mut(middle);
        let (left_results, right_results) = results.split_at_mut(middle);
        self.visit_alone(left, left_results, tokens, pruned_for, scratch);
        self.visit_alone(right, right_results, tokens, pruned_for, scratch);
    }

    /// The tokens that decide the field in a box of `count` points; `None` if pruning takes longer than it saves.
    fn near(
        &self,
        tokens: &[Token],
        pruned_for: usize,
        count: usize,
        [lower, upper]: [DVec3; 2],
        scratch: &mut PruningScratch,
    ) -> Option<Vec<Token>> {
        if tokens.len() <= FEW_TOKENS || (count > LANES && FEWER_POINTS * count > pruned_for) {
            return None;
        }
        self.pruning.prune(self.solid, tokens, ball_around(lower, upper), scratch);
        Some(scratch.kept.clone())
    }
}

fn corners_of(points: &[Placed]) -> [DVec3; 2] {
    let lower = points.iter().fold(DVec3::INFINITY, |lower, point| lower.min(point.place));
    let upper = points.iter().fold(DVec3::NEG_INFINITY, |upper, point| upper.max(point.place));
    [lower, upper]
}

/// Divides points in half across the longest side of their box. Returns the number in the first half, whole batches.
fn divide(points: &mut [Placed], [lower, upper]: [DVec3; 2]) -> usize {
    let side = upper - lower;
    let axis = (1..3).fold(0, |longest, axis| if side[axis] > side[longest] { axis } else { longest });
    let middle = (points.len() / 2).next_multiple_of(LANES);
    points.select_nth_unstable_by(middle, |a, b| a.place[axis].total_cmp(&b.place[axis]));
    middle
}

/// A ball that contains the points of a box and the steps of their differences, local units.
fn ball_around(lower: DVec3, upper: DVec3) -> Ball {
    let ball = Ball::around(lower, upper);
    let farthest = lower.abs().max(upper.abs()).max_element().max(1.0);
    Ball { radius: ball.radius + (ROUNDING + GRADIENT_STEP) * farthest, ..ball }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::parts::pruning::text_of_many_leaves;
    use crate::csg::text::language::parse;

    /// Divided points have the values of single points, which are not divided.
    #[test]
    fn many_points_have_the_values_of_single_points() {
        let mut random = crate::mesh::random::uniform(9);
        let joints = ["union", "diff", "blend union 0.05", "xor"];
        let text = text_of_many_leaves(2 * MANY_LEAVES, &joints, &mut random);
        let solid = Solid::new(&parse(&text).unwrap()).unwrap();
        let mut points: Vec<DVec3> = (0..3000).map(|_| DVec3::new(random(), random(), random()) * 3.0 - 1.5).collect();
        // Points at one place, and points far away, where positions are rounded by more than the shape is large.
        points.extend([points[7]; 70]);
        points.extend((0..70).map(|i| DVec3::new(1e15 + f64::from(i), -3e15, 2.0)));
        points.extend((0..70).map(|i| DVec3::new(1e4, 2e4 + f64::from(i), 3e4)));
        let progress = Progress::new();
        let distances = solid.precise_distances(&points, &progress).unwrap();
        let gradients = solid.gradients(&points, &progress).unwrap();
        for (i, point) in points.iter().enumerate() {
            let alone = solid.precise_distances(&[*point], &progress).unwrap()[0];
            assert_eq!(distances[i].to_bits(), alone.to_bits(), "{point}");
            assert_eq!(gradients[i], solid.gradients(&[*point], &progress).unwrap()[0], "{point}");
        }
        progress.cancel();
        assert!(solid.distances(&points, &progress).is_err());
        assert!(solid.gradients(&points, &progress).is_err());
    }
}
