//! A field with a transform to the world, and its lower bound on the distance at any point.
//!
//! # Theory
//!
//! Let `M` map local to world coordinates, and let `sigma_min` and `sigma_max` be the smallest and largest factor by
//! which it stretches a length. The distance `d` from a world point to the placed surface satisfies
//!
//! ```text
//!   sigma_min d_local <= d <= sigma_max d_local
//! ```
//!
//! since every segment between the point and the surface is stretched by a factor between the two. A lower bound `L` on
//! the signed local distance therefore becomes `sigma_min L` where it is positive and `sigma_max L` where it is
//! negative, and neither exceeds the signed world distance. For a rigid motion both factors are 1 and the bound is as
//! tight as in local space.
//!
//! `L` at a local point `p`:
//!
//! - Between eight voxel centres `c_i` with samples `d_i`: a signed distance is 1-Lipschitz, so
//!   `L = max(d_i - |p - c_i|)`. If all eight are positive, the variance bound `s` of [`crate::volume::outside`] also
//!   holds, and the larger one is used. (If `p` were inside a part too thin for any corner to be inside, at depth `e`,
//!   then `d_i <= |p - c_i| - e` and `e <= |p - c_i|`, hence `sum w_i d_i^2 < sum w_i |p - c_i|^2`: `s` would be 0.) At
//!   a voxel centre this is the sample itself. Between centres, trilinear interpolation may exceed the distance. `L` is
//!   smaller than the interpolated value by at most half the diagonal of a voxel, as in the middle of a cell whose
//!   eight samples are equal.
//! - Outside the hull of the centres: `sqrt(a^2 + s^2)` as in [`crate::volume::outside`], from the hull and from the
//!   box of the surface. Where the surface extends beyond the outermost samples, because the grid's box cuts it, the
//!   cut counts as surface and the part beyond it is absent, so the bound is at most the distance to the grid's box.
//! - In the world, the surface lies in the box around the transformed corners of its own box. The distance to that box
//!   is a lower bound as well. It makes culling by boxes exact: a box that is too far away cannot contain the minimum.
//!
//! # Practice
//!
//! All arithmetic is f64, rounded down to f32 at the end. The bound holds up to the error of the stored distances.

use crate::error::{ArgumentError, Error};
use crate::quadric::local::Local;
use crate::volume::{FieldView, Trilinear};
use glam::{DAffine3, DMat3, DVec3};

/// The geometry of a placed field.
#[derive(Debug, Clone, Copy)]
pub enum Geometry<'a> {
    /// A stored field.
    Volume {
        /// The field.
        field: FieldView<'a>,
        /// A box that contains its surface.
        inner: [DVec3; 2],
    },
    /// A quadric in world space; it is not transformed.
    Quadric(Local),
}

/// Geometry and its transform.
#[derive(Debug, Clone)]
pub struct Placed<'a> {
    /// The object.
    pub geometry: Geometry<'a>,
    /// Transform of the object.
    pub world_from_local: DAffine3,
    /// Inverse of the transform.
    pub local_from_world: DAffine3,
    /// Smallest stretch of the transform.
    pub sigma_min: f64,
    /// Largest stretch of the transform.
    pub sigma_max: f64,
    /// Box around the surface, world axes.
    pub bounds: [DVec3; 2],
    /// Whether the surface extends beyond the outermost samples.
    pub is_cut: bool,
}

impl<'a> Placed<'a> {
    /// Places a stored field. Fails if the transform cannot be inverted.
    pub fn volume(field: FieldView<'a>, inner: [DVec3; 2], world_from_local: DAffine3) -> Result<Self, Error> {
        let [sigma_min, sigma_max] = stretch(world_from_local.matrix3);
        let local_from_world = world_from_local.inverse();
        if !(sigma_min > 0.0 && sigma_max.is_finite() && local_from_world.is_finite()) {
            return Err(ArgumentError::new("transform", "cannot be undone").into());
        }
        let grid = field.grid();
        let half = 0.5 * grid.spacing();
        let is_cut = inner[0].cmplt(grid.lower + half).any() || inner[1].cmpgt(grid.upper - half).any();
        let solid = if is_cut { [grid.lower, grid.upper] } else { inner };
        let bounds = transformed_box(solid, &world_from_local);
        let geometry = Geometry::Volume { field, inner };
        Ok(Self { geometry, world_from_local, local_from_world, sigma_min, sigma_max, bounds, is_cut })
    }

