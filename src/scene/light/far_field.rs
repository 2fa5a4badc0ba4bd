//! The far part of rays: beyond a distance one coarse field replaces all opaque instances.
//!
//! # Theory
//!
//! The coarse field of *Signed Distance Fields in Unity* ([`crate::merge`]) is made for light from far away. A ray has
//! up to three parts:
//!
//! ```text
//!   0 ----- near ----- distance ----- far ----- end of the data ----- rest ----- light
//!      instances                     the field                     instances
//! ```
//!
//! Near the surface, where the shadow shows the shapes of the surface itself and of its neighbours, the instances are
//! evaluated. Beyond the grid of the field the instances are evaluated again. Translucent instances, which the field
//! does not contain, are evaluated on the whole ray.
//!
//! *No leaks.* Samples of a merged field do not exceed the signed distance `d`, so at a point `p` of a cell of side `h`
//! the field is at most `sum w_i d(c_i)`. Take a wall of thickness `w` and a point in its middle: `d(c_i)` is
//! `|(c_i - p).n| - w/2`, and the weighted mean of `|(c_i - p).n|` is at most its root mean square, `h/2`. The field is
//! therefore below zero in the middle of every wall thicker than one voxel, at any angle. In a wall of two voxels it is
//! so in a layer of `1.7 h`. Thin rays are traced exactly. The step of a cone may exceed the distance by half the
//! diagonal of a cell, `0.87 h`, because values do not exceed `d` at the samples. It then ends in that layer, which
//! reaches from `0.15 h` to `1.85 h` behind the face, and the axis is traced from the step before. So none passes. A
//! thinner object may be lost beyond the distance, as in any field with such voxels.
//!
//! *Start.* The surface of a coarse field lies up to about one voxel off the true one. A ray that the instances let
//! pass is outside when the far part begins. If the field is negative there, the ray skips one voxel and is evaluated
//! again. A wall of two voxels cannot be skipped: its middle is one voxel behind its face.
//!
//! *Levels.* Nested fields are each evaluated on their own piece of the ray, the finest where it has samples.
//!
//! # Practice
//!
//! [`Far::new`] places a field in a scene, once per picture; [`super::shadow::TracedScene`] evaluates it.

use super::light_rays::{LightRay, SurfacePoint, widest};
use crate::error::{Error, SceneError};
use crate::geometry::{Aabb, clip};
use crate::scene::content::instance::{Instance, InstanceInput};
use crate::scene::content::model::Scene;
use crate::scene::content::options::{FAR_VOXELS, FarField};
use crate::scene::fields::field::Field;
use glam::{DAffine3, Vec3};
use std::sync::Arc;

/// A far field in a scene.
pub(crate) struct Far {
    /// Levels, finest first.
    pub levels: Vec<FarLevel>,
    /// Distance from which the field is evaluated, scene units.
    pub distance: Option<f64>,
    /// Whether no instance has to be evaluated beyond the distance: all are opaque, and none extends beyond the grid.
    pub holds_all: bool,
}

/// A level of a far field.
pub(crate) struct FarLevel {
    /// The field as an instance of the scene.
    pub instance: Instance,
    /// Region of the level, except for the finer levels in it: the box of its samples; for the outermost level the box
    /// of its surface.
    pub bounds: Aabb,
    /// Voxel size, scene units.
    pub voxel: f64,
}

/// The split of a ray into parts for the instances and for the far field, scene units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Split {
    /// End of the part for the instances.
    pub near: f64,
    pub far: Option<[f64; 2]>,
    /// Start of the second part for the instances.
    pub rest: Option<f64>,
}

impl Split {
    /// The split without a far field.
    pub(crate) fn near(end: f64) -> Self {
        Self { near: end, far: None, rest: None }
    }

    /// The intervals of a ray of length `t_max` in which an instance is evaluated: not beside the far field if that
    /// contains the instance. It contains opaque solids only.
    pub(crate) fn parts(&self, instance: &Instance, t_max: f64) -> impl Iterator<Item = [f64; 2]> + use<> {
        let (near, rest) = if instance.is_opaque_solid() { (self.near, self.rest) } else { (t_max, None) };
        [Some([0.0, near]), rest.map(|rest| [rest, t_max])].into_iter().flatten()
    }
}

