// The field of the part of a box. The kernel that is written for a shape has another text in place of this file: a function
// for each structure of its parts, see src/csg/compiled.rs.

#import csg_interpreter

// How rays meet a part: these two in closed form, the others by marching its field.
const FORM_UNION: u32 = 1u;
const FORM_CHORDS: u32 = 2u;

fn part_distance(p: vec3f, form: u32, first: u32, count: u32, parameters: u32) -> f32 {
    return csg_distance(p, first, count);
}
