// The rays of a picture, one per pixel. They start on a plane just before the visible objects. The CPU moves the eye
// there in float64, so float32 is precise enough for a camera at any distance. Twin of src/picture/camera.rs.

struct PictureRays {
    // Start of the ray through the centre of the picture. One unit to the right or up on the plane at depth 1 adds
    // `start_right` or `start_up`.
    start: vec3f,
    width: u32,
    start_right: vec3f,
    height: u32,
    start_up: vec3f,
    // The first row of this dispatch.
    first_row: u32,
    // Direction of the ray through the centre of the picture, one unit of depth long. One unit to the right or up on
    // the plane at depth 1 adds `right` or `up`. Both are zero if the rays are parallel; then only the starts differ.
    forward: vec3f,
    // Side of a pixel: on the plane at depth 1, or at any depth if the rays are parallel.
    pixel: f32,
    right: vec3f,
    light_count: u32,
    up: vec3f,
    // 1 for hard shadows, 0 for none.
    shadows: u32,
}

// Start and direction of the ray through the centre of a pixel. The direction is one unit of depth long.
struct PictureRay {
    start: vec3f,
    along: vec3f,
}

fn picture_ray(rays: PictureRays, x: u32, y: u32) -> PictureRay {
    let along_right = (f32(x) + 0.5 - 0.5 * f32(rays.width)) * rays.pixel;
    let along_up = (0.5 * f32(rays.height) - 0.5 - f32(y)) * rays.pixel;
    return PictureRay(
        rays.start + along_right * rays.start_right + along_up * rays.start_up,
        rays.forward + along_right * rays.right + along_up * rays.up,
    );
}
