//! Decomposition of a shape into parts, smaller shapes that replace it inside their own boxes.
//!
//! # Theory
//!
//! Tracing a ray through a shape of a thousand leaves evaluates a thousand leaves per step, although only a few of them
//! determine the surface near any point. A *part* is a list of tokens over the model's tables, and the boxes in which
//! that list replaces the whole:
//!
//! - [`Method::Aabb`] is the method of A. Palecek, "SDF Decomposition" (2021): boxes are carried from the leaves to the
//!   root, split and discarded by the operators ([`super::carried_boxes`]). The solid is the *union* of the parts, each
//!   cut to its boxes. Boxes of different parts may overlap, and the nearest hit is used.
//! - [`Method::Octree`] divides space into cells and keeps in each only the leaves that can influence it
//!   ([`super::octree`]). In its boxes a part has the sign and the roots of the whole; the boxes do not overlap.
//!
//! # Practice
//!
//! Parts of equal structure differ only in their parameters, see [`structure`](super::part::structure): they share one
//! shader.

use super::cells::PartCells;
use super::part::{Method, Part};
use super::solid::Solid;
use super::{carried_boxes, octree};
use crate::csg::model::lowered::{Coat, DistanceOp, Model};
use crate::csg::model::token::{Operation, Token, fold_postfix};
use crate::csg::tree::kind::{Blend, Kind, Op};
use crate::csg::tree::placement::{Placement, WarpKind};
use crate::csg::tree::shape::Shape;
use crate::error::{Error, ShapeError};
use glam::{DMat3, DQuat, DVec3};

/// Decomposes a shape. An empty shape has no parts.
pub(crate) fn decompose(solid: &Solid, method: Method) -> Result<Vec<Part>, Error> {
    solid.bounds()?;
    if solid.model.extent.is_empty() {
        return Ok(Vec::new());
    }
    Ok(match method {
        Method::Aabb => carried_boxes::parts(&solid.model),
        Method::Octree => octree::parts(solid),
    })
}

impl Solid {
    /// The parts of a decomposition, computed at the first call.
    pub fn parts(&self, method: Method) -> Result<&[Part], Error> {
        let known = &self.parts[method as usize];
        if known.get().is_none() {
            // Two threads may compute them at the same time, with the same result.
            let _ = known.set(decompose(self, method)?);
        }
        Ok(known.get().map_or(&[], Vec::as_slice))
    }

    /// The parts of a decomposition, prepared for rays at the first call.
    pub(crate) fn cells(&self, method: Method) -> Result<&PartCells, Error> {
        let parts = self.parts(method)?;
        Ok(self.cells[method as usize].get_or_init(|| PartCells::new(self.tables(), parts)))
    }
}

/// A part as a shape of its own, with every leaf in its placement.
pub(crate) fn shape_of(model: &Model, tokens: &[Token]) -> Result<Shape, ShapeError> {
    let shape = fold_postfix(tokens, |operation| Some(applied(model, operation)));
    shape.unwrap_or_else(|| Err(ShapeError::argument("shape", "has no parts")))
}

/// The shape of one token.
fn applied(model: &Model, operation: Operation<Result<Shape, ShapeError>>) -> Result<Shape, ShapeError> {
    match operation {
        Operation::Leaf(i) => {
            let leaf = &model.leaves[i as usize];
            let bare = Shape::primitive(leaf.primitive.clone());
            coated(placed(&bare, &leaf.place)?, leaf.paint.as_deref())
        }
        Operation::Combine(i, first, second) => {
            let combine = model.combines[i as usize];
            let [a, b] = combine.in_order(first?, second?);
            joined(combine.op, combine.blend, a, b)
        }
        Operation::DistanceOp(i, operand) => match model.levels[i as usize] {
            DistanceOp::Offset(distance) => operand?.changed("offset", &[distance]),
            DistanceOp::Shell(thickness) => operand?.changed("shell", &[thickness]),
            DistanceOp::Times(factor) => operand?.changed("times", &[factor]),
        },
        Operation::Complement(operand) => operand?.changed("complement", &[]),
        Operation::Warp(i, operand) => {
            let warp = model.warps[i as usize];
            let warped = match warp.kind {
                WarpKind::Elongate(half) => operand?.changed("elongate", &half.to_array()),
                WarpKind::Twist(rate) => operand?.changed("twist", &[rate.to_degrees()]),
                WarpKind::Bend(rate) => operand?.changed("bend", &[rate.to_degrees()]),
                // The child is one leaf, so every part has all of it, and the other copies belong to the whole shape.
                WarpKind::NearestCopy(lattice) => {
                    let counts = lattice.counts.map(f64::from);
                    operand?.changed("repeat", &[lattice.spacing.to_array(), counts].concat())
                }
            };
            placed(&warped?, &warp.place)
        }
    }
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
fn placed(shape: &Shape, place: &Placement) -> Result<Shape, ShapeError> {
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
