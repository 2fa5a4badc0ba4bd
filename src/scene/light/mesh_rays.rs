//! Thin rays of light past the triangles of meshes.
//!
//! # Theory
//!
//! A distance field on a grid cannot represent objects thinner than a voxel. Rays to lights and paths of indirect light
//! therefore trace the triangles of every mesh in float64 ([`crate::bvh::rays::cast`]), so walls of any thickness block
//! them. Only cones evaluate the fields of meshes.
//!
//! A face blocks the fraction that its material blocks at the hit: all for an opaque face, all or nothing for a mask,
//! the opacity of the texture for a blend. A ray keeps the product of the transmitted fractions of its crossings. Faces
//! that a ray crosses at the same depth count once, as they do for the camera. A translucent solid of one opacity is
//! one layer, however many of its faces the ray crosses.
//!
//! *Start.* A ray starts off its own surface by a small fraction of the size of the mesh. A mesh with smooth normals
//! appears curved, but its faces are flat: rays from the faces would show them where the light grazes the surface. So
//! rays past the own mesh start on the smooth surface
//! ([`Triangles::to_smooth_surface`](crate::scene::content::triangles::Triangles::to_smooth_surface)). Rays past other
//! meshes start on the face, so that objects in contact have no gap. The picture of a mesh by its field starts them one
//! voxel off the field.
//!
//! # Practice
//!
//! Triangles are traced on the CPU for pictures of every device, so their shadows do not depend on it. Rays of
//! neighbouring surfaces, and the rays of one surface to an area light or over its hemisphere, are searched in packets
//! past each opaque mesh.

use super::far_field::Split;
use super::light_rays::{LightRay, LightWork, SurfacePoint};
use super::occluder::NearList;
use super::shadow::TracedScene;
use crate::bvh::rays::watertight;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::tree::{Line, Lines};
use crate::scene::content::triangles::Triangles;
use crate::scene::visibility::appearance::FaceAppearance;
use rayon::prelude::*;

/// Largest distance of a flat mesh from its plane, relative to its size: half the distance at which rays start off
/// their own surface. Float32 vertices of coplanar faces differ by an eighth of it.
const FLATNESS: f64 = 5e-7;

/// Distance of the start of a ray from its own surface, relative to the size of the mesh. Float32 vertices of coplanar
/// faces differ by a sixteenth of it.
const LIFT: f64 = 1e-6;

/// Largest distance of the start from the surface, relative to the lift of the mesh that is tested: a small mesh on a
/// wide floor lies within the lift of the floor.
const MOST_LIFTS: f64 = 64.0;

/// Difference of depths within which two crossings count as one, in scene units and relative.
const SAME_DEPTH: f64 = 1e-9;

/// Largest number of rays that are passed to a mesh together.
const MOST_RAYS: usize = 64;

/// Number of translucent crossings of one mesh that are compared by depth.
const CROSSINGS: usize = 16;

/// A thin ray of light from a surface, and the fraction of it that passes.
pub(crate) struct PlacedRay<'a> {
    place: &'a SurfacePoint,
    ray: LightRay,
    split: Split,
    pub share: f32,
    pub work: LightWork,
}

impl<'a> PlacedRay<'a> {
    /// A ray that nothing has blocked yet.
    pub(crate) fn new(traced: &TracedScene<'_>, place: &'a SurfacePoint, ray: LightRay) -> Self {
        let (split, work) = (traced.split(place, &ray, 0.0), LightWork { rays: 1, ..LightWork::default() });
        Self { place, ray, split, share: 1.0, work }
    }

    /// The part of the ray on which an instance is evaluated; None if there are two.
    fn part(&self, instance: &Instance) -> Option<[f64; 2]> {
        let mut parts = self.split.parts(instance, self.ray.t_max);
        parts.next().filter(|_| parts.next().is_none())
    }
}

