// Finds the first hit of the ray of each pixel, and the lights that reach it. One invocation computes one pixel and
// visits the boxes of the parts front to back. Twin of src/csg/parts/trace.rs. The CPU computes the colours from the
// result (src/csg/device/gpu.rs).

#import csg_walk
#import picture_rays

struct CsgDrawParams {
    // Rays of the picture, local units.
    rays: PictureRays,
    // 1 / largest Lipschitz constant of a part.
    inverse_lipschitz: f32,
    // Number of nodes. They precede the boxes of the parts in `boxes`.
    node_count: u32,
    pad_0: u32,
    pad_1: u32,
}

struct CsgPixel {
    normal: vec3f,
    // Distance along the ray from its start, local units.
    t: f32,
    // Index of the box that contains the hit.
    cell: u32,
    // 0: no hit. 1: hit. 2: the invocation ran out of rounds.
    state: u32,
    steps: u32,
    // Number of tokens evaluated, an upper bound on the number of leaves.
    tokens: u32,
}

@group(0) @binding(0) var<storage, read> params: CsgDrawParams;
@group(0) @binding(4) var<storage, read> boxes: array<CsgBox>;
// Direction in which each light travels, unit length.
@group(0) @binding(5) var<storage, read> lights: array<vec4f>;
@group(0) @binding(6) var<storage, read_write> pixels: array<CsgPixel>;
// Fraction of each light that arrives, `light_count` values per pixel.
@group(0) @binding(7) var<storage, read_write> shares: array<f32>;

// Step of the tetrahedral differences of a part's field along each axis, local units.
const NORMAL_STEP: f32 = 1e-4;

var<private> steps: u32 = 0u;
var<private> evaluated: u32 = 0u;

fn node_count() -> u32 {
    return params.node_count;
}

fn longest_step() -> f32 {
    return params.inverse_lipschitz;
}

fn count_evaluation(cell: u32) {
    steps++;
    evaluated += boxes[cell].count;
}

// Unit normal where a ray enters the part of a box. The reversed ray direction is returned where the gradient is zero.
fn surface_normal(p: vec3f, direction: vec3f, cell: u32) -> vec3f {
    let box = params.node_count + cell;
    var slope = vec3f(0.0);
    if is_closed(boxes[box].form) {
        slope = chord_slope(p, direction, boxes[box].first, boxes[box].count);
    } else if MARCHES {
        for (var i = 0u; i < 4u; i++) {
            slope += tetrahedron(i) * part_at(p + NORMAL_STEP * tetrahedron(i), box);
        }
    }
    let size = length(slope);
    if size == 0.0 { return -direction; }
    return slope / size;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    // Some specialised kernels read no parameters, but the bind group layout has the buffer in all kernels.
    _ = arrayLength(&numbers);
    let x = id.x;
    let y = id.y + params.rays.first_row;
    if x >= params.rays.width || y >= params.rays.height { return; }
    let index = x + params.rays.width * y;
    for (var i = 0u; i < min(params.rays.light_count, MAX_LIGHTS); i++) { shares[index * params.rays.light_count + i] = 1.0; }

    let from_eye = picture_ray(params.rays, x, y);
    let direction = normalize(from_eye.along);
    var ray = part_ray(from_eye.start, direction);
    var pixel: CsgPixel;
    var p = from_eye.start;
    // Traces the ray from the eye, then one ray to each light. There is one call, because drivers inline functions.
    for (var i = 0u; i <= min(params.rays.light_count, MAX_LIGHTS) && has_rounds(); i++) {
        rounds++;
        if i > 0u {
            let to_light = -lights[i - 1u].xyz;
            shares[index * params.rays.light_count + i - 1u] = 0.0;
            if dot(pixel.normal, to_light) <= 0.0 { continue; }
            ray = part_ray(p + SHADOW_BIAS * pixel.normal, to_light);
        }
        let hit = trace_parts(ray, WALK_FAR, i > 0u);
        if i > 0u {
            if !hit.is_hit { shares[index * params.rays.light_count + i - 1u] = 1.0; }
            continue;
        }
        pixel.steps = steps;
        pixel.tokens = evaluated;
        if !hit.is_hit { break; }
        pixel.state = PIXEL_HIT;
        pixel.t = hit.t;
        pixel.cell = hit.cell;
        p = from_eye.start + hit.t * direction;
        pixel.normal = surface_normal(p, direction, hit.cell);
        // A parallel ray that starts inside the solid hits it there. The surface faces the camera.
        if hit.t == 0.0 && all(params.rays.right == vec3f(0.0)) { pixel.normal = -direction; }
        if params.rays.shadows == 0u { break; }
    }
    if !has_rounds() { pixel.state = PIXEL_RAN_OUT; }
    pixels[index] = pixel;
}
