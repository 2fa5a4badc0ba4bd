// What rays and cones ask of solids: here of sampled fields alone. A scene that holds shapes too has another text in place of
// this one, see src/scene/kinds.rs.

#import scene_sampled

// The first t in [0, t_max] where a ray is in matter, or -1. The ray lies in the box of the surface.
fn solid_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return sampled_hit(field, origin, along, t_max);
}

// Distance in the thing's units; where it is not known, a lower bound.
fn field_distance(field: SceneField, p: vec3f) -> f32 {
    return sampled_distance(field, p);
}

// A better guess of the distance, which may be above it by second order.
fn field_guess(field: SceneField, p: vec3f) -> f32 {
    return sampled_guess(field, p);
}

// Gradient of the distance in the thing's own axes, near length 1; zero where there is none.
fn field_gradient(field: SceneField, p: vec3f) -> vec3f {
    return sampled_gradient(field, p);
}
