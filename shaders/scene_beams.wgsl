// What share of thin rays and cones passes the instances of a scene. Twin of src/scene/shadow.rs and field.rs.

#import cubic

struct SceneNode {
    min: vec3f,
    // First item of a leaf, or left child; the right one follows it.
    first: u32,
    max: vec3f,
    // Items of a leaf; 0 for an inner node.
    count: u32,
}

struct SceneInstance {
    // Rows of the affine map from scene space to field space.
    field_x: vec4f,
    field_y: vec4f,
    field_z: vec4f,
    // Rows of the map of directions from scene space to the thing's own axes.
    local_x: vec3f,
    opacity: f32,
    local_y: vec3f,
    least_stretch: f32,
    local_z: vec3f,
    largest_stretch: f32,
    // Rows of the map of normals from scene space to field space.
    normal_x: vec3f,
    grid: u32,
    normal_y: vec3f,
    casts_shadow: u32,
    normal_z: vec3f,
    pad_0: u32,
    box_min: vec3f,
    pad_1: u32,
    box_max: vec3f,
    pad_2: u32,
    surface_lower: vec3f,
    pad_3: u32,
    surface_upper: vec3f,
    pad_4: u32,
    field_extent: vec3f,
    pad_5: u32,
}

struct SceneGrid {
    shape: vec3u,
    first_sample: u32,
    spacing: vec3f,
    first_block: u32,
    blocks: vec3u,
    pad_0: u32,
}

struct Beam {
    p: vec3f,
    t_max: f32,
    // Unit.
    direction: vec3f,
    // Growth of a cone's radius with distance; 0 for a ray.
    slope: f32,
    normal: vec3f,
    bias_voxels: f32,
    own: u32,
    // A cone that is not asked again in parts; the CPU's to know.
    is_coarse: u32,
    pad_0: u32,
    pad_1: u32,
}

struct Answer {
    // Share that passes, or a thickness.
    value: f32,
    is_proven: u32,
    steps: u32,
    // 0 where the steps ran out: then the value means nothing.
    is_complete: u32,
}

