// The stack machine over the tokens of a shape: one program for every shape. Twin of Program::run in src/csg/program.rs.
//
// All that one invocation does is counted in `rounds`: software adapters stop an invocation after 65,535 rounds of all its
// loops, without an error. One that runs out says so, and is redone on the CPU.

#import csg_field

// A leaf, or a warp, in local units.
struct CsgLeaf {
    // Rows of leaf_from_local, each with its shift.
    row_x: vec3f,
    shift_x: f32,
    row_y: vec3f,
    shift_y: f32,
    row_z: vec3f,
    shift_z: f32,
    a: vec4f,
    b: vec2f,
    kind: u32,
    // The first of its numbers in `numbers`: corners or samples.
    first: u32,
}

@group(0) @binding(1) var<storage, read> tokens: array<u32>;
@group(0) @binding(2) var<storage, read> leaves: array<CsgLeaf>;
// Joints, levels, corners of polygons, samples of volumes.
@group(0) @binding(3) var<storage, read> numbers: array<f32>;

const MAX_ROUNDS: u32 = 64000u;
// Deeper than any shape needs: operands that need more go first.
const MAX_STACK: u32 = 32u;
const MAX_WARPS: u32 = 4u;

// A token: what to do in the upper four bits, with which entry of a table in the others.
const TOKEN_INDEX: u32 = 0x0fffffffu;
const TOKEN_LEAF: u32 = 0u;
const TOKEN_UNION: u32 = 1u;
const TOKEN_INTERSECTION: u32 = 2u;
const TOKEN_DIFFERENCE: u32 = 3u;
const TOKEN_XOR: u32 = 4u;
const TOKEN_OFFSET: u32 = 5u;
const TOKEN_SHELL: u32 = 6u;
const TOKEN_COMPLEMENT: u32 = 7u;
const TOKEN_ENTER: u32 = 8u;
const TOKEN_LEAVE: u32 = 9u;

var<private> rounds: u32 = 0u;

fn has_rounds() -> bool {
    return rounds < MAX_ROUNDS;
}

fn placed(leaf: u32, p: vec3f) -> vec3f {
    return vec3f(
        dot(leaves[leaf].row_x, p) + leaves[leaf].shift_x,
        dot(leaves[leaf].row_y, p) + leaves[leaf].shift_y,
        dot(leaves[leaf].row_z, p) + leaves[leaf].shift_z,
    );
}

// The nearest edge, and the parity of the edges to the right.
fn polygon(at: vec2f, first: u32, count: u32) -> f32 {
    var nearest = CSG_FAR;
    var is_inside = false;
    let last = first + 2u * (count - 1u);
    var before = vec2f(numbers[last], numbers[last + 1u]);
    for (var i = 0u; i < count && has_rounds(); i++) {
        rounds++;
        let corner = vec2f(numbers[first + 2u * i], numbers[first + 2u * i + 1u]);
        let edge = before - corner;
        let to = at - corner;
        let away = to - clamp(dot(to, edge) / dot(edge, edge), 0.0, 1.0) * edge;
        nearest = min(nearest, dot(away, away));
        // The edge spans the height of the point, and crosses it on the right.
        if (corner.y > at.y) != (before.y > at.y) {
            if (to.x * edge.y < to.y * edge.x) == (edge.y > 0.0) { is_inside = !is_inside; }
        }
        before = corner;
    }
    return select(sqrt(nearest), -sqrt(nearest), is_inside);
}

// A baked field, closed by its box; see src/csg/volume_leaf.rs.
fn volume(at: vec3f, first: u32) -> f32 {
    let lower = vec3f(numbers[first], numbers[first + 1u], numbers[first + 2u]);
    let upper = vec3f(numbers[first + 3u], numbers[first + 4u], numbers[first + 5u]);
    let inverse_spacing = vec3f(numbers[first + 6u], numbers[first + 7u], numbers[first + 8u]);
    let shape = vec3f(numbers[first + 9u], numbers[first + 10u], numbers[first + 11u]);
    let scale = numbers[first + 12u];
    let samples = first + 13u;

    let inside = clamp(at, lower, upper);
    let away = at - inside;
    let outside = dot(away, away);
    let to_faces = max(lower - at, at - upper);
    let to_face = max(to_faces.x, max(to_faces.y, to_faces.z));
    let last = shape - 1.0;
    let grid = clamp((inside - lower) * inverse_spacing - 0.5, vec3f(0.0), last);
    let cell = min(floor(grid), max(last - 1.0, vec3f(0.0)));
    let f = grid - cell;
    let low = vec3u(cell);
    let high = vec3u(min(cell + 1.0, last));
    let nx = u32(shape.x);
    let nxy = nx * u32(shape.y);
    let y0 = low.y * nx;
    let y1 = high.y * nx;
    let z0 = samples + low.z * nxy;
    let z1 = samples + high.z * nxy;
    let x00 = mix_exact(numbers[low.x + y0 + z0], numbers[high.x + y0 + z0], f.x);
    let x10 = mix_exact(numbers[low.x + y1 + z0], numbers[high.x + y1 + z0], f.x);
    let x01 = mix_exact(numbers[low.x + y0 + z1], numbers[high.x + y0 + z1], f.x);
    let x11 = mix_exact(numbers[low.x + y1 + z1], numbers[high.x + y1 + z1], f.x);
    let stored = mix_exact(mix_exact(x00, x10, f.y), mix_exact(x01, x11, f.y), f.z) * scale;
    let s = max(stored, 0.0);
    return select(max(stored, to_face), sqrt(outside + s * s), outside > 0.0);
}

