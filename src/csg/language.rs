//! The s-expressions of "SDF Decomposition" (A. Palecek, 2021) and of the author's Tangerine: sizes are full lengths and
//! diameters, angles degrees, round things stand along z.
//!
//! ```text
//! shape     = ( name number... shape... )          ; a comment runs to the end of the line
//! brushes     sphere d | ellipsoid dx dy dz | box w l h | cube s | torus D d | cylinder d h | cone d h
//!             coninder d_low d_high h | plane nx ny nz [offset] | and ours: rounded-box w l h r | box-frame w l h t
//!             capped-torus D d degrees | capsule d h | pyramid base h | octahedron d | hex-prism d h | gyroid cell t
//!             extrude h PROFILE | revolve offset PROFILE ; PROFILE = (circle d) (rectangle w h) (polygon x y x y ...)
//! operators   union | inter | diff | xor, and (blend union k a b ...), (chamfer union k a b ...); blend-union k a b ...
//! modifiers   move x y z | move-x x | rotate qx qy qz qw | rotate-x degrees | scale s | flate r | align x y z
//!             shell t | elongate x y z | mirror x y z | reflect x y z | repeat x y z nx ny nz | twist deg | bend deg | not
//!             paint COLOR | paint-over COLOR | stencil COLOR subject mask | mask COLOR subject mask
//!             ; COLOR = r g b from 0 to 1, linear, or #rrggbb
//! ```
//!
//! Names may be written with `-` or `_`; `'` before a parenthesis is skipped. The reader keeps its own stack, so nesting is
//! limited by memory alone.

use super::align::aligned;
use super::primitive::Primitive;
use super::profile::Profile;
use super::shape::{Blend, Kind, Op, Shape};
use crate::error::ShapeError;
use glam::{DQuat, DVec3};
use std::fmt::Write;
use std::sync::Arc;

/// A place in the text, from 1.
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
enum Word<'a> {
    Open,
    Close,
    Atom(&'a str),
}

/// A form that is being read.
struct Form<'a> {
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
pub fn parse(text: &str) -> Result<Shape, ShapeError> {
    let mut open: Vec<Form<'_>> = Vec::new();
    let mut found: Option<Shape> = None;
    let mut words = Words { rest: text, at: Position { line: 1, column: 1 } };
    while let Some((word, at)) = words.next_word() {
        if found.is_some() {
            return Err(at.error("the shape ends before this; put several into (union ...)"));
        }
        match word {
            Word::Open => open.push(Form {
                start: at,
                name: None,
                numbers: Vec::new(),
                words: Vec::new(),
                shapes: Vec::new(),
                profiles: Vec::new(),
            }),
            Word::Close => {
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
            Word::Atom(atom) => {
                let form = open.last_mut().ok_or_else(|| at.error(format!("expected '(', got {}", quoted(atom))))?;
                form.take(atom, at)?;
            }
        }
    }
    if let Some(form) = open.last() {
        return Err(form.start.error(format!("this '(' is never closed ({} are open at the end)", open.len())));
    }
    found.ok_or_else(|| words.at.error("expected a shape such as (sphere 1), the text is empty"))
}

/// At most forty characters of what came.
fn quoted(atom: &str) -> String {
    let short: String = atom.chars().take(40).collect();
    format!("'{short}{}'", if short.len() < atom.len() { "..." } else { "" })
}

struct Words<'a> {
    rest: &'a str,
    at: Position,
}

