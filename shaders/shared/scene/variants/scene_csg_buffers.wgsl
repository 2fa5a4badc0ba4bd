// The tables of a shape in the buffers of all fields, see scene_part_boxes.wgsl: indices of its first values. The texts
// that read tables of one shape are rewritten for them (src/scene/fields/shader_variants.rs).

#import scene_field

// Words of a node or a box, and of a leaf.
const BOX_WORDS: u32 = 12u;
const LEAF_WORDS: u32 = 20u;

var<private> first_box: u32;
var<private> first_leaf: u32;
var<private> first_token: u32;
var<private> first_number: u32;

fn real_at(at: u32) -> f32 {
    return bitcast<f32>(blocks[at]);
}

fn has_rounds() -> bool {
    // The CPU evaluates what did not end.
    if steps + visits >= MAX_STEPS { steps = MAX_STEPS; }
    return steps < MAX_STEPS;
}
