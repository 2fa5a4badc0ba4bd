// Instances in the view of the camera. Twin of src/scene/device/device_raster.rs.

struct RasterInstance {
    // Rows of the map from the instance's own space to clip space. The third is w, the depth in scene units; if the
    // rays are parallel it is z.
    clip_x: vec4f,
    clip_y: vec4f,
    clip_depth: vec4f,
    // Start of the ray through pixel (0, 0) in the instance's own space.
    start: vec3f,
    // Index of the instance in the scene's list.
    index: u32,
    // Direction of the ray through pixel (0, 0), one scene unit of depth long. Its change per pixel along x and y
    // follows, or the change of the start if the rays are parallel.
    ray: vec3f,
    first_face: u32,
    ray_x: vec3f,
    first_material: u32,
    ray_y: vec3f,
    is_mirrored: u32,
    // Pixel position where the ray is the viewing axis, and side of a pixel at a depth of one scene unit.
    middle: vec2f,
    pixel: f32,
    // 1: parallel rays. 0: all rays start at the eye.
    is_parallel: u32,
}

@group(0) @binding(0) var<storage, read> rows: array<RasterInstance>;

// Depth of rays from the eye that maps to 1 in the depth buffer. Larger depths approach 0, with the same relative
// precision everywhere. Depths of parallel rays map linearly, from 1 before the scene to 0 behind it.
const NEAR: f32 = 1e-6;

fn clip_position(row: u32, p: vec3f) -> vec4f {
    let at = vec4f(p, 1.0);
    let depth = dot(rows[row].clip_depth, at);
    let zw = select(vec2f(NEAR, depth), vec2f(depth, 1.0), rows[row].is_parallel != 0u);
    return vec4f(dot(rows[row].clip_x, at), dot(rows[row].clip_y, at), zw);
}

// The ray through the centre of a fragment in the instance's own space. The direction is one scene unit of depth long.
struct FragmentRay {
    start: vec3f,
    along: vec3f,
}

fn ray_through(row: u32, fragment: vec2f) -> FragmentRay {
    let to_start = f32(rows[row].is_parallel);
    let aside = fragment.x * rows[row].ray_x + fragment.y * rows[row].ray_y;
    return FragmentRay(rows[row].start + to_start * aside, rows[row].ray + (1.0 - to_start) * aside);
}
