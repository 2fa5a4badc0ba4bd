// Nested fields of a scene, each level twice as fine as the level around it. Twin of src/scene/fields/nested.rs, which
// explains why the field has no jump. Field space is the grid space of the finest level.
//
// The record of a nested field: `shape.x` is the number of levels, and `first_block` the index of the record of the
// finest level in `fields`; the coarser levels follow it. `samples` has LEVEL_NUMBERS numbers per level:
//   0..2    scale of the map from field space to the grid space of the level: `scale * p + offset`
//   3..5    offset of the map
//   6..11   lower and upper corner of the region of the level, in its grid space

#import scene_samples

const LEVEL_NUMBERS: u32 = 12u;

// Vector k of a level: 0 scale, 1 offset, 2 lower corner, 3 upper corner of its region.
fn level_triple(field: SceneField, level: u32, k: u32) -> vec3f {
    let first = field.first_sample + LEVEL_NUMBERS * level + 3u * k;
    return vec3f(samples[first], samples[first + 1u], samples[first + 2u]);
}

fn in_level(field: SceneField, level: u32, p: vec3f) -> vec3f {
    return level_triple(field, level, 0u) * p + level_triple(field, level, 1u);
}

// The interval of a ray in the region of a level. A miss returns an empty interval at `t_max`.
fn part_in(field: SceneField, level: u32, origin: vec3f, along: vec3f, t_max: f32) -> vec2f {
    let part = clip(
        in_level(field, level, origin), level_triple(field, level, 0u) * along,
        level_triple(field, level, 2u), level_triple(field, level, 3u), vec2f(0.0, t_max),
    );
    return select(part, vec2f(t_max), part.x > part.y);
}

// The first hit of a ray. The ray is split into pieces: in each level, one before it enters the next finer level and
// one behind it.
fn nested_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    // The pieces go inwards to the finest level, then outwards again.
    let outermost = field.shape.x - 1u;
    for (var piece = 0u; piece <= 2u * outermost && steps < MAX_STEPS; piece++) {
        let is_inward = piece <= outermost;
        let level = select(piece - outermost, outermost - piece, is_inward);
        var part = part_in(field, level, origin, along, t_max);
        if level > 0u {
            let finer = part_in(field, level - 1u, origin, along, t_max);
            part = select(vec2f(max(part.x, finer.y), part.y), vec2f(part.x, min(part.y, finer.x)), is_inward);
        }
        if part.x >= part.y { continue; }
        let direction = level_triple(field, level, 0u) * along;
        let start = in_level(field, level, origin) + part.x * direction;
        let hit = sampled_hit(fields[field.first_block + level], start, direction, part.y - part.x);
        if hit >= 0.0 { return part.x + hit; }
    }
    return -1.0;
}

// The finest level that holds a point; the outermost level if none does.
fn level_of(field: SceneField, p: vec3f) -> u32 {
    let outermost = field.shape.x - 1u;
    for (var level = 0u; level < outermost; level++) {
        let q = in_level(field, level, p);
        if all(q >= level_triple(field, level, 2u)) && all(q <= level_triple(field, level, 3u)) { return level; }
    }
    return outermost;
}

// ---- in a scene with fields of one grid

struct InLevel {
    field: SceneField,
    p: vec3f,
}

// The grid that has the samples at a point, and the point in its grid space. A field of one grid has one level.
fn at_level(field: SceneField, p: vec3f) -> InLevel {
    if field.kind != KIND_NESTED { return InLevel(field, p); }
    let level = level_of(field, p);
    return InLevel(fields[field.first_block + level], in_level(field, level, p));
}

fn levels_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    if field.kind == KIND_NESTED { return nested_hit(field, origin, along, t_max); }
    return sampled_hit(field, origin, along, t_max);
}
