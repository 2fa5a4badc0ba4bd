//! The light on the faces that a device found, without leaving the device: the beams are made from the picture in its
//! memory (`shaders/scene_surfaces.wgsl`), and only their results are read back.
//!
//! It applies to faces of meshes under hard and soft shadows without occlusion, in pictures whose rays start at the
//! eye. Everything else is left to [`super::device_beams`]: fields, translucent surfaces, light through objects, and
//! pixels that the CPU drew.

use super::SceneShadows;
use super::device_buffers::{Buffers, MOST_BEAMS, MOST_PARTS};
use super::gbuffer::DeviceSeen;
use super::gpu::{DeviceScene, work_of};
use super::light_buffer::{LightBuffer, parts_of, stride};
use super::light_rays::{LightWork, PARTS};
use super::lit_surface::{BIAS_TRIANGLE, LitSurface, SceneLight};
use super::pass::Pass;
use crate::error::Error;
use crate::gpu::layout::{Answer, PieceParams, SurfaceLight, SurfaceParams};
use crate::progress::Progress;
use rayon::prelude::*;

/// Largest distance of the eye from the middle of the scene, scene units. The device computes positions in float32
/// along the ray, and a position must be precise to a fraction of a voxel.
const MOST_DISTANCE: f64 = 16.0;
/// Number of invocations of a workgroup, as in the shader.
const GROUP: u32 = 64;
/// Value of [`Answer::is_proven`] for a disc whose fraction is the mean of its parts, as in the shader.
const DIVIDED: u32 = 2;

/// Kinds of counts, as in the shader.
#[derive(Clone, Copy)]
enum Count {
    Beams,
    Discs,
    Edges,
}

/// Lights the faces that the device found. Returns false if the method does not apply to the picture.
pub(crate) fn light_faces(pass: &Pass<'_>, device: &DeviceScene, known: &mut LightBuffer) -> Result<bool, Error> {
    let Some(seen) = &pass.buffer.seen else { return Ok(false) };
    let scene = pass.casters.scene;
    let eye = scene.scene_from_world(pass.buffer.view.camera.eye);
    let lights = match pass.options.shadows {
        SceneShadows::None => 0,
        SceneShadows::Hard | SceneShadows::Soft => pass.lights.lights.len(),
        SceneShadows::Area(_) | SceneShadows::Article => return Ok(false),
    };
    let is_exact = eye.length() <= MOST_DISTANCE && !pass.buffer.view.camera.is_parallel();
    if lights == 0 || pass.options.occlusion.is_some() || !is_exact || device.faces().is_none() {
        return Ok(false);
    }
    let mut view = SurfaceParams {
        eye: eye.as_vec3().to_array(),
        width: pass.options.size[0],
        ray: seen.rays[0].as_vec3().to_array(),
        stride: seen.stride,
        ray_x: seen.rays[1].as_vec3().to_array(),
        light_count: lights as u32,
        ray_y: seen.rays[2].as_vec3().to_array(),
        bias_voxels: BIAS_TRIANGLE,
        ..SurfaceParams::default()
    };
    for (row, light) in view.lights.iter_mut().zip(&pass.lights.lights[..lights]) {
        *row = light_row(light, pass.options.shadows);
    }
    let rows = &view.lights[..lights];
    let kinds = [rows.iter().any(|row| row.size > 0.0), rows.iter().any(|row| row.size <= 0.0)];
    let work = FaceLight { pass, device, seen, progress: pass.progress, buffers: device.light.on(device.context())? };
    device.context().write("view of surfaces", &work.buffers.view, 0, &[view])?;

    let width = pass.options.size[0] as usize;
    let pixels = width * pass.options.size[1] as usize;
    let chunk = (MOST_BEAMS / lights).min(pixels);
    for first in (0..pixels).step_by(chunk) {
        let count = chunk.min(pixels - first);
        let answers = work.answers(first, count, lights, kinds)?;
        take(pass, known, first, &answers)?;
    }
    Ok(true)
}

