//! Light that passes through an object: the length of its material along a ray, and the fraction of the light that
//! remains.
//!
//! # Theory
//!
//! At a visible point `p` of an object that scatters, for a direction `w` to a light,
//!
//! ```text
//!   T = V(w) exp(-l(w) / s)
//! ```
//!
//! is the fraction of the light that arrives through the object. `l` is the length of the ray from `p` along `w` inside
//! the object, and `s` the material's scattering length, one for each of RGB. `V` is the visibility of the light from
//! the point where the ray enters the object. No other point of the object lies on the ray behind that one, so `V` is
//! the fraction of the ray from `p` that all *other* instances let pass, in the mode of the picture's shadows.
//!
//! A quadric has its chord in closed form ([`Field::chord`](crate::scene::fields::field::Field::chord)). For other
//! objects the field is evaluated along the ray, with steps of the distance, within which no crossing lies. If the
//! distance is below [`LEAST_VOXELS`], the step has that length. A crossing between two evaluations is interpolated
//! linearly, so `l` is a continuous function of the ray, except for intervals inside the object that are shorter than
//! [`LEAST_VOXELS`] voxels.
//!
//! The visible point of a mesh lies up to a third of a voxel from the surface of its field. A ray into the object
//! starts one voxel before `p`, outside, and the length begins at the field's own surface; a ray away from it starts
//! outside like shadow rays.

use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::occluder::ray_in_field;
use super::shadow::TracedScene;
use crate::geometry::clip;
use crate::scene::fields::field::FieldRay;
use glam::Vec3;

/// The shortest step, voxels.
const LEAST_VOXELS: f32 = 0.125;
/// Largest number of shortest steps in the interval of a ray in the box. In a long interval the shortest step is longer
/// than [`LEAST_VOXELS`].
const MOST_STEPS: f32 = 1024.0;
/// Distance before a visible point at which a ray into the object starts, voxels.
const BACK_VOXELS: f64 = 1.0;

/// `exp(-x)` below this counts as no light.
pub(crate) const NO_LIGHT: f32 = 1e-9;

/// Fraction of the light that remains after a length inside, for each of RGB; the scattering lengths are in the same
/// unit. A colour with a scattering length of 0 does not enter.
pub(crate) fn transmitted(length: f32, scattering: Vec3) -> Vec3 {
    let share = (-length / scattering.max(Vec3::splat(f32::MIN_POSITIVE))).exp();
    Vec3::select(scattering.cmpgt(Vec3::ZERO), share, Vec3::ZERO)
}

/// Weight of transmitted light on a surface at this cosine to the light: 1 where the surface faces away. On the lit
/// side it falls fast enough that Lambert's cosine plus the weight is at most 1.
pub(crate) fn weight(cosine: f32) -> f32 {
    let rest = 1.0 - cosine.clamp(0.0, 1.0);
    rest * rest
}

/// The ray through a surface's own field along which its length inside is measured.
pub(crate) struct InsideRay {
    /// Start at the entrance to the box of the surface, field space. The direction has the length of one scene unit.
    pub ray: FieldRay,
    /// End in the box, scene units from the ray's start.
    pub end: f32,
    /// Number of scene units in a local unit of distance.
    pub pace: f32,
    /// The shortest step, scene units.
    pub least_step: f32,
}

impl TracedScene<'_> {
    /// Length of a ray from a visible point inside the point's own instance, scene units; 0 without a field.
    pub(crate) fn length_inside(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        if let Some(chord) = self.chord(place, ray) {
            return chord;
        }
        let instance = &self.scene.instances[place.own as usize];
        let Some(field) = instance.field.as_deref() else { return 0.0 };
        let Some(inside) = self.inside_ray(place, ray) else { return 0.0 };
        let InsideRay { ray, end, pace, least_step } = inside;
        let mut length = 0.0;
        let (mut before, mut distance_before) = (0.0, f32::INFINITY);
        let mut t = 0.0;
        loop {
            let distance = field.distance(ray.origin + t * ray.direction);
            work.steps += 1;
            length += length_between(before, distance_before, t, distance);
            if t >= end {
                return length;
            }
            (before, distance_before) = (t, distance);
            t = (t + (distance.abs() * pace).max(least_step)).min(end);
        }
    }

    /// The length in closed form; `None` if the field has none.
    pub(crate) fn chord(&self, place: &SurfacePoint, ray: &LightRay) -> Option<f32> {
        let instance = &self.scene.instances[place.own as usize];
        let field = instance.field.as_deref()?;
        let (origin, direction) = ray_in_field(instance, false, place, ray);
        let enters = place.normal.dot(ray.direction.as_vec3()) < 0.0;
        let on_surface = FieldRay { origin: origin.as_vec3(), direction: direction.as_vec3() };
        field.chord(&on_surface, enters).map(|chord| chord.min(ray.t_max as f32))
    }

    /// The ray along which a length inside is measured; `None` if it misses the box of the surface.
    pub(crate) fn inside_ray(&self, place: &SurfacePoint, ray: &LightRay) -> Option<InsideRay> {
        let instance = &self.scene.instances[place.own as usize];
        let field = instance.field.as_deref()?;
        let enters = place.normal.dot(ray.direction.as_vec3()) < 0.0;
        let (origin, direction) = ray_in_field(instance, !enters, place, ray);
        let voxel = 1.0 / direction.length();
        let from = if enters { -BACK_VOXELS * voxel } else { 0.0 };
        let [lower, upper] = field.surface_bounds();
        let (enter, leave) = clip(origin, direction, lower, upper, from, ray.t_max)?;
        let end = (leave - enter) as f32;
        Some(InsideRay {
            ray: FieldRay { origin: (origin + enter * direction).as_vec3(), direction: direction.as_vec3() },
            end,
            pace: 1.0 / (instance.local_from_scene * ray.direction.as_vec3()).length(),
            least_step: (LEAST_VOXELS * voxel as f32).max(end / MOST_STEPS),
        })
    }
}

/// Length inside between two evaluations of a field; a crossing is interpolated linearly. The infinite distance before
/// the first evaluation counts as outside.
fn length_between(from: f32, distance_from: f32, to: f32, distance_to: f32) -> f32 {
    match (distance_from < 0.0, distance_to < 0.0) {
        (true, true) => to - from,
        (false, false) => 0.0,
        (false, true) if distance_from == f32::INFINITY => 0.0,
        (is_inside, _) => {
            let share = distance_from / (distance_from - distance_to);
            (to - from) * if is_inside { share } else { 1.0 - share }
        }
    }
}
