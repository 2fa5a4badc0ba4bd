//! The smallest signed distance of a point over a motion, with a proven lower bound.
//!
//! # Theory
//!
//! Let g(s) be the signed distance of a fixed point from the moving body. A signed distance changes by at most the
//! distance that the point moves in the frame of the body. On an interval of time on which that path is at most w long,
//! g is at least (g0 + g1 - w) / 2, with the values g0 and g1 at its ends, and at least max(g0, g1) - w (S. Piyavskii,
//! "An algorithm for finding the absolute extremum of a function", 1972; B. Shubert, "A sequential method seeking the
//! global maximum of a function", 1972). The interval with the smallest bound is halved first, until no interval can
//! undercut the smallest value by more than the tolerance.
//!
//! Two empty balls give a larger bound where the point slides along a surface. Let a path have its ends at the points
//! p0 and p1 of the body's frame, c apart, outside the body. By Stewart's theorem every point y of the body has
//! |y - x|^2 = (1 - t) |y - p0|^2 + t |y - p1|^2 - t (1 - t) c^2
//! for the point x at the share t of the chord. This is at least (1 - t) g0^2 + t g1^2 - t (1 - t) c^2.
//! A path of the length w lies in the ellipsoid with both ends as foci, so its points are at most sqrt(w^2 - c^2) / 2
//! from the chord. At the distance g this loses c^2 / (8 g) in place of c / 2.
//!
//! Points near each other share the intervals that can matter: at a point at the distance r every value and every bound
//! is lower by at most r. [`Searcher::narrow`] leaves out the intervals that cannot have the smallest distance of any
//! point within a radius.

use super::Sweep;
use crate::assembly::{Geometry, Similarity};
use crate::csg::parts::closed_form::Scratch;
use crate::query::Search;
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Intervals of a step shorter than this are not halved.
const SHORTEST: f64 = 1e-12;
/// Intervals on which the path is shorter than this many radii are left to the points within the radius.
const KEPT_PATH: f64 = 3.0;
/// Largest relative error of the lengths of a path and its chord.
const PATH_ROUNDING: f64 = 1e-9;

/// An interval of time of one body: several whole steps, or a part of one step.
#[derive(Debug, Clone, Copy)]
pub(super) struct Interval {
    body: u32,
    /// First step, and number of steps.
    first: u32,
    count: u32,
    /// Ends within the step, 0 to 1.
    ends: [f64; 2],
    /// Lower bounds of the distances at the ends.
    values: [f64; 2],
    /// Length of the path of the point in the frame of the body, at most.
    path: f64,
    /// Lower bound of the distance on the interval.
    bound: f64,
}

impl Goal {
    /// The lower bound that ends the search if this is the smallest value.
    fn enough(&self, smallest: f64) -> f64 {
        (smallest - self.tolerance.max(self.share * smallest)).min(self.above)
    }
}

impl Interval {
    fn bounded(mut self) -> Self {
        let [a, b] = self.values;
        self.bound = (0.5 * (a + b - self.path)).max(a.max(b) - self.path).max(self.bound);
        self
    }

    /// Tightens the bound by the empty balls around both ends of the path, which are `chord` apart. The values at the
    /// ends must be positive.
    fn bounded_by_balls(mut self, chord: f64) -> Self {
        let [a, b] = self.values.map(|value| value * value);
        let square = chord * chord;
        let share = if square > 0.0 { (0.5 * (a + square - b) / square).clamp(0.0, 1.0) } else { 0.0 };
        let on_chord = a + share * (b - a) - share * (1.0 - share) * square;
        // Cancellation would leave few correct digits of a smaller value.
        if on_chord > 1e-3 * a.max(b) {
            let path = self.path * (1.0 + PATH_ROUNDING);
            let aside = 0.5 * (path * path - square).max(0.0).sqrt();
            self.bound = self.bound.max(on_chord.sqrt() - aside);
        }
        self
    }
}

// The interval with the smallest bound is the largest.
impl Ord for Interval {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |i: &Self| (i.body, i.first, i.ends[0]);
        let (own, others) = (key(self), key(other));
        other.bound.total_cmp(&self.bound).then(others.partial_cmp(&own).unwrap_or(Ordering::Equal))
    }
}

