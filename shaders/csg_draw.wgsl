// What the ray of each pixel hits first, and which lights reach it: one invocation a pixel, which walks the boxes of the
// parts front to back. Twin of src/csg/trace.rs; colours are made from this on the CPU (src/csg/gpu.rs).

#import csg_interpreter

struct CsgDrawParams {
    // Where the ray of the middle of the picture starts, and what one unit to the right and up on the plane at depth 1
    // adds to it; local units.
    start: vec3f,
    width: u32,
    start_right: vec3f,
    height: u32,
    start_up: vec3f,
    first_row: u32,
    // Its direction, one unit of depth long, and what one unit to the right and up adds.
    forward: vec3f,
    // Side of a pixel on the plane at depth 1.
    pixel: f32,
    right: vec3f,
    light_count: u32,
    up: vec3f,
    // 1 for hard shadows, 0 for none.
    shadows: u32,
    // One over the largest Lipschitz constant of a part.
    inverse_lipschitz: f32,
    // Nodes come first in `boxes`.
    node_count: u32,
    pad_0: u32,
    pad_1: u32,
}

// A node of the tree over boxes: its children are nodes `first` and `first + 1`, or, in a leaf, `count` boxes from `first`.
// A box: its part has `count` tokens from `first`.
struct CsgBox {
    lower: vec3f,
    first: u32,
    upper: vec3f,
    count: u32,
}

struct CsgPixel {
    normal: vec3f,
    // Along the ray from its start, local units.
    t: f32,
    // Index of the box that was hit.
    cell: u32,
    // 0 nothing, 1 a hit, 2 ran out of rounds.
    state: u32,
    steps: u32,
    // Evaluations of leaves, at least: tokens.
    tokens: u32,
}

@group(0) @binding(0) var<uniform> params: CsgDrawParams;
@group(0) @binding(4) var<storage, read> boxes: array<CsgBox>;
// The way each light travels, unit.
@group(0) @binding(5) var<storage, read> lights: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> pixels: array<CsgPixel>;
// Share of each light that arrives, `light_count` a pixel.
@group(0) @binding(7) var<storage, read_write> shares: array<f32>;

const MIN_STEP: f32 = 3e-5;
const MAX_STEPS: u32 = 4096u;
const MAX_ROOT_STEPS: u32 = 32u;
const ROOT_WIDTH: f32 = 1.2e-7;
const NORMAL_STEP: f32 = 5e-4;
const SHADOW_BIAS: f32 = 1e-3;
// Longer than any way through the model, and still far from overflow.
const FAR_T: f32 = 1e6;
const MAX_WAITING: u32 = 64u;
const MAX_LIGHTS: u32 = 64u;

struct Ray {
    origin: vec3f,
    direction: vec3f,
}

struct Hit {
    t: f32,
    cell: u32,
    is_hit: bool,
}

var<private> steps: u32 = 0u;
var<private> evaluated: u32 = 0u;

fn field(ray: Ray, t: f32, cell: u32) -> f32 {
    steps++;
    evaluated += boxes[cell].count;
    return csg_distance(ray.origin + t * ray.direction, boxes[cell].first, boxes[cell].count);
}

// Where a ray is in a box, as (in, out); in >= out where it misses. A ray along a face is in the box above it.
fn span(ray: Ray, cell: u32, t_max: f32) -> vec2f {
    let lower = boxes[cell].lower;
    let upper = boxes[cell].upper;
    var t = vec2f(0.0, t_max);
    for (var axis = 0u; axis < 3u; axis++) {
        let direction = ray.direction[axis];
        if direction == 0.0 {
            if ray.origin[axis] < lower[axis] || ray.origin[axis] >= upper[axis] { return vec2f(1.0, 0.0); }
            continue;
        }
        let inverse = 1.0 / direction;
        let a = (lower[axis] - ray.origin[axis]) * inverse;
        let b = (upper[axis] - ray.origin[axis]) * inverse;
        t = vec2f(max(t.x, min(a, b)), min(t.y, max(a, b)));
    }
    return t;
}

// The root between a value of zero or more and one below: regula falsi, Illinois variant.
fn root(ray: Ray, cell: u32, t0: f32, value0: f32, t1: f32, value1: f32) -> f32 {
    var low = t0;
    var above = value0;
    var high = t1;
    var below = value1;
    var last_side = 0;
    for (var i = 0u; i < MAX_ROOT_STEPS && has_rounds(); i++) {
        rounds++;
        if high - low <= ROOT_WIDTH * max(high, 1.0) || below == 0.0 { break; }
        let t = clamp(low + (high - low) * (above / (above - below)), low, high);
        // The root is an end of the bracket as far as float32 can tell.
        if t == low || t == high { return t; }
        let value = field(ray, t, cell);
        if value > 0.0 {
            low = t;
            above = value;
            if last_side == 1 { below *= 0.5; }
            last_side = 1;
        } else {
            high = t;
            below = value;
            if last_side == -1 { above *= 0.5; }
            last_side = -1;
        }
    }
    return high;
}

