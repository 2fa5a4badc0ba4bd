//! Structs of scenes.

use bytemuck::{Pod, Zeroable};

/// A node of the tree over a scene's instances; `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SceneNode {
    pub min: [f32; 3],
    /// Leaf: first item. Inner node: left child; the right child follows it.
    pub first: u32,
    pub max: [f32; 3],
    /// Number of items in a leaf; 0 for an inner node.
    pub count: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SceneInstance {
    pub field_x: [f32; 4],
    pub field_y: [f32; 4],
    pub field_z: [f32; 4],
    pub local_x: [f32; 3],
    pub opacity: f32,
    pub local_y: [f32; 3],
    pub least_stretch: f32,
    pub local_z: [f32; 3],
    pub largest_stretch: f32,
    pub normal_x: [f32; 3],
    pub field: u32,
    pub normal_y: [f32; 3],
    pub casts_shadow: u32,
    pub normal_z: [f32; 3],
    pub voxel: f32,
    pub box_min: [f32; 3],
    pub prefers_rays: u32,
    pub box_max: [f32; 3],
    pub pad_1: u32,
    pub surface_lower: [f32; 3],
    pub surface_radius: f32,
    pub surface_upper: [f32; 3],
    pub pad_2: u32,
    pub field_extent: [f32; 3],
    pub pad_3: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SceneField {
    pub shape: [u32; 3],
    pub first_sample: u32,
    pub spacing: [f32; 3],
    pub first_block: u32,
    pub blocks: [u32; 3],
    pub kind: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Beam {
    pub p: [f32; 3],
    pub t_max: f32,
    pub direction: [f32; 3],
    pub slope: f32,
    pub normal: [f32; 3],
    pub bias_voxels: f32,
    pub own: u32,
    pub is_coarse: u32,
    pub skips_own: u32,
    pub pad_0: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Answer {
    pub value: f32,
    pub is_proven: u32,
    pub steps: u32,
    pub is_complete: u32,
    pub is_far: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BeamParams {
    pub first: u32,
    pub count: u32,
    pub far: u32,
    pub far_levels: u32,
    pub far_holds_all: u32,
    pub far_distance: f32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/scene_view.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RasterInstance {
    pub clip_x: [f32; 4],
    pub clip_y: [f32; 4],
    pub clip_w: [f32; 4],
    pub eye: [f32; 3],
    pub index: u32,
    pub ray: [f32; 3],
    pub first_face: u32,
    pub ray_x: [f32; 3],
    pub first_material: u32,
    pub ray_y: [f32; 3],
    pub is_mirrored: u32,
    pub middle: [f32; 2],
    pub pixel: f32,
    pub pad_0: u32,
}

/// `shaders/scene_triangles.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RasterMaterial {
    pub kind: u32,
    pub two_sided: u32,
    pub cutoff: f32,
    pub opacity: f32,
    pub first_level: u32,
    pub levels: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/scene_triangles.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TextureLevel {
    pub first: u32,
    pub width: u32,
    pub height: u32,
    pub pad_0: u32,
}
