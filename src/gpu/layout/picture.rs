//! Structs of packing, and of the rays of pictures.

gpu_structs! {
    /// `shaders/atlas/atlas_pack.wgsl`.
    "atlas_pack": struct PackParams {
        corner: [u32; 2],
        tile: [u32; 2],
        shape: [u32; 3],
        gutter: u32,
        columns: u32,
        first_plane: u32,
        planes: u32,
        row_words: u32,
        word_texels: u32,
        steps: u32,
        scale: f32,
        scale_exponent: i32,
    }

    /// `shaders/shared/picture/picture_rays.wgsl`.
    "csg_draw": struct PictureRays {
        start: [f32; 3],
        width: u32,
        start_right: [f32; 3],
        height: u32,
        start_up: [f32; 3],
        first_row: u32,
        forward: [f32; 3],
        pixel: f32,
        right: [f32; 3],
        light_count: u32,
        up: [f32; 3],
        shadows: u32,
    }
}
