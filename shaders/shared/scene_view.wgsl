// Instances as a camera sees them. Twin of src/scene/raster.rs.

struct RasterInstance {
    // Rows of the map from the instance's own space to clip space; w is the depth in scene units.
    clip_x: vec4f,
    clip_y: vec4f,
    clip_w: vec4f,
    // The eye in that space.
    eye: vec3f,
    // In the scene's list.
    index: u32,
    // The ray of the pixel at (0, 0), one scene unit deep, and its change from pixel to pixel.
    ray: vec3f,
    first_face: u32,
    ray_x: vec3f,
    first_material: u32,
    ray_y: vec3f,
    is_mirrored: u32,
    // Where the ray goes straight along the viewing axis, and a pixel's side one unit deep.
    middle: vec2f,
    pixel: f32,
    pad_0: u32,
}

@group(0) @binding(0) var<storage, read> rows: array<RasterInstance>;

// Depth that the depth buffer shows as 1; further away it falls to 0, with the same relative precision everywhere.
const NEAR: f32 = 1e-6;

fn clip_position(row: u32, p: vec3f) -> vec4f {
    let at = vec4f(p, 1.0);
    let w = dot(rows[row].clip_w, at);
    return vec4f(dot(rows[row].clip_x, at), dot(rows[row].clip_y, at), NEAR, w);
}

// The way through the centre of a fragment, one scene unit deep.
fn ray_through(row: u32, fragment: vec2f) -> vec3f {
    return rows[row].ray + fragment.x * rows[row].ray_x + fragment.y * rows[row].ray_y;
}
