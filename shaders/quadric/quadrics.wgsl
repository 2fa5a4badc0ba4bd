// Draws quadrics that are stored in a texture. One invocation computes one pixel: its ray and its shadow rays. Twin of
// src/quadric/draw.rs.

#import light
#import picture_rays
#import quadric

struct QuadricParams {
    // Rays of the picture, relative to the centre of all quadrics.
    rays: PictureRays,
    background: vec4f,
    ambient: f32,
    specular: f32,
    shininess: f32,
    // Number of records in the texture. The boxes of the tree follow the records. With `node_count` 0 every record is
    // tried.
    quadric_count: u32,
    node_count: u32,
    // Number of texels in a row of the texture; a multiple of six, so that no record or box spans two rows.
    texels_per_row: u32,
    pad_0: u32,
    pad_1: u32,
}

struct QuadricPixel {
    color: vec4f,
    normal: vec3f,
    // Depth beyond the start of the ray.
    depth: f32,
    quadric: u32,
    steps: u32,
    // NOTHING_HIT, HIT or UNFINISHED.
    state: u32,
    pad_0: u32,
}

@group(0) @binding(0) var<storage, read> params: QuadricParams;
@group(0) @binding(1) var records: texture_2d<f32>;
@group(0) @binding(2) var<storage, read> lights: array<Light>;
@group(0) @binding(3) var<storage, read_write> pixels: array<QuadricPixel>;
// Fraction of each light that arrives, `light_count` values per pixel.
@group(0) @binding(4) var<storage, read_write> shares: array<f32>;

const NO_QUADRIC: u32 = 0xffffffffu;

// Largest number of boxes and quadrics that one pixel may try with all its rays. Software adapters stop an invocation
// at 65,535 loop iterations. The CPU draws the pixels that need more.
const MAX_TRIED: u32 = 60000u;
// A gradient shorter than this has no usable direction.
const SINGULAR: f32 = 1e-3;

// A quadric: its form in the frame of its trim sphere, the trim sphere, and the material.
struct Quadric {
    form: QuadricForm,
    center: vec3f,
    radius: f32,
    reflectance: vec3f,
    opacity: f32,
}

struct QuadricHit {
    t: f32,
    place: u32,
}

var<private> tried: u32;

fn texel(index: u32) -> vec4f {
    return textureLoad(records, vec2u(index % params.texels_per_row, index / params.texels_per_row), 0);
}

// Reads a record. Texel i is (first + i):
//   0-2  columns of the 3x3 matrix (w unused)
//   3    linear term (xyz) and constant (w)
//   4    centre (xyz) and radius (w) of the trim sphere
//   5    reflectance (xyz) and opacity (w)
fn load_quadric(place: u32) -> Quadric {
    let first = RECORD_TEXELS * place;
    let a0 = texel(first);
    let a1 = texel(first + 1u);
    let a2 = texel(first + 2u);
    let a3 = texel(first + 3u);
    let trim = texel(first + 4u);
    let surface = texel(first + 5u);
    let form = QuadricForm(mat3x3f(a0.xyz, a1.xyz, a2.xyz), a3.xyz, a3.w);
    return Quadric(form, trim.xyz, trim.w, surface.xyz, surface.w);
}

// The first t > 0 at which a ray crosses a quadric inside its trim sphere, or NO_CROSSING. `forget_start` skips the
// crossing nearest to the origin of the ray. The direction must have unit length.
fn first_crossing(q: Quadric, origin: vec3f, direction: vec3f, forget_start: bool) -> f32 {
    var t = quadric_crossings(q.form, (origin - q.center) / q.radius, direction);
    if forget_start {
        if abs(t.y) < abs(t.x) { t.y = NO_CROSSING; } else { t.x = NO_CROSSING; }
    }
    // Converts to world units. NO_CROSSING stays as it is.
    let in_world = select(t, t * q.radius, t < vec2f(NO_CROSSING));
    let ahead = select(vec2f(NO_CROSSING), in_world, in_world > vec2f(0.0));
    return min(ahead.x, ahead.y);
}

// Unit normal of a quadric at a world point on its surface, on the side of the ray's origin; see src/quadric/local.rs.
fn quadric_normal(q: Quadric, p: vec3f, direction: vec3f) -> vec3f {
    var gradient = q.form.m * ((p - q.center) / q.radius) + q.form.v;
    if length(gradient) <= SINGULAR { gradient = q.form.m * direction; }
    let size = length(gradient);
    if size == 0.0 { return -direction; }
    let normal = gradient / size;
    return select(normal, -normal, dot(normal, direction) > 0.0);
}

