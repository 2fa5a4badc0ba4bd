//! Pictures of a stored field on the CPU: its zero level set, viewed by a camera and lit. A graphics device draws a
//! field as a scene of one instance ([`crate::scene`]).
//!
//! # Theory
//!
//! For each pixel, a ray through its centre ([`crate::picture`]) is clipped to the box of the grid and traced to the
//! first root of the trilinear field ([`crate::march`]), then shaded ([`shade`]). The ray is computed in f64 and
//! transformed to grid space, where voxel centres are integers and f32 is precise enough at any scale and offset of the
//! world. Everything after that is f32. Tiles of pixels shorten their rays to the depths of the surface
//! ([`crate::march::tiles`]).
//!
//! The picture shows the solid "field <= 0, inside the box". Where the box cuts it, the cut is drawn as a flat face. A
//! camera inside the solid sees it at depth 0. With [`Filter::Nearest`](crate::picture::Filter::Nearest) the field is
//! constant in each voxel ([`crate::march::voxels`]).
//!
//! # Practice
//!
//! [`raymarch`] runs on all cores by rows, counts its progress in rows and stops when it is cancelled. Its cost is
//! proportional to the steps in `Frame::steps`, plus about as many for each light.

mod draw;
pub(crate) mod shade;

pub use draw::raymarch;

#[cfg(test)]
mod tests;