impl Far {
    pub(crate) fn new(scene: &Scene, far: &FarField) -> Result<Self, Error> {
        if let Some(distance) = far.distance.filter(|distance| !(0.0..=f64::MAX).contains(distance)) {
            let problem = format!("must be a finite number of at least 0, got {distance}");
            return Err(SceneError::new("far_distance", problem).into());
        }
        let Some((outermost, finer)) = far.levels.split_last() else {
            return Err(SceneError::new("far", "has no levels").into());
        };
        // Grids are aligned with the world's axes.
        let in_scene = |field: &Arc<dyn Field>, corners: [Vec3; 2]| {
            let world_from_field = field.field_from_local().inverse();
            let [min, max] = corners
                .map(|corner| scene.scene_from_world(world_from_field.transform_point3(corner.as_dvec3())).as_vec3());
            Aabb { min, max }
        };
        let level = |field: &Arc<dyn Field>, corners: [Vec3; 2]| {
            Ok::<_, Error>(FarLevel {
                instance: Instance::placed(0, &as_thing(field), scene.center, scene.scale, 1)?,
                bounds: in_scene(field, corners),
                voxel: field.voxel() / scene.scale,
            })
        };
        let between_samples = |field: &Arc<dyn Field>| {
            let [lower, upper] = field.bounds();
            [lower + 0.5, upper - 0.5]
        };
        let finer = finer.iter().map(|field| level(field, between_samples(field)));
        let levels = finer.chain([level(outermost, outermost.surface_bounds())]).collect::<Result<_, _>>()?;

        let data = in_scene(outermost, outermost.bounds());
        let is_held = |(instance, bounds): (&Instance, &Aabb)| {
            let casts = instance.casts_shadow && instance.shade > 0.0;
            let is_in_data = bounds.min.cmpge(data.min).all() && bounds.max.cmple(data.max).all();
            !casts || (instance.is_opaque_solid() && is_in_data)
        };
        let holds_all = scene.instances.iter().zip(&scene.boxes).all(is_held);
        Ok(Self { levels, distance: far.distance.map(|distance| distance / scene.scale), holds_all })
    }

    /// Splits a ray, or a cone of radius `slope t` around it.
    pub(crate) fn split(&self, place: &SurfacePoint, ray: &LightRay, slope: f32) -> Split {
        let bounds = &self.outermost().bounds;
        let grown = if slope > 0.0 { widest(place, ray, slope, bounds) } else { 0.0 };
        let (lower, upper) = (bounds.min - grown, bounds.max + grown);
        match clip(place.p, ray.direction, lower, upper, self.distance_from(place), ray.t_max) {
            Some((enter, leave)) if enter < leave => {
                let rest = (leave < ray.t_max && !self.holds_all).then_some(leave);
                Split { near: enter, far: Some([enter, leave]), rest }
            }
            _ => Split::near(ray.t_max),
        }
    }

    /// The levels for the far part of a ray, each with its piece.
    pub(crate) fn pieces<'a>(
        &'a self,
        far: [f64; 2],
        place: &'a SurfacePoint,
        ray: &'a LightRay,
    ) -> impl Iterator<Item = (&'a FarLevel, [f64; 2])> {
        // The piece of the next finer level.
        let mut finer: Option<[f64; 2]> = None;
        self.levels.iter().enumerate().flat_map(move |(k, level)| {
            let part = if k + 1 == self.levels.len() {
                Some(far)
            } else {
                let Aabb { min, max } = level.bounds;
                clip(place.p, ray.direction, min, max, far[0], far[1]).map(|(enter, leave)| [enter, leave])
            };
            let pieces = match (part, finer) {
                (Some([enter, leave]), Some([from, to])) => [Some([enter, from]), Some([to, leave])],
                _ => [part, None],
            };
            finer = part.or(finer);
            pieces.into_iter().flatten().filter(|[from, to]| from < to).map(move |piece| (level, piece))
        })
    }

    fn outermost(&self) -> &FarLevel {
        self.levels.last().expect("checked when it was made")
    }

    /// Distance from which the field is evaluated for a ray.
    fn distance_from(&self, place: &SurfacePoint) -> f64 {
        self.distance.unwrap_or_else(|| {
            let p = place.p.as_vec3();
            let holds = |level: &&FarLevel| p.cmpge(level.bounds.min).all() && p.cmple(level.bounds.max).all();
            FAR_VOXELS * self.levels.iter().find(holds).unwrap_or_else(|| self.outermost()).voxel
        })
    }
}

/// A field in world space as the input of a scene.
fn as_thing(field: &Arc<dyn Field>) -> InstanceInput {
    InstanceInput {
        triangles: None,
        field: Some(field.clone()),
        world_from_local: DAffine3::IDENTITY,
        first_material: 0,
        own_colors: false,
        opacity: 1.0,
        casts_shadow: true,
        visible: false,
        object: 0,
        is_sheet: false,
        is_solid: true,
    }
}
