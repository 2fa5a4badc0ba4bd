//! Pictures of a stored field: its zero level set, viewed by a camera and lit.
//!
//! # Theory
//!
//! For each pixel, a ray through its centre ([`camera`]) is clipped to the box of the grid and traced to the first root
//! of the trilinear field ([`march`], [`empty`], [`cubic`]), then shaded ([`shade`]). The ray is computed in f64 and
//! transformed to grid space, where voxel centres are integers and f32 is precise enough at any scale and offset of the
//! world. Everything after that is f32 with bounded loops, so that a shader can do the same.
//!
//! The picture shows the solid "field <= 0, inside the box". Where the box cuts it, the cut is drawn as a flat face. A
//! camera inside the solid sees it at depth 0.
//!
//! # Practice
//!
//! [`raymarch`] runs on all cores by rows, counts its progress in rows and stops when it is cancelled. Its cost is
//! proportional to the steps in `Frame::steps`, plus about as many for each light.

pub mod blocks;
pub mod bricks;
pub mod camera;
pub mod cubic;
pub mod empty;
mod gpu;
mod gpu_fields;
#[cfg(test)]
mod gpu_tests;
pub mod march;
pub(crate) mod shade;

pub use camera::Camera;
pub(crate) use gpu::upload_lights;

use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error, choice};
use crate::gpu::{Context, Place};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::device::DeviceField;
use crate::volume::sparse::SparseView;
use crate::volume::{FieldView, Texel, Trilinear};
use blocks::Blocks;
use bricks::MaskedBricks;
use glam::{DVec3, Vec3};
use gpu_fields::{MarchedField, nested_grid};
use march::{Marcher, clip_to_box};
use rayon::prelude::*;
use shade::{Shader, Surface};
use std::sync::Arc;

/// A light at infinite distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectionalLight {
    /// Direction in which the light travels, world space, any length.
    pub direction: Vec3,
    /// Linear RGB. A white light of value 1 lights a surface that faces it to the surface's own colour.
    pub color: Vec3,
}

/// Kind of shadows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shadows {
    /// No shadows: every light reaches every surface.
    None,
    /// Hard shadows: a light reaches a point completely or not at all.
    #[default]
    Hard,
}

impl Shadows {
    /// Converts the public name of a kind of shadows.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("shadows", name, &[("none", Self::None), ("hard", Self::Hard)])
    }
}

/// Interpolation between the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Filter {
    /// Trilinear interpolation in float32; a hit is its root.
    #[default]
    Linear,
    /// The texture hardware of a graphics device, with rounded weights and half floats.
    Hardware,
}

impl Filter {
    /// Converts the public name of a filter.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("filter", name, &[("linear", Self::Linear), ("hardware", Self::Hardware)])
    }
}

/// Options of a picture. The names are those of the Python interface, which defines the defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct RaymarchOptions {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Lights; an empty list leaves ambient light only.
    pub lights: Vec<DirectionalLight>,
    /// Ambient light, mostly from above (+Y), as a fraction of a light of colour 1.
    pub ambient: f32,
    /// Linear RGB of the surface.
    pub color: Vec3,
    /// Strength of the highlight.
    pub specular: f32,
    /// Sharpness of the highlight, the exponent of Blinn-Phong.
    pub shininess: f32,
    /// Linear RGBA of pixels without a hit.
    pub background: [f32; 4],
    pub shadows: Shadows,
    pub filter: Filter,
}

#[cfg(test)]
impl Default for RaymarchOptions {
    /// Simple options for tests.
    fn default() -> Self {
        Self {
            size: [512, 512],
            lights: vec![DirectionalLight { direction: Vec3::new(0.3, -0.7, -0.6), color: Vec3::ONE }],
            ambient: 0.2,
            color: Vec3::splat(0.8),
            specular: 0.25,
            shininess: 32.0,
            background: [1.0; 4],
            shadows: Shadows::Hard,
            filter: Filter::Linear,
        }
    }
}

/// A picture and its arrays by rows, row 0 on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    pub width: usize,
    pub height: usize,
    /// Number of lights per pixel in `shadow`.
    pub lights: usize,
    /// Linear RGBA, 4 values per pixel.
    pub color: Vec<f32>,
    /// Distance along the viewing axis, world units; infinite without a hit.
    pub depth: Vec<f32>,
    /// Unit normal in world space, 3 values per pixel; zero without a hit.
    pub normal: Vec<f32>,
    /// 0 for the field, -1 without a hit.
    pub object_id: Vec<i32>,
    /// Fraction of each light that arrives, 1 lit, 0 dark, `lights` values per pixel; 1 without a hit.
    pub shadow: Vec<f32>,
    /// Number of cells visited and empty regions skipped by the ray of the pixel.
    pub steps: Vec<u32>,
}

/// Largest number of pixels of a picture: 16384 x 16384, about 12 GiB of arrays.
const MAX_PIXELS: u64 = 1 << 28;

