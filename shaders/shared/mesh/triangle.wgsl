// A triangle in its own frame, and the squared distance from a point to it. Twin of src/bvh/pack.rs.

struct Triangle {
    // Origin and axes: `u` along the longest edge, `n` the unit normal, v = n x u.
    a: vec3f,
    face: u32,
    u: vec3f,
    // Length of the edge along `u`, lengths of the edges from its two ends to the apex, and their unit directions.
    length: f32,
    v: vec3f,
    left_length: f32,
    n: vec3f,
    right_length: f32,
    left: vec2f,
    right: vec2f,
}

// Squared distance of `p`: the squared height over the plane plus the squared 2D distance within the plane.
fn triangle_distance_squared(triangle: Triangle, p: vec3f) -> f32 {
    let d = p - triangle.a;
    let x = dot(d, triangle.u);
    let y = dot(d, triangle.v);
    let height = dot(d, triangle.n);

    // The edge along `u`.
    let base_x = x - clamp(x, 0.0, triangle.length);
    let base = base_x * base_x + y * y;
    // The edge from the origin to the apex: position along it, and offset to its left.
    let along_left = dot(vec2f(x, y), triangle.left);
    let beside = triangle.left.x * y - triangle.left.y * x;
    let past_left = along_left - clamp(along_left, 0.0, triangle.left_length);
    let left = past_left * past_left + beside * beside;
    // The edge from the far end to the apex.
    let end_x = x - triangle.length;
    let along_right = dot(vec2f(end_x, y), triangle.right);
    let aside = triangle.right.x * y - triangle.right.y * end_x;
    let past_right = along_right - clamp(along_right, 0.0, triangle.right_length);
    let right = past_right * past_right + aside * aside;

    let inside = y >= 0.0 && beside <= 0.0 && aside >= 0.0;
    return height * height + select(min(base, min(left, right)), 0.0, inside);
}
