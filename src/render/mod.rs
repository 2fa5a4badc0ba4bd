//! Pictures of a stored field: its zero level set, viewed by a camera and lit.
//!
//! # Theory
//!
//! For each pixel, a ray through its centre ([`camera`]) is clipped to the box of the grid and traced to the first root
//! of the trilinear field ([`march`], [`empty`], [`cubic`]), then shaded ([`shade`]). The ray is computed in f64 and
//! transformed to grid space, where voxel centres are integers and f32 is precise enough at any scale and offset of the
//! world. Everything after that is f32 with bounded loops, so that a shader can do the same. On the CPU, tiles of
//! pixels shorten their rays to the depths of the surface ([`tiles`]).
//!
//! The picture shows the solid "field <= 0, inside the box". Where the box cuts it, the cut is drawn as a flat face. A
//! camera inside the solid sees it at depth 0. With [`Filter::Nearest`] the field is constant in each voxel
//! ([`voxels`]).
//!
//! # Practice
//!
//! [`raymarch`] runs on all cores by rows, counts its progress in rows and stops when it is cancelled. Its cost is
//! proportional to the steps in `Frame::steps`, plus about as many for each light.

pub(crate) mod blocks;
pub(crate) mod bricks;
pub(crate) mod camera;
pub(crate) mod cubic;
mod draw;
pub(crate) mod empty;
pub(crate) mod frame;
mod gpu;
mod gpu_fields;
#[cfg(test)]
mod gpu_tests;
pub(crate) mod march;
pub(crate) mod options;
pub(crate) mod shade;
mod tiles;
mod voxels;

pub use camera::Camera;
pub use draw::{Source, raymarch, raymarch_at, raymarch_nested, raymarch_on_device, raymarch_sparse, raymarch_view};
pub use frame::Frame;
pub(crate) use frame::Row;
pub(crate) use gpu::upload_lights;
pub use options::{DirectionalLight, Filter, RaymarchOptions, Shadows};

#[cfg(test)]
mod tests;