/// Draws the zero level set of a field.
pub fn raymarch<F: Blocks>(
    field: F,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    options.check()?;
    if options.filter == Filter::Hardware {
        let problem = "\"hardware\" needs a graphics device, and this picture is drawn on the CPU; use device=\"gpu\"";
        return Err(ArgumentError::new("filter", problem).into());
    }
    let lights = options.unit_lights()?;
    let marcher = Marcher::new(field, progress)?;
    let shader = Shader::new(&marcher, options, &lights);
    let view = View {
        camera,
        eye_grid: marcher.field.grid_from_world(camera.eye),
        spacing: marcher.field.grid().spacing(),
        shape: marcher.field.shape(),
        marcher: &marcher,
        shader,
        options,
    };

    Frame::by_pixels(options.size, lights.len(), progress, |x, y, row| view.draw_pixel(x, y, row))
}

/// Location of the samples of a field.
#[derive(Debug, Clone, Copy)]
pub enum Source<'a> {
    /// Samples on the host, x fastest.
    Host(&'a [f32]),
    Device(&'a DeviceField),
}

/// Draws at a place. Samples that are elsewhere are copied there first.
pub fn raymarch_at(
    place: &Place,
    source: Source<'_>,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    let read: Vec<f32>;
    let samples = match (place, source) {
        (Place::Gpu(context), Source::Device(field)) if Arc::ptr_eq(context, field.context()) => {
            return raymarch_on_device(field, grid, camera, options, progress);
        }
        (_, Source::Device(field)) => {
            read = field.read(progress)?;
            &read
        }
        (_, Source::Host(samples)) => samples,
    };
    let view = FieldView::new(*grid, samples)?;
    match place {
        Place::Cpu => raymarch(view, camera, options, progress),
        Place::Gpu(context) => {
            let field = DeviceField::upload(context, grid.shape, view.distances())?;
            raymarch_on_device(&field, grid, camera, options, progress)
        }
    }
}

/// Draws samples in any encoding at a place. A graphics device decodes them when it reads them, except for its texture
/// hardware, which receives decoded values.
pub fn raymarch_view<T: Texel>(
    place: &Place,
    field: FieldView<'_, T>,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    match place {
        Place::Cpu => raymarch(field, camera, options, progress),
        Place::Gpu(context) if options.filter == Filter::Linear && T::ENCODING != Encoding::Float32 => {
            let upload = || MarchedField::encoded(context, field);
            draw_on_device(upload, field.grid(), camera, options, progress)
        }
        Place::Gpu(_) => raymarch_at(place, Source::Host(&field.decoded()), field.grid(), camera, options, progress),
    }
}

/// Draws a sparse field at a place, from its bricks. The texture hardware of a graphics device receives the whole grid.
pub fn raymarch_sparse<T: Texel>(
    place: &Place,
    field: SparseView<'_, T>,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    match place {
        Place::Cpu => raymarch(MaskedBricks::new(field, progress)?, camera, options, progress),
        Place::Gpu(context) if options.filter == Filter::Linear => {
            let upload = || MarchedField::sparse(context, field, progress);
            draw_on_device(upload, field.grid(), camera, options, progress)
        }
        Place::Gpu(_) => {
            raymarch_at(place, Source::Host(&field.dense(progress)?), field.grid(), camera, options, progress)
        }
    }
}

/// Draws nested fields on a device, finest first. Each is twice as fine as the one around it, and joined to it as in
/// `scene::nested`.
pub fn raymarch_nested(
    context: &Arc<Context>,
    levels: &[FieldView<'_>],
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    let grid = nested_grid(levels).ok_or_else(|| ArgumentError::new("levels", "are empty"))?;
    draw_on_device(|| MarchedField::nested(context, levels, &grid), &grid, camera, options, progress)
}

/// Draws a field in device memory.
///
/// The picture equals that of [`raymarch`] to float32 rounding with [`Filter::Linear`]. `Frame::steps` counts cells
/// only, since the device does not leap.
pub fn raymarch_on_device(
    field: &DeviceField,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    draw_on_device(|| MarchedField::dense(field, grid, options.filter), grid, camera, options, progress)
}

/// Checks the request, copies the field to its device, and draws it there.
fn draw_on_device(
    field: impl FnOnce() -> Result<MarchedField, Error>,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    options.check()?;
    let lights = options.unit_lights()?;
    gpu::raymarch(&field()?, grid, camera, options, &lights, progress)
}

/// Data shared by all pixels.
struct View<'a, F> {
    camera: &'a Camera,
    eye_grid: DVec3,
    spacing: DVec3,
    shape: DVec3,
    marcher: &'a Marcher<F>,
    shader: Shader<'a, F>,
    options: &'a RaymarchOptions,
}

