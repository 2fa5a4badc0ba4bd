// The functions of the shapes of a view, local units. The text of a view replaces this file.

// The field of a structure.
fn structure_distance(structure: u32, p: vec3f) -> f32 {
    return 1.0;
}

// Linear RGB of the paint of a structure at a point; negative without paint.
fn structure_color(structure: u32, p: vec3f) -> vec3f {
    return vec3f(-1.0);
}
