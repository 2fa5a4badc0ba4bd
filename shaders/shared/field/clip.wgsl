// Clips rays to a box in the grid space of a field, where voxel centres are at whole numbers. Twin of `clip_to_box` in
// src/march/marcher.rs.

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

// The part of a ray between two corners of a box, in grid space.
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
