//! One pass of the camera, and the data for its light.

use super::RenderOptions;
use super::bounces::Bounces;
use super::gbuffer::GBuffer;
use super::gpu::DeviceScene;
use super::light_rays::RayCounters;
use super::lit_surface::Lights;
use super::shadow::Casters;
use crate::progress::Progress;

/// One pass of the camera, and the data for its light.
#[derive(Clone, Copy)]
pub(crate) struct Pass<'a> {
    pub casters: &'a Casters<'a>,
    pub buffer: &'a GBuffer,
    pub lights: &'a Lights,
    /// Set for the evaluation of indirect light alone.
    pub bounces: Option<&'a Bounces<'a>>,
    pub options: &'a RenderOptions,
    /// Device of the light pass; None for the CPU.
    pub device: Option<&'a DeviceScene>,
    pub counters: &'a RayCounters,
    pub progress: &'a Progress,
}
