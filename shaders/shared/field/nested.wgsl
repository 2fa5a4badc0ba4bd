// Nested fields, each twice as fine as the one around it, evaluated as one field. Twin of src/scene/fields/nested.rs,
// which explains why the field has no jump. Grid space is the grid space of the finest level, extended over the box of
// the outermost one.

#import ray

struct NestedLevel {
    shape: vec3u,
    // Index of the level's first sample in `distances`.
    first_sample: u32,
    // Map to the grid space of this level: `scale * p_grid + offset`.
    offset: vec3f,
    scale: f32,
}

// Samples of all levels, finest level first.
@group(0) @binding(1) var<storage, read> distances: array<f32>;
@group(0) @binding(5) var<storage, read> levels: array<NestedLevel>;

// Largest number of pieces: twice the largest number of levels (python/fieldbake/merging/nested.py).
const MAX_PIECES: u32 = 24u;

// First sample of the level that is being read.
var<private> first_sample: u32;

fn stored_sample(index: u32) -> f32 {
    return distances[first_sample + index];
}

fn in_level(k: u32, p_grid: vec3f) -> vec3f {
    return levels[k].scale * p_grid + levels[k].offset;
}

// Grid coordinate at which the region of a level begins: 0 (the first sample), or -0.5 (the box) for the outermost
// level.
fn border_of(k: u32) -> f32 {
    return select(0.0, -0.5, k + 1u == arrayLength(&levels));
}

// The interval of a ray in the region of a level. A miss returns an empty interval at the end of the ray.
fn part_in(k: u32, ray: ClippedRay) -> vec2f {
    let border = border_of(k);
    let upper = vec3f(levels[k].shape) - 1.0 - border;
    let clipped = clip_between(in_level(k, ray.origin), ray.direction, vec3f(border), upper);
    if !clipped.is_in_box { return vec2f(ray.t_max); }
    return min(vec2f(clipped.t_enter, clipped.t_enter + clipped.t_max) / levels[k].scale, vec2f(ray.t_max));
}

// The first hit of a ray. The ray is split into pieces: in each level, one before it enters the next finer level and
// one behind it.
fn first_hit(ray: ClippedRay) -> Hit {
    var hit: Hit;
    var steps = 0u;
    // The pieces go inwards to the finest level, then outwards again.
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

// The gradient in the finest level that contains a point, averaged over one voxel of that level. The point is moved out
// of the outermost half voxel, where the field is constant along an axis.
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
