// The field of a shape at points. Twin of Solid::distances in src/csg/parts/solid.rs.

#import csg_interpreter

struct CsgPointParams {
    first: u32,
    count: u32,
    token_count: u32,
    pad_0: u32,
}

@group(0) @binding(0) var<uniform> params: CsgPointParams;
// Positions in local units, three floats per point.
@group(0) @binding(4) var<storage, read> points: array<f32>;
// Distances in local units; CSG_FAR where the invocation ran out of rounds.
@group(0) @binding(5) var<storage, read_write> distances: array<f32>;

@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= params.count { return; }
    let i = params.first + id.x;
    let p = vec3f(points[3u * i], points[3u * i + 1u], points[3u * i + 2u]);
    let distance = csg_distance(p, 0u, params.token_count);
    distances[i] = select(CSG_FAR, distance, has_rounds());
}
