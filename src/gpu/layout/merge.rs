//! Structs of merging.

gpu_structs! {
    /// A node of the tree over placed fields; `shaders/field/merge_owners.wgsl`.
    "merge_owners": struct MergeNode {
        min: [f32; 3],
        first: u32,
        max: [f32; 3],
        count: u32,
    }

    /// `shaders/field/merge_owners.wgsl`.
    "merge_owners": struct MergeField {
        row_x: [f32; 4],
        row_y: [f32; 4],
        row_z: [f32; 4],
        center: [f32; 3],
        grid: u32,
        lower: [f32; 3],
        sigma_min: f32,
        upper: [f32; 3],
        sigma_max: f32,
        inner_lower: [f32; 3],
        error: f32,
        inner_upper: [f32; 3],
        is_known: u32,
    }

    /// `shaders/field/merge_owners.wgsl`.
    "merge_owners": struct MergeGrid {
        shape: [u32; 3],
        first_sample: u32,
        spacing: [f32; 3],
        inverse_unit: f32,
    }

    /// `shaders/field/merge_owners.wgsl`.
    "merge_owners": struct MergeParams {
        shape: [u32; 3],
        first: u32,
        first_plane: u32,
        count: u32,
        pad_0: u32,
        pad_1: u32,
    }
}
