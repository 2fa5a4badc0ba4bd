// Copies the samples at the corners of cells of a dense field, for points that the CPU interpolates. Twin of
// FieldView::corners in src/volume/mod.rs.

#import samples

struct CellParams {
    // Number of samples of the whole field along each axis.
    shape: vec3u,
    // Index of the first cell of this dispatch.
    first: u32,
    // Number of cells of this dispatch.
    count: u32,
    // The bound slab has the planes of samples from `first_plane` up to `end_plane`, exclusive.
    first_plane: u32,
    end_plane: u32,
    pad_0: u32,
}

@group(0) @binding(0) var<uniform> params: CellParams;
// Coordinates of the cells along x, y and z, from -1 to n - 1.
@group(0) @binding(2) var<storage, read> cells: array<i32>;
// Eight samples per cell; bit 0 of the corner is x, bit 1 y, bit 2 z. Corners in other slabs are left as they are.
@group(0) @binding(3) var<storage, read_write> corners: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let i = params.first + id.x;
    let cell = vec3i(cells[3u * i], cells[3u * i + 1u], cells[3u * i + 2u]);
    let last = vec3i(params.shape) - 1;
    for (var corner = 0u; corner < 8u; corner++) {
        let step = vec3i(vec3u(corner & 1u, corner >> 1u & 1u, corner >> 2u));
        let voxel = vec3u(clamp(cell + step, vec3i(0), last));
        if voxel.z >= params.first_plane && voxel.z < params.end_plane {
            let row = voxel.y + params.shape.y * (voxel.z - params.first_plane);
            corners[8u * i + corner] = stored_sample(voxel.x + params.shape.x * row);
        }
    }
}
