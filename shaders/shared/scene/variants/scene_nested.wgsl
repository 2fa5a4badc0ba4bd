// Nested fields of a scene: levels on grids, finest first, each finer than the one around it. Field space is the grid
// space of the finest level. Twin of src/scene/fields/nested.rs.
//
// The record of a nested field has the number of its levels in `shape.x`. The records of the levels follow it. Its
// values in `samples` are scale and offset of the map from field space to the grid of each level, three numbers each.

#import scene_sampled

const LEVEL_NUMBERS: u32 = 6u;

struct StoredPoint {
    field: SceneField,
    p: vec3f,
}

fn three_at(at: u32) -> vec3f {
    return vec3f(samples[at], samples[at + 1u], samples[at + 2u]);
}

fn level_scale(nested: SceneField, level: u32) -> vec3f {
    return three_at(nested.first_sample + LEVEL_NUMBERS * level);
}

fn in_level(nested: SceneField, level: u32, p: vec3f) -> vec3f {
    return level_scale(nested, level) * p + three_at(nested.first_sample + LEVEL_NUMBERS * level + 3u);
}

fn level_record(nested: SceneField, level: u32) -> SceneField {
    return fields[nested.first_block + level];
}

// Grid coordinate at which the region of a level begins: 0 (the first sample), or -0.5 (the box) for the outermost
// level.
fn border_of(nested: SceneField, level: u32) -> f32 {
    return select(0.0, -0.5, level + 1u == nested.shape.x);
}

// The grid in which a point is evaluated, and the point in its space.
fn stored_point(field: SceneField, p: vec3f) -> StoredPoint {
    if field.kind != KIND_NESTED { return StoredPoint(field, p); }
    var level = 0u;
    for (; level + 1u < field.shape.x; level++) {
        let q = in_level(field, level, p);
        if all(q >= vec3f(0.0)) && all(q <= vec3f(level_record(field, level).shape) - 1.0) { break; }
    }
    return StoredPoint(level_record(field, level), in_level(field, level, p));
}

// The interval of a ray in the region of a level. A miss returns an empty interval at the end of the ray.
fn part_of_level(nested: SceneField, level: u32, origin: vec3f, along: vec3f, t_max: f32) -> vec2f {
    let border = border_of(nested, level);
    let upper = vec3f(level_record(nested, level).shape) - 1.0 - border;
    let scale = level_scale(nested, level);
    let part = clip(in_level(nested, level, origin), scale * along, vec3f(border), upper, vec2f(0.0, t_max));
    return select(part, vec2f(t_max), part.x > part.y);
}

fn stored_distance(field: SceneField, p: vec3f) -> f32 {
    let at = stored_point(field, p);
    return sampled_distance(at.field, at.p);
}

fn stored_guess(field: SceneField, p: vec3f, distance: f32) -> f32 {
    let at = stored_point(field, p);
    return sampled_guess(at.field, at.p, distance);
}

fn stored_gradient(field: SceneField, p: vec3f) -> vec3f {
    let at = stored_point(field, p);
    return sampled_gradient(at.field, at.p);
}

// A ray through a nested field has pieces: in each level, one before it enters the next finer level and one behind it.
// A ray through one grid is one piece. The loop has one march, because drivers inline functions.
fn stored_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let is_nested = field.kind == KIND_NESTED;
    let outermost = select(0u, field.shape.x - 1u, is_nested);
    for (var piece = 0u; piece <= 2u * outermost && steps < MAX_STEPS; piece++) {
        var grid = field;
        var start = origin;
        var direction = along;
        var part = vec2f(0.0, t_max);
        if is_nested {
            // The pieces go inwards to the finest level, then outwards again.
            let is_inward = piece <= outermost;
            let level = select(piece - outermost, outermost - piece, is_inward);
            part = part_of_level(field, level, origin, along, t_max);
            if level > 0u {
                let finer = part_of_level(field, level - 1u, origin, along, t_max);
                part = select(vec2f(max(part.x, finer.y), part.y), vec2f(part.x, min(part.y, finer.x)), is_inward);
            }
            if part.x >= part.y { continue; }
            grid = level_record(field, level);
            direction = level_scale(field, level) * along;
            start = in_level(field, level, origin) + part.x * direction;
        }
        let hit = sampled_hit(grid, start, direction, part.y - part.x);
        if hit >= 0.0 { return part.x + hit; }
    }
    return -1.0;
}
