// The field of the part of a box. A kernel specialised for one shape imports another variant of this file, with one
// function for each structure of its parts (src/csg/text/specialised_kernel.rs).

#import csg_interpreter

fn part_distance(p: vec3f, form: u32, first: u32, count: u32, parameters: u32) -> f32 {
    return csg_distance(p, first, count);
}
