// Traces rays through a filtered 3D texture to the first point where the field is <= 0: sphere tracing, then false
// position.
//
// The texture holds distances in units of the smallest side of a voxel. Hardware rounds the weights of its filter to
// about 8 bits (WebGPU guarantees no precision), and half floats have 11 bits. Together a value near the surface is
// within 0.005 of the trilinear one. A ray that is inside the solid for less than MIN_STEP may miss it.

#import clip

@group(0) @binding(5) var field: texture_3d<f32>;
@group(0) @binding(6) var field_sampler: sampler;

// Smallest step, voxels. A shorter step would stay in the cell.
const MIN_STEP: f32 = 0.5;
// Largest difference by which the interpolated field may exceed the distance, in units of the smallest side of a voxel:
// half a cell.
const INTERPOLATION_SLACK: f32 = 0.5;
// Number of rounds of false position. The bracket is about MIN_STEP long.
const ROOT_ROUNDS: u32 = 8u;

// The field at a point of grid space, in units of the smallest side of a voxel. Outside the box: the value at its
// nearest point.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    return textureSampleLevel(field, field_sampler, (p_grid + 0.5) / vec3f(shape), 0.0).x;
}

// The root between `start` and `end`, each (t, value). The value is > 0 at `start` and <= 0 at `end`. False position;
// the value at an end that stays twice is halved (the Illinois method).
fn root_between(ray: ClippedRay, shape: vec3u, start: vec2f, end: vec2f) -> f32 {
    var above = start;
    var below = end;
    var t = end.x;
    // Number of consecutive rounds with a value above zero; negative for rounds with a value <= 0.
    var side = 0;
    for (var round = 0u; round < ROOT_ROUNDS; round++) {
        t = above.x + (below.x - above.x) * (above.y / max(above.y - below.y, TINY));
        let value = field_at(ray.origin + t * ray.direction, shape);
        if value > 0.0 {
            above = vec2f(t, value);
            side = max(side, 0) + 1;
            if side > 1 { below.y *= 0.5; }
        } else {
            below = vec2f(t, value);
            side = min(side, 0) - 1;
            if side < -1 { above.y *= 0.5; }
        }
    }
    return t;
}

// Traces a ray to its first hit.
fn march(ray: ClippedRay, shape: vec3u) -> Hit {
    var hit: Hit;
    // Length of one unit of t, in units of the smallest side of a voxel.
    let per_t = length(ray.direction * params.relative_spacing);
    var before = vec2f(0.0, field_at(ray.origin, shape));
    if before.y <= 0.0 {
        hit.is_hit = true;
        hit.at_start = true;
        return hit;
    }
    for (var step = 1u; step <= MAX_STEPS; step++) {
        hit.steps = step;
        if before.x >= ray.t_max { return hit; }
        let t = min(before.x + max((before.y - INTERPOLATION_SLACK) / per_t, MIN_STEP), ray.t_max);
        let value = field_at(ray.origin + t * ray.direction, shape);
        if value <= 0.0 {
            hit.is_hit = true;
            hit.t = root_between(ray, shape, before, vec2f(t, value));
            return hit;
        }
        before = vec2f(t, value);
    }
    return hit;
}
