//! The emissive surfaces of a scene as area lights: random directions to them, and their density.
//!
//! # Theory
//!
//! A face of an emissive mesh is drawn in proportion to an estimate of its light at the place ([`tree`]), and a point
//! on it at random. A shape, a volume or a quadric has no faces. Its surface lies in a box, so points on the sides of
//! that box are drawn instead, and the object emits where the ray through the point hits it. From a place outside, at
//! most three sides face the place, and each ray into the box enters through one of them. Seen from the place at the
//! distance `d` from its centre, a side of the area `A` covers about `A cos / d^2`, so the sides are selected in
//! proportion to that. The density per steradian of a direction that enters through side `k` at the distance `t` is
//!
//! ```text
//!   p_k t^2 / (A_k cos)
//! ```
//!
//! Directions at random and directions to emitters are combined by the power heuristic (Veach and Guibas, *Optimally
//! combining sampling techniques for Monte Carlo rendering*, SIGGRAPH 1995): few directions at random hit a small
//! emitter, so the hits have little weight. No value exceeds the emission.

use super::light_hits::{LEAST_OPACITY, LightHit};
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::shadow::TracedScene;
use crate::error::Error;
use crate::geometry::morton_code;
use crate::memory::require_for;
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::material::Material;
use crate::scene::content::model::Scene;
use crate::scene::content::triangles::Triangles;
use crate::scene::fields::field::Field;
use crate::scene::visibility::appearance::{FaceAppearance, field_emission};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;
pub(crate) use tree::Cut;
use tree::{Bounds, EmitterTree};

mod tree;

/// Relative distance within which a hit lies on a face.
const SAME_PLACE: f64 = 1e-4;

/// Number of groups of emitters for each path. A group takes a hundredth of the time of a path.
const GROUPS_PER_PATH: usize = 16;
/// Largest number of groups, 2 MiB.
const MOST_GROUPS: usize = 1 << 16;

/// Number of faces between two checks of the progress: about a millisecond.
const BATCH: usize = 1 << 14;
/// Remedy for a table of faces that does not fit.
const ADVICE: &str = "emit light from fewer instances or faces, or leave out bounces=";

/// A face or an object without faces that emits light.
#[derive(Clone, Copy)]
struct Emitter {
    instance: u32,
    /// [`WHOLE`] for an object without faces.
    face: u32,
    /// Area times brightness, scene units.
    power: f64,
}

/// An emissive face after its key: the octant of its normal, and the position of its middle on a space-filling curve.
type SortedEmitter = (u64, Emitter);

/// Largest index of a cell of a space-filling curve along an axis.
const LAST_CELL: f64 = ((1 << 20) - 1) as f64;

/// Stands for the face of an object without faces.
const WHOLE: u32 = u32::MAX;

/// The emitters of an instance.
enum Lamp {
    Nothing,
    /// The position of each face in the list, [`WHOLE`] for a face that emits no light.
    Faces(Vec<u32>),
    /// An object in a box, and its position in the list.
    Boxed(Box<LampBox>, u32),
}

/// The emissive surfaces that cast shadows.
#[derive(Default)]
pub(crate) struct Emitters {
    list: Vec<Emitter>,
    tree: EmitterTree,
    /// One for each instance.
    lamps: Vec<Lamp>,
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

/// The box of an emissive object in scene space, in which it is a parallelepiped.
struct LampBox {
    corner: DVec3,
    edges: [DVec3; 3],
    /// Vectors across each pair of opposite sides, of the length of their area, along the edge between them.
    areas: [DVec3; 3],
}

/// The sides of a box that face a place.
struct FacingSides<'a> {
    of: &'a LampBox,
    /// For each pair of sides: the corner of the one that faces the place, its outward area vector, and the fraction of
    /// the directions that are drawn to it, which is 0 if none of the pair faces the place.
    sides: [(DVec3, DVec3, f64); 3],
}

