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
//! A model is made from a tree in [`super::lower`].

use super::bounds::Extent;
use super::lower::lower;
use super::primitive::Primitive;
use super::program::Program;
use super::shape::{Blend, Kind, Op, Shape};
use crate::error::ShapeError;
use glam::{DMat3, DVec3};
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

    pub(super) fn of_kind(kind: &Kind) -> Option<Self> {
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

/// Mirrored in the plane through the origin with this normal.
pub(super) fn reflection(normal: DVec3) -> Place {
    let outer = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
    Place { rotation: DMat3::IDENTITY - 2.0 * outer, ..Place::HERE }
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

/// A shape in postfix form. [`Model::new`] alone makes the tokens, from a tree that cannot lack an operand, so whoever walks
/// them finds what each one takes on its stack; a part of them is cut out whole, operator with operands.
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
    pub is_painted: bool,
}

/// Warps inside each other at most: a graphics device keeps the positions.
pub const MAX_WARPS: usize = 4;

impl Model {
    pub fn new(shape: &Shape) -> Result<Self, ShapeError> {
        lower(shape)
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
