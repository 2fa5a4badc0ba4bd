//! A shape made ready: placements pushed down to the leaves, repetitions written out, operators in postfix order.
//!
//! A [`Model`] is a table of leaves and operators and a list of [`Token`]s over them. The list is a program for a stack
//! machine: a leaf pushes its distance, an operator takes two. A part of a model is a shorter list over the same tables, so
//! that decomposition, both evaluators and the graphics device speak one language.
//!
//! Positions are in *local units*: `(world - center) / scale`, with `scale` a power of two that brings the model to a size
//! near one. The placement of a leaf holds its turn and its shift; its scale goes into its parameters, and so distances come
//! out in local units without a multiplication.
//!
//! The operand that needs the deeper stack goes first (Sethi and Ullman, 1970), so a model of a million leaves needs a stack
//! of twenty, however the user nested it.

use super::bounds::Extent;
use super::primitive::Primitive;
use super::program::{Frame, Program};
use super::shape::{Blend, Kind, Op, Shape};
use crate::error::ShapeError;
use glam::{DMat3, DVec3};
use std::collections::HashMap;
use std::sync::Arc;

/// A step of the stack machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Token {
    /// Push the distance to a leaf.
    Leaf(u32),
    /// Take two, push their combination.
    Combine(u32),
    /// Subtract a radius, or fold into a skin; see [`Level`].
    Level(u32),
    /// Negate.
    Complement,
    /// What follows is evaluated at a changed position, up to the matching `Leave`.
    Enter(u32),
    Leave(u32),
}

/// A placement without its scale: `world = rotation * leaf + translation`. The rotation may mirror.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub rotation: DMat3,
    pub translation: DVec3,
    /// Units of the parent a unit of what is placed.
    pub scale: f64,
}

impl Place {
    pub const HERE: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, scale: 1.0 };

    /// The placement of something that is placed by `inner` in what is placed by `self`.
    pub fn then(&self, inner: &Self) -> Self {
        Self {
            rotation: self.rotation * inner.rotation,
            translation: self.translation + self.scale * (self.rotation * inner.translation),
            scale: self.scale * inner.scale,
        }
    }

    fn of_kind(kind: &Kind) -> Option<Self> {
        match *kind {
            Kind::Move(translation) => Some(Self { translation, ..Self::HERE }),
            Kind::Rotate { axis, degrees } => Some(Self { rotation: rotation(axis, degrees), ..Self::HERE }),
            Kind::Scale(scale) => Some(Self { scale, ..Self::HERE }),
            Kind::Reflect(normal) => Some(reflection(normal)),
            _ => None,
        }
    }
}

/// Exact at multiples of 90 degrees about the axes, so that boxes stay boxes.
fn rotation(axis: DVec3, degrees: f64) -> DMat3 {
    let turn = degrees.rem_euclid(360.0);
    let (sin, cos) = match turn {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        _ => turn.to_radians().sin_cos(),
    };
    let outer = |a: DVec3, b: DVec3| DMat3::from_cols(a * b.x, a * b.y, a * b.z);
    let cross = DMat3::from_cols(
        DVec3::new(0.0, axis.z, -axis.y),
        DVec3::new(-axis.z, 0.0, axis.x),
        DVec3::new(axis.y, -axis.x, 0.0),
    );
    cos * DMat3::IDENTITY + (1.0 - cos) * outer(axis, axis) + sin * cross
}

#[derive(Debug, Clone)]
pub struct Leaf {
    pub primitive: Primitive,
    /// In world units, or in those of the warp that it stands in.
    pub place: Place,
    pub paint: Option<Arc<Coat>>,
    /// Where its level sets lie.
    pub extent: Extent,
    pub is_warped: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Combine {
    pub op: Op,
    pub blend: Blend,
    /// The second operand was put first: the stack holds (second, first).
    pub is_swapped: bool,
}

/// A change of the distance alone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Level {
    Offset(f64),
    Shell(f64),
}

