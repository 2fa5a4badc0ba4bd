// Turns unsigned local distances into stored ones: applies the band, world units, the sign and the thickness. Twin of
// src/bake/cpu.rs and src/bake/band.rs. The CPU decides the signs by exact predicates in float64 and passes them as
// bits.

#import grid

struct FinishParams {
    shape: vec3u,
    first_plane: u32,
    // Number of nodes of the coarse grid that bounds the far samples, and squared spacing of the nodes in local units.
    coarse_shape: vec3u,
    planes: u32,
    spacing_squared: vec3f,
    // World units per local unit, a power of two.
    scale: f32,
    // Half width of the band, local units; negative for no band.
    width: f32,
    // Thickness, world units.
    half_thickness: f32,
    // Number of words of sign bits per row of samples; 0 if no sample is inside.
    words_per_row: u32,
    // Distance between neighbouring nodes of the coarse grid, in samples.
    stride: u32,
}

@group(0) @binding(0) var<uniform> params: FinishParams;
@group(0) @binding(1) var<storage, read> inside_bits: array<u32>;
@group(0) @binding(2) var<storage, read> squares: array<f32>;
@group(0) @binding(4) var<storage, read_write> distances: array<f32>;
@group(0) @binding(5) var<storage, read_write> negative_count: atomic<u32>;

// A lower bound on the distance at a sample, from the exact squared distances at the surrounding nodes
// (src/bake/band.rs).
fn lower_bound(voxel: vec3u) -> f32 {
    let node = voxel / params.stride;
    let fraction = vec3f(voxel % params.stride) / f32(params.stride);
    var mean = 0.0;
    for (var corner = 0u; corner < 8u; corner++) {
        let offset = vec3u(corner & 1u, (corner >> 1u) & 1u, corner >> 2u);
        let weights = select(1.0 - fraction, fraction, offset == vec3u(1u));
        let weight = weights.x * weights.y * weights.z;
        if weight > 0.0 {
            mean += weight * squares[sample_offset(node + offset, params.coarse_shape)];
        }
    }
    let spread = dot(params.spacing_squared, fraction * (1.0 - fraction));
    return sqrt(max(mean * (1.0 - SLACK) - spread, 0.0));
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let offset = (group.y * WORKGROUPS_PER_ROW + group.x) * 64u + local;
    if offset >= params.shape.x * params.shape.y * params.planes { return; }
    let voxel = unravel(offset, params.shape);

    var distance = distances[offset];
    if params.width >= 0.0 && distance > params.width {
        distance = max(lower_bound(voxel + vec3u(0u, 0u, params.first_plane)), params.width);
    }
    distance *= params.scale;
    if params.words_per_row > 0u {
        let row = offset / params.shape.x;
        let word = inside_bits[row * params.words_per_row + voxel.x / 32u];
        if ((word >> (voxel.x % 32u)) & 1u) == 1u { distance = -distance; }
    }
    distance -= params.half_thickness;
    if distance < 0.0 { atomicAdd(&negative_count, 1u); }
    distances[offset] = distance;
}
