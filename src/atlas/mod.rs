//! The atlas: many fields in the layers of one 2D texture.
//!
//! # Theory
//!
//! A field is divided into its slices along z, and each slice is a tile of the page. The tiles of a field form one
//! [`AtlasBlock`]: `columns` tiles per row, rows below each other. Two layouts differ only in how blocks are made:
//!
//! - *Strips*, of the article "Packing 3D SDF to a 2D Texture": cubes of n voxels, all tiles in one row, blocks below
//!   each other. Texel (x + z n, y + row n); 64 fields of 64^3 fill a page of 4096^2.
//! - *Shelves*: fields of any shape, slices wrapped over rows, blocks placed in free areas ([`rectangles`]). A gutter
//!   of copies of the border surrounds each slice, so that a sampler with rounded weights does not read a neighbouring
//!   slice.
//!
//! ```text
//!   strips   | z=0 | z=1 | z=2 | z=3 |        shelves   | z=0 | z=1 |   . gutter   n = 4, columns = 2
//!                                                       | z=2 | z=3 |
//! ```
//!
//! Sampling takes one bilinear value from each of the two slices around the point and interpolates between them. This
//! is the trilinear function; the single tap of the article is discontinuous along z ([`sample`]).
//!
//! # Practice
//!
//! [`plan`] finds blocks, [`texels::write`] (on a device [`gpu`]) fills pages, and [`texels::read`] reads a field back
//! bit for bit. The plan depends only on the occupied blocks: an atlas grows and shrinks without moving other fields,
//! also after it was saved and loaded.

pub(crate) mod entry;
pub(crate) mod gpu;
#[cfg(test)]
mod gpu_tests;
pub(crate) mod plan;
pub(crate) mod rectangles;
pub(crate) mod sample;
pub(crate) mod shader;
pub(crate) mod texels;

use crate::error::{ArgumentError, choice};
use bytemuck::{Pod, Zeroable};
pub use gpu::DevicePages;

use rectangles::Rectangle;

/// Layout of the blocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Layout {
    /// Fields of any shape, slices wrapped over rows.
    Shelves {
        /// Number of texels around each slice.
        gutter: u32,
    },
    /// Equal cubes, all slices in one row, as in the article.
    Strips,
}

impl Layout {
    /// Converts the public name of a layout. Strips have no gutter.
    pub fn from_name(name: &str, gutter: u32) -> Result<Self, ArgumentError> {
        choice("layout", name, &[("shelves", Self::Shelves { gutter }), ("strips", Self::Strips)])
    }
}

/// Position of the slices of a field.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct AtlasBlock {
    /// Index of the page.
    pub page: u32,
    /// First texel: (column, row).
    pub corner: [u32; 2],
    /// Size of a slice with its gutters.
    pub tile: [u32; 2],
    /// Number of slices in a row.
    pub columns: u32,
    /// Width of the gutter around a slice, texels.
    pub gutter: u32,
    /// Number of voxels along x, y and z.
    pub shape: [u32; 3],
}

impl AtlasBlock {
    /// Rectangle of the slices and their gutters, texels.
    pub fn rectangle(&self) -> Rectangle {
        let [x, y] = self.corner;
        Rectangle { x, y, width: self.columns * self.tile[0], height: self.rows() * self.tile[1] }
    }

    /// Number of rows of slices.
    pub fn rows(&self) -> u32 {
        self.shape[2].div_ceil(self.columns)
    }

    /// Texel of voxel (0, 0, z).
    pub fn slice(&self, z: u32) -> [u32; 2] {
        [
            self.corner[0] + z % self.columns * self.tile[0] + self.gutter,
            self.corner[1] + z / self.columns * self.tile[1] + self.gutter,
        ]
    }

    /// Number of voxels of the field.
    pub fn voxels(&self) -> usize {
        self.shape.iter().map(|&n| n as usize).product()
    }

    /// Whether [`plan`] could have made this block on pages of this size, so that it is safe to read.
    pub fn is_sound(&self, page_size: u32, pages: u32) -> bool {
        let wide = |a: u32, b: u32| u64::from(a) * u64::from(b);
        let limit = u64::from(page_size);
        self.page < pages
            && self.columns > 0
            && self.shape.iter().all(|&n| n > 0 && n <= page_size)
            && self.gutter <= page_size
            && (0..2).all(|axis| u64::from(self.tile[axis]) == u64::from(self.shape[axis]) + wide(2, self.gutter))
            && u64::from(self.corner[0]) + wide(self.columns, self.tile[0]) <= limit
            && u64::from(self.corner[1]) + wide(self.rows(), self.tile[1]) <= limit
    }
}