impl<F: Blocks> View<'_, F> {
    /// Fills pixel `x` of row `y`. The row is initialised to "no hit".
    fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);

        // Multiples of `direction` are depths, in world and in grid space.
        let direction = self.camera.pixel_direction(x as u32, y as u32, self.options.size);
        let direction_grid = direction / self.spacing;
        let Some(clipped) = clip_to_box(self.eye_grid, direction_grid, self.shape) else { return };
        let march = self.marcher.march(&clipped.ray);
        row.steps[x] = march.steps;
        let Some(hit) = march.hit else { return };

        let p_grid = clipped.ray.origin + hit.t * clipped.ray.direction;
        let to_eye = -direction.normalize().as_vec3();
        let normal = match (hit.at_start, clipped.enter_axis) {
            // The hit lies on a face of the box, which cuts the solid.
            (true, Some(axis)) => {
                let mut normal = Vec3::ZERO;
                normal[axis] = to_eye[axis].signum();
                normal
            }
            // The eye is inside the solid.
            (true, None) => to_eye,
            (false, _) => self.shader.normal(p_grid, to_eye),
        };
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = self.shader.shade(&Surface { p_grid, normal, to_eye }, shadow);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = (clipped.t_enter + hit.t as f64 / direction_grid.length()) as f32;
        row.normal[3 * x..][..3].copy_from_slice(&normal.to_array());
        row.object_id[x] = 0;
    }
}

impl RaymarchOptions {
    pub(crate) fn check(&self) -> Result<(), Error> {
        let error = |argument, problem: String| Err(ArgumentError::new(argument, problem).into());
        let [width, height] = self.size;
        if width == 0 || height == 0 || width as u64 * height as u64 > MAX_PIXELS {
            return error("size", format!("expected 1 to {MAX_PIXELS} pixels, got {width} x {height}"));
        }
        if !(self.ambient.is_finite() && self.ambient >= 0.0) {
            return error("ambient", format!("must be finite and at least 0, got {}", self.ambient));
        }
        if !self.color.is_finite() {
            return error("color", format!("must be finite, got {}", self.color));
        }
        if !self.specular.is_finite() {
            return error("specular", format!("must be finite, got {}", self.specular));
        }
        if !(self.shininess.is_finite() && self.shininess >= 0.0) {
            return error("shininess", format!("must be finite and at least 0, got {}", self.shininess));
        }
        Ok(())
    }

    /// The lights with unit directions.
    pub(crate) fn unit_lights(&self) -> Result<Vec<DirectionalLight>, Error> {
        let unit = |(i, light): (usize, &DirectionalLight)| {
            let direction = light.direction.as_dvec3().normalize_or_zero().as_vec3();
            if direction == Vec3::ZERO {
                let problem = format!("[{i}] is {}, expected a finite direction that is not zero", light.direction);
                return Err(ArgumentError::new("light_directions", problem).into());
            }
            if !light.color.is_finite() {
                let problem = format!("[{i}] is {}, expected finite numbers", light.color);
                return Err(ArgumentError::new("light_colors", problem).into());
            }
            Ok(DirectionalLight { direction, color: light.color })
        };
        self.lights.iter().enumerate().map(unit).collect()
    }
}

/// One row of every array of a frame.
pub(crate) struct Row<'a> {
    pub lights: usize,
    pub color: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub normal: &'a mut [f32],
    pub object_id: &'a mut [i32],
    pub shadow: &'a mut [f32],
    pub steps: &'a mut [u32],
}

impl Frame {
    /// A picture without any hit.
    pub(crate) fn new(width: usize, height: usize, lights: usize) -> Self {
        let pixels = width * height;
        Self {
            width,
            height,
            lights,
            color: vec![0.0; 4 * pixels],
            depth: vec![f32::INFINITY; pixels],
            normal: vec![0.0; 3 * pixels],
            object_id: vec![-1; pixels],
            shadow: vec![1.0; lights * pixels],
            steps: vec![0; pixels],
        }
    }

    /// A picture that `draw_pixel` fills one pixel at a time: pixel `x` of row `y`, initialised to "no hit". Runs on
    /// all cores by rows, which the progress counts.
    pub(crate) fn by_pixels(
        size: [u32; 2],
        lights: usize,
        progress: &Progress,
        draw_pixel: impl Fn(usize, usize, &mut Row<'_>) + Sync,
    ) -> Result<Self, Error> {
        let [width, height] = size.map(|n| n as usize);
        progress.set_total(height as u64);
        let mut frame = Self::new(width, height, lights);
        frame.rows().into_par_iter().enumerate().try_for_each(|(y, mut row)| {
            for x in 0..width {
                draw_pixel(x, y, &mut row);
            }
            progress.advance(1)
        })?;
        Ok(frame)
    }

    pub(crate) fn rows(&mut self) -> Vec<Row<'_>> {
        let (width, lights) = (self.width, self.lights);
        let mut shadow = self.shadow.as_mut_slice();
        self.color
            .chunks_mut(4 * width)
            .zip(self.depth.chunks_mut(width))
            .zip(self.normal.chunks_mut(3 * width))
            .zip(self.object_id.chunks_mut(width))
            .zip(self.steps.chunks_mut(width))
            .map(|((((color, depth), normal), object_id), steps)| {
                // `shadow` is not chunked like the other arrays, since its rows are empty without lights.
                let (row, rest) = std::mem::take(&mut shadow).split_at_mut(lights * width);
                shadow = rest;
                Row { lights, color, depth, normal, object_id, shadow: row, steps }
            })
            .collect()
    }
}

#[cfg(test)]
mod tests;
