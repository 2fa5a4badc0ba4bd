// Traces rays through a single sparse field, from the buffers that src/render/gpu_fields.rs uploads.

#import clip
#import bricks_march

struct SparseParams {
    // Number of bricks along each axis.
    bricks: vec3u,
    // Smallest distance of any point of an empty brick from the surface, world units.
    floor: f32,
    // Distance of neighbouring nodes along each axis, in units of the longest of the three steps.
    node_step: vec3f,
    // Longest of the three steps, world units.
    longest_step: f32,
}

@group(0) @binding(5) var<storage, read> index: array<u32>;
@group(0) @binding(6) var<storage, read> nodes: array<f32>;
// One byte per brick, x fastest: the radius, in bricks, of the surrounding cube that contains no surface; 0 if the
// brick has one.
@group(0) @binding(8) var<storage, read> empty_space: array<u32>;
@group(0) @binding(9) var<uniform> sparse: SparseParams;

var<private> steps: u32;

fn brick_word(at: u32) -> u32 {
    return index[at];
}

fn brick_node(at: u32) -> f32 {
    return nodes[at];
}

fn empty_bytes(at: u32) -> u32 {
    return empty_space[at];
}

fn all_bricks(shape: vec3u) -> Bricks {
    return Bricks(shape, sparse.bricks, sparse.floor, sparse.node_step, sparse.longest_step, 0u, 0u, 0u, 0u);
}

// The field at a point of grid space, world units. Outside the box: the value at its nearest point.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    return sample_bricks(all_bricks(shape), clamp(p_grid, vec3f(-0.5), vec3f(shape) - 0.5));
}

// Traces a ray to its first hit.
fn march(ray: ClippedRay, shape: vec3u) -> Hit {
    var hit: Hit;
    steps = 0u;
    let t = march_bricks(all_bricks(shape), ray.origin, ray.direction, ray.t_max);
    hit.steps = steps;
    hit.is_hit = t >= 0.0;
    hit.t = max(t, 0.0);
    hit.at_start = t == 0.0;
    return hit;
}