// The first root in a box on [t_in, t_out), or -1.
fn march(ray: Ray, cell: u32, t_in: f32, t_out: f32) -> f32 {
    var t = t_in;
    var value = field(ray, t, cell);
    if value < 0.0 { return t; }
    for (var i = 0u; i < MAX_STEPS && has_rounds(); i++) {
        rounds++;
        let safe = value * params.inverse_lipschitz;
        let next = t + max(safe, MIN_STEP);
        if next >= t_out {
            // A safe step crosses nothing; the smallest step might.
            if t + safe >= t_out { return -1.0; }
            let end = field(ray, t_out, cell);
            if end >= 0.0 { return -1.0; }
            let found = root(ray, cell, t, value, t_out, end);
            return select(-1.0, found, found < t_out);
        }
        let there = field(ray, next, cell);
        if there < 0.0 { return root(ray, cell, t, value, next, there); }
        t = next;
        value = there;
    }
    return -1.0;
}

fn trace(ray: Ray, any: bool) -> Hit {
    var best = Hit(FAR_T, 0u, false);
    var waiting: array<u32, MAX_WAITING>;
    var waiting_t: array<f32, MAX_WAITING>;
    var count = 0u;
    let root_span = span(ray, 0u, FAR_T);
    if params.node_count > 0u && root_span.x < root_span.y {
        waiting[0] = 0u;
        waiting_t[0] = root_span.x;
        count = 1u;
    }
    while count > 0u && has_rounds() {
        rounds++;
        count--;
        let node = waiting[count];
        if waiting_t[count] >= best.t { continue; }
        let first = boxes[node].first;
        if node < params.node_count && boxes[node].count > 0u {
            // The few boxes of a leaf wait like nodes, so that the nearest comes first.
            for (var i = 0u; i < boxes[node].count && count < MAX_WAITING; i++) {
                rounds++;
                let cell = params.node_count + first + i;
                let t = span(ray, cell, best.t);
                if t.x >= t.y { continue; }
                // Into its place: the nearest on top.
                var place = count;
                while place > 0u && waiting[place - 1u] >= params.node_count && waiting_t[place - 1u] < t.x {
                    rounds++;
                    waiting[place] = waiting[place - 1u];
                    waiting_t[place] = waiting_t[place - 1u];
                    place--;
                }
                waiting[place] = cell;
                waiting_t[place] = t.x;
                count++;
            }
        } else if node >= params.node_count {
            let t = span(ray, node, best.t);
            if t.x >= t.y { continue; }
            let found = march(ray, node, t.x, t.y);
            if found >= 0.0 && found < best.t {
                best = Hit(found, node - params.node_count, true);
                if any { return best; }
            }
        } else if count + 2u <= MAX_WAITING {
            let left = span(ray, first, best.t);
            let right = span(ray, first + 1u, best.t);
            let is_right_near = right.x < left.x;
            let near = select(first, first + 1u, is_right_near);
            let far = select(first + 1u, first, is_right_near);
            let near_span = select(left, right, is_right_near);
            let far_span = select(right, left, is_right_near);
            if far_span.x < far_span.y {
                waiting[count] = far;
                waiting_t[count] = far_span.x;
                count++;
            }
            if near_span.x < near_span.y {
                waiting[count] = near;
                waiting_t[count] = near_span.x;
                count++;
            }
        }
    }
    return best;
}

// Unit normal by differences on a tetrahedron; `fallback` where the field has no slope.
fn surface_normal(p: vec3f, cell: u32, fallback: vec3f) -> vec3f {
    let box = params.node_count + cell;
    var slope = vec3f(0.0);
    for (var i = 0u; i < 4u; i++) {
        let corner = vec3f(
            select(-1.0, 1.0, i == 0u || i == 3u),
            select(-1.0, 1.0, i == 2u || i == 3u),
            select(-1.0, 1.0, i == 1u || i == 3u),
        );
        slope += corner * csg_distance(p + NORMAL_STEP * corner, boxes[box].first, boxes[box].count);
    }
    let size = length(slope);
    if size == 0.0 { return fallback; }
    return slope / size;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let x = id.x;
    let y = id.y + params.first_row;
    if x >= params.width || y >= params.height { return; }
    let index = x + params.width * y;
    for (var i = 0u; i < min(params.light_count, MAX_LIGHTS); i++) { shares[index * params.light_count + i] = 1.0; }

    let along_right = (f32(x) + 0.5 - 0.5 * f32(params.width)) * params.pixel;
    let along_up = (0.5 * f32(params.height) - 0.5 - f32(y)) * params.pixel;
    let start = params.start + along_right * params.start_right + along_up * params.start_up;
    let direction = normalize(params.forward + along_right * params.right + along_up * params.up);
    let ray = Ray(start, direction);
    let hit = trace(ray, false);
    var pixel: CsgPixel;
    pixel.steps = steps;
    pixel.tokens = evaluated;
    if hit.is_hit {
        pixel.state = 1u;
        pixel.t = hit.t;
        pixel.cell = hit.cell;
        let p = start + hit.t * direction;
        pixel.normal = surface_normal(p, hit.cell, -direction);
        for (var i = 0u; i < min(params.light_count, MAX_LIGHTS); i++) {
            if params.shadows == 0u { continue; }
            let to_light = -lights[i].xyz;
            var share = 0.0;
            if dot(pixel.normal, to_light) > 0.0 {
                let shadow = trace(Ray(p + SHADOW_BIAS * pixel.normal, to_light), true);
                share = select(1.0, 0.0, shadow.is_hit);
            }
            shares[index * params.light_count + i] = share;
        }
    }
    if !has_rounds() { pixel.state = 2u; }
    pixels[index] = pixel;
}
