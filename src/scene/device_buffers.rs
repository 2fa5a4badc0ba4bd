//! Device memory for the light on faces.

use super::light_rays::PARTS;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::layout::{Answer, Beam, PieceParams, SurfaceParams};
use std::sync::OnceLock;

/// Number of beams in memory at a time: 16 MiB.
pub(crate) const MOST_BEAMS: usize = 1 << 18;
/// Number of parts of divided discs in memory at a time: 32 MiB.
pub(crate) const MOST_PARTS: usize = 1 << 19;

/// Buffers for beams, allocated at the first use.
#[derive(Default)]
pub(crate) struct LightBuffers(OnceLock<Buffers>);

/// The buffers of one picture.
pub(crate) struct Buffers {
    pub view: wgpu::Buffer,
    pub piece: wgpu::Buffer,
    pub counts: wgpu::Buffer,
    pub beams: wgpu::Buffer,
    pub answers: wgpu::Buffer,
    pub parts: wgpu::Buffer,
    pub part_answers: wgpu::Buffer,
    pub edges: wgpu::Buffer,
    pub parents: wgpu::Buffer,
}

impl LightBuffers {
    /// The buffers in the memory of a device.
    pub(crate) fn on(&self, context: &Context) -> Result<&Buffers, Error> {
        if let Some(buffers) = self.0.get() {
            return Ok(buffers);
        }
        let storage = |label: &str, items: usize, size: usize| context.storage(label, (items * size) as u64);
        let made = Buffers {
            view: context.uniform("view of surfaces", &SurfaceParams::default())?,
            piece: context.uniform("piece of surfaces", &PieceParams::default())?,
            counts: storage("counts of beams", 4, size_of::<u32>())?,
            beams: storage("beams", MOST_BEAMS, size_of::<Beam>())?,
            answers: storage("answers", MOST_BEAMS, size_of::<Answer>())?,
            parts: storage("parts of discs", MOST_PARTS, size_of::<Beam>())?,
            part_answers: storage("answers of parts", MOST_PARTS, size_of::<Answer>())?,
            edges: storage("cones at edges", MOST_PARTS, size_of::<Beam>())?,
            parents: storage("divided discs", MOST_PARTS / PARTS as usize, size_of::<u32>())?,
        };
        Ok(self.0.get_or_init(|| made))
    }
}