    /// Places a quadric.
    pub fn quadric(local: Local) -> Self {
        Self {
            geometry: Geometry::Quadric(local),
            world_from_local: DAffine3::IDENTITY,
            local_from_world: DAffine3::IDENTITY,
            sigma_min: 1.0,
            sigma_max: 1.0,
            bounds: [local.center - local.radius, local.center + local.radius],
            is_cut: false,
        }
    }

    /// Distance from a world point to the box around the surface.
    pub fn distance_to_bounds(&self, p: DVec3) -> f64 {
        (self.bounds[0] - p).max(p - self.bounds[1]).max(DVec3::ZERO).length()
    }

    /// Lower bound on the signed distance from a world point. If the bound is at least `best`, any value that is at
    /// least `best` may be returned, which saves its evaluation.
    pub fn lower_bound(&self, p: DVec3, best: f64) -> f64 {
        let to_bounds = self.distance_to_bounds(p);
        // Inside the box the field may be negative, so the distance zero to the box is not a bound.
        if to_bounds > 0.0 && to_bounds >= best {
            return to_bounds;
        }
        match &self.geometry {
            Geometry::Quadric(local) => local.distance_bound(p).max(to_bounds),
            Geometry::Volume { field, inner } => {
                let p_local = self.local_from_world.transform_point3(p);
                if !self.is_cut {
                    let by_box = self.sigma_min * distance_to_box(p_local, *inner);
                    if by_box > 0.0 && by_box >= best {
                        return by_box;
                    }
                }
                let local = signed_bound(field, *inner, self.is_cut, p_local);
                let bound = if local < 0.0 { self.sigma_max * local } else { self.sigma_min * local };
                if to_bounds > 0.0 { bound.max(to_bounds) } else { bound }
            }
        }
    }
}

/// `L` of the module.
fn signed_bound(field: &FieldView<'_>, inner: [DVec3; 2], is_cut: bool, p: DVec3) -> f64 {
    let cell = field.cell_bound(p);
    // Bound on the surface itself, without the cut.
    let unsigned = || field.unsigned_bound(p, inner);
    // Even if all corners are positive, the point may be inside a thin part, where the bound of the distance is 0.
    let in_cell = || match cell.all_positive.then(unsigned) {
        Some(bound) if bound > 0.0 => cell.by_distance.max(bound),
        _ => cell.by_distance,
    };
    if !is_cut {
        let to_inner = distance_to_box(p, inner);
        let bound = if cell.in_hull { in_cell() } else { cell.by_distance.max(unsigned()) };
        return if to_inner > 0.0 { bound.max(to_inner) } else { bound };
    }
    let to_box = distance_to_box(p, [field.grid().lower, field.grid().upper]);
    if to_box > 0.0 {
        return unsigned().min(to_box);
    }
    in_cell()
}

fn distance_to_box(p: DVec3, [lower, upper]: [DVec3; 2]) -> f64 {
    (lower - p).max(p - upper).max(DVec3::ZERO).length()
}

/// Box around a transformed box.
pub(crate) fn transformed_box([lower, upper]: [DVec3; 2], transform: &DAffine3) -> [DVec3; 2] {
    let center = transform.transform_point3(0.5 * (lower + upper));
    let half = 0.5 * (upper - lower);
    let m = transform.matrix3;
    let reach = m.x_axis.abs() * half.x + m.y_axis.abs() * half.y + m.z_axis.abs() * half.z;
    // A few roundings of the summed values.
    let room = 8.0 * f64::EPSILON * (reach + center.abs());
    [center - reach - room, center + reach + room]
}

