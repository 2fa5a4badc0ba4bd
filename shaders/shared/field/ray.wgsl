// Traces rays through the grid to the first point where the field is <= 0. Twin of src/march/marcher.rs, which explains
// why no epsilon decides a hit. The CPU leaps over blocks of empty cells; this shader visits each cell.

#import clip
#import sampling

// Traces a ray to its first hit.
fn march(ray: ClippedRay, shape: vec3u) -> Hit {
    var hit: Hit;
    let last_cell = vec3i(shape) - 1;
    let side = select(vec3i(0), vec3i(1), ray.direction > vec3f(0.0));
    let is_parallel = abs(ray.direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(ray.direction, vec3f(1.0), is_parallel);

    var t = 0.0;
    var cell = clamp(vec3i(floor(ray.origin)), vec3i(-1), last_cell);
    // The index of a cell never moves back along the ray.
    let max_steps = shape.x + shape.y + shape.z + 4u;
    for (var step = 1u; step <= max_steps; step++) {
        hit.steps = step;
        let to_faces = select((vec3f(cell + side) - ray.origin) * inverse, vec3f(FAR_T), is_parallel);
        let axis = first_axis(to_faces);
        let t_end = min(max(to_faces[axis], t), ray.t_max);

        let corners = cell_corners(cell, shape);
        let root = root_in_cell(corners, ray.origin + t * ray.direction - vec3f(cell), ray.direction, t_end - t);
        if root.x >= 0.0 {
            hit.is_hit = true;
            hit.t = t + root.x;
            hit.at_start = hit.t == 0.0 && root.y <= 0.0;
            return hit;
        }
        if t_end >= ray.t_max { return hit; }

        // Continues in the next cell, which is exact along the axis of the face.
        t = t_end;
        cell[axis] += 2 * side[axis] - 1;
        cell = clamp(cell, vec3i(-1), last_cell);
    }
    return hit;
}
