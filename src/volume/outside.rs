//! A lower bound on the distance to the surface at points outside the box.
//!
//! # Theory
//!
//! Let `d(p)` be the distance to the surface, a closed set of points `q`. Then
//!
//! ```text
//!   d(p)^2 - |p|^2 = min over q of (|q|^2 - 2 p.q)
//! ```
//!
//! is a minimum of linear functions of `p`, hence concave. Let `c` be a point among eight voxel centres `c_i`, with
//! trilinear weights `w_i`, so `c = sum w_i c_i`. Jensen's inequality gives
//!
//! ```text
//!   d(c)^2 >= sum w_i d_i^2 - (sum w_i |c_i|^2 - |c|^2)
//!           = sum w_i d_i^2 - sum over axes of h^2 f (1 - f)  =: s^2
//! ```
//!
//! with the voxel size `h` and the fraction `f` along each axis; the subtracted term is the variance of the weights. So
//! `s` is a bound that uses the squares of the stored values. The trilinear field itself is not a bound; it can exceed
//! `d`.
//!
//! Take a convex set that contains the surface and in which the samples define `s`. Let `c` be its point nearest to
//! `p`, and `a = |p - c|`.
//!
//! - Case 1: the surface lies in the hull of the voxel centres, as after a bake with a margin. Two convex sets are
//!   valid: the hull, and the box of the surface in it. Convexity gives `(p - c).(c - q) >= 0` for every `q`, so
//!   `|p - q|^2 >= a^2 + |c - q|^2` and `d(p) >= sqrt(a^2 + max(0, s^2))`. The bound of the hull is tighter near the
//!   box, the bound of the inner box farther away. The larger one is used, and it is positive.
//! - Case 2: it does not, because the user's bounds cut the mesh. Then `d(p) >= s - a` at the nearest point of the
//!   hull, by the triangle inequality, and `d(p)` is at least the distance to the inner box. The larger one is used; it
//!   can be zero.
//!
//! All of this holds for values that are lower bounds themselves (a narrow band, a merged scene). `a + s` is not a
//! bound: with it rays would pass through surfaces.
//!
//! # Practice
//!
//! The bound holds up to the error of the stored distances; the last rounding to f32 is downward. For a sphere in a box
//! with a margin of 10 % the bound is on average 0.85 of the distance, over the points within one box length of the
//! box.

use super::{FieldView, Texel, Trilinear};
use glam::DVec3;

impl<T: Texel> FieldView<'_, T> {
    /// [`bound_outside`] of the unsigned distance in f64. Valid for points in the hull too.
    pub(crate) fn unsigned_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f64 {
        unsigned_bound(self, p, inner)
    }

    /// Bound on the signed distance at `p` from the eight samples around the point of the hull nearest to `p`.
    pub(crate) fn cell_bound(&self, p: DVec3) -> CellBound {
        let h = self.grid().spacing();
        let p_grid = self.grid_from_world(p);
        let last = self.shape() - 1.0;
        let cell = p_grid.max(DVec3::ZERO).min(last).floor();
        let corners = self.corners(cell.as_ivec3());
        // Squared distances to the lower and to the upper corner along each axis.
        let (to_low, to_high) = ((p_grid - cell) * h, (p_grid - (cell + 1.0).min(last)) * h);
        let (low, high) = (to_low * to_low, to_high * to_high);
        let in_hull = p_grid.clamp(DVec3::ZERO, last) == p_grid;
        let mut bound = CellBound { by_distance: f64::NEG_INFINITY, all_positive: true, in_hull };
        for (i, &distance) in corners.iter().enumerate() {
            let x = if i & 1 == 0 { low.x } else { high.x };
            let y = if i & 2 == 0 { low.y } else { high.y };
            let z = if i & 4 == 0 { low.z } else { high.z };
            bound.by_distance = bound.by_distance.max(f64::from(distance) - (x + y + z).sqrt());
            bound.all_positive &= distance > 0.0;
        }
        bound
    }
}

/// A bound from the samples around a point.
#[derive(Debug, Clone, Copy)]
pub(crate) struct CellBound {
    /// The largest difference of a sample and its distance from the point. It does not exceed the signed distance,
    /// which has slope 1.
    pub by_distance: f64,
    pub all_positive: bool,
    /// Whether the point lies between the voxel centres.
    pub in_hull: bool,
}

/// Lower bound, zero or more, on the distance from `p`, outside the box, to a surface inside the box `inner`, from a
/// field that stores every sample of its grid.
pub(crate) fn bound_outside(field: &impl Trilinear, p: DVec3, inner: [DVec3; 2]) -> f32 {
    round_down(unsigned_bound(field, p, inner))
}

/// [`bound_outside`] before it is rounded.
fn unsigned_bound(field: &impl Trilinear, p: DVec3, inner: [DVec3; 2]) -> f64 {
    let grid = field.grid();
    let h = grid.spacing();
    let (hull_lower, hull_upper) = (grid.lower + 0.5 * h, grid.upper - 0.5 * h);
    let nearest_in_hull = p.max(hull_lower).min(hull_upper);
    let nearest_in_inner = p.max(inner[0]).min(inner[1]);
    let to_inner = (p - nearest_in_inner).length();

    let surface_is_in_hull = inner[0].cmpge(hull_lower).all() && inner[1].cmple(hull_upper).all();
    if surface_is_in_hull {
        let by_hull = (p - nearest_in_hull).length_squared() + square_bound(field, nearest_in_hull);
        let by_inner = to_inner * to_inner + square_bound(field, nearest_in_inner);
        by_hull.max(by_inner).sqrt()
    } else {
        let by_hull = square_bound(field, nearest_in_hull).sqrt() - (p - nearest_in_hull).length();
        by_hull.max(to_inner)
    }
}