/// Smallest and largest factor by which a matrix stretches a vector: its singular values, by one-sided Jacobi rotations
/// (Hestenes 1958), which compute small ones as accurately as large ones. The interval is widened by their rounding.
fn stretch(m: DMat3) -> [f64; 2] {
    let mut columns = [m.x_axis, m.y_axis, m.z_axis];
    for _ in 0..MAX_SWEEPS {
        let mut is_done = true;
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let (u, v) = (columns[i], columns[j]);
            let (uu, vv, uv) = (u.length_squared(), v.length_squared(), u.dot(v));
            if uv.abs() <= f64::EPSILON * (uu * vv).sqrt() {
                continue;
            }
            is_done = false;
            let zeta = (vv - uu) / (2.0 * uv);
            let tangent = 1.0f64.copysign(zeta) / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let cosine = 1.0 / (1.0 + tangent * tangent).sqrt();
            let sine = cosine * tangent;
            columns[i] = cosine * u - sine * v;
            columns[j] = sine * u + cosine * v;
        }
        if is_done {
            break;
        }
    }
    let lengths = columns.map(DVec3::length);
    let least = lengths.iter().copied().fold(f64::INFINITY, f64::min);
    let most = lengths.iter().copied().fold(0.0, f64::max);
    if (least - 1.0).abs() <= RIGID && (most - 1.0).abs() <= RIGID {
        return [1.0, 1.0];
    }
    [least * (1.0 - STRETCH_ROUNDING), most * (1.0 + STRETCH_ROUNDING)]
}

/// Number of sweeps. Three or four suffice for any 3x3 matrix.
const MAX_SWEEPS: usize = 20;
/// Relative rounding error of a singular value after some tens of operations.
const STRETCH_ROUNDING: f64 = 1e-14;
/// A rotation computed in float64 preserves lengths to within this, far below the rounding of a sample.
const RIGID: f64 = 1e-12;

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DQuat;
    use proptest::prelude::*;

    fn rotation() -> impl Strategy<Value = DMat3> {
        prop::array::uniform4(-1.0..1.0f64)
            .prop_filter("no direction", |q| q.iter().map(|x| x * x).sum::<f64>() > 0.01)
            .prop_map(|q| DMat3::from_quat(DQuat::from_array(q).normalize()))
    }

    proptest! {
        #[test]
        fn the_stretch_is_that_of_the_axes(a in rotation(), b in rotation(), scale in prop::array::uniform3(1e-6..1e6f64)) {
            let [least, most] = stretch(a * DMat3::from_diagonal(DVec3::from(scale)) * b);
            let exact = DVec3::from(scale);
            // The product of three matrices is rounded itself, by a few roundings of its largest entry.
            let rounding = 1e-14 * exact.max_element();
            prop_assert!(least <= exact.min_element() + rounding && least >= exact.min_element() * (1.0 - 1e-13) - rounding);
            prop_assert!(most >= exact.max_element() - rounding && most <= exact.max_element() * (1.0 + 1e-13) + rounding);
        }

        #[test]
        fn rotations_stretch_by_one(a in rotation(), b in rotation()) {
            prop_assert_eq!(stretch(a * b), [1.0, 1.0]);
            prop_assert_eq!(stretch(a * DMat3::from_diagonal(DVec3::new(1.0, -1.0, 1.0))), [1.0, 1.0]);
        }
    }

    #[test]
    fn what_cannot_be_undone_is_refused() {
        let grid = crate::grid::Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 1]).unwrap();
        let field = FieldView::new(grid, &[1.0]).unwrap();
        let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
        let error = Placed::volume(field, [DVec3::splat(0.5); 2], flat).unwrap_err().to_string();
        assert!(error.starts_with("transform: "), "{error}");
    }
}
