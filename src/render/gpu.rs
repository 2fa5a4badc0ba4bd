//! The raymarcher on a graphics device (`shaders/field/raymarch*.wgsl`).
//!
//! Float64 computations are done once per picture, on the CPU: the eye is moved along the viewing axis to just before
//! the box, and the rays of all pixels become linear functions of the pixel in grid space. The upload is a few hundred
//! bytes, the read-back 48 bytes per pixel.

use super::gpu_fields::MarchedField;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::layout::{Light, MarchParams, Pixel};
use crate::gpu::pace::in_pieces;
use crate::grid::Grid;
use crate::picture::{Camera, DirectionalLight, Frame, RaymarchOptions};
use crate::progress::Progress;

/// Side of a workgroup in pixels, as in the shader.
const TILE: u32 = 8;
/// Number of rows of workgroups in the first dispatch, and largest number in any.
const TILE_ROWS: (u64, u64) = (4, 1024);
/// Size of the band of rows that is drawn at a time, bytes of device memory.
const BAND_BYTES: u64 = 64 << 20;

/// Draws a field on its device. `lights` must have unit directions.
pub(super) fn raymarch(
    field: &MarchedField,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    lights: &[DirectionalLight],
    progress: &Progress,
) -> Result<Frame, Error> {
    let context = &field.context;
    let light_buffer = upload_lights(context, lights)?;
    let [width, height] = options.size;
    let start_depth = camera.depth_before([grid.lower, grid.upper]);
    let unit = grid.spacing().min_element();
    let mut params = params(grid, camera, options, lights.len(), start_depth);
    let uniform = context.parameters("picture parameters", &params)?;
    // The picture is drawn in bands of rows that fit in a buffer that the device can bind.
    let share_bytes = 4 * lights.len().max(1) as u64;
    let row_bytes = u64::from(width) * share_bytes.max(size_of::<Pixel>() as u64);
    let fitting =
        u64::from(TILE).max(BAND_BYTES.min(context.max_binding()) / row_bytes / u64::from(TILE) * u64::from(TILE));
    let band_rows = fitting.min(u64::from(height)) as u32;
    let band_pixels = width as usize * band_rows as usize;
    let pixels = context.storage("a picture", (band_pixels * size_of::<Pixel>()) as u64)?;
    let shares = context.storage("light shares", band_pixels as u64 * share_bytes)?;
    let shared = [(0, &uniform), (2, &light_buffer), (3, &pixels), (4, &shares)];
    let shared = shared.into_iter().map(|(binding, buffer)| (binding, buffer.as_entire_binding()));
    let kernel = context.kernel(field.kernel, "main")?;
    let group = context.bind_resources("raymarch", &kernel, shared.chain(field.resources()))?;
    progress.set_total(u64::from(height));
    let mut frame = Frame::new(width as usize, height as usize, lights.len())?;
    let mut found = vec![Pixel::default(); band_pixels];
    for band_start in (0..height).step_by(band_rows as usize) {
        let band_end = height.min(band_start + band_rows);
        (params.band_start, params.band_end) = (band_start, band_end);
        let rows = u64::from((band_end - band_start).div_ceil(TILE));
        in_pieces(context, "the raymarch kernel", rows, TILE_ROWS.0, TILE_ROWS.1, progress, |first, count| {
            params.rays.first_row = band_start + first as u32 * TILE;
            context.write("picture parameters", &uniform, 0, &[params])?;
            progress.advance((count * u64::from(TILE)).min(u64::from(band_end - params.rays.first_row)))?;
            Ok(context.dispatch("raymarch", &kernel, &group, [width.div_ceil(TILE), count as u32, 1])?)
        })?;

        let [start, end] = [band_start, band_end].map(|row| row as usize * width as usize);
        let found = &mut found[..end - start];
        context.read("a picture", &pixels, found, progress)?;
        let shadow = &mut frame.shadow[start * lights.len()..end * lights.len()];
        context.read("light shares", &shares, shadow, progress)?;
        for (i, pixel) in (start..end).zip(found) {
            frame.color[4 * i..][..4].copy_from_slice(&pixel.color);
            frame.steps[i] = pixel.steps;
            if pixel.is_hit == 1 {
                frame.depth[i] = (start_depth + unit * f64::from(pixel.depth)) as f32;
                frame.normal[3 * i..][..3].copy_from_slice(&pixel.normal);
                frame.object_id[i] = 0;
            }
        }
    }
    Ok(frame)
}

/// Uploads lights in the layout of the kernels. `lights` must have unit directions.
pub(crate) fn upload_lights(context: &Context, lights: &[DirectionalLight]) -> Result<wgpu::Buffer, Error> {
    let row = |light: &DirectionalLight| Light {
        direction: light.direction.to_array(),
        color: light.color.to_array(),
        ..Light::default()
    };
    Ok(context.upload("lights", &lights.iter().map(row).collect::<Vec<_>>())?)
}

fn params(grid: &Grid, camera: &Camera, options: &RaymarchOptions, lights: usize, start_depth: f64) -> MarchParams {
    let spacing = grid.spacing();
    // The unit of depth in the shader is the smallest side of a voxel, since world units may have any size.
    let unit = spacing.min_element();
    let relative = spacing / unit;
    let start = (camera.eye - start_depth * camera.back - grid.lower) / spacing - 0.5;
    MarchParams {
        rays: camera.rays_in(unit, relative, options, lights, start, start_depth),
        shape: grid.shape.map(|n| n as u32),
        color: options.color.to_array(),
        relative_spacing: relative.as_vec3().to_array(),
        background: options.background,
        ambient: options.ambient,
        specular: options.specular,
        shininess: options.shininess,
        bias_voxels: options.filter.bias_voxels(),
        ..MarchParams::default()
    }
}
