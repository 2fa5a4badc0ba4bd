// Distances of sampled fields and hits of rays with them: this variant has fields of one grid only. A scene with nested
// fields imports another variant of this file, see src/scene/fields/shader_variants.rs.

#import scene_sampled

// The first t in [0, t_max] where a ray enters the field, or -1. The ray lies in the box of the surface.
fn levels_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return sampled_hit(field, origin, along, t_max);
}

// Distance in the object's units. Outside the grid it is a lower bound.
fn levels_distance(field: SceneField, p: vec3f) -> f32 {
    return sampled_distance(field, p);
}

// An estimate of the distance, closer than the lower bound `distance` outside the grid.
fn levels_guess(field: SceneField, p: vec3f, distance: f32) -> f32 {
    return sampled_guess(field, p, distance);
}

fn levels_gradient(field: SceneField, p: vec3f) -> vec3f {
    return sampled_gradient(field, p);
}
