//! The shadow march of the article "Mesh Distance Field + Shadow" (Ale's blog, 2024), unchanged: for teaching, and as
//! the baseline of the bench.
//!
//! One loop over all instances with at most 100 steps each. A hit is a distance below 0.01. The start is moved 0.05
//! along the normal and 0.05 towards the light. All constants are in world units. Outside the grid it steps to the box
//! of the surface. [`super::shadow`] has the method of this crate.

use super::light_rays::{LightRay, LightWork, SurfacePoint};
use crate::scene::content::model::Scene;
use glam::Vec3;

const STEPS: u32 = 100;
const HIT_DISTANCE: f64 = 0.01;
const BIAS: f64 = 0.05;

impl Scene {
    /// 0 if the article's march finds an occluder before the light, else 1.
    pub fn article_share(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        let start = place.p + (BIAS * place.normal.as_dvec3() + BIAS * ray.direction) / self.scale;
        let is_shaded = |(item, instance): (usize, &crate::scene::content::instance::Instance)| {
            if place.skips_own && item == place.own as usize {
                return false;
            }
            let Some(field) = instance.field.as_deref().filter(|_| instance.casts_shadow) else { return false };
            let [lower, upper] = field.bounds();
            let [inner_lower, inner_upper] = field.surface_bounds();
            let pace = 1.0 / f64::from((instance.local_from_scene * ray.direction.as_vec3()).length());
            let mut t = 0.0;
            for _ in 0..STEPS {
                work.steps += 1;
                let p = instance.field_from_scene.transform_point3(start + t * ray.direction).as_vec3();
                let is_in_data = p.cmpge(lower).all() && p.cmple(upper).all();
                let local = if is_in_data {
                    field.distance(p)
                } else {
                    to_box(p, inner_lower, inner_upper) * (field.voxel() as f32)
                };
                t += f64::from(local) * pace;
                if t > ray.t_max {
                    return false;
                }
                if f64::from(local) < HIT_DISTANCE {
                    return true;
                }
            }
            false
        };
        if self.instances.iter().enumerate().any(is_shaded) { 0.0 } else { 1.0 }
    }
}

fn to_box(p: Vec3, lower: Vec3, upper: Vec3) -> f32 {
    p.distance(p.clamp(lower, upper))
}
