// What is known of a volume: a record of atlas.entries, 208 bytes in std430 and std140.
struct AtlasEntry {
    // World from the volume's space, and back.
    model: mat4x4f,
    inverse_model: mat4x4f,
    // Box of the surface, and box of the samples, in the volume's space.
    inner_min: vec4f,
    inner_max: vec4f,
    outer_min: vec4f,
    outer_max: vec4f,
    // Layer of the texture, and row of strips.
    atlas_index: i32,
    atlas_offset: i32,
    // Distance of a texel with the value 1; for float32 texels padding.
    scale: f32,
    padding: u32,
}

// Voxels along x, y and z.
fn atlas_shape(entry: AtlasEntry) -> vec3u {
    return vec3u(ATLAS_SIDE);
}

// Texel of voxel (0, 0, z).
fn atlas_slice(entry: AtlasEntry, z: u32) -> vec2u {
    return vec2u(z, u32(entry.atlas_offset)) * ATLAS_SIDE;
}

// Distance of a texel with the value 1.
fn atlas_scale(entry: AtlasEntry) -> f32 {
    return select(1.0, entry.scale, ATLAS_IS_SCALED);
}
