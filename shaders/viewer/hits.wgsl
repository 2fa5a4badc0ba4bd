// Where rays meet the fields of a view, and their distances: one function for each kind of field. Rays and positions
// are in field space; distances are in the field's own units.

// The part of a ray between two corners of a box. Twin of `clip_to_box` in src/march/marcher.rs, without a loop over
// the axes, because software devices are slow at indices that vary.
fn clip_to_field(origin: vec3f, direction: vec3f, lower: vec3f, upper: vec3f) -> ClippedRay {
    var clipped: ClippedRay;
    clipped.enter_axis = NO_AXIS;
    let is_parallel = direction == vec3f(0.0);
    if any(is_parallel & ((origin < lower) | (origin > upper))) { return clipped; }
    let divisor = select(direction, vec3f(1.0), is_parallel);
    let to_lower = (lower - origin) / divisor;
    let to_upper = (upper - origin) / divisor;
    let enter = select(min(to_lower, to_upper), vec3f(-FAR_T), is_parallel);
    let leave = select(max(to_lower, to_upper), vec3f(FAR_T), is_parallel);
    let last = max(enter.x, max(enter.y, enter.z));
    if last > 0.0 {
        clipped.t_enter = last;
        clipped.enter_axis = select(select(2u, 1u, enter.y == last), 0u, enter.x == last);
    }
    let t_leave = min(leave.x, min(leave.y, leave.z));
    let voxels_per_t = length(direction);
    clipped.is_in_box = t_leave >= clipped.t_enter && voxels_per_t > 0.0;
    clipped.origin = origin + clipped.t_enter * direction;
    clipped.direction = direction / max(voxels_per_t, TINY);
    clipped.t_max = (t_leave - clipped.t_enter) * voxels_per_t;
    return clipped;
}

// ---- dense grids in motion

// A step along a ray in motion has at least this length, and the surface is found at this distance, texels.
const LEAST_STEP: f32 = 0.25;
const NEAR_SURFACE: f32 = 0.02;
// Steps of a ray in motion at most.
const MAX_MOTION_STEPS: u32 = 512u;

// The dense field by the filter of the device, less the level. The grid of the texture may be coarser than the field's.
fn filtered_value(p: vec3f) -> f32 {
    let last = (vec3f(shape) - 1.0) * filter_place.y;
    var texel = clamp(p * filter_place.y, vec3f(0.0), last) + 0.5;
    texel.z += filter_place.x;
    return textureSampleLevel(filtered, linear_filter, texel * view.filtered.xyz, 0.0).x * filter_place.z - level;
}

// Sphere tracing with steps for neighbouring samples that differ by at most 1 / filter_place.w. A step that passes
// through the surface returns to the zero of the line between its ends.
fn filtered_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    let least = LEAST_STEP / filter_place.y;
    let near = NEAR_SURFACE / filter_place.y;
    var t = 0.0;
    var t_before = 0.0;
    var before = 1.0;
    for (var i = 0u; i < MAX_MOTION_STEPS && t <= t_max; i++) {
        let value = filtered_value(origin + t * direction) * filter_place.w;
        if value <= near {
            if value < 0.0 && i > 0u { return mix(t_before, t, before / (before - value)); }
            return t;
        }
        t_before = t;
        before = value;
        t += max(value, least);
    }
    return -1.0;
}

// ---- dense grids, twin of src/march/marcher.rs

fn empty_blocks(index: u32) -> i32 {
    return i32((empty_bytes(index >> 2u) >> (8u * (index & 3u))) & 0xffu);
}

// Whether a cell has a corner that is not above the level: a bit for each of the 4^3 cells of a block.
fn may_have_root(index: u32, cell: vec3i) -> bool {
    let local = vec3u(cell + 1) & vec3u(3u);
    let mask = word_at(mask_words + 2u * index + (local.z >> 1u));
    return ((mask >> (local.x + 4u * local.y + 16u * (local.z & 1u))) & 1u) == 1u;
}

// The first t in [0, t_max] where the field is not above the level, or -1; the direction is unit. The inner loop leaps
// over empty blocks of 4^3 cells and passes cells without a root; the outer loop solves the cubic in the others. So
// lanes of a software device that are in different places of their rays wait less for each other.
fn dense_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    if IS_MOTION { return filtered_hit(origin, direction, t_max); }
    let last_cell = vec3i(shape) - 1;
    let side = vec3i(direction > vec3f(0.0));
    let is_parallel = abs(direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(direction, vec3f(1.0), is_parallel);
    var t = 0.0;
    var t_end = 0.0;
    var cell = clamp(vec3i(floor(origin)), vec3i(-1), last_cell);
    var next = cell;
    while t_end < t_max && steps < MAX_STEPS {
        var is_found = false;
        while !is_found && t_end < t_max && steps < MAX_STEPS {
            steps++;
            cell = next;
            t = t_end;
            let block = (cell + 1) >> vec3u(2u);
            let index = u32(block.x) + blocks.x * (u32(block.y) + blocks.y * u32(block.z));
            let empty = empty_blocks(index);
            // The far faces of the empty cube, or of the cell.
            let first = (block - (empty - 1)) * 4 - 1;
            let face = select(vec3f(cell + side), vec3f(first + side * ((2 * empty - 1) * 4)), empty > 0);
            let to_faces = select((face - origin) * inverse, vec3f(FAR_T), is_parallel);
            let axis = first_axis(to_faces);
            t_end = min(max(to_faces[axis], t), t_max);
            if empty == 0 { is_found = may_have_root(index, cell); }
            // Into the next cell: exact on the axis of the face, never back on the others.
            let here = vec3i(floor(origin + t_end * direction));
            if empty > 0 { next = side * max(here, cell) + (1 - side) * min(here, cell); }
            next[axis] = i32(face[axis]) - 1 + side[axis];
            next = clamp(next, vec3i(-1), last_cell);
        }
        if is_found {
            let p = origin + t * direction - vec3f(cell);
            let root = root_in_cell(cell_corners(cell, shape), p, direction, t_end - t).x;
            if root >= 0.0 { return t + root; }
        }
    }
    return -1.0;
}

