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

// The angle of a vector from the x axis, radians, -pi to pi, to 2e-7: the built-in function may have an error of 5e-4.
// The polynomial is the one of S. Moshier's Cephes library for float32.
fn angle_of(v: vec2f) -> f32 {
    let a = abs(v);
    let larger = max(max(a.x, a.y), 1e-30);
    let smaller = min(a.x, a.y);
    let is_steep = smaller > 0.41421356 * larger;
    let t = select(smaller / larger, (smaller - larger) / (smaller + larger), is_steep);
    let q = t * t;
    let series = (((0.080537444 * q - 0.13877685) * q + 0.19977711) * q - 0.3333295) * q * t + t;
    var angle = series + select(0.0, 0.78539816, is_steep);
    if a.y > a.x { angle = 1.57079633 - angle; }
    if v.x < 0.0 { angle = 3.14159265 - angle; }
    return select(angle, -angle, v.y < 0.0);
}

// Signed distance to a screw thread; see src/csg/evaluation/helicoid.rs.
fn thread(at: vec3f, k: array<f32, 6>) -> f32 {
    let pitch = k[0];
    let minor = k[1];
    let major = k[2];
    let crest = k[3];
    let root = k[4];
    let rise = pitch * 0.15915494;
    let r = length(at.xy);
    let core = minor * THREAD_CORE;
    let outer = max(r, core);
    let height = at.z - rise * angle_of(at.xy);
    let flank = vec2f(minor - major, root - crest);

    let from_crest = abs(height - floor(height / pitch + 0.5) * pitch);
    let limit = major + clamp((from_crest - crest) / flank.y, 0.0, 1.0) * flank.x;

    var nearest = CSG_FAR;
    if from_crest <= crest { nearest = abs(outer - major); }
    if from_crest >= root { nearest = min(nearest, abs(outer - minor)); }
    var turn = 0.0;
    for (var i = 0u; i < THREAD_SEARCHES; i++) {
        let u = height - rise * turn;
        let place = floor(u / pitch + 0.5) * pitch;
        let at_profile = vec2f(outer * cos(turn), abs(u - place));
        let share = clamp(dot(at_profile - vec2f(major, crest), flank) / dot(flank, flank), 0.0, 1.0);
        let on_flank = vec2f(major, crest) + share * flank;
        nearest = min(nearest, length(vec3f(at_profile - on_flank, outer * sin(turn))));
        let along = place + select(on_flank.y, -on_flank.y, u < place);
        turn = rise * (height - along) / (outer * on_flank.x + rise * rise);
    }
    let inner = max(minor - r, nearest - (core - r));
    let size = select(nearest, inner, r < core);
    return select(size, -size, outer < limit) - k[5];
}

// An extrusion with taper and chamfers; see extrude in src/csg/evaluation/field.rs.
fn extruded(flat: f32, z: f32, k: array<f32, 6>) -> f32 {
    let half_height = k[0];
    if k[5] == 0.0 { return prism(flat, z, half_height); }
    let side = flat * k[2] + (z + select(-half_height, half_height, k[1] > 0.0)) * k[1];
    let solid = max(side, abs(z) - half_height);
    let chamfers = max(side + k[4] + z - half_height, side + k[3] - z - half_height) * k[5];
    return select(solid, max(solid, chamfers), k[3] + k[4] > 0.0);
}

// The list of edges of a cell; list 0 is for points outside the grid.
fn edge_list(cell: vec2f, counts: vec2f) -> u32 {
    if all(cell >= vec2f(0.0)) && all(cell < counts) { return 1u + u32(cell.x) + u32(counts.x) * u32(cell.y); }
    return 0u;
}

// Squared distance to an edge, the product with the outward normal at the nearest point, and the squared length of the
// edge; zero if the nearest point is an end.
fn edge_beside(at: vec2f, ends: vec4f, normals: vec4f) -> vec3f {
    let along = ends.zw - ends.xy;
    let to = at - ends.xy;
    let squared = dot(along, along);
    let share = dot(to, along) / squared;
    if share <= 0.0 { return vec3f(dot(to, to), dot(to, normals.xy), 0.0); }
    if share < 1.0 {
        let away = to - share * along;
        return vec3f(dot(away, away), to.x * along.y - to.y * along.x, squared);
    }
    let past = at - ends.zw;
    return vec3f(dot(past, past), dot(past, normals.zw), 0.0);
}

// The signed distance from the nearest result of edge_beside.
fn signed_edge_distance(nearest: vec3f) -> f32 {
    if nearest.z > 0.0 { return nearest.y / sqrt(nearest.z); }
    return select(sqrt(nearest.x), -sqrt(nearest.x), nearest.y < 0.0);
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
