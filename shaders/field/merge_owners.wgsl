// Finds, for each sample of a merged field, the placed field with the smallest lower bound on the distance. Float32 is
// too coarse for the bound itself, but interval arithmetic still identifies the field that attains the minimum. Twin of
// src/merge/placed.rs, with the rounding carried along. src/merge/gpu.rs evaluates the bound in float64.

// A node of the tree over the boxes of the fields.
struct MergeNode {
    min: vec3f,
    // Leaf: first entry in `order`. Inner node: left child; the right child follows it.
    first: u32,
    max: vec3f,
    // Number of fields in a leaf; 0 for an inner node.
    count: u32,
}

// A field with its transform. Scene space spans about 1. Lengths of a field are in a unit of its own, about its size.
struct MergeField {
    // Rows of the map from scene space to grid space, relative to `center`: grid = row.xyz . (p - center) + row.w.
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    center: vec3f,
    grid: u32,
    // Box around the field, scene space.
    lower: vec3f,
    sigma_min: f32,
    upper: vec3f,
    sigma_max: f32,
    // Box of the surface, grid space.
    inner_lower: vec3f,
    // Largest error of a grid coordinate, voxels.
    error: f32,
    inner_upper: vec3f,
    // 1 if the bound can be evaluated here; 0 if the CPU must evaluate it wherever it may attain the minimum.
    is_known: u32,
}

struct MergeGrid {
    shape: vec3u,
    first_sample: u32,
    // Voxel size in the unit of the field.
    spacing: vec3f,
    // 1 / unit of the field.
    inverse_unit: f32,
}

