// Stored fields of a scene: this variant has fields of one grid only. A scene with nested fields imports another variant
// of this file, see src/scene/fields/shader_variants.rs.

#import scene_sampled

fn stored_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return sampled_hit(field, origin, along, t_max);
}

fn stored_distance(field: SceneField, p: vec3f) -> f32 {
    return sampled_distance(field, p);
}

fn stored_guess(field: SceneField, p: vec3f, distance: f32) -> f32 {
    return sampled_guess(field, p, distance);
}

fn stored_gradient(field: SceneField, p: vec3f) -> vec3f {
    return sampled_gradient(field, p);
}
