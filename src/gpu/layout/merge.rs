//! Structs of merging.

use bytemuck::{Pod, Zeroable};

/// A node of the tree over placed fields; `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeNode {
    pub min: [f32; 3],
    pub first: u32,
    pub max: [f32; 3],
    pub count: u32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeField {
    pub row_x: [f32; 4],
    pub row_y: [f32; 4],
    pub row_z: [f32; 4],
    pub center: [f32; 3],
    pub grid: u32,
    pub lower: [f32; 3],
    pub sigma_min: f32,
    pub upper: [f32; 3],
    pub sigma_max: f32,
    pub inner_lower: [f32; 3],
    pub error: f32,
    pub inner_upper: [f32; 3],
    pub is_known: u32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeGrid {
    pub shape: [u32; 3],
    pub first_sample: u32,
    pub spacing: [f32; 3],
    pub inverse_unit: f32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeParams {
    pub shape: [u32; 3],
    pub first: u32,
    pub first_plane: u32,
    pub count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}
