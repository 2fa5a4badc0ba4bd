//! Functions for the shaders of users: WGSL without an entry point, translated with its comments and names.
//!
//! The WGSL files in `shaders/library/` and `shaders/atlas/` are the source; naga translates them to the other
//! languages. The text lacks only an entry point: together with the user's `main` it is a complete shader. naga drops
//! comments and numbers repeated names, so the comments are inserted again before the definitions that they explain,
//! and the names get back their form.

use super::translation::{GlslTarget, Language, parse, resources, translate};
use crate::error::{ArgumentError, Error, choice};
use naga::back::glsl::Version;
use naga::{Module, ShaderStage, TypeInner};
use std::collections::HashMap;

/// The bound outside the box of a stored field, with the names of [`Library::Volume`]; twin of src/volume/outside.rs.
const OUTSIDE: &str = include_str!("../../shaders/library/outside.wgsl");

/// Shader functions that evaluate stored fields or quadrics. Their constants are written in front.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Library {
    Volume,
    Sparse,
    Nested,
    Quadrics,
}

impl Library {
    /// Converts the internal name of a library.
    pub(crate) fn from_name(name: &str) -> Result<Self, ArgumentError> {
        let names = [
            ("volume", Self::Volume),
            ("sparse", Self::Sparse),
            ("nested", Self::Nested),
            ("quadrics", Self::Quadrics),
        ];
        choice("library", name, &names)
    }

    /// The WGSL text, and statements that call its functions.
    fn source(self) -> (&'static str, &'static str) {
        match self {
            Self::Volume => {
                (include_str!("../../shaders/library/stored_volume.wgsl"), "let g = field_gradient(vec3f(0.0));")
            }
            Self::Sparse => {
                (include_str!("../../shaders/library/stored_sparse.wgsl"), "let d = sparse_distance(vec3f(0.0));")
            }
            Self::Nested => {
                (include_str!("../../shaders/library/stored_nested.wgsl"), "let d = nested_distance(vec3f(0.0));")
            }
            Self::Quadrics => (
                include_str!("../../shaders/library/stored_quadrics.wgsl"),
                "let q = load_quadric(0);
                let t = intersect_quadric(q, vec3f(0.0), vec3f(0.0), 0.0);
                let n = quadric_normal(q, vec3f(t), vec3f(0.0));",
            ),
        }
    }

    /// Prefix of the names of a stored field.
    fn prefix(self) -> Option<&'static str> {
        match self {
            Self::Volume => Some("field"),
            Self::Sparse => Some("sparse"),
            Self::Nested => Some("nested"),
            Self::Quadrics => None,
        }
    }

    /// The text in a language. `head` is WGSL: a comment, and the constants and textures that the functions read.
    pub(crate) fn text(self, head: &str, language: Language) -> Result<String, Error> {
        let (functions, calls) = self.source();
        let outside = self.prefix().map(|prefix| {
            let renamed = OUTSIDE.replace("field_", &format!("{prefix}_"));
            format!("\n{}", renamed.replace("FIELD_", &format!("{}_", prefix.to_uppercase())))
        });
        text_without_entry(&format!("{head}\n{functions}{}", outside.unwrap_or_default()), calls, language)
    }
}

/// GLSL ES 3.00, the language of WebGL 2. Newer desktop versions accept it with another first line.
const GLSL: GlslTarget = GlslTarget {
    version: Version::Embedded { version: 300, is_webgl: true },
    stage: ShaderStage::Fragment,
    entry_point: "entry_point",
};

/// The text of WGSL functions in a language. `calls` are statements that call every function that should remain.
pub(crate) fn text_without_entry(wgsl: &str, calls: &str, language: Language) -> Result<String, Error> {
    if language == Language::Wgsl {
        return Ok(wgsl.to_owned());
    }
    let complete = format!("{wgsl}\n@fragment fn entry_point() {{\n{calls}\n}}\n");
    let translated = translate(&complete, language, GLSL)?;
    let (module, _) = parse(&complete)?;
    let plain = match language {
        Language::Wgsl => translated,
        Language::Glsl => plain_glsl(&translated, &module),
        Language::Hlsl => plain_hlsl(&translated, &module),
        Language::Msl => before(&translated, "fragment void entry_point"),
    };
    Ok(with_comments(&plain_names(&plain), wgsl))
}

