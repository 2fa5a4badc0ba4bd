// The parts of shapes: this variant has none, all shapes of the scene have functions for their structures. Another
// variant is scene_part_boxes.wgsl, see src/scene/fields/shader_variants.rs.

#import scene_field

const HAS_PARTS: bool = false;

// Selects the shape whose tables the other functions read.
fn select_parts(field: SceneField) {
}

// The first t on [0, t_max) where a ray enters the selected shape, or -1. Local units.
fn parts_hit(origin: vec3f, direction: vec3f, t_max: f32) -> f32 {
    return -1.0;
}