impl LampBox {
    fn new(instance: &Instance, field: &dyn Field) -> Self {
        let [lower, upper] = field.surface_bounds().map(|corner| corner.as_dvec3());
        let scene_from_field = instance.field_from_scene.inverse();
        let m = scene_from_field.matrix3 * DMat3::from_diagonal(upper - lower);
        let edges = [m.x_axis, m.y_axis, m.z_axis];
        let areas = std::array::from_fn(|k| {
            let across = edges[(k + 1) % 3].cross(edges[(k + 2) % 3]);
            across * across.dot(edges[k]).signum()
        });
        Self { corner: scene_from_field.transform_point3(lower), edges, areas }
    }

    /// The area of three sides, no two of them opposite.
    fn area(&self) -> f64 {
        self.areas.iter().map(|area| area.length()).sum()
    }

    /// The sides that face a place; None if the place is inside.
    fn facing(&self, p: DVec3) -> Option<FacingSides<'_>> {
        let mut sides = std::array::from_fn(|k| {
            let (corner, area) = (self.corner, self.areas[k]);
            let (corner, area) = if (p - corner).dot(area) > area.dot(self.edges[k]) {
                (corner + self.edges[k], area)
            } else {
                (corner, -area)
            };
            let height = (p - corner).dot(area);
            let middle = corner + 0.5 * (self.edges[(k + 1) % 3] + self.edges[(k + 2) % 3]);
            let angle = height / (middle - p).length().powi(3);
            (corner, area, if height > 0.0 { angle.min(2.0 * PI) } else { 0.0 })
        });
        let total: f64 = sides.iter().map(|(.., angle)| angle).sum();
        sides.iter_mut().for_each(|(.., angle)| *angle /= total);
        (total > 0.0 && total.is_finite()).then_some(FacingSides { of: self, sides })
    }
}

