//! Occlusion by sheets: open, flat and alpha-textured meshes, whose triangles are intersected by rays.
//!
//! # Theory
//!
//! A distance field on a grid cannot represent objects thinner than a voxel, and a thicker sheet shades itself. Light
//! and occlusion therefore trace the triangles of a sheet in float64 ([`crate::bvh::rays::cast`]), with the opacity of
//! the material at each hit: 1 for opaque faces, 0 or 1 for a mask, the texture's for a blend. A ray keeps the product
//! of the transmitted fractions of its crossings. Faces that a ray crosses at the same depth count once, as they do for
//! the camera.
//!
//! A cone is sampled by [`CONE_RAYS`] rays spread evenly over its section, and a light's disc by [`PARTS`] such cones.
//! Before that, [`RIM_RAYS`] rays on the rim and [`PROBE_RAYS`] inside it decide discs that are completely lit or dark:
//! a straight edge between two rim rays covers less than 0.3 % of the disc.
//!
//! Sheets and fields are independent factors of a cone's fraction: the fractions of the same part of a disc are
//! multiplied.
//!
//! # Practice
//!
//! Sheets are evaluated on the CPU for pictures of every device, so their shadows do not depend on it.

use super::light_hits::LEAST_OPACITY;
use super::light_rays::{LightRay, LightWork, PARTS, SurfacePoint, basis, disc_point, toward};
use super::lit_surface::{Lights, LitSurface};
use super::occlusion::AO_SLOPE;
use crate::bvh::rays::watertight;
use crate::bvh::rays::watertight::FaceHit;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::options::{RenderOptions, SceneShadows};
use crate::scene::content::sheets::Sheets;
use crate::scene::content::tree::Line;
use crate::scene::visibility::appearance::FaceAppearance;
use glam::{DVec3, Vec2};

/// Number of rays of a cone. A light's disc has [`PARTS`] cones, so 64 rays.
const CONE_RAYS: u32 = 4;

/// Number of rays on the rim of a disc that test whether it is completely lit or dark.
const RIM_RAYS: u32 = 16;
/// Number of rays inside the disc for the same test.
const PROBE_RAYS: u32 = 8;

/// Distance of the start of a ray from its own surface, relative to the size of the mesh. Float32 vertices of coplanar
/// faces differ by a sixteenth of it.
const LIFT: f64 = 1e-6;

/// Difference of depths within which two crossings count as one, in scene units and relative.
const SAME_DEPTH: f64 = 1e-9;

/// Number of translucent crossings of one mesh that are compared by depth.
const CROSSINGS: usize = 16;

impl Sheets {
    /// The sheets whose boxes a cone of radius `slope t` touches, without the own sheet if it cannot occlude the place.
    fn near(&self, place: &SurfacePoint, ray: &LightRay, slope: f32) -> Vec<u32> {
        let mut found = Vec::new();
        if let Some(tree) = &self.tree {
            let line = Line::cone(place.p.as_vec3(), ray.direction.as_vec3(), slope);
            tree.walk(&line, ray.t_max as f32, |item, limit| {
                let instance = self.instances[item as usize];
                if instance != place.own || !(place.skips_own || self.is_flat[item as usize]) {
                    found.push(instance);
                }
                limit
            });
        }
        found
    }
}

impl Scene {
    /// Fraction of a thin ray that passes the sheets.
    pub fn ray_past_sheets(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        if self.sheets.is_empty() {
            return 1.0;
        }
        self.ray_past(&self.sheets.near(place, ray, 0.0), place, ray, work)
    }

    /// Mean fraction of a cone's section that passes the sheets.
    pub fn cone_past_sheets(&self, place: &SurfacePoint, ray: &LightRay, slope: f32, work: &mut LightWork) -> f32 {
        if self.sheets.is_empty() {
            return 1.0;
        }
        let met = self.sheets.near(place, ray, slope);
        if met.is_empty() { 1.0 } else { self.cone_past(&met, place, ray, slope, work) }
    }

    /// Fraction of each of the [`PARTS`] of a light's disc that passes the sheets: angular radius `slope`, `ray` to its
    /// centre.
    pub fn disc_past_sheets(
        &self,
        place: &SurfacePoint,
        ray: &LightRay,
        slope: f32,
        work: &mut LightWork,
    ) -> [f32; PARTS as usize] {
        let mut parts = [1.0; PARTS as usize];
        if self.sheets.is_empty() {
            return parts;
        }
        let met = self.sheets.near(place, ray, slope);
        if met.is_empty() {
            return parts;
        }
        let axes = basis(ray.direction);
        let rim = (0..RIM_RAYS).map(|i| Vec2::from_angle(i as f32 * (std::f32::consts::TAU / RIM_RAYS as f32)));
        let inside = (0..PROBE_RAYS).map(|i| disc_point(i, PROBE_RAYS, 0.0));
        let mut probes =
            rim.chain(inside).map(|point| self.ray_past(&met, place, &toward(ray, axes, slope, point), work));
        let first = probes.next().unwrap_or(1.0);
        if (first == 0.0 || first == 1.0) && probes.all(|share| share == first) {
            return [first; PARTS as usize];
        }
        let part_slope = slope / (PARTS as f32).sqrt();
        for (i, part) in parts.iter_mut().enumerate() {
            let to_part = toward(ray, axes, slope, disc_point(i as u32, PARTS, 0.0));
            *part = self.cone_past(&met, place, &to_part, part_slope, work);
        }
        parts
    }

