//! A lowered shape: placements at the leaves, copies written out or selected by position, operators in postfix order.
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
use super::token::{Operation, Token, fold_postfix};
use crate::csg::tree::kind::{Blend, Op};
use crate::csg::tree::placement::{Placement, Warp};
use crate::csg::tree::primitive::Primitive;
use crate::csg::tree::shape::Shape;
use crate::error::ShapeError;
use glam::DVec3;
use std::fmt;
use std::sync::{Arc, OnceLock};

#[derive(Debug, Clone)]
pub struct Leaf {
    pub primitive: Primitive,
    /// Placement in world units, or in the units of the enclosing warp.
    pub place: Placement,
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

impl Combine {
    /// The operands in the order of the operator, from those in the order of their evaluation.
    pub(crate) fn in_order<T>(&self, first: T, second: T) -> [T; 2] {
        if self.is_swapped { [second, first] } else { [first, second] }
    }
}

/// An operation on the distance alone, at the same position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DistanceOp {
    Offset(f64),
    Shell(f64),
    /// Multiplies the distance by a positive factor.
    Times(f64),
}

/// Paint on a leaf; `above` is the paint applied over it, farther up in the tree.
#[derive(Debug)]
pub struct Coat {
    pub above: Option<Arc<Self>>,
    pub color: [f32; 3],
    /// Whether the coat replaces the colours below it.
    pub over: bool,
    pub mask: Option<Mask>,
}

/// Region that a coat covers: the inside or the outside of a shape.
#[derive(Debug)]
pub struct Mask {
    pub shape: Shape,
    /// The lowered shape.
    pub model: Arc<Model>,
    /// Its field, compiled at the first use.
    pub distance: OnceLock<MaskDistance>,
    pub place: Placement,
    pub outside: bool,
}

/// The field of the shape of a mask, at a point in the units of that shape.
pub struct MaskDistance(pub Box<dyn Fn(DVec3) -> f64 + Send + Sync>);

impl fmt::Debug for MaskDistance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("MaskDistance")
    }
}

impl Drop for Coat {
    fn drop(&mut self) {
        let mut above = self.above.take();
        while let Some(mut coat) = above.and_then(Arc::into_inner) {
            above = coat.above.take();
        }
    }
}

impl Coat {
    /// The colour of a painted leaf at a point, in the units of the leaf's placement. `compile` makes the field of a
    /// mask.
    pub fn color(coat: Option<&Self>, p: DVec3, compile: fn(&Arc<Model>) -> MaskDistance) -> Option<[f32; 3]> {
        let mut color = None;
        let mut next = coat;
        while let Some(coat) = next {
            if (color.is_none() || coat.over) && coat.mask.as_ref().is_none_or(|mask| mask.covers(p, compile)) {
                color = Some(coat.color);
            }
            next = coat.above.as_deref();
        }
        color
    }
}

impl Mask {
    fn covers(&self, p: DVec3, compile: fn(&Arc<Model>) -> MaskDistance) -> bool {
        let inside = self.place.rotation.transpose() * (p - self.place.translation) / self.place.scale;
        let distance = self.distance.get_or_init(|| compile(&self.model));
        ((distance.0)(inside) <= 0.0) != self.outside
    }
}

/// A shape in postfix form. Only [`Model::new`] makes the tokens, from a tree whose operators have all their operands,
/// so a stack machine always finds its operands. A part contains whole subtrees, operators with operands.
#[derive(Debug, Clone)]
pub struct Model {
    pub tokens: Vec<Token>,
    pub leaves: Vec<Leaf>,
    pub combines: Vec<Combine>,
    pub levels: Vec<DistanceOp>,
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
    /// Extent of a part of the tokens.
    pub(crate) fn extent_of(&self, tokens: &[Token]) -> Extent {
        let extent = fold_postfix(tokens, |operation| {
            Some(match operation {
                Operation::Leaf(leaf) => self.leaves[leaf as usize].extent,
                Operation::Combine(i, below, top) => {
                    let combine = self.combines[i as usize];
                    let [a, b] = combine.in_order(below, top);
                    Extent::combined(combine.op, combine.blend, a, b)
                }
                Operation::DistanceOp(i, operand) => match self.levels[i as usize] {
                    DistanceOp::Offset(distance) => operand.level(distance),
                    DistanceOp::Shell(thickness) => operand.level(0.5 * thickness),
                    DistanceOp::Times(factor) => operand.times(factor),
                },
                Operation::Complement(operand) => operand.complement(),
                Operation::Warp(i, operand) => operand.warped(&self.warps[i as usize]),
            })
        });
        extent.unwrap_or(Extent::EMPTY)
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
    pub(crate) fn lipschitz_of(&self, tokens: &[Token]) -> f64 {
        let constant = fold_postfix::<f64>(tokens, |operation| {
            Some(match operation {
                Operation::Leaf(leaf) => self.leaves[leaf as usize].primitive.lipschitz(),
                Operation::Combine(i, a, b) => match self.combines[i as usize].blend {
                    // The flat of a chamfer: (a + b - k) / sqrt(2).
                    Blend::Chamfer(_) => a.max(b).max((a + b) * 0.5f64.sqrt()),
                    _ => a.max(b),
                },
                Operation::DistanceOp(i, operand) => match self.levels[i as usize] {
                    DistanceOp::Times(factor) => factor * operand,
                    DistanceOp::Offset(_) | DistanceOp::Shell(_) => operand,
                },
                Operation::Complement(operand) | Operation::Warp(_, operand) => operand,
            })
        });
        constant.unwrap_or(1.0)
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