impl FacingSides<'_> {
    /// A unit direction from the place into the box. The two values of `at`, from 0 to 1, select it.
    fn direction(&self, p: DVec3, at: [f64; 2]) -> DVec3 {
        let (mut k, mut start) = (0, 0.0);
        while k < 2 && at[0] >= start + self.sides[k].2 {
            start += self.sides[k].2;
            k += 1;
        }
        let (corner, _, share) = self.sides[k];
        let along = if share > 0.0 { ((at[0] - start) / share).clamp(0.0, 1.0) } else { 0.5 };
        let point = corner + along * self.of.edges[(k + 1) % 3] + at[1] * self.of.edges[(k + 2) % 3];
        (point - p).normalize()
    }

    /// Density of a unit direction from the place that enters the box, per steradian.
    fn density(&self, p: DVec3, direction: DVec3) -> f64 {
        // The ray enters through the last of the planes that it crosses from outside.
        let crossing = |(corner, area, share): &(DVec3, DVec3, f64)| {
            let toward = -area.dot(direction);
            let t = (p - *corner).dot(*area) / toward;
            (*share > 0.0 && toward > 0.0).then(|| (t, share * t * t / toward))
        };
        self.sides.iter().filter_map(crossing).max_by(|a, b| a.0.total_cmp(&b.0)).map_or(0.0, |(_, density)| density)
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
        let per_face = size_of::<Emitter>() + size_of::<SortedEmitter>() + size_of::<u32>();
        let needed = (count * per_face + EmitterTree::bytes(count)) as u64;
        require_for(&format!("a table of {count} emissive faces"), needed, needed, ADVICE)?;

        let batches = batches
            .into_par_iter()
            .map(|(item, faces)| {
                progress.check()?;
                Ok(weights(scene, item, faces))
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let mut sorted = batches.concat();
        sorted.par_sort_unstable_by_key(|(key, emitter)| (emitter.instance, *key, emitter.face));
        let mut list: Vec<Emitter> = sorted.into_iter().map(|(_, emitter)| emitter).collect();
        let mut lamps: Vec<Lamp> = scene.instances.iter().map(|_| Lamp::Nothing).collect();
        for own in list.chunk_by(|a, b| a.instance == b.instance) {
            let item = own[0].instance as usize;
            let faces = scene.instances[item].triangles.as_deref().map_or(0, |triangles| triangles.mesh.faces().len());
            lamps[item] = Lamp::Faces(vec![WHOLE; faces]);
        }
        for (position, face) in (0..).zip(&list) {
            if let Lamp::Faces(positions) = &mut lamps[face.instance as usize] {
                positions[face.face as usize] = position;
            }
        }
        for (item, instance) in scene.instances.iter().enumerate() {
            let Some((field, brightness)) = emissive_object(scene, instance) else { continue };
            let around = LampBox::new(instance, field);
            let power = around.area() * brightness;
            if power > 0.0 && power.is_finite() {
                lamps[item] = Lamp::Boxed(Box::new(around), list.len() as u32);
                list.push(Emitter { instance: item as u32, face: WHOLE, power });
            }
        }
        let tree = EmitterTree::new(list.len(), |i| bounds(scene, &lamps, &list[i]), progress)?;
        Ok(Self { list, tree, lamps })
    }

    /// The emitters in groups, by their light at a place, from which the directions of this number of paths are drawn.
    pub(crate) fn cut(&self, place: &SurfacePoint, paths: u32) -> Option<Cut> {
        self.tree.cut(place.p, place.normal.as_dvec3(), (GROUPS_PER_PATH * paths as usize).min(MOST_GROUPS))
    }

    /// Whether a ray may hit an emitter.
    pub(crate) fn may_be_hit(&self, place: &SurfacePoint, direction: DVec3) -> bool {
        self.tree.may_be_hit(place.p, direction)
    }

    /// Whether directions are drawn to all surfaces of a scene that emit light.
    pub(crate) fn are_all(&self, scene: &Scene) -> bool {
        scene.instances.iter().zip(&self.lamps).all(|(instance, lamp)| {
            let mut own = instance.own_materials(&scene.materials).iter();
            !matches!(lamp, Lamp::Nothing) || own.all(|own| !own.unlit && own.emission == [0.0; 3])
        }) && scene.materials.iter().all(|material| !material.unlit)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// The probability that a place draws the emitter at a position in the list.
    fn probability(&self, emitter: u32, place: &SurfacePoint, cut: Option<&Cut>) -> f64 {
        self.tree.probability(cut, emitter as usize, place.p, place.normal.as_dvec3())
    }

    /// Weight of the emission of a hit that a path found by a cosine-weighted direction. Points drawn on the emitters
    /// have the rest of the weight, see [`Self::light`].
    pub(crate) fn share_of_direction(
        &self,
        scene: &Scene,
        place: &SurfacePoint,
        cut: Option<&Cut>,
        ray: &LightRay,
        hit: &LightHit,
    ) -> f32 {
        let drawn = match &self.lamps[hit.place.own as usize] {
            Lamp::Nothing => return 1.0,
            Lamp::Faces(positions) => {
                let instance = &scene.instances[hit.place.own as usize];
                let (Some(triangles), Some(&position)) =
                    (instance.triangles.as_deref(), positions.get(hit.face as usize).filter(|&&at| at != WHOLE))
                else {
                    return 1.0;
                };
                let cross = PlacedFace::new(triangles, hit.face, instance.tree_from_scene.inverse()).cross;
                let cosine = cross.normalize().dot(ray.direction).abs();
                let power = self.list[position as usize].power;
                let per_area = brightness(&scene.materials[hit.material as usize]) / power
                    * self.probability(position, place, cut);
                per_area * hit.t * hit.t / cosine.max(f64::MIN_POSITIVE)
            }
            Lamp::Boxed(around, position) => {
                let Some(sides) = around.facing(place.p) else { return 1.0 };
                let share = self.probability(*position, place, cut);
                share * sides.density(place.p, ray.direction)
            }
        };
        weight_of_direction(density_of_direction(place, ray), drawn)
    }

    /// The light of one direction to the emitters that a white surface reflects, RGB. The two values of `at`, from 0 to
    /// 1, select the direction.
    pub(crate) fn light(
        &self,
        traced: &TracedScene<'_>,
        place: &SurfacePoint,
        cut: Option<&Cut>,
        at: [f64; 2],
        work: &mut LightWork,
    ) -> Vec3 {
        let (p, normal) = (place.p, place.normal.as_dvec3());
        let Some((drawn, probability, along)) = self.tree.draw(cut, p, normal, at[0]) else {
            return Vec3::ZERO;
        };
        let emitter = &self.list[drawn];
        if let Lamp::Boxed(around, _) = &self.lamps[emitter.instance as usize] {
            return light_of_object(traced, place, emitter.instance, (around, probability), [along, at[1]], work);
        }
        let u = along.sqrt();
        let weights = [1.0 - u, u * (1.0 - at[1]), u * at[1]];
        let scene = traced.scene;
        let instance = &scene.instances[emitter.instance as usize];
        let Some(triangles) = instance.triangles.as_deref() else { return Vec3::ZERO };
        let scene_from_tree = instance.tree_from_scene.inverse();
        let placed = PlacedFace::new(triangles, emitter.face, scene_from_tree);
        // The normal of the side that emits.
        let normal = scene_from_tree.matrix3.determinant().signum() * placed.cross.normalize();
        let face = FaceAppearance::new(scene, instance, triangles, emitter.face, weights);
        let to_point = placed.corner + weights[1] * placed.edges[0] + weights[2] * placed.edges[1] - place.p;
        let t = to_point.length();
        let ray = LightRay { direction: to_point / t, t_max: t };
        let cosine = -normal.dot(ray.direction);
        let is_front = cosine > 0.0;
        let cosine = if face.material().two_sided { cosine.abs() } else { cosine };
        let arrives = density_of_direction(place, &ray);
        // A point at a distance of zero has no direction.
        if !(t > 0.0 && cosine > 0.0 && arrives > 0.0) {
            return Vec3::ZERO;
        }
        // The ray starts off its own surface.
        let lift = scene.lift(place.own, emitter.instance) / cosine;
        let is_visible = traced
            .first_surface(place, &ray, work)
            .is_none_or(|hit| hit.place.own == emitter.instance && hit.t >= t - lift - SAME_PLACE * t);
        let opacity = instance.face_shade.unwrap_or_else(|| instance.opacity * face.opacity(is_front));
        if !is_visible || opacity < LEAST_OPACITY {
            return Vec3::ZERO;
        }
        let per_area = brightness(face.material()) / emitter.power * probability;
        face.emission(|| 0.0) * weight_of_drawn(arrives, per_area * t * t / cosine)
    }
}

/// The light of a direction into the box of an object that a white surface reflects, RGB; see [`Emitters::light`].
fn light_of_object(
    traced: &TracedScene<'_>,
    place: &SurfacePoint,
    item: u32,
    (around, share): (&LampBox, f64),
    at: [f64; 2],
    work: &mut LightWork,
) -> Vec3 {
    let Some(sides) = around.facing(place.p) else { return Vec3::ZERO };
    let ray = LightRay { direction: sides.direction(place.p, at), t_max: f64::INFINITY };
    let arrives = density_of_direction(place, &ray);
    if arrives <= 0.0 {
        return Vec3::ZERO;
    }
    match traced.first_surface(place, &ray, work).filter(|hit| hit.place.own == item) {
        Some(hit) => hit.emission * weight_of_drawn(arrives, share * sides.density(place.p, ray.direction)),
        None => Vec3::ZERO,
    }
}

/// The field and the brightness of an object without faces that emits light.
fn emissive_object<'a>(scene: &Scene, instance: &'a Instance) -> Option<(&'a dyn Field, f64)> {
    let material = &scene.materials[instance.first_material as usize];
    let brightness = if field_emission(material) == Vec3::ZERO { 0.0 } else { brightness(material) };
    let is_found = instance.triangles.is_none() && instance.casts_shadow && instance.shade >= LEAST_OPACITY;
    instance.field.as_deref().filter(|_| is_found && brightness > 0.0).map(|field| (field, brightness))
}

/// The mesh of an instance, if its faces may emit light.
fn emissive_mesh<'a>(scene: &Scene, instance: &'a Instance) -> Option<&'a Triangles> {
    let materials = instance.own_materials(&scene.materials);
    let emits = materials.iter().any(|material| brightness(material) > 0.0)
        && instance.face_shade.is_none_or(|shade| shade >= LEAST_OPACITY);
    instance.casting_triangles().filter(|_| emits)
}

