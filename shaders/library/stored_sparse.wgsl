// One word per brick. Bits 31-30: level 0 to 2, whose cells have 2^level voxels; bits 29-0: index of the stored brick.
// Level 3 marks an empty brick; bit 0 then tells inside (1) from outside (0).
@group(0) @binding(0) var sparse_index: texture_3d<u32>;
// Lower bounds of the distance at the corners of the bricks, in units of SPARSE_LONGEST_STEP.
@group(0) @binding(1) var sparse_nodes: texture_3d<f32>;
// The samples: 512 texels per brick, x fastest, in rows of SPARSE_ROW texels.
@group(0) @binding(2) var sparse_bricks: texture_2d<f32>;

// A stored sample, world units.
fn sparse_sample(at: i32) -> f32 {
    return textureLoad(sparse_bricks, vec2i(at % SPARSE_ROW, at / SPARSE_ROW), 0).x * SPARSE_SCALE;
}

// Bilinear interpolation of the samples of a brick from sample `first` on.
fn sparse_slice(first: i32, fraction: vec2f) -> f32 {
    let low = mix(sparse_sample(first), sparse_sample(first + 1), fraction.x);
    let high = mix(sparse_sample(first + 8), sparse_sample(first + 9), fraction.x);
    return mix(low, high, fraction.y);
}

// Lower bound at a voxel's corner in an empty brick: the mean of the squares around it less the variance of the
// weights.
fn sparse_bound(brick: vec3i, corner: vec3i) -> f32 {
    // Node 0 lies at voxel -1, and nodes are 7 voxels apart.
    let f = clamp(vec3f(corner + 1) / 7.0 - vec3f(brick), vec3f(0.0), vec3f(1.0));
    var mean = 0.0;
    for (var i = 0; i < 8; i++) {
        let side = vec3i(i & 1, (i / 2) & 1, i / 4);
        let node = textureLoad(sparse_nodes, brick + side, 0).x;
        let weights = mix(1.0 - f, f, vec3f(side));
        mean += weights.x * weights.y * weights.z * node * node;
    }
    let variance = dot(SPARSE_NODE_STEP * SPARSE_NODE_STEP, f * (1.0 - f));
    return max(sqrt(max(mean - variance, 0.0)) * SPARSE_LONGEST_STEP, SPARSE_FLOOR);
}

// The distance at p in world space: trilinear in the stored bricks, a lower bound with its sign in the empty ones.
// Outside the box, with the distance a to it and the value s at its nearest point, it is sqrt(a^2 + s^2).
fn sparse_distance(p: vec3f) -> f32 {
    let p_grid = (p - SPARSE_LOWER) / SPARSE_SPACING - 0.5;
    let clamped = clamp(p_grid, vec3f(-0.5), vec3f(SPARSE_SHAPE) - 0.5);
    let cell = vec3i(floor(clamped));
    let brick = min((cell + 1) / 7, SPARSE_COUNTS - 1);
    let word = textureLoad(sparse_index, brick, 0).x;
    let level = word >> 30u;
    var value = 0.0;
    if level < 3u {
        let cells = i32(1u << level);
        let origin = 7 * (brick / cells * cells) - 1;
        let local = (cell - origin) / cells;
        let fraction = (clamped - vec3f(origin + local * cells)) / f32(cells);
        let first = i32(word & 0x3fffffffu) * 512 + local.x + 8 * (local.y + 8 * local.z);
        value = mix(sparse_slice(first, fraction.xy), sparse_slice(first + 64, fraction.xy), fraction.z);
    } else {
        let fraction = clamped - vec3f(cell);
        for (var i = 0; i < 8; i++) {
            let side = vec3i(i & 1, (i / 2) & 1, i / 4);
            let weights = mix(1.0 - fraction, fraction, vec3f(side));
            value += weights.x * weights.y * weights.z * sparse_bound(brick, cell + side);
        }
        value = select(value, -value, (word & 1u) == 1u);
    }
    let outside = (p_grid - clamped) * SPARSE_SPACING;
    let squared = dot(outside, outside);
    return select(value, sqrt(squared + max(value, 0.0) * max(value, 0.0)), squared > 0.0);
}
