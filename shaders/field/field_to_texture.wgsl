// Converts samples to half floats in units of the smallest side of a voxel. The rows are padded so that they can be
// copied to a texture.

struct TextureParams {
    width: u32,
    height: u32,
    // First plane and number of planes of this dispatch, counted in the bound buffer.
    first_plane: u32,
    planes: u32,
    // Number of texel pairs from the start of a row to the start of the next, padding included.
    words_per_row: u32,
    // Factor for distances.
    per_voxel: f32,
    // Number of workgroups along x.
    workgroups_across: u32,
    pad_0: u32,
}

@group(0) @binding(0) var<uniform> params: TextureParams;
@group(0) @binding(1) var<storage, read> distances: array<f32>;
@group(0) @binding(2) var<storage, read_write> rows: array<u32>;

// The largest half float.
const MAX_HALF: f32 = 65504.0;
const WORKGROUP: u32 = 64u;

fn texel(x: u32, row: u32) -> f32 {
    if x >= params.width { return 0.0; }
    let distance = distances[x + params.width * (row + params.height * params.first_plane)];
    return clamp(distance * params.per_voxel, -MAX_HALF, MAX_HALF);
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let index = (group.x + params.workgroups_across * group.y) * WORKGROUP + local;
    let row = index / params.words_per_row;
    if row >= params.height * params.planes { return; }
    let x = 2u * (index % params.words_per_row);
    rows[index] = pack2x16float(vec2f(texel(x, row), texel(x + 1u, row)));
}
