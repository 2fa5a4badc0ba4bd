//! The primary pass on the CPU: the visible surfaces of each pixel.

pub(crate) mod appearance;
pub(crate) mod gbuffer;
pub(crate) mod pixel_ray;
pub(crate) mod primary;
pub(crate) mod rasterizer;
pub(crate) mod searched;
