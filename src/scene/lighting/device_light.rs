//! The light on the faces that a device found, without leaving the device: the beams are made from the picture in its
//! memory (`shaders/scene/scene_surfaces.wgsl`), and only their results are read back.
//!
//! It applies to faces of meshes under hard and soft shadows without occlusion, in pictures whose rays start at the
//! eye. Everything else is left to [`super::device_beams`]: fields, translucent surfaces, light through objects, and
//! pixels that the CPU drew.

use super::light_buffer::{LightBuffer, parts_of, stride};
use super::pass::Pass;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::constants::scene_counts::{
    GROUP, SPREAD, STAGE_CONES, STAGE_CUTS, STAGE_DISCS, STAGE_EDGES, STAGE_PARTS, STAGE_RAYS, STAGE_TILES, TILE,
};
use crate::gpu::layout::{BeamParams, BeamResult, CutParams, SurfaceLight, SurfaceParams, TileParams};
use crate::gpu::pace::{Items, by_rate};
use crate::gpu::pipeline::{BoundRange, Dispatch, DispatchSize, whole};
use crate::gpu::shader::Instead;
use crate::gpu::timer::Timer;
use crate::progress::Progress;
use crate::scene::content::options::SceneShadows;
use crate::scene::device::device_buffers::{Buffers, STAGE_BYTES};
use crate::scene::device::device_scene::{DeviceScene, work_of};
use crate::scene::light::light_rays::{LightWork, PARTS};
use crate::scene::light::lit_surface::{BIAS_TRIANGLE, LitSurface, SceneLight};
use crate::scene::light::occlusion::NearOccluders;
use crate::scene::visibility::gbuffer::DeviceVisibility;
use rayon::prelude::*;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Largest distance of the eye from the middle of the scene, scene units. The device computes positions in float32
/// along the ray, and a position must be precise to a fraction of a voxel.
const MOST_DISTANCE: f64 = 16.0;
/// Value of [`BeamResult::is_proven`] for a disc whose fraction is the mean of its parts, as in the shader.
const DIVIDED: u32 = 2;
/// Largest number of results of beams in memory at a time: 40 MiB.
const MOST_RESULTS: u64 = 1 << 21;
/// Number of tiles of the first submission if the time for one is unknown: 256 beams of one light.
const FIRST_TILES: u64 = 4;

/// Lights the faces that the device found. Returns false if the method does not apply to the picture.
pub(crate) fn light_faces(pass: &Pass<'_>, device: &DeviceScene, evaluated: &mut LightBuffer) -> Result<bool, Error> {
    let (Some(visible), Some(corners)) = (&pass.buffer.visible, device.faces()) else { return Ok(false) };
    let scene = pass.traced.scene;
    let eye = scene.scene_from_world(pass.buffer.view.camera.eye);
    let lights = match pass.options.shadows {
        SceneShadows::None => 0,
        SceneShadows::Hard | SceneShadows::Soft => pass.lights.lights.len(),
        SceneShadows::Area(_) => return Ok(false),
    };
    let is_exact = eye.length() <= MOST_DISTANCE && !pass.buffer.view.camera.is_parallel();
    if lights == 0 || pass.options.occlusion.is_some() || !is_exact {
        return Ok(false);
    }
    let mut view = SurfaceParams {
        eye: eye.as_vec3().to_array(),
        width: pass.options.size[0],
        ray: visible.rays[0].as_vec3().to_array(),
        stride: visible.stride,
        ray_x: visible.rays[1].as_vec3().to_array(),
        light_count: lights as u32,
        ray_y: visible.rays[2].as_vec3().to_array(),
        bias_voxels: BIAS_TRIANGLE,
        ..SurfaceParams::default()
    };
    for (row, light) in view.lights.iter_mut().zip(&pass.lights.lights[..lights]) {
        *row = light_row(light, pass.options.shadows);
    }
    let rows = &view.lights[..lights];
    let has_cones = rows.iter().any(|row| row.size > 0.0);
    let has_rays = rows.iter().any(|row| row.size <= 0.0);
    let faces = pass.buffer.rows.iter().flatten().filter(|layer| layer.is_from_device).count();
    if faces == 0 {
        return Ok(true);
    }
    let context = device.context();
    let tiles = Tiles::of(pass.options.size);
    (view.height, view.tile_columns) = (pass.options.size[1], tiles.columns);
    (view.tile_count, view.tile_step) = (tiles.count, tiles.step);
    let tile_results = u64::from(GROUP) * lights as u64;
    let chunk = (MOST_RESULTS / tile_results).min(tiles.places());
    let buffers = device.light.on(context, &device.groups, chunk * tile_results)?;
    context.write("view of surfaces", &buffers.view, 0, &[view])?;
    buffers.set_beam_params(context, DeviceScene::beam_params(pass.traced))?;
    let has_far = pass.traced.far.is_some();
    let work = FaceLight::new(device, visible, corners, &buffers, [has_cones, has_rays], has_far)?;
    let cost = (faces * lights) as f64 / tiles.places() as f64;
    for start in (0..tiles.places()).step_by(chunk as usize) {
        let count = chunk.min(tiles.places() - start);
        let beam_results = work.beam_results(start, count, tile_results, cost, pass.progress)?;
        let range = start as u32..(start + count) as u32;
        take(pass, evaluated, &tiles, range, &beam_results)?;
    }
    Ok(true)
}

