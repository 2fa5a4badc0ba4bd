// Shapes of a scene, traced and measured as a whole. Twin of src/scene/fields/shape.rs, and of `march` in
// src/csg/parts/trace.rs.
//
// Layout of a shape in `samples`:
//   0    index of its structure
//   1    1 / Lipschitz constant
//   2    the object's units per local unit
//   3    1 if the field is an exact distance, else 0
//   4..  parameters that the function of the structure reads

#import csg_root
#import scene_sampled
#import scene_structures

// Number of field units in a local unit.
const SHAPE_UNITS: f32 = 1024.0;
// Number of first-order steps to the surface.
const GUESSES: u32 = 3u;
// Half the step of the central differences, local units. Rounding leaves an error of 5e-4 in the gradient; a larger
// step would blur creases.
const SLOPE_STEP: f32 = 1.2207031e-4;

struct SceneShape {
    structure: u32,
    inverse_lipschitz: f32,
    scale: f32,
    is_exact: bool,
    // Index of the first parameter in `samples`.
    first: u32,
}

fn shape_of(field: SceneField) -> SceneShape {
    let at = field.first_sample;
    return SceneShape(u32(samples[at]), samples[at + 1u], samples[at + 2u], samples[at + 3u] != 0.0, at + 4u);
}

// The field at a point, local units.
fn shape_value(shape: SceneShape, p: vec3f) -> f32 {
    steps++;
    return structure_distance(shape.structure, p, shape.first);
}

// The gradient by central differences (xyz) and the field (w). The loop evaluates the field at one place of the text,
// because drivers inline functions.
fn shape_slope(shape: SceneShape, p: vec3f) -> vec4f {
    var found = vec4f(0.0);
    for (var i = 0u; i < 7u && steps < MAX_STEPS; i++) {
        let axis = i >> 1u;
        let step = select(SLOPE_STEP, -SLOPE_STEP, (i & 1u) != 0u);
        var at = p;
        if axis < 3u { at[axis] += step; }
        let value = shape_value(shape, at);
        if axis < 3u { found[axis] += value / (2.0 * step); } else { found.w = value; }
    }
    return found;
}

fn shape_distance(field: SceneField, p: vec3f) -> f32 {
    let shape = shape_of(field);
    return shape_value(shape, p / SHAPE_UNITS) * shape.inverse_lipschitz * shape.scale;
}

fn shape_guess(field: SceneField, p: vec3f) -> f32 {
    let shape = shape_of(field);
    let start = p / SHAPE_UNITS;
    var at = start;
    var bound = 0.0;
    for (var i = 0u; i < GUESSES; i++) {
        let there = shape_slope(shape, at);
        if i == 0u { bound = there.w * shape.inverse_lipschitz * shape.scale; }
        let steepness = dot(there.xyz, there.xyz);
        if shape.is_exact || bound <= 0.0 || steepness == 0.0 { break; }
        at -= there.w / steepness * there.xyz;
    }
    return max(bound, distance(at, start) * shape.scale);
}

fn shape_gradient(field: SceneField, p: vec3f) -> vec3f {
    let slope = shape_slope(shape_of(field), p / SHAPE_UNITS).xyz;
    let size = length(slope);
    return select(slope / max(size, TINY), vec3f(0.0), size == 0.0);
}

// The first root on [0, t_max), or -1.
fn shape_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let shape = shape_of(field);
    let per_t = length(along) / SHAPE_UNITS;
    let start = origin / SHAPE_UNITS;
    let direction = normalize(along);
    let end = t_max * per_t;
    var search = search_from(0.0);
    var state = SEARCHING;
    for (var i = 0u; i < MAX_MARCH_STEPS && state == SEARCHING && steps < MAX_STEPS; i++) {
        state = search_on(&search, shape_value(shape, start + search.t * direction), shape.inverse_lipschitz, end);
    }
    return select(-1.0, search.t / per_t, state == FOUND && (search.t < end || search.t == 0.0));
}

// ---- in a scene with sampled fields

fn solid_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    if field.kind == KIND_SHAPE { return shape_hit(field, origin, along, t_max); }
    return levels_hit(field, origin, along, t_max);
}

fn field_distance(field: SceneField, p: vec3f) -> f32 {
    if field.kind == KIND_SHAPE { return shape_distance(field, p); }
    return sampled_distance(field, p);
}

fn field_guess(field: SceneField, p: vec3f, distance: f32) -> f32 {
    if field.kind == KIND_SHAPE { return shape_guess(field, p); }
    return sampled_guess(field, p, distance);
}

fn field_gradient(field: SceneField, p: vec3f) -> vec3f {
    if field.kind == KIND_SHAPE { return shape_gradient(field, p); }
    return sampled_gradient(field, p);
}
