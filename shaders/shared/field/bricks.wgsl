// A sparse field at any point: trilinear in bricks near the surface, a bound on the distance elsewhere. Twin of
// src/volume/sparse/mod.rs.
//
// The importing kernel must define three functions:
//   brick_word(i)     word i of the index, one u32 per brick, x fastest
//   brick_node(i)     lower bound on the distance at corner i of the bricks, in longest steps, x fastest
//   stored_sample(i)  sample i of the stored bricks, world units
//
// Layout of a word of the index:
//   31 30 29                             0
//   +----+--------------------------------+
//   |lvl |  index of the stored brick     |   lvl 0 to 2: cells of 2^lvl voxels
//   +----+--------------------------------+
//   |  3 |  unused                  inside|   lvl 3: no samples stored; bit 0 tells inside (1) from outside (0)
//   +----+--------------------------------+

#import cubic

struct Bricks {
    // Number of voxels of the grid, and of bricks, along each axis.
    shape: vec3u,
    counts: vec3u,
    // Smallest distance of any point of an empty brick from the surface, world units.
    floor: f32,
    // Distance of neighbouring nodes along each axis, in units of the longest of the three steps.
    node_step: vec3f,
    // Longest of the three steps, world units.
    longest_step: f32,
    // Offsets of this field in the buffers: its first word, node, sample, and byte of `empty_bytes`.
    first_word: u32,
    first_node: u32,
    first_sample: u32,
    first_empty: u32,
}

// The brick that contains a cell of the grid. Cell -1 is the first cell of brick 0.
fn brick_of(cell: vec3i) -> vec3u {
    return vec3u(cell + 1) / u32(BRICK_CELLS);
}

fn brick_offset(bricks: Bricks, brick: vec3u) -> u32 {
    return brick.x + bricks.counts.x * (brick.y + bricks.counts.y * brick.z);
}

// log2 of the side of the brick's cells, in voxels.
fn cell_shift(word: u32) -> u32 {
    return select(word >> LEVEL_SHIFT, 0u, word >> LEVEL_SHIFT == NOTHING_STORED);
}

// Grid coordinates of sample 0 of the stored brick that covers `brick`.
fn brick_origin(brick: vec3u, shift: u32) -> vec3i {
    return BRICK_CELLS * vec3i((brick >> vec3u(shift)) << vec3u(shift)) - 1;
}

// The samples at the corners of a cell of a stored brick; bit 0 of the index is x, bit 1 y, bit 2 z.
fn brick_corners(bricks: Bricks, word: u32, cell: vec3i) -> array<f32, 8> {
    let local = vec3u(cell);
    let first = bricks.first_sample
        + (word & BRICK_MASK) * BRICK_LEN + local.x + BRICK_SAMPLES * (local.y + BRICK_SAMPLES * local.z);
    let y = BRICK_SAMPLES;
    let z = BRICK_SAMPLES * BRICK_SAMPLES;
    return array<f32, 8>(
        stored_sample(first), stored_sample(first + 1u),
        stored_sample(first + y), stored_sample(first + y + 1u),
        stored_sample(first + z), stored_sample(first + z + 1u),
        stored_sample(first + y + z), stored_sample(first + y + z + 1u),
    );
}

// Bounds at the eight corners of a cell of an empty brick, interpolated from the surrounding nodes. The squared
// distance is a concave function plus |p|^2, so its interpolation minus the variance of the weights is a lower bound
// (src/volume/outside.rs). All corners of a cell lie between the same eight nodes.
fn bounds_around(bricks: Bricks, brick: vec3u, cell: vec3i) -> array<f32, 8> {
    let row = bricks.counts.x + 1u;
    let layer = row * (bricks.counts.y + 1u);
    let first = bricks.first_node + brick.x + row * brick.y + layer * brick.z;
    var squares: array<f32, 8>;
    for (var i = 0u; i < 8u; i++) {
        let node = brick_node(first + (i & 1u) + row * ((i >> 1u) & 1u) + layer * (i >> 2u));
        squares[i] = node * node;
    }
    var corners: array<f32, 8>;
    for (var i = 0u; i < 8u; i++) {
        // Node 0 coincides with sample -1.
        let place = vec3f(cell + 1 + vec3i(vec3u(i & 1u, (i >> 1u) & 1u, i >> 2u))) / f32(BRICK_CELLS);
        let f = clamp(place - vec3f(brick), vec3f(0.0), vec3f(1.0));
        let variance = dot(bricks.node_step * bricks.node_step, f * (1.0 - f));
        corners[i] = max(sqrt(max(trilinear(squares, f) - variance, 0.0)) * bricks.longest_step, bricks.floor);
    }
    return corners;
}

// The field at a point of the box, world units; `p` is in grid space.
fn sample_bricks(bricks: Bricks, p: vec3f) -> f32 {
    let cell = vec3i(floor(p));
    let brick = brick_of(cell);
    let word = brick_word(bricks.first_word + brick_offset(bricks, brick));
    if word >> LEVEL_SHIFT != NOTHING_STORED {
        let shift = cell_shift(word);
        let origin = brick_origin(brick, shift);
        let local = (cell - origin) >> vec3u(shift);
        let low = origin + (local << vec3u(shift));
        return trilinear(brick_corners(bricks, word, local), (p - vec3f(low)) / f32(1u << shift));
    }
    // An empty brick: trilinear interpolation of the bounds at the corners of the voxel.
    let bound = trilinear(bounds_around(bricks, brick, cell), p - vec3f(cell));
    return select(bound, -bound, (word & 1u) == 1u);
}