/// The tiles of a picture: squares of [`TILE`] pixels. The device processes them in an order in which [`SPREAD`]
/// consecutive tiles are spread evenly over the picture: a tile's place in this order, `place`, is at
/// `place % SPREAD * step + place / SPREAD` in the picture.
struct Tiles {
    columns: u32,
    count: u32,
    step: u32,
}

impl Tiles {
    fn of([width, height]: [u32; 2]) -> Self {
        let columns = width.div_ceil(TILE);
        let count = columns * height.div_ceil(TILE);
        Self { columns, count, step: count.div_ceil(SPREAD) }
    }

    /// Number of places in the order, some of which may have no tile.
    fn places(&self) -> u64 {
        u64::from(self.step) * u64::from(SPREAD)
    }

    /// The place of a pixel's tile, and the number of the pixel in its tile: blocks of 4 x 2 pixels, row by row.
    fn place(&self, x: u32, y: u32) -> (u32, u32) {
        let tile = y / TILE * self.columns + x / TILE;
        let lane = (x & 3) | (y & 1) << 2 | (x & 4) << 1 | (y & 6) << 3;
        (tile % self.step * SPREAD + tile / self.step, lane)
    }
}

fn light_row(light: &SceneLight, shadows: SceneShadows) -> SurfaceLight {
    let (place, size, is_point) = match *light {
        SceneLight::Directional { to_light, slope, .. } => (to_light, slope, 0),
        SceneLight::Point { position, radius, .. } => (position, radius as f32, 1),
    };
    let size = if shadows == SceneShadows::Soft { size } else { 0.0 };
    SurfaceLight { place: place.as_vec3().to_array(), size, is_point, ..SurfaceLight::default() }
}

/// Stores the answers for a range of places of tiles.
fn take(
    pass: &Pass<'_>,
    evaluated: &mut LightBuffer,
    tiles: &Tiles,
    range: Range<u32>,
    beam_results: &[BeamResult],
) -> Result<(), Error> {
    let scene = pass.traced.scene;
    let lights = pass.lights.lights.len();
    evaluated.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut total = LightWork::default();
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            let (place, lane) = tiles.place(layer.x, y as u32);
            if !layer.is_from_device || !range.contains(&place) {
                continue;
            }
            let surface = LitSurface::new(scene, pass.buffer, y, layer);
            if surface.scatters(scene) {
                continue;
            }
            let first = ((place - range.start) * GROUP + lane) as usize * lights;
            let mut found = beam_results[first..][..lights].iter();
            let values = &mut row.values[i * stride(lights)..][..stride(lights)];
            if let Some(work) = take_pixel(pass, &surface, &mut found, values) {
                row.work[i] = work;
                row.is_evaluated[i] = true;
                total += work;
            }
        }
        pass.counters.add(total);
        pass.progress.check()
    })
}

