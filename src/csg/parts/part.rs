//! Parts of a shape, and the structure that parts of one kernel share.

use crate::csg::model::lowered::{DistanceOp, Model};
use crate::csg::model::token::Token;
use crate::csg::tree::kind::{Blend, Op};
use crate::csg::tree::placement::WarpKind;
use crate::error::{ShapeError, choice};
use glam::DVec3;
use rustc_hash::FxHashMap;
use std::sync::Arc;

/// Method of decomposition.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Method {
    Aabb,
    #[default]
    Octree,
}

impl Method {
    /// Converts the public name of a method.
    pub fn from_name(name: &str) -> Result<Self, ShapeError> {
        choice("method", name, &[("aabb", Self::Aabb), ("octree", Self::Octree)]).map_err(ShapeError::from)
    }
}

/// A smaller shape, and the boxes in which it replaces the whole.
#[derive(Debug, Clone, PartialEq)]
pub struct Part {
    /// Tokens over the tables of the model.
    pub tokens: Arc<[Token]>,
    /// Lower and upper corners, world units. A box contains its lower faces and not its upper ones.
    pub boxes: Vec<[DVec3; 2]>,
}

/// Groups boxes by their tokens, in the order in which the tokens first occur.
pub(crate) fn grouped(pieces: impl IntoIterator<Item = (Arc<[Token]>, [DVec3; 2])>) -> Vec<Part> {
    let mut places: FxHashMap<Arc<[Token]>, usize> = FxHashMap::default();
    let mut parts: Vec<Part> = Vec::new();
    for (tokens, cell) in pieces {
        let place = *places.entry(tokens.clone()).or_insert(parts.len());
        if place == parts.len() {
            parts.push(Part { tokens, boxes: Vec::new() });
        }
        parts[place].boxes.push(cell);
    }
    parts
}

/// A token without its parameters. A list of these determines the text of a specialised kernel.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(crate) enum StructureToken {
    Leaf(&'static str),
    Combine { op: Op, is_swapped: bool, joint: &'static str },
    DistanceOp(&'static str),
    Complement,
    Enter(&'static str),
    Leave,
}

/// The structure of a part.
pub(crate) fn structure(model: &Model, tokens: &[Token]) -> Vec<StructureToken> {
    tokens
        .iter()
        .map(|&token| match token {
            Token::Leaf(leaf) => StructureToken::Leaf(model.leaves[leaf as usize].primitive.name()),
            Token::Combine(i) => {
                let combine = model.combines[i as usize];
                let joint = match combine.blend {
                    Blend::Sharp => "sharp",
                    Blend::Smooth(_) => "smooth",
                    Blend::Chamfer(_) => "chamfer",
                };
                StructureToken::Combine { op: combine.op, is_swapped: combine.is_swapped, joint }
            }
            Token::DistanceOp(i) => StructureToken::DistanceOp(match model.levels[i as usize] {
                DistanceOp::Offset(_) => "offset",
                DistanceOp::Shell(_) => "shell",
                DistanceOp::Times(_) => "times",
            }),
            Token::Complement => StructureToken::Complement,
            Token::Enter(i) => StructureToken::Enter(match model.warps[i as usize].kind {
                WarpKind::Elongate(_) => "elongate",
                WarpKind::Twist(_) => "twist",
                WarpKind::Bend(_) => "bend",
                WarpKind::NearestCopy(_) => "nearest_copy",
            }),
            Token::Leave(_) => StructureToken::Leave,
        })
        .collect()
}
