// Quadrics of a scene: sheets in trim spheres about the origin of field space. Twin of src/scene/fields/quadric.rs.
//
// The record of a quadric in `samples` is the 4x4 matrix of its form in the frame of the trim sphere, by columns.

#import scene_solids
#import quadric

// Radius of the trim sphere in field units.
const QUADRIC_UNITS: f32 = 1024.0;

fn quadric_column(field: SceneField, column: u32) -> vec4f {
    let first = field.first_sample + 4u * column;
    return vec4f(samples[first], samples[first + 1u], samples[first + 2u], samples[first + 3u]);
}

// The first t in [0, t_max] where a ray crosses the sheet, or -1.
fn quadric_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let last = quadric_column(field, 3u);
    let m = mat3x3f(
        quadric_column(field, 0u).xyz, quadric_column(field, 1u).xyz, quadric_column(field, 2u).xyz
    );
    let per_t = length(along) / QUADRIC_UNITS;
    let found = quadric_crossings(QuadricForm(m, last.xyz, last.w), origin / QUADRIC_UNITS, normalize(along));
    let is_ahead = found >= vec2f(0.0) & found <= vec2f(t_max * per_t);
    let ahead = select(vec2f(NO_CROSSING), found, is_ahead);
    let first = min(ahead.x, ahead.y);
    return select(-1.0, first / per_t, first < NO_CROSSING);
}

// ---- in a scene with other objects

const HAS_THIN: bool = true;

// The first t in [0, t_max] where a ray enters the object, or -1. The ray lies in the box of the surface.
fn field_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    if field.kind == KIND_QUADRIC { return quadric_hit(field, origin, along, t_max); }
    return solid_hit(field, origin, along, t_max);
}

// `field_hit` for objects that cones test by thin rays.
fn thin_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    return quadric_hit(field, origin, along, t_max);
}
