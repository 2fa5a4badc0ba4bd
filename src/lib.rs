//! fieldbake: exact signed distance fields from triangle meshes.
//!
//! Data walks one street: mesh, bake, volume, render. See ARCHITECTURE.md for the map and the conventions.

pub mod error;
pub mod grid;
pub mod progress;
