// Distances of the primitives of CSG shapes, and the joints of their operators. Twin of src/csg/evaluation/field.rs and
// src/csg/evaluation/program.rs, function by function. `k` holds the parameters in the order of Primitive::parameters.

fn sphere(at: vec3f, k: array<f32, 6>) -> f32 {
    return length(at) - k[0];
}

// The dual of the distance at the multiplier that Newton's method found; see src/csg/evaluation/field.rs.
fn ellipsoid(at: vec3f, k: array<f32, 6>) -> f32 {
    let radii = vec3f(k[0], k[1], k[2]);
    let above = vec3f(k[3], k[4], k[5]);
    let q = abs(at);
    let c = radii * q;
    let starts = c - above;
    var t = max(max(starts.x, max(starts.y, starts.z)), ELLIPSOID_TINY);
    for (var i = 0u; i < ELLIPSOID_STEPS; i++) {
        let w = 1.0 / (t + above);
        let a = c * w * (c * w);
        let sum = a.x + a.y + a.z;
        t = max(t + sum * (sqrt(sum) - 1.0) / max(dot(a, w), ELLIPSOID_TINY), ELLIPSOID_TINY);
    }
    let shortest = min(radii.x, min(radii.y, radii.z));
    let t_from_zero = t - shortest * shortest;
    let excess = dot(q, q / (t + above)) - 1.0;
    if t_from_zero > 0.0 { return sqrt(t_from_zero) * sqrt(max(excess, 0.0)); }
    return -(sqrt(-t_from_zero) * sqrt(max(-excess, 0.0)));
}

fn cuboid(at: vec3f, half: vec3f) -> f32 {
    let q = abs(at) - half;
    return length(max(q, vec3f(0.0))) + min(max(q.x, max(q.y, q.z)), 0.0);
}

fn rounded_box(at: vec3f, k: array<f32, 6>) -> f32 {
    return cuboid(at, vec3f(k[0], k[1], k[2])) - k[3];
}

// Distance to the nearest of three bars, one along each axis; all others follow by symmetry.
fn box_frame(at: vec3f, k: array<f32, 6>) -> f32 {
    let half = vec3f(k[0], k[1], k[2]);
    let bar = k[3];
    // Coordinates relative to the middle of a bar, along the two axes across it.
    let q = abs(at) - (half - bar);
    let along_x = cuboid(vec3f(at.x, q.y, q.z), vec3f(half.x, bar, bar));
    let along_y = cuboid(vec3f(q.x, at.y, q.z), vec3f(bar, half.y, bar));
    let along_z = cuboid(vec3f(q.x, q.y, at.z), vec3f(bar, bar, half.z));
    return min(along_x, min(along_y, along_z));
}

fn torus(at: vec3f, k: array<f32, 6>) -> f32 {
    return length(vec2f(length(at.xy) - k[0], at.z)) - k[1];
}

fn capped_torus(at: vec3f, k: array<f32, 6>) -> f32 {
    let end = vec2f(k[2], k[3]);
    let y = abs(at.y);
    let to_ring = length(vec2f(length(at.xy) - k[0], at.z));
    let to_end = length(vec3f(vec2f(at.x, y) - k[0] * end, at.z));
    return select(to_ring, to_end, y * end.x - at.x * end.y > 0.0) - k[1];
}

// Distance to a prism: a 2D distance extruded along z.
fn prism(flat: f32, z: f32, half_height: f32) -> f32 {
    let above = abs(z) - half_height;
    return min(max(flat, above), 0.0) + length(max(vec2f(flat, above), vec2f(0.0)));
}

fn cylinder(at: vec3f, k: array<f32, 6>) -> f32 {
    return prism(length(at.xy) - k[0], at.z, k[1]);
}

// The points within k[2] of a smaller cylinder.
fn rounded_cylinder(at: vec3f, k: array<f32, 6>) -> f32 {
    return prism(length(at.xy) - k[0], at.z, k[1]) - k[2];
}

fn capsule(at: vec3f, k: array<f32, 6>) -> f32 {
    return length(vec3f(at.xy, at.z - clamp(at.z, -k[1], k[1]))) - k[0];
}

// The smaller of the distances to the cap and to the side of a truncated cone.
fn cone(at: vec3f, k: array<f32, 6>) -> f32 {
    let r = length(at.xy);
    let cap_radius = select(k[1], k[0], at.z < 0.0);
    let cap = vec2f(max(r - cap_radius, 0.0), abs(at.z) - k[2]);
    // Position along the side, 0 at the top and 1 at the bottom.
    let slant = vec2f(k[0] - k[1], -2.0 * k[2]);
    let from_top = vec2f(r - k[1], at.z - k[2]);
    let side = from_top - clamp(dot(from_top, slant) * k[3], 0.0, 1.0) * slant;
    let size = sqrt(min(dot(cap, cap), dot(side, side)));
    return select(size, -size, side.x < 0.0 && cap.y < 0.0);
}

// The nearest of the lower ball, the upper ball and the side. The normals of the side through the two centres separate
// these regions.
fn rounded_cone(at: vec3f, k: array<f32, 6>) -> f32 {
    let q = vec2f(length(at.xy), at.z - k[2]);
    let along = q.y * k[4] - q.x * k[5];
    if along < 0.0 { return length(q) - k[0]; }
    if along > k[3] * k[4] { return length(vec2f(q.x, q.y - k[3])) - k[1]; }
    return q.x * k[4] + q.y * k[5] - k[0];
}

fn plane(at: vec3f, k: array<f32, 6>) -> f32 {
    return dot(at, vec3f(k[0], k[1], k[2])) - k[3];
}

