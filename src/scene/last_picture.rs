//! The visible surfaces of the last picture and the light on them, kept for a next picture that has the same ones.

use crate::gpu::{Context, Place};
use crate::picture::{Camera, Light};
use crate::scene::content::model::Scene;
use crate::scene::content::options::{FarField, Primary, RenderOptions, SceneShadows};
use crate::scene::lighting::light_buffer::LightBuffer;
use crate::scene::visibility::gbuffer::{GBuffer, Layer};
use glam::DVec3;
use std::sync::Arc;

/// The surfaces of a picture with one sample per pixel, and the light on them.
pub(crate) struct LastPicture {
    pub surfaces_of: SurfaceInputs,
    pub light_of: LightInputs,
    pub buffer: GBuffer,
    pub light: LightBuffer,
    /// Number of rays and cones of the light, and of those that entered the far field.
    pub rays: [u64; 2],
}

/// Everything on which the visible surfaces of a picture depend.
pub(crate) struct SurfaceInputs {
    pub scene: Arc<Scene>,
    pub context: Option<Arc<Context>>,
    pub camera: Camera,
    pub size: [u32; 2],
    pub primary: Primary,
}

/// Largest size of a picture that is kept, bytes.
const LARGEST: usize = 256 << 20;

impl LastPicture {
    pub(crate) fn is_small(&self) -> bool {
        let layers: usize = self.buffer.rows.iter().map(Vec::len).sum();
        layers * (size_of::<Layer>() + self.light.layer_bytes()) <= LARGEST
    }
}

impl SurfaceInputs {
    pub(crate) fn new(place: &Place, scene: &Arc<Scene>, camera: &Camera, options: &RenderOptions) -> Self {
        let context = match place {
            Place::Cpu => None,
            Place::Gpu(context) => Some(context.clone()),
        };
        Self { scene: scene.clone(), context, camera: *camera, size: options.size, primary: options.primary }
    }
}

impl PartialEq for SurfaceInputs {
    fn eq(&self, other: &Self) -> bool {
        let is_same_place = match (&self.context, &other.context) {
            (None, None) => true,
            (Some(one), Some(other)) => one.is_same_device(other),
            _ => false,
        };
        is_same_place
            && Arc::ptr_eq(&self.scene, &other.scene)
            && (self.camera, self.size, self.primary) == (other.camera, other.size, other.primary)
    }
}

/// Everything besides the surfaces that determines the fractions of the light on them. The colours, ranges and cones
/// of the lights do not.
#[derive(PartialEq)]
pub(crate) struct LightInputs {
    /// Direction or position of each light, and the size of its disc or ball.
    sources: Vec<(bool, DVec3, f64)>,
    shadows: SceneShadows,
    occlusion: Option<f64>,
    far: Option<FarField>,
    light_scale: u32,
}

impl LightInputs {
    pub(crate) fn new(options: &RenderOptions) -> Self {
        let source = |light: &Light| match *light {
            Light::Directional { direction, slope, .. } => (false, direction, f64::from(slope)),
            Light::Point { position, radius, .. } => (true, position, radius),
        };
        Self {
            sources: options.lights.iter().map(source).collect(),
            shadows: options.shadows,
            occlusion: options.occlusion,
            far: options.far.clone(),
            light_scale: options.light_scale,
        }
    }
}
