//! A scene in the memory of a graphics device, and the primary pass there.

pub(crate) mod device_buffers;
pub(crate) mod device_meshes;
pub(crate) mod device_raster;
pub(crate) mod device_scene;