/// GLSL has no separate samplers, and naga generates names for the textures.
fn plain_glsl(text: &str, module: &Module) -> String {
    let mut text = before(text, "void main()");
    for (binding, variable) in resources(module) {
        let generated = format!("_group_{}_binding_{}_fs", binding.group, binding.binding);
        text = text.replace(&generated, variable.name.as_deref().unwrap_or(&generated));
    }
    text
}

/// naga reads samplers from a heap of its own. Here each sampler has a register.
fn plain_hlsl(text: &str, module: &Module) -> String {
    let is_heap = |line: &str| line.starts_with("Sampler") || line.contains("SamplerIndexArray");
    let mut samplers = String::new();
    let is_sampler = |ty| matches!(module.types[ty].inner, TypeInner::Sampler { .. });
    for (i, (_, sampler)) in resources(module).filter(|(_, variable)| is_sampler(variable.ty)).enumerate() {
        samplers += &format!("SamplerState {} : register(s{i});\n", sampler.name.as_deref().unwrap_or("unnamed"));
    }
    let mut plain = String::new();
    for line in before(text, "void entry_point").lines().filter(|line| !is_heap(line)) {
        plain = plain + line + "\n";
        if line.starts_with("Texture") {
            plain += &std::mem::take(&mut samplers);
        }
    }
    plain
}

/// The text before the entry point.
fn before(text: &str, entry: &str) -> String {
    text.find(entry).map_or(text, |end| &text[..end]).trim_end().to_owned() + "\n"
}

/// Gives names back their plain form. naga appends numbers to names that occur in several functions, as in `p_2`. The
/// number is removed in a function where the name has only one. If a name with an underscore at the end occurs in the
/// text, the language reserves the name, and it keeps its number.
fn plain_names(text: &str) -> String {
    let mut plain = String::new();
    let mut function = String::new();
    for line in text.lines() {
        function = function + line + "\n";
        // The last line of a definition is not indented, and neither are those between definitions.
        if !line.starts_with([' ', '\t', '{']) && !line.ends_with(['{', ',', '(']) && !line.ends_with(')') {
            plain += &plain_function(&function, text);
            function.clear();
        }
    }
    plain + &plain_function(&function, text)
}

fn plain_function(function: &str, text: &str) -> String {
    let mut numbers: HashMap<&str, Vec<&str>> = HashMap::new();
    for word in function.split(|c| !is_word(c)) {
        if let Some(name) = without_number(word) {
            let forms = numbers.entry(name).or_default();
            if !forms.contains(&word) {
                forms.push(word);
            }
        }
    }
    let has_word = |text: &str, word: &str| text.split(|c| !is_word(c)).any(|other| other == word);
    numbers.retain(|name, forms| forms.len() == 1 && !has_word(function, name) && !has_word(text, &format!("{name}_")));
    let mut plain = String::new();
    let mut rest = function;
    while let Some(start) = rest.find(is_word) {
        let (between, word) = rest.split_at(start);
        let (word, after) = word.split_at(word.find(|c| !is_word(c)).unwrap_or(word.len()));
        let name = without_number(word).filter(|name| numbers.contains_key(name));
        plain = plain + between + name.unwrap_or(word);
        rest = after;
    }
    plain + rest
}

/// The part of `name_12` before the number.
fn without_number(word: &str) -> Option<&str> {
    let (name, number) = word.rsplit_once('_')?;
    let is_number = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
    (is_number && name.starts_with(|c: char| c.is_ascii_alphabetic())).then_some(name)
}

fn is_word(c: char) -> bool {
    c.is_ascii_alphanumeric() || c == '_'
}

/// Inserts the comments of the WGSL text before the definitions in its translation, and its header at the top.
fn with_comments(translated: &str, wgsl: &str) -> String {
    let head: String = wgsl.lines().take_while(|line| line.starts_with("//")).flat_map(|line| [line, "\n"]).collect();
    let comments = comments(wgsl);
    let mut text = String::new();
    let mut lines = translated.lines().skip_while(|line| line.is_empty()).peekable();
    // A version or an include must remain in the first lines.
    while let Some(line) = lines.next_if(|line| line.starts_with('#') || line.starts_with("//")) {
        text = text + line + "\n";
    }
    text = text + &head + "\n";
    let mut lines = lines.skip_while(|line| line.is_empty()).peekable();
    while let Some(line) = lines.next() {
        if let Some((_, comment)) = comments.iter().find(|(name, _)| defines(line, name)) {
            text += comment;
        }
        // Several empty lines become one.
        if !(line.is_empty() && lines.peek().is_none_or(|next| next.is_empty())) {
            text = text + line + "\n";
        }
    }
    text
}