fn mix_exact(a: f32, b: f32, fraction: f32) -> f32 {
    return a + (b - a) * fraction;
}

// A profile: 0 a circle, 1 a rectangle, 2 a polygon.
fn profile(at: vec2f, which: u32, leaf: u32) -> f32 {
    let first = leaves[leaf].first;
    switch which {
        case 0u: { return circle(at, numbers[first]); }
        case 1u: { return rectangle(at, vec2f(numbers[first], numbers[first + 1u])); }
        default: { return polygon(at, first + 1u, u32(numbers[first])); }
    }
}

fn leaf_distance(leaf: u32, p: vec3f) -> f32 {
    let at = placed(leaf, p);
    let a = leaves[leaf].a;
    let b = leaves[leaf].b;
    let k = array<f32, 6>(a.x, a.y, a.z, a.w, b.x, b.y);
    let kind = leaves[leaf].kind;
    switch kind {
        case 0u: { return sphere(at, k); }
        case 1u: {
            rounds += ELLIPSOID_STEPS;
            return ellipsoid(at, k);
        }
        case 2u: { return rounded_box(at, k); }
        case 3u: { return box_frame(at, k); }
        case 4u: { return torus(at, k); }
        case 5u: { return capped_torus(at, k); }
        case 6u: { return cylinder(at, k); }
        case 7u: { return capsule(at, k); }
        case 8u: { return cone(at, k); }
        case 9u: { return plane(at, k); }
        case 10u: { return pyramid(at, k); }
        case 11u: { return octahedron(at, k); }
        case 12u: { return hex_prism(at, k); }
        case 13u: { return gyroid(at, k); }
        case 14u, 15u, 16u: { return prism(profile(at.xy, kind - 14u, leaf), at.z, k[0]); }
        case 17u, 18u, 19u: { return profile(vec2f(length(at.xy) - k[0], at.z), kind - 17u, leaf); }
        default: { return volume(at, leaves[leaf].first); }
    }
}

// The space of a warp: 0 elongated, 1 twisted, 2 bent.
fn warped(warp: u32, p: vec3f) -> vec3f {
    let q = placed(warp, p);
    let a = leaves[warp].a;
    switch leaves[warp].kind {
        case 0u: { return q - clamp(q, -a.xyz, a.xyz); }
        case 1u: { return turned_about_z(q, -a.x * q.z); }
        default: { return turned_about_z(q, -a.x * q.x); }
    }
}

// What distances in a warp are divided by.
fn stretch(warp: u32, p: vec3f) -> f32 {
    let q = placed(warp, p);
    return 1.0 + leaves[warp].b.x * max(length(q.xy), leaves[warp].b.y);
}

fn joined(joint: u32, a: f32, b: f32) -> f32 {
    let kind = numbers[joint];
    let width = numbers[joint + 1u];
    if kind == 0.0 { return sharp_union(a, b, width); }
    if kind == 1.0 { return smooth_union(a, b, width); }
    return chamfer_union(a, b, width);
}

fn combined(op: u32, joint: u32, below: f32, top: f32) -> f32 {
    let is_swapped = numbers[joint + 2u] == 1.0;
    let a = select(below, top, is_swapped);
    let b = select(top, below, is_swapped);
    switch op {
        case TOKEN_UNION: { return joined(joint, a, b); }
        case TOKEN_INTERSECTION: { return -joined(joint, -a, -b); }
        case TOKEN_DIFFERENCE: { return -joined(joint, -a, b); }
        default: {
            let either = joined(joint, a, b);
            let both = -joined(joint, -a, -b);
            return -joined(joint, -either, both);
        }
    }
}

// The field of a list of tokens, local units.
fn csg_distance(p: vec3f, first: u32, count: u32) -> f32 {
    var values: array<f32, MAX_STACK>;
    var positions: array<vec3f, MAX_WARPS>;
    var at = p;
    var top = 0u;
    var warps = 0u;
    for (var i = 0u; i < count && has_rounds(); i++) {
        rounds++;
        let token = tokens[first + i];
        let index = token & TOKEN_INDEX;
        let what = token >> 28u;
        switch what {
            case TOKEN_LEAF: {
                values[top] = leaf_distance(index, at);
                top++;
            }
            case TOKEN_OFFSET: { values[top - 1u] -= numbers[index]; }
            case TOKEN_SHELL: { values[top - 1u] = abs(values[top - 1u]) - numbers[index]; }
            case TOKEN_COMPLEMENT: { values[top - 1u] = -values[top - 1u]; }
            case TOKEN_ENTER: {
                positions[warps] = at;
                warps++;
                at = warped(index, at);
            }
            case TOKEN_LEAVE: {
                warps--;
                at = positions[warps];
                values[top - 1u] /= stretch(index, at);
            }
            default: {
                top--;
                values[top - 1u] = combined(what, index, values[top - 1u], values[top]);
            }
        }
    }
    return values[0];
}