struct MergeParams {
    shape: vec3u,
    // First sample of this dispatch within the slab, and number of samples.
    first: u32,
    first_plane: u32,
    count: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<uniform> params: MergeParams;
@group(0) @binding(1) var<storage, read> nodes: array<MergeNode>;
// Indices of fields, leaf by leaf.
@group(0) @binding(2) var<storage, read> order: array<u32>;
@group(0) @binding(3) var<storage, read> fields: array<MergeField>;
@group(0) @binding(4) var<storage, read> grids: array<MergeGrid>;
@group(0) @binding(5) var<storage, read> samples: array<f32>;
// Scene positions of the samples along x, then y, then z.
@group(0) @binding(6) var<storage, read> axes: array<f32>;
@group(0) @binding(7) var<storage, read_write> owners: array<u32>;

const FAR_T: f32 = 1e30;
// Largest number of loop iterations of an invocation. Software drivers stop it at 65,535 without an error.
const MAX_WORK: u32 = 60000u;
// Number of loop iterations to evaluate the bound of one field.
const FIELD_WORK: u32 = 26u;
// Relative rounding error of a length computed by about twelve operations, including a square root.
const ROUNDING: f32 = 2e-6;
// Rounding error of a difference of scene coordinates.
const SCENE_ROUNDING: f32 = 1e-6;

struct Range {
    low: f32,
    high: f32,
}

fn length_range(length: f32, error: f32) -> Range {
    let room = error + ROUNDING * length;
    return Range(max(length - room, 0.0), length + room);
}

// The eight samples around a point of the grid, in the unit of the field.
fn corners_at(grid: MergeGrid, cell: vec3f) -> array<f32, 8> {
    let last = vec3i(grid.shape) - 1;
    let a = vec3u(clamp(vec3i(cell), vec3i(0), last));
    let b = vec3u(clamp(vec3i(cell) + 1, vec3i(0), last));
    var corners: array<f32, 8>;
    for (var i = 0u; i < 8u; i++) {
        let at = select(a, b, vec3<bool>((i & 1u) != 0u, (i & 2u) != 0u, (i & 4u) != 0u));
        let index = grid.first_sample + at.x + grid.shape.x * (at.y + grid.shape.y * at.z);
        corners[i] = samples[index] * grid.inverse_unit;
    }
    return corners;
}

// Range of the squared bound of src/volume/outside.rs at a point of the grid inside the hull of the samples.
fn square_range(grid: MergeGrid, place: vec3f, error: f32) -> Range {
    let cell = floor(place);
    let f = place - cell;
    let corners = corners_at(grid, cell);
    var sum = 0.0;
    var least = FAR_T;
    var most = -FAR_T;
    for (var i = 0u; i < 8u; i++) {
        let is_upper = vec3<bool>((i & 1u) != 0u, (i & 2u) != 0u, (i & 4u) != 0u);
        let w = select(1.0 - f, f, is_upper);
        sum += w.x * w.y * w.z * corners[i] * corners[i];
        least = min(least, corners[i]);
        most = max(most, corners[i]);
    }
    let h = grid.spacing;
    let variance = dot(h * h, f * (1.0 - f));
    let largest = max(abs(least), abs(most));
    // Two sources of error: the position, whose effect is limited by the slope per voxel, and rounding.
    let slope = 2.0 * largest * (most - least) + max(h.x, max(h.y, h.z)) * max(h.x, max(h.y, h.z));
    let room = 3.0 * error * slope + ROUNDING * (largest * largest + dot(h, h));
    let square = sum - variance;
    return Range(max(square - room, 0.0), max(square + room, 0.0));
}

fn add_squares(a: Range, b: Range) -> Range {
    return Range((a.low * a.low + b.low) * (1.0 - ROUNDING), (a.high * a.high + b.high) * (1.0 + ROUNDING));
}

// Range of the lower bound of one field at a point, scene units.
fn bound_range(index: u32, p: vec3f) -> Range {
    let field = &fields[index];
    let outside = max(max((*field).lower - p, p - (*field).upper), vec3f(0.0));
    let to_bounds = length_range(length(outside), SCENE_ROUNDING);
    let is_out = to_bounds.low > 0.0;
    let unknown = Range(select(-FAR_T, to_bounds.low, is_out), FAR_T);
    if (*field).is_known == 0u { return unknown; }

    let grid = grids[(*field).grid];
    let d = p - (*field).center;
    let q = vec3f(dot((*field).row_x.xyz, d), dot((*field).row_y.xyz, d), dot((*field).row_z.xyz, d))
        + vec3f((*field).row_x.w, (*field).row_y.w, (*field).row_z.w);
    let error = (*field).error;
    let last = vec3f(grid.shape) - 1.0;
    let h = grid.spacing;
    let off = error * length(h);

    // On a face of a cell or of the hull, rounding may select the neighbouring cell.
    let is_on_face = (abs(q - round(q)) <= vec3f(error)) & (q > vec3f(-error)) & (q < last + error);
    if any(is_on_face) { return unknown; }
    let in_hull = clamp(q, vec3f(0.0), last);
    let is_in_hull = all(in_hull == q);

    // Bounds from the eight surrounding samples.
    let cell = floor(in_hull);
    let corners = corners_at(grid, cell);
    let to_low = (q - cell) * h;
    let to_high = (q - min(cell + 1.0, last)) * h;
    var by_distance = -FAR_T;
    var all_positive = true;
    var size = 0.0;
    for (var i = 0u; i < 8u; i++) {
        let way = select(to_low, to_high, vec3<bool>((i & 1u) != 0u, (i & 2u) != 0u, (i & 4u) != 0u));
        let reach = length(way);
        by_distance = max(by_distance, corners[i] - reach);
        all_positive = all_positive && corners[i] > 0.0;
        size = max(size, abs(corners[i]) + reach);
    }
    var bound = Range(by_distance - off - ROUNDING * size, by_distance + off + ROUNDING * size);
    let in_inner = clamp(q, (*field).inner_lower, (*field).inner_upper);
    let to_inner = length_range(length((q - in_inner) * h), off);
    if !is_in_hull || all_positive {
        let by_hull = add_squares(length_range(length((q - in_hull) * h), off), square_range(grid, in_hull, error));
        let by_inner = add_squares(to_inner, square_range(grid, in_inner, error));
        let squared = max(by_hull.low, by_inner.low);
        // In a cell whose corners are positive, 0 states nothing: the point may be inside a thin part.
        if !is_in_hull || squared > 0.0 { bound.low = max(bound.low, sqrt(squared) * (1.0 - ROUNDING)); }
        bound.high = max(bound.high, sqrt(max(by_hull.high, by_inner.high)) * (1.0 + ROUNDING));
    }
    // The distance to the box of the surface is a bound only outside that box. Where rounding leaves the side open, the
    // range covers both cases.
    bound.low = select(bound.low, max(bound.low, to_inner.low), to_inner.low > 0.0);
    if any(q < (*field).inner_lower + error) || any(q > (*field).inner_upper - error) {
        bound.high = max(bound.high, to_inner.high);
    }

    let sigma = vec2f((*field).sigma_min, (*field).sigma_max);
    let low = bound.low * select(sigma.x * (1.0 - ROUNDING), sigma.y * (1.0 + ROUNDING), bound.low < 0.0);
    let high = bound.high * select(sigma.x * (1.0 + ROUNDING), sigma.y * (1.0 - ROUNDING), bound.high < 0.0);
    let is_near = all(p > (*field).lower + SCENE_ROUNDING) && all(p < (*field).upper - SCENE_ROUNDING);
    return Range(
        select(low, max(low, to_bounds.low), is_out),
        select(max(high, to_bounds.high), high, is_near),
    );
}

fn box_distance(node: MergeNode, p: vec3f) -> f32 {
    let outside = length(max(max(node.min - p, p - node.max), vec3f(0.0)));
    return outside * (1.0 - ROUNDING) - SCENE_ROUNDING;
}

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let index = params.first + id.x;
    let x = index % params.shape.x;
    let row = index / params.shape.x;
    let y = row % params.shape.y;
    let z = params.first_plane + row / params.shape.y;
    let p = vec3f(axes[x], axes[params.shape.x + y], axes[params.shape.x + params.shape.y + z]);

    var owner = UNDECIDED;
    var best = Range(FAR_T, FAR_T);
    // Smallest lower end of the ranges of all other fields.
    var others = FAR_T;
    var stack: array<u32, MAX_STACK>;
    stack[0] = 0u;
    var top = 1u;
    var work = 0u;
    while top > 0u && work < MAX_WORK {
        work++;
        top--;
        let node = nodes[stack[top]];
        // The field may be below every value so far anywhere inside the box.
        if box_distance(node, p) > max(best.high, 0.0) { continue; }
        if node.count == 0u {
            let is_left_near = box_distance(nodes[node.first], p) <= box_distance(nodes[node.first + 1u], p);
            stack[top] = node.first + u32(is_left_near);
            stack[top + 1u] = node.first + u32(!is_left_near);
            top += 2u;
            continue;
        }
        for (var i = 0u; i < node.count; i++) {
            work += FIELD_WORK;
            let candidate = order[node.first + i];
            let found = bound_range(candidate, p);
            if found.high < best.high {
                others = min(others, best.low);
                best = found;
                owner = candidate;
            } else {
                others = min(others, found.low);
            }
        }
    }
    let is_decided = top == 0u && best.high < FAR_T && others > best.high;
    owners[index] = select(UNDECIDED, owner, is_decided);
}
