//! Balls around the surfaces of instances.

use super::instance::Instance;
use crate::geometry::{GOLDEN_ANGLE, clip};
use crate::scene::fields::field::{Field, FieldRay};
use glam::{DMat3, DVec3, Vec3};
use std::collections::HashMap;
use std::sync::Arc;

/// Relative margin for the rounding of distances.
const ROUNDING: f32 = 1e-5;

/// A ball that contains the surface of an instance, scene units.
#[derive(Debug, Clone, Copy)]
pub struct Ball {
    pub center: Vec3,
    pub radius: f32,
    /// The radius in field space. The centre is the centre of the surface's box.
    pub field_radius: f32,
    /// Fraction of the ball's disc that the object covers, averaged over directions.
    pub fill: f32,
}

impl Ball {
    /// The balls of all instances. An instance without a field has a ball of radius 0.
    pub fn of(instances: &[Instance]) -> Vec<Self> {
        let mut found: HashMap<usize, (DVec3, f64, f32)> = HashMap::new();
        instances
            .iter()
            .map(|instance| {
                let Some(field) = &instance.field else {
                    return Self { center: Vec3::ZERO, radius: 0.0, field_radius: 0.0, fill: 0.0 };
                };
                let (center, radius, fill) = *found.entry(Arc::as_ptr(field).addr()).or_insert_with(|| {
                    let (center, radius) = surface_ball(field.as_ref());
                    (center, radius, fill(field.as_ref(), center, radius))
                });
                let center = instance.field_from_scene.inverse().transform_point3(center).as_vec3();
                let radius = radius as f32 * (1.0 + ROUNDING);
                let scale = field.field_from_local().matrix3;
                let units =
                    [scale.x_axis, scale.y_axis, scale.z_axis].map(DVec3::length).into_iter().fold(0.0, f64::max);
                let field_radius = (radius * units as f32).min(field.surface_radius());
                Self { center, radius: radius * instance.stretch[1], field_radius, fill }
            })
            .collect()
    }
}

/// Largest number of halvings of a surface's box in [`surface_ball`]. They give the radius to a sixteenth of the box.
const HALVINGS: u32 = 5;

/// Centre in field space and radius in the object's units of a ball that contains the surface.
///
/// Cells of the surface's box are halved along all axes, and the cell with the farthest corner comes first. A cell is
/// dropped if the distance at its centre exceeds its half diagonal by a voxel or more.
fn surface_ball(field: &dyn Field) -> (DVec3, f64) {
    let [lower, upper] = field.surface_bounds().map(|corner| corner.as_dvec3());
    let (center, half) = (0.5 * (lower + upper), 0.5 * (upper - lower));
    let m = field.field_from_local().inverse().matrix3;
    let local_from_field = DMat3::from_cols(m.x_axis.abs(), m.y_axis.abs(), m.z_axis.abs());
    if field.prefers_rays() {
        // For these objects one distance costs more than the larger ball.
        let unit = local_from_field.mul_vec3(DVec3::ONE).max_element();
        return (center, (f64::from(field.surface_radius()) * unit).min((local_from_field * half).length()));
    }
    let corner = |middle: DVec3, half: DVec3| (local_from_field * ((middle - center).abs() + half)).length();
    let mut radius = 0.0f64;
    let mut cells = vec![(center, 0)];
    while let Some((middle, halvings)) = cells.pop() {
        let half = half * 0.5f64.powi(halvings as i32);
        let furthest = corner(middle, half);
        let clearance = (local_from_field * half).length() + field.voxel();
        if furthest <= radius || f64::from(field.distance(middle.as_vec3())) > clearance {
            continue;
        }
        if halvings == HALVINGS {
            radius = furthest;
            continue;
        }
        let first = cells.len();
        cells.extend((0..8).map(|i| {
            let side = |axis: u32| if i >> axis & 1 == 0 { -0.5 } else { 0.5 };
            (middle + DVec3::new(side(0), side(1), side(2)) * half, halvings + 1)
        }));
        cells[first..].sort_by(|a, b| corner(a.0, 0.5 * half).total_cmp(&corner(b.0, 0.5 * half)));
    }
    (center, radius)
}

/// Number of rays that measure how much of a ball its surface fills. The standard error is 0.06 or less.
const FILL_RAYS: u32 = 64;

/// Fraction of lines through a ball, uniform in direction and position, that intersect the surface in it.
fn fill(field: &dyn Field, center: DVec3, radius: f64) -> f32 {
    let [lower, upper] = field.surface_bounds();
    let field_from_local = field.field_from_local().matrix3;
    let hits = (0..FILL_RAYS).filter(|&i| {
        // A spiral over the sphere, and a sequence of low discrepancy over the disc (Roberts 2018).
        let z = 1.0 - (2.0 * f64::from(i) + 1.0) / f64::from(FILL_RAYS);
        let (sine, cosine) = (f64::from(i) * GOLDEN_ANGLE).sin_cos();
        let along = DVec3::new(cosine * (1.0 - z * z).sqrt(), sine * (1.0 - z * z).sqrt(), z);
        let (right, up) = along.any_orthonormal_pair();
        let [share, turn] = [0.754_877_666, 0.569_840_291].map(|step: f64| (0.5 + f64::from(i) * step).fract());
        let (sine, cosine) = (std::f64::consts::TAU * turn).sin_cos();
        let aside = radius * share.sqrt() * (cosine * right + sine * up);
        let (start, direction) = (center + field_from_local * (aside - radius * along), field_from_local * along);
        let Some((enter, leave)) = clip(start, direction, lower, upper, 0.0, 2.0 * radius) else { return false };
        let ray = FieldRay { origin: (start + enter * direction).as_vec3(), direction: direction.as_vec3() };
        field.first_hit(&ray, (leave - enter) as f32).0.is_some()
    });
    hits.count() as f32 / FILL_RAYS as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::progress::Progress;
    use crate::scene::fields::field::{DenseField, SampledField};

    #[test]
    fn the_ball_of_a_sphere_is_nearly_as_small() {
        let grid = Grid::new(DVec3::splat(-1.5), DVec3::splat(1.5), [48; 3]).unwrap();
        let samples =
            (0..grid.len()).map(|i| (grid.center(i % 48, i / 48 % 48, i / 2304).length() - 1.0) as f32).collect();
        let field = DenseField::new(grid, samples).unwrap();
        let field = SampledField::new(field, [DVec3::splat(-1.0), DVec3::ONE], &Progress::new()).unwrap();
        let (center, radius) = surface_ball(&field);
        assert!((center - 23.5).length() <= 1.0, "{center}");
        // A cell of a sixteenth of the box has the diagonal 0.12. Its centre may be half of that and a voxel off the
        // surface.
        assert!((1.0..=1.0 + 0.12 + 0.0625).contains(&radius), "{radius}");
        // The disc of the sphere in a ball twice as wide, within the standard error of the rays.
        let share = fill(&field, center, 2.0);
        assert!((share - 0.25).abs() <= 0.06, "{share}");
        // The squared ratio of the radii, less the same error.
        assert!((f64::from(fill(&field, center, radius)) - radius.powi(-2)).abs() <= 0.06);
    }
}
