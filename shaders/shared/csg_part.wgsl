// The field of the part of a box. A kernel that is written for a shape has another text in place of this file: a function for
// each structure of its parts (src/csg/compiled.rs).

#import csg_interpreter

fn part_distance(p: vec3f, form: u32, first: u32, count: u32, parameters: u32) -> f32 {
    return csg_distance(p, first, count);
}
