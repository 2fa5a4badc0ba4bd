//! Structs of shapes.

use super::picture::PictureRays;

gpu_structs! {
    /// A placed leaf or warp; `shaders/shared/csg/csg_tables.wgsl`.
    "csg_points": struct CsgLeaf {
        row_x: [f32; 3],
        shift_x: f32,
        row_y: [f32; 3],
        shift_y: f32,
        row_z: [f32; 3],
        shift_z: f32,
        a: [f32; 4],
        b: [f32; 2],
        kind: u32,
        first: u32,
    }

    /// `shaders/csg/csg_points.wgsl`.
    "csg_points": struct CsgPointParams {
        first: u32,
        count: u32,
        token_count: u32,
        pad_0: u32,
    }

    /// `shaders/csg/csg_draw.wgsl`.
    "csg_draw": struct CsgDrawParams {
        rays: PictureRays,
        inverse_lipschitz: f32,
        node_count: u32,
        pad_0: u32,
        pad_1: u32,
    }

    /// A node or a box; `shaders/csg/csg_draw.wgsl`.
    "csg_draw": struct CsgBox {
        lower: [f32; 3],
        first: u32,
        upper: [f32; 3],
        count: u32,
        form: u32,
        parameters: u32,
        pad_0: u32,
        pad_1: u32,
    }

    /// `shaders/csg/csg_draw.wgsl`.
    "csg_draw": struct CsgPixel {
        normal: [f32; 3],
        t: f32,
        cell: u32,
        state: u32,
        steps: u32,
        tokens: u32,
    }
}