/// A change of the position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Warp {
    pub kind: WarpKind,
    pub place: Place,
    /// Distances inside are larger than outside by this at most; they are divided by it.
    pub stretch: Stretch,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WarpKind {
    /// Half the lengths that are inserted.
    Elongate(DVec3),
    /// Radians a unit of z.
    Twist(f64),
    /// Radians a unit of x.
    Bend(f64),
}

/// How much a turn that grows along an axis stretches: the derivative of `R(angle) p` is a turn plus `rate * r` across, at
/// distance `r` from the z axis, so it is at most `1 + rate * r`. It is taken at `max(r, radius)`, where `radius` is twice
/// that of the child: a straight way from a point to the solid never leaves the larger of its own radius and that.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stretch {
    pub rate: f64,
    pub radius: f64,
}

impl Stretch {
    pub fn at(&self, r: f64) -> f64 {
        1.0 + self.rate.abs() * r.max(self.radius)
    }
}

/// Paint on a leaf; what is painted over it, farther out in the tree, is `above`.
#[derive(Debug)]
pub struct Coat {
    pub above: Option<Arc<Self>>,
    pub color: [f32; 3],
    /// Replaces colours below it.
    pub over: bool,
    pub mask: Option<Mask>,
}

/// Where a coat covers: inside a shape, or outside.
#[derive(Debug)]
pub struct Mask {
    pub shape: Shape,
    pub model: Model,
    pub program: Program<f64>,
    pub place: Place,
    pub outside: bool,
}

impl Drop for Coat {
    fn drop(&mut self) {
        let mut above = self.above.take();
        while let Some(mut coat) = above.and_then(Arc::into_inner) {
            above = coat.above.take();
        }
    }
}

/// A shape in postfix form.
#[derive(Debug, Clone)]
pub struct Model {
    pub tokens: Vec<Token>,
    pub leaves: Vec<Leaf>,
    pub combines: Vec<Combine>,
    pub levels: Vec<Level>,
    pub warps: Vec<Warp>,
    /// Box of the solid, world units.
    pub extent: Extent,
    /// Values that wait at a time, at most.
    pub stack: usize,
    /// The most that the field changes over a unit of length.
    pub lipschitz: f64,
    /// The field is the Euclidean distance everywhere.
    pub is_exact: bool,
}

/// Warps inside each other at most: a graphics device keeps the positions.
pub const MAX_WARPS: usize = 4;

/// A node of the written-out tree.
#[derive(Debug, Clone, Copy)]
enum Item {
    Leaf(u32),
    Combine { op: Op, blend: Blend, first: usize, second: usize },
    Level(u32, usize),
    Complement(usize),
    Warp(u32, usize),
}

/// What a node inherits from above.
#[derive(Debug, Clone)]
struct Context {
    place: Place,
    coat: Option<Arc<Coat>>,
    warps: usize,
}

/// What is still to be done.
enum Task<'a> {
    Visit(&'a Shape, Context),
    Combine { op: Op, blend: Blend, count: usize },
    Level(Level),
    Complement,
    Warp(WarpKind, Place),
}

impl Model {
    pub fn new(shape: &Shape) -> Result<Self, ShapeError> {
        Builder::default().build(shape)
    }

    /// A model over the same tables, for a part of the tokens.
    pub fn extent_of(&self, tokens: &[Token]) -> Extent {
        let mut stack: Vec<Extent> = Vec::new();
        for &token in tokens {
            self.apply_extent(token, &mut stack);
        }
        stack.pop().unwrap_or(Extent::EMPTY)
    }