fn light_row(light: &SceneLight, shadows: SceneShadows) -> SurfaceLight {
    let (place, size, is_point) = match *light {
        SceneLight::Directional { to_light, slope, .. } => (to_light, slope, 0),
        SceneLight::Point { position, radius, .. } => (position, radius as f32, 1),
    };
    let size = if shadows == SceneShadows::Soft { size } else { 0.0 };
    SurfaceLight { place: place.as_vec3().to_array(), size, is_point, ..SurfaceLight::default() }
}

/// Stores the answers for a range of pixels.
fn take(pass: &Pass<'_>, known: &mut LightBuffer, first: usize, answers: &[Answer]) -> Result<(), Error> {
    let scene = pass.casters.scene;
    let width = pass.options.size[0] as usize;
    let lights = pass.lights.lights.len();
    let range = first..first + answers.len() / lights;
    known.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        if (y + 1) * width <= range.start || y * width >= range.end {
            return Ok(());
        }
        let mut total = LightWork::default();
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            let pixel = y * width + layer.x as usize;
            if !layer.is_from_device || !range.contains(&pixel) {
                continue;
            }
            let surface = LitSurface::new(scene, pass.buffer, y, layer);
            if surface.scatters(scene) {
                continue;
            }
            let mut found = answers[(pixel - first) * lights..][..lights].iter();
            let values = &mut row.values[i * stride(lights)..][..stride(lights)];
            if let Some(work) = take_pixel(pass, &surface, &mut found, values) {
                row.work[i] = work;
                row.is_known[i] = true;
                total += work;
            }
        }
        pass.counters.add(total);
        pass.progress.check()
    })
}

/// The light on a surface; None if an answer is missing. The CPU evaluates sheets. Where they cover some of the parts
/// of a divided disc, the fractions of the parts are missing.
fn take_pixel(
    pass: &Pass<'_>,
    surface: &LitSurface<'_>,
    answers: &mut std::slice::Iter<'_, Answer>,
    values: &mut [f32],
) -> Option<LightWork> {
    let scene = pass.casters.scene;
    let (past_sheets, mut work) = if scene.sheets.is_empty() {
        (Vec::new(), LightWork::default())
    } else {
        scene.sheets_at(surface, pass.lights, pass.options)
    };
    let mut past_sheets = past_sheets.into_iter();
    // The product of an answer and the mean of the next `count` fractions past the sheets.
    let mut value = |answer: &Answer, count: u32| {
        if answer.is_complete != 1 {
            return None;
        }
        work += work_of(answer);
        work.rays += if answer.is_proven == DIVIDED { PARTS } else { 0 };
        if scene.sheets.is_empty() {
            return Some(answer.value);
        }
        let fractions: Vec<f32> = past_sheets.by_ref().take(count as usize).collect();
        if answer.is_proven == DIVIDED && fractions.iter().any(|&fraction| fraction != fractions[0]) {
            return None;
        }
        Some(answer.value * fractions.iter().sum::<f32>() / count as f32)
    };
    let found = parts_of(values, pass.lights.lights.len());
    *found.open = 1.0;
    for (light, share) in pass.lights.lights.iter().zip(found.shares) {
        let answer = answers.next();
        let (ray, slope, _) = light.seen_from(surface.place.p);
        let parts = if pass.options.shadows == SceneShadows::Soft && slope > 0.0 { PARTS } else { 1 };
        *share = match surface.plain_share(&ray, pass.options) {
            Some(share) => share,
            None => value(answer?, parts)?,
        };
    }
    Some(work)
}

/// The kernels on the buffers of one picture.
struct FaceLight<'a> {
    pass: &'a Pass<'a>,
    device: &'a DeviceScene,
    seen: &'a DeviceSeen,
    progress: &'a Progress,
    buffers: &'a Buffers,
}