/// Lower bound `max(0, s^2)` on the squared distance at a point `c` in the hull of the voxel centres.
pub(super) fn square_bound(field: &impl Trilinear, c: DVec3) -> f64 {
    let h = field.grid().spacing();
    let c_grid = field.grid_from_world(c).max(DVec3::ZERO).min(field.shape() - 1.0);
    let cell = c_grid.floor();
    let f = c_grid - cell;
    let variance = (h * h * f * (1.0 - f)).element_sum();
    (mean_square(&field.cell(cell.as_ivec3()).corners, f) - variance).max(0.0)
}

/// Trilinear mean of the squared samples. It is f64, because it is compared with the variance.
fn mean_square(corners: &[f32; 8], f: DVec3) -> f64 {
    let mut sum = 0.0;
    for (i, &distance) in corners.iter().enumerate() {
        let wx = if i & 1 == 0 { 1.0 - f.x } else { f.x };
        let wy = if i & 2 == 0 { 1.0 - f.y } else { f.y };
        let wz = if i & 4 == 0 { 1.0 - f.z } else { f.z };
        sum += wx * wy * wz * (distance as f64 * distance as f64);
    }
    sum
}

/// The largest f32 that does not exceed `value`.
pub(crate) fn round_down(value: f64) -> f32 {
    let rounded = value as f32;
    if rounded as f64 > value { rounded.next_down() } else { rounded }
}

#[cfg(test)]
mod tests {
    use super::super::FieldView;
    use super::super::tests::fill;
    use super::*;
    use crate::grid::Grid;
    use proptest::prelude::*;

    /// Brute-force truth: the surface is a set of points.
    fn distance_to(points: &[DVec3], p: DVec3) -> f64 {
        points.iter().map(|q| (p - *q).length_squared()).fold(f64::INFINITY, f64::min).sqrt()
    }

    fn bounds_of(points: &[DVec3]) -> [DVec3; 2] {
        [points.iter().copied().reduce(DVec3::min).unwrap(), points.iter().copied().reduce(DVec3::max).unwrap()]
    }

    /// The largest effect of half an ulp of error in the stored samples on the bound, relative to the largest sample.
    fn stored_error(distances: &[f32]) -> f64 {
        f32::EPSILON as f64 * distances.iter().fold(0.0f32, |m, d| m.max(d.abs())) as f64
    }

    fn point() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #[test]
        fn the_bound_is_never_above_the_truth(
            surface in prop::collection::vec(point(), 1..12),
            shape in (1..7usize, 1..7usize, 1..7usize),
            margin in 0.0..0.6f64,
            queries in prop::collection::vec(point(), 20),
        ) {
            let inner = bounds_of(&surface);
            let size = inner[1] - inner[0] + 0.1;
            let grid = Grid::new(inner[0] - margin * size - 0.01, inner[1] + margin * size + 0.01, [shape.0, shape.1, shape.2]).unwrap();
            let distances = fill(&grid, |p| distance_to(&surface, p));
            let field = FieldView::new(grid, &distances).unwrap();
            for direction in queries {
                let p = 3.0 * direction;
                if !field.contains(p) {
                    let bound = field.distance_bound(p, inner) as f64;
                    prop_assert!(bound >= 0.0);
                    prop_assert!(bound <= distance_to(&surface, p) + stored_error(&distances));
                }
            }
        }

        #[test]
        fn the_bound_holds_where_the_box_cuts_the_surface(
            surface in prop::collection::vec(point(), 1..12),
            corner in point(),
            queries in prop::collection::vec(point(), 20),
        ) {
            let grid = Grid::new(corner - 0.5, corner + DVec3::new(0.4, 0.5, 0.3), [4, 5, 3]).unwrap();
            let distances = fill(&grid, |p| distance_to(&surface, p));
            let field = FieldView::new(grid, &distances).unwrap();
            for direction in queries {
                let p = 3.0 * direction;
                if !field.contains(p) {
                    let bound = field.distance_bound(p, bounds_of(&surface)) as f64;
                    prop_assert!(bound >= 0.0);
                    prop_assert!(bound <= distance_to(&surface, p) + stored_error(&distances));
                }
            }
        }
    }

    #[test]
    fn the_bound_is_tight_for_a_sphere() {
        let grid = Grid::new(DVec3::splat(-1.1), DVec3::splat(1.1), [32, 32, 32]).unwrap();
        let distances = fill(&grid, |p| p.length() - 1.0);
        let field = FieldView::new(grid, &distances).unwrap();
        let (mut sum, mut count) = (0.0, 0);
        // Points of a regular lattice within one box length of the box, not on its symmetry planes.
        for i in 0..30 {
            for j in 0..30 {
                for k in 0..30 {
                    let p = (DVec3::new(i as f64, j as f64, k as f64) + 0.37) / 30.0 * 6.6 - 3.3;
                    if field.contains(p) {
                        continue;
                    }
                    let (bound, truth) =
                        (field.distance_bound(p, [DVec3::NEG_ONE, DVec3::ONE]) as f64, p.length() - 1.0);
                    assert!(bound > 0.0 && bound <= truth + stored_error(&distances));
                    sum += bound / truth;
                    count += 1;
                }
            }
        }
        let tightness = sum / count as f64;
        println!("mean bound / distance: {tightness:.3}");
        assert!(tightness > 0.8);
    }

    #[test]
    fn rounding_is_downward() {
        assert!(round_down(0.1) as f64 <= 0.1);
        assert!(round_down(0.3) as f64 <= 0.3);
        assert_eq!(round_down(0.5), 0.5);
        assert_eq!(round_down(f64::INFINITY), f32::INFINITY);
    }
}
