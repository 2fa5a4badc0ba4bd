// Corners of triangles in scene space and in clip space.

// The row of the table for the instance that is drawn.
struct Own {
    texels: array<vec4f, 24>,
}

@group(0) @binding(5) var<uniform> own: Own;

// A point of scene space from its place in field space.
fn corner_point(place: vec3f) -> vec3f {
    let p = vec4f(place, 1.0);
    return vec3f(dot(own.texels[9], p), dot(own.texels[10], p), dot(own.texels[11], p));
}

// The unit normal in scene space from a vector along the gradient in field space. The normal of a mesh points to the
// eye, because a mesh may be open or wound inside out.
fn corner_normal(slope: vec3f, to_eye: vec3f) -> vec3f {
    let along = slope.x * own.texels[6].xyz + slope.y * own.texels[7].xyz + slope.z * own.texels[8].xyz;
    let normal = along / max(length(along), SHORTEST);
    return select(normal, -normal, own.texels[23].y == 1.0 && dot(normal, to_eye) < 0.0);
}

fn corner_clip(p: vec3f) -> vec4f {
    let p_scene = vec4f(p, 1.0);
    let w = dot(view.clip_w, p_scene);
    return vec4f(dot(view.clip_x, p_scene), dot(view.clip_y, p_scene), view.clip_z.x * w + view.clip_z.y, w);
}
