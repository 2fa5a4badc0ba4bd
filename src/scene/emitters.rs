//! The emissive faces of a scene as area lights: random points on them, and their density.

use super::face_look::FaceLook;
use super::light_hits::{LEAST_OPACITY, LightHit};
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::shadow::Casters;
use super::{Instance, Material, Scene};
use glam::{DVec3, Vec3};
use std::f64::consts::PI;

/// Distance between a face and the surface of its field, voxels: with a margin for the trilinear interpolation.
const FIELD_VOXELS: f64 = 3.0;
/// Relative distance within which a hit lies on a face.
const SAME_PLACE: f64 = 1e-4;
/// Smallest cosine by which the distance from a field is converted to one along a ray.
const LEAST_COSINE: f64 = 0.1;

/// A face that emits light, scene units.
struct Emitter {
    instance: u32,
    face: u32,
    corner: DVec3,
    edges: [DVec3; 2],
    /// Unit normal of the side that emits.
    normal: DVec3,
    is_two_sided: bool,
    /// Sum of area times brightness of this face and all before it.
    end: f64,
}

/// The emissive faces of meshes that cast shadows. Points on them are drawn in proportion to area and brightness.
#[derive(Default)]
pub(crate) struct Emitters {
    faces: Vec<Emitter>,
    /// Whether the faces of each instance are among them.
    has_instance: Vec<bool>,
}

/// Brightness of a material by its factor of emission: the mean of the channels.
fn brightness(material: &Material) -> f64 {
    if material.unlit { 0.0 } else { f64::from(Vec3::from_array(material.emission).element_sum()) / 3.0 }
}

impl Emitters {
    pub(crate) fn new(scene: &Scene) -> Self {
        let mut emitters = Self { faces: Vec::new(), has_instance: vec![false; scene.instances.len()] };
        let mut end = 0.0;
        for (item, instance) in scene.instances.iter().enumerate() {
            let materials = instance.own_materials(&scene.materials);
            let emits = blocks_light(instance) && materials.iter().any(|material| brightness(material) > 0.0);
            let Some(triangles) = instance.triangles.as_ref().filter(|_| emits) else { continue };
            // The normals of a solid must point outwards. The light of others is found by directions alone.
            if !instance.is_sheet && triangles.mesh.topology().has_reversed_body(&triangles.mesh) {
                continue;
            }
            let scene_from_tree = instance.tree_from_scene.inverse();
            let side = scene_from_tree.matrix3.determinant().signum();
            for face in 0..triangles.mesh.faces().len() as u32 {
                let material = &materials[triangles.material[face as usize] as usize];
                let brightness = brightness(material);
                let [a, b, c] = triangles.mesh.triangle(face).map(|p| scene_from_tree.transform_point3(p));
                let cross = (b - a).cross(c - a);
                let weight = 0.5 * cross.length() * brightness;
                if weight > 0.0 && weight.is_finite() {
                    end += weight;
                    emitters.faces.push(Emitter {
                        instance: item as u32,
                        face,
                        corner: a,
                        edges: [b - a, c - a],
                        normal: side * cross.normalize(),
                        is_two_sided: material.two_sided && instance.is_sheet,
                        end,
                    });
                    emitters.has_instance[item] = true;
                }
            }
        }
        emitters
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.faces.is_empty()
    }

    fn total(&self) -> f64 {
        self.faces.last().map_or(0.0, |face| face.end)
    }

    /// Weight of the emission of a hit that a path found by a cosine-weighted direction. Points drawn on the emitters
    /// have the rest of the weight, see [`Self::light`].
    pub(crate) fn share_of_direction(
        &self,
        scene: &Scene,
        place: &SurfacePoint,
        ray: &LightRay,
        hit: &LightHit,
    ) -> f32 {
        if !self.has_instance[hit.place.own as usize] {
            return 1.0;
        }
        let per_area = brightness(&scene.materials[hit.material as usize]) / self.total();
        let cosine = -hit.place.normal.as_dvec3().dot(ray.direction);
        balance(density_of_direction(place, ray), per_area * hit.t * hit.t / cosine.max(f64::MIN_POSITIVE))
    }

    /// The light of one point on the emitters that a white surface reflects, RGB. The two values of `at`, from 0 to 1,
    /// select the point.
    ///
    /// Directions and points are combined by the balance heuristic (Veach and Guibas, *Optimally combining sampling
    /// techniques for Monte Carlo rendering*, SIGGRAPH 1995). No value exceeds the emission.
    pub(crate) fn light(
        &self,
        casters: &Casters<'_>,
        place: &SurfacePoint,
        at: [f64; 2],
        work: &mut LightWork,
    ) -> Vec3 {
        let target = at[0] * self.total();
        let i = self.faces.partition_point(|face| face.end <= target).min(self.faces.len() - 1);
        let emitter = &self.faces[i];
        let start = if i == 0 { 0.0 } else { self.faces[i - 1].end };
        let u = ((target - start) / (emitter.end - start)).clamp(0.0, 1.0).sqrt();
        let weights = [1.0 - u, u * (1.0 - at[1]), u * at[1]];
        let way = emitter.corner + weights[1] * emitter.edges[0] + weights[2] * emitter.edges[1] - place.p;
        let t = way.length();
        let ray = LightRay { direction: way / t, t_max: t };
        let cosine = -emitter.normal.dot(ray.direction);
        let is_front = cosine > 0.0;
        let cosine = if emitter.is_two_sided { cosine.abs() } else { cosine };
        let arrives = density_of_direction(place, &ray);
        // A point at a distance of zero has no direction.
        if !(t > 0.0 && cosine > 0.0 && arrives > 0.0) {
            return Vec3::ZERO;
        }
        let scene = casters.scene;
        let instance = &scene.instances[emitter.instance as usize];
        let voxel = f64::from((instance.field_normal_from_scene * emitter.normal.as_vec3()).length());
        let off_field = if instance.is_sheet { 0.0 } else { FIELD_VOXELS * voxel / cosine.max(LEAST_COSINE) };
        // Rays to sheets start off the surface.
        let lift = scene.lift(place) / cosine;
        let is_visible = casters
            .first_surface(place, &ray, work)
            .is_none_or(|hit| hit.place.own == emitter.instance && hit.t >= t - lift - off_field.max(SAME_PLACE * t));
        let Some(triangles) = instance.triangles.as_deref().filter(|_| is_visible) else { return Vec3::ZERO };
        let face = FaceLook::new(scene, instance, triangles, emitter.face, weights);
        if instance.is_sheet && instance.opacity * face.opacity(is_front) < LEAST_OPACITY {
            return Vec3::ZERO;
        }
        let per_area = brightness(face.material()) / self.total();
        face.emission(|| 0.0) * balance(arrives, per_area * t * t / cosine)
    }
}

/// Whether rays of light find an instance.
fn blocks_light(instance: &Instance) -> bool {
    instance.casts_shadow && (instance.is_sheet || instance.field.is_some() && instance.shade >= LEAST_OPACITY)
}

/// Density of cosine-weighted directions along a ray, per steradian.
fn density_of_direction(place: &SurfacePoint, ray: &LightRay) -> f64 {
    place.normal.as_dvec3().dot(ray.direction) / PI
}

/// Weight of a technique with the density `own`, if another technique has the density `other`.
fn balance(own: f64, other: f64) -> f32 {
    (own / (own + other)) as f32
}
