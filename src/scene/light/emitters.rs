//! The emissive faces of a scene as area lights: random points on them, and their density.

use super::light_hits::{LEAST_OPACITY, LightHit};
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::shadow::Casters;
use crate::error::Error;
use crate::memory::require_for;
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::material::Material;
use crate::scene::content::model::Scene;
use crate::scene::content::triangles::Triangles;
use crate::scene::visibility::appearance::FaceAppearance;
use glam::{DAffine3, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;

/// Relative distance within which a hit lies on a face.
const SAME_PLACE: f64 = 1e-4;

/// Number of faces between two checks of the progress: about a millisecond.
const BATCH: usize = 1 << 14;
/// Remedy for a table of faces that does not fit.
const ADVICE: &str = "emit light from fewer instances or faces, or leave out bounces=";

/// A face that emits light.
#[derive(Clone, Copy)]
struct Emitter {
    instance: u32,
    face: u32,
    /// Sum of area times brightness of this face and all before it, scene units.
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

/// A face in scene space: its first corner, the edges from there to the two others, and their cross product.
struct PlacedFace {
    corner: DVec3,
    edges: [DVec3; 2],
    cross: DVec3,
}

impl PlacedFace {
    fn new(triangles: &Triangles, face: u32, scene_from_tree: DAffine3) -> Self {
        let [a, b, c] = triangles.mesh.triangle(face).map(|p| scene_from_tree.transform_point3(p));
        Self { corner: a, edges: [b - a, c - a], cross: (b - a).cross(c - a) }
    }
}

impl Emitters {
    pub(crate) fn new(scene: &Scene, progress: &Progress) -> Result<Self, Error> {
        let mut batches = Vec::new();
        for (item, instance) in scene.instances.iter().enumerate() {
            progress.check()?;
            let Some(triangles) = emissive_mesh(scene, instance) else { continue };
            let count = triangles.mesh.faces().len();
            batches.extend((0..count).step_by(BATCH).map(|first| (item, first..count.min(first + BATCH))));
        }
        let count: usize = batches.iter().map(|(_, faces)| faces.len()).sum();
        let needed = (count * size_of::<Emitter>()) as u64;
        require_for(&format!("a table of {count} emissive faces"), needed, needed, ADVICE)?;

        let batches = batches
            .into_par_iter()
            .map(|(item, faces)| {
                progress.check()?;
                Ok(weights(scene, item, faces))
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let mut faces = batches.concat();
        let mut has_instance = vec![false; scene.instances.len()];
        let mut sum = 0.0;
        for face in &mut faces {
            has_instance[face.instance as usize] = true;
            sum += face.end;
            face.end = sum;
        }
        Ok(Self { faces, has_instance })
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
        let scene = casters.scene;
        let instance = &scene.instances[emitter.instance as usize];
        let Some(triangles) = instance.triangles.as_deref() else { return Vec3::ZERO };
        let scene_from_tree = instance.tree_from_scene.inverse();
        let placed = PlacedFace::new(triangles, emitter.face, scene_from_tree);
        // The normal of the side that emits.
        let normal = scene_from_tree.matrix3.determinant().signum() * placed.cross.normalize();
        let face = FaceAppearance::new(scene, instance, triangles, emitter.face, weights);
        let way = placed.corner + weights[1] * placed.edges[0] + weights[2] * placed.edges[1] - place.p;
        let t = way.length();
        let ray = LightRay { direction: way / t, t_max: t };
        let cosine = -normal.dot(ray.direction);
        let is_front = cosine > 0.0;
        let cosine = if face.material().two_sided { cosine.abs() } else { cosine };
        let arrives = density_of_direction(place, &ray);
        // A point at a distance of zero has no direction.
        if !(t > 0.0 && cosine > 0.0 && arrives > 0.0) {
            return Vec3::ZERO;
        }
        // The ray starts off its own surface.
        let lift = scene.lift(place) / cosine;
        let is_visible = casters
            .first_surface(place, &ray, work)
            .is_none_or(|hit| hit.place.own == emitter.instance && hit.t >= t - lift - SAME_PLACE * t);
        let opacity = instance.face_shade.unwrap_or_else(|| instance.opacity * face.opacity(is_front));
        if !is_visible || opacity < LEAST_OPACITY {
            return Vec3::ZERO;
        }
        let per_area = brightness(face.material()) / self.total();
        face.emission(|| 0.0) * balance(arrives, per_area * t * t / cosine)
    }
}

/// The mesh of an instance, if its faces may emit light.
fn emissive_mesh<'a>(scene: &Scene, instance: &'a Instance) -> Option<&'a Triangles> {
    let materials = instance.own_materials(&scene.materials);
    let emits = materials.iter().any(|material| brightness(material) > 0.0)
        && instance.face_shade.is_none_or(|shade| shade >= LEAST_OPACITY);
    instance.casting_triangles().filter(|_| emits)
}

/// The faces in a range that emit light. `end` of each is its own area times brightness.
fn weights(scene: &Scene, item: usize, faces: Range<usize>) -> Vec<Emitter> {
    let instance = &scene.instances[item];
    let Some(triangles) = instance.triangles.as_deref() else { return Vec::new() };
    let materials = instance.own_materials(&scene.materials);
    let scene_from_tree = instance.tree_from_scene.inverse();
    let emitter = |face: usize| {
        let brightness = brightness(&materials[triangles.material[face] as usize]);
        let end = 0.5 * PlacedFace::new(triangles, face as u32, scene_from_tree).cross.length() * brightness;
        (end > 0.0 && end.is_finite()).then_some(Emitter { instance: item as u32, face: face as u32, end })
    };
    faces.filter_map(emitter).collect()
}

/// Density of cosine-weighted directions along a ray, per steradian.
fn density_of_direction(place: &SurfacePoint, ray: &LightRay) -> f64 {
    place.normal.as_dvec3().dot(ray.direction) / PI
}

/// Weight of a technique with the density `own`, if another technique has the density `other`.
fn balance(own: f64, other: f64) -> f32 {
    (own / (own + other)) as f32
}
