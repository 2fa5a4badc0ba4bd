// Shapes of a scene that are traced through their parts, each in its boxes, and measured by the interpreter.
//
// Layout of such a shape:
//   `samples`: the four numbers of scene_shape.wgsl; 1 / largest Lipschitz constant of a part; the numbers of its tables
//   `blocks`:  nodes and boxes, leaves, tokens of the whole shape, tokens of the parts
//   `shape`:   number of nodes, of boxes, of leaves;   `blocks.x`: number of tokens of the whole shape

#import csg_walk
#import scene_field

const HAS_PARTS: bool = true;

// Index of the number of scene_shape.wgsl that follows its four.
const PART_NUMBER: u32 = 4u;

var<private> part_nodes: u32;
var<private> part_step: f32;
var<private> whole_tokens: u32;

// Selects the shape whose tables the other functions read.
fn select_parts(field: SceneField) {
    first_box = field.first_block / 4u;
    first_leaf = first_box + BOX_WORDS * (field.shape.x + field.shape.y);
    first_token = first_leaf + LEAF_WORDS * field.shape.z;
    first_number = field.first_sample + PART_NUMBER + 1u;
    part_nodes = field.shape.x;
    part_step = samples[field.first_sample + PART_NUMBER];
    whole_tokens = field.blocks.x;
}

fn node_count() -> u32 {
    return part_nodes;
}

fn longest_step() -> f32 {
    return part_step;
}

fn count_evaluation(cell: u32) {
    steps++;
}

// The field of the selected shape, local units.
fn parts_distance(p: vec3f) -> f32 {
    return csg_distance(p, 0u, whole_tokens);
}

// The first t on [0, t_max) where a ray enters the selected shape, or -1. Local units.
fn parts_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    let hit = trace_parts(part_ray(origin, direction), t_max, false);
    return select(-1.0, hit.t, hit.is_hit);
}

// A node, or the box of a part.
fn box_at(cell: u32) -> CsgBox {
    let at = first_box + BOX_WORDS * cell;
    return CsgBox(
        vec3f(real_at(at), real_at(at + 1u), real_at(at + 2u)),
        blocks[at + 3u],
        vec3f(real_at(at + 4u), real_at(at + 5u), real_at(at + 6u)),
        blocks[at + 7u],
        blocks[at + 8u],
        blocks[at + 9u],
        0u,
        0u,
    );
}

fn leaf_at(leaf: u32) -> CsgLeaf {
    let at = first_leaf + LEAF_WORDS * leaf;
    return CsgLeaf(
        vec3f(real_at(at), real_at(at + 1u), real_at(at + 2u)),
        real_at(at + 3u),
        vec3f(real_at(at + 4u), real_at(at + 5u), real_at(at + 6u)),
        real_at(at + 7u),
        vec3f(real_at(at + 8u), real_at(at + 9u), real_at(at + 10u)),
        real_at(at + 11u),
        vec4f(real_at(at + 12u), real_at(at + 13u), real_at(at + 14u), real_at(at + 15u)),
        vec2f(real_at(at + 16u), real_at(at + 17u)),
        blocks[at + 18u],
        blocks[at + 19u],
    );
}
