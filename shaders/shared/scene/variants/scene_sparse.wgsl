// Sparse fields of a scene, as bricks. Twin of src/scene/fields/sparse.rs.
//
// Layout of a sparse field:
//   `samples`: floor, longest step, step along x, y and z, nodes, samples of the bricks
//   `blocks`:  one byte per brick (see bricks_march.wgsl), padded to whole words, then the index, one word per brick

#import scene_dense
#import bricks_march

const SPARSE_HEADER: u32 = 5u;

fn brick_word(at: u32) -> u32 {
    return blocks[at];
}

fn brick_node(at: u32) -> f32 {
    return samples[at];
}

fn stored_sample(at: u32) -> f32 {
    return samples[at];
}

fn empty_bytes(at: u32) -> u32 {
    return blocks[at];
}

fn bricks_of(field: SceneField) -> Bricks {
    let first = field.first_sample;
    let nodes = field.blocks + 1u;
    var bricks: Bricks;
    bricks.shape = field.shape;
    bricks.counts = field.blocks;
    bricks.floor = samples[first];
    bricks.longest_step = samples[first + 1u];
    bricks.node_step = vec3f(samples[first + 2u], samples[first + 3u], samples[first + 4u]);
    bricks.first_empty = field.first_block;
    bricks.first_word = (field.first_block + field.blocks.x * field.blocks.y * field.blocks.z + 3u) / 4u;
    bricks.first_node = first + SPARSE_HEADER;
    bricks.first_sample = bricks.first_node + nodes.x * nodes.y * nodes.z;
    return bricks;
}

fn sparse_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    let per_t = length(along);
    let hit = march_bricks(bricks_of(field), origin, along / per_t, t_max * per_t);
    return select(-1.0, hit / per_t, hit >= 0.0);
}

// ---- in a scene with dense grids

// Largest float32 below 1.
const BELOW_ONE: f32 = 0.99999994;

// The field at a point inside the grid; `p` is in grid space. Past the outermost samples the field is constant along an
// axis. An empty brick has bounds there instead, so the point moves into the last cell between samples.
fn sample_in_data(field: SceneField, p: vec3f) -> f32 {
    if field.kind != KIND_SPARSE { return dense_sample(field, p); }
    return sample_bricks(bricks_of(field), clamp(p, vec3f(0.0), BELOW_ONE * (vec3f(field.shape) - 1.0)));
}

// Differences of the field over one voxel along each axis, centred at a point.
fn slope_in_data(field: SceneField, p: vec3f) -> vec3f {
    if field.kind != KIND_SPARSE { return dense_slope(field, p); }
    var slope: vec3f;
    for (var i = 0u; i < 6u; i++) {
        var q = p;
        q[i >> 1u] += select(0.5, -0.5, (i & 1u) != 0u);
        let value = sample_in_data(field, q);
        slope[i >> 1u] += select(value, -value, (i & 1u) != 0u);
    }
    return slope;
}

fn sampled_hit(field: SceneField, origin: vec3f, along: vec3f, t_max: f32) -> f32 {
    if field.kind == KIND_SPARSE { return sparse_hit(field, origin, along, t_max); }
    return dense_hit(field, origin, along, t_max);
}
