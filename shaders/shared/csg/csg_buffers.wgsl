// The buffers of one shape. In a scene another variant of this file reads them from the buffers of all fields.
//
// `rounds` counts the iterations of all loops of an invocation, because software adapters stop an invocation after
// 65,535 iterations without an error. An invocation that reaches MAX_ROUNDS reports it, and the CPU computes its
// result.

@group(0) @binding(1) var<storage, read> tokens: array<u32>;
@group(0) @binding(2) var<storage, read> leaves: array<CsgLeaf>;
// Parameters of joints, levels of offsets and shells, corners of polygons, samples of volumes.
@group(0) @binding(3) var<storage, read> numbers: array<f32>;

const MAX_ROUNDS: u32 = 64000u;
var<private> rounds: u32 = 0u;

fn has_rounds() -> bool {
    return rounds < MAX_ROUNDS;
}
