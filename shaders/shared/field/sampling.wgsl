// Trilinear interpolation of a dense field. It is written out, because hardware filters round the weights to about 8
// bits. Twin of src/volume/mod.rs. The importing kernel must define `stored_sample(i)`, the sample at index i in
// memory.

#import cubic

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
        stored_sample(low.x + y0 + z0), stored_sample(high.x + y0 + z0),
        stored_sample(low.x + y1 + z0), stored_sample(high.x + y1 + z0),
        stored_sample(low.x + y0 + z1), stored_sample(high.x + y0 + z1),
        stored_sample(low.x + y1 + z1), stored_sample(high.x + y1 + z1),
    );
}
