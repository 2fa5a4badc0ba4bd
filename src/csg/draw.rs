//! Pictures of shapes on the CPU, with the camera, the light and the frame of all other pictures.

use super::chord::Form;
use super::decompose::Method;
use super::gpu;
use super::model::Model;
use super::program::Stack;
use super::solid::Solid;
use super::trace::{LocalRay, Tracer, Work};
use crate::error::{Error, ShapeError, choice};
use crate::gpu::Place;
use crate::gpu::constants::csg_draw::{FAR_T, SHADOW_BIAS};
use crate::gpu::layout::PictureRays;
use crate::progress::Progress;
use crate::render::shade::{Look, lit};
use crate::render::{Camera, DirectionalLight, Frame, RaymarchOptions, Row};
use glam::Vec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// The parts that rays are traced through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum DrawMethod {
    /// The whole shape: every step evaluates every leaf.
    Whole,
    /// The parts, each in its boxes.
    Parts(Method),
    /// The method with the smallest estimated cost per ray.
    #[default]
    Auto,
}

impl DrawMethod {
    /// Converts the public name of a method.
    pub fn from_name(name: &str) -> Result<Self, ShapeError> {
        choice(
            "method",
            name,
            &[
                ("auto", Self::Auto),
                ("whole", Self::Whole),
                ("aabb", Self::Parts(Method::Aabb)),
                ("octree", Self::Parts(Method::Octree)),
            ],
        )
        .map_err(ShapeError::from)
    }
}

/// A picture and its cost.
#[derive(Debug)]
pub struct Drawing {
    pub frame: Frame,
    pub parts: usize,
    pub boxes: usize,
    /// Number of evaluations of leaves by the rays of the pixels, without shadow rays.
    pub leaf_evaluations: u64,
    /// Number of structures that have a function in the device's kernel for this picture.
    pub structures: usize,
    /// Whether that kernel was compiled. Until then the interpreter draws.
    pub is_compiled: bool,
    /// Number of kernels that the device keeps for pictures of shapes.
    pub pipelines: usize,
}

/// The parts that rays are traced through at a place; a single part for [`DrawMethod::Whole`].
pub fn tracer<'a>(place: &Place, solid: &'a Solid, method: DrawMethod) -> Result<Tracer<'a>, Error> {
    solid.bounds()?;
    match method {
        DrawMethod::Whole => Ok(Tracer::whole(solid)),
        DrawMethod::Auto if matches!(place, Place::Gpu(_)) && is_one_structure(solid) => Ok(Tracer::one_box(solid)),
        DrawMethod::Auto => cheapest(solid),
        DrawMethod::Parts(method) => Ok(Tracer::of(solid, solid.cells(method)?.clone())),
    }
}

/// Largest number of leaves of a shape that is one function on a device. The parts of its decomposition would depend on
/// its parameters, and changing a parameter should compile nothing.
const FEW_LEAVES: usize = 12;

/// Whether a device compiles one function for a whole shape. Shapes in closed form have none.
fn is_one_structure(solid: &Solid) -> bool {
    let tokens = &solid.model.tokens;
    Model::leaf_count(tokens) <= FEW_LEAVES && Form::of(&solid.program, tokens) == Form::Field
}

/// The parts with the smallest estimated cost per ray. A few leaves are evaluated together; boxes carried from the
/// leaves are few and fit sparse scenes tightly; only the octree separates many leaves that intersect.
fn cheapest(solid: &Solid) -> Result<Tracer<'_>, Error> {
    let octree = Tracer::of(solid, solid.cells(Method::Octree)?.clone());
    if Model::leaf_count(&solid.model.tokens) > AABB_LEAVES {
        return Ok(octree);
    }
    let aabb = Tracer::of(solid, solid.cells(Method::Aabb)?.clone());
    let of_octree = octree.cost();
    let others = [Tracer::one_box(solid), aabb].into_iter().filter(|tracer| tracer.cost() < of_octree);
    Ok(others.min_by(|a, b| a.cost().total_cmp(&b.cost())).unwrap_or(octree))
}

/// Largest number of leaves for which boxes carried from the leaves are tried.
const AABB_LEAVES: usize = 256;

