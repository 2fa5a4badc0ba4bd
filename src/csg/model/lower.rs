//! Lowering of a tree to a model: placements move to the leaves, copies are written out or selected by position, equal
//! leaves are shared.
//!
//! The tree is traversed without recursion, at any depth. The operand that needs the deeper stack comes first (Sethi
//! and Ullman, 1970), so a model of a million leaves needs a stack of twenty at any nesting.

use super::bounds::Extent;
use super::lowered::{Coat, Combine, DistanceOp, Leaf, Mask, Model};
use super::operand_stack::OperandStack;
use super::token::Token;
use crate::csg::tree::kind::{Blend, Kind, Op};
use crate::csg::tree::placement::{Lattice, Placement, Stretch, Warp, WarpKind, reflection};
use crate::csg::tree::primitive::Primitive;
use crate::csg::tree::shape::{MAX_COPIES, MAX_LEAVES, Shape, copies_of, too_many_leaves};
use crate::error::ShapeError;
use crate::gpu::constants::csg_interpreter::MAX_WARPS;
use glam::DVec3;
use std::collections::HashMap;
use std::sync::{Arc, OnceLock};

impl Model {
    /// The model of a tree.
    pub fn new(shape: &Shape) -> Result<Self, ShapeError> {
        Builder::default().build(shape)
    }
}

/// Smallest scale of a placement. The largest is `1.0 / MIN_SCALE`. Float64 can square both.
const MIN_SCALE: f64 = 1e-30;
/// Largest translation of a placement, world units. Float64 can square it.
const MAX_REACH: f64 = 1e37;

/// A node of the written-out tree.
#[derive(Debug, Clone, Copy)]
enum LoweredNode {
    Leaf(u32),
    Combine { op: Op, blend: Blend, first: usize, second: usize },
    DistanceOp(u32, usize),
    Complement(usize),
    Warp(u32, usize),
}

/// State that a node inherits from its parent.
#[derive(Debug, Clone)]
struct InheritedState {
    place: Placement,
    coat: Option<Arc<Coat>>,
    warps: usize,
}

impl InheritedState {
    /// The state of a child with a placement.
    fn placed(&self, place: &Placement) -> Self {
        Self { place: self.place.then(place), ..self.clone() }
    }
}

/// An entry of the stack of pending work.
enum Task<'a> {
    Visit(&'a Shape, InheritedState),
    Combine { op: Op, blend: Blend, count: usize },
    DistanceOp(DistanceOp),
    Complement,
    Warp(WarpKind, Placement),
}

/// Largest number of changes of the position inside each other, repetitions included.
fn warp_depth(shape: &Shape) -> usize {
    let mut deepest = 0;
    let mut waiting = vec![(shape, 0)];
    while let Some((shape, depth)) = waiting.pop() {
        let kind = shape.kind();
        let is_warp = matches!(kind, Kind::Elongate(_) | Kind::Twist(_) | Kind::Bend(_) | Kind::Repeat { .. });
        let depth = depth + usize::from(is_warp);
        deepest = deepest.max(depth);
        // Deeper levels change no decision, and shared subtrees are visited once per path only down to here.
        if depth < MAX_WARPS {
            waiting.extend(shape.children().iter().map(|child| (child, depth)));
        }
    }
    deepest
}

/// Builds a model from a tree.
#[derive(Default)]
struct Builder {
    items: Vec<LoweredNode>,
    /// Number of stack entries that the evaluation of an item needs.
    needs: Vec<u32>,
    leaves: Vec<Leaf>,
    /// Number of leaves with repetitions written out and equal leaves counted each time.
    written: u64,
    known: HashMap<LeafKey, u32>,
    levels: Vec<DistanceOp>,
    warps: Vec<Warp>,
    /// Items that wait for their operator.
    done: OperandStack<usize>,
}

/// Key for sharing equal leaves: primitives of a kind differ only in their parameters and placement.
#[derive(PartialEq, Eq, Hash)]
struct LeafKey {
    name: &'static str,
    parameters: Vec<u64>,
    /// Profiles and volumes are compared by identity.
    data: usize,
    coat: usize,
    warps: usize,
}

impl Builder {
    fn build(mut self, shape: &Shape) -> Result<Model, ShapeError> {
        let context = InheritedState { place: Placement::HERE, coat: None, warps: 0 };
        let mut tasks = vec![Task::Visit(shape, context)];
        while let Some(task) = tasks.pop() {
            match task {
                Task::Visit(shape, context) => self.visit(shape, context, &mut tasks)?,
                Task::Combine { op, blend, count } => self.combine(op, blend, count),
                Task::DistanceOp(level) => {
                    self.levels.push(level);
                    self.wrap(|child, builder| LoweredNode::DistanceOp(builder.levels.len() as u32 - 1, child));
                }
                Task::Complement => self.wrap(|child, _| LoweredNode::Complement(child)),
                Task::Warp(kind, place) => self.warp(kind, place)?,
            }
        }
        let root = self.done.pop();
        Ok(self.emit(root))
    }

