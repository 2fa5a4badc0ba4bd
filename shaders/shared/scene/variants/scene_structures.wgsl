// The field of a shape, by the index of its structure. The kernels of a scene import another variant of this file, with
// one function for each structure of its shapes, see src/scene/fields/shader_variants.rs.

#import csg_field

fn structure_distance(structure: u32, p: vec3f, first: u32) -> f32 {
    return CSG_FAR;
}
