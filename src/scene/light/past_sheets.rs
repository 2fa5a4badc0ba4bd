//! Cones past sheets: open, flat, thin and alpha-textured meshes, whose triangles are intersected by rays.
//!
//! # Theory
//!
//! A distance field on a grid cannot represent objects thinner than a voxel, and a thicker sheet shades itself. Cones
//! of light past a sheet are therefore sampled by thin rays, which trace triangles ([`super::mesh_rays`]).
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

use super::light_rays::{LightRay, LightWork, PARTS, SurfacePoint, basis, disc_point, toward};
use super::lit_surface::{Lights, LitSurface};
use super::mesh_rays::is_skipped;
use super::occlusion::NearOccluders;
use super::shadow::TracedScene;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::options::{RenderOptions, SceneShadows};
use crate::scene::content::sheets::Sheets;
use crate::scene::content::tree::Line;
use glam::Vec2;

/// Number of rays of a cone. A light's disc has [`PARTS`] cones, so 64 rays.
const CONE_RAYS: u32 = 4;

/// Number of rays on the rim of a disc that test whether it is completely lit or dark.
const RIM_RAYS: u32 = 16;
/// Number of rays inside the disc for the same test.
const PROBE_RAYS: u32 = 8;

impl Sheets {
    /// The sheets whose boxes a cone of radius `slope t` touches, without the own sheet if it cannot occlude the place.
    fn near(&self, instances: &[Instance], place: &SurfacePoint, ray: &LightRay, slope: f32) -> Vec<u32> {
        let mut found = Vec::new();
        if let Some(tree) = &self.tree {
            let line = Line::cone(place.p.as_vec3(), ray.direction.as_vec3(), slope);
            tree.walk(&line, ray.t_max as f32, |item, limit| {
                let instance = self.instances[item as usize];
                let triangles = instances[instance as usize].casting_triangles();
                if triangles.is_some_and(|triangles| !is_skipped(instance, triangles, place)) {
                    found.push(instance);
                }
                limit
            });
        }
        found
    }
}

impl Scene {
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
        let sheets = self.sheets.near(&self.instances, place, ray, slope);
        if sheets.is_empty() {
            return parts;
        }
        let axes = basis(ray.direction);
        let rim = (0..RIM_RAYS).map(|i| Vec2::from_angle(i as f32 * (std::f32::consts::TAU / RIM_RAYS as f32)));
        let inside = (0..PROBE_RAYS).map(|i| disc_point(i, PROBE_RAYS, 0.0));
        let mut probes =
            rim.chain(inside).map(|point| self.ray_past(&sheets, place, &toward(ray, axes, slope, point), work));
        let first = probes.next().unwrap_or(1.0);
        if (first == 0.0 || first == 1.0) && probes.all(|share| share == first) {
            return [first; PARTS as usize];
        }
        let part_slope = slope / (PARTS as f32).sqrt();
        for (i, part) in parts.iter_mut().enumerate() {
            let to_part = toward(ray, axes, slope, disc_point(i as u32, PARTS, 0.0));
            *part = self.cone_past(&sheets, place, &to_part, part_slope, work);
        }
        parts
    }

    fn cone_past(&self, sheets: &[u32], place: &SurfacePoint, ray: &LightRay, slope: f32, work: &mut LightWork) -> f32 {
        let axes = basis(ray.direction);
        let to = |i: u32| toward(ray, axes, slope, disc_point(i, CONE_RAYS, 0.0));
        (0..CONE_RAYS).map(|i| self.ray_past(sheets, place, &to(i), work)).sum::<f32>() / CONE_RAYS as f32
    }

    fn ray_past(&self, sheets: &[u32], place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        let mut share = 1.0;
        for &item in sheets {
            let Some(triangles) = self.instances[item as usize].casting_triangles() else { continue };
            work.steps += 1;
            share *= self.past_mesh(item, triangles, place, ray, [0.0, ray.t_max]);
            if share <= 0.0 {
                break;
            }
        }
        share
    }
}

impl TracedScene<'_> {
    /// Whether triangles may block the light of a picture. The CPU traces them for all devices.
    pub(crate) fn needs_faces(&self, lights: &Lights, options: &RenderOptions) -> bool {
        let has_rays = match options.shadows {
            SceneShadows::Hard | SceneShadows::Area(_) => true,
            SceneShadows::Soft => lights.lights.iter().any(|light| !light.has_size()),
            SceneShadows::None => false,
        };
        !self.scene.sheets.is_empty() || ((has_rays || options.occlusion.is_some()) && self.scene.has_faces)
    }

    /// Fractions of a light that pass triangles: for a disc one for each of its [`PARTS`] past the sheets, for a point
    /// a single one past all meshes.
    pub(crate) fn light_past_faces(
        &self,
        place: &SurfacePoint,
        ray: &LightRay,
        slope: f32,
        work: &mut LightWork,
    ) -> Vec<f32> {
        if slope > 0.0 {
            self.scene.disc_past_sheets(place, ray, slope, work).to_vec()
        } else {
            vec![self.face_share(place, ray, work)]
        }
    }

    /// All fractions past triangles that the light pass needs at a surface: first each ray over the hemisphere, then
    /// for each evaluated light one fraction (hard), [`PARTS`] (soft) or one per ray (area).
    pub(crate) fn faces_at(
        &self,
        surface: &LitSurface<'_>,
        lights: &Lights,
        options: &RenderOptions,
        near: &mut NearOccluders,
    ) -> (Vec<f32>, LightWork) {
        let (mut shares, mut work) = (Vec::new(), LightWork::default());
        let place = &surface.place;
        if let Some(distance) = options.occlusion {
            let hemisphere = surface.hemisphere(distance / self.scene.scale);
            shares.extend(self.open_past_faces(&hemisphere, near, &mut work));
        }
        for light in &lights.lights {
            let (ray, slope, _) = light.seen_from(place.p);
            if !surface.needs_rays(&ray, options) {
                continue;
            }
            let is_soft = options.shadows == SceneShadows::Soft;
            for (path, slope) in surface.paths(&ray, slope, options.shadows) {
                let slope = if is_soft { slope } else { 0.0 };
                shares.extend(self.light_past_faces(place, &path, slope, &mut work));
            }
        }
        (shares, work)
    }
}
