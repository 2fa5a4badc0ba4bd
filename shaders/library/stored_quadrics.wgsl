// The array of pack_quadrics as an RGBA32F texture: one row of six texels per quadric.
@group(0) @binding(0) var quadric_texels: texture_2d<f32>;

// A quadric, the points with (p, 1)^T form (p, 1) = 0 inside a trim sphere. The matrix is stored by rows.
struct Quadric {
    row_x: vec4f,
    row_y: vec4f,
    row_z: vec4f,
    row_w: vec4f,
    center: vec3f,
    radius: f32,
    reflectance: vec3f,
    opacity: f32,
}

// One texel of the record in row i.
fn quadric_texel(i: i32, texel: i32) -> vec4f {
    return textureLoad(quadric_texels, vec2i(texel, i), 0);
}

// The quadric in row i.
fn load_quadric(i: i32) -> Quadric {
    var quadric: Quadric;
    quadric.row_x = quadric_texel(i, 0);
    quadric.row_y = quadric_texel(i, 1);
    quadric.row_z = quadric_texel(i, 2);
    quadric.row_w = quadric_texel(i, 3);
    let trim = quadric_texel(i, 4);
    quadric.center = trim.xyz;
    quadric.radius = trim.w;
    let surface = quadric_texel(i, 5);
    quadric.reflectance = surface.xyz;
    quadric.opacity = surface.w;
    return quadric;
}

// The product of the matrix and a vector.
fn quadric_times(quadric: Quadric, v: vec4f) -> vec4f {
    return vec4f(dot(quadric.row_x, v), dot(quadric.row_y, v), dot(quadric.row_z, v), dot(quadric.row_w, v));
}

// The nearest t >= t_min at which a ray, with a direction of length 1, crosses a quadric inside its trim sphere; -1 if
// there is none. The ray is moved to its point nearest to the centre first, so that its origin may be far away. The
// quadric may not: beyond 100 radii from the world's origin the float32 rows are coarse, as pack_quadrics explains.
fn intersect_quadric(quadric: Quadric, origin: vec3f, direction: vec3f, t_min: f32) -> f32 {
    let start = dot(quadric.center - origin, direction);
    let nearest = origin + start * direction;
    let offset = nearest - quadric.center;
    let half_chord_squared = quadric.radius * quadric.radius - dot(offset, offset);
    if half_chord_squared < 0.0 {
        return -1.0;
    }
    // A surface that touches its trim sphere is kept: the sphere is a thousandth larger here.
    let half_chord = sqrt(half_chord_squared) + 0.001 * quadric.radius;
    let along = vec4f(direction, 0.0);
    let slope = quadric_times(quadric, vec4f(nearest, 1.0));
    let a = dot(along, quadric_times(quadric, along));
    let b = dot(along, slope);
    let c = dot(vec4f(nearest, 1.0), slope);
    let discriminant = b * b - a * c;
    if discriminant < 0.0 {
        return -1.0;
    }
    // The roots, without cancellation: the one of larger magnitude first, the other from the product of both.
    let root = sqrt(discriminant);
    let k = select(root - b, -(b + root), b >= 0.0);
    var hit = 1.0e30;
    if a != 0.0 && abs(k) <= half_chord * abs(a) && start + k / a >= t_min {
        hit = start + k / a;
    }
    if k != 0.0 && abs(c) <= half_chord * abs(k) && start + c / k >= t_min {
        hit = min(hit, start + c / k);
    }
    return select(hit, -1.0, hit >= 1.0e30);
}

// The unit normal at a point of a quadric, on the side that the ray comes from.
fn quadric_normal(quadric: Quadric, p: vec3f, direction: vec3f) -> vec3f {
    let normal = normalize(quadric_times(quadric, vec4f(p, 1.0)).xyz);
    return select(normal, -normal, dot(normal, direction) > 0.0);
}