impl PartialOrd for Interval {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Interval {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Interval {}

/// The accuracy of a search.
#[derive(Debug, Clone, Copy)]
pub(super) struct Goal {
    /// Largest difference between the smallest value and the lower bound: a length, or a share of the value.
    pub(super) tolerance: f64,
    pub(super) share: f64,
    /// The search ends when the distance is certainly at least this.
    pub(super) above: f64,
    /// The search ends when the distance is certainly at most this.
    pub(super) below: f64,
}

/// Bounds of the smallest distance over the motion.
#[derive(Debug, Clone, Copy)]
pub(super) struct Found {
    pub(super) lower: f64,
    pub(super) upper: f64,
}

/// State of one thread.
pub(super) struct Searcher<'a> {
    sweep: &'a Sweep,
    /// Searches of meshes, one for each geometry.
    searches: Vec<Option<Search<'a>>>,
    scratch: Scratch,
    /// The point for which `lengths` has the sums of path lengths of the steps of each body.
    center: DVec3,
    lengths: Vec<Vec<f64>>,
    heap: BinaryHeap<Interval>,
    /// The body, step and share at which the last search found its smallest value.
    last: Option<(u32, u32, f64)>,
    /// Number of evaluated poses.
    pub(super) evaluations: u64,
}

impl<'a> Searcher<'a> {
    pub(super) fn new(sweep: &'a Sweep) -> Self {
        let searches = sweep.bodies.elements.iter().map(|element| match &element.geometry {
            Geometry::Mesh(mesh) => Some(Search::new(mesh)),
            Geometry::Shape(_) => None,
        });
        Self {
            sweep,
            searches: searches.collect(),
            scratch: Scratch::default(),
            center: DVec3::ZERO,
            lengths: Vec::new(),
            heap: BinaryHeap::new(),
            last: None,
            evaluations: 0,
        }
    }

    /// Begins with points near `center`, and returns the whole motion of each body with geometry.
    pub(super) fn whole(&mut self, center: DVec3) -> Vec<Interval> {
        self.center = center;
        // Results do not depend on earlier points, which differ with the number of threads.
        self.last = None;
        self.lengths.resize(self.sweep.paths.len(), Vec::new());
        let mut intervals = Vec::new();
        for (body, (path, lengths)) in self.sweep.paths.iter().zip(&mut self.lengths).enumerate() {
            if path.elements.is_empty() {
                continue;
            }
            lengths.clear();
            let mut sum = 0.0;
            lengths.push(sum);
            lengths.extend(path.steps.iter().map(|step| {
                sum += step.speed(center);
                sum
            }));
            intervals.push(Interval {
                body: body as u32,
                first: 0,
                count: path.steps.len() as u32,
                ends: [0.0, 1.0],
                values: [f64::NEG_INFINITY; 2],
                path: sum,
                bound: f64::NEG_INFINITY,
            });
        }
        intervals
    }

    /// The intervals as they apply at a point at the distance `shift`.
    fn shifted(&self, interval: &Interval, shift: f64) -> Interval {
        let Interval { body, first, count, ends, .. } = *interval;
        let turns = &self.sweep.paths[body as usize].turns;
        let turn = (turns[(first + count) as usize] - turns[first as usize]) * (ends[1] - ends[0]);
        Interval {
            values: interval.values.map(|value| value - shift),
            path: interval.path + turn * shift,
            bound: interval.bound - shift,
            ..*interval
        }
    }

