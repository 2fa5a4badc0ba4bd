//! Decomposition of a shape into parts, smaller shapes that replace it inside their own boxes.
//!
//! # Theory
//!
//! Tracing a ray through a shape of a thousand leaves evaluates a thousand leaves per step, although only a few of them
//! determine the surface near any point. A *part* is a list of tokens over the model's tables, and the boxes in which
//! that list replaces the whole:
//!
//! - [`Method::Aabb`] is the method of A. Palecek, "SDF Decomposition" (2021): boxes are carried from the leaves to the
//!   root, split and discarded by the operators ([`super::aabb`]). The solid is the *union* of the parts, each cut to
//!   its boxes. Boxes of different parts may overlap, and the nearest hit is used.
//! - [`Method::Octree`] divides space into cells and keeps in each only the leaves that can influence it
//!   ([`super::octree`]). In its boxes a part has the sign and the roots of the whole; the boxes do not overlap.
//!
//! # Practice
//!
//! Parts of equal structure differ only in their parameters, see [`structure`]: they share one shader.

use super::model::{Coat, Model, Place, Token, WarpKind};
use super::shape::{Blend, Kind, Op, Shape};
use super::solid::Solid;
use super::{aabb, octree};
use crate::error::{Error, ShapeError, choice};
use glam::{DMat3, DQuat, DVec3};
use rustc_hash::FxHashMap;
use std::hash::Hash;
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

/// Decomposes a shape. An empty shape has no parts.
pub fn decompose(solid: &Solid, method: Method) -> Result<Vec<Part>, Error> {
    solid.bounds()?;
    if solid.model.extent.is_empty() {
        return Ok(Vec::new());
    }
    Ok(match method {
        Method::Aabb => aabb::parts(&solid.model),
        Method::Octree => octree::parts(solid),
    })
}

/// Groups boxes by their tokens, in the order in which the tokens first occur.
pub fn grouped(pieces: impl IntoIterator<Item = (Arc<[Token]>, [DVec3; 2])>) -> Vec<Part> {
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

/// The input of a shader's compilation: operators and kinds of leaves, without their parameters.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum StructureToken {
    Leaf(&'static str),
    Combine { op: Op, is_swapped: bool, joint: &'static str },
    Level(&'static str),
    Complement,
    Enter(&'static str),
    Leave,
}

/// The structure of a part.
pub fn structure(model: &Model, tokens: &[Token]) -> Vec<StructureToken> {
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
            Token::Level(i) => StructureToken::Level(match model.levels[i as usize] {
                super::model::Level::Offset(_) => "offset",
                super::model::Level::Shell(_) => "shell",
            }),
            Token::Complement => StructureToken::Complement,
            Token::Enter(i) => StructureToken::Enter(match model.warps[i as usize].kind {
                WarpKind::Elongate(_) => "elongate",
                WarpKind::Twist(_) => "twist",
                WarpKind::Bend(_) => "bend",
            }),
            Token::Leave(_) => StructureToken::Leave,
        })
        .collect()
}

/// A part as a shape of its own, with every leaf in its placement.
pub fn shape_of(model: &Model, tokens: &[Token]) -> Result<Shape, ShapeError> {
    let mut stack: Vec<Shape> = Vec::new();
    for &token in tokens {
        let shape = match token {
            Token::Leaf(i) => {
                let leaf = &model.leaves[i as usize];
                let bare = Shape::primitive(leaf.primitive.clone());
                coated(placed(&bare, &leaf.place)?, leaf.paint.as_deref())?
            }
            Token::Combine(i) => {
                let combine = model.combines[i as usize];
                let (top, below) = (pop(&mut stack), pop(&mut stack));
                let (a, b) = if combine.is_swapped { (top, below) } else { (below, top) };
                joined(combine.op, combine.blend, a, b)?
            }
            Token::Level(i) => match model.levels[i as usize] {
                super::model::Level::Offset(distance) => pop(&mut stack).changed("offset", &[distance])?,
                super::model::Level::Shell(thickness) => pop(&mut stack).changed("shell", &[thickness])?,
            },
            Token::Complement => pop(&mut stack).changed("complement", &[])?,
            Token::Enter(_) => continue,
            Token::Leave(i) => {
                let warp = model.warps[i as usize];
                let child = pop(&mut stack);
                let warped = match warp.kind {
                    WarpKind::Elongate(half) => child.changed("elongate", &half.to_array())?,
                    WarpKind::Twist(rate) => child.changed("twist", &[rate.to_degrees()])?,
                    WarpKind::Bend(rate) => child.changed("bend", &[rate.to_degrees()])?,
                };
                placed(&warped, &warp.place)?
            }
        };
        stack.push(shape);
    }
    stack.pop().ok_or_else(|| ShapeError::argument("shape", "has no parts"))
}

fn pop(stack: &mut Vec<Shape>) -> Shape {
    stack.pop().expect("tokens are in postfix order")
}

/// A sharp operator over the same operator becomes one with more operands.
fn joined(op: Op, blend: Blend, a: Shape, b: Shape) -> Result<Shape, ShapeError> {
    let operands = match a.kind() {
        Kind::Combine { op: inner, blend: Blend::Sharp } if *inner == op && blend == Blend::Sharp => {
            [a.children(), &[b]].concat()
        }
        _ => vec![a, b],
    };
    Shape::combine(op, blend, operands)
}

/// Scaled, rotated and moved, without the changes that have no effect.
fn placed(shape: &Shape, place: &Place) -> Result<Shape, ShapeError> {
    let mut shape = shape.clone();
    if place.scale != 1.0 {
        shape = shape.changed("scale", &[place.scale])?;
    }
    let mut rotation = place.rotation;
    if rotation.determinant() < 0.0 {
        // A rotation after a reflection in x.
        rotation *= DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0));
        shape = shape.changed("reflect", &[1.0, 0.0, 0.0])?;
    }
    if rotation != DMat3::IDENTITY {
        let (axis, angle) = DQuat::from_mat3(&rotation).normalize().to_axis_angle();
        shape = shape.changed("rotate", &[axis.x, axis.y, axis.z, whole(angle.to_degrees())])?;
    }
    if place.translation != DVec3::ZERO {
        shape = shape.changed("translate", &place.translation.to_array())?;
    }
    Ok(shape)
}

/// Rounds to a whole number of degrees if only the rounding of the quaternion separates them.
fn whole(degrees: f64) -> f64 {
    if (degrees - degrees.round()).abs() < 1e-9 { degrees.round() } else { degrees }
}

/// Applies the paint of a leaf.
fn coated(mut shape: Shape, coat: Option<&Coat>) -> Result<Shape, ShapeError> {
    let mut next = coat;
    while let Some(coat) = next {
        let color = coat.color.map(f64::from);
        shape = match &coat.mask {
            Some(mask) => shape.stencil(&placed(&mask.shape, &mask.place)?, color, mask.outside)?,
            None => shape.changed(if coat.over { "paint_over" } else { "paint" }, &color)?,
        };
        next = coat.above.as_deref();
    }
    Ok(shape)
}
