//! The kinds of objects in a scene, and the shader text for them: kernels contain the code of those kinds only.
//!
//! Software devices execute every branch and inline all functions, so a kernel has the cost of every kind it contains
//! at each evaluation of a field. A scene of dense grids uses the kernels as they are. Other scenes override some of
//! the imported files. Shapes have one function per structure.

use crate::csg::text::structure_text::StructureText;
use crate::gpu::shader::{Instead, shared};
use std::borrow::Cow;
use std::fmt::Write;

/// The same values as in `shaders/shared/scene/scene_field.wgsl`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum FieldKind {
    Dense = 0,
    Sparse = 1,
    Quadric = 2,
    Shape = 3,
    Nested = 4,
}

/// Largest number of structures of a scene's shapes. A text with more takes minutes to compile.
pub(crate) const MAX_STRUCTURES: usize = 8;

/// The kinds of a scene's objects, besides dense grids.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct GeometryKinds {
    pub sparse: bool,
    pub nested: bool,
    pub quadrics: bool,
    /// The functions of the shapes' structures.
    pub structures: Vec<String>,
}

impl GeometryKinds {
    /// Overrides of imported files.
    pub fn texts(&self) -> Vec<Instead> {
        let file = |name| Cow::Borrowed(shared(name).unwrap_or_default());
        let mut texts = Vec::new();
        if self.sparse {
            texts.push(("scene_samples", file("scene_sparse")));
        }
        if self.nested {
            texts.push(("scene_levels", file("scene_nested")));
        }
        if self.quadrics {
            texts.push(("scene_objects", file("scene_quadric")));
        }
        if !self.structures.is_empty() {
            texts.push(("scene_solids", file("scene_shape")));
            texts.push(("scene_structures", Cow::Owned(structures_text(&self.structures))));
        }
        texts
    }
}

/// The override of `shaders/shared/scene/variants/scene_cases.wgsl`, for kernels of beams: whether the scene has a far
/// field.
pub(crate) fn cases_text(has_far: bool) -> Instead {
    ("scene_cases", Cow::Owned(format!("const HAS_FAR: bool = {has_far};\n")))
}

/// The override of `shaders/shared/scene/variants/scene_structures.wgsl`.
fn structures_text(bodies: &[String]) -> String {
    let mut text = "// A function for each structure of the shapes of a scene. Their numbers begin at `n`, in the order of the text.\n\n\
         #import scene_field\n#import csg_field\n"
        .to_owned();
    text.push_str(&StructureText::helpers(ARRAY));
    let mut cases = String::new();
    for (i, body) in bodies.iter().enumerate() {
        let _ = write!(text, "\nfn structure_{i}(p0: vec3f, n: u32) -> f32 {{\n{body}}}\n");
        let _ = writeln!(cases, "        case {i}u: {{ return structure_{i}(p, first); }}");
    }
    let _ = write!(
        text,
        "\nfn structure_distance(structure: u32, p: vec3f, first: u32) -> f32 {{\n    switch structure {{\n{cases}        \
         default: {{ return CSG_FAR; }}\n    }}\n}}\n"
    );
    text
}

/// Array with the parameters of shapes, and counter of loop iterations, in `shaders/shared/scene/scene_field.wgsl`.
pub(crate) const ARRAY: &str = "samples";
pub(crate) const TURNS: &str = "steps";

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::parts::solid::Solid;
    use crate::csg::text::language;
    use crate::csg::tree::shape::Shape;
    use crate::gpu::shader::source_instead;
    use crate::gpu::tests::validate;

    #[test]
    fn every_text_is_valid() {
        let shape: Shape = language::parse("(difference (box 1 1 1) (sphere 0.6))").unwrap();
        let body = StructureText::of(&Solid::new(&shape).unwrap(), ARRAY, TURNS).unwrap().body;
        for i in 0..16u8 {
            let has = |bit: u8| i >> bit & 1 == 1;
            let structures = if has(2) { vec![body.clone()] } else { Vec::new() };
            let mut texts = GeometryKinds { sparse: has(0), nested: has(3), quadrics: has(1), structures }.texts();
            texts.push(cases_text(has(1)));
            for kernel in ["scene_beams", "scene_fields"] {
                let text = source_instead(kernel, &texts).unwrap();
                validate(kernel, &text);
                assert_eq!(text.contains("fn march_bricks"), has(0));
                assert_eq!(text.contains("fn quadric_hit"), has(1));
                assert_eq!(text.contains("fn structure_0"), has(2));
                assert_eq!(text.contains("fn nested_hit"), has(3));
            }
        }
    }
}
