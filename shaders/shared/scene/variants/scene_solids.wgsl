// Intersections and distances of solids: this variant has sampled fields only. A scene with shapes imports another
// variant of this file, see src/scene/fields/shader_variants.rs.

#import scene_sampled

// The first t in [0, t_max] where a ray enters the solid, or -1. The ray lies in the box of the surface.
fn solid_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return levels_hit(field, origin, along, t_max);
}

// Distance in the object's units. Where it is not known, a lower bound.
fn field_distance(field: SceneField, p: vec3f) -> f32 {
    return sampled_distance(field, p);
}

// An estimate of the distance, which may exceed it by a second-order error. `distance` is the result of
// `field_distance`.
fn field_guess(field: SceneField, p: vec3f, distance: f32) -> f32 {
    return sampled_guess(field, p, distance);
}

// Gradient of the distance in the object's own axes, of about unit length; zero where it is undefined.
fn field_gradient(field: SceneField, p: vec3f) -> vec3f {
    return sampled_gradient(field, p);
}
