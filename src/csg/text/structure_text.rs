//! The field of a whole shape as a WGSL function, for kernels that evaluate several shapes.
//!
//! As in [`super::specialised_kernel`], the text follows from the structure alone, and the parameters are in an array:
//! shapes that differ in parameters share a function.

use super::shader::{HELPERS, Writer};
use crate::csg::evaluation::leaf::LeafField;
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use crate::csg::parts::solid::Solid;
use std::fmt::Write;

/// Largest number of tokens of a shape. Drivers inline the function at each call, and longer ones compile for minutes.
const MAX_TOKENS: usize = 64;

/// Largest number of parameters of a shape, most of which are the tables of polygons: 256 KiB.
const MAX_NUMBERS: usize = 1 << 16;

/// The field of a shape at `p0`, local units. Its parameters start at index `n` of an array.
#[derive(Debug)]
pub(crate) struct StructureText {
    pub body: String,
    pub numbers: Vec<f32>,
    /// The body of the function of its paint, whose numbers follow the others; it returns linear RGB.
    pub color: Option<String>,
}

impl StructureText {
    /// None for a shape that is too large for a function, or that contains a baked volume.
    pub(crate) fn of(solid: &Solid, array: &str, turns: &str) -> Option<Self> {
        let is_volume = |token: &Token| match token {
            Token::Leaf(leaf) => matches!(solid.program.leaves[*leaf as usize].field, LeafField::Volume(..)),
            _ => false,
        };
        let tokens = &solid.model.tokens;
        if tokens.len() > MAX_TOKENS || Model::leaf_count(tokens) == 0 || tokens.iter().any(is_volume) {
            return None;
        }
        let mut writer = Writer::new(&solid.model, &solid.program, "n + ");
        let value = writer.write(tokens);
        if writer.numbers.len() > MAX_NUMBERS {
            return None;
        }
        let mut body = String::new();
        if !writer.loops.is_empty() {
            let _ = writeln!(body, "    {turns} += {};", writer.loops.join(" + "));
        }
        let _ = writeln!(body, "{}    return {value};", writer.body);
        let mut colors = Writer::new(&solid.model, &solid.program, "n + ");
        let color = colors.write_color(tokens, writer.numbers.clone()).map(|color| {
            writer.numbers = colors.numbers;
            in_array(&format!("{}    return {color};\n", colors.body), array)
        });
        Some(Self { body: in_array(&body, array), numbers: writer.numbers, color })
    }

    /// Helper functions for the generated ones, besides the primitives of `shaders/shared/csg/csg_field.wgsl`.
    pub(crate) fn helpers(array: &str) -> String {
        in_array(HELPERS, array)
    }
}

fn in_array(text: &str, array: &str) -> String {
    text.replace("numbers[", &format!("{array}["))
}