    fn visit<'a>(
        &mut self,
        shape: &'a Shape,
        context: InheritedState,
        tasks: &mut Vec<Task<'a>>,
    ) -> Result<(), ShapeError> {
        let children = shape.children();
        match *shape.kind() {
            Kind::Primitive(ref primitive) => self.leaf(primitive, &context)?,
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
                tasks.push(Task::DistanceOp(DistanceOp::Offset(context.place.scale * distance)));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Shell(thickness) => {
                tasks.push(Task::DistanceOp(DistanceOp::Shell(context.place.scale * thickness)));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Times(factor) => {
                tasks.push(Task::DistanceOp(DistanceOp::Times(factor)));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Complement => {
                tasks.push(Task::Complement);
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Mirror(normal) => {
                tasks.push(Task::Combine { op: Op::Union, blend: Blend::Sharp, count: 2 });
                tasks.push(Task::Visit(&children[0], context.placed(&reflection(normal))));
                tasks.push(Task::Visit(&children[0], context));
            }
            Kind::Repeat { spacing, counts } => self.repeat(&children[0], spacing, counts, &context, tasks)?,
            Kind::Elongate(half) => self.enter(WarpKind::Elongate(half), &children[0], context, tasks)?,
            Kind::Twist(degrees) => self.enter(WarpKind::Twist(degrees.to_radians()), &children[0], context, tasks)?,
            Kind::Bend(degrees) => self.enter(WarpKind::Bend(degrees.to_radians()), &children[0], context, tasks)?,
            Kind::Paint { color, over } => {
                let coat = Coat { above: context.coat, color, over, mask: None };
                tasks.push(Task::Visit(&children[0], InheritedState { coat: Some(Arc::new(coat)), ..context }));
            }
            Kind::Stencil { color, outside } => {
                let mask = Mask {
                    shape: children[1].clone(),
                    model: Arc::new(Self::default().build(&children[1])?),
                    distance: OnceLock::new(),
                    place: context.place,
                    outside,
                };
                let coat = Coat { above: context.coat, color, over: true, mask: Some(mask) };
                tasks.push(Task::Visit(&children[0], InheritedState { coat: Some(Arc::new(coat)), ..context }));
            }
            Kind::Move(_) | Kind::Rotate { .. } | Kind::Turn(_) | Kind::Scale(_) | Kind::Reflect(_) => {
                let placed = context.placed(&Placement::of_kind(shape.kind()));
                let (scale, reach) = (placed.place.scale, placed.place.translation.abs().max_element());
                if !(MIN_SCALE..=1.0 / MIN_SCALE).contains(&scale) || reach.is_nan() || reach > MAX_REACH {
                    let problem =
                        format!("grows or moves a part out of range: scaled by {scale:e}, moved by {reach:e}");
                    return Err(ShapeError::argument("shape", problem));
                }
                tasks.push(Task::Visit(&children[0], placed));
            }
        }
        Ok(())
    }

    /// Adds the tasks of a repetition: copies that the position selects, or the union of all copies.
    fn repeat<'a>(
        &mut self,
        child: &'a Shape,
        spacing: DVec3,
        counts: [u32; 3],
        context: &InheritedState,
        tasks: &mut Vec<Task<'a>>,
    ) -> Result<(), ShapeError> {
        if let Some(lattice) = self.lattice(child, spacing, counts, context)? {
            // The lower and the upper copy along each axis with several copies.
            let uppers = (0..8u8).filter(|upper| (0..3).all(|axis| counts[axis] > 1 || upper >> axis & 1 == 0));
            let uppers: Vec<u8> = uppers.collect();
            tasks.push(Task::Combine { op: Op::Union, blend: Blend::Sharp, count: uppers.len() });
            for upper in uppers {
                self.enter(WarpKind::NearestCopy(Lattice { upper, ..lattice }), child, context.clone(), tasks)?;
            }
            return Ok(());
        }
        let count = counts.iter().map(|&n| n as usize).product();
        if count > 1 {
            tasks.push(Task::Combine { op: Op::Union, blend: Blend::Sharp, count });
        }
        let middle = 0.5 * (DVec3::from(counts.map(f64::from)) - 1.0);
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    let at = spacing * (DVec3::from([x, y, z].map(f64::from)) - middle);
                    let place = Placement { translation: at, ..Placement::HERE };
                    tasks.push(Task::Visit(child, context.placed(&place)));
                }
            }
        }
        Ok(())
    }

    /// The lattice of a repetition whose copies are selected by position; None if they are to be written out. The child
    /// must be one leaf, since a part of a shape may have other operands of the child at each copy. It must fit into
    /// its cell, and its paint must not depend on the position in the world.
    fn lattice(
        &self,
        child: &Shape,
        spacing: DVec3,
        counts: [u32; 3],
        context: &InheritedState,
    ) -> Result<Option<Lattice>, ShapeError> {
        let copies = copies_of(counts);
        if copies <= MAX_COPIES {
            return Ok(None);
        }
        let has_mask = std::iter::successors(context.coat.as_deref(), |coat| coat.above.as_deref())
            .any(|coat| coat.mask.is_some());
        // The nodes below one evaluated leaf form a chain, which is lowered in little time.
        let is_leaf = child.evaluated_leaves() == 1;
        if is_leaf && context.warps + warp_depth(child) < MAX_WARPS && !has_mask {
            let extent = Self::default().build(child)?.extent;
            let size = extent.upper - extent.lower;
            let fits = (0..3).all(|axis| counts[axis] == 1 || size[axis] <= spacing[axis].abs());
            if fits && extent.unbounded.is_none() && !extent.is_empty() {
                let middle = 0.5 * (extent.lower + extent.upper);
                return Ok(Some(Lattice { spacing, counts, middle, upper: 0 }));
            }
        }
        let leaves = child.evaluated_leaves().saturating_mul(copies);
        if leaves > MAX_LEAVES { Err(too_many_leaves()) } else { Ok(None) }
    }

    fn enter<'a>(
        &mut self,
        kind: WarpKind,
        child: &'a Shape,
        context: InheritedState,
        tasks: &mut Vec<Task<'a>>,
    ) -> Result<(), ShapeError> {
        if context.warps == MAX_WARPS {
            let problem = format!("has more than {MAX_WARPS} of twist, bend, elongate and repeat inside each other");
            return Err(ShapeError::argument("shape", problem));
        }
        let scale = context.place.scale;
        // Inside, the units are already world units.
        let kind = match kind {
            WarpKind::Elongate(half) => WarpKind::Elongate(scale * half),
            WarpKind::Twist(rate) => WarpKind::Twist(rate / scale),
            WarpKind::Bend(rate) => WarpKind::Bend(rate / scale),
            WarpKind::NearestCopy(lattice) => WarpKind::NearestCopy(Lattice {
                spacing: scale * lattice.spacing,
                middle: scale * lattice.middle,
                ..lattice
            }),
        };
        tasks.push(Task::Warp(kind, Placement { scale: 1.0, ..context.place }));
        let place = Placement { scale, ..Placement::HERE };
        tasks.push(Task::Visit(child, InheritedState { place, coat: context.coat, warps: context.warps + 1 }));
        Ok(())
    }

    fn leaf(&mut self, primitive: &Primitive, context: &InheritedState) -> Result<(), ShapeError> {
        self.written += 1;
        if self.written > MAX_LEAVES {
            return Err(too_many_leaves());
        }
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
        self.push(LoweredNode::Leaf(id), 1);
        Ok(())
    }

    fn push(&mut self, item: LoweredNode, need: u32) {
        self.done.push(self.items.len());
        self.items.push(item);
        self.needs.push(need);
    }

    fn wrap(&mut self, item: impl FnOnce(usize, &Self) -> LoweredNode) {
        let child = self.done.pop();
        let item = item(child, self);
        self.push(item, self.needs[child]);
    }

    fn combine(&mut self, op: Op, blend: Blend, count: usize) {
        let operands = self.done.pop_many(count);
        let mut first = operands[0];
        for &second in &operands[1..] {
            let (a, b) = (self.needs[first], self.needs[second]);
            self.push(LoweredNode::Combine { op, blend, first, second }, if a == b { a + 1 } else { a.max(b) });
            first = self.done.pop();
        }
        self.done.push(first);
    }

    fn warp(&mut self, kind: WarpKind, place: Placement) -> Result<(), ShapeError> {
        let child = self.done.pop();
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
        self.push(LoweredNode::Warp(self.warps.len() as u32 - 1, child), self.needs[child]);
        Ok(())
    }

    /// Extent of an item inside the warp that is being built.
    fn extent_of(&self, item: usize) -> Extent {
        let (tokens, combines) = self.tokens(item);
        let model = self.assemble(tokens, combines);
        model.extent
    }

    /// The tokens of a subtree in postfix order. The operand that needs the deeper stack comes first.
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
                LoweredNode::Leaf(leaf) => tokens.push(Token::Leaf(leaf)),
                LoweredNode::Combine { op, blend, first, second } => {
                    let is_swapped = self.needs[second] > self.needs[first];
                    let combine = Combine { op, blend, is_swapped };
                    // There are few different operators, so equal ones share an entry.
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
                LoweredNode::DistanceOp(level, child) => {
                    steps.push(Step::Emit(Token::DistanceOp(level)));
                    steps.push(Step::Visit(child));
                }
                LoweredNode::Complement(child) => {
                    steps.push(Step::Emit(Token::Complement));
                    steps.push(Step::Visit(child));
                }
                LoweredNode::Warp(warp, child) => {
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
            is_painted: self.leaves.iter().any(|leaf| leaf.paint.is_some()),
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