/// The light on a surface; None if an answer is missing. The CPU traces triangles. Where sheets cover some of the parts
/// of a divided disc, the fractions of the parts are missing.
fn take_pixel(
    pass: &Pass<'_>,
    surface: &LitSurface<'_>,
    beam_results: &mut std::slice::Iter<'_, BeamResult>,
    values: &mut [f32],
) -> Option<LightWork> {
    let needs_faces = pass.traced.needs_faces(pass.lights, pass.options);
    let (past_faces, mut work) = if needs_faces {
        pass.traced.faces_at(surface, pass.lights, pass.options, &mut NearOccluders::default())
    } else {
        (Vec::new(), LightWork::default())
    };
    let mut past_faces = past_faces.into_iter();
    // The product of an answer and the mean of the next `count` fractions past triangles.
    let mut value = |beam_result: &BeamResult, count: u32| {
        if beam_result.is_complete != 1 {
            return None;
        }
        work += work_of(beam_result);
        work.rays += if beam_result.is_proven == DIVIDED { PARTS } else { 0 };
        if !needs_faces {
            return Some(beam_result.value);
        }
        let fractions: Vec<f32> = past_faces.by_ref().take(count as usize).collect();
        if beam_result.is_proven == DIVIDED && fractions.iter().any(|&fraction| fraction != fractions[0]) {
            return None;
        }
        Some(beam_result.value * fractions.iter().sum::<f32>() / count as f32)
    };
    let found = parts_of(values, pass.lights.lights.len());
    *found.open = 1.0;
    for (light, share) in pass.lights.lights.iter().zip(found.shares) {
        let beam_result = beam_results.next();
        let (ray, slope, _) = light.seen_from(surface.place.p);
        let parts = if pass.options.shadows == SceneShadows::Soft && slope > 0.0 { PARTS } else { 1 };
        *share = match surface.plain_share(&ray, pass.options) {
            Some(share) => share,
            None => surface.above_horizon(value(beam_result?, parts)?, &ray, slope, pass.options),
        };
    }
    Some(work)
}

/// The kernels on the buffers of one picture.
///
/// A submission has the following dispatches for each bunch of tiles that fits into the buffers. The device counts the
/// items of each, and a kernel with one invocation writes the number of workgroups of the next
/// (`shaders/scene/scene_stages.wgsl`), so the host needs no count.
///
/// ```text
///   next_tiles, surface_beams, count_beams     beams of the lights on the visible faces
///   rays                                       their answers
///   tree_cuts, cones                           starts of the searches of cones, and their answers
///   collect_discs                              discs that one cone does not decide
///   rounds, each for some of these discs:
///     next_discs, divide, cones                their parts, and the answers of the parts
///     collect_edges, count_edges, edge_cones   parts that need a ray past an edge
///     join_parts                               answers of the discs
/// ```
struct FaceLight<'a> {
    context: &'a Context,
    /// Rates of the device by kinds of beams, and the kinds of this picture.
    rates: &'a Mutex<HashMap<[bool; 2], f64>>,
    kinds: [bool; 2],
    buffers: &'a Buffers,
    timer: Option<&'a Timer>,
    /// Kernels of a bunch, and kernels of each round.
    bunch: Vec<Kernel>,
    round: Vec<Kernel>,
}

/// The stage to which the time of a kernel counts in reports.
fn stage_of(kernel: &str) -> &'static str {
    match kernel {
        "next_tiles" | "surface_beams" | "count_beams" | "tree cuts" => "beams",
        "rays of surfaces" => "rays",
        "cones of surfaces" | "collect_discs" => "cones",
        "cones at edges" | "join_parts" => "edges",
        _ => "parts",
    }
}

/// A kernel with its buffers.
struct Kernel {
    pipeline: wgpu::ComputePipeline,
    group: wgpu::BindGroup,
    size: Size,
    /// The stage to which its time counts.
    stage: &'static str,
}

