// The tree over the instances of a scene, and boxes in the way of cones. Twin of src/scene/content/tree.rs.

#import scene_field
#import scene_beam

struct SceneNode {
    min: vec3f,
    // Leaf: first instance. Inner node: left child; the right child follows it.
    first: u32,
    max: vec3f,
    // Leaf: 1 + the second instance, or 1 + the first if the leaf has only one. Inner node: 0.
    second: u32,
}

// Node 0 is the root.
@group(0) @binding(1) var<storage, read> nodes: array<SceneNode>;

const MAX_DEPTH: u32 = 34u;

// Largest distance from a point to a box.
fn reach(p: vec3f, low: vec3f, high: vec3f) -> f32 {
    return length(max(abs(p - low), abs(p - high)));
}

// Largest radius of a cone from p where it can touch a box before t_max.
fn widest(p: vec3f, slope: f32, low: vec3f, high: vec3f, t_max: f32) -> f32 {
    if slope <= 0.0 { return 0.0; }
    return min(slope / (1.0 - min(slope, 0.9)) * reach(p, low, high), slope * t_max);
}
