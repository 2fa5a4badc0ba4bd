//! Device memory for the light on faces.

use crate::error::DeviceError;
use crate::gpu::Context;
use crate::gpu::buffer::ReadBack;
use crate::gpu::constants::scene_beam::{CUT_BEAMS, CUT_NODES};
use crate::gpu::constants::scene_counts::{BEAMS_FIT, COUNTS, DISCS_FIT, PARTS, STAGES, STRIDE};
use crate::gpu::layout::{Beam, BeamParams, BeamResult, SurfaceParams};
use crate::gpu::pipeline::BindGroups;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Largest number of beams in memory at a time: 16 MiB.
const MOST_BEAMS: u32 = 1 << 18;
/// Largest number of divided discs in memory at a time: 74 MiB for their parts.
const MOST_DISCS: u32 = 1 << 15;
/// Size of the parameters of a stage and the distance to the parameters of the next one, bytes.
pub(crate) const STAGE_BYTES: u64 = STRIDE as u64 * size_of::<u32>() as u64;

/// Buffers for beams, kept between pictures.
#[derive(Default)]
pub(crate) struct LightBuffers(Mutex<Option<Arc<Buffers>>>);

/// Buffers for some number of answers. One for more answers also serves a picture with fewer.
pub(crate) struct Buffers {
    pub view: wgpu::Buffer,
    /// Counts and sizes of the stages: see [`crate::gpu::constants::scene_counts`].
    pub counts: wgpu::Buffer,
    pub groups: wgpu::Buffer,
    pub params: wgpu::Buffer,
    pub beams: wgpu::Buffer,
    /// Cuts of the scene's tree for the beams.
    pub cuts: wgpu::Buffer,
    pub beam_results: wgpu::Buffer,
    /// Beams whose discs are divided.
    pub discs: wgpu::Buffer,
    pub parts: wgpu::Buffer,
    pub part_results: wgpu::Buffer,
    pub edges: wgpu::Buffer,
    /// Number of beams, of discs and of answers that fit.
    pub beams_fit: u32,
    pub discs_fit: u32,
    results_fit: u64,
    /// Memory for the answers on the host; a picture in progress takes it out.
    result: Mutex<Option<ReadBack>>,
    /// The parameters in the memory of the stages.
    beam_params: Mutex<Option<BeamParams>>,
}

impl LightBuffers {
    /// The buffers for a number of answers in the memory of a device. Smaller ones, and all of `groups`, are released
    /// before larger ones are made.
    pub(crate) fn on(
        &self,
        context: &Context,
        groups: &BindGroups,
        beam_results: u64,
    ) -> Result<Arc<Buffers>, DeviceError> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(buffers) = kept.as_ref().filter(|buffers| buffers.results_fit >= beam_results) {
            return Ok(buffers.clone());
        }
        *kept = None;
        groups.clear();
        let buffers = Arc::new(Buffers::new(context, beam_results)?);
        *kept = Some(buffers.clone());
        Ok(buffers)
    }
}

impl Buffers {
    fn new(context: &Context, beam_results: u64) -> Result<Self, DeviceError> {
        let storage = |label: &str, items: u32, size: usize| context.storage(label, u64::from(items) * size as u64);
        let beams_fit = beam_results.min(u64::from(MOST_BEAMS)) as u32;
        let discs_fit = beams_fit.min(MOST_DISCS);
        let mut counts = [0; COUNTS as usize];
        counts[BEAMS_FIT as usize] = beams_fit;
        counts[DISCS_FIT as usize] = discs_fit;
        Ok(Self {
            view: context.uniform("view of surfaces", &SurfaceParams::default())?,
            counts: context.upload("counts of beams", &counts)?,
            groups: context.written_by_kernels("sizes of stages", u64::from(STAGES) * size_of::<[u32; 4]>() as u64)?,
            params: context.written_by_kernels("parameters of stages", u64::from(STAGES) * STAGE_BYTES)?,
            beams: storage("beams", beams_fit, size_of::<Beam>())?,
            cuts: storage("cuts of the scene's tree", CUT_NODES * beams_fit.div_ceil(CUT_BEAMS), size_of::<u32>())?,
            beam_results: context.storage("beam results", beam_results * size_of::<BeamResult>() as u64)?,
            discs: storage("divided discs", beams_fit, size_of::<u32>())?,
            parts: storage("parts of discs", PARTS * discs_fit, size_of::<Beam>())?,
            part_results: storage("results of parts", PARTS * discs_fit, size_of::<BeamResult>())?,
            edges: storage("cones at edges", PARTS * discs_fit, size_of::<Beam>())?,
            beams_fit,
            discs_fit,
            results_fit: beam_results,
            result: Mutex::default(),
            beam_params: Mutex::default(),
        })
    }

    /// Writes the parameters of kernels that evaluate beams into the parameters of all stages, if they differ.
    pub(crate) fn set_beam_params(&self, context: &Context, params: BeamParams) -> Result<(), DeviceError> {
        let mut known = self.beam_params.lock().unwrap_or_else(PoisonError::into_inner);
        if *known == Some(params) {
            return Ok(());
        }
        let mut words = vec![0u32; (STAGES * STRIDE) as usize];
        for stage in words.chunks_exact_mut(STRIDE as usize) {
            stage[..size_of::<BeamParams>() / size_of::<u32>()].copy_from_slice(bytemuck::cast_slice(&[params]));
        }
        context.write("parameters of stages", &self.params, 0, &words)?;
        *known = Some(params);
        Ok(())
    }

    /// Memory on the host for all answers. It is kept for the next picture by [`Self::keep_result`].
    pub(crate) fn result(&self, context: &Context) -> Result<ReadBack, DeviceError> {
        match self.kept_result().take() {
            Some(result) => Ok(result),
            None => context.read_back("beam results", self.beam_results.size()),
        }
    }

    /// Keeps memory without a pending copy.
    pub(crate) fn keep_result(&self, result: ReadBack) {
        *self.kept_result() = Some(result);
    }

    fn kept_result(&self) -> MutexGuard<'_, Option<ReadBack>> {
        self.result.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
