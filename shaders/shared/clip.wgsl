// Rays and the box of a grid, in grid space: voxel centres at whole numbers. Twin of `clip_to_box` in src/render/march.rs.

// Beyond every t; stands for infinity.
const FAR_T: f32 = 1e30;
const NO_AXIS: u32 = 3u;
// At least the smallest normal number.
const TINY: f32 = 1.2e-38;

struct ClippedRay {
    origin: vec3f,
    // False where the ray misses the box.
    is_in_box: bool,
    // Unit length, in voxels.
    direction: vec3f,
    t_max: f32,
    // Length of the part before the box, in multiples of the direction that was given.
    t_enter: f32,
    // Axis of the face through which the ray enters; NO_AXIS if it starts inside.
    enter_axis: u32,
}

struct Hit {
    t: f32,
    is_hit: bool,
    // The ray began at a value that was not above zero.
    at_start: bool,
    steps: u32,
}

// The part of a ray that lies in the box of `shape` voxels, in grid space: voxel centres at integers.
fn clip_to_box(origin: vec3f, direction: vec3f, shape: vec3u) -> ClippedRay {
    return clip_between(origin, direction, vec3f(-0.5), vec3f(shape) - 0.5);
}

// The part of a ray that lies between two corners, in grid space.
fn clip_between(origin: vec3f, direction: vec3f, lower: vec3f, upper: vec3f) -> ClippedRay {
    var clipped: ClippedRay;
    clipped.enter_axis = NO_AXIS;
    var t_leave = FAR_T;
    for (var axis = 0u; axis < 3u; axis++) {
        if direction[axis] == 0.0 {
            if origin[axis] < lower[axis] || origin[axis] > upper[axis] { return clipped; }
            continue;
        }
        let to_lower = (lower[axis] - origin[axis]) / direction[axis];
        let to_upper = (upper[axis] - origin[axis]) / direction[axis];
        if min(to_lower, to_upper) > clipped.t_enter {
            clipped.t_enter = min(to_lower, to_upper);
            clipped.enter_axis = axis;
        }
        t_leave = min(t_leave, max(to_lower, to_upper));
    }
    let voxels_per_t = length(direction);
    clipped.is_in_box = t_leave >= clipped.t_enter && voxels_per_t > 0.0;
    clipped.origin = origin + clipped.t_enter * direction;
    clipped.direction = direction / max(voxels_per_t, TINY);
    clipped.t_max = (t_leave - clipped.t_enter) * voxels_per_t;
    return clipped;
}
