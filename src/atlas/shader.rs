//! The sampling functions of an atlas as shader text, for the user's programs ([`crate::shader_text::library`]).

use super::Layout;
use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error, choice};
use crate::shader_text::library::text_without_entry;
use crate::shader_text::translation::Language;
use std::fmt::Write;

const SHELVES: &str = include_str!("../../shaders/atlas/shelves.wgsl");
const STRIPS: &str = include_str!("../../shaders/atlas/strips.wgsl");
const SAMPLING: &str = include_str!("../../shaders/atlas/sampling.wgsl");
const FILTERED: &str = include_str!("../../shaders/atlas/filtered.wgsl");

/// Texels that are bound as the texture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Texels {
    /// The pages, as floats or normalised integers.
    Pages,
    /// The unsigned integers of an image file, whose middle is distance 0. Image files hold snorm16 in place of float
    /// encodings.
    Png,
    /// The integers of the pages, in an integer format that every device has; it has no filter.
    Integers,
}

impl Texels {
    /// Converts the public name.
    pub(crate) fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("texels", name, &[("pages", Self::Pages), ("png", Self::Png), ("integers", Self::Integers)])
    }
}

/// Parameters of the text.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShaderOptions {
    pub layout: Layout,
    pub encoding: Encoding,
    pub texels: Texels,
    pub page_size: u32,
    /// Number of voxels along a side of the cubes in strips.
    pub side: u32,
}

/// Statements that call every function but the function of the filter.
const CALLS: &str = "
    var entry: AtlasEntry;
    let p = vec3f(atlas_texture_coordinates(entry, vec3f(0.0)), 0.0);
    var sum = atlas_sample(entry, p) + atlas_sample_nearest(entry, p);
";
const CALL_FILTERED: &str = "sum += atlas_sample_filtered(entry, p);\n";

/// The sampling functions of an atlas in a language.
pub(crate) fn shader(options: &ShaderOptions, language: Language) -> Result<String, Error> {
    if options.texels == Texels::Integers && !options.encoding.is_normalised() {
        let problem =
            format!("\"integers\" are those of snorm16 and snorm8, and the pages are {}", options.encoding.name());
        return Err(ArgumentError::new("texels", problem).into());
    }
    let filtered = if options.texels == Texels::Integers { "" } else { CALL_FILTERED };
    let text = text_without_entry(&wgsl(options), &format!("{CALLS}{filtered}"), language)?;
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
    let is_snorm8 = options.encoding == Encoding::Snorm8;
    let format = match (options.texels, options.encoding) {
        (Texels::Png, _) => {
            if is_snorm8 {
                "r8unorm"
            } else {
                "r16unorm"
            }
        }
        (Texels::Integers, _) => {
            if is_snorm8 {
                "r8sint"
            } else {
                "r16sint"
            }
        }
        (Texels::Pages, Encoding::Float32) => "r32float",
        (Texels::Pages, Encoding::Float16) => "r16float",
        (Texels::Pages, Encoding::Snorm16) => "r16snorm",
        (Texels::Pages, Encoding::Snorm8) => "r8snorm",
    };
    // The core of WebGPU and of WebGL 2 has no normalised formats of 16 bits.
    let feature = if format.starts_with("r16") && format.ends_with("norm") { SNORM16_FEATURE } else { "" };
    let mut text = format!(
        "// Sampling of a fieldbake atlas: layout \"{layout}\", pages of {size} x {size} texels of format {format}.\n\
         // Bind the pages as the layers of a 2D array texture. Points are in the space that a volume was baked in:\n\
         // for an instance, entry.inverse_model * world. Distances are negative inside.\n\
         {feature}\n\
         const ATLAS_PAGE_SIZE: f32 = {size}.0;\n"
    );
    if options.layout == Layout::Strips {
        // Writing to a string cannot fail.
        let _ = writeln!(text, "const ATLAS_SIDE: u32 = {}u;", options.side);
        let is_scaled = options.texels == Texels::Png || options.encoding.is_scaled();
        let _ = writeln!(text, "const ATLAS_IS_SCALED: bool = {is_scaled};");
    }
    let share = match options.texels {
        Texels::Pages => PLAIN_SHARE.to_owned(),
        Texels::Png => unsigned_share(if is_snorm8 { 8 } else { 16 }),
        Texels::Integers => signed_share(if is_snorm8 { 8 } else { 16 }),
    };
    let sampling = match options.texels {
        Texels::Integers => SAMPLING.replace("texture_2d_array<f32>", "texture_2d_array<i32>"),
        Texels::Pages | Texels::Png => format!("{SAMPLING}\n{FILTERED}"),
    };
    text + "\n" + entry + "\n" + &share + "\n" + &sampling
}

const SNORM16_FEATURE: &str = "\
// The format needs the feature TEXTURE_FORMAT_16BIT_NORM of wgpu, \"texture-formats-tier1\" of WebGPU or
// EXT_texture_norm16 of WebGL 2. texels=\"integers\" of a snorm16 atlas needs none of them.
";

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

/// The function that decodes signed integers of this many bits.
fn signed_share(bits: u32) -> String {
    let steps = (1u32 << (bits - 1)) - 1;
    format!(
        "\
// The distance of a texel as a fraction of the entry's scale: integer / {steps}.
fn atlas_share(texel: i32) -> f32 {{
    return f32(texel) / {steps}.0;
}}
"
    )
}

#[cfg(test)]
mod tests {
    use super::super::entry::{AtlasEntry, StripEntry};
    use super::*;
    use crate::shader_text::translation::parse;
    use naga::{Module, ShaderStage, front};
    use std::mem::offset_of;

    const LANGUAGES: [Language; 4] = [Language::Wgsl, Language::Glsl, Language::Hlsl, Language::Msl];
    const FUNCTIONS: [&str; 4] = ["atlas_sample", "atlas_sample_nearest", "atlas_texture_coordinates", "atlas_slice"];

    fn every_option() -> impl Iterator<Item = ShaderOptions> {
        [Layout::Strips, Layout::Shelves { gutter: 1 }].into_iter().flat_map(|layout| {
            [Texels::Pages, Texels::Png, Texels::Integers].into_iter().flat_map(move |texels| {
                let has = move |encoding: &Encoding| texels != Texels::Integers || encoding.is_normalised();
                let make = move |encoding| ShaderOptions { layout, encoding, texels, page_size: 4096, side: 64 };
                Encoding::ALL.into_iter().filter(has).map(make)
            })
        })
    }

    #[test]
    fn the_text_is_valid_and_every_language_has_every_function_with_its_comment() {
        for options in every_option() {
            parse(&wgsl(&options)).unwrap();
            for language in LANGUAGES {
                let text = shader(&options, language).unwrap();
                let has_filter = options.texels != Texels::Integers;
                assert_eq!(text.contains("atlas_sample_filtered"), has_filter);
                // GLSL joins a texture and its sampler.
                assert_eq!(text.contains("atlas_sampler"), has_filter && language != Language::Glsl);
                for function in FUNCTIONS.into_iter().chain(has_filter.then_some("atlas_sample_filtered")) {
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
            let kind = if options.texels == Texels::Integers { "isampler2DArray" } else { "sampler2DArray" };
            assert!(text.contains(&format!("uniform highp {kind} atlas_pages;")), "{text}");
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
                texels: Texels::Pages,
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
