//! Structs of pictures of fields, and of packing and copying.

use bytemuck::{Pod, Zeroable};

/// `shaders/atlas_pack.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PackParams {
    pub corner: [u32; 2],
    pub tile: [u32; 2],
    pub shape: [u32; 3],
    pub gutter: u32,
    pub columns: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub row_words: u32,
    pub word_texels: u32,
    pub steps: u32,
    pub scale: f32,
    pub scale_exponent: i32,
}

/// `shaders/field_to_texture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TextureParams {
    pub width: u32,
    pub height: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub words_per_row: u32,
    pub per_voxel: f32,
    pub workgroups_across: u32,
    pub pad_0: u32,
}

/// `shaders/shared/picture_rays.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PictureRays {
    pub start: [f32; 3],
    pub width: u32,
    pub start_right: [f32; 3],
    pub height: u32,
    pub start_up: [f32; 3],
    pub first_row: u32,
    pub forward: [f32; 3],
    pub pixel: f32,
    pub right: [f32; 3],
    pub light_count: u32,
    pub up: [f32; 3],
    pub shadows: u32,
}

/// `shaders/shared/picture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MarchParams {
    pub rays: PictureRays,
    pub shape: [u32; 3],
    pub band_start: u32,
    pub color: [f32; 3],
    pub band_end: u32,
    pub relative_spacing: [f32; 3],
    pub ambient: f32,
    pub background: [f32; 4],
    pub specular: f32,
    pub shininess: f32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/samples_encoded.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct StoredParams {
    pub encoding: u32,
    pub scale: f32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/bricks.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SparseParams {
    pub bricks: [u32; 3],
    pub floor: f32,
    pub node_step: [f32; 3],
    pub longest_step: f32,
}

/// `shaders/shared/nested.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct NestedLevel {
    pub shape: [u32; 3],
    pub first_sample: u32,
    pub offset: [f32; 3],
    pub scale: f32,
}

/// `shaders/shared/light.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Light {
    pub direction: [f32; 3],
    pub pad_0: u32,
    pub color: [f32; 3],
    pub pad_1: u32,
}

/// `shaders/shared/picture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Pixel {
    pub color: [f32; 4],
    pub normal: [f32; 3],
    pub depth: f32,
    pub steps: u32,
    pub is_hit: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}
