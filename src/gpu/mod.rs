//! Graphics devices through wgpu (Vulkan, Metal and DX12): services for the modules that compute on them, without
//! algorithms.
//!
//! *Theory.* One [`Context`] per process and adapter holds the open device, its queue and its compiled kernels. It is
//! made at the first use and kept; after a device loss the next use opens a new one. WGSL files in `shaders/` are
//! joined by their `#import` lines ([`shader`]) and compiled once per context ([`pipeline`]). A struct that both sides
//! read has its `#[repr(C)]` twin in [`layout`].
//!
//! *Practice.* [`choose`] maps the user's `device=` to a device. Every call into wgpu runs inside error scopes, so a
//! failure is a [`DeviceError`](crate::error::DeviceError) with its reason and never a panic. Waiting checks the
//! progress of the job every 50 ms, so that Ctrl-C works; dispatches are short for the same reason ([`pace`]).
//!
//! OpenGL is not used: its backend loses storage texture writes without an error.

pub(crate) mod buffer;
pub(crate) mod constants;
pub(crate) mod context;
pub(crate) mod device;
pub(crate) mod layout;
pub(crate) mod pace;
pub(crate) mod pipeline;
pub(crate) mod raster;
pub(crate) mod shader;
pub(crate) mod table;
pub(crate) mod timer;

#[cfg(test)]
pub(crate) mod tests;

pub use context::{Context, context};
pub use device::{DeviceInfo, Place, choose, devices, is_overridden};
