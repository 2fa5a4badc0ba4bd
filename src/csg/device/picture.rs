//! The pixels of a picture of a shape: rays, visible points and their light. The CPU traces the rays itself; for a
//! graphics device it lights the points that the device found.

use crate::csg::evaluation::program::Stack;
use crate::csg::parts::trace::{ShapeRay, TraceWork, Tracer};
use crate::error::Error;
use crate::gpu::constants::csg_draw::{FAR_T, SHADOW_BIAS};
use crate::gpu::layout::PictureRays;
use crate::picture::{Camera, DirectionalLight, Frame, RaymarchOptions, Row};
use crate::progress::Progress;
use crate::render::shade::lit;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};

/// A picture and its cost.
#[derive(Debug)]
pub(crate) struct Drawing {
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

/// Draws on the CPU.
pub(crate) fn draw_on_cpu(view: &ShapeView<'_>, progress: &Progress) -> Result<Drawing, Error> {
    let [width, height] = view.options.size.map(|n| n as usize);
    progress.set_total(height as u64);
    let mut frame = Frame::new(width, height, view.lights.len())?;
    let evaluations = AtomicU64::new(0);
    let [columns, lines] = view.window();
    frame.rows().into_par_iter().enumerate().try_for_each_init(PixelScratch::default, |scratch, (y, mut row)| {
        scratch.work = TraceWork::default();
        row.color.as_chunks_mut().0.fill(view.options.background);
        let columns = if lines.contains(&y) { columns.clone() } else { 0..0 };
        for x in columns {
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
pub(crate) struct PixelScratch {
    march: Stack<f32, 1>,
    slope: Stack<f64, 6>,
    work: TraceWork,
}

/// Data shared by all pixels.
pub(crate) struct ShapeView<'a> {
    pub tracer: &'a Tracer<'a>,
    pub camera: &'a Camera,
    pub options: &'a RaymarchOptions,
    /// Lights with unit directions.
    pub lights: &'a [DirectionalLight],
    pub is_eye_inside: bool,
    pub rays: PixelRays,
}

/// The visible point of a pixel, in local units except for the depth.
pub(crate) struct VisiblePoint {
    pub p: Vec3,
    pub depth: f64,
    pub normal: Vec3,
    /// Index of the part; None uses the colour of the options.
    pub part: Option<u32>,
}

/// The rays of a picture in local units. They start on a plane just before the bounds, computed in float64, so that
/// float32 is precise enough for an eye at any distance. Twin of `shaders/shared/picture/picture_rays.wgsl`.
pub(crate) struct PixelRays {
    pub rays: PictureRays,
    /// Depth of the plane, and length of one local unit, world units.
    start_depth: f64,
    scale: f64,
    middle: [f32; 2],
    forward: Vec3,
}

impl PixelRays {
    pub(crate) fn new(tracer: &Tracer<'_>, camera: &Camera, options: &RaymarchOptions, light_count: usize) -> Self {
        let frame = tracer.solid.frame;
        let start_depth = camera.depth_before(tracer.bounds.map(|corner| frame.world(corner.as_dvec3())));
        let start = frame.local(camera.eye - start_depth * camera.back);
        let rays = camera.rays(frame.scale, options, light_count, start, start_depth);
        Self {
            start_depth,
            scale: frame.scale,
            middle: options.size.map(|n| 0.5 * n as f32),
            forward: Vec3::from_array(rays.forward),
            rays,
        }
    }

    pub(crate) fn through(&self, x: usize, y: usize) -> ShapeRay {
        let rays = &self.rays;
        let along_right = (x as f32 + 0.5 - self.middle[0]) * rays.pixel;
        let along_up = (self.middle[1] - 0.5 - y as f32) * rays.pixel;
        let [start, start_right, start_up] = [rays.start, rays.start_right, rays.start_up].map(Vec3::from_array);
        let [right, up] = [rays.right, rays.up].map(Vec3::from_array);
        ShapeRay {
            origin: start + along_right * start_right + along_up * start_up,
            direction: (self.forward + along_right * right + along_up * up).normalize(),
            t_max: FAR_T,
        }
    }

    /// Depth of the point at `t`, world units.
    pub(crate) fn depth(&self, ray: &ShapeRay, t: f32) -> f64 {
        self.start_depth + f64::from(t) * f64::from(self.forward.dot(ray.direction)) * self.scale
    }
}

impl ShapeView<'_> {
    /// Columns and rows of the pixels that may show the shape.
    fn window(&self) -> [Range<usize>; 2] {
        if self.is_eye_inside {
            return self.options.size.map(|n| 0..n as usize);
        }
        let frame = self.tracer.solid.frame;
        self.camera.window(self.tracer.bounds.map(|corner| frame.world(corner.as_dvec3())), self.options.size)
    }

    /// Fills pixel `x` of row `y`. The row is initialised to "no hit", and its colours to the background.
    pub(crate) fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>, scratch: &mut PixelScratch) {
        if self.is_eye_inside {
            let unit = self.camera.pixel_direction(x as u32, y as u32, self.options.size).normalize().as_vec3();
            let p = self.tracer.solid.frame.local(self.camera.eye).as_vec3();
            let visible = VisiblePoint { p, depth: 0.0, normal: -unit, part: None };
            return self.finish(x, row, &visible, unit, |to_light| {
                self.share_that_arrives(p, visible.normal, to_light, &mut scratch.march)
            });
        }
        let ray = self.rays.through(x, y);
        let before = scratch.work.steps;
        let hit = self.tracer.first_hit(&ray, &mut scratch.march, &mut scratch.work);
        row.steps[x] = scratch.work.steps - before;
        let Some(hit) = hit else { return };
        let p = ray.origin + hit.t * ray.direction;
        // A parallel ray that starts inside the solid hits it there. The surface faces the camera.
        let starts_inside = hit.t == 0.0 && self.camera.is_parallel();
        let normal = (!starts_inside)
            .then(|| self.tracer.normal(p, ray.direction, hit.part, &mut scratch.slope))
            .flatten()
            .unwrap_or(-ray.direction);
        let visible = VisiblePoint { p, depth: self.rays.depth(&ray, hit.t), normal, part: Some(hit.part) };
        self.finish(x, row, &visible, ray.direction, |to_light| {
            self.share_that_arrives(p, normal, to_light, &mut scratch.march)
        });
    }

    /// Lights the visible point in a unit direction and stores it.
    pub(crate) fn finish(
        &self,
        x: usize,
        row: &mut Row<'_>,
        visible: &VisiblePoint,
        direction: Vec3,
        share_that_arrives: impl FnMut(Vec3) -> f32,
    ) {
        let painted = visible.part.and_then(|part| self.tracer.color(visible.p, part));
        let color = painted.map_or(self.options.color, Vec3::from_array);
        let point = self.options.lit_point(visible.normal, -direction, color);
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = lit(&point, self.options, self.lights, shadow, share_that_arrives);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = visible.depth as f32;
        row.normal[3 * x..][..3].copy_from_slice(&visible.normal.to_array());
        row.object_id[x] = 0;
    }

    /// 0 if the shape occludes the light, else 1.
    fn share_that_arrives(&self, p: Vec3, normal: Vec3, to_light: Vec3, stack: &mut Stack<f32, 1>) -> f32 {
        if normal.dot(to_light) <= 0.0 {
            return 0.0;
        }
        let ray = ShapeRay { origin: p + SHADOW_BIAS * normal, direction: to_light, t_max: FAR_T };
        if self.tracer.is_hit(&ray, stack, &mut TraceWork::default()) { 0.0 } else { 1.0 }
    }
}
