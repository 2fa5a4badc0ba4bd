// One record of atlas.entries: everything that a shader needs to sample one volume.
struct AtlasEntry {
    // Maps from the volume's space to the world, and back.
    model: mat4x4f,
    inverse_model: mat4x4f,
    // Box of the surface and box of the samples, in the volume's space.
    inner_min: vec4f,
    inner_max: vec4f,
    outer_min: vec4f,
    outer_max: vec4f,
    // Layer of the texture array, and index of the block's first texel, counted row by row.
    atlas_index: i32,
    atlas_offset: i32,
    // Distance that the texel value 1 stands for, in the volume's units.
    scale: f32,
    // Number of slices in a row of the block.
    columns: u32,
    // Number of voxels along x, y and z.
    shape: vec3u,
    gutter: u32,
    // First texel (x, y) of the block, and size of a slice including its gutters, in texels.
    corner: vec2u,
    tile: vec2u,
}

// Number of voxels along x, y and z.
fn atlas_shape(entry: AtlasEntry) -> vec3u {
    return entry.shape;
}

// Texel (x, y) of voxel (0, 0, z).
fn atlas_slice(entry: AtlasEntry, z: u32) -> vec2u {
    let column = vec2u(z % entry.columns, z / entry.columns);
    return entry.corner + column * entry.tile + entry.gutter;
}

// Distance that the texel value 1 stands for, in the volume's units.
fn atlas_scale(entry: AtlasEntry) -> f32 {
    return entry.scale;
}