/// Draws a shape at a place.
pub fn draw(
    place: &Place,
    tracer: &Tracer<'_>,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Drawing, Error> {
    options.check()?;
    let lights = options.unit_lights()?;
    let is_eye_inside = tracer.is_inside(camera.eye);
    let rays = Rays::new(tracer, camera, options, lights.len());
    let view = View { tracer, camera, options, lights: &lights, is_eye_inside, rays };
    match place {
        // With the eye inside, or without boxes, there is nothing to trace.
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

/// Buffers that a thread keeps between pixels.
#[derive(Default)]
pub(super) struct Scratch {
    march: Stack<f32, 1>,
    slope: Stack<f64, 6>,
    work: Work,
}

/// Data shared by all pixels.
pub(super) struct View<'a> {
    pub tracer: &'a Tracer<'a>,
    pub camera: &'a Camera,
    pub options: &'a RaymarchOptions,
    /// Lights with unit directions.
    pub lights: &'a [DirectionalLight],
    pub is_eye_inside: bool,
    pub rays: Rays,
}

/// The visible point of a pixel, in local units except for the depth.
pub(super) struct Seen {
    pub p: Vec3,
    pub depth: f64,
    pub normal: Vec3,
    /// Index of the part; None uses the colour of the options.
    pub part: Option<u32>,
}

/// The rays of a picture in local units. They start on a plane just before the bounds, computed in float64, so that
/// float32 is precise enough for an eye at any distance. Twin of `shaders/shared/picture_rays.wgsl`.
pub(super) struct Rays {
    pub rays: PictureRays,
    /// Depth of the plane, and length of one local unit, world units.
    start_depth: f64,
    scale: f64,
    middle: [f32; 2],
    forward: Vec3,
}

impl Rays {
    fn new(tracer: &Tracer<'_>, camera: &Camera, options: &RaymarchOptions, light_count: usize) -> Self {
        let frame = tracer.solid.frame;
        let start_depth = camera.depth_before(tracer.bounds.map(|corner| frame.world(corner.as_dvec3())));
        let start = frame.local(camera.eye - start_depth * camera.back);
        let rays = camera.rays(options, light_count, start, start_depth / frame.scale);
        Self {
            start_depth,
            scale: frame.scale,
            middle: options.size.map(|n| 0.5 * n as f32),
            forward: Vec3::from_array(rays.forward),
            rays,
        }
    }

    pub fn through(&self, x: usize, y: usize) -> LocalRay {
        let rays = &self.rays;
        let along_right = (x as f32 + 0.5 - self.middle[0]) * rays.pixel;
        let along_up = (self.middle[1] - 0.5 - y as f32) * rays.pixel;
        let [start, start_right, start_up] = [rays.start, rays.start_right, rays.start_up].map(Vec3::from_array);
        let [right, up] = [rays.right, rays.up].map(Vec3::from_array);
        LocalRay {
            origin: start + along_right * start_right + along_up * start_up,
            direction: (self.forward + along_right * right + along_up * up).normalize(),
            t_max: FAR_T,
        }
    }

    /// Depth of the point at `t`, world units.
    pub fn depth(&self, ray: &LocalRay, t: f32) -> f64 {
        self.start_depth + f64::from(t) * f64::from(self.forward.dot(ray.direction)) * self.scale
    }
}

impl View<'_> {
    /// Fills pixel `x` of row `y`. The row is initialised to "no hit".
    pub fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>, scratch: &mut Scratch) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);

        if self.is_eye_inside {
            let unit = self.camera.pixel_direction(x as u32, y as u32, self.options.size).normalize().as_vec3();
            let p = self.tracer.solid.frame.local(self.camera.eye).as_vec3();
            let seen = Seen { p, depth: 0.0, normal: -unit, part: None };
            return self.finish(x, row, &seen, unit, |to_light| {
                self.share_that_arrives(p, seen.normal, to_light, &mut scratch.march)
            });
        }
        let ray = self.rays.through(x, y);
        let before = scratch.work.steps;
        let hit = self.tracer.first_hit(&ray, &mut scratch.march, &mut scratch.work);
        row.steps[x] = scratch.work.steps - before;
        let Some(hit) = hit else { return };
        let p = ray.origin + hit.t * ray.direction;
        let normal = self.tracer.normal(p, ray.direction, hit.part, &mut scratch.slope).unwrap_or(-ray.direction);
        let seen = Seen { p, depth: self.rays.depth(&ray, hit.t), normal, part: Some(hit.part) };
        self.finish(x, row, &seen, ray.direction, |to_light| {
            self.share_that_arrives(p, normal, to_light, &mut scratch.march)
        });
    }

    /// Lights the visible point in a unit direction and stores it.
    pub fn finish(
        &self,
        x: usize,
        row: &mut Row<'_>,
        seen: &Seen,
        direction: Vec3,
        share_that_arrives: impl FnMut(Vec3) -> f32,
    ) {
        let painted = seen.part.and_then(|part| self.tracer.color(seen.p, part));
        let color = painted.map_or(self.options.color, Vec3::from_array);
        let look = Look { normal: seen.normal, to_eye: -direction, color };
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = lit(&look, self.options, self.lights, shadow, share_that_arrives);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = seen.depth as f32;
        row.normal[3 * x..][..3].copy_from_slice(&seen.normal.to_array());
        row.object_id[x] = 0;
    }

    /// 0 if the shape occludes the light, else 1.
    fn share_that_arrives(&self, p: Vec3, normal: Vec3, to_light: Vec3, stack: &mut Stack<f32, 1>) -> f32 {
        if normal.dot(to_light) <= 0.0 {
            return 0.0;
        }
        let ray = LocalRay { origin: p + SHADOW_BIAS * normal, direction: to_light, t_max: FAR_T };
        if self.tracer.is_hit(&ray, stack, &mut Work::default()) { 0.0 } else { 1.0 }
    }
}
