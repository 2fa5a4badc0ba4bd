// What is known of a volume: a record of atlas.entries.
struct AtlasEntry {
    // World from the volume's space, and back.
    model: mat4x4f,
    inverse_model: mat4x4f,
    // Box of the surface, and box of the samples, in the volume's space.
    inner_min: vec4f,
    inner_max: vec4f,
    outer_min: vec4f,
    outer_max: vec4f,
    // Layer of the texture, and first texel of the block counted row by row.
    atlas_index: i32,
    atlas_offset: i32,
    // Distance of a texel with the value 1.
    scale: f32,
    // Slices in a row.
    columns: u32,
    // Voxels along x, y and z.
    shape: vec3u,
    gutter: u32,
    // First texel of the block, and size of a slice with its gutters.
    corner: vec2u,
    tile: vec2u,
}

// Voxels along x, y and z.
fn atlas_shape(entry: AtlasEntry) -> vec3u {
    return entry.shape;
}

// Texel of voxel (0, 0, z).
fn atlas_slice(entry: AtlasEntry, z: u32) -> vec2u {
    let column = vec2u(z % entry.columns, z / entry.columns);
    return entry.corner + column * entry.tile + entry.gutter;
}

// Distance of a texel with the value 1.
fn atlas_scale(entry: AtlasEntry) -> f32 {
    return entry.scale;
}
