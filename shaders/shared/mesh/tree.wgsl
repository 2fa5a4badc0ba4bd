// The binary tree over the triangles of a mesh. Twin of src/bvh/binary.rs.
//
// Software adapters stop an invocation after 65,535 rounds of all its loops together, without an error. A search
// therefore counts its rounds and reports when it needs more; the caller repeats it on the CPU. Software adapters also
// execute both sides of every branch. A round of a search therefore reads little: a node holds the boxes of both its
// children.

struct Node {
    left_min: vec3f,
    // A child: the index of a node, or a leaf (see LEAF).
    left: u32,
    left_max: vec3f,
    right: u32,
    right_min: vec3f,
    pad_0: u32,
    right_max: vec3f,
    pad_1: u32,
}

@group(0) @binding(1) var<storage, read> nodes: array<Node>;

// Largest number of rounds, below the 65,535 of software adapters.
const MAX_ROUNDS: u32 = 65000u;

// A leaf is a run of triangles in one u32. An inner child is an index below LEAF.
//   31 30      28 27                    0
//   +-+----------+----------------------+
//   |1| count - 1|    first triangle    |
//   +-+----------+----------------------+
