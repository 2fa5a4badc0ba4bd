//! The field of a shape as readable WGSL, and in the other shading languages through naga.
//!
//! The text follows from the structure alone. Parameters are read from a buffer, so shapes that differ in parameters
//! share one text and one pipeline. [`ShapeShader::numbers`] is the content of that buffer. Positions are in world
//! units.

use crate::csg::evaluation::leaf::{Flat, LeafField};
use crate::csg::evaluation::program::{Joint, LocalFrame, PlacedDistanceOp, PlacedWarpKind, Program};
use crate::csg::model::lowered::{Leaf, Model};
use crate::csg::model::token::Token;
use crate::csg::parts::part::{StructureToken, structure};
use crate::csg::parts::solid::Solid;
use crate::csg::tree::kind::Op;
use crate::csg::tree::placement::{WarpKind, by_number};
use crate::csg::tree::primitive::{PARAMETERS, Primitive};
use crate::error::ShapeError;
use crate::gpu::shader::shared;
use crate::shader_text::translation::{GlslTarget, Language, translate};
use glam::DVec3;
use naga::ShaderStage;
use naga::back::glsl::Version;
use std::fmt::Write;
use std::iter::successors;

/// OpenGL 4.3 and OpenGL ES 3.1 have compute shaders.
const GLSL: GlslTarget =
    GlslTarget { version: Version::Desktop(430), stage: ShaderStage::Compute, entry_point: "main" };

/// A shader for the field of a shape.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct ShapeShader {
    pub wgsl: String,
    /// Parameters in the order in which the text reads them, world units.
    pub numbers: Vec<f32>,
}

impl ShapeShader {
    /// The text in a shading language.
    pub(crate) fn text(&self, language: Language) -> Result<String, ShapeError> {
        Ok(translate(&self.wgsl, language, GLSL)?)
    }
}

/// The whole shape as one function.
pub(crate) fn shader(solid: &Solid) -> Result<ShapeShader, ShapeError> {
    let model = &solid.model;
    for leaf in &model.leaves {
        if let Primitive::Volume(_) = leaf.primitive {
            let problem = "holds a baked volume, which needs a texture; draw it with raymarch, or sample its atlas";
            return Err(ShapeError::argument("shape", problem));
        }
    }
    // World units: nothing is moved or scaled.
    let program = Program::<f32>::new(model, LocalFrame { center: DVec3::ZERO, scale: 1.0 });
    let mut writer = Writer::new(model, &program, "");
    let value = writer.write(&model.tokens);
    let _ = writeln!(writer.body, "    return {value};");

    let mut wgsl = String::from(
        "// The signed distance to a shape, negative inside. Its numbers are read from `numbers`, in order, so that shapes of\n\
         // the same structure share this text.\n\n",
    );
    wgsl.push_str("@group(0) @binding(0) var<storage, read> numbers: array<f32>;\n");
    wgsl.push_str("// World positions, and where their distances go.\n");
    wgsl.push_str("@group(0) @binding(1) var<storage, read> points: array<vec4f>;\n");
    wgsl.push_str("@group(0) @binding(2) var<storage, read_write> distances: array<f32>;\n\n");
    wgsl.push_str(shared("csg_field").unwrap_or_default());
    wgsl.push_str(HELPERS);
    let _ = write!(wgsl, "\nfn distance_to_shape(p0: vec3f) -> f32 {{\n{}}}\n", writer.body);
    wgsl.push_str(ENTRY);
    Ok(ShapeShader { wgsl, numbers: writer.numbers })
}

/// Helper functions that the generated function calls besides the primitives.
pub(crate) const HELPERS: &str = "
// A position in the space of a leaf, whose placement is the twelve numbers from `i`.
fn place_at(p: vec3f, i: u32) -> vec3f {
    return vec3f(
        dot(vec3f(numbers[i], numbers[i + 1u], numbers[i + 2u]), p) + numbers[i + 3u],
        dot(vec3f(numbers[i + 4u], numbers[i + 5u], numbers[i + 6u]), p) + numbers[i + 7u],
        dot(vec3f(numbers[i + 8u], numbers[i + 9u], numbers[i + 10u]), p) + numbers[i + 11u],
    );
}

