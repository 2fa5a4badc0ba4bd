//! The field of a whole shape as a WGSL function, for kernels that ask several shapes at once.
//!
//! As in [`super::compiled`] the text follows from the structure alone, and the numbers are an array's: shapes that differ in
//! numbers share a function.

use super::leaf::LeafField;
use super::model::{Model, Token};
use super::shader::{HELPERS, Writer};
use super::solid::Solid;
use std::fmt::Write;

/// Tokens of a shape at most: drivers put the function in place of each of its calls, and longer ones compile for minutes.
const MAX_TOKENS: usize = 64;

/// Numbers of a shape at most. Each corner of a polygon is a turn of a loop, and software adapters stop an invocation after
/// 65,535 turns.
const MAX_NUMBERS: usize = 4096;

/// The field of a shape, local units, at `p0`, its numbers being those from place `n` of an array.
#[derive(Debug)]
pub struct Whole {
    pub body: String,
    pub numbers: Vec<f32>,
}

impl Whole {
    /// None for a shape that is too large for a function, or that holds a baked volume.
    pub fn of(solid: &Solid, array: &str, turns: &str) -> Option<Self> {
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
        Some(Self { body: in_array(&body, array), numbers: writer.numbers })
    }

    /// What the functions call besides the primitives of `shaders/shared/csg_field.wgsl`.
    pub fn helpers(array: &str) -> String {
        in_array(HELPERS, array)
    }
}

fn in_array(text: &str, array: &str) -> String {
    text.replace("numbers[", &format!("{array}["))
}