impl<'a> Words<'a> {
    fn next_word(&mut self) -> Option<(Word<'a>, Position)> {
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
                    return Some((Word::Open, at));
                }
                ')' => {
                    self.skip(1);
                    return Some((Word::Close, at));
                }
                c if c.is_whitespace() || c == '\'' || c == ',' => self.skip(c.len_utf8()),
                _ => {
                    let is_end = |c: char| c.is_whitespace() || matches!(c, '(' | ')' | ';' | ',');
                    let end = self.rest.find(is_end).unwrap_or(self.rest.len());
                    let atom = &self.rest[..end];
                    self.skip(end);
                    return Some((Word::Atom(atom), at));
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

impl<'a> Form<'a> {
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
            ("polygon", numbers) if numbers.len() % 2 == 0 => Profile::polygon(numbers.as_chunks().0),
            ("circle", _) => return Err(self.start.error("circle takes a diameter")),
            ("rectangle", _) => return Err(self.start.error("rectangle takes a width and a height")),
            ("polygon", _) => return Err(self.start.error("polygon takes pairs of numbers")),
            _ => return Ok(None),
        };
        if !self.shapes.is_empty() || !self.profiles.is_empty() {
            return Err(self.start.error(format!("{name} takes numbers only")));
        }
        Ok(Some(profile))
    }

