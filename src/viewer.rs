//! The shader of the viewer in browsers, written for the kinds of fields that a view has.
//!
//! The WGSL files in `shaders/viewer/` are the source. Each structure of the shapes in a view becomes a function, and
//! naga writes the whole as GLSL ES 3.00, the language of WebGL 2; WebGPU compiles the WGSL itself. The parameters of a
//! shape stay in the data of the view, so that a changed parameter compiles nothing.

use crate::csg::parts::solid::Solid;
use crate::csg::text::structure_text::StructureText;
use crate::encoding::Encoding;
use crate::error::{DeviceError, Error};
use crate::gpu::shader::{shared, source_with};
use crate::shader_text::translation::{GlslTarget, Language, translate_used};
use naga::ShaderStage;
use naga::back::glsl::Version;
use std::fmt::Write;
use std::sync::Arc;

const fn glsl(stage: ShaderStage, entry_point: &'static str) -> GlslTarget {
    GlslTarget { version: Version::Embedded { version: 300, is_webgl: true }, stage, entry_point }
}

/// Kinds of fields besides shapes.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct ViewedKinds {
    pub dense: bool,
    pub sparse: bool,
    pub quadric: bool,
    /// Whether the view has the triangles of meshes.
    pub mesh: bool,
    /// The encoding of all sampled fields, if they have the same one.
    pub encoding: Option<Encoding>,
}

/// The shaders of a view, and the data that the shapes need.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ViewerShader {
    /// The fragment shader of rays.
    pub rays: String,
    /// The vertex and the fragment shader of meshes with shadows.
    pub mesh: Option<[String; 2]>,
    /// One entry per shape; `None` for a shape without a function: one that is too large, or that contains a baked
    /// volume.
    pub shapes: Vec<Option<ShapeFunction>>,
}

/// The function that evaluates a shape, and its input.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ShapeFunction {
    /// Index of its function.
    pub structure: u32,
    /// Input of the function, local units.
    pub numbers: Vec<f32>,
    /// The local frame in world units: a local position is `(world - center) / scale`.
    pub center: [f64; 3],
    pub scale: f64,
    /// One over the largest slope of the field.
    pub inverse_lipschitz: f64,
}

/// Writes the shaders for fields of these kinds and for these shapes.
pub(crate) fn shader(kinds: ViewedKinds, solids: &[Arc<Solid>], language: Language) -> Result<ViewerShader, Error> {
    let mut functions: Vec<(String, Option<String>)> = Vec::new();
    let mut shapes = Vec::new();
    for solid in solids {
        shapes.push(StructureText::of(solid, ARRAY, "steps").map(|whole| {
            let function = (whole.body, whole.color);
            let found = functions.iter().position(|found| *found == function);
            if found.is_none() {
                functions.push(function);
            }
            ShapeFunction {
                structure: found.unwrap_or(functions.len() - 1) as u32,
                numbers: whole.numbers,
                center: solid.frame.center.to_array(),
                scale: solid.frame.scale,
                inverse_lipschitz: 1.0 / solid.model.lipschitz,
            }
        }));
    }
    let has_shape = !functions.is_empty();
    let texts = [("viewer_needs", &*needs(kinds, has_shape)), ("viewer_shapes", &*shapes_text(&functions))];
    let has = [("DENSE", kinds.dense), ("SPARSE", kinds.sparse), ("SHAPE", has_shape), ("QUADRIC", kinds.quadric)];
    let own_kernel = |name| -> Result<String, Error> {
        let wgsl = kernel(name, &texts)?;
        Ok(has.iter().filter(|(_, has)| !has).fold(wgsl, |text, (name, _)| without_lines(&text, name)))
    };
    let rays = written(&own_kernel("viewer")?, language, glsl(ShaderStage::Fragment, "main"))?;
    let mesh = if kinds.mesh {
        Some(triangles(&own_kernel("viewer_mesh")?, language, ["lit_corner", "lit_color"])?)
    } else {
        None
    };
    Ok(ViewerShader { rays, mesh, shapes })
}

/// The vertex and the fragment shader for triangles of level sets.
pub(crate) fn triangle_shaders(language: Language) -> Result<[String; 2], Error> {
    triangles(&kernel("viewer_triangles", &[])?, language, ["triangle_corner", "triangle_color"])
}

