//! Records of the fields of an atlas for a storage buffer: everything that a shader needs.
//!
//! Strips have the article's record, 208 bytes in std430, to the byte. Shelves have the same first 200 bytes, followed
//! by the layout of the slices. Matrices are stored by columns, as GLSL and WGSL read them.

use super::AtlasBlock;
use bytemuck::{Pod, Zeroable};
use glam::{DMat4, DVec3};

/// The article's struct `PackedSdfOffsetDetail`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct StripEntry {
    pub model: [f32; 16],
    pub inverse_model: [f32; 16],
    pub inner_min: [f32; 4],
    pub inner_max: [f32; 4],
    pub outer_min: [f32; 4],
    pub outer_max: [f32; 4],
    /// Index of the page; -1 for an entry without a field.
    pub atlas_index: i32,
    /// Index of the row of strips.
    pub atlas_offset: i32,
    /// Factor of a texel; zero for float32. This field and the next one are padding in the article.
    pub scale: f32,
    pub padding: u32,
}

/// The record of a field of any shape; `AtlasEntry` in `shaders/atlas/shelves.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub(crate) struct AtlasEntry {
    pub model: [f32; 16],
    pub inverse_model: [f32; 16],
    pub inner_min: [f32; 4],
    pub inner_max: [f32; 4],
    pub outer_min: [f32; 4],
    pub outer_max: [f32; 4],
    /// Index of the page; -1 for an entry without a field.
    pub atlas_index: i32,
    /// First texel of the block, counted row by row.
    pub atlas_offset: i32,
    /// Factor of a texel; see [`crate::encoding::Encoding::scale`].
    pub scale: f32,
    /// Number of slices in a row.
    pub columns: u32,
    pub shape: [u32; 3],
    pub gutter: u32,
    /// First texel of the block: (column, row).
    pub corner: [u32; 2],
    /// Size of a slice with its gutters.
    pub tile: [u32; 2],
}

/// Position and boxes of a field, world units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facts {
    pub block: AtlasBlock,
    pub inner: [DVec3; 2],
    pub outer: [DVec3; 2],
    /// Transform from the field's own space to the world.
    pub model: DMat4,
    /// Factor of a texel; `None` for float32.
    pub scale: Option<f32>,
}

impl Facts {
    pub(crate) fn strip_entry(&self) -> StripEntry {
        let block = &self.block;
        let AtlasEntry { model, inverse_model, inner_min, inner_max, outer_min, outer_max, atlas_index, .. } =
            self.atlas_entry(0);
        let atlas_offset = (block.corner[1] / block.shape[1]) as i32;
        let scale = self.scale.unwrap_or(0.0);
        StripEntry {
            model,
            inverse_model,
            inner_min,
            inner_max,
            outer_min,
            outer_max,
            atlas_index,
            atlas_offset,
            scale,
            padding: 0,
        }
    }

    pub(crate) fn atlas_entry(&self, page_size: u32) -> AtlasEntry {
        let block = &self.block;
        AtlasEntry {
            model: self.model.as_mat4().to_cols_array(),
            inverse_model: self.model.inverse().as_mat4().to_cols_array(),
            inner_min: position(self.inner[0]),
            inner_max: position(self.inner[1]),
            outer_min: position(self.outer[0]),
            outer_max: position(self.outer[1]),
            atlas_index: block.page as i32,
            atlas_offset: (block.corner[1] * page_size + block.corner[0]) as i32,
            scale: self.scale.unwrap_or(1.0),
            columns: block.columns,
            shape: block.shape,
            gutter: block.gutter,
            corner: block.corner,
            tile: block.tile,
        }
    }
}

/// A position as a vec4 with w = 1.
fn position(p: DVec3) -> [f32; 4] {
    p.as_vec3().extend(1.0).to_array()
}
