// The pages, one layer each.
@group(0) @binding(0) var atlas_pages: texture_2d_array<f32>;
// Linear, clamped to the edge.
@group(0) @binding(1) var atlas_sampler: sampler;

// The nearest point of the box, in voxels: centres at whole numbers, -0.5 to n - 0.5.
fn atlas_grid_position(entry: AtlasEntry, p: vec3f) -> vec3f {
    let shape = vec3f(atlas_shape(entry));
    let p_grid = (p - entry.outer_min.xyz) / (entry.outer_max.xyz - entry.outer_min.xyz) * shape - 0.5;
    return clamp(p_grid, vec3f(-0.5), shape - 0.5);
}

// The share of a voxel; outside the grid, of the nearest one.
fn atlas_voxel(entry: AtlasEntry, voxel: vec3i) -> f32 {
    let inside = vec3u(clamp(voxel, vec3i(0), vec3i(atlas_shape(entry)) - 1));
    let texel = atlas_slice(entry, inside.z) + inside.xy;
    return atlas_share(textureLoad(atlas_pages, vec2i(texel), entry.atlas_index, 0).x);
}

// Bilinear in one slice: four texels.
fn atlas_bilinear(entry: AtlasEntry, cell: vec3i, fraction: vec2f) -> f32 {
    let low = mix(atlas_voxel(entry, cell), atlas_voxel(entry, cell + vec3i(1, 0, 0)), fraction.x);
    let high = mix(atlas_voxel(entry, cell + vec3i(0, 1, 0)), atlas_voxel(entry, cell + vec3i(1, 1, 0)), fraction.x);
    return mix(low, high, fraction.y);
}

// The distance at p, in the volume's space: the trilinear field, exactly. Needs no filter of the hardware.
// Outside the box it is the value of the box's nearest point, which is no bound of the distance there.
fn atlas_sample(entry: AtlasEntry, p: vec3f) -> f32 {
    let p_grid = atlas_grid_position(entry, p);
    let cell = floor(p_grid);
    let fraction = p_grid - cell;
    let near = atlas_bilinear(entry, vec3i(cell), fraction.xy);
    let far = atlas_bilinear(entry, vec3i(cell) + vec3i(0, 0, 1), fraction.xy);
    return mix(near, far, fraction.z) * atlas_scale(entry);
}

// The same by two taps of the hardware's filter, whose weights have 8 bits or so: off by up to 1/256 of the difference
// between neighbours. Without a gutter, and strips have none, the border takes as much from the next slice.
fn atlas_sample_filtered(entry: AtlasEntry, p: vec3f) -> f32 {
    // Clamped to the outermost centres, which is the same function: beyond them the field is constant.
    let last = vec3f(atlas_shape(entry)) - 1.0;
    let p_grid = clamp(atlas_grid_position(entry, p), vec3f(0.0), last);
    let z = floor(p_grid.z);
    let low = vec2f(atlas_slice(entry, u32(z))) + p_grid.xy + 0.5;
    let high = vec2f(atlas_slice(entry, u32(min(z + 1.0, last.z)))) + p_grid.xy + 0.5;
    let near = textureSampleLevel(atlas_pages, atlas_sampler, low / ATLAS_PAGE_SIZE, entry.atlas_index, 0.0).x;
    let far = textureSampleLevel(atlas_pages, atlas_sampler, high / ATLAS_PAGE_SIZE, entry.atlas_index, 0.0).x;
    return atlas_share(mix(near, far, p_grid.z - z)) * atlas_scale(entry);
}

// The stored distance of the voxel that holds p.
fn atlas_sample_nearest(entry: AtlasEntry, p: vec3f) -> f32 {
    return atlas_voxel(entry, vec3i(floor(atlas_grid_position(entry, p) + 0.5))) * atlas_scale(entry);
}

// Where p falls on its page, 0 to 1, in the slice that holds it: the article's ConvertWorldToTexture.
fn atlas_texture_coordinates(entry: AtlasEntry, p: vec3f) -> vec2f {
    let texture_position = atlas_grid_position(entry, p) + 0.5;
    let z = min(u32(texture_position.z), atlas_shape(entry).z - 1u);
    return (vec2f(atlas_slice(entry, z)) + texture_position.xy) / ATLAS_PAGE_SIZE;
}