impl TracedScene<'_> {
    /// Finds the fractions of rays near each other that pass some instances. All rays start on one instance. Without a
    /// far field the fractions equal the results of [`TracedScene::ray_share`], bit for bit.
    pub(crate) fn pass_rays(&self, near: &NearList, rays: &mut [PlacedRay<'_>]) {
        let mut lines = Lines::default();
        for PlacedRay { place, ray, .. } in &*rays {
            lines.push(&Line::new(place.p.as_vec3(), ray.direction.as_vec3()), ray.t_max as f32);
        }
        let mut tested = Vec::with_capacity(rays.len());
        for item in near.for_ray() {
            tested.clear();
            lines.touching(&self.scene.boxes[item as usize], &mut tested);
            self.pass_instance(item, rays, &tested);
            for i in tested.iter().copied().filter(|&i| rays[i].share <= 0.0) {
                near.set_last(item);
                lines.remove(i);
            }
        }
    }

    /// Multiplies the fractions of rays by the fractions that pass the far field.
    pub(crate) fn pass_far(&self, rays: &mut [PlacedRay<'_>]) {
        if self.far.is_none() {
            return;
        }
        for PlacedRay { place, ray, split, share, work } in rays {
            if split.far.is_some() && *share > 0.0 {
                work.far_rays += 1;
                if self.far_occluders(split, place, ray).any(|far| self.hit_of(&far, place, ray, work).is_some()) {
                    *share = 0.0;
                }
            }
        }
    }

    /// Multiplies the fractions of the `tested` rays by the fractions that pass an instance.
    fn pass_instance(&self, item: u32, rays: &mut [PlacedRay<'_>], tested: &[usize]) {
        let instance = &self.scene.instances[item as usize];
        let alone = |PlacedRay { place, ray, split, share, work }: &mut PlacedRay<'_>| {
            *share *= self.past_instance(item, place, ray, split, work);
        };
        let Some((triangles, shade)) = instance.casting_triangles().zip(instance.face_shade) else {
            return tested.iter().for_each(|&i| alone(&mut rays[i]));
        };
        if tested.first().is_none_or(|&i| is_skipped(item, triangles, rays[i].place)) {
            return;
        }
        let mut is_blocked = [false; MOST_RAYS];
        for tested in tested.chunks(MOST_RAYS) {
            if tested.iter().any(|&i| rays[i].part(instance).is_none()) {
                tested.iter().for_each(|&i| alone(&mut rays[i]));
                continue;
            }
            let in_tree = tested.iter().filter_map(|&i| {
                let ray = &rays[i];
                Some(self.scene.ray_in_tree(item, ray.place, &ray.ray, ray.part(instance)?))
            });
            triangles.mesh.are_occluded(in_tree, true, |k, found| is_blocked[k] = found);
            for (&i, is_blocked) in tested.iter().zip(is_blocked) {
                rays[i].work.steps += 1;
                rays[i].share *= if is_blocked { 1.0 - shade } else { 1.0 };
            }
        }
    }

    /// Sum of the fractions of rays from a place that pass some instances.
    pub(crate) fn sum_of_rays(
        &self,
        near: &NearList,
        place: &SurfacePoint,
        rays: impl Iterator<Item = LightRay>,
        work: &mut LightWork,
    ) -> f32 {
        let mut rays: Vec<PlacedRay<'_>> = rays.map(|ray| PlacedRay::new(self, place, ray)).collect();
        self.pass_rays(near, &mut rays);
        rays.iter().for_each(|ray| *work += ray.work);
        rays.iter().map(|ray| ray.share).sum()
    }

    /// Fraction of a thin ray that the triangles of an instance let pass.
    pub(crate) fn past_faces(
        &self,
        item: u32,
        triangles: &Triangles,
        place: &SurfacePoint,
        ray: &LightRay,
        split: &Split,
        work: &mut LightWork,
    ) -> f32 {
        if is_skipped(item, triangles, place) {
            return 1.0;
        }
        work.steps += 1;
        let mut share = 1.0;
        for part in split.parts(&self.scene.instances[item as usize], ray.t_max) {
            share *= self.scene.past_mesh(item, triangles, place, ray, part);
        }
        share
    }
}

/// Whether the triangles of an instance cannot block light from a place: it is the own instance, and flat or left out.
pub(crate) fn is_skipped(item: u32, triangles: &Triangles, place: &SurfacePoint) -> bool {
    item == place.own && (place.skips_own || triangles.is_flat(FLATNESS))
}

impl Scene {
    /// Builds what rays read of the meshes that block light. If a tree were built at the first ray, inside a parallel
    /// loop, a worker could wait for work that is queued behind its own.
    pub(crate) fn prepare_rays(&self) {
        let casting: Vec<&Triangles> = self.instances.iter().filter_map(Instance::casting_triangles).collect();
        for triangles in &casting {
            triangles.mesh.bvh();
            triangles.mesh.ray_packs();
        }
        casting.par_iter().for_each(|triangles| {
            triangles.is_flat(FLATNESS);
        });
        for item in self.instances.iter().filter(|instance| instance.is_sheet) {
            if let Some(triangles) = item.casting_triangles() {
                triangles.mesh.topology();
            }
        }
    }

    /// Fraction of a part of a ray that the triangles of an instance let pass.
    pub(crate) fn past_mesh(
        &self,
        item: u32,
        triangles: &Triangles,
        place: &SurfacePoint,
        ray: &LightRay,
        part: [f64; 2],
    ) -> f32 {
        let instance = &self.instances[item as usize];
        let in_tree = self.ray_in_tree(item, place, ray, part);
        if let Some(shade) = instance.face_shade {
            return if triangles.mesh.is_occluded(&in_tree) { 1.0 - shade } else { 1.0 };
        }
        let mut share = 1.0;
        let mut depths = [0.0; CROSSINGS];
        let mut crossings = 0;
        triangles.mesh.first_hit(&in_tree, |hit| {
            let opacity = instance.opacity
                * FaceAppearance::new(self, instance, triangles, hit.face, hit.weights).opacity(hit.is_front);
            let is_same = |depth: &f64| (hit.t - depth).abs() <= SAME_DEPTH * (1.0 + hit.t);
            if opacity > 0.0 && !depths[..crossings].iter().any(is_same) {
                share *= 1.0 - opacity;
                if crossings < CROSSINGS {
                    depths[crossings] = hit.t;
                    crossings += 1;
                }
            }
            share <= 0.0
        });
        share
    }

    /// A part of a ray in the space of the tree of an instance, from a start slightly off the ray's own surface, on the
    /// side to which the ray goes.
    pub(crate) fn ray_in_tree(
        &self,
        item: u32,
        place: &SurfacePoint,
        ray: &LightRay,
        [t_min, t_max]: [f64; 2],
    ) -> watertight::Ray {
        let instance = &self.instances[item as usize];
        let lift = self.lift(place.own, item);
        let normal = place.normal.as_dvec3();
        let start = place.p + lift.copysign(normal.dot(ray.direction)) * normal;
        let mut origin = instance.tree_from_scene.transform_point3(start);
        if item == place.own {
            origin += place.lift.as_dvec3();
        }
        watertight::Ray { origin, direction: instance.tree_from_scene.matrix3 * ray.direction, t_min, t_max }
    }

    /// Distance of the start of a ray past an instance from the own surface, scene units; 0 without triangles.
    pub(crate) fn lift(&self, own: u32, past: u32) -> f64 {
        let [own, past] = [own, past].map(|item| {
            let instance = &self.instances[item as usize];
            let triangles = instance.triangles.as_ref();
            triangles.map_or(0.0, |triangles| LIFT * triangles.mesh.scale() * f64::from(instance.stretch[1]))
        });
        own.min(MOST_LIFTS * past)
    }
}
