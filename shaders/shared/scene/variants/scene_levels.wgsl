// The levels of sampled fields: this variant has fields of one grid only. A scene with nested fields imports another
// variant of this file, see src/scene/fields/shader_variants.rs.

#import scene_samples

struct InLevel {
    field: SceneField,
    p: vec3f,
}

// The grid that has the samples at a point, and the point in its grid space.
fn at_level(field: SceneField, p: vec3f) -> InLevel {
    return InLevel(field, p);
}

// The first t in [0, t_max] where a ray enters the field, or -1. The ray lies in the box of the surface.
fn levels_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return sampled_hit(field, origin, along, t_max);
}
