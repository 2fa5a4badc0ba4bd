// Instances in the view of the camera. Twin of src/scene/raster.rs.

struct RasterInstance {
    // Rows of the map from the instance's own space to clip space. w is the depth in scene units.
    clip_x: vec4f,
    clip_y: vec4f,
    clip_w: vec4f,
    // The eye in the instance's own space.
    eye: vec3f,
    // Index of the instance in the scene's list.
    index: u32,
    // The ray through pixel (0, 0), one scene unit of depth long, and its change per pixel along x and y.
    ray: vec3f,
    first_face: u32,
    ray_x: vec3f,
    first_material: u32,
    ray_y: vec3f,
    is_mirrored: u32,
    // Pixel position where the ray is the viewing axis, and side of a pixel at a depth of one scene unit.
    middle: vec2f,
    pixel: f32,
    pad_0: u32,
}

@group(0) @binding(0) var<storage, read> rows: array<RasterInstance>;

// Depth that maps to 1 in the depth buffer. Larger depths approach 0, with the same relative precision everywhere.
const NEAR: f32 = 1e-6;

fn clip_position(row: u32, p: vec3f) -> vec4f {
    let at = vec4f(p, 1.0);
    let w = dot(rows[row].clip_w, at);
    return vec4f(dot(rows[row].clip_x, at), dot(rows[row].clip_y, at), NEAR, w);
}

// The ray through the centre of a fragment, one scene unit of depth long.
fn ray_through(row: u32, fragment: vec2f) -> vec3f {
    return rows[row].ray + fragment.x * rows[row].ray_x + fragment.y * rows[row].ray_y;
}
