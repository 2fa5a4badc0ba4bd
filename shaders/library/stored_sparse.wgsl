// One word per brick. Bits 31-30: level 0 to 2, whose cells have 2^level voxels; bits 29-0: index of the stored brick.
// Level 3 marks an empty brick; bit 0 then tells inside (1) from outside (0).
@group(0) @binding(0) var sparse_index: texture_3d<u32>;
// Lower bounds of the distance at the corners of the bricks, in units of SPARSE_LONGEST_STEP.
@group(0) @binding(1) var sparse_nodes: texture_3d<f32>;

// A stored sample, world units.
fn sparse_sample(at: i32) -> f32 {
    return f32(textureLoad(sparse_bricks, vec2i(at % SPARSE_ROW, at / SPARSE_ROW), 0).x) * SPARSE_SCALE;
}

// Bilinear interpolation of the samples of a brick from sample `first` on.
fn sparse_slice(first: i32, fraction: vec2f) -> f32 {
    let low = mix(sparse_sample(first), sparse_sample(first + 1), fraction.x);
    let high = mix(sparse_sample(first + 8), sparse_sample(first + 9), fraction.x);
    return mix(low, high, fraction.y);
}

// A node, which bounds the distance outside the box; world units.
fn sparse_bound_sample(node: vec3i) -> f32 {
    return textureLoad(sparse_nodes, node, 0).x * SPARSE_LONGEST_STEP;
}

// The distance at p in world space: trilinear in the stored bricks, a lower bound with its sign in the empty ones, a
// lower bound outside the box.
fn sparse_distance(p: vec3f) -> f32 {
    let p_grid = (p - SPARSE_LOWER) / SPARSE_SPACING - 0.5;
    if any(p_grid < vec3f(-0.5)) || any(p_grid > vec3f(SPARSE_SHAPE) - 0.5) {
        return sparse_bound(p);
    }
    let cell = vec3i(floor(p_grid));
    let brick = min((cell + 1) / 7, SPARSE_COUNTS - 1);
    let word = textureLoad(sparse_index, brick, 0).x;
    let level = word >> 30u;
    if level == 3u {
        let bound = max(sqrt(sparse_bound_squared(p)), SPARSE_FLOOR);
        return select(bound, -bound, (word & 1u) == 1u);
    }
    let cells = i32(1u << level);
    let origin = 7 * (brick / cells * cells) - 1;
    let local = (cell - origin) / cells;
    let fraction = (p_grid - vec3f(origin + local * cells)) / f32(cells);
    let first = i32(word & 0x3fffffffu) * 512 + local.x + 8 * (local.y + 8 * local.z);
    return mix(sparse_slice(first, fraction.xy), sparse_slice(first + 64, fraction.xy), fraction.z);
}
