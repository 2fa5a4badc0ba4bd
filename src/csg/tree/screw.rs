//! Dimensions of screw threads.

use super::checks::{finite, positive};
use crate::error::ShapeError;
use crate::gpu::constants::csg_field::THREAD_CORE;
use std::f64::consts::PI;

/// The basic profile of a thread with a major radius: minor radius, half the width of a crest, and the distance from
/// the middle of a crest to the beginning of a root, along the axis.
///
/// ISO 68-1: a triangle of the height `H = sqrt(3)/2 pitch`, cut off by H/8 at the crests and by H/4 at the roots.
/// ISO 2904: flanks of 15 degrees on the height of pitch/2, crests and roots of equal width.
pub(crate) fn profile(radius: f64, pitch: f64, is_iso: bool) -> [f64; 3] {
    if is_iso {
        return [radius - 0.625 * 0.75f64.sqrt() * pitch, pitch / 16.0, 0.5 * pitch - pitch / 8.0];
    }
    let half_width = 0.5 * (0.5 - 0.5 * (PI / 12.0).tan()) * pitch;
    [radius - 0.5 * pitch, half_width, 0.5 * pitch - half_width]
}

/// Checks the arguments of a thread.
pub(crate) fn check(radius: f64, pitch: f64, offset: f64, is_iso: bool) -> Result<(), ShapeError> {
    let (radius, pitch) = (positive("diameter", radius)?, positive("pitch", pitch)?);
    finite("clearance", offset)?;
    let [minor, ..] = profile(radius, pitch, is_iso);
    if pitch > minor {
        let least = 2.0 * (radius - minor + pitch);
        let limit = if minor > 0.0 {
            format!("must be at most the minor radius {minor}")
        } else {
            format!("is too large for a diameter of {}", 2.0 * radius)
        };
        let problem = format!("{limit}, got {pitch}; a diameter of {least} has this pitch");
        return Err(ShapeError::argument("pitch", problem));
    }
    if offset.abs() > 0.25 * minor {
        let problem = format!("must be at most a quarter of the minor radius, {}, got {}", 0.25 * minor, offset.abs());
        return Err(ShapeError::argument("clearance", problem));
    }
    Ok(())
}

/// Lipschitz constant of the field of a thread; see [`crate::csg::evaluation::helicoid`].
pub(crate) fn lipschitz(radius: f64, pitch: f64, is_iso: bool) -> f64 {
    let [minor, ..] = profile(radius, pitch, is_iso);
    let slope = pitch / (2.0 * PI) / (THREAD_CORE * minor);
    2.0 * (1.0 + slope * slope).sqrt() - 1.0
}
