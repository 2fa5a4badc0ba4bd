// The stored field between its samples, by hand: hardware filters round the weights to 8 bits or so. Twin of
// src/volume/mod.rs.

#import cubic

@group(0) @binding(1) var<storage, read> distances: array<f32>;

// The samples at the corners of a cell; bit 0 of the index is x, bit 1 y, bit 2 z. Cells run from -1 to n - 1.
fn cell_corners(cell: vec3i, shape: vec3u) -> array<f32, 8> {
    let last = vec3i(shape) - 1;
    let low = vec3u(clamp(cell, vec3i(0), last));
    let high = vec3u(clamp(cell + 1, vec3i(0), last));
    let y0 = low.y * shape.x;
    let y1 = high.y * shape.x;
    let z0 = low.z * shape.x * shape.y;
    let z1 = high.z * shape.x * shape.y;
    return array<f32, 8>(
        distances[low.x + y0 + z0], distances[high.x + y0 + z0],
        distances[low.x + y1 + z0], distances[high.x + y1 + z0],
        distances[low.x + y0 + z1], distances[high.x + y0 + z1],
        distances[low.x + y1 + z1], distances[high.x + y1 + z1],
    );
}

// The trilinear field at a point of grid space; outside the box, at its nearest point.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    let p = clamp(p_grid, vec3f(-0.5), vec3f(shape) - 0.5);
    let cell = floor(p);
    return trilinear(cell_corners(vec3i(cell), shape), p - cell);
}
