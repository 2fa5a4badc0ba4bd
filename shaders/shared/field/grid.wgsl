// The grid of samples. The CPU computes the positions along each axis in float64 and rounds them once. `axes` holds the
// positions along x, then y, then z, in local units. Twin of LocalGrid in src/bake/mod.rs.

@group(0) @binding(3) var<storage, read> axes: array<f32>;

fn sample_position(voxel: vec3u, shape: vec3u) -> vec3f {
    return vec3f(axes[voxel.x], axes[shape.x + voxel.y], axes[shape.x + shape.y + voxel.z]);
}

// Index of a sample in memory, x fastest.
fn sample_offset(voxel: vec3u, shape: vec3u) -> u32 {
    return voxel.x + shape.x * (voxel.y + shape.y * voxel.z);
}

// Coordinates of item `index` in a box of `shape` items, x fastest.
fn unravel(index: u32, shape: vec3u) -> vec3u {
    let row = index / shape.x;
    return vec3u(index % shape.x, row % shape.y, row / shape.y);
}
