//! Pictures of quadrics, on the CPU or a graphics device.

use super::Quadrics;
use super::gpu::draw;
use super::picture::QuadricView;
use crate::error::Error;
use crate::gpu::Place;
use crate::picture::{Camera, Frame, RaymarchOptions};
use crate::progress::Progress;

/// Draws at a place. `options.color` is ignored, since each quadric has its reflectance.
pub(crate) fn draw_at(
    place: &Place,
    quadrics: &Quadrics,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    options.check()?;
    let lights = options.directional_lights()?;
    let view = QuadricView { quadrics, camera, options, lights: &lights };
    match place {
        Place::Cpu => Frame::by_pixels(options.size, lights.len(), progress, |x, y, row| view.draw_pixel(x, y, row)),
        Place::Gpu(context) => draw(context, &view, progress),
    }
}
