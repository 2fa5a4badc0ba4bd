// Unsigned distances at the samples of a grid, in local units. One invocation computes one sample; one workgroup
// computes a block of 4^3 samples.
//
// `coarse` computes every fourth sample along each axis and stores its nearest triangle. `main` starts each search from
// the triangle of the nearest coarse sample, which is already a tight upper bound. Twin of src/bake/dense/mod.rs: the
// distances are the same, but the search is a different one.

#import bvh
#import grid

struct DistanceParams {
    // Number of samples of the grid along each axis.
    shape: vec3u,
    // First block of this dispatch, counted within the slab.
    first_block: u32,
    // Number of samples of the coarse grid along each axis.
    coarse_shape: vec3u,
    // Distance between neighbouring coarse samples, in samples.
    stride: u32,
    // The slab: first plane and number of planes that the output holds.
    first_plane: u32,
    planes: u32,
    pad_0: u32,
    // Square of the largest distance that has to be exact, local units.
    limit_squared: f32,
}

@group(0) @binding(0) var<uniform> params: DistanceParams;
@group(0) @binding(4) var<storage, read_write> coarse_slots: array<u32>;
// Distances (`main`) or squared distances (`coarse`), local units. Negative where the search ran out of rounds.
@group(0) @binding(5) var<storage, read_write> results: array<f32>;
@group(0) @binding(6) var<storage, read_write> overflows: atomic<u32>;

// The sample of an invocation, relative to the slab. The caller must discard samples past the edge of the slab.
fn slab_sample(block: u32, local: vec3u) -> vec3u {
    let slab = vec3u(params.shape.xy, params.planes);
    return unravel(params.first_block + block, (slab + BLOCK - 1u) / BLOCK) * BLOCK + local;
}

@compute @workgroup_size(4, 4, 4)
fn coarse(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let voxel = slab_sample(block.x, local);
    if any(voxel >= vec3u(params.shape.xy, params.planes)) { return; }
    let p = sample_position(voxel + vec3u(0u, 0u, params.first_plane), params.shape);
    let found = nearest_triangle(p, Nearest(FAR, 0u, false));
    if !found.complete { atomicAdd(&overflows, 1u); }
    let offset = sample_offset(voxel, params.shape);
    coarse_slots[offset] = found.slot;
    results[offset] = select(-1.0, found.squared, found.complete);
}

@compute @workgroup_size(4, 4, 4)
fn main(@builtin(workgroup_id) block: vec3u, @builtin(local_invocation_id) local: vec3u) {
    let voxel = slab_sample(block.x, local);
    if any(voxel >= vec3u(params.shape.xy, params.planes)) { return; }
    let sample = voxel + vec3u(0u, 0u, params.first_plane);
    let p = sample_position(sample, params.shape);
    let node = min((sample + params.stride / 2u) / params.stride, params.coarse_shape - 1u);
    let slot = coarse_slots[sample_offset(node, params.coarse_shape)];
    let bound = triangle_distance_squared(triangles[slot], p);
    let found = nearest_triangle(p, Nearest(min(bound, params.limit_squared), slot, false));
    if !found.complete { atomicAdd(&overflows, 1u); }
    results[sample_offset(voxel, params.shape)] = select(-1.0, sqrt(found.squared), found.complete);
}
