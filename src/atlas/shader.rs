//! The sampling functions of an atlas as shader text, for the user's programs ([`crate::shader_library`]).

use super::Layout;
use crate::encoding::Encoding;
use crate::error::Error;
use crate::shader_library::text_without_entry;
use crate::shader_text::Language;
use std::fmt::Write;

const SHELVES: &str = include_str!("../../shaders/atlas/shelves.wgsl");
const STRIPS: &str = include_str!("../../shaders/atlas/strips.wgsl");
const SAMPLING: &str = include_str!("../../shaders/atlas/sampling.wgsl");

/// Parameters of the text.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShaderOptions {
    pub layout: Layout,
    pub encoding: Encoding,
    /// Whether texels are the unsigned integers of an image file, whose middle is distance 0. Image files hold snorm16
    /// in place of float encodings.
    pub unsigned: bool,
    pub page_size: u32,
    /// Number of voxels along a side of the cubes in strips.
    pub side: u32,
}

/// Statements that call every function.
const CALLS: &str = "
    var entry: AtlasEntry;
    let p = vec3f(atlas_texture_coordinates(entry, vec3f(0.0)), 0.0);
    var sum = atlas_sample(entry, p) + atlas_sample_filtered(entry, p) + atlas_sample_nearest(entry, p);
";

/// The sampling functions of an atlas in a language.
pub(crate) fn shader(options: &ShaderOptions, language: Language) -> Result<String, Error> {
    let text = text_without_entry(&wgsl(options), CALLS, language)?;
    // HLSL counts rows where the other languages count columns.
    let is_hlsl = language == Language::Hlsl;
    Ok(if is_hlsl { text.replace("entry.inverse_model * world", "mul(world, entry.inverse_model)") } else { text })
}

/// The whole WGSL text.
pub(crate) fn wgsl(options: &ShaderOptions) -> String {
    let size = options.page_size;
    let (layout, entry) = match options.layout {
        Layout::Shelves { .. } => ("shelves", SHELVES),
        Layout::Strips => ("strips", STRIPS),
    };
    let format = match (options.encoding, options.unsigned) {
        (Encoding::Snorm8, true) => "r8unorm",
        (_, true) => "r16unorm",
        (Encoding::Float32, false) => "r32float",
        (Encoding::Float16, false) => "r16float",
        (Encoding::Snorm16, false) => "r16snorm",
        (Encoding::Snorm8, false) => "r8snorm",
    };
    let mut text = format!(
        "// Sampling of a fieldbake atlas: layout \"{layout}\", pages of {size} x {size} texels of format {format}.\n\
         // Bind the pages as the layers of a 2D array texture. Points are in the space that a volume was baked in:\n\
         // for an instance, entry.inverse_model * world. Distances are negative inside.\n\n\
         const ATLAS_PAGE_SIZE: f32 = {size}.0;\n"
    );
    if options.layout == Layout::Strips {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const ATLAS_SIDE: u32 = {}u;", options.side);
        let is_scaled = options.unsigned || options.encoding.is_scaled();
        let _ = writeln!(text, "const ATLAS_IS_SCALED: bool = {is_scaled};");
    }
    let share = match (options.unsigned, options.encoding) {
        (false, _) => PLAIN_SHARE.to_owned(),
        (true, Encoding::Snorm8) => unsigned_share(8),
        (true, _) => unsigned_share(16),
    };
    text + "\n" + entry + "\n" + &share + "\n" + SAMPLING
}

const PLAIN_SHARE: &str = "\
// The distance of a texel as a fraction of the entry's scale: the value of the texel.
fn atlas_share(texel: f32) -> f32 {
    return texel;
}
";

/// The function that decodes unsigned integers of this many bits.
fn unsigned_share(bits: u32) -> String {
    let largest = (1u32 << bits) - 1;
    let middle = 1u32 << (bits - 1);
    let steps = middle - 1;
    format!(
        "\
// The distance of a texel as a fraction of the entry's scale. The texture returns the unsigned integer over {largest},
// and the distance is (integer - {middle}) / {steps} * scale.
fn atlas_share(texel: f32) -> f32 {{
    return (texel * {largest}.0 - {middle}.0) / {steps}.0;
}}
"
    )
}

#[cfg(test)]
mod tests {
    use super::super::entry::{AtlasEntry, StripEntry};
    use super::*;
    use crate::shader_text::parse;
    use naga::{Module, ShaderStage, front};
    use std::mem::offset_of;

    const LANGUAGES: [Language; 4] = [Language::Wgsl, Language::Glsl, Language::Hlsl, Language::Msl];
    const FUNCTIONS: [&str; 5] =
        ["atlas_sample", "atlas_sample_filtered", "atlas_sample_nearest", "atlas_texture_coordinates", "atlas_slice"];

