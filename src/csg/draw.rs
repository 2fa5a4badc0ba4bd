//! Pictures of shapes on the CPU, with the camera, the light and the frame of every other picture.

use super::chord::Form;
use super::decompose::Method;
use super::gpu;
use super::model::Model;
use super::program::Stack;
use super::solid::Solid;
use super::trace::{LocalRay, Tracer, Work};
use crate::error::{Error, ShapeError};
use crate::gpu::Place;
use crate::progress::Progress;
use crate::render::shade::{Look, lit};
use crate::render::{Camera, DirectionalLight, Frame, RaymarchOptions, Row};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Which rays see what.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DrawMethod {
    /// Every step evaluates every leaf.
    Whole,
    /// Part by part in their boxes.
    Parts(Method),
    /// By the octree, but for a shape of a few leaves.
    #[default]
    Auto,
}

impl DrawMethod {
    /// The method that the Python interface calls `name`.
    pub fn from_name(name: &str) -> Result<Self, ShapeError> {
        match name {
            "auto" => Ok(Self::Auto),
            "whole" => Ok(Self::Whole),
            _ => Method::from_name(name).map(Self::Parts).map_err(|_| {
                let problem = format!("expected \"auto\", \"whole\", \"aabb\" or \"octree\", got {name:?}");
                ShapeError::argument("method", problem)
            }),
        }
    }
}

/// A picture, and what it cost.
#[derive(Debug)]
pub struct Drawing {
    pub frame: Frame,
    pub parts: usize,
    pub boxes: usize,
    /// Evaluations of leaves by the rays of the pixels, shadow rays left out.
    pub leaf_evaluations: u64,
    /// Structures of parts that the device's kernel for this picture has a function for, or will have.
    pub structures: usize,
    /// Whether that kernel was there; until then the interpreter draws.
    pub is_compiled: bool,
    /// Kernels that the device keeps for pictures of shapes.
    pub pipelines: usize,
}

/// Start of a shadow ray above the surface, local units: some of the shortest steps.
const SHADOW_BIAS: f32 = 1e-3;

/// The parts that a picture is drawn from; one that is the whole for [`DrawMethod::Whole`].
pub fn tracer<'a>(solid: &'a Solid, method: DrawMethod) -> Result<Tracer<'a>, Error> {
    solid.bounds()?;
    match method {
        DrawMethod::Whole => Ok(Tracer::whole(solid)),
        DrawMethod::Auto if is_small(solid) => Ok(Tracer::one_box(solid)),
        DrawMethod::Auto => Ok(Tracer::of(solid, solid.cells(Method::Octree)?.clone())),
        DrawMethod::Parts(method) => Ok(Tracer::of(solid, solid.cells(method)?.clone())),
    }
}

/// Up to so many leaves, evaluating all of them costs less than finding out which matter.
const FEW_LEAVES: usize = 12;
/// The same where hits have a closed form.
const FEW_CHORDS: usize = 4;

fn is_small(solid: &Solid) -> bool {
    let tokens = &solid.model.tokens;
    let few = if Form::of(&solid.program, tokens) == Form::Field { FEW_LEAVES } else { FEW_CHORDS };
    Model::leaf_count(tokens) <= few
}

/// Draw a shape at a place.
pub fn draw(
    place: &Place,
    tracer: &Tracer<'_>,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Drawing, Error> {
    options.check()?;
    let lights = options.unit_lights(camera)?;
    let view = View { tracer, camera, options, lights: &lights, is_eye_inside: tracer.is_inside(camera.eye) };
    match place {
        // With the eye inside there is nothing to trace, and without boxes nothing to see.
        Place::Gpu(context) if !view.is_eye_inside && !tracer.boxes.is_empty() => gpu::draw(&view, context, progress),
        _ => draw_on_cpu(&view, progress),
    }
}

fn draw_on_cpu(view: &View<'_>, progress: &Progress) -> Result<Drawing, Error> {
    let [width, height] = view.options.size.map(|n| n as usize);
    progress.set_total(height as u64);
    let mut frame = Frame::new(width, height, view.lights.len());
    let evaluations = AtomicU64::new(0);
    frame.rows().into_par_iter().enumerate().try_for_each_init(Scratch::default, |scratch, (y, mut row)| {
        scratch.work = Work::default();
        for x in 0..width {
            view.draw_pixel(x, y, &mut row, scratch);
        }
        evaluations.fetch_add(scratch.work.leaves, Ordering::Relaxed);
        progress.advance(1)
    })?;
    Ok(Drawing {
        frame,
        parts: view.tracer.programs.len(),
        boxes: view.tracer.boxes.len(),
        leaf_evaluations: evaluations.into_inner(),
        structures: 0,
        is_compiled: false,
        pipelines: 0,
    })
}

