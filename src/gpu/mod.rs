//! Graphics devices through wgpu (Vulkan, Metal and DX12): services for the rooms that compute on them, no algorithm.
//!
//! *Theory.* One [`Context`] a process and adapter holds the open device, its queue and its compiled kernels. It is made
//! at the first use and kept; after a device loss the next use opens a new one. WGSL files in `shaders/` are joined by
//! their `#import` lines ([`shader`]) and compiled once a context ([`pipeline`]). A struct that both sides read has its
//! `#[repr(C)]` twin in [`layout`].
//!
//! *Practice.* [`choose`] turns the user's `device=` into a place to run. Every call into wgpu stands between error
//! scopes, so a refusal is a [`DeviceError`](crate::error::DeviceError) with its reason and never a panic. Waiting looks
//! at the job's progress ten times a second, so that Ctrl-C works; a dispatch is kept short for the same reason
//! ([`pace`]).
//!
//! OpenGL is left out: its backend loses storage texture writes without an error.

pub mod buffer;
pub mod context;
pub mod device;
pub mod layout;
pub mod pace;
pub mod pipeline;
pub mod raster;
pub mod shader;
pub mod texture;

#[cfg(test)]
pub(crate) mod tests;

pub use context::{Context, context};
pub use device::{DeviceInfo, Place, choose, devices};