// The six numbers from `i`.
fn six(i: u32) -> array<f32, 6> {
    return array<f32, 6>(
        numbers[i], numbers[i + 1u], numbers[i + 2u], numbers[i + 3u], numbers[i + 4u], numbers[i + 5u],
    );
}

// The nearest of the edges that are nearest to a point of the cell of the grid, whose tables begin at `i`.
fn polygon_at(at: vec2f, i: u32) -> f32 {
    let cell = (at - vec2f(numbers[i], numbers[i + 1u])) * numbers[i + 2u];
    let list = edge_list(cell, vec2f(numbers[i + 3u], numbers[i + 4u]));
    let end = u32(numbers[i + 7u + list]);
    var nearest = vec3f(CSG_FAR, 0.0, 0.0);
    for (var c = u32(numbers[i + 6u + list]); c < end; c++) {
        let e = i + u32(numbers[i + 5u]) + 8u * u32(numbers[i + c]);
        let ends = vec4f(numbers[e], numbers[e + 1u], numbers[e + 2u], numbers[e + 3u]);
        let normals = vec4f(numbers[e + 4u], numbers[e + 5u], numbers[e + 6u], numbers[e + 7u]);
        let found = edge_beside(at, ends, normals);
        if found.x < nearest.x { nearest = found; }
    }
    return signed_edge_distance(nearest);
}
";

const ENTRY: &str = "
@compute @workgroup_size(64)
fn main(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= arrayLength(&distances) { return; }
    distances[id.x] = distance_to_shape(points[id.x].xyz);
}
";