    /// The smallest distance of `p` over intervals that apply at the distance `shift` from it.
    pub(super) fn smallest(&mut self, p: DVec3, starts: &[Interval], shift: f64, goal: &Goal) -> Found {
        let mut found = Found { lower: f64::INFINITY, upper: f64::INFINITY };
        if let Some((body, step, share)) = self.last {
            let pose = self.sweep.paths[body as usize].steps[step as usize].at(share);
            found.upper = self.evaluate(body, &pose, p, f64::INFINITY);
        }
        self.heap.clear();
        let mut heap = std::mem::take(&mut self.heap);
        for start in starts {
            let bound = start.bound - shift;
            // The others cannot undercut the smallest value by more than the tolerance.
            if bound < goal.enough(found.upper) {
                heap.push(self.shifted(start, shift));
            } else {
                found.lower = found.lower.min(bound);
            }
        }
        while let Some(interval) = heap.pop() {
            let enough = goal.enough(found.upper);
            if found.upper <= goal.below {
                found.lower = found.lower.min(interval.bound);
                break;
            }
            if interval.bound >= enough || interval.ends[1] - interval.ends[0] < SHORTEST {
                found.lower = found.lower.min(interval.bound);
                if interval.bound >= enough {
                    break;
                }
                continue;
            }
            if let Some(halves) = self.halved(&interval, p, enough, &mut found.upper) {
                heap.extend(halves);
            } else {
                found.lower = found.lower.min(enough);
            }
        }
        self.heap = heap;
        found.lower = found.lower.min(found.upper);
        found
    }

    /// Bounds of the smallest distance at `p`, and the intervals that can have the smallest distance of any point
    /// within `radius` of it, with bounds at `p`. No intervals are returned if the distance reaches the goal.
    pub(super) fn narrow(
        &mut self,
        p: DVec3,
        radius: f64,
        starts: &[Interval],
        shift: f64,
        goal: &Goal,
    ) -> (Found, Option<Vec<Interval>>) {
        let mut found = Found { lower: f64::INFINITY, upper: f64::INFINITY };
        let mut heap: BinaryHeap<Interval> = starts.iter().map(|start| self.shifted(start, shift)).collect();
        let mut kept: Vec<Interval> = Vec::new();
        while let Some(interval) = heap.pop() {
            let enough = found.upper + 2.0 * radius;
            let lower = found.lower.min(interval.bound);
            if found.upper <= goal.below || lower >= goal.above {
                found.lower = lower.min(found.upper);
                return (found, None);
            }
            if interval.bound > enough {
                // The bounds of all others are larger.
                break;
            }
            if interval.path <= KEPT_PATH * radius || interval.ends[1] - interval.ends[0] < SHORTEST {
                found.lower = lower;
                kept.push(interval);
                continue;
            }
            if let Some(halves) = self.halved(&interval, p, enough, &mut found.upper) {
                heap.extend(halves);
            }
        }
        let enough = found.upper + 2.0 * radius;
        kept.retain(|interval| interval.bound <= enough);
        // The first intervals are likely to have the smallest distance.
        kept.sort_unstable_by(|a, b| b.cmp(a));
        found.lower = found.lower.min(found.upper);
        if found.upper <= goal.below || found.lower >= goal.above {
            return (found, None);
        }
        (found, Some(kept))
    }

    /// Both halves of an interval at `p`; none if the distance certainly exceeds `enough` on both.
    fn halved(&mut self, interval: &Interval, p: DVec3, enough: f64, upper: &mut f64) -> Option<[Interval; 2]> {
        let Interval { body, first, count, ends, values, path, .. } = *interval;
        let steps = &self.sweep.paths[body as usize].steps;
        let mut halves = [*interval; 2];
        let (pose, at);
        if count > 1 {
            let half = count / 2;
            (halves[0].count, halves[1].first, halves[1].count) = (half, first + half, count - half);
            halves[0].path = self.length(&halves[0], p).min(path);
            halves[1].path = self.length(&halves[1], p).min(path);
            at = (body, first + half, 0.0);
            pose = steps[at.1 as usize].at(0.0);
        } else {
            let middle = 0.5 * (ends[0] + ends[1]);
            let (posed, speed) = steps[first as usize].middle(p, ends[0], ends[1]);
            (halves[0].ends[1], halves[1].ends[0]) = (middle, middle);
            let half_path = (0.5 * speed * (ends[1] - ends[0])).min(path);
            halves.iter_mut().for_each(|half| half.path = half_path);
            (at, pose) = ((body, first, middle), posed);
        }
        let longest = halves[0].path.max(halves[1].path);
        let limit = enough + longest;
        let value = self.evaluate(body, &pose, p, limit);
        if value >= limit {
            return None;
        }
        if value < *upper {
            *upper = value;
            self.last = Some(at);
        }
        (halves[0].values, halves[1].values) = ([values[0], value], [value, values[1]]);
        let middle = pose.inverse_point(p);
        let tightened = |half: Interval, outer: f64, step: u32| {
            if half.bound >= enough || half.values[0].min(half.values[1]) <= 0.0 {
                return half;
            }
            let outer = steps[step as usize].at(outer).inverse_point(p);
            half.bounded_by_balls(middle.distance(outer))
        };
        let [start, end] = halves.map(Interval::bounded);
        Some([tightened(start, ends[0], first), tightened(end, ends[1], first + count - 1)])
    }

