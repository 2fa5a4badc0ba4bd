// The instances of a scene and their dense fields: distances, gradients, exact hits. Twin of src/scene/field.rs.

#import cubic

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
    // Of a level of a far field; 0 for an instance.
    voxel: f32,
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

@group(0) @binding(3) var<storage, read> instances: array<SceneInstance>;
@group(0) @binding(4) var<storage, read> grids: array<SceneGrid>;
@group(0) @binding(5) var<storage, read> samples: array<f32>;
// Distance of each block of 4^3 cells to one with a surface, in blocks, four to a word.
@group(0) @binding(6) var<storage, read> blocks: array<u32>;

const FAR_T: f32 = 1e30;
const PARALLEL: f32 = 1e-20;
const TINY: f32 = 1.2e-38;
// Of the whole invocation, all loops together: software drivers cut it off at 65,535 without a word.
const MAX_STEPS: u32 = 50000u;

var<private> steps: u32;

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

// From and to where a part of a line is in a box; from above to where it misses.
fn clip(origin: vec3f, direction: vec3f, lower: vec3f, upper: vec3f, part: vec2f) -> vec2f {
    var span = part;
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

struct FieldRay {
    origin: vec3f,
    direction: vec3f,
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

// Where a part of a ray enters an instance's matter, or -1.
fn hit_of(index: u32, ray: FieldRay, part: vec2f) -> f32 {
    let to = &instances[index];
    let span = clip(ray.origin, ray.direction, (*to).surface_lower, (*to).surface_upper, part);
    if span.x > span.y { return -1.0; }
    let hit = first_hit(grids[(*to).grid], ray.origin + span.x * ray.direction, ray.direction, span.y - span.x);
    return select(-1.0, hit + span.x, hit >= 0.0);
}
