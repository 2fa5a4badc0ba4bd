//! Shapes on graphics devices, and pictures of one shape.

pub(crate) mod draw;
pub(crate) mod gpu;
pub(crate) mod picture;
