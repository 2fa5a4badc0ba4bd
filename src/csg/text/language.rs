//! The s-expressions of "SDF Decomposition" (A. Palecek, 2021) and of the author's program Tangerine. Sizes are full
//! lengths and diameters, angles are in degrees, and round primitives have z as their axis.
//!
//! ```text
//! shape     = ( word number... shape... )          ; a comment runs to the end of its line
//! shapes      the rows of the table of primitives (primitive.rs), and extrude h PROFILE | revolve offset PROFILE
//!             | extrude h taper chamfer chamfer PROFILE          ; chamfers of the lower and of the upper end
//!             ; PROFILE = (circle d) | (rectangle w h) | (polygon x y x y ...) | (polygons (polygon ...) ...)
//! operators   union | inter | diff | xor, and (blend union k a b ...), (chamfer union k a b ...);
//!             blend-union k a b ...
//! modifiers   the rows of MODIFIERS, and rotate qx qy qz qw | align x y z | stencil COLOR subject mask
//!             | mask COLOR subject mask           ; COLOR = r g b from 0 to 1, linear, or #rrggbb
//! ```
//!
//! Names may be written with `-` or `_`; `'` before a parenthesis is skipped. The reader keeps its own stack, so
//! nesting is limited by memory alone.

use crate::csg::model::align::aligned;
use crate::csg::tree::kind::{Blend, Kind, Op};
use crate::csg::tree::language_table::{NumberSource, Word};
use crate::csg::tree::placement::is_coordinate_axis;
use crate::csg::tree::primitive::{Primitive, WORDS};
use crate::csg::tree::profile::Profile;
use crate::csg::tree::region::{Region, Rule};
use crate::csg::tree::shape::Shape;
use crate::error::ShapeError;
use glam::{DQuat, DVec3};
use std::fmt::Write;
use std::sync::Arc;

/// Words of the operators; the first word of each is written.
const OPERATORS: [(&str, Op); 6] = [
    ("union", Op::Union),
    ("inter", Op::Intersection),
    ("intersection", Op::Intersection),
    ("diff", Op::Difference),
    ("difference", Op::Difference),
    ("xor", Op::Xor),
];

const fn modifier(word: &'static str, operation: &'static str, slots: &'static [NumberSource]) -> Word {
    Word { word, operation, slots }
}

/// Forms that change one shape; the first form that can express a change is written.
const MODIFIERS: &[Word] = {
    use NumberSource::{Full, Half, One, Zero};
    &[
        modifier("move", "translate", &[Full("x"), Full("y"), Full("z")]),
        modifier("move-x", "translate", &[Full("x"), Zero, Zero]),
        modifier("move-y", "translate", &[Zero, Full("y"), Zero]),
        modifier("move-z", "translate", &[Zero, Zero, Full("z")]),
        modifier("rotate-x", "rotate", &[One, Zero, Zero, Full("degrees")]),
        modifier("rotate-y", "rotate", &[Zero, One, Zero, Full("degrees")]),
        modifier("rotate-z", "rotate", &[Zero, Zero, One, Full("degrees")]),
        modifier("scale", "scale", &[Full("s")]),
        modifier("flate", "offset", &[Full("r")]),
        modifier("shell", "shell", &[Full("t")]),
        modifier("times", "times", &[Full("factor")]),
        modifier("not", "complement", &[]),
        modifier("elongate", "elongate", &[Half("x"), Half("y"), Half("z")]),
        modifier("mirror", "mirror", &[Full("x"), Full("y"), Full("z")]),
        modifier("reflect", "reflect", &[Full("x"), Full("y"), Full("z")]),
        modifier("repeat", "repeat", &[Full("x"), Full("y"), Full("z"), Full("nx"), Full("ny"), Full("nz")]),
        modifier("twist", "twist", &[Full("degrees")]),
        modifier("bend", "bend", &[Full("degrees")]),
        modifier("paint", "paint", &[Full("r"), Full("g"), Full("b")]),
        modifier("paint-over", "paint_over", &[Full("r"), Full("g"), Full("b")]),
    ]
};

