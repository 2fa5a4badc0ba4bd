//! Structs of bakes and of queries of points.

gpu_structs! {
    /// A node of the binary tree; `shaders/shared/mesh/tree.wgsl`.
    "bake_distance": struct Node {
        left_min: [f32; 3],
        /// A child: the index of a node, or a leaf (see `bvh::binary`).
        left: u32,
        left_max: [f32; 3],
        right: u32,
        right_min: [f32; 3],
        pad_0: u32,
        right_max: [f32; 3],
        pad_1: u32,
    }

    /// A triangle in its own frame; `shaders/shared/mesh/triangle.wgsl`.
    "bake_distance": struct Triangle {
        a: [f32; 3],
        face: u32,
        u: [f32; 3],
        length: f32,
        v: [f32; 3],
        left_length: f32,
        n: [f32; 3],
        right_length: f32,
        left: [f32; 2],
        right: [f32; 2],
    }

    /// `shaders/mesh/bake_distance.wgsl`.
    "bake_distance": struct DistanceParams {
        shape: [u32; 3],
        first_block: u32,
        coarse_shape: [u32; 3],
        stride: u32,
        first_plane: u32,
        planes: u32,
        pad_0: u32,
        limit_squared: f32,
    }

    /// `shaders/mesh/bake_finish.wgsl`.
    "bake_finish": struct FinishParams {
        shape: [u32; 3],
        first_plane: u32,
        coarse_shape: [u32; 3],
        planes: u32,
        spacing_squared: [f32; 3],
        scale: f32,
        width: f32,
        half_thickness: f32,
        words_per_row: u32,
        stride: u32,
    }

    /// `shaders/mesh/bake_brute.wgsl`.
    "bake_brute": struct BruteParams {
        shape: [u32; 3],
        first_triangle: u32,
        triangle_count: u32,
        first_sample: u32,
        sample_count: u32,
        sign_rule: u32,
    }

    /// State of a sample of the brute-force bake; `shaders/mesh/bake_brute.wgsl`.
    "bake_brute": struct BruteState {
        squared: f32,
        nudged_squared: f32,
        behind: u32,
        crossings: u32,
    }

    /// `shaders/field/field_cells.wgsl`.
    "field_cells": struct CellParams {
        shape: [u32; 3],
        first: u32,
        count: u32,
        first_plane: u32,
        end_plane: u32,
        pad_0: u32,
    }

    /// `shaders/mesh/query_points.wgsl`.
    "query_points": struct QueryParams {
        first: u32,
        count: u32,
        pad_0: u32,
        pad_1: u32,
    }

    /// `shaders/mesh/cast_rays.wgsl`.
    "cast_rays": struct CastParams {
        first: u32,
        count: u32,
        /// Kind of search.
        mode: u32,
        pad_0: u32,
    }

    /// A ray, clipped to the box of a mesh, in local units.
    "cast_rays": struct CastRay {
        /// Position at which the ray enters the box.
        origin: [f32; 3],
        /// Largest `t` of a hit, in the scaled direction from `origin`; MISSED or UNSUITED if the device must not
        /// search.
        limit: f32,
        /// The direction, divided by the magnitude of its largest component.
        direction: [f32; 3],
        /// Axis of the largest component.
        axis: u32,
        /// Reciprocals of the scaled direction.
        inverse: [f32; 3],
        pad_0: u32,
    }

    /// The corners of a triangle, local units.
    "cast_rays": struct Corners {
        a: [f32; 3],
        face: u32,
        b: [f32; 3],
        pad_0: u32,
        c: [f32; 3],
        pad_1: u32,
    }
}
