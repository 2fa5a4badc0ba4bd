//! One occluder on a ray or cone to a light: where it is evaluated, in the space of its field.

use super::cone::ConeWalk;
use super::light_rays::{LightCone, LightRay, LightWork, SurfacePoint, widest};
use super::ray_bundle::is_clear;
use crate::geometry::{Aabb, clip};
use crate::scene::content::instance::Instance;
use crate::scene::fields::field::{Field, FieldHit, FieldRay};
use glam::DVec3;
use std::sync::atomic::{AtomicU32, Ordering};

/// One occluder on an interval of a ray: an instance or a level of the far field.
pub(crate) struct Occluder<'a> {
    pub instance: &'a Instance,
    pub field: &'a dyn Field,
    /// Its box, scene space.
    pub bounds: &'a Aabb,
    /// Interval in which it is evaluated, scene units.
    pub part: [f64; 2],
    /// Whether the start is on its own surface.
    pub is_own: bool,
    /// Length to skip if the interval begins inside the occluder, scene units; above zero only for the far field, see
    /// [`super::far_field`].
    pub skip: f64,
}

impl<'a> Occluder<'a> {
    /// The first hit of a ray in field space, at `from` or later. All positions are in scene units.
    pub(crate) fn hit_in_field(
        &self,
        (origin, direction): (DVec3, DVec3),
        from: f64,
        work: &mut LightWork,
    ) -> Option<FieldHit> {
        let [lower, upper] = self.field.surface_bounds();
        let mut first_hit = |from: f64| {
            let (enter, leave) = clip(origin, direction, lower, upper, from, self.part[1])?;
            let start = FieldRay { origin: (origin + enter * direction).as_vec3(), direction: direction.as_vec3() };
            let (hit, taken) = self.field.first_hit(&start, (leave - enter) as f32);
            work.steps += taken;
            hit.map(|hit| FieldHit { t: hit.t + enter as f32, ..hit })
        };
        match first_hit(from)? {
            hit if hit.at_start && self.skip > 0.0 => first_hit(self.part[0] + self.skip),
            hit => Some(hit),
        }
    }

    /// The interval of a cone of radius `slope t` in which the surface may come within `x_limit` radii of the axis.
    pub(crate) fn cone_walk(
        &self,
        LightCone { place, ray, slope }: LightCone<'_>,
        x_limit: f32,
    ) -> Option<ConeWalk<'a>> {
        let Occluder { instance, field, bounds, .. } = *self;
        let (origin, direction) = ray_in_field(instance, self.is_own, place, ray);
        let [lower, upper] = field.surface_bounds();
        // The box is enlarged by the radius of the cone at its far side; see `Line::cone`.
        let grown = instance.field_extent * widest(place, ray, slope * x_limit.max(0.0), bounds);
        let clip_from = |from: f64| clip(origin, direction, lower - grown, upper + grown, from, self.part[1]);
        let (mut enter, leave) = clip_from(self.part[0])?;
        if self.skip > 0.0 && field.distance((origin + enter * direction).as_vec3()) <= 0.0 {
            (enter, _) = clip_from(self.part[0] + self.skip)?;
        }
        Some(ConeWalk::new(field, instance, (origin, direction), [enter, leave], ray.direction, slope))
    }

    /// Whether a cone may touch the occluder, by the ball around its surface.
    pub(crate) fn may_intersect(&self, place: &SurfacePoint, ray: &LightRay, slope: f32) -> bool {
        let Occluder { instance, field, .. } = *self;
        let (origin, direction) = ray_in_field(instance, self.is_own, place, ray);
        let [lower, upper] = field.surface_bounds();
        // Under non-uniform scale a cone is widest where the scene is stretched least.
        let pace = 1.0 / (instance.local_from_scene * ray.direction.as_vec3()).length();
        let slope = slope * pace / instance.stretch[0];
        let direction = direction.normalize().as_vec3();
        !is_clear(origin.as_vec3(), direction, slope, 0.5 * (lower + upper), field.surface_radius())
    }
}

/// The instances that may block a light from neighbouring surfaces.
#[derive(Debug)]
pub(crate) struct NearList {
    /// Near instances first.
    items: Vec<u32>,
    /// The instance that blocked a ray last, which likely blocks the next one; `u32::MAX` before.
    last: AtomicU32,
}

impl NearList {
    /// `items` has near instances first.
    pub(crate) fn new(items: Vec<u32>) -> Self {
        Self { items, last: AtomicU32::new(u32::MAX) }
    }

    /// The instances in the order in which a ray visits them. The order has no effect on its result: the first one is
    /// visited early only if it blocked all of a ray, and all others keep their order.
    pub(crate) fn for_ray(&self) -> impl Iterator<Item = u32> {
        let last = self.last.load(Ordering::Relaxed);
        let first = Some(last).filter(|last| *last != u32::MAX);
        first.into_iter().chain(self.items.iter().copied().filter(move |item| *item != last))
    }

    /// The instances in the order in which a cone visits them: their results are added up in the order of the list.
    pub(crate) fn for_cone(&self) -> impl Iterator<Item = u32> {
        self.items.iter().copied()
    }

    /// Stores that an instance blocked all of a ray.
    pub(crate) fn set_last(&self, item: u32) {
        self.last.store(item, Ordering::Relaxed);
    }
}

/// Distance by which a ray in the field of the own instance starts off the surface, scene units.
pub(crate) fn bias(own: &Instance, place: &SurfacePoint) -> f32 {
    place.bias_voxels * (own.field_normal_from_scene * place.normal).length()
}

/// A ray in the field space of an instance. Its start is moved off the surface if the surface belongs to the instance.
pub(crate) fn ray_in_field(instance: &Instance, is_own: bool, place: &SurfacePoint, ray: &LightRay) -> (DVec3, DVec3) {
    let mut p = place.p;
    if is_own {
        p += (bias(instance, place) * place.normal).as_dvec3();
    }
    (instance.field_from_scene.transform_point3(p), instance.field_from_scene.matrix3 * ray.direction)
}
