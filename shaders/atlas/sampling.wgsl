// The pages: one layer of the texture array per page.
@group(0) @binding(0) var atlas_pages: texture_2d_array<f32>;

// Clamps p to the box and returns it in grid space: voxel centres at whole numbers, range -0.5 to n - 0.5.
fn atlas_grid_position(entry: AtlasEntry, p: vec3f) -> vec3f {
    let shape = vec3f(atlas_shape(entry));
    let p_grid = (p - entry.outer_min.xyz) / (entry.outer_max.xyz - entry.outer_min.xyz) * shape - 0.5;
    return clamp(p_grid, vec3f(-0.5), shape - 0.5);
}

// The stored value of a voxel, as a fraction of the scale. A voxel outside the grid reads the nearest voxel inside.
fn atlas_voxel(entry: AtlasEntry, voxel: vec3i) -> f32 {
    let inside = vec3u(clamp(voxel, vec3i(0), vec3i(atlas_shape(entry)) - 1));
    let texel = atlas_slice(entry, inside.z) + inside.xy;
    return atlas_share(textureLoad(atlas_pages, vec2i(texel), entry.atlas_index, 0).x);
}

// Bilinear interpolation within one slice. Reads four texels.
fn atlas_bilinear(entry: AtlasEntry, cell: vec3i, fraction: vec2f) -> f32 {
    let low = mix(atlas_voxel(entry, cell), atlas_voxel(entry, cell + vec3i(1, 0, 0)), fraction.x);
    let high = mix(atlas_voxel(entry, cell + vec3i(0, 1, 0)), atlas_voxel(entry, cell + vec3i(1, 1, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// The distance at p, in the volume's space: the exact trilinear interpolation, without hardware filtering. Outside the
// box the function returns the value at the nearest point of the box, which is no bound on the distance there.
fn atlas_sample(entry: AtlasEntry, p: vec3f) -> f32 {
    let p_grid = atlas_grid_position(entry, p);
    let cell = floor(p_grid);
    let fraction = p_grid - cell;
    let near = atlas_bilinear(entry, vec3i(cell), fraction.xy);
    let far = atlas_bilinear(entry, vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    return mix(near, far, fraction.z) * atlas_scale(entry);
}

// The stored distance of the voxel that contains p.
fn atlas_sample_nearest(entry: AtlasEntry, p: vec3f) -> f32 {
    return atlas_voxel(entry, vec3i(floor(atlas_grid_position(entry, p) + 0.5))) * atlas_scale(entry);
}

// Texture coordinates of p on its page, 0 to 1, in the slice that contains p. This is ConvertWorldToTexture of the
// article.
fn atlas_texture_coordinates(entry: AtlasEntry, p: vec3f) -> vec2f {
    let texture_position = atlas_grid_position(entry, p) + 0.5;
    let z = min(u32(texture_position.z), atlas_shape(entry).z - 1u);
    return (vec2f(atlas_slice(entry, z)) + texture_position.xy) / ATLAS_PAGE_SIZE;
}