/// The position on a space-filling curve through a box.
fn code_in_box(p: DVec3, [lower, upper]: [DVec3; 2]) -> u64 {
    let cell = (p - lower) * (LAST_CELL / (upper - lower).max(DVec3::splat(f64::MIN_POSITIVE)));
    // Casting saturates.
    morton_code(cell.to_array().map(|x| x as u64))
}

/// The faces in a range that emit light.
fn weights(scene: &Scene, item: usize, faces: Range<usize>) -> Vec<SortedEmitter> {
    let instance = &scene.instances[item];
    let Some(triangles) = instance.triangles.as_deref() else { return Vec::new() };
    let materials = instance.own_materials(&scene.materials);
    let scene_from_tree = instance.tree_from_scene.inverse();
    let [lower, upper] = triangles.mesh.bounds().map(|corner| triangles.mesh.local_from_world(corner));
    let emitter = |face: usize| {
        let brightness = brightness(&materials[triangles.material[face] as usize]);
        let cross = PlacedFace::new(triangles, face as u32, scene_from_tree).cross;
        let power = 0.5 * cross.length() * brightness;
        let middle = triangles.mesh.triangle(face as u32).iter().sum::<DVec3>() / 3.0;
        let octant = cross.to_array().iter().enumerate().fold(0, |bits, (i, x)| bits | u64::from(*x < 0.0) << i);
        let key = octant << 60 | code_in_box(middle, [lower, upper]);
        (power > 0.0 && power.is_finite()).then_some((key, Emitter { instance: item as u32, face: face as u32, power }))
    };
    faces.filter_map(emitter).collect()
}

