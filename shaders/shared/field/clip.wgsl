// A ray clipped to a box in the grid space of a field, where voxel centres are at whole numbers.

const NO_AXIS: u32 = 3u;
// Slightly above the smallest normal float32.
const TINY: f32 = 1.2e-38;

struct ClippedRay {
    origin: vec3f,
    // False where the ray misses the box.
    is_in_box: bool,
    // Unit length; grid space, so lengths along the ray are in voxels.
    direction: vec3f,
    t_max: f32,
    // Distance from the given origin to the box, in multiples of the given direction.
    t_enter: f32,
    // Axis of the face through which the ray enters; NO_AXIS if it starts inside.
    enter_axis: u32,
}