/// Name and comment of each function, struct, constant and texture of a WGSL text.
fn comments(wgsl: &str) -> Vec<(&str, String)> {
    let mut found = Vec::new();
    let mut pending = String::new();
    for line in wgsl.lines() {
        if line.starts_with("//") {
            pending = pending + line + "\n";
            continue;
        }
        let definition = ["fn ", "struct ", "const "].into_iter().find_map(|word| line.strip_prefix(word));
        let definition = definition
            .or_else(|| line.starts_with("@group").then(|| line.split_once("var ")).flatten().map(|split| split.1));
        if let Some(name) = definition.and_then(|rest| rest.split(|c| !is_word(c)).next()) {
            found.push((name, pending.clone()));
        }
        pending.clear();
    }
    found
}

/// Whether a line of a C-like text begins the definition of a function, struct, constant or texture.
fn defines(line: &str, name: &str) -> bool {
    let is_outside = !line.starts_with([' ', '\t']);
    let is_function = line.contains(&format!(" {name}(")) && !line.ends_with(';');
    let is_variable = [" = ", ";", " : register"].iter().any(|end| line.contains(&format!(" {name}{end}")));
    is_outside && (is_function || is_variable || line.starts_with(&format!("struct {name} ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = "\
// A field.

// Voxels along x, y and z.
const FIELD_SHAPE: vec3i = vec3i(4, 5, 6);
// Lower corner.
const FIELD_LOWER: vec3f = vec3f(0.0, 0.0, 0.0);
// Size of a voxel.
const FIELD_SPACING: vec3f = vec3f(1.0, 1.0, 1.0);
// Scale.
const FIELD_SCALE: f32 = 1.0;
// Box of the surface.
const FIELD_INNER_LOWER: vec3f = vec3f(1.0, 1.0, 1.0);
const FIELD_INNER_UPPER: vec3f = vec3f(2.0, 2.0, 2.0);
// Whether the samples surround it.
const FIELD_SURROUNDS_SURFACE: bool = true;
// Samples of the bound.
const FIELD_BOUND_FIRST: vec3f = vec3f(0.5, 0.5, 0.5);
const FIELD_BOUND_STEP: vec3f = vec3f(1.0, 1.0, 1.0);
const FIELD_BOUND_LAST: vec3i = vec3i(3, 4, 5);
// The samples.
@group(0) @binding(0) var field_texels: texture_3d<f32>;
";

    #[test]
    fn every_language_has_the_functions_with_their_comments_and_names() {
        for language in [Language::Wgsl, Language::Glsl, Language::Hlsl, Language::Msl] {
            let text = Library::Volume.text(HEAD, language).unwrap();
            let lines: Vec<&str> = text.lines().collect();
            for name in ["field_voxel", "field_slice", "field_bound", "field_distance", "field_gradient"] {
                let defines = |line: &&str| !line.starts_with(' ') && line.contains(&format!(" {name}("));
                let at = lines.iter().position(defines).unwrap();
                assert!(lines[at - 1].starts_with("// "), "{language:?} {name}: {}", lines[at - 1]);
            }
            assert!(text.contains("// A field.\n") && text.contains("// Size of a voxel.\n"), "{text}");
            assert!(!text.contains("entry_point") && !text.contains("_group_0"), "{text}");
            assert!(!text.contains(" p_1") && !text.contains("\n\n\n"), "{text}");
        }
    }

    #[test]
    fn names_keep_numbers_that_distinguish_them() {
        let text = "float f(float p_1) {\n    return p_1;\n}\nfloat g(float p_2, float p_3) {\n    return p_2 - p_3;\n}\n\
                    float h(float far_1) {\n    return far_1;\n}\nfloat far_;\n";
        assert_eq!(plain_names(text), text.replace("p_1", "p"));
    }
}