    /// Length of the path of `p` in the frame of the body during whole steps, at most.
    fn length(&self, interval: &Interval, p: DVec3) -> f64 {
        let Interval { body, first, count, .. } = *interval;
        let (first, last) = (first as usize, (first + count) as usize);
        let lengths = &self.lengths[body as usize];
        let turns = &self.sweep.paths[body as usize].turns;
        lengths[last] - lengths[first] + (turns[last] - turns[first]) * p.distance(self.center)
    }

    /// The signed distance of `p` from a posed body; `limit` if it certainly exceeds the limit.
    fn evaluate(&mut self, body: u32, pose: &Similarity, p: DVec3, limit: f64) -> f64 {
        self.evaluations += 1;
        let mut least = limit;
        let at_body = pose.inverse_point(p);
        for &i in &self.sweep.paths[body as usize].elements {
            let element = &self.sweep.bodies.elements[i];
            let local = element.place.inverse_point(at_body);
            let beside = element.bounds.is_some_and(|[lower, upper]| {
                // The inside may have any depth in the box.
                let away = (lower - local).max(local - upper).max(DVec3::ZERO).length();
                away > 0.0 && away > least
            });
            if beside {
                continue;
            }
            let distance = match (&element.geometry, &mut self.searches[i]) {
                (Geometry::Shape(shape), _) => Some(shape.distance(local, &mut self.scratch)),
                (Geometry::Mesh(_), Some(search)) => search.nearest(local, least).map(|found| found.distance),
                (Geometry::Mesh(_), None) => None,
            };
            if let Some(distance) = distance {
                least = least.min(if self.sweep.is_unsigned { distance.abs() } else { distance });
            }
        }
        least
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_bound_the_distance_on_arcs_and_chords() {
        // Around a body that is one point, distances are exact, and the bound is the distance from the chord.
        let bounded = |values: [f64; 2], chord: f64, path: f64| {
            let ends = [0.0, 1.0];
            let bound = f64::NEG_INFINITY;
            Interval { body: 0, first: 0, count: 1, ends, values, path, bound }.bounded_by_balls(chord).bound
        };
        let mut tight = 0;
        for i in 1..=40 {
            for j in 0..20 {
                // An arc of the radius 1, and the body at `place` on the line through its middle and center.
                let half = 0.03 * f64::from(i);
                let place = DVec3::X * (-1.0 + 0.2 * f64::from(j));
                let at = |angle: f64| DVec3::new(angle.cos(), angle.sin(), 0.0);
                let values = [at(-half).distance(place), at(half).distance(place)];
                let bound = bounded(values, at(-half).distance(at(half)), 2.0 * half);
                let on_arc = |k: i32| at(half * f64::from(k) / 100.0).distance(place);
                let least = (-100..=100).map(on_arc).fold(f64::INFINITY, f64::min);
                assert!(bound <= least, "{half} {place} {bound} {least}");
                tight += i32::from(bound >= 0.5 * (values[0] + values[1]) - half);
            }
        }
        // On most arcs the bound is larger than the bound by the length of the path.
        assert!(tight >= 400, "{tight}");
        assert!((bounded([2.0, 2.0], 1.0, 1.0) - 3.75_f64.sqrt()).abs() <= 1e-4);
        assert!((bounded([2.0, 3.0], 1.0, 1.0) - 2.0).abs() <= 1e-4);
        assert!(bounded([1.0, 1.0], 2.0, 2.0).is_infinite());
    }
}