    fn every_option() -> impl Iterator<Item = ShaderOptions> {
        [Layout::Strips, Layout::Shelves { gutter: 1 }].into_iter().flat_map(|layout| {
            [false, true].into_iter().flat_map(move |unsigned| {
                Encoding::ALL.map(|encoding| ShaderOptions { layout, encoding, unsigned, page_size: 4096, side: 64 })
            })
        })
    }

    #[test]
    fn the_text_is_valid_and_every_language_has_every_function_with_its_comment() {
        for options in every_option() {
            parse(&wgsl(&options)).unwrap();
            for language in LANGUAGES {
                let text = shader(&options, language).unwrap();
                for function in FUNCTIONS {
                    let lines: Vec<&str> = text.lines().collect();
                    let at = lines.iter().position(|line| line.contains(&format!(" {function}("))).unwrap();
                    assert!(lines[at - 1].starts_with("// "), "{language:?} {function}: {}", lines[at - 1]);
                }
                assert!(text.contains("Distances are negative inside."));
                assert!(!text.contains("entry_point") && !text.contains("entry_1") && !text.contains("nagaS"));
                assert!(!text.contains("\n\n\n"));
                assert_eq!(text, shader(&options, language).unwrap());
            }
        }
    }

    #[test]
    fn a_main_after_the_glsl_text_makes_a_shader() {
        for options in every_option() {
            let text = shader(&options, Language::Glsl).unwrap();
            assert!(text.starts_with("#version 300 es\n"), "{text}");
            assert!(text.contains("uniform highp sampler2DArray atlas_pages;"));
            assert!(!text.contains("main"));
        }
    }

    /// Names and offsets of the members of a struct in a module, and its size.
    fn layout_of(module: &Module, name: &str) -> (Vec<(String, u32)>, u32) {
        let (_, found) = module.types.iter().find(|(_, found)| found.name.as_deref() == Some(name)).unwrap();
        let naga::TypeInner::Struct { members, span } = &found.inner else { panic!("{name} is not a struct") };
        (members.iter().map(|member| (member.name.clone().unwrap(), member.offset)).collect(), *span)
    }

    macro_rules! offsets {
        ($name:ident { $($field:ident),* }) => {
            (vec![$((stringify!($field).to_owned(), offset_of!($name, $field) as u32)),*], size_of::<$name>() as u32)
        };
    }

    #[test]
    fn records_have_the_layout_that_the_shaders_read() {
        let module = |layout| {
            parse(&wgsl(&ShaderOptions {
                layout,
                encoding: Encoding::Float32,
                unsigned: false,
                page_size: 64,
                side: 8,
            }))
            .unwrap()
            .0
        };
        let strips = offsets!(StripEntry {
            model,
            inverse_model,
            inner_min,
            inner_max,
            outer_min,
            outer_max,
            atlas_index,
            atlas_offset,
            scale,
            padding
        });
        assert_eq!(layout_of(&module(Layout::Strips), "AtlasEntry"), strips);
        let shelves = offsets!(AtlasEntry {
            model,
            inverse_model,
            inner_min,
            inner_max,
            outer_min,
            outer_max,
            atlas_index,
            atlas_offset,
            scale,
            columns,
            shape,
            gutter,
            corner,
            tile
        });
        assert_eq!(layout_of(&module(Layout::Shelves { gutter: 1 }), "AtlasEntry"), shelves);
    }

    /// The buffer as the article "Packing 3D SDF to a 2D Texture" declares it.
    const ARTICLE: &str = "#version 450
        struct PackedSdfOffsetDetail {
            mat4 modelMat;
            mat4 invModelMat;
            vec4 innerBBMin;
            vec4 innerBBMax;
            vec4 outerBBMin;
            vec4 outerBBMax;
            int atlasIndex;
            int atlasOffset;
        };
        layout(std430, binding = 0) buffer PackedSdfOffsetDetailBuffer {
            int offsetSize;
            PackedSdfOffsetDetail offsets[];
        };
        void main() { offsetSize = offsets[0].atlasIndex; }";

    #[test]
    fn a_strip_entry_is_the_articles_struct() {
        let options = front::glsl::Options::from(ShaderStage::Vertex);
        let module = front::glsl::Frontend::default().parse(&options, ARTICLE).unwrap();
        let (members, size) = layout_of(&module, "PackedSdfOffsetDetail");
        let (ours, our_size) = offsets!(StripEntry {
            model,
            inverse_model,
            inner_min,
            inner_max,
            outer_min,
            outer_max,
            atlas_index,
            atlas_offset
        });
        assert_eq!(size, our_size);
        assert_eq!(
            members.iter().map(|member| member.1).collect::<Vec<_>>(),
            ours.iter().map(|o| o.1).collect::<Vec<_>>()
        );
    }
}