    fn apply_extent(&self, token: Token, stack: &mut Vec<Extent>) {
        let mut pop = || stack.pop().expect("tokens are in postfix order");
        let extent = match token {
            Token::Leaf(leaf) => self.leaves[leaf as usize].extent,
            Token::Combine(i) => {
                let combine = self.combines[i as usize];
                let (top, below) = (pop(), pop());
                let (a, b) = if combine.is_swapped { (top, below) } else { (below, top) };
                Extent::combined(combine.op, combine.blend, a, b)
            }
            Token::Level(i) => match self.levels[i as usize] {
                Level::Offset(distance) => pop().level(distance),
                Level::Shell(thickness) => pop().level(0.5 * thickness),
            },
            Token::Complement => pop().complement(),
            Token::Enter(_) => return,
            Token::Leave(i) => {
                let warp = &self.warps[i as usize];
                pop().warped(warp)
            }
        };
        stack.push(extent);
    }

    /// The box without the room that fillets take.
    pub fn sharp_extent(&self) -> Extent {
        let mut sharp = self.clone();
        sharp.combines.iter_mut().for_each(|combine| combine.blend = Blend::Sharp);
        sharp.extent_of(&self.tokens)
    }

    /// How deep the stack gets.
    pub fn stack_of(tokens: &[Token]) -> usize {
        let (mut depth, mut deepest) = (0usize, 0);
        for token in tokens {
            match token {
                Token::Leaf(_) => depth += 1,
                Token::Combine(_) => depth -= 1,
                _ => {}
            }
            deepest = deepest.max(depth);
        }
        deepest
    }

    /// The Lipschitz constant of a part.
    pub fn lipschitz_of(&self, tokens: &[Token]) -> f64 {
        let mut stack: Vec<f64> = Vec::new();
        for &token in tokens {
            match token {
                Token::Leaf(leaf) => stack.push(self.leaves[leaf as usize].primitive.lipschitz()),
                Token::Combine(i) => {
                    let (a, b) = (stack.pop().unwrap_or(1.0), stack.pop().unwrap_or(1.0));
                    // The flat of a chamfer: (a + b - k) / sqrt(2).
                    let flat = match self.combines[i as usize].blend {
                        Blend::Chamfer(_) => std::f64::consts::SQRT_2,
                        _ => 1.0,
                    };
                    stack.push(a.max(b) * flat);
                }
                _ => {}
            }
        }
        stack.pop().unwrap_or(1.0)
    }

    pub fn is_bounded(&self) -> Result<(), ShapeError> {
        match self.extent.unbounded {
            None => Ok(()),
            Some(leaf) => Err(ShapeError::Unbounded { leaf }),
        }
    }

    /// Leaves that the tokens name.
    pub fn leaf_count(tokens: &[Token]) -> usize {
        tokens.iter().filter(|token| matches!(token, Token::Leaf(_))).count()
    }
}

/// Makes a model from a tree.
#[derive(Default)]
struct Builder {
    items: Vec<Item>,
    /// Values that the evaluation of an item needs on the stack.
    needs: Vec<u32>,
    leaves: Vec<Leaf>,
    known: HashMap<LeafKey, u32>,
    levels: Vec<Level>,
    warps: Vec<Warp>,
    /// Items that wait for their operator.
    done: Vec<usize>,
}

/// Equal leaves are one: what differs between primitives of a kind is in their parameters and their place.
#[derive(PartialEq, Eq, Hash)]
struct LeafKey {
    name: &'static str,
    parameters: Vec<u64>,
    /// Profiles and volumes are told apart by who they are.
    data: usize,
    coat: usize,
    warps: usize,
}

impl Builder {
    fn build(mut self, shape: &Shape) -> Result<Model, ShapeError> {
        let context = Context { place: Place::HERE, coat: None, warps: 0 };
        let mut tasks = vec![Task::Visit(shape, context)];
        while let Some(task) = tasks.pop() {
            match task {
                Task::Visit(shape, context) => self.visit(shape, context, &mut tasks)?,
                Task::Combine { op, blend, count } => self.combine(op, blend, count),
                Task::Level(level) => {
                    self.levels.push(level);
                    self.wrap(|child, builder| Item::Level(builder.levels.len() as u32 - 1, child));
                }
                Task::Complement => self.wrap(|child, _| Item::Complement(child)),
                Task::Warp(kind, place) => self.warp(kind, place)?,
            }
        }
        let root = self.done.pop().expect("a shape has a root");
        Ok(self.emit(root))
    }

