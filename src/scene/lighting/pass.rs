//! One pass of the camera, and the data for its light.

use crate::progress::Progress;
use crate::scene::content::options::RenderOptions;
use crate::scene::device::device_scene::DeviceScene;
use crate::scene::light::bounces::Bounces;
use crate::scene::light::light_rays::RayCounters;
use crate::scene::light::lit_surface::Lights;
use crate::scene::light::shadow::TracedScene;
use crate::scene::visibility::gbuffer::GBuffer;

/// One pass of the camera, and the data for its light.
#[derive(Clone, Copy)]
pub(crate) struct Pass<'a> {
    pub traced: &'a TracedScene<'a>,
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