/// Usage of the forms that no table lists, for messages.
const OTHER_USAGES: [(&str, &str); 7] = [
    ("extrude", "(extrude h PROFILE)"),
    ("extrude", "(extrude h taper chamfer chamfer PROFILE)"),
    ("revolve", "(revolve offset PROFILE)"),
    ("rotate", "(rotate qx qy qz qw)"),
    ("align", "(align x y z)"),
    ("stencil", "(stencil COLOR subject mask)"),
    ("mask", "(mask COLOR subject mask)"),
];

/// A position in the text, counted from 1.
#[derive(Debug, Clone, Copy)]
struct Position {
    line: usize,
    column: usize,
}

impl Position {
    fn error(self, problem: impl Into<String>) -> ShapeError {
        ShapeError::Syntax { line: self.line, column: self.column, problem: problem.into() }
    }
}

#[derive(Debug)]
enum Lexeme<'a> {
    Open,
    Close,
    Atom(&'a str),
}

/// A form that is being read.
struct ReadForm<'a> {
    start: Position,
    name: Option<&'a str>,
    numbers: Vec<f64>,
    words: Vec<&'a str>,
    shapes: Vec<Shape>,
    profiles: Vec<Arc<Profile>>,
}

enum Value {
    Shape(Shape),
    Profile(Arc<Profile>),
}

/// Read one shape.
pub(crate) fn parse(text: &str) -> Result<Shape, ShapeError> {
    let mut open: Vec<ReadForm<'_>> = Vec::new();
    let mut found: Option<Shape> = None;
    let mut lexer = Lexer { rest: text, at: Position { line: 1, column: 1 } };
    while let Some((lexeme, at)) = lexer.next_lexeme() {
        if found.is_some() {
            return Err(at.error("the shape ends before this; put several into (union ...)"));
        }
        match lexeme {
            Lexeme::Open => open.push(ReadForm {
                start: at,
                name: None,
                numbers: Vec::new(),
                words: Vec::new(),
                shapes: Vec::new(),
                profiles: Vec::new(),
            }),
            Lexeme::Close => {
                let form = open.pop().ok_or_else(|| at.error("this ')' closes nothing"))?;
                match (form.finish()?, open.last_mut()) {
                    (Value::Shape(shape), None) => found = Some(shape),
                    (Value::Shape(shape), Some(outer)) => outer.shapes.push(shape),
                    (Value::Profile(profile), Some(outer)) => outer.profiles.push(profile),
                    (Value::Profile(_), None) => {
                        return Err(at.error("a flat profile is no solid; put it into (extrude height ...)"));
                    }
                }
            }
            Lexeme::Atom(atom) => {
                let form = open.last_mut().ok_or_else(|| at.error(format!("expected '(', got {}", quoted(atom))))?;
                form.take(atom, at)?;
            }
        }
    }
    if let Some(form) = open.last() {
        return Err(form.start.error(format!("this '(' is never closed ({} are open at the end)", open.len())));
    }
    found.ok_or_else(|| lexer.at.error("expected a shape such as (sphere 1), the text is empty"))
}

/// The first forty characters of an unexpected atom.
fn quoted(atom: &str) -> String {
    let short: String = atom.chars().take(40).collect();
    format!("'{short}{}'", if short.len() < atom.len() { "..." } else { "" })
}

struct Lexer<'a> {
    rest: &'a str,
    at: Position,
}

