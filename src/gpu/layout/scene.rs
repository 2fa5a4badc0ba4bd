//! Structs of scenes.

gpu_structs! {
    /// A node of the tree over a scene's instances; `shaders/shared/scene/scene_tree.wgsl`.
    "scene_beams": struct SceneNode {
        min: [f32; 3],
        /// Leaf: first instance. Inner node: left child; the right child follows it.
        first: u32,
        max: [f32; 3],
        /// Leaf: 1 + the second instance, or 1 + the first if the leaf has only one. Inner node: 0.
        second: u32,
    }

    /// `shaders/shared/scene/scene_field.wgsl`.
    "scene_beams": struct SceneInstance {
        field_x: [f32; 4],
        field_y: [f32; 4],
        field_z: [f32; 4],
        local_x: [f32; 3],
        opacity: f32,
        local_y: [f32; 3],
        least_stretch: f32,
        local_z: [f32; 3],
        largest_stretch: f32,
        normal_x: [f32; 3],
        field: u32,
        normal_y: [f32; 3],
        casts_shadow: u32,
        normal_z: [f32; 3],
        voxel: f32,
        box_min: [f32; 3],
        prefers_rays: u32,
        box_max: [f32; 3],
        pad_1: u32,
        surface_lower: [f32; 3],
        surface_radius: f32,
        surface_upper: [f32; 3],
        pad_2: u32,
        field_extent: [f32; 3],
        pad_3: u32,
    }

    /// `shaders/shared/scene/scene_field.wgsl`.
    "scene_beams": struct SceneField {
        shape: [u32; 3],
        first_sample: u32,
        spacing: [f32; 3],
        first_block: u32,
        blocks: [u32; 3],
        kind: u32,
    }

    /// `shaders/shared/scene/scene_beam.wgsl`.
    "scene_beams": struct Beam {
        p: [f32; 3],
        t_max: f32,
        direction: [f32; 3],
        slope: f32,
        normal: [f32; 3],
        bias_voxels: f32,
        own: u32,
        is_coarse: u32,
        cut: u32,
        owner: u32,
    }

    /// `shaders/shared/scene/scene_beam.wgsl`.
    "scene_beams": struct BeamResult {
        value: f32,
        is_proven: u32,
        steps: u32,
        is_complete: u32,
        is_far: u32,
    }

    /// `shaders/scene/scene_beams.wgsl`.
    "scene_beams": struct BeamParams {
        first: u32,
        count: u32,
        far: u32,
        far_levels: u32,
        far_holds_all: u32,
        far_distance: f32,
        pad_0: u32,
        pad_1: u32,
    }

    /// `shaders/scene/scene_cuts.wgsl`.
    "scene_cuts": struct CutParams {
        first: u32,
        count: u32,
        cones: u32,
        pad_0: u32,
    }

    /// `shaders/scene/scene_surfaces.wgsl`.
    "scene_surfaces": struct SurfaceLight {
        place: [f32; 3],
        size: f32,
        is_point: u32,
        pad_0: u32,
        pad_1: u32,
        pad_2: u32,
    }

    /// `shaders/scene/scene_surfaces.wgsl`.
    "scene_surfaces": struct SurfaceParams {
        eye: [f32; 3],
        width: u32,
        ray: [f32; 3],
        stride: u32,
        ray_x: [f32; 3],
        light_count: u32,
        ray_y: [f32; 3],
        bias_voxels: f32,
        height: u32,
        tile_columns: u32,
        tile_count: u32,
        tile_step: u32,
        lights: [SurfaceLight; 16],
    }

    /// `shaders/scene/scene_surfaces.wgsl`.
    "scene_surfaces": struct TileParams {
        first: u32,
        count: u32,
        next: u32,
        start: u32,
        end: u32,
        pad_0: u32,
        pad_1: u32,
        pad_2: u32,
    }

    /// `shaders/shared/scene/scene_view.wgsl`.
    "scene_fields": struct RasterInstance {
        clip_x: [f32; 4],
        clip_y: [f32; 4],
        clip_depth: [f32; 4],
        start: [f32; 3],
        index: u32,
        ray: [f32; 3],
        first_face: u32,
        ray_x: [f32; 3],
        first_material: u32,
        ray_y: [f32; 3],
        is_mirrored: u32,
        middle: [f32; 2],
        pixel: f32,
        is_parallel: u32,
    }

    /// `shaders/scene/scene_triangles.wgsl`.
    "scene_triangles": struct RasterMaterial {
        kind: u32,
        two_sided: u32,
        cutoff: f32,
        opacity: f32,
        first_level: u32,
        levels: u32,
        pad_0: u32,
        pad_1: u32,
    }

    /// `shaders/scene/scene_triangles.wgsl`.
    "scene_triangles": struct TextureLevel {
        first: u32,
        width: u32,
        height: u32,
        pad_0: u32,
    }
}
