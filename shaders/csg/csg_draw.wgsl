// Finds the first hit of the ray of each pixel, and the lights that reach it. One invocation computes one pixel and
// visits the boxes of the parts front to back. Twin of src/csg/parts/trace.rs. The CPU computes the colours from the
// result (src/csg/device/gpu.rs).

#import csg_chord
#import csg_needs
#import csg_part
#import csg_root
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

// A node of the tree over boxes, or the box of a part.
//             | inner node         | leaf                     | box of a part
//   `first`   | left child         | first box                | first token of the part
//   `count`   | 0                  | number of boxes          | number of tokens
// The right child of an inner node is `first + 1`.
struct CsgBox {
    lower: vec3f,
    first: u32,
    upper: vec3f,
    count: u32,
    // 0: sphere traced by the interpreter. FORM_UNION or FORM_CHORDS: closed form. From 3: function `form - 3` of a
    // specialised kernel.
    form: u32,
    // Index of the part's first parameter in `numbers`, for a compiled field.
    parameters: u32,
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
const MAX_WAITING: u32 = 64u;
const NO_BOX: u32 = 0xffffffffu;

struct Ray {
    origin: vec3f,
    direction: vec3f,
    inverse: vec3f,
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
    return field_at(ray.origin + t * ray.direction, cell);
}

fn field_at(p: vec3f, cell: u32) -> f32 {
    return part_distance(p, boxes[cell].form, boxes[cell].first, boxes[cell].count, boxes[cell].parameters);
}

fn is_closed(form: u32) -> bool {
    return HAS_CHORDS && (!MARCHES || form == FORM_UNION || form == FORM_CHORDS);
}

fn ray_along(origin: vec3f, direction: vec3f) -> Ray {
    return Ray(origin, direction, 1.0 / select(direction, vec3f(STILL), abs(direction) < vec3f(STILL)));
}

// The interval (t_in, t_out) of a ray inside a box; a miss returns t_in >= t_out. A ray within a face belongs to the
// box above the face.
fn span(ray: Ray, cell: u32, t_max: f32) -> vec2f {
    let a = (boxes[cell].lower - ray.origin) * ray.inverse;
    let b = (boxes[cell].upper - ray.origin) * ray.inverse;
    let low = min(a, b);
    let high = max(a, b);
    return vec2f(max(max(low.x, low.y), max(low.z, 0.0)), min(min(high.x, high.y), min(high.z, t_max)));
}

// The first t on [t_in, t_out) at which the ray is inside the part of a box, or -1.
fn first_root(ray: Ray, cell: u32, t_in: f32, t_out: f32) -> f32 {
    let form = boxes[cell].form;
    if !is_closed(form) { return march(ray, cell, t_in, t_out); }
    steps++;
    evaluated += boxes[cell].count;
    let is_union = form == FORM_UNION;
    return first_inside(ray.origin, ray.direction, boxes[cell].first, boxes[cell].count, is_union, t_in, t_out);
}

// The first root of a sphere-traced part on [t_in, t_out), or -1.
fn march(ray: Ray, cell: u32, t_in: f32, t_out: f32) -> f32 {
    var search = search_from(t_in);
    var state = SEARCHING;
    for (var i = 0u; i < MAX_MARCH_STEPS && state == SEARCHING && has_rounds(); i++) {
        rounds++;
        state = search_on(&search, field(ray, search.t, cell), params.inverse_lipschitz, t_out);
    }
    return select(-1.0, search.t, state == FOUND && (search.t < t_out || search.t == t_in));
}

fn trace(ray: Ray, any: bool) -> Hit {
    var best = Hit(FAR_T, 0u, false);
    // Nodes and boxes still to visit. The nearest of the latest children lies on top.
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
        // Descends to a box. The expensive intersection follows this loop, so that it is not evaluated per node.
        var cell = NO_BOX;
        while count > 0u && cell == NO_BOX && has_rounds() {
            rounds++;
            count--;
            let node = waiting[count];
            if waiting_t[count] >= best.t { continue; }
            if node >= params.node_count {
                cell = node;
                continue;
            }
            // The two children of an inner node, or the few boxes of a leaf.
            let few = boxes[node].count;
            let first = boxes[node].first + select(params.node_count, 0u, few == 0u);
            let bottom = count;
            for (var i = 0u; i < select(few, 2u, few == 0u) && count < MAX_WAITING; i++) {
                rounds++;
                let t = span(ray, first + i, best.t);
                if t.x >= t.y { continue; }
                // Inserts the entry in order of distance.
                var place = count;
                while place > bottom && waiting_t[place - 1u] < t.x {
                    rounds++;
                    waiting[place] = waiting[place - 1u];
                    waiting_t[place] = waiting_t[place - 1u];
                    place--;
                }
                waiting[place] = first + i;
                waiting_t[place] = t.x;
                count++;
            }
        }
        if cell == NO_BOX { break; }
        let t = span(ray, cell, best.t);
        let found = first_root(ray, cell, t.x, t.y);
        if found >= 0.0 && found < best.t {
            best = Hit(found, cell - params.node_count, true);
            if any { return best; }
        }
    }
    return best;
}

// Unit normal where a ray enters the part of a box. The reversed ray direction is returned where the gradient is zero.
fn surface_normal(p: vec3f, direction: vec3f, cell: u32) -> vec3f {
    let box = params.node_count + cell;
    var slope = vec3f(0.0);
    if is_closed(boxes[box].form) {
        slope = chord_slope(p, direction, boxes[box].first, boxes[box].count);
    } else if MARCHES {
        for (var i = 0u; i < 4u; i++) {
            slope += tetrahedron(i) * field_at(p + NORMAL_STEP * tetrahedron(i), box);
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
    var ray = ray_along(from_eye.start, direction);
    var pixel: CsgPixel;
    var p = from_eye.start;
    // Traces the ray from the eye, then one ray to each light. There is one call, because drivers inline functions.
    for (var i = 0u; i <= min(params.rays.light_count, MAX_LIGHTS) && has_rounds(); i++) {
        rounds++;
        if i > 0u {
            let to_light = -lights[i - 1u].xyz;
            shares[index * params.rays.light_count + i - 1u] = 0.0;
            if dot(pixel.normal, to_light) <= 0.0 { continue; }
            ray = ray_along(p + SHADOW_BIAS * pixel.normal, to_light);
        }
        let hit = trace(ray, i > 0u);
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