/// What a thread keeps between pixels.
#[derive(Default)]
pub(super) struct Scratch {
    march: Stack<f32, 1>,
    slope: Stack<f64, 6>,
    work: Work,
}

/// What every pixel needs.
pub(super) struct View<'a> {
    pub tracer: &'a Tracer<'a>,
    pub camera: &'a Camera,
    pub options: &'a RaymarchOptions,
    /// With unit directions.
    pub lights: &'a [DirectionalLight],
    pub is_eye_inside: bool,
}

impl View<'_> {
    /// Fill pixel `x` of row `y`; the row already says "nothing hit".
    pub fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>, scratch: &mut Scratch) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);

        // Multiples of `direction` are depths.
        let direction = self.camera.pixel_direction(x as u32, y as u32, self.options.size);
        let unit = direction.normalize();
        let frame = self.tracer.solid.frame;
        let (depth, p, normal, part) = if self.is_eye_inside {
            (0.0, frame.local(self.camera.eye).as_vec3(), -unit.as_vec3(), None)
        } else {
            let Some((ray, t_start)) = entering(self.tracer, self.camera.eye, unit) else { return };
            let before = scratch.work.steps;
            let hit = self.tracer.first_hit(&ray, &mut scratch.march, &mut scratch.work);
            row.steps[x] = scratch.work.steps - before;
            let Some(hit) = hit else { return };
            let p = ray.origin + hit.t * ray.direction;
            let normal = self.tracer.normal(p, hit.part, &mut scratch.slope).unwrap_or(-unit.as_vec3());
            let depth = (t_start + f64::from(hit.t)) * frame.scale / direction.length();
            (depth, p, normal, Some(hit.part))
        };
        self.finish(x, row, depth, p, normal, direction, part, |to_light| {
            self.share_that_arrives(p, normal, to_light, &mut scratch.march)
        });
    }

    /// Light a hit at the local point `p` and write it down; without a `part` it has the colour of the options.
    pub fn finish(
        &self,
        x: usize,
        row: &mut Row<'_>,
        depth: f64,
        p: Vec3,
        normal: Vec3,
        direction: DVec3,
        part: Option<u32>,
        share_that_arrives: impl FnMut(Vec3) -> f32,
    ) {
        let painted = part.and_then(|part| self.tracer.color(p, part));
        let color = painted.map_or(self.options.color, Vec3::from_array);
        let look = Look { normal, to_eye: -direction.normalize().as_vec3(), color };
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = lit(&look, self.options, self.lights, shadow, share_that_arrives);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = depth as f32;
        row.normal[3 * x..][..3].copy_from_slice(&normal.to_array());
        row.object_id[x] = 0;
    }

    /// 1 where nothing stands between the surface and the light, else 0.
    fn share_that_arrives(&self, p: Vec3, normal: Vec3, to_light: Vec3, stack: &mut Stack<f32, 1>) -> f32 {
        if normal.dot(to_light) <= 0.0 {
            return 0.0;
        }
        let ray = LocalRay { origin: p + SHADOW_BIAS * normal, direction: to_light, t_max: FAR };
        if self.tracer.is_hit(&ray, stack, &mut Work::default()) { 0.0 } else { 1.0 }
    }
}

/// Longer than any way through the model.
const FAR: f32 = 16.0;

/// A direction without a part along an axis has this one: its inverse times any distance is finite.
const STILL: f64 = 1e-200;

/// The part of a ray from an eye that lies in the bounds, and how far before it begins, local units. In float64, because
/// the eye may be far away; `unit` is a world direction.
pub fn entering(tracer: &Tracer<'_>, eye: DVec3, unit: DVec3) -> Option<(LocalRay, f64)> {
    if tracer.boxes.is_empty() {
        return None;
    }
    let [lower, upper] = tracer.bounds.map(Vec3::as_dvec3);
    let origin = tracer.solid.frame.local(eye);
    // What does not move along an axis goes up by next to nothing.
    let still = DVec3::splat(STILL);
    let inverse = DVec3::select(unit.abs().cmplt(still), still, unit).recip();
    let (a, b) = ((lower - origin) * inverse, (upper - origin) * inverse);
    let (t_in, t_out) = (a.min(b).max_element().max(0.0), a.max(b).min_element());
    if t_in >= t_out {
        return None;
    }
    let ray = LocalRay { origin: (origin + t_in * unit).as_vec3(), direction: unit.as_vec3(), t_max: FAR };
    Some((ray, t_in))
}