    /// Fractions of a light that pass the sheets: one for each of its [`PARTS`], or a single one for a point.
    pub fn light_past_sheets(
        &self,
        place: &SurfacePoint,
        ray: &LightRay,
        slope: f32,
        work: &mut LightWork,
    ) -> Vec<f32> {
        if slope > 0.0 {
            self.disc_past_sheets(place, ray, slope, work).to_vec()
        } else {
            vec![self.ray_past_sheets(place, ray, work)]
        }
    }

    /// All fractions of the sheets that the light pass needs at a surface: first each cone of occlusion, then for each
    /// evaluated light one fraction (hard), [`PARTS`] (soft) or one per ray (area).
    pub fn sheets_at(
        &self,
        surface: &LitSurface<'_>,
        lights: &Lights,
        options: &RenderOptions,
    ) -> (Vec<f32>, LightWork) {
        let (mut shares, mut work) = (Vec::new(), LightWork::default());
        let place = &surface.place;
        if let Some(distance) = options.occlusion {
            for (ray, _) in place.open_rays(distance / self.scale) {
                shares.push(self.cone_past_sheets(place, &ray, AO_SLOPE, &mut work));
            }
        }
        for light in &lights.lights {
            let (ray, slope, _) = light.seen_from(place.p);
            if !surface.needs_rays(&ray, options) {
                continue;
            }
            match options.shadows {
                SceneShadows::Soft => shares.extend(self.light_past_sheets(place, &ray, slope, &mut work)),
                SceneShadows::Area(count) if slope > 0.0 => {
                    let axes = basis(ray.direction);
                    shares.extend((0..count).map(|i| {
                        let to_point = toward(&ray, axes, slope, disc_point(i, count, surface.turn));
                        self.ray_past_sheets(place, &to_point, &mut work)
                    }));
                }
                _ => shares.push(self.ray_past_sheets(place, &ray, &mut work)),
            }
        }
        (shares, work)
    }

    fn cone_past(&self, met: &[u32], place: &SurfacePoint, ray: &LightRay, slope: f32, work: &mut LightWork) -> f32 {
        let axes = basis(ray.direction);
        let to = |i: u32| toward(ray, axes, slope, disc_point(i, CONE_RAYS, 0.0));
        (0..CONE_RAYS).map(|i| self.ray_past(met, place, &to(i), work)).sum::<f32>() / CONE_RAYS as f32
    }

    fn ray_past(&self, met: &[u32], place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        let start = self.lifted(place, ray);
        let mut share = 1.0;
        for &item in met {
            work.steps += 1;
            share *= self.instance_share(&self.instances[item as usize], start, ray);
            if share <= 0.0 {
                break;
            }
        }
        share
    }

    /// The nearest face on a thin ray that blocks at least [`LEAST_OPACITY`] of the light, with the instance that it
    /// belongs to.
    pub fn first_face(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> Option<(u32, FaceHit)> {
        let mut nearest: Option<(u32, FaceHit)> = None;
        let start = self.lifted(place, ray);
        for item in self.sheets.near(place, ray, 0.0) {
            work.steps += 1;
            let instance = &self.instances[item as usize];
            let Some(triangles) = instance.triangles.as_deref() else { continue };
            let t_max = nearest.map_or(ray.t_max, |(_, hit)| hit.t);
            let hit = triangles.mesh.first_hit(&ray_in_tree(instance, start, ray, t_max), |hit| {
                instance.opacity
                    * FaceAppearance::new(self, instance, triangles, hit.face, hit.weights).opacity(hit.is_front)
                    >= LEAST_OPACITY
            });
            nearest = hit.map(|hit| (item, hit)).or(nearest);
        }
        nearest
    }

    /// Start of a ray: slightly off its own surface, on the side to which it goes.
    fn lifted(&self, place: &SurfacePoint, ray: &LightRay) -> DVec3 {
        let normal = place.normal.as_dvec3();
        place.p + self.lift(place).copysign(normal.dot(ray.direction)) * normal
    }

    /// Distance of the start of a ray from its own surface, scene units.
    pub(crate) fn lift(&self, place: &SurfacePoint) -> f64 {
        let own = &self.instances[place.own as usize];
        own.triangles.as_ref().map_or(0.0, |triangles| LIFT * triangles.mesh.scale() * f64::from(own.stretch[1]))
    }

    /// Fraction of a ray that one sheet lets pass.
    fn instance_share(&self, instance: &Instance, start: DVec3, ray: &LightRay) -> f32 {
        let Some(triangles) = instance.triangles.as_deref() else { return 1.0 };
        let in_tree = ray_in_tree(instance, start, ray, ray.t_max);
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
}

/// A ray from `start` in the space of the tree of an instance.
fn ray_in_tree(instance: &Instance, start: DVec3, ray: &LightRay, t_max: f64) -> watertight::Ray {
    let origin = instance.tree_from_scene.transform_point3(start);
    let direction = instance.tree_from_scene.matrix3 * ray.direction;
    watertight::Ray { origin, direction, t_min: 0.0, t_max }
}