impl FaceLight<'_> {
    /// The answers for some pixels. `kinds`: whether any light needs cones, and whether any needs rays.
    fn answers(&self, first: usize, count: usize, lights: usize, kinds: [bool; 2]) -> Result<Vec<Answer>, Error> {
        let buffers = self.buffers;
        let mut clears = 1;
        for (is_wanted, wants_cones) in kinds.into_iter().zip([1, 0]) {
            if !is_wanted {
                continue;
            }
            self.reset_counts()?;
            let bindings = [
                (0, &self.seen.rows),
                (1, &buffers.view),
                (3, self.device.instances()),
                (7, &self.seen.pixels),
                (8, self.device.faces().expect("checked before")),
                (9, &buffers.beams),
                (10, &buffers.answers),
                (11, &buffers.counts),
            ];
            let piece = PieceParams { first: first as u32, count: count as u32, wants_cones, clears };
            self.dispatch("surface_beams", piece, &bindings)?;
            clears = 0;
            let beams = self.count(Count::Beams)?;
            if wants_cones == 0 {
                self.run("rays", &buffers.beams, &buffers.answers, beams)?;
                continue;
            }
            self.run("cones", &buffers.beams, &buffers.answers, beams)?;
            for first in (0..beams).step_by(MOST_PARTS / PARTS as usize) {
                self.divide(first, (MOST_PARTS / PARTS as usize).min(beams - first))?;
            }
        }
        let mut answers = vec![Answer::default(); count * lights];
        self.device.context().read("answers", &buffers.answers, &mut answers, self.progress)?;
        Ok(answers)
    }

    /// Evaluates the discs among the beams that one cone did not decide, by the parts of each disc.
    fn divide(&self, first: usize, count: usize) -> Result<(), Error> {
        let buffers = self.buffers;
        self.reset_counts()?;
        let piece = PieceParams { first: first as u32, count: count as u32, ..PieceParams::default() };
        let bindings = [
            (9, &buffers.beams),
            (10, &buffers.answers),
            (11, &buffers.counts),
            (12, &buffers.parts),
            (13, &buffers.parents),
        ];
        self.dispatch("divide", piece, &bindings)?;
        let discs = self.count(Count::Discs)?;
        if discs == 0 {
            return Ok(());
        }
        self.run("cones", &buffers.parts, &buffers.part_answers, discs * PARTS as usize)?;
        self.edges(&buffers.parts, &buffers.part_answers, discs * PARTS as usize)?;
        let piece = PieceParams { count: discs as u32, ..PieceParams::default() };
        let bindings = [(10, &buffers.answers), (13, &buffers.parents), (14, &buffers.part_answers)];
        self.dispatch("join_parts", piece, &bindings)
    }

    /// Evaluates the cones that need a ray past an edge.
    fn edges(&self, beams: &wgpu::Buffer, answers: &wgpu::Buffer, count: usize) -> Result<(), Error> {
        let buffers = self.buffers;
        self.reset_counts()?;
        let piece = PieceParams { count: count as u32, ..PieceParams::default() };
        let bindings = [(9, beams), (10, answers), (11, &buffers.counts), (12, &buffers.edges)];
        self.dispatch("collect_edges", piece, &bindings)?;
        let edges = self.count(Count::Edges)?;
        self.run("edge_cones", &buffers.edges, answers, edges)
    }

    fn run(
        &self,
        entry: &'static str,
        beams: &wgpu::Buffer,
        answers: &wgpu::Buffer,
        count: usize,
    ) -> Result<(), Error> {
        let params = DeviceScene::beam_params(self.pass.casters);
        self.device.run(entry, params, beams, answers, count, self.progress)
    }

    fn dispatch(
        &self,
        entry: &'static str,
        piece: PieceParams,
        bindings: &[(u32, &wgpu::Buffer)],
    ) -> Result<(), Error> {
        let context = self.device.context();
        context.write("piece of surfaces", &self.buffers.piece, 0, &[piece])?;
        let kernel = context.kernel_with("scene_surfaces", entry, &[])?;
        let all: Vec<_> = bindings.iter().copied().chain([(2, &self.buffers.piece)]).collect();
        let group = context.bind("scene_surfaces", &kernel, &all)?;
        context.dispatch("scene_surfaces", &kernel, &group, [piece.count.div_ceil(GROUP), 1, 1])?;
        Ok(())
    }

    fn reset_counts(&self) -> Result<(), Error> {
        Ok(self.device.context().write("counts of beams", &self.buffers.counts, 0, &[0u32; 4])?)
    }

    fn count(&self, which: Count) -> Result<usize, Error> {
        let mut counts = [0u32; 4];
        self.device.context().read("counts of beams", &self.buffers.counts, &mut counts, self.progress)?;
        Ok(counts[which as usize] as usize)
    }
}
