// What a ray meets, of whatever kind: here solids alone. A scene that holds quadrics too has another text in place
// of this one, see src/scene/kinds.rs.

#import scene_solids

// Nothing is asked by thin rays.
const HAS_THIN: bool = false;

// The first t in [0, t_max] where a ray is in matter, or -1. The ray lies in the box of the surface.
fn field_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return solid_hit(field, origin, along, t_max);
}

// The same of what is asked by thin rays.
fn thin_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return -1.0;
}