/// Generates the statements of a function.
pub(crate) struct Writer<'a> {
    model: &'a Model,
    program: &'a Program<f32>,
    pub body: String,
    pub numbers: Vec<f32>,
    /// Prefix of indices into the buffer of parameters: empty, or the name of a variable and a plus sign.
    base: &'static str,
    /// Numbers of iterations of the loops in an evaluation, as expressions.
    pub loops: Vec<String>,
    /// Depth of the open spaces: `p0` is the outermost.
    depth: usize,
    names: usize,
    /// Colours of the values on the stack, as expressions; `None` where colours are not written.
    colors: Option<Vec<Option<String>>>,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(model: &'a Model, program: &'a Program<f32>, base: &'static str) -> Self {
        let (body, numbers, loops) = Default::default();
        Self { model, program, body, numbers, base, loops, depth: 1, names: 0, colors: None }
    }

    /// Generates the statements for the field of tokens and for their paint, which calls `mixed_color`. Returns the
    /// name of the colour; `None` if nothing is painted, or if the colour depends on a stencil or mask. The parameters
    /// are appended to `numbers`.
    pub(crate) fn write_color(&mut self, tokens: &[Token], numbers: Vec<f32>) -> Option<String> {
        let is_masked = |leaf: &Leaf| {
            successors(leaf.paint.as_deref(), |coat| coat.above.as_deref()).any(|coat| coat.mask.is_some())
        };
        if !self.model.is_painted || self.model.leaves.iter().any(is_masked) {
            return None;
        }
        self.numbers = numbers;
        self.colors = Some(Vec::new());
        self.write(tokens);
        self.colors.take()?.pop()?
    }

    /// The colour of a leaf without masks: the outermost coat that covers the coats below, else the innermost, decides.
    fn paint(&mut self, leaf: u32) {
        let Some(mut colors) = self.colors.take() else { return };
        let mut color = None;
        for coat in successors(self.model.leaves[leaf as usize].paint.as_deref(), |coat| coat.above.as_deref()) {
            if color.is_none() || coat.over {
                color = Some(coat.color);
            }
        }
        colors.push(color.map(|rgb| {
            let rgb = rgb.map(|x| self.number(x)).join(", ");
            self.statement("c", &format!("vec3f({rgb})"), "paint")
        }));
        self.colors = Some(colors);
    }

    /// The colour of a combination; twin of `color` in src/csg/evaluation/program.rs.
    fn combine_colors(&mut self, op: Op, is_smooth: bool, is_swapped: bool, a: &str, b: &str, width: &str) {
        let Some(mut colors) = self.colors.take() else { return };
        let (top, below) = (colors.pop().flatten(), colors.pop().flatten());
        let (first, second) = if is_swapped { (top, below) } else { (below, top) };
        colors.push(match (first, second) {
            (Some(first), Some(second)) => {
                let (a, b) = match op {
                    Op::Union => (a.to_owned(), b.to_owned()),
                    Op::Intersection => (format!("-{a}"), format!("-{b}")),
                    Op::Difference => (format!("-{a}"), b.to_owned()),
                    Op::Xor => (format!("abs({a})"), format!("abs({b})")),
                };
                let width = if is_smooth { width } else { "0.0" };
                Some(self.statement("c", &format!("mixed_color({a}, {b}, {first}, {second}, {width})"), ""))
            }
            (first, second) => first.or(second),
        });
        self.colors = Some(colors);
    }

    /// Generates the statements for tokens; returns the name of the value.
    pub(crate) fn write(&mut self, tokens: &[Token]) -> String {
        let kinds = structure(self.model, tokens);
        let mut stack: Vec<String> = Vec::new();
        let mut spaces = vec!["p0".to_owned()];
        for (&token, kind) in tokens.iter().zip(kinds) {
            let p = spaces.last().cloned().unwrap_or_default();
            match (token, kind) {
                (Token::Leaf(leaf), _) => {
                    let call = self.leaf(leaf, &p);
                    let name = self.statement("d", &call, "");
                    self.paint(leaf);
                    stack.push(name);
                }
                (Token::Combine(i), StructureToken::Combine { op, is_swapped, joint }) => {
                    let (top, below) = (stack.pop().unwrap_or_default(), stack.pop().unwrap_or_default());
                    let (a, b) = if is_swapped { (top, below) } else { (below, top) };
                    let width = match self.program.combines[i as usize].joint {
                        Joint::Sharp => "0.0".to_owned(),
                        Joint::Smooth(k, _) | Joint::Chamfer(k) => self.number(k),
                    };
                    let is_smooth = matches!(self.program.combines[i as usize].joint, Joint::Smooth(..));
                    self.combine_colors(op, is_smooth, is_swapped, &a, &b, &width);
                    let call = joined(op, joint, &a, &b, &width);
                    let name = self.statement("d", &call, &format!("{joint} {}", op.name()));
                    stack.push(name);
                }
                (Token::DistanceOp(i), _) => {
                    let d = stack.pop().unwrap_or_default();
                    let (call, what) = match self.program.levels[i as usize] {
                        PlacedDistanceOp::Offset(distance) => (format!("{d} - {}", self.number(distance)), "offset"),
                        PlacedDistanceOp::Shell(half) => (format!("abs({d}) - {}", self.number(half)), "shell"),
                        PlacedDistanceOp::Times(factor) => (format!("{d} * {}", self.number(factor)), "times"),
                    };
                    let name = self.statement("d", &call, what);
                    stack.push(name);
                }
                (Token::Enter(i), _) => {
                    let (inside, stretch) = self.enter(i, &p);
                    stack.push(stretch);
                    spaces.push(inside);
                    self.depth += 1;
                }
                (Token::Leave(_), _) => {
                    let d = stack.pop().unwrap_or_default();
                    let stretch = stack.pop().unwrap_or_default();
                    spaces.pop();
                    self.depth -= 1;
                    let name = self.statement("d", &format!("{d} / {stretch}"), "back from the warp");
                    stack.push(name);
                }
                _ => {
                    let d = stack.pop().unwrap_or_default();
                    let name = self.statement("d", &format!("-{d}"), "complement");
                    stack.push(name);
                }
            }
        }
        stack.pop().unwrap_or_else(|| "CSG_FAR".to_owned())
    }

    /// Generates the statements that enter a warp at the position `p`. Returns the expressions of the position inside
    /// it, and of the divisor of its distances.
    fn enter(&mut self, i: u32, p: &str) -> (String, String) {
        let warp = self.program.warps[i as usize];
        let at = self.placement(&warp.rows, warp.shift);
        let what = match self.model.warps[i as usize].kind {
            WarpKind::Elongate(_) => "elongate",
            WarpKind::Twist(_) => "twist",
            WarpKind::Bend(_) => "bend",
            WarpKind::NearestCopy(_) => "the nearest copy",
        };
        let place = self.statement("q", &format!("place_at({p}, {at})"), &format!("the space of {what}"));
        let call = match warp.kind {
            PlacedWarpKind::Elongate(half) => {
                let half = half.map(|x| self.number(x)).join(", ");
                format!("{place} - clamp({place}, -vec3f({half}), vec3f({half}))")
            }
            PlacedWarpKind::Twist(rate) => {
                format!("turned_about_z({place}, -{} * {place}.z)", self.number(rate))
            }
            PlacedWarpKind::Bend(rate) => {
                format!("turned_about_z({place}, -{} * {place}.x)", self.number(rate))
            }
            PlacedWarpKind::NearestCopy(axes) => {
                let vectors = by_number(&axes).map(|v| v.map(|x| self.number(x)).join(", "));
                format!("nearest_copy({place}, {})", vectors.map(|v| format!("vec3f({v})")).join(", "))
            }
        };
        let inside = self.statement("q", &call, "");
        // The divisor, for the matching end.
        let rate = self.number(warp.rate);
        let radius = self.number(warp.radius);
        (inside, format!("(1.0 + {rate} * max(length({place}.xy), {radius}))"))
    }

    fn statement(&mut self, prefix: &str, expression: &str, comment: &str) -> String {
        let name = format!("{prefix}{}", self.names);
        self.names += 1;
        let indent = "    ".repeat(self.depth.min(4));
        let comment = if comment.is_empty() { String::new() } else { format!(" // {comment}") };
        let _ = writeln!(self.body, "{indent}let {name} = {expression};{comment}");
        name
    }

    /// A parameter in the buffer, as an expression.
    fn number(&mut self, value: f32) -> String {
        let at = self.next();
        self.numbers.push(value);
        format!("numbers[{at}]")
    }

    /// The index of the next parameter, as an expression.
    fn next(&self) -> String {
        format!("{}{}u", self.base, self.numbers.len())
    }

    /// Appends twelve parameters; returns the index of the first.
    fn placement(&mut self, rows: &[[f32; 3]; 3], shift: [f32; 3]) -> String {
        let first = self.next();
        for (row, shift) in rows.iter().zip(shift) {
            self.numbers.extend([row[0], row[1], row[2], shift]);
        }
        first
    }

    fn leaf(&mut self, leaf: u32, p: &str) -> String {
        let program = self.program;
        let placed = &program.leaves[leaf as usize];
        let at = self.placement(&placed.rows, placed.shift);
        let place = format!("place_at({p}, {at})");
        match &placed.field {
            LeafField::Extrude(flat) => {
                let first = self.next();
                self.numbers.extend(&placed.parameters[..PARAMETERS]);
                let place = self.statement("q", &place, "extrude");
                let flat = self.profile(flat, &format!("{place}.xy"));
                format!("extruded({flat}, {place}.z, six({first}))")
            }
            LeafField::Revolve(flat) => {
                let offset = self.number(placed.parameters[0]);
                let place = self.statement("q", &place, "revolve");
                self.profile(flat, &format!("vec2f(length({place}.xy) - {offset}, {place}.z)"))
            }
            field => {
                self.loops.extend(field.loops().iter().map(|&steps| steps.to_owned()));
                let first = self.next();
                self.numbers.extend(&placed.parameters[..PARAMETERS]);
                format!("{}({place}, six({first}))", self.model.leaves[leaf as usize].primitive.name())
            }
        }
    }

    fn profile(&mut self, flat: &Flat<f32>, at: &str) -> String {
        match flat {
            Flat::Circle(radius) => format!("circle({at}, {})", self.number(*radius)),
            Flat::Rectangle([x, y]) => {
                let (x, y) = (self.number(*x), self.number(*y));
                format!("rectangle({at}, vec2f({x}, {y}))")
            }
            Flat::Polygon(polygon) => {
                let first = self.next();
                self.loops.push(format!("{}u", polygon.longest_list()));
                self.numbers.extend(polygon.numbers());
                format!("polygon_at({at}, {first})")
            }
        }
    }
}

fn joined(op: Op, joint: &str, a: &str, b: &str, width: &str) -> String {
    let union = |a: &str, b: &str| format!("{joint}_union({a}, {b}, {width})");
    match op {
        Op::Union => union(a, b),
        Op::Intersection => format!("-{}", union(&format!("-{a}"), &format!("-{b}"))),
        Op::Difference => format!("-{}", union(&format!("-{a}"), b)),
        Op::Xor => {
            let both = format!("-{}", union(&format!("-{a}"), &format!("-{b}")));
            format!("-{}", union(&format!("-{}", union(a, b)), &both))
        }
    }
}
