// Rays through a filtered 3D texture to the first point that is found not above zero: sphere tracing, then false position.
//
// The texture holds distances in units of the smallest side of a voxel. Hardware rounds its weights to 8 bits or so
// (WebGPU promises no number), half floats hold 11: together a value is within 0.005 of the trilinear one near the
// surface. A ray that is in the solid for less than MIN_STEP may miss it.

#import clip

@group(0) @binding(5) var field: texture_3d<f32>;
@group(0) @binding(6) var field_sampler: sampler;

// Steps of a ray at most: twice the voxels along the diagonal of the largest 3D texture that devices offer, and some.
const MAX_STEPS: u32 = 16384u;
// A shorter step than this does not leave the cell, voxels.
const MIN_STEP: f32 = 0.5;
// How far the field between samples may lie above the distance, in the smallest side of a voxel: half a cell.
const INTERPOLATION_SLACK: f32 = 0.5;
// Rounds of false position; the bracket is MIN_STEP long or little more.
const ROOT_ROUNDS: u32 = 8u;

// The field at a point of grid space, in the smallest side of a voxel; outside the box, at its nearest point.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    return textureSampleLevel(field, field_sampler, (p_grid + 0.5) / vec3f(shape), 0.0).x;
}

// The root between `start`, where the field is `above` zero, and `end`, where it is `below` or at zero: false position,
// halving the value at an end that stays twice (the Illinois method).
fn root_between(ray: ClippedRay, shape: vec3u, start: vec2f, end: vec2f) -> f32 {
    var above = start;
    var below = end;
    var t = end.x;
    // Rounds in a row that ended above zero, negative for those that did not.
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

// Walk along a ray to its first hit. `params.relative_spacing` is that of the picture.
fn march(ray: ClippedRay, shape: vec3u) -> Hit {
    var hit: Hit;
    // Length of one unit of t in the smallest side of a voxel.
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
