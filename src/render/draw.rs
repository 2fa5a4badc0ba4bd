//! Pictures of dense, encoded, sparse and nested fields, on the CPU or on a device.

use super::gpu;
use super::gpu_fields::{MarchedField, nested_grid};
use super::shade::{PixelHit, Shader};
use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error};
use crate::gpu::{Context, Place};
use crate::grid::Grid;
use crate::march::blocks::Blocks;
use crate::march::bricks::MaskedBricks;
use crate::march::marcher::{Marcher, clip_to_box};
use crate::march::tiles::Tiles;
use crate::picture::{Camera, Filter, Frame, RaymarchOptions, Row};
use crate::progress::Progress;
use crate::volume::device::DeviceField;
use crate::volume::sparse::SparseView;
use crate::volume::{FieldView, Texel, Trilinear};
use glam::{DVec3, Vec3};
use std::sync::Arc;

/// Draws the zero level set of a field.
pub fn raymarch<F: Blocks>(
    field: F,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    options.check()?;
    let lights = options.directional_lights()?;
    let marcher = Marcher::new(field, progress)?;
    let shader = Shader::new(&marcher, options, &lights);
    let view = RaymarchView {
        camera,
        spacing: marcher.field.grid().spacing(),
        tiles: Tiles::new(&marcher, camera, options.size, progress)?,
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
    /// Samples in the memory of a device.
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

/// Draws samples in any encoding at a place. A graphics device decodes them when it reads them if they are interpolated
/// linearly; otherwise it receives decoded values.
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
        Place::Gpu(_) => {
            raymarch_at(place, Source::Host(&field.decoded(progress)?), field.grid(), camera, options, progress)
        }
    }
}

/// Draws a sparse field at a place, from its bricks. A graphics device receives the whole grid unless the field is
/// interpolated linearly.
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

/// Draws nested fields on a device, finest first. Each is twice as fine as the next, and joined to it as in
/// `scene::fields::nested`.
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
/// The picture equals the picture of [`raymarch`] to float32 rounding with [`Filter::Linear`]. `Frame::steps` counts
/// cells only, since the device does not leap.
pub fn raymarch_on_device(
    field: &DeviceField,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    draw_on_device(|| Ok(MarchedField::dense(field, options.filter)?), grid, camera, options, progress)
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
    let lights = options.directional_lights()?;
    gpu::raymarch(&field()?, grid, camera, options, &lights, progress)
}

/// Data shared by all pixels.
struct RaymarchView<'a, F: Blocks> {
    camera: &'a Camera,
    spacing: DVec3,
    tiles: Tiles,
    shape: DVec3,
    marcher: &'a Marcher<F>,
    shader: Shader<'a, F>,
    options: &'a RaymarchOptions,
}

impl<F: Blocks> RaymarchView<'_, F> {
    /// Fills pixel `x` of row `y`. The row is initialised to "no hit".
    fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);

        let Some(depths) = self.tiles.depths(x, y) else { return };
        // Multiples of `direction` are depths, in world and in grid space.
        let start = self.camera.pixel_start(x as u32, y as u32, self.options.size);
        let direction = self.camera.pixel_direction(x as u32, y as u32, self.options.size);
        let start_grid = self.marcher.field.grid_from_world(start);
        let direction_grid = direction / self.spacing;
        let Some(clipped) = clip_to_box(start_grid, direction_grid, self.shape) else { return };
        let voxels_per_depth = direction_grid.length();
        let Some(ray) = clipped.between(depths, voxels_per_depth) else { return };
        let march = self.marcher.trace(&ray, self.options.filter);
        row.steps[x] = march.steps;
        let Some(hit) = march.hit else { return };

        let p_grid = ray.origin + hit.t * ray.direction;
        let to_eye = -direction.normalize().as_vec3();
        // The hit lies on a face of the box, which cuts the solid, or on a face of a voxel.
        let face = if hit.at_start { clipped.enter_axis } else { hit.face };
        let normal = match face {
            Some(axis) => {
                let mut normal = Vec3::ZERO;
                normal[axis] = to_eye[axis].signum();
                normal
            }
            // The eye is inside the solid.
            None if hit.at_start => to_eye,
            None => self.shader.normal(p_grid, to_eye),
        };
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = self.shader.shade(&PixelHit { p_grid, normal, to_eye }, shadow);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = (clipped.t_enter + hit.t as f64 / voxels_per_depth) as f32;
        row.normal[3 * x..][..3].copy_from_slice(&normal.to_array());
        row.object_id[x] = 0;
    }
}