    fn shape(&self, written: &str) -> Result<Shape, ShapeError> {
        let name = written.replace('-', "_");
        let n = self.numbers.as_slice();

        // Operators, with their joint.
        let (joint, op) = match (name.as_str(), self.words.as_slice()) {
            ("blend" | "chamfer", &[op]) => (name.as_str(), op),
            ("blend" | "chamfer", _) => {
                let problem = format!("{written} takes union, inter, diff or xor, a width, and shapes");
                return Err(self.start.error(problem));
            }
            (_, &[word, ..]) => return Err(self.start.error(format!("{written} does not take {}", quoted(word)))),
            (whole, &[]) => match whole.split_once('_') {
                Some((joint @ ("blend" | "chamfer"), op)) => (joint, op),
                _ => ("sharp", whole),
            },
        };
        let op = match op {
            "union" => Some(Op::Union),
            "inter" | "intersection" => Some(Op::Intersection),
            "diff" | "difference" => Some(Op::Difference),
            "xor" => Some(Op::Xor),
            _ => None,
        };
        if let Some(op) = op {
            let blend = match (joint, n) {
                ("sharp", &[]) => Blend::Sharp,
                ("blend", &[k]) => Blend::new(k, 0.0)?,
                ("chamfer", &[k]) => Blend::new(0.0, k)?,
                ("sharp", _) => return Err(self.start.error(format!("{written} takes shapes only, not numbers"))),
                _ => return Err(self.start.error(format!("{written} takes one width before its shapes"))),
            };
            self.expect_shapes(written, 1, usize::MAX)?;
            return Shape::combine(op, blend, self.shapes.clone());
        }
        if joint != "sharp" {
            return Err(self.start.error(format!("{written} takes union, inter, diff or xor, a width, and shapes")));
        }

        // Brushes: full lengths and diameters.
        let primitive = match (name.as_str(), n) {
            ("sphere", &[d]) => Some(Primitive::named("sphere", &[0.5 * d])),
            ("ellipsoid", &[x, y, z]) => Some(Primitive::named("ellipsoid", &[0.5 * x, 0.5 * y, 0.5 * z])),
            ("box", &[x, y, z]) => Some(Primitive::named("box", &[x, y, z])),
            ("cube", &[side]) => Some(Primitive::named("box", &[side, side, side])),
            ("torus", &[outer, tube]) => Some(Primitive::named("torus", &[0.5 * (outer - tube), 0.5 * tube])),
            ("cylinder", &[d, h]) => Some(Primitive::named("cylinder", &[0.5 * d, h])),
            ("cone", &[d, h]) => Some(Primitive::named("cone", &[0.5 * d, 0.0, h])),
            ("coninder" | "cylicone", &[low, high, h]) => Some(Primitive::named("cone", &[0.5 * low, 0.5 * high, h])),
            ("plane", &[x, y, z]) => Some(Primitive::named("plane", &[x, y, z, 0.0])),
            ("plane", &[x, y, z, offset]) => Some(Primitive::named("plane", &[x, y, z, offset])),
            ("rounded_box", &[x, y, z, r]) => Some(Primitive::named("rounded_box", &[x, y, z, r])),
            ("box_frame", &[x, y, z, t]) => Some(Primitive::named("box_frame", &[x, y, z, t])),
            ("capped_torus", &[outer, tube, angle]) => {
                Some(Primitive::named("capped_torus", &[0.5 * (outer - tube), 0.5 * tube, angle]))
            }
            ("capsule", &[d, h]) => Some(Primitive::named("capsule", &[0.5 * d, h])),
            ("pyramid", &[base, h]) => Some(Primitive::named("pyramid", &[base, h])),
            ("octahedron", &[d]) => Some(Primitive::named("octahedron", &[0.5 * d])),
            ("hex_prism", &[d, h]) => Some(Primitive::named("hex_prism", &[0.5 * d, h])),
            ("gyroid", &[cell, t]) => Some(Primitive::named("gyroid", &[cell, t])),
            _ => None,
        };
        if let Some(primitive) = primitive {
            self.expect_shapes(written, 0, 0)?;
            return Ok(Shape::primitive(primitive?));
        }
        if let ("extrude" | "revolve", &[number]) = (name.as_str(), n) {
            let [profile] = self.profiles.as_slice() else {
                return Err(self
                    .start
                    .error(format!("{written} takes a number and one of circle, rectangle, polygon")));
            };
            self.expect_shapes_alone(written, 0, 0)?;
            return if name == "extrude" {
                Shape::extrude(profile.clone(), number)
            } else {
                Shape::revolve(profile.clone(), number)
            };
        }

        // Modifiers.
        let (name, numbers): (&str, Vec<f64>) = match (name.as_str(), n) {
            ("move", &[x, y, z]) => ("translate", vec![x, y, z]),
            ("move_x", &[x]) => ("translate", vec![x, 0.0, 0.0]),
            ("move_y", &[y]) => ("translate", vec![0.0, y, 0.0]),
            ("move_z", &[z]) => ("translate", vec![0.0, 0.0, z]),
            ("rotate_x", &[degrees]) => ("rotate", vec![1.0, 0.0, 0.0, degrees]),
            ("rotate_y", &[degrees]) => ("rotate", vec![0.0, 1.0, 0.0, degrees]),
            ("rotate_z", &[degrees]) => ("rotate", vec![0.0, 0.0, 1.0, degrees]),
            ("rotate", &[x, y, z, w]) => {
                let largest = [x, y, z, w].into_iter().map(f64::abs).fold(0.0, f64::max);
                if largest == 0.0 {
                    return Err(self.start.error("the quaternion of rotate is zero"));
                }
                let turn = DQuat::from_xyzw(x / largest, y / largest, z / largest, w / largest).normalize();
                let (axis, angle) = turn.to_axis_angle();
                ("rotate", vec![axis.x, axis.y, axis.z, angle.to_degrees()])
            }
            ("flate", &[r]) => ("offset", vec![r]),
            ("not", &[]) => ("complement", Vec::new()),
            (name @ ("align" | "mask" | "stencil"), n) if n.len() == 3 => (name, n.to_vec()),
            (
                name @ ("scale" | "shell" | "elongate" | "mirror" | "reflect" | "repeat" | "twist" | "bend" | "paint"
                | "paint_over"),
                n,
            ) => {
                // Lengths are full ones: what is inserted on each side is half of it.
                let half = if name == "elongate" { 0.5 } else { 1.0 };
                (name, n.iter().map(|x| half * x).collect())
            }
            (
                known @ ("sphere" | "ellipsoid" | "box" | "cube" | "torus" | "cylinder" | "cone" | "coninder"
                | "cylicone" | "plane" | "rounded_box" | "box_frame" | "capped_torus" | "capsule" | "pyramid"
                | "octahedron" | "hex_prism" | "gyroid" | "extrude" | "revolve" | "move" | "move_x" | "move_y"
                | "move_z" | "rotate" | "rotate_x" | "rotate_y" | "rotate_z" | "flate" | "not" | "align"
                | "mask" | "stencil"),
                n,
            ) => {
                let problem = format!(
                    "{} does not take {} number{}",
                    known.replace('_', "-"),
                    n.len(),
                    if n.len() == 1 { "" } else { "s" }
                );
                return Err(self.start.error(problem));
            }
            _ => return Err(self.start.error(format!("{} is no brush, operator or modifier", quoted(written)))),
        };
        match name {
            "align" => {
                self.expect_shapes(written, 1, 1)?;
                aligned(&self.shapes[0], DVec3::new(numbers[0], numbers[1], numbers[2]))
            }
            "stencil" | "mask" => {
                self.expect_shapes(written, 2, 2)?;
                let color = [numbers[0], numbers[1], numbers[2]];
                self.shapes[0].stencil(&self.shapes[1], color, name == "mask")
            }
            _ => {
                self.expect_shapes(written, 1, 1)?;
                self.shapes[0].changed(name, &numbers).map_err(|error| match error {
                    ShapeError::Argument { argument: "name", .. } => {
                        self.start.error(format!("{written} does not take {} numbers", n.len()))
                    }
                    other => other,
                })
            }
        }
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
        let wanted = match (least, most) {
            (_, 0) => "no shape".to_owned(),
            (1, 1) => "one shape".to_owned(),
            (least, usize::MAX) => format!("at least {least}"),
            (least, _) => format!("{least} shapes"),
        };
        Err(self.start.error(format!("{name} takes {wanted}, got {got}")))
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
pub fn to_sexpr(shape: &Shape) -> Result<String, ShapeError> {
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
        let mut flat: Vec<&Shape> = shape.children().iter().rev().collect();
        while let Some(first) = flat.last().copied()
            && matches!(shape.kind(), Kind::Combine { blend: Blend::Sharp, .. })
            && first.kind() == shape.kind()
        {
            flat.pop();
            flat.extend(first.children().iter().rev());
        }
        for child in flat {
            steps.push(Step::Visit(child));
            steps.push(Step::Text(" "));
        }
    }
    Ok(out)
}

/// Name and numbers.
fn head(kind: &Kind, out: &mut String) -> Result<(), ShapeError> {
    let mut put = |name: &str, numbers: &[f64]| {
        out.push_str(name);
        for number in numbers {
            // The shortest text that reads back as the same number. Writing to a string cannot fail.
            let _ = write!(out, " {}", number + 0.0);
        }
    };
    match kind {
        Kind::Primitive(primitive) => match primitive {
            Primitive::Sphere { radius } => put("sphere", &[2.0 * radius]),
            Primitive::Ellipsoid { radii } => put("ellipsoid", &(2.0 * *radii).to_array()),
            Primitive::Box { half, rounding: 0.0 } if half.x == half.y && half.y == half.z => {
                put("cube", &[2.0 * half.x])
            }
            Primitive::Box { half, rounding: 0.0 } => put("box", &(2.0 * *half).to_array()),
            Primitive::Box { half, rounding } => {
                let [x, y, z] = (2.0 * *half).to_array();
                put("rounded-box", &[x, y, z, *rounding]);
            }
            Primitive::BoxFrame { half, thickness } => {
                let [x, y, z] = (2.0 * *half).to_array();
                put("box-frame", &[x, y, z, *thickness]);
            }
            Primitive::Torus { radius, tube } => put("torus", &[2.0 * (radius + tube), 2.0 * tube]),
            Primitive::CappedTorus { radius, tube, half_angle } => {
                put("capped-torus", &[2.0 * (radius + tube), 2.0 * tube, 2.0 * half_angle.to_degrees()]);
            }
            Primitive::Cylinder { radius, half_height } => put("cylinder", &[2.0 * radius, 2.0 * half_height]),
            Primitive::Capsule { radius, half_height } => put("capsule", &[2.0 * radius, 2.0 * half_height]),
            Primitive::Cone { low, high: 0.0, half_height } => put("cone", &[2.0 * low, 2.0 * half_height]),
            Primitive::Cone { low, high, half_height } => {
                put("coninder", &[2.0 * low, 2.0 * high, 2.0 * half_height]);
            }
            Primitive::Plane { normal, offset: 0.0 } => put("plane", &normal.to_array()),
            Primitive::Plane { normal, offset } => put("plane", &[normal.x, normal.y, normal.z, *offset]),
            Primitive::Pyramid { half_base, half_height } => put("pyramid", &[2.0 * half_base, 2.0 * half_height]),
            Primitive::Octahedron { radius } => put("octahedron", &[2.0 * radius]),
            Primitive::HexPrism { apothem, half_height } => {
                put("hex-prism", &[2.0 * apothem / 0.75f64.sqrt(), 2.0 * half_height]);
            }
            Primitive::Gyroid { cell, thickness } => put("gyroid", &[*cell, *thickness]),
            Primitive::Extrude { profile, half_height } => {
                put("extrude", &[2.0 * half_height]);
                profile_text(profile, out);
            }
            Primitive::Revolve { profile, offset } => {
                put("revolve", &[*offset]);
                profile_text(profile, out);
            }
            Primitive::Volume(_) => {
                let problem = "holds a baked volume, which s-expressions have no words for";
                return Err(ShapeError::argument("shape", problem));
            }
        },
        Kind::Combine { op, blend } => {
            let name = match op {
                Op::Union => "union",
                Op::Intersection => "inter",
                Op::Difference => "diff",
                Op::Xor => "xor",
            };
            match blend {
                Blend::Sharp => put(name, &[]),
                Blend::Smooth(k) => put(&format!("blend {name}"), &[*k]),
                Blend::Chamfer(k) => put(&format!("chamfer {name}"), &[*k]),
            }
        }
        Kind::Move(by) => put("move", &by.to_array()),
        Kind::Rotate { axis, degrees } if *axis == DVec3::X => put("rotate-x", &[*degrees]),
        Kind::Rotate { axis, degrees } if *axis == DVec3::Y => put("rotate-y", &[*degrees]),
        Kind::Rotate { axis, degrees } if *axis == DVec3::Z => put("rotate-z", &[*degrees]),
        Kind::Rotate { axis, degrees } => {
            let turn = DQuat::from_axis_angle(*axis, degrees.rem_euclid(720.0).to_radians());
            put("rotate", &turn.to_array());
        }
        Kind::Scale(factor) => put("scale", &[*factor]),
        Kind::Offset(distance) => put("flate", &[*distance]),
        Kind::Shell(thickness) => put("shell", &[*thickness]),
        Kind::Complement => put("not", &[]),
        Kind::Elongate(half) => put("elongate", &(2.0 * *half).to_array()),
        Kind::Reflect(normal) => put("reflect", &normal.to_array()),
        Kind::Mirror(normal) => put("mirror", &normal.to_array()),
        Kind::Repeat { spacing, counts } => {
            let [nx, ny, nz] = counts.map(f64::from);
            put("repeat", &[spacing.x, spacing.y, spacing.z, nx, ny, nz]);
        }
        Kind::Twist(degrees) => put("twist", &[*degrees]),
        Kind::Bend(degrees) => put("bend", &[*degrees]),
        Kind::Paint { color, over } => {
            put(if *over { "paint-over" } else { "paint" }, &color.map(f64::from));
        }
        Kind::Stencil { color, outside } => put(if *outside { "mask" } else { "stencil" }, &color.map(f64::from)),
    }
    Ok(())
}

fn profile_text(profile: &Profile, out: &mut String) {
    // Writing to a string cannot fail.
    let _ = match profile {
        Profile::Circle { radius } => write!(out, " (circle {})", 2.0 * radius),
        Profile::Rectangle { half } => write!(out, " (rectangle {} {})", 2.0 * half.x, 2.0 * half.y),
        Profile::Polygon { corners, .. } => {
            out.push_str(" (polygon");
            for corner in corners {
                let _ = write!(out, " {} {}", corner.x + 0.0, corner.y + 0.0);
            }
            out.write_str(")")
        }
    };
}
