// Rays through the grid to the first point where the field is not above zero. Twin of src/render/march.rs, which says
// why no epsilon decides a hit; it leaps over blocks of empty cells where this visits each.

#import sampling

// An axis on which the direction is smaller than this counts as parallel.
const PARALLEL: f32 = 1e-20;
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
    var clipped: ClippedRay;
    clipped.enter_axis = NO_AXIS;
    var t_leave = FAR_T;
    for (var axis = 0u; axis < 3u; axis++) {
        let lower = -0.5;
        let upper = f32(shape[axis]) - 0.5;
        if direction[axis] == 0.0 {
            if origin[axis] < lower || origin[axis] > upper { return clipped; }
            continue;
        }
        let to_lower = (lower - origin[axis]) / direction[axis];
        let to_upper = (upper - origin[axis]) / direction[axis];
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

// Walk along a ray to its first hit.
fn march(ray: ClippedRay, shape: vec3u) -> Hit {
    var hit: Hit;
    let last_cell = vec3i(shape) - 1;
    let side = select(vec3i(0), vec3i(1), ray.direction > vec3f(0.0));
    let is_parallel = abs(ray.direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(ray.direction, vec3f(1.0), is_parallel);

    var t = 0.0;
    var cell = clamp(vec3i(floor(ray.origin)), vec3i(-1), last_cell);
    // A cell index never moves back.
    let max_steps = shape.x + shape.y + shape.z + 4u;
    for (var step = 1u; step <= max_steps; step++) {
        hit.steps = step;
        let to_faces = select((vec3f(cell + side) - ray.origin) * inverse, vec3f(FAR_T), is_parallel);
        let to_next = min(to_faces.x, min(to_faces.y, to_faces.z));
        let t_end = min(max(to_next, t), ray.t_max);

        let corners = cell_corners(cell, shape);
        let low = vec4f(corners[0], corners[1], corners[2], corners[3]);
        let high = vec4f(corners[4], corners[5], corners[6], corners[7]);
        let smallest = min(low, high);
        if min(min(smallest.x, smallest.y), min(smallest.z, smallest.w)) <= 0.0 {
            let p = ray.origin + t * ray.direction - vec3f(cell);
            let cubic = cubic_along_ray(corners, p, ray.direction);
            // In units of the largest corner: products of coefficients stay in range at any scale.
            let sizes = max(abs(low), abs(high));
            let largest = max(max(max(sizes.x, sizes.y), max(sizes.z, sizes.w)), TINY);
            let s = first_root(cubic / largest, t_end - t);
            if s >= 0.0 {
                hit.is_hit = true;
                hit.t = t + s;
                hit.at_start = hit.t == 0.0 && cubic.x <= 0.0;
                return hit;
            }
        }
        if t_end >= ray.t_max { return hit; }

        // Into the next cell, exact on the axis of the face.
        t = t_end;
        let beyond = cell + 2 * side - 1;
        if to_faces.x == to_next {
            cell.x = beyond.x;
        } else if to_faces.y == to_next {
            cell.y = beyond.y;
        } else {
            cell.z = beyond.z;
        }
        cell = clamp(cell, vec3i(-1), last_cell);
    }
    return hit;
}
