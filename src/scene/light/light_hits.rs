//! The first surface on a ray of light, with its appearance.
//!
//! A ray finds the surfaces that cast shadows: fields, and the triangles of sheets. The colours of a mesh are those of
//! the face that is nearest to the hit of its field.

use super::far_field::Split;
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::lit_surface::{BIAS_FIELD, BIAS_TRIANGLE};
use super::occluder::ray_in_field;
use super::shadow::Casters;
use crate::bvh::rays::watertight::FaceHit;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::tree::Line;
use crate::scene::fields::field::FieldHit;
use crate::scene::visibility::appearance::{FaceAppearance, field_color, field_emission};
use glam::Vec3;

/// Smallest fraction of the light that a surface on a ray blocks. Rays pass more translucent surfaces.
pub(crate) const LEAST_OPACITY: f32 = 0.5;

/// Side of the square over which a texture is averaged, relative to the length of the ray.
const FOOTPRINT: f64 = 0.1;

/// A surface that a ray of light hits.
pub(crate) struct LightHit {
    /// Length of the ray, scene units.
    pub t: f64,
    /// The surface as the start of other rays; its normal is on the side that was hit.
    pub place: SurfacePoint,
    /// Index of its material in the scene's list.
    pub material: u32,
    /// Linear RGB of the reflected fraction; zero if the surface shows its colour without lighting.
    pub albedo: Vec3,
    /// Linear RGB that the surface emits to this side.
    pub emission: Vec3,
}

impl Casters<'_> {
    /// The first surface on a thin ray.
    pub(crate) fn first_surface(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> Option<LightHit> {
        let scene = self.scene;
        let face = scene.first_face(place, ray, work);
        let mut ray = LightRay { t_max: face.map_or(ray.t_max, |(_, hit)| hit.t), ..*ray };
        let mut solid: Option<(u32, FieldHit)> = None;
        let line = Line::new(place.p.as_vec3(), ray.direction.as_vec3());
        scene.tree.walk(&line, ray.t_max as f32, |item, limit| {
            work.steps += 1;
            if scene.instances[item as usize].shade < LEAST_OPACITY {
                return limit;
            }
            let before = ray;
            for caster in self.casters(item, place, &before, &Split::near(before.t_max)) {
                if let Some(hit) = self.hit_from(&caster, place, &before, 0.0, work) {
                    ray.t_max = f64::from(hit.t);
                    solid = Some((item, hit));
                    return hit.t;
                }
            }
            limit
        });
        work.count(false);
        match (solid, face) {
            (Some((item, hit)), _) => scene.solid_hit(item, place, &ray, &hit),
            (None, Some((item, hit))) => scene.sheet_hit(item, place, &ray, &hit),
            (None, None) => None,
        }
    }
}

impl Scene {
    /// A hit of a field. `ray` ends there.
    fn solid_hit(&self, item: u32, place: &SurfacePoint, ray: &LightRay, hit: &FieldHit) -> Option<LightHit> {
        let instance = &self.instances[item as usize];
        let field = instance.field.as_deref()?;
        let (origin, direction) = ray_in_field(instance, item == place.own, place, ray);
        let look = field.appearance((origin + ray.t_max * direction).as_vec3(), hit, direction.as_vec3());
        let against = -ray.direction.as_vec3();
        let normal =
            if hit.at_start { against } else { (instance.scene_from_normal * look.normal).normalize_or(against) };
        let p = place.p + ray.t_max * ray.direction;
        let (material, color, emission) = match &instance.triangles {
            Some(triangles) => {
                let nearest = triangles.mesh.closest_point(instance.tree_from_scene.transform_point3(p));
                let face = FaceAppearance::new(self, instance, triangles, nearest.face, nearest.on_triangle.weights);
                let footprint = || footprint(instance, ray);
                (face.material_index(), face.color(footprint).truncate(), face.emission(footprint))
            }
            None => {
                let material = &self.materials[instance.first_material as usize];
                (instance.first_material, field_color(instance, material, &look), field_emission(material))
            }
        };
        let place = SurfacePoint { p, normal, own: item, bias_voxels: BIAS_FIELD, skips_own: false };
        Some(self.light_hit(ray, place, material, color, emission))
    }

    /// A hit of the face of a sheet. `ray` ends there.
    fn sheet_hit(&self, item: u32, place: &SurfacePoint, ray: &LightRay, hit: &FaceHit) -> Option<LightHit> {
        let instance = &self.instances[item as usize];
        let face = FaceAppearance::new(self, instance, instance.triangles.as_deref()?, hit.face, hit.weights);
        let footprint = || footprint(instance, ray);
        let emits = hit.is_front || face.material().two_sided;
        let emission = if emits { face.emission(footprint) } else { Vec3::ZERO };
        let place = SurfacePoint {
            p: place.p + ray.t_max * ray.direction,
            normal: face.normal_toward(ray.direction.as_vec3(), hit.is_front),
            own: item,
            bias_voxels: BIAS_TRIANGLE,
            skips_own: false,
        };
        Some(self.light_hit(ray, place, face.material_index(), face.color(footprint).truncate(), emission))
    }

    fn light_hit(&self, ray: &LightRay, place: SurfacePoint, material: u32, color: Vec3, emission: Vec3) -> LightHit {
        let is_unlit = self.materials[material as usize].unlit;
        let (albedo, emission) = if is_unlit { (Vec3::ZERO, emission + color) } else { (color, emission) };
        LightHit { t: ray.t_max, place, material, albedo, emission }
    }
}

/// Side of the square over which textures are averaged, units of the mesh's tree.
fn footprint(instance: &Instance, ray: &LightRay) -> f64 {
    FOOTPRINT * ray.t_max * (instance.tree_from_scene.matrix3 * ray.direction).length()
}
