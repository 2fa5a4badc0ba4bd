// A sparse field between its samples: trilinear in bricks near the surface, a bound on the distance elsewhere. Twin of
// src/volume/sparse/mod.rs. The kernel that imports this brings `stored_sample`.

#import cubic

struct SparseParams {
    // Bricks along each axis.
    bricks: vec3u,
    // No point of an empty brick is nearer to the surface, world units.
    floor: f32,
    // Distance of neighbouring nodes along each axis, in units of the longest of the three.
    node_step: vec3f,
    // That, world units.
    longest_step: f32,
}

// A word a brick, x fastest: the level in the two highest bits, below it which brick; level 3 says that nothing is stored,
// and then bit 0 that it lies inside.
@group(0) @binding(5) var<storage, read> index: array<u32>;
// Distances at the corners of the bricks, or lower bounds of them, in units of the longest step; x fastest.
@group(0) @binding(6) var<storage, read> nodes: array<f32>;
@group(0) @binding(9) var<uniform> sparse: SparseParams;

// Cells and samples along the side of a brick.
const BRICK_CELLS: i32 = 7;
const BRICK_SAMPLES: u32 = 8u;
const BRICK_LEN: u32 = 512u;
const NOTHING_STORED: u32 = 3u;
const BRICK_MASK: u32 = 0x3fffffffu;

// The brick that holds a cell of the grid; cell -1 is the first of brick 0.
fn brick_of(cell: vec3i) -> vec3u {
    return vec3u(cell + 1) / u32(BRICK_CELLS);
}

fn brick_offset(brick: vec3u) -> u32 {
    return brick.x + sparse.bricks.x * (brick.y + sparse.bricks.y * brick.z);
}

// Voxels along the side of the cells of a brick, to base 2.
fn cell_shift(word: u32) -> u32 {
    return select(word >> 30u, 0u, word >> 30u == NOTHING_STORED);
}

// Grid coordinates of sample 0 of the stored brick that stands for `brick`.
fn brick_origin(brick: vec3u, shift: u32) -> vec3i {
    return BRICK_CELLS * vec3i((brick >> vec3u(shift)) << vec3u(shift)) - 1;
}

// The samples at the corners of a cell of a stored brick; bit 0 of the index is x, bit 1 y, bit 2 z.
fn brick_corners(word: u32, cell: vec3i) -> array<f32, 8> {
    let local = vec3u(cell);
    let first =
        (word & BRICK_MASK) * BRICK_LEN + local.x + BRICK_SAMPLES * (local.y + BRICK_SAMPLES * local.z);
    let y = BRICK_SAMPLES;
    let z = BRICK_SAMPLES * BRICK_SAMPLES;
    return array<f32, 8>(
        stored_sample(first), stored_sample(first + 1u),
        stored_sample(first + y), stored_sample(first + y + 1u),
        stored_sample(first + z), stored_sample(first + z + 1u),
        stored_sample(first + y + z), stored_sample(first + y + z + 1u),
    );
}

// What the nodes around a point of an empty brick say of its distance: the square of the distance is a concave function
// plus that of the place, so its interpolation less the variance of the weights is a lower bound (src/volume/outside.rs).
fn bound_at(p_grid: vec3f) -> f32 {
    // Node 0 is sample -1.
    let p = clamp((p_grid + 1.0) / f32(BRICK_CELLS), vec3f(0.0), vec3f(sparse.bricks));
    let low = min(vec3u(p), sparse.bricks - 1u);
    let f = p - vec3f(low);
    let row = sparse.bricks.x + 1u;
    let layer = row * (sparse.bricks.y + 1u);
    let first = low.x + row * low.y + layer * low.z;
    let squares = array<f32, 8>(
        nodes[first] * nodes[first], nodes[first + 1u] * nodes[first + 1u],
        nodes[first + row] * nodes[first + row], nodes[first + row + 1u] * nodes[first + row + 1u],
        nodes[first + layer] * nodes[first + layer], nodes[first + layer + 1u] * nodes[first + layer + 1u],
        nodes[first + layer + row] * nodes[first + layer + row],
        nodes[first + layer + row + 1u] * nodes[first + layer + row + 1u],
    );
    let variance = dot(sparse.node_step * sparse.node_step, f * (1.0 - f));
    return max(sqrt(max(trilinear(squares, f) - variance, 0.0)) * sparse.longest_step, sparse.floor);
}

// The field at a point of grid space; outside the box, at its nearest point.
fn field_at(p_grid: vec3f, shape: vec3u) -> f32 {
    let p = clamp(p_grid, vec3f(-0.5), vec3f(shape) - 0.5);
    let cell = vec3i(floor(p));
    let brick = brick_of(cell);
    let word = index[brick_offset(brick)];
    if word >> 30u != NOTHING_STORED {
        let shift = cell_shift(word);
        let origin = brick_origin(brick, shift);
        let local = (cell - origin) >> vec3u(shift);
        let low = origin + (local << vec3u(shift));
        return trilinear(brick_corners(word, local), (p - vec3f(low)) / f32(1u << shift));
    }
    // Voxel by voxel between bounds.
    var corners: array<f32, 8>;
    for (var i = 0u; i < 8u; i++) {
        corners[i] = bound_at(vec3f(cell + vec3i(vec3u(i & 1u, (i >> 1u) & 1u, i >> 2u))));
    }
    let bound = trilinear(corners, p - vec3f(cell));
    return select(bound, -bound, (word & 1u) == 1u);
}
