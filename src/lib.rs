//! fieldbake: exact signed distance fields from triangle meshes.
//!
//! Data passes through a pipeline: mesh, bake, volume, render. See ARCHITECTURE.md for the map and the conventions. The
//! Python package is a layer above this crate; the crate itself needs neither Python nor a GPU:
//!
//! ```
//! use fieldbake::bake::{BakeOptions, bake};
//! use fieldbake::grid::Grid;
//! use fieldbake::mesh::Mesh;
//! use fieldbake::progress::Progress;
//! use glam::DVec3;
//!
//! // The tetrahedron x, y, z >= 0, x + y + z <= 1, with faces counter-clockwise as seen from outside.
//! let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
//! let mesh = Mesh::new(&corners, &[[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])?;
//! let grid = Grid::new(DVec3::splat(-0.5), DVec3::splat(1.5), [32; 3])?;
//! let baked = bake(&mesh, &grid, &BakeOptions::default(), &Progress::new())?;
//!
//! // Inside, near the slanted face: its distance is (1 - x - y - z) / sqrt(3), and negative.
//! let p = grid.center(11, 11, 11);
//! let truth = (p.element_sum() - 1.0) / 3f64.sqrt();
//! let sample = f64::from(baked.distances[grid.offset(11, 11, 11)]);
//! assert!((sample - truth).abs() <= 1e-6 * grid.diagonal());
//! assert!(baked.report.closed);
//! # Ok::<(), fieldbake::error::Error>(())
//! ```

#![cfg_attr(
    not(feature = "python"),
    allow(dead_code, unused_imports, reason = "the bindings alone use some of the inner items")
)]

pub mod assembly;
pub mod atlas;
pub mod bake;
mod bvh;
pub mod cloud;
pub mod csg;
pub mod encoding;
pub mod error;
pub mod geometry;
pub mod gpu;
pub mod grid;
mod march;
mod memory;
pub mod merge;
pub mod mesh;
mod openexr;
pub mod picture;
pub mod progress;
#[cfg(feature = "python")]
mod python;
pub mod quadric;
pub mod query;
pub mod render;
pub mod scene;
mod shader_text;
pub mod sign;
mod simd;
pub mod solid;
pub mod surface;
pub mod sweep;
mod viewer;
pub mod volume;
