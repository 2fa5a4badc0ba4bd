// Where the samples of fields are: here in dense grids alone. A scene that holds sparse fields too has another text in place
// of this one, see src/scene/kinds.rs.

#import scene_dense

// At a point of the data.
fn sample_in_data(field: SceneField, p: vec3f) -> f32 {
    return dense_sample(field, p);
}

fn sampled_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return dense_hit(field, origin, along, t_max);
}