/// The bounds of an emitter in scene space.
fn bounds(scene: &Scene, lamps: &[Lamp], emitter: &Emitter) -> Bounds {
    let instance = &scene.instances[emitter.instance as usize];
    if let Lamp::Boxed(around, _) = &lamps[emitter.instance as usize] {
        let [a, b, c] = around.edges;
        let corners = [DVec3::ZERO, a, b, c, a + b, a + c, b + c, a + b + c].map(|corner| around.corner + corner);
        return Bounds::new(corners, None, false, emitter.power);
    }
    // Every other emitter is a face of a mesh.
    let Some(triangles) = instance.triangles.as_deref() else { return Bounds::new([], None, false, 0.0) };
    let scene_from_tree = instance.tree_from_scene.inverse();
    let PlacedFace { corner, edges, cross } = PlacedFace::new(triangles, emitter.face, scene_from_tree);
    let normal = scene_from_tree.matrix3.determinant().signum() * cross.normalize();
    let material = &instance.own_materials(&scene.materials)[triangles.material[emitter.face as usize] as usize];
    Bounds::new([corner, corner + edges[0], corner + edges[1]], Some(normal), material.two_sided, emitter.power)
}

/// Density of cosine-weighted directions along a ray, per steradian.
fn density_of_direction(place: &SurfacePoint, ray: &LightRay) -> f64 {
    place.normal.as_dvec3().dot(ray.direction) / PI
}

/// Weight of a direction by its cosine, if directions to the emitters have the density `drawn` along it.
fn weight_of_direction(direction: f64, drawn: f64) -> f32 {
    // A direction in the tangent plane has the density 0.
    let ratio = drawn / direction.max(f64::MIN_POSITIVE);
    (1.0 + ratio * ratio).recip() as f32
}

/// Weight of a direction to the emitters, divided by its density, in units of the density `direction` of directions by
/// their cosine. It is at most 1/2.
fn weight_of_drawn(direction: f64, drawn: f64) -> f32 {
    let ratio = drawn / direction;
    (ratio + ratio.recip()).recip() as f32
}