impl<'a> Lexer<'a> {
    fn next_lexeme(&mut self) -> Option<(Lexeme<'a>, Position)> {
        loop {
            let c = self.rest.chars().next()?;
            let at = self.at;
            match c {
                ';' => {
                    let end = self.rest.find('\n').unwrap_or(self.rest.len());
                    self.skip(end);
                }
                '(' => {
                    self.skip(1);
                    return Some((Lexeme::Open, at));
                }
                ')' => {
                    self.skip(1);
                    return Some((Lexeme::Close, at));
                }
                c if c.is_whitespace() || c == '\'' || c == ',' => self.skip(c.len_utf8()),
                _ => {
                    let is_end = |c: char| c.is_whitespace() || matches!(c, '(' | ')' | ';' | ',');
                    let end = self.rest.find(is_end).unwrap_or(self.rest.len());
                    let atom = &self.rest[..end];
                    self.skip(end);
                    return Some((Lexeme::Atom(atom), at));
                }
            }
        }
    }

    fn skip(&mut self, bytes: usize) {
        let (passed, rest) = self.rest.split_at(bytes);
        for c in passed.chars() {
            if c == '\n' {
                self.at = Position { line: self.at.line + 1, column: 1 };
            } else {
                self.at.column += 1;
            }
        }
        self.rest = rest;
    }
}

impl<'a> ReadForm<'a> {
    fn take(&mut self, atom: &'a str, at: Position) -> Result<(), ShapeError> {
        if self.name.is_none() {
            self.name = Some(atom);
        } else if let Some(rgb) = atom.strip_prefix('#') {
            self.numbers.extend(
                hex_color(rgb).ok_or_else(|| at.error(format!("{} is no colour such as #ff8800", quoted(atom))))?,
            );
        } else if atom.starts_with(|c: char| c.is_ascii_digit() || matches!(c, '-' | '+' | '.')) {
            let number = atom.parse::<f64>().ok().filter(|number| number.is_finite());
            self.numbers.push(number.ok_or_else(|| at.error(format!("{} is no number", quoted(atom))))?);
        } else if self.numbers.is_empty() && self.words.is_empty() && self.shapes.is_empty() {
            self.words.push(atom);
        } else {
            return Err(at.error(format!("expected a number or '(', got {}", quoted(atom))));
        }
        Ok(())
    }

    fn finish(self) -> Result<Value, ShapeError> {
        let start = self.start;
        let located = |error: ShapeError| match error {
            ShapeError::Argument { argument, problem } => {
                start.error(format!("in ({}: {argument} {problem}", self.name.unwrap_or_default()))
            }
            other => other,
        };
        let Some(name) = self.name else {
            return Err(start.error("expected a name after '(', such as sphere or union"));
        };
        if self.words.is_empty()
            && let Some(profile) = self.profile(name)?
        {
            return profile.map(|profile| Value::Profile(Arc::new(profile))).map_err(located);
        }
        self.shape(name).map(Value::Shape).map_err(located)
    }

    fn profile(&self, name: &str) -> Result<Option<Result<Profile, ShapeError>>, ShapeError> {
        let profile = match (name, self.numbers.as_slice()) {
            ("circle", &[diameter]) => Profile::circle(0.5 * diameter),
            ("rectangle", &[w, h]) => Profile::rectangle([w, h]),
            ("polygon", numbers) if numbers.len() % 2 == 0 => Profile::polygon(&[numbers.as_chunks().0], Rule::EvenOdd),
            ("polygons", &[]) => return self.polygons().map(Some),
            ("circle", _) => return Err(self.start.error("circle takes a diameter")),
            ("rectangle", _) => return Err(self.start.error("rectangle takes a width and a height")),
            ("polygon", _) => return Err(self.start.error("polygon takes pairs of numbers")),
            ("polygons", _) => return Err(self.start.error("polygons takes polygons, not numbers")),
            _ => return Ok(None),
        };
        if !self.shapes.is_empty() || !self.profiles.is_empty() {
            return Err(self.start.error(format!("{name} takes numbers only")));
        }
        Ok(Some(profile))
    }

