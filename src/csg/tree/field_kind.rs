//! How near the field of a tree is to the distance from its surface.
//!
//! An offset shifts the field, and a joint compares the fields of its operands. Both are in world units if the field
//! has the slope of a distance. [`FieldKind`] follows from the operators alone, from the leaves to the root.

use super::primitive::Primitive;
use super::shape::{Blend, Kind, Op, Shape};

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
    pub(super) fn of(kind: &Kind, children: &[Shape]) -> Self {
        let worst = children.iter().map(Shape::field_kind).max().unwrap_or(Self::Distance);
        match kind {
            Kind::Primitive(primitive) => Self::of_primitive(primitive),
            Kind::Combine { op: Op::Xor, .. } => worst.max(Self::Joint),
            Kind::Combine { blend: Blend::Smooth(_) | Blend::Chamfer(_), .. } => worst.max(Self::Joint),
            Kind::Elongate(_) if children.iter().all(is_smooth_at_its_planes) => Self::Distance,
            Kind::Times(_) | Kind::Twist(_) | Kind::Bend(_) | Kind::Elongate(_) => Self::Scaled,
            // The second child of a stencil is its mask.
            Kind::Stencil { .. } => children.first().map_or(worst, Shape::field_kind),
            _ => worst,
        }
    }

    /// Bound of the difference of the field of a node from the distance near its surface, at points whose nearest
    /// surface point lies on no edge, world units; infinite if none is known.
    pub(super) fn error_of(kind: &Kind, children: &[Shape]) -> f64 {
        let worst = children.iter().map(Shape::field_error).fold(0.0, f64::max);
        match kind {
            Kind::Primitive(Primitive::Volume(volume)) => volume.error().unwrap_or(f64::INFINITY),
            Kind::Primitive(primitive) if Self::of_primitive(primitive) == Self::Distance => 0.0,
            Kind::Combine { op: Op::Union | Op::Intersection | Op::Difference, blend: Blend::Sharp } => worst,
            Kind::Elongate(_) if Self::of(kind, children) == Self::Distance => worst,
            Kind::Scale(factor) => factor * worst,
            Kind::Stencil { .. } => children.first().map_or(worst, Shape::field_error),
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
    pub(super) fn is_misused(kind: &Kind, children: &[Shape]) -> bool {
        let worst = children.iter().map(Shape::field_kind).max().unwrap_or(Self::Distance);
        match kind {
            // A multiplied field is shifted on purpose, for instance to a thickness.
            Kind::Offset(_) | Kind::Shell(_) => {
                let is_unknown = |child: &Shape| child.field_error() == f64::INFINITY;
                children.iter().any(|child| is_unknown(child) && !matches!(child.kind(), Kind::Times(_)))
            }
            Kind::Combine { blend: Blend::Smooth(_), .. } => worst == Self::Scaled,
            _ => false,
        }
    }
}

/// Whether a convex shape is symmetric about the coordinate planes and has no edge in them, so that the pieces between
/// which [`Kind::Elongate`] inserts prisms meet them without a crease.
fn is_smooth_at_its_planes(shape: &Shape) -> bool {
    use Primitive::{Box, Capsule, Cylinder, Ellipsoid, RoundedCylinder, Sphere};
    matches!(
        shape.kind(),
        Kind::Primitive(
            Sphere { .. } | Ellipsoid { .. } | Box { .. } | Cylinder { .. } | RoundedCylinder { .. } | Capsule { .. }
        )
    )
}
