// Traces rays through the bricks of a sparse field to the first point where the field is <= 0. A ray leaps over empty
// bricks and visits the cells of the others one by one. Twin of src/march/marcher.rs.
//
// The importing kernel must define `empty_bytes(i)`, `steps`, MAX_STEPS, FAR_T and PARALLEL, and import `cubic`.
// `empty_bytes` has one byte per brick, four to a word: the radius, in bricks, of the surrounding cube that contains no
// surface; 0 if the brick has one. `steps` counts the steps of the invocation up to MAX_STEPS.

#import bricks

// The first t in [0, t_max] where the field is <= 0, or -1. The direction must have unit length in grid space.
fn march_bricks(bricks: Bricks, start: vec3f, direction: vec3f, t_max: f32) -> f32 {
    let last_cell = vec3i(bricks.shape) - 1;
    let is_forward = direction > vec3f(0.0);
    let side = vec3i(is_forward);
    let is_parallel = abs(direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(direction, vec3f(1.0), is_parallel);

    var t = 0.0;
    var cell = clamp(vec3i(floor(start)), vec3i(-1), last_cell);
    // The index of a cell never moves back along the ray.
    while steps < MAX_STEPS {
        steps++;
        let brick = brick_of(cell);
        let offset = brick_offset(bricks, brick);
        let byte = bricks.first_empty + offset;
        let distance = i32((empty_bytes(byte >> 2u) >> (8u * (byte & 3u))) & 0xffu);
        if distance > 0 {
            // Leaps to the face of the empty cube around the brick.
            let first = BRICK_CELLS * (vec3i(brick) - (distance - 1)) - 1;
            let face = first + side * (2 * distance - 1) * BRICK_CELLS;
            let to_faces = select((vec3f(face) - start) * inverse, vec3f(FAR_T), is_parallel);
            let axis = first_axis(to_faces);
            t = max(to_faces[axis], t);
            if t >= t_max { return -1.0; }
            // The new cell is exact along the axis of the face, and never moves back along the others.
            let here = vec3i(floor(start + t * direction));
            // GLSL ES 3.00 selects no integers.
            cell = side * max(here, cell) + (1 - side) * min(here, cell);
            cell[axis] = face[axis] - 1 + side[axis];
            cell = clamp(cell, vec3i(-1), last_cell);
            continue;
        }

        let word = brick_word(bricks.first_word + offset);
        let shift = cell_shift(word);
        let origin = brick_origin(brick, shift);
        let local = (cell - origin) >> vec3u(shift);
        let low = origin + (local << vec3u(shift));
        let face = low + (side << vec3u(shift));
        let to_faces = select((vec3f(face) - start) * inverse, vec3f(FAR_T), is_parallel);
        let axis = first_axis(to_faces);
        let t_end = min(max(to_faces[axis], t), t_max);

        // A brick that has no samples and is not empty lies inside the solid.
        var corners = array<f32, 8>(-1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0, -1.0);
        if word >> LEVEL_SHIFT != NOTHING_STORED { corners = brick_corners(bricks, word, local); }
        let per_voxel = 1.0 / f32(1u << shift);
        let p = (start + t * direction - vec3f(low)) * per_voxel;
        let root = root_in_cell(corners, p, direction * per_voxel, t_end - t).x;
        if root >= 0.0 { return t + root; }
        if t_end >= t_max { return -1.0; }

        // Continues in the next cell.
        t = t_end;
        let cell_side = 1 << shift;
        let next = local[axis] + 2 * side[axis] - 1;
        if shift > 0u && (next < 0 || next >= BRICK_CELLS) {
            // A cell of several voxels is left at the position of the ray. Along the axis of the face the new cell is
            // exact.
            let here = vec3i(floor(start + t * direction));
            cell = clamp(here, low, low + cell_side - 1);
        }
        // The nearest voxel beyond the face.
        cell[axis] = face[axis] - 1 + side[axis];
        cell = clamp(cell, vec3i(-1), last_cell);
    }
    return -1.0;
}
