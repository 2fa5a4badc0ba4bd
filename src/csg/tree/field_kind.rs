//! How near the field of a tree is to the distance from its surface.
//!
//! An offset shifts the field, and a joint compares the fields of its operands. Both are in world units if the field
//! has the slope of a distance. [`FieldKind`] follows from the operators alone, from the leaves to the root.

use super::kind::{Blend, Kind, Op};
use super::primitive::Primitive;

/// Relation of a field to the distance from its zero level set.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum FieldKind {
    /// The field is the distance at points whose nearest surface point lies on no edge. Level sets are offsets, and
    /// keep the edges of joints.
    Distance,
    /// As a distance, but for fillets, chamfers and samples of a grid, near which the slope is smaller.
    Joint,
    /// The slope differs from one on smooth parts of the surface.
    Scaled,
}

/// A child of a node: its operation, and how near its field is to the distance.
pub(super) struct Operand<'a> {
    pub kind: &'a Kind,
    pub field: FieldKind,
    pub error: f64,
}

impl FieldKind {
    /// The word of the Python interface.
    pub fn name(self) -> &'static str {
        match self {
            Self::Distance => "distance",
            Self::Joint => "joint",
            Self::Scaled => "scaled",
        }
    }

    fn of_primitive(primitive: &Primitive) -> Self {
        match primitive {
            Primitive::Volume(_) => Self::Joint,
            // A union of bars, and a tube that intersects itself: their faces belong to exact fields.
            Primitive::BoxFrame { .. } | Primitive::Torus { .. } => Self::Distance,
            _ if primitive.is_exact() => Self::Distance,
            _ => Self::Scaled,
        }
    }

    /// The relation of the field of a node.
    pub(super) fn of(kind: &Kind, operands: &[Operand<'_>]) -> Self {
        let worst = operands.iter().map(|operand| operand.field).max().unwrap_or(Self::Distance);
        match kind {
            Kind::Primitive(primitive) => Self::of_primitive(primitive),
            Kind::Combine { op: Op::Xor, .. } => worst.max(Self::Joint),
            Kind::Combine { blend: Blend::Smooth(_) | Blend::Chamfer(_), .. } => worst.max(Self::Joint),
            Kind::Elongate(_) if operands.iter().all(|operand| is_smooth_at_its_planes(operand.kind)) => Self::Distance,
            Kind::Times(_) | Kind::Twist(_) | Kind::Bend(_) | Kind::Elongate(_) => Self::Scaled,
            // The second child of a stencil is its mask.
            Kind::Stencil { .. } => operands.first().map_or(worst, |operand| operand.field),
            _ => worst,
        }
    }

    /// Bound of the difference of the field of a node from the distance near its surface, at points whose nearest
    /// surface point lies on no edge, world units; infinite if none is known.
    pub(super) fn error_of(kind: &Kind, operands: &[Operand<'_>]) -> f64 {
        let worst = operands.iter().map(|operand| operand.error).fold(0.0, f64::max);
        match kind {
            Kind::Primitive(Primitive::Volume(volume)) => volume.error().unwrap_or(f64::INFINITY),
            Kind::Primitive(primitive) if Self::of_primitive(primitive) == Self::Distance => 0.0,
            Kind::Combine { op: Op::Union | Op::Intersection | Op::Difference, blend: Blend::Sharp } => worst,
            Kind::Elongate(_) if Self::of(kind, operands) == Self::Distance => worst,
            Kind::Scale(factor) => factor * worst,
            Kind::Stencil { .. } => operands.first().map_or(worst, |operand| operand.error),
            Kind::Primitive(_)
            | Kind::Combine { .. }
            | Kind::Elongate(_)
            | Kind::Times(_)
            | Kind::Twist(_)
            | Kind::Bend(_) => f64::INFINITY,
            _ => worst,
        }
    }

    /// Whether a node shifts or compares fields that do not have the slope of a distance, so that its size is not in
    /// world units.
    pub(super) fn is_misused(kind: &Kind, operands: &[Operand<'_>]) -> bool {
        let worst = operands.iter().map(|operand| operand.field).max().unwrap_or(Self::Distance);
        match kind {
            // A multiplied field is shifted on purpose, for instance to a thickness.
            Kind::Offset(_) | Kind::Shell(_) => {
                let is_unknown = |operand: &Operand<'_>| operand.error == f64::INFINITY;
                operands.iter().any(|operand| is_unknown(operand) && !matches!(operand.kind, Kind::Times(_)))
            }
            Kind::Combine { blend: Blend::Smooth(_), .. } => worst == Self::Scaled,
            _ => false,
        }
    }
}

/// Whether a convex shape is symmetric about the coordinate planes and has no edge in them, so that the pieces between
/// which [`Kind::Elongate`] inserts prisms meet them without a crease.
fn is_smooth_at_its_planes(kind: &Kind) -> bool {
    use Primitive::{Box, Capsule, Cylinder, Ellipsoid, RoundedCylinder, Sphere};
    matches!(
        kind,
        Kind::Primitive(
            Sphere { .. } | Ellipsoid { .. } | Box { .. } | Cylinder { .. } | RoundedCylinder { .. } | Capsule { .. }
        )
    )
}