    /// Several polygons as one profile, by the even-odd rule.
    fn polygons(&self) -> Result<Result<Profile, ShapeError>, ShapeError> {
        let mut loops = Vec::new();
        for profile in &self.profiles {
            let Profile::Polygon(region) = &**profile else {
                return Err(self.start.error("polygons takes polygons only"));
            };
            loops.extend(region.loops.iter().cloned());
        }
        if !self.shapes.is_empty() {
            return Err(self.start.error("polygons takes polygons only"));
        }
        Ok(Region::new(loops, Rule::EvenOdd).map(|region| Profile::Polygon(Arc::new(region))))
    }

    fn shape(&self, written: &str) -> Result<Shape, ShapeError> {
        let name = written.replace('_', "-");
        let n = self.numbers.as_slice();
        if let Some(combined) = self.combined(written, &name)? {
            return Ok(combined);
        }
        if let ("extrude", &[_] | &[_, _, _, _]) | ("revolve", &[_]) = (name.as_str(), n) {
            let [profile] = self.profiles.as_slice() else {
                return Err(self
                    .start
                    .error(format!("{written} takes a number and one of circle, rectangle, polygon")));
            };
            self.expect_shapes_alone(written, 0, 0)?;
            return match (name.as_str(), n) {
                ("extrude", &[height, taper, low, high]) => Shape::extrude(profile.clone(), height, taper, [low, high]),
                ("extrude", _) => Shape::extrude(profile.clone(), n[0], 0.0, [0.0; 2]),
                _ => Shape::revolve(profile.clone(), n[0]),
            };
        }
        if let Some((operation, arguments)) = arguments_of(WORDS, &name, n) {
            self.expect_shapes(written, 0, 0)?;
            return Primitive::named(operation, &arguments).map(Shape::primitive);
        }
        if let Some((operation, arguments)) = arguments_of(MODIFIERS, &name, n) {
            self.expect_shapes(written, 1, 1)?;
            return self.shapes[0].changed(operation, &arguments);
        }
        match (name.as_str(), n) {
            ("rotate", &[x, y, z, w]) => self.rotated(written, [x, y, z, w]),
            ("align", &[x, y, z]) => {
                self.expect_shapes(written, 1, 1)?;
                aligned(&self.shapes[0], DVec3::new(x, y, z))
            }
            ("stencil" | "mask", &[r, g, b]) => {
                self.expect_shapes(written, 2, 2)?;
                self.shapes[0].stencil(&self.shapes[1], [r, g, b], name == "mask")
            }
            (name, n) => Err(self.unknown(written, name, n)),
        }
    }

    /// The shape turned by a quaternion.
    fn rotated(&self, written: &str, [x, y, z, w]: [f64; 4]) -> Result<Shape, ShapeError> {
        let largest = [x, y, z, w].into_iter().map(f64::abs).fold(0.0, f64::max);
        if largest == 0.0 {
            return Err(self.start.error("the quaternion of rotate is zero"));
        }
        self.expect_shapes(written, 1, 1)?;
        let turn = DQuat::from_xyzw(x / largest, y / largest, z / largest, w / largest);
        if turn.xyz() == DVec3::ZERO || is_coordinate_axis(turn.xyz()) {
            let (axis, angle) = turn.normalize().to_axis_angle();
            return self.shapes[0].changed("rotate", &[axis.x, axis.y, axis.z, angle.to_degrees()]);
        }
        // A quaternion that has unit length but for rounding keeps its bits, so that a written shape is the
        // same when it is read.
        let written = DQuat::from_xyzw(x, y, z, w);
        let is_unit = (written.length_squared() - 1.0).abs() <= 8.0 * f64::EPSILON;
        let turn = if is_unit { written } else { turn.normalize() };
        self.shapes[0].changed("turn", &turn.to_array())
    }

    /// The error for a name without a form for these numbers.
    fn unknown(&self, written: &str, name: &str, n: &[f64]) -> ShapeError {
        let rows = WORDS.iter().chain(MODIFIERS).filter(|row| row.word == name).map(Word::usage);
        let others = OTHER_USAGES.iter().filter(|(word, _)| *word == name).map(|(_, usage)| (*usage).to_owned());
        let usages: Vec<String> = rows.chain(others).collect();
        if usages.is_empty() {
            return self.start.error(format!("{} is no shape, operator or modifier", quoted(written)));
        }
        let s = if n.len() == 1 { "" } else { "s" };
        let problem = format!("{name} does not take {} number{s}, expected {}", n.len(), usages.join(" or "));
        self.start.error(problem)
    }

