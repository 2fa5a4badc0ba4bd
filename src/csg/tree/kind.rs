//! The operations of the nodes of a shape.

use super::checks::not_negative;
use super::primitive::Primitive;
use crate::error::ShapeError;
use glam::{DQuat, DVec3};

/// Operation of a node on its children.
#[derive(Debug, Clone, PartialEq)]
pub enum Kind {
    Primitive(Primitive),
    /// Two children or more, combined from the left.
    Combine {
        op: Op,
        blend: Blend,
    },
    Move(DVec3),
    /// Right-handed rotation about one of the coordinate axes.
    Rotate {
        axis: DVec3,
        degrees: f64,
    },
    /// Rotation by a unit quaternion, about any other axis.
    Turn(DQuat),
    Scale(f64),
    /// All points within this distance; a negative distance shrinks the solid.
    Offset(f64),
    /// A shell of this thickness about the surface.
    Shell(f64),
    /// The child with its field multiplied by this factor.
    Times(f64),
    /// The complement of the child.
    Complement,
    /// The child, pulled apart at the planes through the origin by this length on each side.
    Elongate(DVec3),
    /// The mirror image in the plane through the origin with this unit normal.
    Reflect(DVec3),
    /// The union of the child and its mirror image in the plane through the origin with this unit normal.
    Mirror(DVec3),
    /// Copies on a lattice about the origin.
    Repeat {
        spacing: DVec3,
        counts: [u32; 3],
    },
    /// The child, rotated about z by this number of degrees per unit of z.
    Twist(f64),
    /// The child, rotated about z by this number of degrees per unit of x.
    Bend(f64),
    /// Linear RGB. `over` replaces colours below; otherwise they stay.
    Paint {
        color: [f32; 3],
        over: bool,
    },
    /// The first child, painted inside the second (or outside).
    Stencil {
        color: [f32; 3],
        outside: bool,
    },
}

/// Boolean operators.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Op {
    /// Points inside any of the shapes.
    Union,
    /// Points inside all of the shapes.
    Intersection,
    /// Points inside the first shape and outside the others.
    Difference,
    /// Points inside exactly one of the two shapes.
    Xor,
}

/// Shape of a joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Blend {
    /// No blend: the minimum or maximum itself.
    Sharp,
    /// A fillet: the field differs from the sharp one where the difference of the operands is below this width.
    Smooth(f64),
    /// A flat at 45 degrees that cuts this width off each operand.
    Chamfer(f64),
}

impl Op {
    /// All operators.
    pub const ALL: [Self; 4] = [Self::Union, Self::Intersection, Self::Difference, Self::Xor];

    /// The word of the language and of messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Union => "union",
            Self::Intersection => "intersection",
            Self::Difference => "difference",
            Self::Xor => "xor",
        }
    }
}

impl Blend {
    /// At most one of the two widths may be above zero.
    pub fn new(k: f64, chamfer: f64) -> Result<Self, ShapeError> {
        match (not_negative("k", k)?, not_negative("chamfer", chamfer)?) {
            (0.0, 0.0) => Ok(Self::Sharp),
            (k, 0.0) => Ok(Self::Smooth(k)),
            (0.0, chamfer) => Ok(Self::Chamfer(chamfer)),
            _ => Err(ShapeError::argument("chamfer", "give either k or chamfer, a joint has one form")),
        }
    }

    /// The width, zero for a sharp joint.
    pub fn width(self) -> f64 {
        match self {
            Self::Sharp => 0.0,
            Self::Smooth(k) | Self::Chamfer(k) => k,
        }
    }
}

impl Kind {
    /// The name and the arguments from which [`Shape::changed`] makes a change of one shape; `None` for other kinds.
    pub fn change(&self) -> Option<(&'static str, Vec<f64>)> {
        Some(match self {
            Self::Move(by) => ("translate", by.to_array().to_vec()),
            Self::Rotate { axis, degrees } => ("rotate", vec![axis.x, axis.y, axis.z, *degrees]),
            Self::Turn(turn) => ("turn", turn.to_array().to_vec()),
            Self::Scale(factor) => ("scale", vec![*factor]),
            Self::Offset(distance) => ("offset", vec![*distance]),
            Self::Shell(thickness) => ("shell", vec![*thickness]),
            Self::Times(factor) => ("times", vec![*factor]),
            Self::Complement => ("complement", Vec::new()),
            Self::Elongate(half) => ("elongate", half.to_array().to_vec()),
            Self::Reflect(normal) => ("reflect", normal.to_array().to_vec()),
            Self::Mirror(normal) => ("mirror", normal.to_array().to_vec()),
            Self::Repeat { spacing, counts } => ("repeat", [spacing.to_array(), counts.map(f64::from)].concat()),
            Self::Twist(degrees) => ("twist", vec![*degrees]),
            Self::Bend(degrees) => ("bend", vec![*degrees]),
            Self::Paint { color, over: false } => ("paint", color.map(f64::from).to_vec()),
            Self::Paint { color, over: true } => ("paint_over", color.map(f64::from).to_vec()),
            Self::Primitive(_) | Self::Combine { .. } | Self::Stencil { .. } => return None,
        })
    }
}
