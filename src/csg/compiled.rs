//! A kernel written for a shape: a function for each structure of its parts, instead of the interpreter.
//!
//! Numbers stay in a buffer, so the text follows from the set of structures alone, and shapes that differ in numbers share a
//! pipeline: a changed parameter compiles nothing. A part whose structure is not in the text is interpreted, in the same
//! dispatch; parts that are met in closed form need no function.
//!
//! lavapipe compiles at the first dispatch and not before: there the first picture by a new kernel waits for it.

use super::chord::Form;
use super::decompose::{StructureToken, structure};
use super::model::Token;
use super::program::LeafField;
use super::shader::{HELPERS, Writer};
use super::trace::{PartProgram, Tracer};
use std::collections::BTreeMap;
use std::fmt::Write;

/// Structures of a kernel at most: those with the most boxes. More make a text that takes seconds to compile.
const MAX_STRUCTURES: usize = 32;

/// Tokens of a structure at most, for the same reason.
const MAX_TOKENS: usize = 64;

/// The form of the first structure, as the kernel counts them.
const FIRST_FORM: u32 = 3;

/// What the kernel knows of a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Entry {
    /// 0 for the interpreter, 1 and 2 for closed forms, then the structures.
    pub form: u32,
    /// The first of its numbers.
    pub parameters: u32,
}

/// The text in place of `shaders/shared/csg_part.wgsl`, and its numbers.
#[derive(Debug)]
pub struct Compiled {
    pub text: String,
    pub structures: usize,
    pub entries: Vec<Entry>,
}

/// Write the functions for the parts that are marched, and append their numbers to `numbers`.
pub fn compiled(tracer: &Tracer<'_>, numbers: &mut Vec<f32>) -> Compiled {
    let structures = chosen(tracer);
    // Without the interpreter the kernel is smaller: faster to compile, and to run.
    let mut needs_interpreter = false;
    let mut functions = vec![String::new(); structures.len()];
    let mut entries = Vec::with_capacity(tracer.programs.len());
    for part in tracer.programs.iter() {
        let form = match part.form {
            Form::Field => 0,
            Form::Union => 1,
            Form::Chords => 2,
        };
        let known = (form == 0 && is_short(tracer, part))
            .then(|| structures.get(&structure(&tracer.solid.model, &part.tokens)))
            .flatten();
        let Some(&place) = known else {
            needs_interpreter |= form == 0;
            entries.push(Entry { form, parameters: 0 });
            continue;
        };
        let mut writer = Writer::new(&tracer.solid.model, &tracer.solid.program, "n + ");
        let value = writer.write(&part.tokens);
        entries.push(Entry { form: FIRST_FORM + place as u32, parameters: numbers.len() as u32 });
        numbers.append(&mut writer.numbers);
        if functions[place].is_empty() {
            functions[place] = function(place, &writer, &value);
        }
    }

    let mut text = HEADER.to_owned();
    text.push_str(HELPERS);
    text.extend(functions);
    text.push_str(DISPATCH);
    for place in 0..structures.len() {
        let form = FIRST_FORM as usize + place;
        let _ = writeln!(text, "        case {form}u: {{ return structure_{place}(p, parameters); }}");
    }
    let default = if needs_interpreter { "csg_distance(p, first, count)" } else { "CSG_FAR" };
    let _ = writeln!(text, "        default: {{ return {default}; }}\n    }}\n}}");
    Compiled { text, structures: structures.len(), entries }
}

const HEADER: &str =
    "// A function for each structure of a shape's parts. Their numbers begin at `n`, in the order of the text.

#import csg_interpreter

const FORM_UNION: u32 = 1u;
const FORM_CHORDS: u32 = 2u;
";

const DISPATCH: &str = "
fn part_distance(p: vec3f, form: u32, first: u32, count: u32, parameters: u32) -> f32 {
    switch form {
";

/// The structures that get a function, by the order of their names, which does not depend on numbers.
fn chosen(tracer: &Tracer<'_>) -> BTreeMap<Vec<StructureToken>, usize> {
    let mut boxes = vec![0usize; tracer.programs.len()];
    tracer.boxes.iter().for_each(|cell| boxes[cell.part as usize] += 1);
    let mut counts: BTreeMap<Vec<StructureToken>, usize> = BTreeMap::new();
    for (part, boxes) in tracer.programs.iter().zip(boxes) {
        if part.form == Form::Field && is_short(tracer, part) {
            *counts.entry(structure(&tracer.solid.model, &part.tokens)).or_default() += boxes;
        }
    }
    let mut most: Vec<_> = counts.into_iter().collect();
    most.sort_by_key(|(_, boxes)| std::cmp::Reverse(*boxes));
    most.truncate(MAX_STRUCTURES);
    let names: BTreeMap<_, _> = most.into_iter().collect();
    names.into_keys().enumerate().map(|(place, name)| (name, place)).collect()
}

/// Whether a part is worth a function. A baked volume is read by the interpreter.
fn is_short(tracer: &Tracer<'_>, part: &PartProgram) -> bool {
    let is_volume = |token: &Token| match token {
        Token::Leaf(leaf) => {
            matches!(tracer.solid.program.leaves[*leaf as usize].field, LeafField::Volume(..))
        }
        _ => false,
    };
    part.tokens.len() <= MAX_TOKENS && !part.tokens.iter().any(is_volume)
}

fn function(place: usize, writer: &Writer<'_>, value: &str) -> String {
    let mut text = format!("\nfn structure_{place}(p0: vec3f, n: u32) -> f32 {{\n");
    if !writer.loops.is_empty() {
        let _ = writeln!(text, "    rounds += {};", writer.loops.join(" + "));
    }
    let _ = write!(text, "{}    return {value};\n}}\n", writer.body);
    text
}