/// The vertex and the fragment shader of a kernel with these entry points.
fn triangles(wgsl: &str, language: Language, [corner, color]: [&'static str; 2]) -> Result<[String; 2], Error> {
    let corner = written(wgsl, language, glsl(ShaderStage::Vertex, corner))?;
    Ok([corner, written(wgsl, language, glsl(ShaderStage::Fragment, color))?])
}

/// The text of one entry point. WGSL stays whole, without its comments and indentation: pages contain it.
fn written(wgsl: &str, language: Language, target: GlslTarget) -> Result<String, Error> {
    let text = translate_used(wgsl, language, target)?;
    if language != Language::Wgsl {
        return Ok(text);
    }
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//"));
    Ok(lines.flat_map(|line| [line, "\n"]).collect())
}

/// The whole WGSL of a kernel.
fn kernel(name: &str, instead: &[(&str, &str)]) -> Result<String, Error> {
    let refused = |reason| DeviceError::Shader { device: "WebGL 2".into(), kernel: name.into(), reason };
    Ok(source_with(name, instead).map_err(refused)?)
}

/// Name of the array of numbers before its elements become calls of `number_at`.
const ARRAY: &str = "numbers";

/// The colour of the operand whose surface is nearer, mixed on a fillet; twin of `color` in
/// src/csg/evaluation/program.rs.
const MIXED_COLOR: &str = "
fn mixed_color(a: f32, b: f32, first: vec3f, second: vec3f, width: f32) -> vec3f {
    let is_first = a <= b;
    let near = select(second, first, is_first);
    if width <= 0.0 { return near; }
    return mix(near, select(first, second, is_first), max(width - abs(a - b), 0.0) / (2.0 * width));
}
";

/// A text without the lines that begin with `if HAS_NAME`.
fn without_lines(text: &str, name: &str) -> String {
    let start = format!("if HAS_{name} ");
    text.lines().filter(|line| !line.trim_start().starts_with(&start)).flat_map(|line| [line, "\n"]).collect()
}

/// The text in place of `shaders/viewer/needs.wgsl`.
fn needs(kinds: ViewedKinds, has_shape: bool) -> String {
    let ViewedKinds { dense, sparse, quadric, encoding, .. } = kinds;
    let encoding = encoding.and_then(|one| Encoding::ALL.iter().position(|&found| found == one));
    format!(
        "const HAS_DENSE: bool = {dense};\nconst HAS_SPARSE: bool = {sparse};\nconst HAS_SHAPE: bool = {has_shape};\n\
         const HAS_QUADRIC: bool = {quadric};\nconst HAS_SLICE: bool = true;\nconst IS_MOTION: bool = false;\n\
         const ONE_ENCODING: i32 = {};\n",
        encoding.map_or(-1, |place| place as i32)
    )
}

/// The text in place of `shaders/viewer/shapes.wgsl`.
fn shapes_text(functions: &[(String, Option<String>)]) -> String {
    let mut text = String::new();
    if !functions.is_empty() {
        text += shared("csg_field").unwrap_or_default();
        text += MIXED_COLOR;
        text += &by_calls(&StructureText::helpers(ARRAY));
    }
    let (mut distances, mut colors) = (String::new(), String::new());
    // Writing to a string cannot fail.
    for (i, (body, color)) in functions.iter().enumerate() {
        let body = by_calls(body);
        let _ = write!(text, "\nfn structure_{i}(p0: vec3f, n: u32) -> f32 {{\n{body}}}\n");
        let _ = writeln!(distances, "        case {i}u: {{ return structure_{i}(p, 0u); }}");
        if let Some(color) = color {
            let color = by_calls(color);
            let _ = write!(text, "\nfn color_{i}(p0: vec3f, n: u32) -> vec3f {{\n{color}}}\n");
            let _ = writeln!(colors, "        case {i}u: {{ return color_{i}(p, 0u); }}");
        }
    }
    let choice = |name: &str, kind: &str, cases: &str, otherwise: &str| {
        format!(
            "\nfn {name}(structure: u32, p: vec3f) -> {kind} {{\n    switch structure {{\n{cases}        default: {{ return \
             {otherwise}; }}\n    }}\n}}\n"
        )
    };
    text + &choice("structure_distance", "f32", &distances, "1.0")
        + &choice("structure_color", "vec3f", &colors, "vec3f(-1.0)")
}

/// A text whose elements `numbers[i]` are calls `number_at(i)`. No index has brackets of its own.
fn by_calls(text: &str) -> String {
    let mut pieces = text.split("numbers[");
    let mut out = pieces.next().unwrap_or_default().to_owned();
    for piece in pieces {
        let (index, rest) = piece.split_once(']').unwrap_or((piece, ""));
        let _ = write!(out, "number_at({index}){rest}");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::text::language;
    use crate::csg::tree::shape::Shape;

    #[test]
    fn every_text_is_valid_in_both_languages() {
        let texts = ["(blend union 0.1 (paint 1 0 0 (cube 1)) (paint 0 1 0 (sphere 0.6)))", "(torus 1 0.2)"];
        let solid = |text: &&str| {
            let shape: Shape = language::parse(text).unwrap();
            Arc::new(Solid::new(&shape).unwrap())
        };
        for solids in [vec![], texts[1..].iter().map(solid).collect(), texts.iter().map(solid).collect::<Vec<_>>()] {
            for bits in 0..8u8 {
                let encoding = (bits == 1).then_some(Encoding::Snorm8);
                let [dense, sparse, quadric] = [1, 2, 4].map(|bit| bits & bit == bit);
                let kinds = ViewedKinds { dense, sparse, quadric, mesh: dense, encoding };
                let glsl = shader(kinds, &solids, Language::Glsl).unwrap();
                assert_eq!(glsl.mesh.is_some(), dense);
                for text in glsl.mesh.iter().flatten().chain([&glsl.rays]) {
                    assert!(text.starts_with("#version 300 es\n"));
                }
                assert_eq!(glsl.shapes.iter().flatten().count(), solids.len());
                let wgsl = shader(kinds, &solids, Language::Wgsl).unwrap();
                assert!(wgsl.rays.contains("fn main("));
                assert!(!wgsl.rays.contains("\n//"));
                assert!(wgsl.mesh.is_none_or(|[text, _]| text.contains("fn lit_color(")));
            }
        }
    }

    #[test]
    fn triangles_are_valid_in_both_languages() {
        let glsl = triangle_shaders(Language::Glsl).unwrap();
        assert!(glsl.iter().all(|text| text.starts_with("#version 300 es\n")));
        assert!(triangle_shaders(Language::Wgsl).unwrap()[0].contains("fn triangle_corner("));
    }

    #[test]
    fn elements_become_calls() {
        assert_eq!(by_calls("f(numbers[n + 2u], k[0])"), "f(number_at(n + 2u), k[0])");
    }
}