/// Number of workgroups of a kernel: one, or the number of a stage.
#[derive(Clone, Copy)]
enum Size {
    One,
    Stage(u32),
}

impl<'a> FaceLight<'a> {
    /// The kernels for a picture. `kinds` is whether any light needs cones, and whether any needs rays.
    fn new(
        device: &'a DeviceScene,
        visible: &DeviceVisibility,
        faces: &wgpu::Buffer,
        buffers: &'a Buffers,
        kinds: [bool; 2],
        has_far: bool,
    ) -> Result<Self, Error> {
        let [has_cones, has_rays] = kinds;
        let Buffers {
            view, counts, groups, params, beams, cuts, beam_results, discs, parts, part_results, edges, ..
        } = buffers;
        let texts = device.beam_texts(has_far);
        let kernel = |name, file, entry, texts: &[Instead], bindings: &[BoundRange<'_>], size| {
            let (pipeline, group) = device.kernel(name, file, entry, texts, bindings)?;
            Ok::<_, Error>(Kernel { pipeline, group, size, stage: stage_of(name) })
        };
        let stages = |entry: &'static str, bindings: &[(u32, &wgpu::Buffer)]| {
            let bindings: Vec<_> = bindings.iter().copied().map(whole).collect();
            kernel(entry, "scene_stages", entry, &[], &bindings, Size::One)
        };
        let surfaces = |entry: &'static str, stage: u32, bindings: &[(u32, &wgpu::Buffer)]| {
            let parameters = (2, params, u64::from(stage) * STAGE_BYTES, size_of::<TileParams>() as u64);
            let bindings: Vec<_> = bindings.iter().copied().map(whole).chain([parameters]).collect();
            kernel(entry, "scene_surfaces", entry, &[], &bindings, Size::Stage(stage))
        };
        let evaluate = |name, entry, stage: u32, beams, beam_results| {
            let parameters = (0, params, u64::from(stage) * STAGE_BYTES, size_of::<BeamParams>() as u64);
            let bindings = device.beam_bindings(entry, parameters, cuts, beams, beam_results);
            kernel(name, "scene_beams", entry, &texts, &bindings, Size::Stage(stage))
        };
        let of_surfaces = [
            (0, &visible.rows),
            (1, view),
            (3, device.instances()),
            (7, &visible.pixels),
            (8, faces),
            (9, beams),
            (10, beam_results),
            (11, counts),
        ];
        let mut bunch = vec![
            stages("next_tiles", &[(0, counts), (1, groups), (2, params)])?,
            surfaces("surface_beams", STAGE_TILES, &of_surfaces)?,
            stages("count_beams", &[(0, counts), (1, groups), (2, params)])?,
        ];
        let mut round = Vec::new();
        if has_rays {
            bunch.push(evaluate("rays of surfaces", "rays", STAGE_RAYS, beams, beam_results)?);
        }
        if has_cones {
            let parameters = (0, params, u64::from(STAGE_CUTS) * STAGE_BYTES, size_of::<CutParams>() as u64);
            let bindings = [parameters, whole((1, device.nodes())), whole((2, cuts)), whole((7, beams))];
            bunch.push(kernel("tree cuts", "scene_cuts", "tree_cuts", &[], &bindings, Size::Stage(STAGE_CUTS))?);
            bunch.push(evaluate("cones of surfaces", "cones", STAGE_CONES, beams, beam_results)?);
            let of_cones = [(9, beams), (10, beam_results), (11, counts), (13, discs)];
            bunch.push(surfaces("collect_discs", STAGE_CONES, &of_cones)?);
            round.push(stages("next_discs", &[(0, counts), (1, groups), (2, params)])?);
            round.push(surfaces("divide", STAGE_DISCS, &[(9, beams), (12, parts), (13, discs)])?);
            round.push(evaluate("cones of parts", "cones", STAGE_PARTS, parts, part_results)?);
            let at_edges = [(9, parts), (10, part_results), (11, counts), (12, edges)];
            round.push(surfaces("collect_edges", STAGE_PARTS, &at_edges)?);
            round.push(stages("count_edges", &[(0, counts), (1, groups), (2, params)])?);
            round.push(evaluate("cones at edges", "edge_cones", STAGE_EDGES, edges, part_results)?);
            let joined = [(9, beams), (10, beam_results), (13, discs), (14, part_results)];
            round.push(surfaces("join_parts", STAGE_DISCS, &joined)?);
        }
        let timer = device.timer.as_ref();
        Ok(Self { context: device.context(), rates: &device.light_rates, kinds, buffers, timer, bunch, round })
    }

    /// The answers for `count` places of tiles from `start` on, with `tile_results` each and this mean cost.
    fn beam_results(
        &self,
        start: u64,
        count: u64,
        tile_results: u64,
        cost: f64,
        progress: &Progress,
    ) -> Result<Vec<BeamResult>, Error> {
        let (context, buffers) = (self.context, self.buffers);
        let mut beam_results = vec![BeamResult::default(); (count * tile_results) as usize];
        let bytes = size_of_val(&beam_results[..]) as u64;
        let result = buffers.result(context)?;
        let bunch = u64::from(buffers.beams_fit) / tile_results;
        let items = Items { count, smallest: FIRST_TILES, cost };
        let rates = || self.rates.lock().unwrap_or_else(PoisonError::into_inner);
        let mut found = rates().get(&self.kinds).copied().unwrap_or(0.0);
        by_rate(context, "the scene's light", &items, &mut found, progress, |first, tiles| {
            let next = start + first;
            let params = TileParams {
                count: bunch as u32,
                next: next as u32,
                start: start as u32,
                end: (next + tiles) as u32,
                ..TileParams::default()
            };
            let offset = u64::from(STAGE_TILES) * STAGE_BYTES;
            context.write("tiles of surfaces", &buffers.params, offset, &[params])?;
            let mut dispatches = Vec::new();
            for from in (0..tiles).step_by(bunch as usize) {
                let size = bunch.min(tiles - from);
                let rounds = (size * tile_results).div_ceil(u64::from(buffers.discs_fit));
                let rounds = std::iter::repeat_n(&self.round, rounds as usize).flatten();
                dispatches.extend(self.bunch.iter().chain(rounds).map(|kernel| kernel.dispatch(buffers)));
            }
            let copy = (first + tiles == count).then_some((&buffers.beam_results, bytes, &result));
            Ok(context.submit_all("the scene's light", &dispatches, copy, self.timer)?)
        })?;
        rates().insert(self.kinds, found);
        context.finish("beam results", &result, &mut beam_results)?;
        buffers.keep_result(result);
        Ok(beam_results)
    }
}