// ---- quadrics, twin of src/scene/fields/quadric.rs: the columns of the form, in the frame of the trim sphere

fn quadric_column(column: u32) -> vec4f {
    let at = 4u * column;
    return vec4f(number_at(at), number_at(at + 1u), number_at(at + 2u), number_at(at + 3u));
}

fn quadric_form() -> QuadricForm {
    let last = quadric_column(3u);
    return QuadricForm(mat3x3f(quadric_column(0u).xyz, quadric_column(1u).xyz, quadric_column(2u).xyz), last.xyz, last.w);
}

fn quadric_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    let found = quadric_crossings(quadric_form(), origin, direction);
    let is_ahead = (found >= vec2f(0.0)) & (found <= vec2f(t_max));
    let ahead = select(vec2f(NO_CROSSING), found, is_ahead);
    let first = min(ahead.x, ahead.y);
    return select(-1.0, first, first < NO_CROSSING);
}

// ---- shapes, twin of `march` in src/csg/parts/trace.rs

fn shape_value(p: vec3f) -> f32 {
    steps++;
    return structure_distance(structure, p) - level;
}

fn shape_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    var search = search_from(0.0);
    var state = SEARCHING;
    for (var i = 0u; i < MAX_MARCH_STEPS && state == SEARCHING && steps < MAX_STEPS; i++) {
        state = search_on(&search, shape_value(origin + search.t * direction), inverse_lipschitz, t_max);
    }
    return select(-1.0, search.t, state == FOUND && (search.t < t_max || search.t == 0.0));
}

// Half the step of the differences of a shape's field, local units.
const NORMAL_STEP: f32 = 1e-4;

fn quadric_value(p: vec3f) -> f32 {
    let form = quadric_form();
    return abs(dot(p, form.m * p) + 2.0 * dot(form.v, p) + form.w);
}

// Towards the eye.
fn quadric_slope(p: vec3f, to_eye: vec3f) -> vec3f {
    let form = quadric_form();
    let slope = form.m * p + form.v;
    return select(slope, -slope, dot(slope, to_eye) < 0.0);
}

fn dense_value(p: vec3f) -> f32 {
    if IS_MOTION { return filtered_value(p); }
    let cell = floor(p);
    return trilinear(cell_corners(vec3i(cell), shape), p - cell);
}

// Index of the sample of a stored brick that is nearest to a voxel.
fn brick_sample(voxel: vec3i) -> u32 {
    let brick = brick_of(voxel);
    let word = brick_word(brick_offset(bricks, brick));
    let shift = cell_shift(word);
    let local = vec3u((voxel - brick_origin(brick, shift)) >> vec3u(shift));
    return (word & BRICK_MASK) * BRICK_LEN + local.x + BRICK_SAMPLES * (local.y + BRICK_SAMPLES * local.z);
}

// ---- any field. The text of a view has the lines for its own kinds only.

// The first t in [0, t_max] where a ray is in the field's solid, or -1.
fn field_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    if HAS_SPARSE && kind == KIND_SPARSE { return march_bricks(bricks, origin, direction, t_max); }
    if HAS_SHAPE && kind == KIND_SHAPE { return shape_hit(origin, direction, t_max); }
    if HAS_QUADRIC && kind == KIND_QUADRIC { return quadric_hit(origin, direction, t_max); }
    if HAS_DENSE { return dense_hit(origin, direction, t_max); }
    return -1.0;
}

// The field at a point, less the level; of a sampled field that at the nearest point of its box.
fn field_value(p: vec3f, inside: vec3f) -> f32 {
    if HAS_SPARSE && kind == KIND_SPARSE { return sample_bricks(bricks, inside); }
    if HAS_SHAPE && kind == KIND_SHAPE { return shape_value(p); }
    if HAS_QUADRIC && kind == KIND_QUADRIC { return quadric_value(p); }
    if HAS_DENSE { return dense_value(inside); }
    return 1.0;
}

// A vector along the gradient: of a sampled field averaged over a voxel, of a quadric towards `to_eye`.
fn field_slope(p: vec3f, to_eye: vec3f, lower: vec3f, upper: vec3f) -> vec3f {
    if HAS_QUADRIC && kind == KIND_QUADRIC { return quadric_slope(p, to_eye); }
    let step = select(0.5, NORMAL_STEP, kind == KIND_SHAPE);
    var slope = vec3f(0.0);
    for (var i = 0u; i < 6u; i++) {
        let sign = select(step, -step, (i & 1u) == 1u);
        let axis = select(vec3f(0.0), vec3f(1.0), vec3u(i >> 1u) == vec3u(0u, 1u, 2u));
        let there = p + sign * axis;
        slope += field_value(there, clamp(there, lower, upper)) * sign * axis;
    }
    return slope;
}

// The error of the stored sample that is nearest to a point, as a share of the view's largest error.
fn error_share(instance: u32, p: vec3f) -> f32 {
    if error_words == 0u { return 0.0; }
    let at = clamp(vec3i(round(p)), vec3i(0), vec3i(shape) - 1);
    var index = u32(at.x) + shape.x * (u32(at.y) + shape.y * u32(at.z));
    if HAS_SPARSE && kind == KIND_SPARSE { index = brick_sample(at); }
    let byte = (word_at(error_words + (index >> 2u)) >> (8u * (index & 3u))) & 0xffu;
    return f32(byte) / 255.0 * frame_at(instance, 23u).x;
}
