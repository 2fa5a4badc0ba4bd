// One record of atlas.entries: everything that a shader needs to sample one volume. 208 bytes in std430 and std140.
struct AtlasEntry {
    // Maps from the volume's space to the world, and back.
    model: mat4x4f,
    inverse_model: mat4x4f,
    // Box of the surface and box of the samples, in the volume's space.
    inner_min: vec4f,
    inner_max: vec4f,
    outer_min: vec4f,
    outer_max: vec4f,
    // Layer of the texture array, and index of the row of strips.
    atlas_index: i32,
    atlas_offset: i32,
    // Distance that the texel value 1 stands for, in the volume's units. Unused padding if the texels are float32.
    scale: f32,
    padding: u32,
}

// Number of voxels along x, y and z.
fn atlas_shape(entry: AtlasEntry) -> vec3u {
    return vec3u(ATLAS_SIDE);
}

// Texel (x, y) of voxel (0, 0, z).
fn atlas_slice(entry: AtlasEntry, z: u32) -> vec2u {
    return vec2u(z, u32(entry.atlas_offset)) * ATLAS_SIDE;
}

// Distance that the texel value 1 stands for, in the volume's units.
fn atlas_scale(entry: AtlasEntry) -> f32 {
    return select(1.0, entry.scale, ATLAS_IS_SCALED);
}