impl Kernel {
    fn dispatch<'a>(&'a self, buffers: &'a Buffers) -> Dispatch<'a> {
        let size = match self.size {
            Size::One => DispatchSize::Known([1, 1, 1]),
            Size::Stage(stage) => DispatchSize::At(&buffers.groups, u64::from(stage) * size_of::<[u32; 4]>() as u64),
        };
        Dispatch { pipeline: &self.pipeline, group: &self.group, size, stage: self.stage }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pixel_has_a_place_of_its_own() {
        for size in [[1, 1], [8, 8], [9, 1], [161, 97], [640, 481]] {
            let tiles = Tiles::of(size);
            let mut is_used = vec![false; tiles.places() as usize * GROUP as usize];
            for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
                let (place, lane) = tiles.place(x, y);
                // The shader's map from places to pixels.
                let at = place % SPREAD * tiles.step + place / SPREAD;
                assert!(at < tiles.count);
                assert_eq!(at % tiles.columns * TILE + (lane & 3) + ((lane >> 1) & 4), x);
                assert_eq!(at / tiles.columns * TILE + ((lane >> 2) & 1) + ((lane >> 3) & 6), y);
                let slot = (place * GROUP + lane) as usize;
                assert!(!std::mem::replace(&mut is_used[slot], true), "{x}, {y}");
            }
        }
    }
}
