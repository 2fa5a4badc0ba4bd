//! fieldbake: exact signed distance fields from triangle meshes.
//!
//! Data passes through a pipeline: mesh, bake, volume, render. See ARCHITECTURE.md for the map and the conventions.

pub mod atlas;
pub mod bake;
pub mod bvh;
pub mod csg;
pub mod encoding;
pub mod error;
pub mod geometry;
pub mod gpu;
pub mod grid;
mod memory;
pub mod merge;
pub mod mesh;
pub mod openexr;
pub mod progress;
#[cfg(feature = "python")]
mod python;
pub mod quadric;
pub mod query;
pub mod render;
pub mod scene;
pub mod shader_text;
pub mod sign;
pub mod surface;
pub mod viewer;
pub mod volume;