struct BeamParams {
    first: u32,
    count: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<uniform> params: BeamParams;
@group(0) @binding(1) var<storage, read> nodes: array<SceneNode>;
// Items of the tree's leaves.
@group(0) @binding(2) var<storage, read> items: array<u32>;
@group(0) @binding(3) var<storage, read> instances: array<SceneInstance>;
@group(0) @binding(4) var<storage, read> grids: array<SceneGrid>;
@group(0) @binding(5) var<storage, read> samples: array<f32>;
// Distance of each block of 4^3 cells to one with a surface, in blocks, four to a word.
@group(0) @binding(6) var<storage, read> blocks: array<u32>;
@group(0) @binding(7) var<storage, read> beams: array<Beam>;
@group(0) @binding(8) var<storage, read_write> answers: array<Answer>;

const FAR_T: f32 = 1e30;
const PARALLEL: f32 = 1e-20;
const TINY: f32 = 1.2e-38;
const MAX_DEPTH: u32 = 34u;
// Of the whole invocation, all loops together: software drivers cut it off at 65,535 without a word.
const MAX_STEPS: u32 = 50000u;
const MAX_CONE_STEPS: u32 = 512u;
const PAST_EDGE: f32 = 1.25;

var<private> steps: u32;

// ---- fields

fn sample_at(grid: SceneGrid, x: u32, y: u32, z: u32) -> f32 {
    return samples[grid.first_sample + x + grid.shape.x * (y + grid.shape.y * z)];
}

fn corners_of(grid: SceneGrid, cell: vec3i) -> array<f32, 8> {
    let last = vec3i(grid.shape) - 1;
    let a = vec3u(clamp(cell, vec3i(0), last));
    let b = vec3u(clamp(cell + 1, vec3i(0), last));
    return array<f32, 8>(
        sample_at(grid, a.x, a.y, a.z), sample_at(grid, b.x, a.y, a.z),
        sample_at(grid, a.x, b.y, a.z), sample_at(grid, b.x, b.y, a.z),
        sample_at(grid, a.x, a.y, b.z), sample_at(grid, b.x, a.y, b.z),
        sample_at(grid, a.x, b.y, b.z), sample_at(grid, b.x, b.y, b.z),
    );
}

// The nearest point of the data.
fn into_data(grid: SceneGrid, p: vec3f) -> vec3f {
    return clamp(p, vec3f(-0.5), vec3f(grid.shape) - 0.5);
}

fn sample_field(grid: SceneGrid, p: vec3f) -> f32 {
    let inside = into_data(grid, p);
    let cell = floor(inside);
    return trilinear(corners_of(grid, vec3i(cell)), inside - cell);
}

// Distance in the thing's units; outside the data a lower bound.
fn field_distance(grid: SceneGrid, p: vec3f) -> f32 {
    let b = into_data(grid, p);
    let s = sample_field(grid, b);
    let outside = (p - b) * grid.spacing;
    let a_squared = dot(outside, outside);
    if a_squared == 0.0 { return s; }
    return sqrt(a_squared + max(s, 0.0) * max(s, 0.0));
}

fn field_gradient(grid: SceneGrid, point: vec3f) -> vec3f {
    let last = vec3f(grid.shape) - 0.5;
    let low = min(vec3f(0.5), last - 1.0);
    let p = min(max(point, low), max(last - 1.0, low));
    let slope = vec3f(
        sample_field(grid, p + vec3f(0.5, 0.0, 0.0)) - sample_field(grid, p - vec3f(0.5, 0.0, 0.0)),
        sample_field(grid, p + vec3f(0.0, 0.5, 0.0)) - sample_field(grid, p - vec3f(0.0, 0.5, 0.0)),
        sample_field(grid, p + vec3f(0.0, 0.0, 0.5)) - sample_field(grid, p - vec3f(0.0, 0.0, 0.5)),
    ) / grid.spacing;
    let largest = max(abs(slope.x), max(abs(slope.y), abs(slope.z)));
    if largest == 0.0 { return vec3f(0.0); }
    return normalize(slope / largest);
}

// A better guess of the distance outside the data.
fn field_distance_guess(grid: SceneGrid, p: vec3f) -> f32 {
    let b = into_data(grid, p);
    let s = sample_field(grid, b);
    if all(p == b) || s <= 0.0 { return field_distance(grid, p); }
    return length((p - b) * grid.spacing + s * field_gradient(grid, b));
}

fn empty_blocks(grid: SceneGrid, block: vec3i) -> i32 {
    let index = grid.first_block + u32(block.x) + grid.blocks.x * (u32(block.y) + grid.blocks.y * u32(block.z));
    return i32((blocks[index / 4u] >> (8u * (index % 4u))) & 0xffu);
}

// The first t in [0, t_max] where the field is not above zero, or -1: leaps over empty blocks, cubics in cells.
fn first_hit(grid: SceneGrid, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let per_t = length(along);
    let direction = along / per_t;
    let end = t_max * per_t;
    let last_cell = vec3i(grid.shape) - 1;
    let forward = direction > vec3f(0.0);
    let side = select(vec3i(0), vec3i(1), forward);
    let is_parallel = abs(direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(direction, vec3f(1.0), is_parallel);
    var t = 0.0;
    var cell = clamp(vec3i(floor(origin)), vec3i(-1), last_cell);
    while steps < MAX_STEPS {
        steps++;
        let block = (cell + 1) >> vec3u(2u);
        let empty = empty_blocks(grid, block);
        // The far faces of the empty cube, or of the cell.
        var face = cell + side;
        if empty > 0 {
            let first = (block - (empty - 1)) * 4 - 1;
            face = first + side * ((2 * empty - 1) * 4);
        }
        let to_faces = select((vec3f(face) - origin) * inverse, vec3f(FAR_T), is_parallel);
        let to_next = min(to_faces.x, min(to_faces.y, to_faces.z));
        let t_end = min(max(to_next, t), end);
        if empty == 0 {
            let c = corners_of(grid, cell);
            let low = vec4f(c[0], c[1], c[2], c[3]);
            let high = vec4f(c[4], c[5], c[6], c[7]);
            let smallest = min(low, high);
            if min(min(smallest.x, smallest.y), min(smallest.z, smallest.w)) <= 0.0 {
                let cubic = cubic_along_ray(c, origin + t * direction - vec3f(cell), direction);
                let sizes = max(abs(low), abs(high));
                let largest = max(max(max(sizes.x, sizes.y), max(sizes.z, sizes.w)), TINY);
                let s = first_root(cubic / largest, t_end - t);
                if s >= 0.0 { return (t + s) / per_t; }
            }
        }
        if t_end >= end { return -1.0; }
        t = t_end;
        // Exact on the axis of the face, never back on the others.
        let beyond = select(face - 1, face, forward);
        if empty > 0 {
            let here = vec3i(floor(origin + t * direction));
            cell = select(min(here, cell), max(here, cell), forward);
        }
        if to_faces.x == to_next {
            cell.x = beyond.x;
        } else if to_faces.y == to_next {
            cell.y = beyond.y;
        } else {
            cell.z = beyond.z;
        }
        cell = clamp(cell, vec3i(-1), last_cell);
    }
    return -1.0;
}

// ---- boxes

// From and to where a line is in a box; from above to where it misses.
fn clip(origin: vec3f, direction: vec3f, lower: vec3f, upper: vec3f, t_max: f32) -> vec2f {
    var span = vec2f(0.0, t_max);
    for (var axis = 0u; axis < 3u; axis++) {
        let low = lower[axis] - origin[axis];
        let high = upper[axis] - origin[axis];
        if abs(direction[axis]) < PARALLEL {
            if low > 0.0 || high < 0.0 { return vec2f(1.0, 0.0); }
            continue;
        }
        let a = low / direction[axis];
        let b = high / direction[axis];
        span = vec2f(max(span.x, min(a, b)), min(span.y, max(a, b)));
    }
    return span;
}

// How far a box is from a point at most.
fn reach(p: vec3f, low: vec3f, high: vec3f) -> f32 {
    return length(max(abs(p - low), abs(p - high)));
}

fn meets(beam: Beam, low: vec3f, high: vec3f) -> bool {
    var grown = 0.0;
    if beam.slope > 0.0 {
        grown = min(beam.slope / (1.0 - min(beam.slope, 0.9)) * reach(beam.p, low, high), beam.slope * beam.t_max);
    }
    let span = clip(beam.p, beam.direction, low - grown, high + grown, beam.t_max);
    return span.x <= span.y * 1.000001;
}

// ---- instances

struct FieldRay {
    origin: vec3f,
    direction: vec3f,
}

fn ray_in_field(index: u32, beam: Beam) -> FieldRay {
    let to = &instances[index];
    var p = beam.p;
    if index == beam.own {
        let n = beam.normal;
        let voxel = length(vec3f(dot((*to).normal_x, n), dot((*to).normal_y, n), dot((*to).normal_z, n)));
        p += beam.bias_voxels * voxel * n;
    }
    let at = vec4f(p, 1.0);
    var ray: FieldRay;
    ray.origin = vec3f(dot((*to).field_x, at), dot((*to).field_y, at), dot((*to).field_z, at));
    ray.direction = field_direction(index, beam.direction);
    return ray;
}

fn field_direction(index: u32, d: vec3f) -> vec3f {
    let to = &instances[index];
    return vec3f(dot((*to).field_x.xyz, d), dot((*to).field_y.xyz, d), dot((*to).field_z.xyz, d));
}

fn local_direction(index: u32, d: vec3f) -> vec3f {
    let to = &instances[index];
    return vec3f(dot((*to).local_x, d), dot((*to).local_y, d), dot((*to).local_z, d));
}

// A scene normal, not unit, from one in the thing's own axes.
fn scene_normal(index: u32, n: vec3f) -> vec3f {
    let to = &instances[index];
    return (*to).local_x * n.x + (*to).local_y * n.y + (*to).local_z * n.z;
}

// Where a ray enters an instance's matter, or -1.
fn hit_of(index: u32, ray: FieldRay, t_max: f32) -> f32 {
    let to = &instances[index];
    let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, t_max);
    if span.x > span.y { return -1.0; }
    let hit = first_hit(grids[(*to).grid], ray.origin + span.x * ray.direction, ray.direction, span.y - span.x);
    return select(-1.0, hit + span.x, hit >= 0.0);
}

// Share of a thin ray that passes.
fn ray_share(beam: Beam) -> f32 {
    var share = 1.0;
    var stack: array<u32, MAX_DEPTH>;
    var top = 1u;
    stack[0] = 0u;
    while top > 0u && steps < MAX_STEPS {
        steps++;
        top--;
        let node = nodes[stack[top]];
        if !meets(beam, node.min, node.max) { continue; }
        if node.count == 0u {
            stack[top] = node.first;
            stack[top + 1u] = node.first + 1u;
            top += 2u;
            continue;
        }
        for (var i = 0u; i < node.count; i++) {
            let index = items[node.first + i];
            let opacity = instances[index].opacity;
            if instances[index].casts_shadow == 0u || opacity == 0.0 { continue; }
            if hit_of(index, ray_in_field(index, beam), beam.t_max) >= 0.0 {
                share *= 1.0 - opacity;
                if share <= 0.0 { return 0.0; }
            }
        }
    }
    return share;
}

// Scene distance across of a local distance at a point.
fn across(index: u32, distance: f32, p: vec3f) -> f32 {
    let least = instances[index].least_stretch;
    if instances[index].largest_stretch <= least * 1.0001 { return distance * least; }
    let size = length(scene_normal(index, field_gradient(grids[instances[index].grid], p)));
    if size > 0.0 { return distance / size; }
    return distance * least;
}

struct Cone {
    // Signed distance of the nearest edge from the axis in radii, from -1 to 1.
    x: f32,
    is_covered: bool,
}

// Look along a cone past one instance.
fn cone_past(index: u32, beam: Beam) -> Cone {
    let to = &instances[index];
    let grid = grids[(*to).grid];
    let ray = ray_in_field(index, beam);
    let speed = length(ray.direction);
    let widest = beam.slope / (1.0 - min(beam.slope, 0.9)) * reach(beam.p, (*to).box_min, (*to).box_max);
    let radius = min(widest, beam.slope * beam.t_max);
    let grown = (*to).field_extent * radius;
    let span = clip(ray.origin, ray.direction, (*to).surface_lower - grown, (*to).surface_upper + grown, beam.t_max);
    if span.x > span.y { return Cone(1.0, false); }
    let pace = 1.0 / length(local_direction(index, beam.direction));
    let least_step = 0.5 / speed;
    let t_hit = hit_of(index, ray, beam.t_max);
    if t_hit < 0.0 {
        return Cone(beside(index, grid, ray, beam.slope, span, pace, least_step), false);
    }

    // How deep the axis gets.
    var deepest = vec2f(0.0, t_hit);
    var t = t_hit + 0.5 * least_step;
    for (var i = 0u; i < MAX_CONE_STEPS; i++) {
        steps++;
        let p = ray.origin + t * ray.direction;
        let distance = field_distance(grid, p);
        if distance >= 0.0 { break; }
        let x = across(index, distance, p) / (beam.slope * t);
        if x <= -1.0 { return Cone(-1.0, true); }
        if x < deepest.x { deepest = vec2f(x, t); }
        t += max(-0.5 * distance * pace, least_step);
        if t >= span.y { break; }
    }
    // The nearest surface across the ray: an edge only if a ray just past it is free.
    let p = ray.origin + deepest.y * ray.direction;
    let normal = scene_normal(index, field_gradient(grid, p));
    let aside = normal - dot(normal, beam.direction) * beam.direction;
    let size = length(aside);
    if size < TINY { return Cone(-1.0, false); }
    let past = PAST_EDGE * -deepest.x * beam.slope
        + least_step * (*to).largest_stretch / (*to).least_stretch / deepest.y;
    if past > 2.0 * beam.slope { return Cone(-1.0, false); }
    var edge = beam;
    edge.slope = 0.0;
    edge.direction = beam.direction + past * (aside / size);
    let longer = length(edge.direction);
    edge.direction /= longer;
    edge.t_max = min(beam.t_max * longer, FAR_T);
    if ray_share(edge) > 0.0 { return Cone(deepest.x, false); }
    return Cone(-1.0, false);
}

// The axis is free: the least clearance in radii, at most 1.
fn beside(
    index: u32, grid: SceneGrid, ray: FieldRay, slope: f32, span: vec2f, pace: f32, least_step: f32
) -> f32 {
    var x = 1.0;
    var t = span.x;
    for (var i = 0u; i < MAX_CONE_STEPS; i++) {
        steps++;
        let p = ray.origin + t * ray.direction;
        let radius = slope * t;
        let distance = field_distance(grid, p);
        if distance * instances[index].least_stretch < x * radius {
            x = min(x, across(index, max(field_distance_guess(grid, p), 0.0), p) / radius);
        }
        var step = distance * pace;
        if step < 2.0 * radius { step *= 0.5; }
        t += max(step, least_step);
        if t >= span.y { break; }
    }
    return x;
}

// Room for the rounding of an edge's place, in radii.
const RIM_ROUNDING: f32 = 1e-5;

// The share of a disc that is seen when an edge passes at x radii from its centre.
fn visible_share(edge: f32) -> f32 {
    let x = clamp((1.0 + RIM_ROUNDING) * edge, -1.0, 1.0);
    if abs(x) == 1.0 { return 0.5 + 0.5 * x; }
    let s = x * x;
    return 0.5 + x * (0.63661975 - s * (0.1061 + s * (0.01592 + s * 0.0146)));
}

fn cone_share(beam: Beam) -> vec2f {
    var share = 1.0;
    var is_proven = true;
    var x = 1.0;
    var stack: array<u32, MAX_DEPTH>;
    var top = 1u;
    stack[0] = 0u;
    while top > 0u && steps < MAX_STEPS {
        steps++;
        top--;
        let node = nodes[stack[top]];
        if !meets(beam, node.min, node.max) { continue; }
        if node.count == 0u {
            stack[top] = node.first;
            stack[top + 1u] = node.first + 1u;
            top += 2u;
            continue;
        }
        for (var i = 0u; i < node.count; i++) {
            let index = items[node.first + i];
            let opacity = instances[index].opacity;
            if instances[index].casts_shadow == 0u || opacity == 0.0 { continue; }
            let cone = cone_past(index, beam);
            if opacity < 1.0 {
                share *= 1.0 - opacity * (1.0 - visible_share(cone.x));
                is_proven = is_proven && (cone.is_covered || cone.x >= 1.0);
            } else {
                if cone.is_covered { return vec2f(0.0, 1.0); }
                x = min(x, cone.x);
            }
        }
    }
    return vec2f(share * visible_share(x), select(0.0, 1.0, is_proven && x >= 1.0));
}

@compute @workgroup_size(64)
fn shares(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let beam = beams[params.first + id.x];
    steps = 0u;
    var found = vec2f(0.0, 1.0);
    if beam.slope > 0.0 {
        found = cone_share(beam);
    } else {
        found.x = ray_share(beam);
    }
    answers[params.first + id.x] = Answer(found.x, u32(found.y), steps, u32(steps < MAX_STEPS));
}

// How far a ray goes through its own instance's matter.
@compute @workgroup_size(64)
fn thicknesses(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    var beam = beams[params.first + id.x];
    steps = 0u;
    beam.bias_voxels = -beam.bias_voxels;
    let to = &instances[beam.own];
    let grid = grids[(*to).grid];
    let ray = ray_in_field(beam.own, beam);
    let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, FAR_T);
    var thickness = 0.0;
    if span.x <= span.y {
        let pace = 1.0 / length(local_direction(beam.own, beam.direction));
        let least_step = 0.5 / length(ray.direction);
        var t = span.x;
        for (var i = 0u; i < MAX_CONE_STEPS; i++) {
            let distance = field_distance(grid, ray.origin + t * ray.direction);
            steps++;
            let next = min(t + max(abs(distance) * pace, least_step), span.y);
            if distance < 0.0 { thickness += next - t; }
            t = next;
            if t >= span.y { break; }
        }
    }
    answers[params.first + id.x] = Answer(thickness, 1u, steps, 1u);
}
