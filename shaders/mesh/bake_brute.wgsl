// The bake of articles 001 and 003, as a reference to compare with and to read. One invocation computes one sample and
// visits every triangle. The production bake is bake_distance.wgsl.
//
// Each dispatch visits one chunk of triangles, because software adapters stop an invocation after 65,535 loop
// iterations without an error. `state` keeps the minimum between dispatches. The sign follows article 001 (normal of
// the nearest face, after a nudge along it that breaks ties at edges) or article 003 (inside if the number of
// crossings is odd).

#import triangle
#import grid

struct BruteParams {
    shape: vec3u,
    // First triangle of this dispatch, and number of triangles.
    first_triangle: u32,
    triangle_count: u32,
    // First sample of this dispatch, and number of samples.
    first_sample: u32,
    sample_count: u32,
    // 0: unsigned, 1: nearest normal, 2: parity of the crossings along +x.
    sign_rule: u32,
}

struct BruteState {
    // Smallest squared distance so far.
    squared: f32,
    // Smallest squared distance to a nudged closest point so far, and whether the sample is behind that triangle (1) or
    // not (0).
    nudged_squared: f32,
    behind: u32,
    crossings: u32,
}

@group(0) @binding(0) var<uniform> params: BruteParams;
// Corners of the triangles, three per triangle; w is unused.
@group(0) @binding(1) var<storage, read> corners: array<vec4f>;
@group(0) @binding(2) var<storage, read> triangles: array<Triangle>;
@group(0) @binding(4) var<storage, read_write> state: array<BruteState>;
@group(0) @binding(5) var<storage, read_write> distances: array<f32>;

// Closest point on a triangle by Voronoi regions: Ericson, Real-Time Collision Detection, 2005, section 5.1.5.
fn closest_point_on_triangle(p: vec3f, a: vec3f, b: vec3f, c: vec3f) -> vec3f {
    let ab = b - a;
    let ac = c - a;
    let ap = p - a;
    let d1 = dot(ab, ap);
    let d2 = dot(ac, ap);
    if d1 <= 0.0 && d2 <= 0.0 { return a; }
    let bp = p - b;
    let d3 = dot(ab, bp);
    let d4 = dot(ac, bp);
    if d3 >= 0.0 && d4 <= d3 { return b; }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 { return a + ab * (d1 / (d1 - d3)); }
    let cp = p - c;
    let d5 = dot(ab, cp);
    let d6 = dot(ac, cp);
    if d6 >= 0.0 && d5 <= d6 { return c; }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 { return a + ac * (d2 / (d2 - d6)); }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let scale = 1.0 / (va + vb + vc);
    return a + ab * (vb * scale) + ac * (vc * scale);
}

// Twice the signed area of p, a, b in the plane along x.
fn turn(p: vec3f, a: vec3f, b: vec3f) -> f32 {
    return (a.y - p.y) * (b.z - p.z) - (a.z - p.z) * (b.y - p.y);
}

// Whether the ray from `p` along +x crosses the triangle. The test is half-open in y and z, but evaluated in float32: a
// ray through an edge may be counted twice or not at all. The CPU has an exact version (src/sign/crossing.rs).
fn crosses(p: vec3f, a: vec3f, b: vec3f, c: vec3f) -> bool {
    let from_a = turn(p, b, c);
    let from_b = turn(p, c, a);
    let from_c = turn(p, a, b);
    let area = from_a + from_b + from_c;
    let same = (from_a >= 0.0 && from_b >= 0.0 && from_c >= 0.0 && area > 0.0)
        || (from_a < 0.0 && from_b < 0.0 && from_c < 0.0);
    return same && (from_a * a.x + from_b * b.x + from_c * c.x) / area > p.x;
}

@compute @workgroup_size(64)
fn main(@builtin(workgroup_id) group: vec3u, @builtin(local_invocation_index) local: u32) {
    let index = (group.y * WORKGROUPS_PER_ROW + group.x) * 64u + local;
    if index >= params.sample_count { return; }
    let offset = params.first_sample + index;
    let p = sample_position(unravel(offset, params.shape), params.shape);
    var now = state[offset];
    for (var i = 0u; i < min(params.triangle_count, MAX_TRIANGLES); i++) {
        let t = params.first_triangle + i;
        now.squared = min(now.squared, triangle_distance_squared(triangles[t], p));
        let a = corners[3u * t].xyz;
        let b = corners[3u * t + 1u].xyz;
        let c = corners[3u * t + 2u].xyz;
        if params.sign_rule == NORMAL {
            let normal = triangles[t].n;
            let q = closest_point_on_triangle(p, a, b, c);
            let way = p - (q + normal * NUDGE);
            let nudged = dot(way, way);
            if nudged < now.nudged_squared {
                now.nudged_squared = nudged;
                now.behind = u32(dot(p - q, normal) < 0.0);
            }
        } else if params.sign_rule == PARITY && crosses(p, a, b, c) {
            now.crossings++;
        }
    }
    state[offset] = now;
    let inside = (params.sign_rule == NORMAL && now.behind == 1u)
        || (params.sign_rule == PARITY && now.crossings % 2u == 1u);
    let distance = sqrt(now.squared);
    distances[offset] = select(distance, -distance, inside);
}
