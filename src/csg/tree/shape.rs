//! The tree that a user builds: immutable, with shared subtrees, of any depth.
//!
//! A [`Shape`] is a counted reference to a node. Operators make new nodes over existing ones, so a subtree may occur in
//! many trees, and several times in one tree. No function recurses: a tree of a hundred thousand levels is built,
//! traversed and dropped.

use super::checks::{finite, not_negative, positive, unit};
use super::ends::Ends;
use super::field_kind::{FieldKind, Operand};
use super::kind::{Blend, Kind, Op};
use super::placement::is_coordinate_axis;
use super::primitive::Primitive;
use super::profile::Profile;
use super::volume_leaf::VolumeLeaf;
use crate::error::ShapeError;
use glam::{DQuat, DVec3};
use std::sync::Arc;

/// A solid: a leaf, or operators over others.
#[derive(Debug, Clone)]
pub struct Shape(Arc<ShapeNode>);

#[derive(Debug)]
pub(crate) struct ShapeNode {
    pub kind: Kind,
    pub children: Vec<Shape>,
    /// Number of leaves with all repetitions written out.
    leaves: u64,
    /// As `leaves`, with eight copies for a repetition of more than [`MAX_COPIES`].
    evaluated: u64,
    field_kind: FieldKind,
    field_error: f64,
    is_misused: bool,
}

/// Largest number of leaves of a shape, with repetitions written out.
pub(crate) const MAX_LEAVES: u64 = 1 << 20;

/// Repetitions of more copies are evaluated at the copies nearest to a point where that is possible. Few copies are
/// written out, since decomposition and rays use the boxes of each.
pub(crate) const MAX_COPIES: u64 = 64;

impl Shape {
    fn node(kind: Kind, children: Vec<Self>) -> Result<Self, ShapeError> {
        let copies = match &kind {
            Kind::Mirror(_) => 2,
            Kind::Repeat { counts, .. } => copies_of(*counts),
            _ => 1,
        };
        let selected = if copies > MAX_COPIES { 8 } else { copies };
        let below = children.iter().map(|child| child.0.leaves).fold(0, u64::saturating_add).max(1);
        let leaves = below.saturating_mul(copies);
        let evaluated = children.iter().map(Self::evaluated_leaves).sum::<u64>().max(1).saturating_mul(selected);
        if evaluated > MAX_LEAVES {
            return Err(too_many_leaves());
        }
        Ok(Self::made(kind, children, leaves, evaluated))
    }

    /// A primitive as a shape.
    pub fn primitive(primitive: Primitive) -> Self {
        Self::made(Kind::Primitive(primitive), Vec::new(), 1, 1)
    }

    fn made(kind: Kind, children: Vec<Self>, leaves: u64, evaluated: u64) -> Self {
        let operands: Vec<Operand<'_>> = children.iter().map(Self::operand).collect();
        let field_kind = FieldKind::of(&kind, &operands);
        let field_error = FieldKind::error_of(&kind, &operands);
        let is_misused = FieldKind::is_misused(&kind, &operands) || children.iter().any(|child| child.0.is_misused);
        Self(Arc::new(ShapeNode { kind, children, leaves, evaluated, field_kind, field_error, is_misused }))
    }

