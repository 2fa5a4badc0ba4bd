//! A lowered shape: placements at the leaves, repetitions written out, operators in postfix order.
//!
//! A [`Model`] is a table of leaves and operators and a list of [`Token`]s over them. The list is a program for a stack
//! machine: a leaf pushes its distance, an operator pops two. A part of a model is a shorter list over the same tables,
//! so decomposition, both evaluators and the graphics device share one representation.
//!
//! Positions are in *local units*: `(world - center) / scale`, where `scale` is a power of two that brings the model to
//! a size near one. The placement of a leaf contains its rotation and translation. Its scale is applied to its
//! parameters, so distances are in local units without a multiplication.
//!
//! [`super::lower`] makes a model from a tree.

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
    /// Pushes the distance to a leaf.
    Leaf(u32),
    /// Pops two values and pushes their combination.
    Combine(u32),
    /// Subtracts a radius, or forms a shell; see [`Level`].
    Level(u32),
    /// Negates.
    Complement,
    /// The following tokens are evaluated at a changed position, up to the matching `Leave`.
    Enter(u32),
    Leave(u32),
}

/// A placement without its scale: `world = rotation * leaf + translation`. The rotation may include a reflection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub rotation: DMat3,
    pub translation: DVec3,
    /// Number of units of the parent in a unit of the placed object.
    pub scale: f64,
}

impl Place {
    pub const HERE: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, scale: 1.0 };

    /// The composition of two placements: `inner` first, then `self`.
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

/// Exact at multiples of 90 degrees about the axes, so that boxes stay axis-aligned.
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

/// The reflection in the plane through the origin with this normal.
pub(super) fn reflection(normal: DVec3) -> Place {
    let outer = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
    Place { rotation: DMat3::IDENTITY - 2.0 * outer, ..Place::HERE }
}

#[derive(Debug, Clone)]
pub struct Leaf {
    pub primitive: Primitive,
    /// Placement in world units, or in those of the enclosing warp.
    pub place: Place,
    pub paint: Option<Arc<Coat>>,
    /// Bounds of its level sets.
    pub extent: Extent,
    pub is_warped: bool,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Combine {
    pub op: Op,
    pub blend: Blend,
    /// Whether the second operand was evaluated first: the stack holds (second, first).
    pub is_swapped: bool,
}

/// A change of the distance only.
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
    /// Upper bound on the ratio of distances inside to distances outside, by which they are divided.
    pub stretch: Stretch,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WarpKind {
    /// Half the lengths inserted along each axis.
    Elongate(DVec3),
    /// Radians per unit of z.
    Twist(f64),
    /// Radians per unit of x.
    Bend(f64),
}

/// Stretch of a rotation that grows along an axis. The derivative of `R(angle) p` is a rotation plus `rate * r` across
/// it, at distance `r` from the z axis, so its norm is at most `1 + rate * r`. It is evaluated at `max(r, radius)`,
/// where `radius` is twice that of the child: a straight segment from a point to the solid never leaves the larger of
/// its own radius and that.
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

/// Paint on a leaf; `above` is the paint applied over it, farther up in the tree.
#[derive(Debug)]
pub struct Coat {
    pub above: Option<Arc<Self>>,
    pub color: [f32; 3],
    /// Whether it replaces colours below it.
    pub over: bool,
    pub mask: Option<Mask>,
}

/// Region that a coat covers: the inside or the outside of a shape.
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

/// A shape in postfix form. Only [`Model::new`] makes the tokens, from a tree whose operators have all their operands,
/// so a stack machine always finds its operands. A part contains whole subtrees, operators with operands.
#[derive(Debug, Clone)]
pub struct Model {
    pub tokens: Vec<Token>,
    pub leaves: Vec<Leaf>,
    pub combines: Vec<Combine>,
    pub levels: Vec<Level>,
    pub warps: Vec<Warp>,
    /// Box of the solid, world units.
    pub extent: Extent,
    /// Largest number of values on the stack.
    pub stack: usize,
    /// Lipschitz constant of the field.
    pub lipschitz: f64,
    /// Whether the field is the Euclidean distance everywhere.
    pub is_exact: bool,
    pub is_painted: bool,
}

impl Model {
    pub fn new(shape: &Shape) -> Result<Self, ShapeError> {
        lower(shape)
    }

    /// Extent of a part of the tokens.
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

    /// The box without the growth by fillets.
    pub fn sharp_extent(&self) -> Extent {
        let mut sharp = self.clone();
        sharp.combines.iter_mut().for_each(|combine| combine.blend = Blend::Sharp);
        sharp.extent_of(&self.tokens)
    }

    /// Depth of the stack that the tokens need.
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

    /// Number of leaves among the tokens.
    pub fn leaf_count(tokens: &[Token]) -> usize {
        tokens.iter().filter(|token| matches!(token, Token::Leaf(_))).count()
    }
}
