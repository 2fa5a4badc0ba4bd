// The tables of a shape: tokens, placed leaves, and numbers (parameters and samples).
//
// `rounds` counts the iterations of all loops of an invocation, because software adapters stop an invocation after
// 65,535 iterations without an error. An invocation that reaches MAX_ROUNDS reports it, and the CPU computes its
// result.

// A leaf or a warp. Lengths are in local units.
struct CsgLeaf {
    // Rows of the map leaf_from_local, each with its translation.
    row_x: vec3f,
    shift_x: f32,
    row_y: vec3f,
    shift_y: f32,
    row_z: vec3f,
    shift_z: f32,
    a: vec4f,
    b: vec2f,
    kind: u32,
    // Index of its first value in `numbers`: corners of a polygon or samples of a volume.
    first: u32,
}

@group(0) @binding(1) var<storage, read> tokens: array<u32>;
@group(0) @binding(2) var<storage, read> leaves: array<CsgLeaf>;
// Parameters of joints, levels of offsets and shells, corners of polygons, samples of volumes.
@group(0) @binding(3) var<storage, read> numbers: array<f32>;

const MAX_ROUNDS: u32 = 64000u;
// A token is one u32:
//   31    28 27 26 25                    0
//   +-------+--+--+----------------------+
//   | opcode| -|C | index into the table |   C: TOKEN_COMPLEMENTED, for leaves
//   +-------+--+--+----------------------+
// Set for a leaf of a part in closed form whose literal is the complement of the leaf.

var<private> rounds: u32 = 0u;

fn has_rounds() -> bool {
    return rounds < MAX_ROUNDS;
}

fn placed(leaf: u32, p: vec3f) -> vec3f {
    return vec3f(
        dot(leaves[leaf].row_x, p) + leaves[leaf].shift_x,
        dot(leaves[leaf].row_y, p) + leaves[leaf].shift_y,
        dot(leaves[leaf].row_z, p) + leaves[leaf].shift_z,
    );
}
