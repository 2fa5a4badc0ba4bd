// Fields nested in each other, each twice as fine as the one around it, as one. Twin of src/scene/nested.rs, which says why
// the field has no jump. Grid space is the finest level's, carried on over the box of the outermost one.

#import ray

struct NestedLevel {
    shape: vec3u,
    // Where its samples begin.
    first_sample: u32,
    // Its own grid space: `scale * p_grid + offset`.
    offset: vec3f,
    scale: f32,
}

// Of all levels, finest first.
@group(0) @binding(1) var<storage, read> distances: array<f32>;
@group(0) @binding(5) var<storage, read> levels: array<NestedLevel>;

// Twice the levels at most, as in python/fieldbake/merging/nested.py.
const MAX_PIECES: u32 = 24u;

// Where the samples begin of the level that is read.
var<private> first_sample: u32;

fn stored_sample(index: u32) -> f32 {
    return distances[first_sample + index];
}

fn in_level(k: u32, p_grid: vec3f) -> vec3f {
    return levels[k].scale * p_grid + levels[k].offset;
}

// How far within its box a level answers, in its voxels: between its samples, the outermost one everywhere.
fn border_of(k: u32) -> f32 {
    return select(0.0, -0.5, k + 1u == arrayLength(&levels));
}

// From and to where a ray is in a level's region; an empty part at its end where it misses.
fn part_in(k: u32, ray: ClippedRay) -> vec2f {
    let border = border_of(k);
    let upper = vec3f(levels[k].shape) - 1.0 - border;
    let clipped = clip_between(in_level(k, ray.origin), ray.direction, vec3f(border), upper);
    if !clipped.is_in_box { return vec2f(ray.t_max); }
    return min(vec2f(clipped.t_enter, clipped.t_enter + clipped.t_max) / levels[k].scale, vec2f(ray.t_max));
}

// The first hit of a ray: one piece in each level before it enters the next finer one and one behind it.
fn first_hit(ray: ClippedRay) -> Hit {
    var hit: Hit;
    var steps = 0u;
    // Inwards to the finest level, and outwards again.
    let outermost = arrayLength(&levels) - 1u;
    for (var piece = 0u; piece < MAX_PIECES; piece++) {
        if piece > 2u * outermost { break; }
        let is_inward = piece <= outermost;
        let k = select(piece - outermost, outermost - piece, is_inward);
        var part = part_in(k, ray);
        if k > 0u {
            let finer = part_in(k - 1u, ray);
            part = select(vec2f(max(part.x, finer.y), part.y), vec2f(part.x, min(part.y, finer.x)), is_inward);
        }
        if part.x >= part.y { continue; }

        first_sample = levels[k].first_sample;
        let scale = levels[k].scale;
        var in_piece = ray;
        in_piece.origin = in_level(k, ray.origin) + part.x * scale * ray.direction;
        in_piece.t_max = (part.y - part.x) * scale;
        hit = march(in_piece, levels[k].shape);
        steps += hit.steps;
        if hit.is_hit {
            hit.t = part.x + hit.t / scale;
            hit.at_start = hit.at_start && part.x == 0.0;
            break;
        }
    }
    hit.steps = steps;
    return hit;
}

// The gradient in the finest level that holds a point, averaged over a voxel of that; inward of the outer half voxel, where
// the field is constant along an axis.
fn slope_at(p_grid: vec3f) -> vec3f {
    var k = 0u;
    for (; k < MAX_PIECES; k++) {
        if k + 1u >= arrayLength(&levels) { break; }
        let p = in_level(k, p_grid);
        if all(p >= vec3f(0.0)) && all(p <= vec3f(levels[k].shape) - 1.0) { break; }
    }
    first_sample = levels[k].first_sample;
    let shape = levels[k].shape;
    let high = vec3f(shape) - 1.5;
    return slope_over_voxel(clamp(in_level(k, p_grid), min(vec3f(0.5), high), high), shape);
}

// From all sides alike, as in scenes, where the CPU draws nested fields.
fn ambient_on(normal: vec3f) -> f32 {
    return params.ambient;
}
