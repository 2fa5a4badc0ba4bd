//! Kernels specialised for one shape. Each structure of its sphere-traced parts becomes a function that replaces the
//! interpreter. The closed forms contain only the kinds of leaves that occur in the shape.
//!
//! Parameters stay in a buffer, so the text depends only on the structures and kinds. Shapes that differ in parameters
//! share a pipeline, and changing a parameter compiles nothing. Parts whose structure has no function are interpreted
//! in the same dispatch.
//!
//! Unused text costs time as well: a group of invocations executes a branch if one of them does, and software adapters
//! execute all branches. lavapipe compiles at the first dispatch, so the first picture by a new kernel waits for it.

use super::shader::{HELPERS, Writer};
use crate::csg::evaluation::leaf::{KINDS_MODULE, KindSet, LeafField, kinds_text};
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use crate::csg::parts::cells::PartProgram;
use crate::csg::parts::chord::{MAX_LEAVES, PartKind};
use crate::csg::parts::part::{StructureToken, structure};
use crate::csg::parts::solid::Solid;
use crate::csg::parts::trace::Tracer;
use crate::csg::tree::kind::Op;
use crate::gpu::constants::csg_draw::{FORM_CHORDS, FORM_FIELD, FORM_UNION};
use crate::gpu::shader::shared;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Largest number of structures of a kernel. Those with the most boxes are chosen. A text with more takes seconds to
/// compile.
const MAX_STRUCTURES: usize = 32;

/// Largest number of tokens of a structure. Longer functions take seconds to compile.
const MAX_TOKENS: usize = 64;

/// The `form` of the first structure in the kernel.
const FIRST_FORM: u32 = FORM_CHORDS + 1;

/// Evaluation of a part by the kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Entry {
    /// 0: the interpreter. 1 and 2: a closed form. From 3: the function of structure `form - 3`.
    pub form: u32,
    /// Index of the first parameter of its function.
    pub parameters: u32,
}

