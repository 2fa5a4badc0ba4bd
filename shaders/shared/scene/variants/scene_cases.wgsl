// Cases that the kernels of beams handle: this variant has all of them. A picture that lacks some imports another
// variant of this file, see src/scene/fields/shader_variants.rs.

// Whether the scene has a far field.
const HAS_FAR: bool = true;
