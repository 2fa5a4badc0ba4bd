// Finds the nearest triangle of each point of a list. The CPU then computes the closest point on it in float64. Twin of
// src/query.rs.

#import bvh

struct QueryParams {
    first: u32,
    count: u32,
    pad_0: u32,
    pad_1: u32,
}

@group(0) @binding(0) var<storage, read> params: QueryParams;
// Positions in local coordinates, three floats per point.
@group(0) @binding(3) var<storage, read> points: array<f32>;
// Index of the nearest face of each point; NOTHING where the search ran out of rounds.
@group(0) @binding(4) var<storage, read_write> faces: array<u32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let i = params.first + id.x;
    let p = vec3f(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
    let found = nearest_triangle(p, Nearest(FAR, 0u, false));
    faces[i] = select(NOTHING, triangles[found.slot].face, found.complete);
}