/// A kernel specialised for one shape.
#[derive(Debug)]
pub(crate) struct SpecialisedKernel {
    /// Overrides of imported shader files, by name.
    pub texts: [(&'static str, String); 4],
    /// Number of structures with a function.
    pub structures: usize,
    /// One entry per part, in part order.
    pub entries: Vec<Entry>,
}

impl SpecialisedKernel {
    /// Generates the kernel of a shape and appends the parameters that its functions read to `numbers`.
    pub(crate) fn of(tracer: &Tracer<'_>, numbers: &mut Vec<f32>) -> Self {
        let structures = chosen(tracer);
        let program = &tracer.solid.program;
        let mut functions = vec![String::new(); structures.len()];
        let mut entries = Vec::with_capacity(tracer.programs.len());
        let mut needs = Needs::of(tracer.solid);
        for part in tracer.programs.iter() {
            let place = match part.form {
                PartKind::Field if is_short(tracer, part) => {
                    structures.get(&structure(&tracer.solid.model, &part.tokens)).copied()
                }
                _ => None,
            };
            needs.add(part, place.is_some());
            let Some(place) = place else {
                let form = match part.form {
                    PartKind::Field => FORM_FIELD,
                    PartKind::Union => FORM_UNION,
                    PartKind::Chords => FORM_CHORDS,
                };
                entries.push(Entry { form, parameters: 0 });
                continue;
            };
            let mut writer = Writer::new(&tracer.solid.model, program, "n + ");
            let value = writer.write(&part.tokens);
            entries.push(Entry { form: FIRST_FORM + place as u32, parameters: numbers.len() as u32 });
            numbers.append(&mut writer.numbers);
            if functions[place].is_empty() {
                functions[place] = function(place, &writer, &value);
            }
        }
        let shared = |name| shared(name).unwrap_or_default();
        let texts = [
            ("csg_part", parts_text(&functions, needs.interpreter)),
            ("csg_needs", needs.text()),
            ("csg_chord", needs.kinds.cases_of(shared("csg_chord"))),
            (KINDS_MODULE, kinds_text(needs.evaluated())),
        ];
        Self { texts, structures: structures.len(), entries }
    }
}

/// The features that a kernel needs for the parts of a shape. Most are derived from the shape instead of its parts,
/// because the parts may change with the parameters.
#[derive(Debug, Default)]
struct Needs {
    /// Kinds of all leaves of the shape.
    kinds: KindSet,
    /// Whether the shape has an operator other than a union.
    combines: bool,
    /// Largest number of literals of a part in closed form.
    leaves: usize,
    /// Whether a part is in closed form.
    chords: bool,
    /// Whether a part is sphere traced.
    marches: bool,
    /// Whether a sphere-traced part has no function.
    interpreter: bool,
}

impl Needs {
    fn of(solid: &Solid) -> Self {
        let tokens = &solid.model.tokens;
        // The normal form of an xor repeats leaves.
        let is_xor = |token: &Token| match token {
            Token::Combine(i) => solid.program.combines[*i as usize].op == Op::Xor,
            _ => false,
        };
        let has_xor = tokens.iter().any(is_xor);
        let with_kind = |kinds: KindSet, token: &Token| match token {
            Token::Leaf(leaf) => kinds.with(&solid.program.leaves[*leaf as usize].field),
            _ => kinds,
        };
        let is_other = |token: &Token| match token {
            Token::Combine(i) => solid.program.combines[*i as usize].op != Op::Union,
            token => matches!(token, Token::Complement),
        };
        Self {
            kinds: tokens.iter().fold(KindSet::default(), with_kind),
            combines: tokens.iter().any(is_other),
            leaves: if has_xor { MAX_LEAVES } else { Model::leaf_count(tokens) },
            ..Self::default()
        }
    }

    fn add(&mut self, part: &PartProgram, has_function: bool) {
        self.chords |= part.form != PartKind::Field;
        self.marches |= part.form == PartKind::Field;
        self.interpreter |= part.form == PartKind::Field && !has_function;
    }

    /// Kinds whose fields are evaluated by a switch: for normals, or by the interpreter.
    fn evaluated(&self) -> KindSet {
        if self.chords || self.interpreter { self.kinds } else { KindSet::default() }
    }

    fn text(&self) -> String {
        // The number is rounded up to one of a few sizes, so that shapes share kernels.
        let leaves = self.leaves.clamp(4, MAX_LEAVES).next_multiple_of(4);
        format!(
            "// Features that the parts of a shape need.

const HAS_CHORDS: bool = {};
const COMBINES_CHORDS: bool = {};
const CHORD_LEAVES: u32 = {leaves}u;
const MARCHES: bool = {};
",
            self.chords, self.combines, self.marches
        )
    }
}

/// The override of `shaders/shared/csg/csg_part.wgsl`. A kernel without the interpreter compiles and runs faster.
fn parts_text(functions: &[String], needs_interpreter: bool) -> String {
    let module = if needs_interpreter { "csg_interpreter" } else { "csg_leaves" };
    let mut text = format!(
        "// A function for each structure of a shape's parts. Their numbers begin at `n`, in the order of the text.\n\n\
         #import {module}\n"
    );
    text.push_str(HELPERS);
    text.extend(functions.iter().map(String::as_str));
    text.push_str(DISPATCH);
    for place in 0..functions.len() {
        let form = FIRST_FORM as usize + place;
        let _ = writeln!(text, "        case {form}u: {{ return structure_{place}(p, parameters); }}");
    }
    let default = if needs_interpreter { "csg_distance(p, first, count)" } else { "CSG_FAR" };
    let _ = writeln!(text, "        default: {{ return {default}; }}\n    }}\n}}");
    text
}

const DISPATCH: &str = "
fn part_distance(p: vec3f, form: u32, first: u32, count: u32, parameters: u32) -> f32 {
    switch form {
";

/// The structures that get a function, sorted. The order does not depend on parameters.
fn chosen(tracer: &Tracer<'_>) -> BTreeMap<Vec<StructureToken>, usize> {
    let mut boxes = vec![0usize; tracer.programs.len()];
    tracer.boxes.iter().for_each(|cell| boxes[cell.part as usize] += 1);
    let mut counts: BTreeMap<Vec<StructureToken>, usize> = BTreeMap::new();
    for (part, boxes) in tracer.programs.iter().zip(boxes) {
        if part.form == PartKind::Field && is_short(tracer, part) {
            *counts.entry(structure(&tracer.solid.model, &part.tokens)).or_default() += boxes;
        }
    }
    let mut most: Vec<_> = counts.into_iter().collect();
    most.sort_by_key(|(_, boxes)| std::cmp::Reverse(*boxes));
    most.truncate(MAX_STRUCTURES);
    let names: BTreeMap<_, _> = most.into_iter().collect();
    names.into_keys().enumerate().map(|(place, name)| (name, place)).collect()
}

/// Whether a part is short enough for a function of its own. Parts with baked volumes are always interpreted.
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