    fn visit<'a>(&mut self, shape: &'a Shape, context: Context, tasks: &mut Vec<Task<'a>>) -> Result<(), ShapeError> {
        let children = shape.children();
        let inside = |place: Place| Context { place: context.place.then(&place), ..context.clone() };
        if let Some(place) = Place::of_kind(shape.kind()) {
            let scale = context.place.scale * place.scale;
            let reach = context.place.then(&place).translation.abs().max_element();
            if !(MIN_SCALE..=1.0 / MIN_SCALE).contains(&scale) || reach.is_nan() || reach > MAX_REACH {
                let problem = format!("grows or moves a part out of range: scaled by {scale:e}, moved by {reach:e}");
                return Err(ShapeError::argument("shape", problem));
            }
            tasks.push(Task::Visit(&children[0], inside(place)));
            return Ok(());
        }
        match *shape.kind() {
            Kind::Primitive(ref primitive) => self.leaf(primitive, &context),
            Kind::Combine { op, blend } => {
                let k = context.place.scale;
                let blend = match blend {
                    Blend::Sharp => Blend::Sharp,
                    Blend::Smooth(width) => Blend::Smooth(k * width),
                    Blend::Chamfer(width) => Blend::Chamfer(k * width),
                };
                tasks.push(Task::Combine { op, blend, count: children.len() });
                tasks.extend(children.iter().rev().map(|child| Task::Visit(child, context.clone())));
            }
            Kind::Offset(distance) => {
                tasks.push(Task::Level(Level::Offset(context.place.scale * distance)));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Shell(thickness) => {
                tasks.push(Task::Level(Level::Shell(context.place.scale * thickness)));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Complement => {
                tasks.push(Task::Complement);
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Mirror(normal) => {
                tasks.push(Task::Combine { op: Op::Union, blend: Blend::Sharp, count: 2 });
                tasks.push(Task::Visit(&children[0], inside(reflection(normal))));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Repeat { spacing, counts } => {
                let count = counts.iter().map(|&n| n as usize).product();
                if count > 1 {
                    tasks.push(Task::Combine { op: Op::Union, blend: Blend::Sharp, count });
                }
                let middle = 0.5 * (DVec3::from(counts.map(f64::from)) - 1.0);
                for z in 0..counts[2] {
                    for y in 0..counts[1] {
                        for x in 0..counts[0] {
                            let at = spacing * (DVec3::from([x, y, z].map(f64::from)) - middle);
                            tasks.push(Task::Visit(&children[0], inside(Place { translation: at, ..Place::HERE })));
                        }
                    }
                }
            }
            Kind::Elongate(half) => self.enter(WarpKind::Elongate(half), &children[0], context, tasks)?,
            Kind::Twist(degrees) => self.enter(WarpKind::Twist(degrees.to_radians()), &children[0], context, tasks)?,
            Kind::Bend(degrees) => self.enter(WarpKind::Bend(degrees.to_radians()), &children[0], context, tasks)?,
            Kind::Paint { color, over } => {
                let coat = Coat { above: context.coat, color, over, mask: None };
                tasks.push(Task::Visit(&children[0], Context { coat: Some(Arc::new(coat)), ..context }));
            }
            Kind::Stencil { color, outside } => {
                let model = Self::default().build(&children[1])?;
                let program = Program::new(&model, Frame::of(&model));
                let mask = Mask { shape: children[1].clone(), model, program, place: context.place, outside };
                let coat = Coat { above: context.coat, color, over: true, mask: Some(mask) };
                tasks.push(Task::Visit(&children[0], Context { coat: Some(Arc::new(coat)), ..context }));
            }
            Kind::Move(_) | Kind::Rotate { .. } | Kind::Scale(_) | Kind::Reflect(_) => unreachable!("placed above"),
        }
        Ok(())
    }

    fn enter<'a>(
        &mut self,
        kind: WarpKind,
        child: &'a Shape,
        context: Context,
        tasks: &mut Vec<Task<'a>>,
    ) -> Result<(), ShapeError> {
        if context.warps == MAX_WARPS {
            let problem = format!("has more than {MAX_WARPS} of twist, bend and elongate inside each other");
            return Err(ShapeError::argument("shape", problem));
        }
        let scale = context.place.scale;
        // Inside, units are those of the world already.
        let kind = match kind {
            WarpKind::Elongate(half) => WarpKind::Elongate(scale * half),
            WarpKind::Twist(rate) => WarpKind::Twist(rate / scale),
            WarpKind::Bend(rate) => WarpKind::Bend(rate / scale),
        };
        tasks.push(Task::Warp(kind, Place { scale: 1.0, ..context.place }));
        let place = Place { scale, ..Place::HERE };
        tasks.push(Task::Visit(child, Context { place, coat: context.coat, warps: context.warps + 1 }));
        Ok(())
    }

    fn leaf(&mut self, primitive: &Primitive, context: &Context) {
        let place = context.place;
        let mut parameters: Vec<u64> = primitive.parameters(place.scale).map(f64::to_bits).to_vec();
        parameters.extend(place.rotation.to_cols_array().map(|x| (x + 0.0).to_bits()));
        parameters.extend(place.translation.to_array().map(|x| (x + 0.0).to_bits()));
        let key = LeafKey {
            name: primitive.name(),
            parameters,
            data: match primitive {
                Primitive::Extrude { profile, .. } | Primitive::Revolve { profile, .. } => {
                    Arc::as_ptr(profile) as usize
                }
                Primitive::Volume(volume) => Arc::as_ptr(volume) as usize,
                _ => 0,
            },
            coat: context.coat.as_ref().map_or(0, |coat| Arc::as_ptr(coat) as usize),
            warps: context.warps,
        };
        let next = self.leaves.len() as u32;
        let id = *self.known.entry(key).or_insert(next);
        if id == next {
            let extent = Extent::of_leaf(primitive, &place);
            self.leaves.push(Leaf {
                primitive: primitive.clone(),
                place,
                paint: context.coat.clone(),
                extent,
                is_warped: context.warps > 0,
            });
        }
        self.push(Item::Leaf(id), 1);
    }

    fn push(&mut self, item: Item, need: u32) {
        self.done.push(self.items.len());
        self.items.push(item);
        self.needs.push(need);
    }

    fn wrap(&mut self, item: impl FnOnce(usize, &Self) -> Item) {
        let child = self.done.pop().expect("the child is done");
        let item = item(child, self);
        self.push(item, self.needs[child]);
    }

    fn combine(&mut self, op: Op, blend: Blend, count: usize) {
        let operands = self.done.split_off(self.done.len() - count);
        let mut first = operands[0];
        for &second in &operands[1..] {
            let (a, b) = (self.needs[first], self.needs[second]);
            self.push(Item::Combine { op, blend, first, second }, if a == b { a + 1 } else { a.max(b) });
            first = self.done.pop().expect("just pushed");
        }
        self.done.push(first);
    }

    fn warp(&mut self, kind: WarpKind, place: Place) -> Result<(), ShapeError> {
        let child = self.done.pop().expect("the child is done");
        let extent = self.extent_of(child);
        let mut stretch = Stretch { rate: 0.0, radius: 0.0 };
        if let WarpKind::Twist(rate) | WarpKind::Bend(rate) = kind {
            if let Some(leaf) = extent.unbounded {
                let problem = format!("cannot be twisted or bent: {leaf} has no bounds");
                return Err(ShapeError::argument("shape", problem));
            }
            stretch = Stretch { rate, radius: 2.0 * extent.radius_about_z() };
        }
        self.warps.push(Warp { kind, place, stretch });
        self.push(Item::Warp(self.warps.len() as u32 - 1, child), self.needs[child]);
        Ok(())
    }

    /// Of an item inside a warp, which is being built.
    fn extent_of(&self, item: usize) -> Extent {
        let (tokens, combines) = self.tokens(item);
        let model = self.assemble(tokens, combines);
        model.extent
    }

    /// Postfix order, the operand with the deeper stack first.
    fn tokens(&self, root: usize) -> (Vec<Token>, Vec<Combine>) {
        enum Step {
            Visit(usize),
            Emit(Token),
        }
        let mut combines: Vec<Combine> = Vec::new();
        let mut tokens = Vec::new();
        let mut steps = vec![Step::Visit(root)];
        while let Some(step) = steps.pop() {
            let item = match step {
                Step::Emit(token) => {
                    tokens.push(token);
                    continue;
                }
                Step::Visit(item) => item,
            };
            match self.items[item] {
                Item::Leaf(leaf) => tokens.push(Token::Leaf(leaf)),
                Item::Combine { op, blend, first, second } => {
                    let is_swapped = self.needs[second] > self.needs[first];
                    let combine = Combine { op, blend, is_swapped };
                    // Few kinds of operators, many uses: equal ones share an entry.
                    let known = combines.iter().rev().take(8).position(|other| *other == combine);
                    let id = known.map_or(combines.len(), |back| combines.len() - 1 - back);
                    if id == combines.len() {
                        combines.push(combine);
                    }
                    steps.push(Step::Emit(Token::Combine(id as u32)));
                    let (early, late) = if is_swapped { (second, first) } else { (first, second) };
                    steps.push(Step::Visit(late));
                    steps.push(Step::Visit(early));
                }
                Item::Level(level, child) => {
                    steps.push(Step::Emit(Token::Level(level)));
                    steps.push(Step::Visit(child));
                }
                Item::Complement(child) => {
                    steps.push(Step::Emit(Token::Complement));
                    steps.push(Step::Visit(child));
                }
                Item::Warp(warp, child) => {
                    steps.push(Step::Emit(Token::Leave(warp)));
                    steps.push(Step::Visit(child));
                    tokens.push(Token::Enter(warp));
                }
            }
        }
        (tokens, combines)
    }

    fn assemble(&self, tokens: Vec<Token>, combines: Vec<Combine>) -> Model {
        let mut model = Model {
            tokens: Vec::new(),
            leaves: self.leaves.clone(),
            combines,
            levels: self.levels.clone(),
            warps: self.warps.clone(),
            extent: Extent::EMPTY,
            stack: Model::stack_of(&tokens),
            lipschitz: 1.0,
            is_exact: false,
        };
        model.extent = model.extent_of(&tokens);
        model.lipschitz = model.lipschitz_of(&tokens);
        model.is_exact = match tokens.split_first() {
            Some((Token::Leaf(leaf), rest)) => {
                self.leaves[*leaf as usize].primitive.is_exact() && rest.iter().all(|token| *token == Token::Complement)
            }
            _ => false,
        };
        model.tokens = tokens;
        model
    }

    fn emit(self, root: usize) -> Model {
        let (tokens, combines) = self.tokens(root);
        self.assemble(tokens, combines)
    }
}

/// Scales and shifts of parts stay where float64 can square them.
const MIN_SCALE: f64 = 1e-30;
const MAX_REACH: f64 = 1e37;

/// Mirrored in the plane through the origin with this normal.
fn reflection(normal: DVec3) -> Place {
    let outer = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
    Place { rotation: DMat3::IDENTITY - 2.0 * outer, ..Place::HERE }
}