    /// The shapes under an operator with its joint; None if the form has another name.
    fn combined(&self, written: &str, name: &str) -> Result<Option<Shape>, ShapeError> {
        let n = self.numbers.as_slice();
        let usage = || Err(self.start.error(format!("{written} takes union, inter, diff or xor, a width, and shapes")));
        let (joint, op) = match (name, self.words.as_slice()) {
            ("blend" | "chamfer", &[op]) => (name, op),
            ("blend" | "chamfer", _) => return usage(),
            (_, &[word, ..]) => return Err(self.start.error(format!("{written} does not take {}", quoted(word)))),
            (whole, &[]) => match whole.split_once('-') {
                Some((joint @ ("blend" | "chamfer"), op)) => (joint, op),
                _ => ("sharp", whole),
            },
        };
        if let Some(&(_, op)) = OPERATORS.iter().find(|(word, _)| *word == op) {
            let blend = match (joint, n) {
                ("sharp", &[]) => Blend::Sharp,
                ("blend", &[k]) => Blend::new(k, 0.0)?,
                ("chamfer", &[k]) => Blend::new(0.0, k)?,
                ("sharp", _) => return Err(self.start.error(format!("{written} takes shapes only, not numbers"))),
                _ => return Err(self.start.error(format!("{written} takes one width before its shapes"))),
            };
            self.expect_shapes(written, 1, usize::MAX)?;
            return Shape::combine(op, blend, self.shapes.clone()).map(Some);
        }
        if joint == "sharp" { Ok(None) } else { usage() }
    }

    fn expect_shapes(&self, name: &str, least: usize, most: usize) -> Result<(), ShapeError> {
        if !self.profiles.is_empty() {
            return Err(self
                .start
                .error(format!("{name} takes solids; put the flat profile into (extrude height ...)")));
        }
        self.expect_shapes_alone(name, least, most)
    }

    fn expect_shapes_alone(&self, name: &str, least: usize, most: usize) -> Result<(), ShapeError> {
        let got = self.shapes.len();
        if (least..=most).contains(&got) {
            return Ok(());
        }
        let expected = match (least, most) {
            (_, 0) => "no shape".to_owned(),
            (1, 1) => "one shape".to_owned(),
            (least, usize::MAX) => format!("at least {least}"),
            (least, _) => format!("{least} shapes"),
        };
        Err(self.start.error(format!("{name} takes {expected}, got {got}")))
    }
}

/// Linear RGB of six hexadecimal digits of sRGB.
fn hex_color(digits: &str) -> Option<[f64; 3]> {
    let digits = digits.strip_prefix('x').unwrap_or(digits);
    if digits.len() != 6 || !digits.is_ascii() {
        return None;
    }
    let mut rgb = [0.0; 3];
    for (i, channel) in rgb.iter_mut().enumerate() {
        let value = f64::from(u8::from_str_radix(&digits[2 * i..2 * i + 2], 16).ok()?) / 255.0;
        *channel = if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) };
    }
    Some(rgb)
}