    fn operand(&self) -> Operand<'_> {
        Operand { kind: &self.0.kind, field: self.0.field_kind, error: self.0.field_error }
    }

    /// A baked field.
    pub fn volume(volume: VolumeLeaf) -> Self {
        Self::primitive(Primitive::Volume(Arc::new(volume)))
    }

    /// A profile extruded along z, with `height` in total, `taper_deg` degrees and two chamfers.
    pub fn extrude(profile: Arc<Profile>, height: f64, taper_deg: f64, chamfer: [f64; 2]) -> Result<Self, ShapeError> {
        let half_height = 0.5 * positive("height", height)?;
        let ends = Ends::new(taper_deg, chamfer, height)?;
        Ok(Self::primitive(Primitive::Extrude { profile, half_height, ends }))
    }

    /// A profile revolved about z.
    pub fn revolve(profile: Arc<Profile>, offset: f64) -> Result<Self, ShapeError> {
        let offset = finite("offset", offset)?;
        if profile.reach(offset) <= 0.0 {
            let problem = format!("the profile lies beyond the axis, nothing is left at x + {offset} > 0");
            return Err(ShapeError::argument("offset", problem));
        }
        let (profile, offset) = profile.joined_at_axis(offset);
        Ok(Self::primitive(Primitive::Revolve { profile, offset }))
    }

    /// Combines shapes by an operator. Fails if there are too few of them.
    pub fn combine(op: Op, blend: Blend, mut shapes: Vec<Self>) -> Result<Self, ShapeError> {
        if shapes.len() > 1 {
            return Self::node(Kind::Combine { op, blend }, shapes);
        }
        shapes.pop().ok_or_else(|| ShapeError::argument("shapes", format!("a {} needs at least one shape", op.name())))
    }

    /// The children, from the last to the first. An operator whose first child is the same sharp operator has the
    /// children of both, because both combine from the left.
    pub(crate) fn operands(&self) -> Vec<&Self> {
        let mut operands: Vec<&Self> = self.children().iter().rev().collect();
        while let Some(&first) = operands.last()
            && matches!(self.kind(), Kind::Combine { blend: Blend::Sharp, .. })
            && first.kind() == self.kind()
        {
            operands.pop();
            operands.extend(first.children().iter().rev());
        }
        operands
    }

    /// A change of one shape by its name and numbers in the Python interface.
    pub fn changed(&self, name: &str, numbers: &[f64]) -> Result<Self, ShapeError> {
        let vector = |argument, x, y, z| -> Result<DVec3, ShapeError> {
            Ok(DVec3::new(finite(argument, x)?, finite(argument, y)?, finite(argument, z)?))
        };
        let kind = match (name, numbers) {
            ("translate", &[x, y, z]) => Kind::Move(vector("offset", x, y, z)?),
            ("rotate", &[x, y, z, degrees]) => {
                let (axis, degrees) = (unit("axis", [x, y, z])?, finite("degrees", degrees)?);
                if is_coordinate_axis(axis) {
                    Kind::Rotate { axis: axis.abs(), degrees: degrees * axis.element_sum() }
                } else {
                    Kind::Turn(DQuat::from_axis_angle(axis, degrees.rem_euclid(720.0).to_radians()))
                }
            }
            ("turn", &[x, y, z, w]) => Kind::Turn(DQuat::from_xyzw(x, y, z, w)),
            ("scale", &[factor]) => {
                let factor = positive("factor", factor)?;
                if factor < 1e-30 {
                    return Err(ShapeError::argument("factor", format!("must be at least 1e-30, got {factor}")));
                }
                Kind::Scale(factor)
            }
            ("offset", &[distance]) => Kind::Offset(finite("distance", distance)?),
            ("shell", &[thickness]) => Kind::Shell(positive("thickness", thickness)?),
            ("times", &[factor]) => {
                if !(1e-6..=1e6).contains(&factor) {
                    return Err(ShapeError::argument("factor", format!("must be 1e-6 to 1e6, got {factor}")));
                }
                Kind::Times(factor)
            }
            ("complement", &[]) => Kind::Complement,
            ("elongate", &[x, y, z]) => {
                Kind::Elongate(DVec3::new(not_negative("size", x)?, not_negative("size", y)?, not_negative("size", z)?))
            }
            ("reflect", &[x, y, z]) => Kind::Reflect(unit("axis", [x, y, z])?),
            ("mirror", &[x, y, z]) => Kind::Mirror(unit("axis", [x, y, z])?),
            ("repeat", &[x, y, z, nx, ny, nz]) => {
                Kind::Repeat { spacing: vector("spacing", x, y, z)?, counts: counts([nx, ny, nz])? }
            }
            ("twist", &[degrees]) => Kind::Twist(finite("degrees", degrees)?),
            ("bend", &[degrees]) => Kind::Bend(finite("degrees", degrees)?),
            ("paint", &[r, g, b]) => Kind::Paint { color: color([r, g, b])?, over: false },
            ("paint_over", &[r, g, b]) => Kind::Paint { color: color([r, g, b])?, over: true },
            _ => {
                let problem = format!("there is no change '{name}' of {} numbers", numbers.len());
                return Err(ShapeError::argument("name", problem));
            }
        };
        Self::node(kind, vec![self.clone()])
    }

    /// The shape, painted inside `mask` or outside of it.
    pub fn stencil(&self, mask: &Self, rgb: [f64; 3], outside: bool) -> Result<Self, ShapeError> {
        Self::node(Kind::Stencil { color: color(rgb)?, outside }, vec![self.clone(), mask.clone()])
    }

    /// Replaces the joint at the root.
    pub fn reblended(&self, blend: Blend) -> Result<Self, ShapeError> {
        match self.kind() {
            Kind::Combine { op, .. } => Self::combine(*op, blend, self.children().to_vec()),
            _ => Err(ShapeError::argument(
                "shape",
                "has no operator at its root whose joint may be smooth or chamfered; combine first",
            )),
        }
    }

    /// The kind of the node at the root.
    pub fn kind(&self) -> &Kind {
        &self.0.kind
    }

    /// The shapes that the root combines or changes.
    pub fn children(&self) -> &[Self] {
        &self.0.children
    }

    /// The relation of the field to the distance.
    pub fn field_kind(&self) -> FieldKind {
        self.0.field_kind
    }

    /// Bound of the difference between the field and the distance near the surface, at points whose nearest surface
    /// point lies on no edge, world units; infinite if none is known.
    pub fn field_error(&self) -> f64 {
        self.0.field_error
    }

    /// Whether a size in the tree is in units of a field that is no distance.
    pub fn is_misused(&self) -> bool {
        self.0.is_misused
    }

    /// Number of leaves, with repetitions written out.
    pub fn leaf_count(&self) -> u64 {
        self.0.leaves
    }

    /// Number of leaves, with eight copies for a repetition of more than [`MAX_COPIES`].
    pub fn evaluated_leaves(&self) -> u64 {
        self.0.evaluated
    }
}

