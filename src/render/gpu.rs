//! The raymarcher on a graphics device (`shaders/raymarch*.wgsl`).
//!
//! What needs float64 is done once a frame, here: the eye is moved along the viewing axis to just before the box, and the
//! rays of all pixels become linear functions of the pixel in grid space. A picture goes up as a few hundred bytes and
//! comes down as 48 bytes a pixel.

use super::gpu_fields::MarchedField;
use super::{Camera, DirectionalLight, Frame, RaymarchOptions, Shadows};
use crate::error::{ArgumentError, Error};
use crate::gpu::layout::{Light, MarchParams, Pixel};
use crate::gpu::pace::in_pieces;
use crate::grid::Grid;
use crate::progress::Progress;
use glam::DVec3;

/// Side of a workgroup, as in the shader.
const TILE: u32 = 8;
/// Rows of workgroups of a dispatch: the first one, and the most.
const TILE_ROWS: (u64, u64) = (4, 1024);
/// A picture is drawn in bands of rows of this size, in device memory.
const BAND_BYTES: u64 = 64 << 20;
/// As in the shader.
const MAX_LIGHTS: usize = 64;

/// Draw what a device marches through. `lights` have unit directions.
pub(super) fn raymarch(
    field: &MarchedField,
    grid: &Grid,
    camera: &Camera,
    options: &RaymarchOptions,
    lights: &[DirectionalLight],
    progress: &Progress,
) -> Result<Frame, Error> {
    let context = &field.context;
    if lights.len() > MAX_LIGHTS {
        let problem = format!("{} lights, a graphics device draws with {MAX_LIGHTS} at most", lights.len());
        return Err(ArgumentError::new("light_directions", problem).into());
    }
    let [width, height] = options.size;
    let start_depth = depth_before_box(grid, camera);
    let unit = grid.spacing().min_element();
    let mut params = params(grid, camera, options, lights.len(), start_depth);
    let light_rows: Vec<Light> = lights
        .iter()
        .map(|light| Light { direction: light.direction.to_array(), color: light.color.to_array(), ..Light::default() })
        .collect();
    let uniform = context.parameters("picture parameters", &params)?;
    let light_buffer = context.upload("lights", &light_rows)?;
    // In bands of rows, each in a buffer that the device can bind.
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
    let mut frame = Frame::new(width as usize, height as usize, lights.len());
    let mut found = vec![Pixel::default(); band_pixels];
    for band_start in (0..height).step_by(band_rows as usize) {
        let band_end = height.min(band_start + band_rows);
        (params.band_start, params.band_end) = (band_start, band_end);
        let rows = u64::from((band_end - band_start).div_ceil(TILE));
        in_pieces(context, "the raymarch kernel", rows, TILE_ROWS.0, TILE_ROWS.1, progress, |first, count| {
            params.first_row = band_start + first as u32 * TILE;
            context.write("picture parameters", &uniform, 0, &[params])?;
            progress.advance((count * u64::from(TILE)).min(u64::from(band_end - params.first_row)))?;
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

/// Depth of the box's nearest corner, or zero if the box reaches behind the eye.
fn depth_before_box(grid: &Grid, camera: &Camera) -> f64 {
    let corner = |i: usize| {
        DVec3::new(
            if i & 1 == 0 { grid.lower.x } else { grid.upper.x },
            if i & 2 == 0 { grid.lower.y } else { grid.upper.y },
            if i & 4 == 0 { grid.lower.z } else { grid.upper.z },
        )
    };
    let depth = |p: DVec3| (camera.eye - p).dot(camera.back);
    // A little nearer, so that rounding does not put the start inside.
    let nearest = (0..8).map(|i| depth(corner(i))).fold(f64::INFINITY, f64::min);
    (nearest - 0.01 * grid.diagonal()).max(0.0)
}

fn params(grid: &Grid, camera: &Camera, options: &RaymarchOptions, lights: usize, start_depth: f64) -> MarchParams {
    let spacing = grid.spacing();
    let to_f32 = |v: DVec3| v.as_vec3().to_array();
    let (forward, right, up) = (-camera.back, camera.right, camera.up);
    // A unit of depth is the smallest side of a voxel there: world units may be of any size.
    let relative = spacing / spacing.min_element();
    let start = camera.eye + start_depth * forward;
    MarchParams {
        shape: grid.shape.map(|n| n as u32),
        light_count: lights as u32,
        start: to_f32((start - grid.lower) / spacing - 0.5),
        width: options.size[0],
        start_right: to_f32(start_depth * right / spacing),
        height: options.size[1],
        start_up: to_f32(start_depth * up / spacing),
        first_row: 0,
        forward: to_f32(forward / relative),
        ambient: options.ambient,
        right: to_f32(right / relative),
        specular: options.specular,
        up: to_f32(up / relative),
        shininess: options.shininess,
        world_forward: to_f32(forward),
        pixel: camera.pixel_size(options.size[1]) as f32,
        world_right: to_f32(right),
        shadows: u32::from(options.shadows == Shadows::Hard),
        world_up: to_f32(up),
        color: options.color.to_array(),
        relative_spacing: to_f32(relative),
        background: options.background,
        ..MarchParams::default()
    }
}
