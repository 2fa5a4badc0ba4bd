// Linear filter, addresses clamped to the edge.
@group(0) @binding(1) var atlas_sampler: sampler;

// The distance at p by two taps of the hardware filter, whose weights have about 8 bits: the error is up to 1/256 of
// the difference between neighbouring samples. Without a gutter (strips have none), the samples of the border mix with
// the neighbouring slice by the same amount.
fn atlas_sample_filtered(entry: AtlasEntry, p: vec3f) -> f32 {
    // Clamps to the outermost voxel centres. The field is constant beyond them, so the function does not change.
    let last = vec3f(atlas_shape(entry)) - 1.0;
    let p_grid = clamp(atlas_grid_position(entry, p), vec3f(0.0), last);
    let z = floor(p_grid.z);
    let low = vec2f(atlas_slice(entry, u32(z))) + p_grid.xy + 0.5;
    let high = vec2f(atlas_slice(entry, u32(min(z + 1.0, last.z)))) + p_grid.xy + 0.5;
    let near = textureSampleLevel(atlas_pages, atlas_sampler, low / ATLAS_PAGE_SIZE, entry.atlas_index, 0.0).x;
    let far = textureSampleLevel(atlas_pages, atlas_sampler, high / ATLAS_PAGE_SIZE, entry.atlas_index, 0.0).x;
    return atlas_share(mix(near, far, p_grid.z - z)) * atlas_scale(entry);
}