/// Number of copies of a repetition.
pub(crate) fn copies_of(counts: [u32; 3]) -> u64 {
    counts.iter().fold(1, |all: u64, &n| all.saturating_mul(u64::from(n)))
}

/// The error of a shape with more than [`MAX_LEAVES`] leaves.
pub(crate) fn too_many_leaves() -> ShapeError {
    let problem = format!("has more leaves than the limit of {MAX_LEAVES}, with repetitions written out");
    ShapeError::argument("shape", problem)
}

/// The numbers of copies along the axes.
fn counts(numbers: [f64; 3]) -> Result<[u32; 3], ShapeError> {
    if let Some(n) = numbers.into_iter().find(|&n| !(n >= 1.0 && n.fract() == 0.0 && n <= MAX_LEAVES as f64)) {
        let problem = format!("must be whole numbers from 1 to {MAX_LEAVES}, got {n}");
        return Err(ShapeError::argument("counts", problem));
    }
    Ok(numbers.map(|n| n as u32))
}

fn color(rgb: [f64; 3]) -> Result<[f32; 3], ShapeError> {
    if rgb.iter().all(|c| (0.0..=FAR_COLOR).contains(c)) {
        return Ok(rgb.map(|c| c as f32));
    }
    Err(ShapeError::argument("color", format!("must be three numbers of at least 0, got {rgb:?}")))
}

const FAR_COLOR: f64 = 1e6;

impl Drop for ShapeNode {
    /// Drops a tree without recursion: children without other owners are dropped one by one.
    fn drop(&mut self) {
        let mut waiting = std::mem::take(&mut self.children);
        while let Some(shape) = waiting.pop() {
            if let Some(mut node) = Arc::into_inner(shape.0) {
                waiting.append(&mut node.children);
            }
        }
    }
}

/// Compares node by node, without recursion.
impl PartialEq for Shape {
    fn eq(&self, other: &Self) -> bool {
        let mut waiting = vec![(self, other)];
        while let Some((a, b)) = waiting.pop() {
            if Arc::ptr_eq(&a.0, &b.0) {
                continue;
            }
            if a.kind() != b.kind() {
                return false;
            }
            let (first, second) = (a.operands(), b.operands());
            if first.len() != second.len() {
                return false;
            }
            waiting.extend(first.into_iter().zip(second));
        }
        true
    }
}
