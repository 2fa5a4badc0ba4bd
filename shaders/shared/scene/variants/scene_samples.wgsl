// Access to the samples of fields: this variant has dense grids only. A scene with sparse fields imports another
// variant of this file, see src/scene/fields/shader_variants.rs.

#import scene_dense

// The field at a point inside the grid; `p` is in grid space.
fn sample_in_data(field: SceneField, p: vec3f) -> f32 {
    return dense_sample(field, p);
}

// Differences of the field over one voxel along each axis, centred at a point.
fn slope_in_data(field: SceneField, p: vec3f) -> vec3f {
    return dense_slope(field, p);
}

fn sampled_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return dense_hit(field, origin, along, t_max);
}
