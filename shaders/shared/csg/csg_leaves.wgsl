// The field of one leaf. Twin of PlacedLeaf::distances in src/csg/evaluation/leaf.rs, which writes the module
// csg_kinds: the constants of the kinds, and `own_distance`, which selects the distance function of a leaf by its kind.

#import csg_field
#import csg_kinds
#import csg_tables

// Signed distance to polygons. Their tables begin at `first`:
//
//   0   lower corner of the grid (2), one over the side of a cell, number of cells along x and y, index of the edges
//   6   start of each list, and the end of the last one
//       lists of edges
//       edges: both ends (4) and the outward pseudonormals of both ends (4)
//
// Indices count from `first`.
fn polygon(at: vec2f, first: u32) -> f32 {
    let cell = (at - corner_at(first)) * numbers[first + 2u];
    let list = edge_list(cell, corner_at(first + 3u));
    let edges = first + u32(numbers[first + 5u]);
    let end = u32(numbers[first + 7u + list]);
    var nearest = vec3f(CSG_FAR, 0.0, 0.0);
    for (var c = u32(numbers[first + 6u + list]); c < end && has_rounds(); c++) {
        rounds++;
        let e = edges + 8u * u32(numbers[first + c]);
        let found = edge_beside(at, edge_values(e), edge_values(e + 4u));
        if found.x < nearest.x { nearest = found; }
    }
    return signed_edge_distance(nearest);
}

fn edge_values(first: u32) -> vec4f {
    return vec4f(corner_at(first), corner_at(first + 2u));
}

// A baked field, closed by the faces of its box; see src/csg/tree/volume_leaf.rs.
fn volume(at: vec3f, first: u32) -> f32 {
    let lower = vec3f(numbers[first], numbers[first + 1u], numbers[first + 2u]);
    let upper = vec3f(numbers[first + 3u], numbers[first + 4u], numbers[first + 5u]);
    let inverse_spacing = vec3f(numbers[first + 6u], numbers[first + 7u], numbers[first + 8u]);
    let shape = vec3f(numbers[first + 9u], numbers[first + 10u], numbers[first + 11u]);
    let scale = numbers[first + 12u];
    let is_divided = numbers[first + 13u] > 0.0;
    let samples = first + 14u;

    let inside = clamp(at, lower, upper);
    let away = at - inside;
    let outside = dot(away, away);
    let to_faces = max(lower - at, at - upper);
    let to_face = max(to_faces.x, max(to_faces.y, to_faces.z));
    let last = shape - 1.0;
    let grid = clamp((inside - lower) * inverse_spacing - 0.5, vec3f(0.0), last);
    let cell = min(floor(grid), max(last - 1.0, vec3f(0.0)));
    let n = vec3u(shape);
    let low = vec3u(cell);
    let count = n.x * n.y * n.z;
    let cells = max(n, vec3u(1u)) - 1u;
    var block = 0u;
    if is_divided { block = u32(numbers[samples + count + low.x + cells.x * (low.y + cells.y * low.z)]); }
    var stored = 0.0;
    if block > 0u {
        let part_at = (grid - cell) * f32(CELL_PARTS);
        let part = min(floor(part_at), vec3f(f32(CELL_PARTS - 1u)));
        let blocks = samples + count + cells.x * cells.y * cells.z;
        let side = CELL_PARTS + 1u;
        let start = blocks + (block - 1u) * side * side * side + dot(vec3u(part), vec3u(1u, side, side * side));
        stored = trilinear_number(start, vec3u(1u, side, side * side), part_at - part);
    } else {
        let strides = vec3u(1u, n.x, n.x * n.y);
        stored = trilinear_number(samples + dot(low, strides), strides * vec3u(n > vec3u(1u)), grid - cell);
    }
    stored *= scale;
    let s = max(stored, 0.0);
    return select(max(stored, to_face), sqrt(outside + s * s), outside > 0.0);
}

// The trilinear mean of eight numbers: the one at `first`, and those a step further along each axis.
fn trilinear_number(first: u32, steps: vec3u, f: vec3f) -> f32 {
    let second = first + steps.z;
    return mix_exact(bilinear_number(first, steps, f), bilinear_number(second, steps, f), f.z);
}

fn bilinear_number(first: u32, steps: vec3u, f: vec3f) -> f32 {
    let second = first + steps.y;
    let low = mix_exact(numbers[first], numbers[first + steps.x], f.x);
    let high = mix_exact(numbers[second], numbers[second + steps.x], f.x);
    return mix_exact(low, high, f.y);
}

fn mix_exact(a: f32, b: f32, fraction: f32) -> f32 {
    return a + (b - a) * fraction;
}

fn corner_at(first: u32) -> vec2f {
    return vec2f(numbers[first], numbers[first + 1u]);
}

// Position in the half plane of a solid of revolution: (distance from the z axis - offset, z).
fn revolved(at: vec3f, offset: f32) -> vec2f {
    return vec2f(length(at.xy) - offset, at.z);
}

fn leaf_distance(leaf: u32, p: vec3f) -> f32 {
    return own_distance(leaf, placed(leaf, p));
}