/// Write a shape so that [`parse`] reads it back. A volume has no words in the language.
pub(crate) fn to_sexpr(shape: &Shape) -> Result<String, ShapeError> {
    enum Step<'a> {
        Visit(&'a Shape),
        Text(&'static str),
    }
    let mut out = String::new();
    let mut steps = vec![Step::Visit(shape)];
    while let Some(step) = steps.pop() {
        let shape = match step {
            Step::Text(text) => {
                out.push_str(text);
                continue;
            }
            Step::Visit(shape) => shape,
        };
        out.push('(');
        head(shape.kind(), &mut out)?;
        steps.push(Step::Text(")"));
        // An operator over the same sharp operator is written as one, from the left.
        for child in shape.operands() {
            steps.push(Step::Visit(child));
            steps.push(Step::Text(" "));
        }
    }
    Ok(out)
}

/// Writes the word and the numbers of a node.
fn head(kind: &Kind, out: &mut String) -> Result<(), ShapeError> {
    let mut put = |words: &[&str], numbers: &[f64]| {
        out.push_str(&words.join(" "));
        for number in numbers {
            // The shortest text that reads back as the same number. Writing to a string cannot fail.
            let _ = write!(out, " {}", number + 0.0);
        }
    };
    match kind {
        Kind::Primitive(Primitive::Extrude { profile, half_height, ends }) => {
            let [low, high] = ends.chamfer;
            let numbers = [2.0 * half_height, ends.taper.to_degrees(), low, high];
            put(&["extrude"], if ends.is_plain() { &numbers[..1] } else { &numbers });
            profile_text(profile, out);
        }
        Kind::Primitive(Primitive::Revolve { profile, offset }) => {
            put(&["revolve"], &[*offset]);
            profile_text(profile, out);
        }
        Kind::Primitive(primitive) => {
            let form = primitive.arguments().and_then(|(name, arguments)| form_of(WORDS, name, &arguments));
            let Some((word, numbers)) = form else {
                let problem = "contains a baked volume, which cannot be written as an s-expression";
                return Err(ShapeError::argument("shape", problem));
            };
            put(&[word], &numbers);
        }
        Kind::Combine { op, blend } => {
            let word = OPERATORS.iter().find(|(_, known)| known == op).map_or("", |(word, _)| *word);
            match blend {
                Blend::Sharp => put(&[word], &[]),
                Blend::Smooth(k) => put(&["blend", word], &[*k]),
                Blend::Chamfer(k) => put(&["chamfer", word], &[*k]),
            }
        }
        Kind::Stencil { color, outside } => {
            put(&[if *outside { "mask" } else { "stencil" }], &color.map(f64::from));
        }
        change => match change.change().and_then(|(name, arguments)| form_of(MODIFIERS, name, &arguments)) {
            Some((word, numbers)) => put(&[word], &numbers),
            // A rotation about any axis is a quaternion.
            None => {
                if let Kind::Turn(turn) = change {
                    put(&["rotate"], &turn.to_array());
                }
            }
        },
    }
    Ok(())
}

/// The operation and the arguments of a form.
fn arguments_of(rows: &[Word], word: &str, numbers: &[f64]) -> Option<(&'static str, Vec<f64>)> {
    let mut rows = rows.iter().filter(|row| row.word == word);
    rows.find_map(|row| Some((row.operation, row.arguments(numbers)?)))
}

/// The word and the numbers of the first form that expresses an operation.
fn form_of(rows: &[Word], operation: &str, arguments: &[f64]) -> Option<(&'static str, Vec<f64>)> {
    let mut rows = rows.iter().filter(|row| row.operation == operation);
    rows.find_map(|row| Some((row.word, row.numbers(arguments)?)))
}

fn profile_text(profile: &Profile, out: &mut String) {
    // Writing to a string cannot fail.
    let _ = match profile {
        Profile::Circle { radius } => write!(out, " (circle {})", 2.0 * radius),
        Profile::Rectangle { half } => write!(out, " (rectangle {} {})", 2.0 * half.x, 2.0 * half.y),
        Profile::Polygon(region) => {
            let is_one = region.loops.len() == 1;
            out.push_str(if is_one { "" } else { " (polygons" });
            for corners in &region.loops {
                out.push_str(" (polygon");
                for corner in corners {
                    let _ = write!(out, " {} {}", corner.x + 0.0, corner.y + 0.0);
                }
                out.push(')');
            }
            out.write_str(if is_one { "" } else { ")" })
        }
    };
}
