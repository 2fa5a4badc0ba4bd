// Where rays meet the fields of a view, and their distances: one function for each kind of field. Rays and positions are
// those of field space; distances are in the field's own units.

// ---- dense grids, twin of src/render/march.rs

fn empty_blocks(index: u32) -> i32 {
    return i32((empty_bytes(index >> 2u) >> (8u * (index & 3u))) & 0xffu);
}

// Whether a cell has a corner that is not above the level: a bit for each of the 4^3 cells of a block.
fn may_have_root(index: u32, cell: vec3i) -> bool {
    let local = vec3u(cell + 1) & vec3u(3u);
    let mask = word_at(mask_words + 2u * index + (local.z >> 1u));
    return ((mask >> (local.x + 4u * local.y + 16u * (local.z & 1u))) & 1u) == 1u;
}

// The first t in [0, t_max] where the field is not above the level, or -1; the direction is unit. The inner loop leaps over
// empty blocks of 4^3 cells and passes cells without a root; the outer loop solves the cubic in the others. So lanes of a
// software device that are in different places of their rays wait less for each other.
fn dense_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
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

// ---- quadrics, twin of src/scene/objects/quadric.rs: the columns of the form, in the frame of the trim sphere

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

// ---- shapes, twin of `march` in src/csg/trace.rs

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
    let cell = floor(p);
    return trilinear(cell_corners(vec3i(cell), shape), p - cell);
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
        var there = p;
        let sign = select(step, -step, (i & 1u) == 1u);
        there[i >> 1u] += sign;
        slope[i >> 1u] += field_value(there, clamp(there, lower, upper)) * sign;
    }
    return slope;
}