fn slab(at: vec3f, k: array<f32, 6>) -> f32 {
    return abs(dot(at, vec3f(k[0], k[1], k[2]))) - k[3];
}

// By symmetry the point has x >= y >= 0, and the nearest side is the one that faces +x.
fn pyramid(at: vec3f, k: array<f32, 6>) -> f32 {
    let half = k[0];
    let slant = k[2];
    let x = max(abs(at.x), abs(at.y));
    let y = min(abs(at.x), abs(at.y));
    let height = at.z + k[1];
    // Distance out of the side, and position up the side from the middle of its base edge.
    let out = (x - half) * k[4] + height * k[3];
    let up = (half - x) * k[3] + height * k[4];

    let inside = max(out, -height);
    let beyond = ((y - half) * slant + up * half) / (half * half + slant * slant);
    var foot = vec2f(min(y, half), max(up, 0.0));
    if beyond > 0.0 {
        let along = clamp((up - beyond * half) / slant, 0.0, 1.0);
        foot = vec2f(half * (1.0 - along), slant * along);
    }
    let to_side = length(vec3f(out, y - foot.x, up - foot.y));
    let to_base = length(vec3f(max(x - half, 0.0), max(y - half, 0.0), height));
    return select(inside, min(to_side, to_base), inside > 0.0);
}

fn octahedron(at: vec3f, k: array<f32, 6>) -> f32 {
    let q = abs(at);
    let m = q.x + q.y + q.z - k[0];
    // Where the projection onto the plane of the face has a negative coordinate, the nearest point lies on that edge.
    var turned: vec3f;
    if 3.0 * q.x < m {
        turned = q;
    } else if 3.0 * q.y < m {
        turned = q.yzx;
    } else if 3.0 * q.z < m {
        turned = q.zxy;
    } else {
        return m * 0.57735027;
    }
    let along = clamp(0.5 * (turned.z - turned.y + k[0]), 0.0, k[0]);
    return length(vec3f(turned.x, turned.y - k[0] + along, turned.z - along));
}

fn hex_prism(at: vec3f, k: array<f32, 6>) -> f32 {
    // Mirrors the sides onto the one that faces +y.
    let edge = vec2f(-0.8660254, 0.5);
    var q = abs(at.xy);
    q -= 2.0 * min(dot(edge, q), 0.0) * edge;
    let half_side = k[0] * 0.57735027;
    let across = q.y - k[0];
    let flat = length(vec2f(q.x - clamp(q.x, -half_side, half_side), across));
    return prism(select(flat, -flat, across < 0.0), at.z, k[1]);
}

fn gyroid(at: vec3f, k: array<f32, 6>) -> f32 {
    let q = at * k[0];
    return abs(dot(sin(q), cos(q.yzx))) * k[1] - k[2];
}

fn schwarz_p(at: vec3f, k: array<f32, 6>) -> f32 {
    return abs(dot(cos(at * k[0]), vec3f(1.0))) * k[1] - k[2];
}

fn diamond(at: vec3f, k: array<f32, 6>) -> f32 {
    let q = at * k[0];
    return abs(sin(q.x) * cos(q.y - q.z) + cos(q.x) * sin(q.y + q.z)) * k[1] - k[2];
}

fn iwp(at: vec3f, k: array<f32, 6>) -> f32 {
    let c = cos(at * k[0]);
    // cos 2x = 2 cos^2 x - 1.
    return abs(2.0 * (dot(c, c.yzx) - dot(c, c) + 1.5)) * k[1] - k[2];
}

// Squared distance to an edge of a polygon, and 1 if the edge crosses the ray from the point to the right, else 0. The
// parity of the crossings tells the side.
fn edge_beside(at: vec2f, before: vec2f, corner: vec2f) -> vec2f {
    let edge = before - corner;
    let to = at - corner;
    let away = to - clamp(dot(to, edge) / dot(edge, edge), 0.0, 1.0) * edge;
    let spans_height = (corner.y > at.y) != (before.y > at.y);
    let is_right = (to.x * edge.y < to.y * edge.x) == (edge.y > 0.0);
    return vec2f(dot(away, away), select(0.0, 1.0, spans_height && is_right));
}

fn circle(at: vec2f, radius: f32) -> f32 {
    return length(at) - radius;
}

fn rectangle(at: vec2f, half: vec2f) -> f32 {
    let q = abs(at) - half;
    return length(max(q, vec2f(0.0))) + min(max(q.x, q.y), 0.0);
}

// The union of two fields: sharp, smooth over a width, or chamfered by a width.
fn sharp_union(a: f32, b: f32, width: f32) -> f32 {
    return min(a, b);
}

fn smooth_union(a: f32, b: f32, width: f32) -> f32 {
    let h = max(width - abs(a - b), 0.0);
    return min(a, b) - h * h / (4.0 * width);
}

fn chamfer_union(a: f32, b: f32, width: f32) -> f32 {
    return min(min(a, b), (a + b - width) * 0.70710678);
}

// A point in the space of a copy on a lattice. The copy is `step` cells after the lower one of the two nearest cells.
fn nearest_copy(p: vec3f, spacing: vec3f, inverse: vec3f, start: vec3f, last: vec3f, step: vec3f) -> vec3f {
    return p - spacing * (clamp(floor(p * inverse + start), vec3f(0.0), last) + step);
}

fn turned_about_z(p: vec3f, angle: f32) -> vec3f {
    let s = sin(angle);
    let c = cos(angle);
    return vec3f(c * p.x - s * p.y, s * p.x + c * p.y, p.z);
}
