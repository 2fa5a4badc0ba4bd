//! The first surface on a ray of light, with its appearance.
//!
//! A ray finds the surfaces that cast shadows: the triangles of meshes, and the fields of all other objects.

use super::far_field::Split;
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::lit_surface::{BIAS_FIELD, BIAS_TRIANGLE};
use super::mesh_rays::is_skipped;
use super::occluder::ray_in_field;
use super::shadow::TracedScene;
use crate::bvh::rays::watertight::FaceHit;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::tree::Line;
use crate::scene::content::triangles::Triangles;
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
    /// The face of a mesh that was hit, 0 for objects without faces.
    pub face: u32,
    /// Index of its material in the scene's list.
    pub material: u32,
    /// Linear RGB of the reflected fraction; zero if the surface shows its colour without lighting.
    pub albedo: Vec3,
    /// Linear RGB that the surface emits to this side.
    pub emission: Vec3,
}

impl TracedScene<'_> {
    /// The first surface on a thin ray.
    pub(crate) fn first_surface(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> Option<LightHit> {
        let scene = self.scene;
        let mut ray = *ray;
        let mut nearest: Option<(u32, Hit)> = None;
        let line = Line::new(place.p.as_vec3(), ray.direction.as_vec3());
        scene.tree.walk(&line, ray.t_max as f32, |item, limit| {
            work.steps += 1;
            let instance = &scene.instances[item as usize];
            if let Some(triangles) = instance.casting_triangles() {
                let Some(hit) = scene.first_face(item, triangles, place, &ray) else { return limit };
                ray.t_max = hit.t;
                nearest = Some((item, Hit::Face(hit)));
                return past(hit.t);
            }
            if instance.shade < LEAST_OPACITY {
                return limit;
            }
            let before = ray;
            for occluder in self.occluders(item, place, &before, &Split::near(before.t_max)) {
                if let Some(hit) = self.hit_from(&occluder, place, &before, 0.0, work) {
                    ray.t_max = f64::from(hit.t);
                    nearest = Some((item, Hit::Field(hit)));
                    return hit.t;
                }
            }
            limit
        });
        work.count(false);
        match nearest? {
            (item, Hit::Face(hit)) => scene.face_hit(item, place, &ray, &hit),
            (item, Hit::Field(hit)) => scene.field_hit(item, place, &ray, &hit),
        }
    }
}

/// A hit of a ray.
enum Hit {
    Face(FaceHit),
    Field(FieldHit),
}

/// A limit in float32 that is at least the distance of a hit: boxes that begin at the hit are searched.
fn past(t: f64) -> f32 {
    (t as f32).next_up()
}

impl Scene {
    /// The first face of an instance on a thin ray that blocks at least [`LEAST_OPACITY`] of the light.
    fn first_face(&self, item: u32, triangles: &Triangles, place: &SurfacePoint, ray: &LightRay) -> Option<FaceHit> {
        let instance = &self.instances[item as usize];
        if is_skipped(item, triangles, place) || instance.face_shade.is_some_and(|shade| shade < LEAST_OPACITY) {
            return None;
        }
        triangles.mesh.first_hit(&self.ray_in_tree(item, place, ray, [0.0, ray.t_max]), |hit| {
            let opacity =
                || FaceAppearance::new(self, instance, triangles, hit.face, hit.weights).opacity(hit.is_front);
            instance.face_shade.is_some() || instance.opacity * opacity() >= LEAST_OPACITY
        })
    }

    /// A hit of a field. `ray` ends there.
    fn field_hit(&self, item: u32, place: &SurfacePoint, ray: &LightRay, hit: &FieldHit) -> Option<LightHit> {
        let instance = &self.instances[item as usize];
        let field = instance.field.as_deref()?;
        let (origin, direction) = ray_in_field(instance, item == place.own, place, ray);
        let appearance = field.appearance((origin + ray.t_max * direction).as_vec3(), hit, direction.as_vec3());
        let against = -ray.direction.as_vec3();
        let normal =
            if hit.at_start { against } else { (instance.scene_from_normal * appearance.normal).normalize_or(against) };
        let p = place.p + ray.t_max * ray.direction;
        let material = &self.materials[instance.first_material as usize];
        let (color, emission) = (field_color(instance, material, &appearance), field_emission(material));
        let place = SurfacePoint { p, normal, own: item, bias_voxels: BIAS_FIELD, lift: Vec3::ZERO, skips_own: false };
        Some(self.light_hit(ray, place, (0, instance.first_material), color, emission))
    }

    /// A hit of a face. `ray` ends there.
    fn face_hit(&self, item: u32, place: &SurfacePoint, ray: &LightRay, hit: &FaceHit) -> Option<LightHit> {
        let instance = &self.instances[item as usize];
        let triangles = instance.triangles.as_deref()?;
        let face = FaceAppearance::new(self, instance, triangles, hit.face, hit.weights);
        let footprint = || footprint(instance, ray);
        let emits = hit.is_front || face.material().two_sided;
        let emission = if emits { face.emission(footprint) } else { Vec3::ZERO };
        let place = SurfacePoint {
            p: place.p + ray.t_max * ray.direction,
            normal: face.normal_toward(ray.direction.as_vec3(), hit.is_front),
            own: item,
            bias_voxels: BIAS_TRIANGLE,
            lift: triangles.to_smooth_surface(hit.face, hit.weights, hit.is_front),
            skips_own: false,
        };
        let at = (hit.face, face.material_index());
        Some(self.light_hit(ray, place, at, face.color(footprint).truncate(), emission))
    }

    /// The hit at the end of a ray, on a face with a material.
    fn light_hit(
        &self,
        ray: &LightRay,
        place: SurfacePoint,
        (face, material): (u32, u32),
        color: Vec3,
        emission: Vec3,
    ) -> LightHit {
        let is_unlit = self.materials[material as usize].unlit;
        let (albedo, emission) = if is_unlit { (Vec3::ZERO, emission + color) } else { (color, emission) };
        LightHit { t: ray.t_max, place, face, material, albedo, emission }
    }
}

/// Side of the square over which textures are averaged, units of the mesh's tree.
fn footprint(instance: &Instance, ray: &LightRay) -> f64 {
    FOOTPRINT * ray.t_max * (instance.tree_from_scene.matrix3 * ray.direction).length()
}