// The t at which a ray enters box `index` of the tree, or NO_CROSSING if that is beyond `t_max`. The CPU enlarges the
// boxes to cover the rounding here.
fn enter_box(index: u32, origin: vec3f, inverse: vec3f, t_max: f32) -> f32 {
    let first = RECORD_TEXELS * params.quadric_count + NODE_TEXELS * index;
    let a = (texel(first).xyz - origin) * inverse;
    let b = (texel(first + 1u).xyz - origin) * inverse;
    let low = min(a, b);
    let high = max(a, b);
    let t_enter = max(max(low.x, low.y), max(low.z, 0.0));
    let t_leave = min(min(high.x, high.y), min(high.z, t_max));
    return select(NO_CROSSING, t_enter, t_enter <= t_leave);
}

// 1 / each component. A component near zero is replaced by 1e-20 first.
fn inverse_of(direction: vec3f) -> vec3f {
    let tiny = vec3f(1e-20);
    return 1.0 / select(direction, tiny, abs(direction) < tiny);
}

// Result of a walk. A shadow ray multiplies `share` by 1 - opacity at every quadric it crosses; other rays keep the
// nearest hit.
struct Walk {
    hit: QuadricHit,
    share: f32,
}

fn try_quadric(walk: ptr<function, Walk>, place: u32, origin: vec3f, direction: vec3f, from_place: u32, shadow: bool) {
    let q = load_quadric(place);
    let t = first_crossing(q, origin, direction, place == from_place);
    if t >= NO_CROSSING { return; }
    if shadow {
        (*walk).share *= 1.0 - q.opacity;
    } else if t < (*walk).hit.t {
        (*walk).hit = QuadricHit(t, place);
    }
}

// Visits the tree over the records, or all records if there is no tree.
fn walk_along(origin: vec3f, direction: vec3f, from_place: u32, shadow: bool) -> Walk {
    var walk = Walk(QuadricHit(NO_CROSSING, NO_QUADRIC), 1.0);
    if params.node_count == 0u {
        for (var place = 0u; place < min(params.quadric_count, MAX_TRIED); place++) {
            tried++;
            try_quadric(&walk, place, origin, direction, from_place, shadow);
        }
        return walk;
    }

    let inverse = inverse_of(direction);
    var stack: array<u32, MAX_STACK>;
    var waiting = 0u;
    if enter_box(0u, origin, inverse, NO_CROSSING) < NO_CROSSING { waiting = 1u; }
    while waiting > 0u && tried < MAX_TRIED && walk.share > 0.0 {
        waiting--;
        let index = stack[waiting];
        let node = RECORD_TEXELS * params.quadric_count + NODE_TEXELS * index;
        let first = u32(texel(node).w);
        let count = u32(texel(node + 1u).w);
        tried++;
        for (var place = first; place < first + count && tried < MAX_TRIED; place++) {
            tried++;
            try_quadric(&walk, place, origin, direction, from_place, shadow);
        }
        if count > 0u { continue; }
        // Pushes the far child first, so that the near child is popped first.
        let left = enter_box(first, origin, inverse, walk.hit.t);
        let right = enter_box(first + 1u, origin, inverse, walk.hit.t);
        let near = select(first + 1u, first, left <= right);
        if max(left, right) < NO_CROSSING && waiting < MAX_STACK {
            stack[waiting] = 2u * first + 1u - near;
            waiting++;
        }
        if min(left, right) < NO_CROSSING && waiting < MAX_STACK {
            stack[waiting] = near;
            waiting++;
        }
    }
    return walk;
}

@compute @workgroup_size(8, 8)
fn main(@builtin(global_invocation_id) id: vec3u) {
    let x = id.x;
    let y = id.y + params.rays.first_row;
    if x >= params.rays.width || y >= params.rays.height { return; }
    let index = x + params.rays.width * y;
    var pixel: QuadricPixel;
    pixel.color = params.background;
    for (var i = 0u; i < min(params.rays.light_count, MAX_LIGHTS); i++) { shares[index * params.rays.light_count + i] = 1.0; }

    let ray = picture_ray(params.rays, x, y);
    let per_depth = length(ray.along);
    let direction = ray.along / per_depth;

    let hit = walk_along(ray.start, direction, NO_QUADRIC, false).hit;
    pixel.steps = tried;
    if hit.place != NO_QUADRIC {
        let q = load_quadric(hit.place);
        let p = ray.start + hit.t * direction;
        let normal = quadric_normal(q, p, direction);
        var color = params.ambient * q.reflectance;
        for (var i = 0u; i < min(params.rays.light_count, MAX_LIGHTS); i++) {
            let to_light = -lights[i].direction;
            var share = 1.0;
            if params.rays.shadows == 1u {
                share = 0.0;
                if dot(normal, to_light) > 0.0 { share = walk_along(p, to_light, hit.place, true).share; }
            }
            shares[index * params.rays.light_count + i] = share;
            color += share * light_adds(lights[i], q.reflectance, normal, -direction, params.specular, params.shininess);
        }
        pixel.color = vec4f(color, 1.0);
        pixel.normal = normal;
        pixel.depth = hit.t / per_depth;
        pixel.quadric = hit.place;
        pixel.state = HIT;
    }
    if tried >= MAX_TRIED { pixel.state = UNFINISHED; }
    pixels[index] = pixel;
}
