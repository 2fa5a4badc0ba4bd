// Intersections of rays with objects of any kind: this variant has solids only. A scene with quadrics imports another
// variant of this file, see src/scene/fields/shader_variants.rs.

#import scene_solids

// No object is tested by thin rays.
const HAS_THIN: bool = false;

// The first t in [0, t_max] where a ray enters the object, or -1. The ray lies in the box of the surface.
fn field_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return solid_hit(field, origin, along, t_max);
}

// `field_hit` for objects that cones test by thin rays.
fn thin_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return -1.0;
}
