//! Structs of bakes and of queries of points.

use bytemuck::{Pod, Zeroable};

/// A node of the binary tree; `shaders/shared/bvh.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    pub left_min: [f32; 3],
    /// A child: the index of a node, or a leaf (see `bvh::binary`).
    pub left: u32,
    pub left_max: [f32; 3],
    pub right: u32,
    pub right_min: [f32; 3],
    pub pad_0: u32,
    pub right_max: [f32; 3],
    pub pad_1: u32,
}

/// A triangle in its own frame; `shaders/shared/triangle.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    pub a: [f32; 3],
    pub face: u32,
    pub u: [f32; 3],
    pub length: f32,
    pub v: [f32; 3],
    pub left_length: f32,
    pub n: [f32; 3],
    pub right_length: f32,
    pub left: [f32; 2],
    pub right: [f32; 2],
}

/// `shaders/bake_distance.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct DistanceParams {
    pub shape: [u32; 3],
    pub first_block: u32,
    pub coarse_shape: [u32; 3],
    pub stride: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub pad_0: u32,
    pub limit_squared: f32,
}

/// `shaders/bake_finish.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct FinishParams {
    pub shape: [u32; 3],
    pub first_plane: u32,
    pub coarse_shape: [u32; 3],
    pub planes: u32,
    pub spacing_squared: [f32; 3],
    pub scale: f32,
    pub width: f32,
    pub half_thickness: f32,
    pub words_per_row: u32,
    pub stride: u32,
}

/// `shaders/bake_brute.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BruteParams {
    pub shape: [u32; 3],
    pub first_triangle: u32,
    pub triangle_count: u32,
    pub first_sample: u32,
    pub sample_count: u32,
    pub sign_rule: u32,
}

/// State of a sample of the brute-force bake; `shaders/bake_brute.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BruteState {
    pub squared: f32,
    pub nudged_squared: f32,
    pub behind: u32,
    pub crossings: u32,
}

/// `shaders/query_points.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QueryParams {
    pub first: u32,
    pub count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}
