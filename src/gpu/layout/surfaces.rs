//! Structs of quadrics and shapes.

use super::picture::PictureRays;
use bytemuck::{Pod, Zeroable};

/// `shaders/quadrics.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QuadricParams {
    pub rays: PictureRays,
    pub background: [f32; 4],
    pub ambient: f32,
    pub specular: f32,
    pub shininess: f32,
    pub quadric_count: u32,
    pub node_count: u32,
    pub texels_per_row: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/quadrics.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QuadricPixel {
    pub color: [f32; 4],
    pub normal: [f32; 3],
    pub depth: f32,
    pub quadric: u32,
    pub steps: u32,
    pub state: u32,
    pub pad_0: u32,
}

/// A placed leaf or warp; `shaders/shared/csg_tables.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgLeaf {
    pub row_x: [f32; 3],
    pub shift_x: f32,
    pub row_y: [f32; 3],
    pub shift_y: f32,
    pub row_z: [f32; 3],
    pub shift_z: f32,
    pub a: [f32; 4],
    pub b: [f32; 2],
    pub kind: u32,
    pub first: u32,
}

/// `shaders/csg_points.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgPointParams {
    pub first: u32,
    pub count: u32,
    pub token_count: u32,
    pub pad_0: u32,
}

/// `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgDrawParams {
    pub rays: PictureRays,
    pub inverse_lipschitz: f32,
    pub node_count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// A node or a box; `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgBox {
    pub lower: [f32; 3],
    pub first: u32,
    pub upper: [f32; 3],
    pub count: u32,
    pub form: u32,
    pub parameters: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgPixel {
    pub normal: [f32; 3],
    pub t: f32,
    pub cell: u32,
    pub state: u32,
    pub steps: u32,
    pub tokens: u32,
}
