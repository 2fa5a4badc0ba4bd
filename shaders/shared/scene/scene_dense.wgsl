// Dense grids of a scene, with blocks of 4^3 cells. Twin of `DenseField` in src/scene/fields/field.rs.

#import scene_field
#import cubic

fn sample_at(field: SceneField, x: u32, y: u32, z: u32) -> f32 {
    return samples[field.first_sample + x + field.shape.x * (y + field.shape.y * z)];
}

fn corners_of(field: SceneField, cell: vec3i) -> array<f32, 8> {
    let last = vec3i(field.shape) - 1;
    let a = vec3u(clamp(cell, vec3i(0), last));
    let b = vec3u(clamp(cell + 1, vec3i(0), last));
    return array<f32, 8>(
        sample_at(field, a.x, a.y, a.z), sample_at(field, b.x, a.y, a.z),
        sample_at(field, a.x, b.y, a.z), sample_at(field, b.x, b.y, a.z),
        sample_at(field, a.x, a.y, b.z), sample_at(field, b.x, a.y, b.z),
        sample_at(field, a.x, b.y, b.z), sample_at(field, b.x, b.y, b.z),
    );
}

// The field at a point inside the grid; `p` is in grid space.
fn dense_sample(field: SceneField, p: vec3f) -> f32 {
    let cell = floor(p);
    return trilinear(corners_of(field, vec3i(cell)), p - cell);
}

fn bilinear(a: f32, b: f32, c: f32, d: f32, f: vec2f) -> f32 {
    return lerp(lerp(a, b, f.x), lerp(c, d, f.x), f.y);
}

// Differences of the field over one voxel along each axis, centred at a point. The one along an axis depends on three
// layers of samples: two of the cell, and one beside it. Together they are 20 samples, and six evaluations have 48.
fn dense_slope(field: SceneField, p: vec3f) -> vec3f {
    let cell = floor(p);
    let f = p - cell;
    let c = corners_of(field, vec3i(cell));
    let low = vec3f(
        bilinear(c[0], c[2], c[4], c[6], f.yz),
        bilinear(c[0], c[1], c[4], c[5], f.xz),
        bilinear(c[0], c[1], c[2], c[3], f.xy),
    );
    let high = vec3f(
        bilinear(c[1], c[3], c[5], c[7], f.yz),
        bilinear(c[2], c[3], c[6], c[7], f.xz),
        bilinear(c[4], c[5], c[6], c[7], f.xy),
    );
    let last = vec3i(field.shape) - 1;
    let is_low = f < vec3f(0.5);
    let a = vec3u(clamp(vec3i(cell), vec3i(0), last));
    let b = vec3u(clamp(vec3i(cell) + 1, vec3i(0), last));
    let e = vec3u(clamp(vec3i(cell) + select(vec3i(2), vec3i(-1), is_low), vec3i(0), last));
    let beside = vec3f(
        bilinear(
            sample_at(field, e.x, a.y, a.z), sample_at(field, e.x, b.y, a.z),
            sample_at(field, e.x, a.y, b.z), sample_at(field, e.x, b.y, b.z), f.yz,
        ),
        bilinear(
            sample_at(field, a.x, e.y, a.z), sample_at(field, b.x, e.y, a.z),
            sample_at(field, a.x, e.y, b.z), sample_at(field, b.x, e.y, b.z), f.xz,
        ),
        bilinear(
            sample_at(field, a.x, a.y, e.z), sample_at(field, b.x, a.y, e.z),
            sample_at(field, a.x, b.y, e.z), sample_at(field, b.x, b.y, e.z), f.xy,
        ),
    );
    let before = select(high - low, low - beside, is_low);
    let behind = select(beside - high, high - low, is_low);
    return before + (behind - before) * (f + select(vec3f(-0.5), vec3f(0.5), is_low));
}

fn empty_blocks(field: SceneField, block: vec3i) -> i32 {
    let index = field.first_block + u32(block.x) + field.blocks.x * (u32(block.y) + field.blocks.y * u32(block.z));
    return i32((blocks[index / 4u] >> (8u * (index % 4u))) & 0xffu);
}

// The first t in [0, t_max] where the field is <= 0, or -1. The ray leaps over empty blocks and intersects the cubic
// in each other cell. Cells are outside of the loop over leaps, because software drivers execute all branches in each
// round of a loop.
fn dense_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let per_t = length(along);
    let direction = along / per_t;
    let end = t_max * per_t;
    let last_cell = vec3i(field.shape) - 1;
    let forward = direction > vec3f(0.0);
    let side = select(vec3i(0), vec3i(1), forward);
    let is_parallel = abs(direction) < vec3f(PARALLEL);
    let inverse = 1.0 / select(direction, vec3f(1.0), is_parallel);
    var t = 0.0;
    var cell = clamp(vec3i(floor(origin)), vec3i(-1), last_cell);
    while steps < MAX_STEPS {
        // Leaps over empty blocks, to the next cell in another block.
        var face: vec3i;
        var axis: u32;
        var t_end: f32;
        var is_empty = true;
        while steps < MAX_STEPS {
            steps++;
            let block = (cell + 1) >> vec3u(2u);
            let empty = empty_blocks(field, block);
            is_empty = empty > 0;
            // The exit faces of the empty cube, or of the cell.
            let first = (block - (empty - 1)) * 4 - 1;
            face = select(cell + side, first + side * ((2 * empty - 1) * 4), is_empty);
            let to_faces = select((vec3f(face) - origin) * inverse, vec3f(FAR_T), is_parallel);
            axis = first_axis(to_faces);
            t_end = min(max(to_faces[axis], t), end);
            if !is_empty || t_end >= end { break; }
            t = t_end;
            // The new cell is exact along the axis of the face, and never moves back along the others.
            let here = vec3i(floor(origin + t * direction));
            cell = select(min(here, cell), max(here, cell), forward);
            cell[axis] = face[axis] - 1 + side[axis];
            cell = clamp(cell, vec3i(-1), last_cell);
        }
        if is_empty { break; }
        let root = root_in_cell(corners_of(field, cell), origin + t * direction - vec3f(cell), direction, t_end - t).x;
        if root >= 0.0 { return (t + root) / per_t; }
        if t_end >= end { break; }
        t = t_end;
        cell[axis] = face[axis] - 1 + side[axis];
        cell = clamp(cell, vec3i(-1), last_cell);
    }
    return -1.0;
}
