//! The light pass: light on all surfaces of a picture, evaluated or interpolated, and their colours.

pub(crate) mod compose;
pub(crate) mod denoise;
pub(crate) mod device_beams;
pub(crate) mod device_light;
pub(crate) mod evaluation;
pub(crate) mod light_buffer;
pub(crate) mod pass;
pub(crate) mod tile;
pub(crate) mod upsampling;
