//! Placements of leaves, and changes of the position.

use super::kind::Kind;
use glam::{DMat3, DVec3};

/// A rotation or reflection, a translation and a uniform scale. `world = rotation * leaf + translation` places a leaf
/// whose parameters are already scaled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Placement {
    pub rotation: DMat3,
    pub translation: DVec3,
    /// Number of units of the parent in one unit of the placed object.
    pub scale: f64,
}

impl Placement {
    pub const HERE: Self = Self { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, scale: 1.0 };

    /// The composition of two placements: `inner` first, then `self`.
    pub fn then(&self, inner: &Self) -> Self {
        Self {
            rotation: self.rotation * inner.rotation,
            translation: self.translation + self.scale * (self.rotation * inner.translation),
            scale: self.scale * inner.scale,
        }
    }

    /// The placement of the child of a node; its own place for all kinds that do not move it.
    pub(crate) fn of_kind(kind: &Kind) -> Self {
        match *kind {
            Kind::Move(translation) => Self { translation, ..Self::HERE },
            Kind::Rotate { axis, degrees } => Self { rotation: rotation(axis, degrees), ..Self::HERE },
            Kind::Turn(turn) => Self { rotation: DMat3::from_quat(turn), ..Self::HERE },
            Kind::Scale(scale) => Self { scale, ..Self::HERE },
            Kind::Reflect(normal) => reflection(normal),
            _ => Self::HERE,
        }
    }
}

/// Whether a vector has one component.
pub(crate) fn is_coordinate_axis(axis: DVec3) -> bool {
    axis.to_array().iter().filter(|&&component| component != 0.0).count() == 1
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
pub(crate) fn reflection(normal: DVec3) -> Placement {
    let outer = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
    Placement { rotation: DMat3::IDENTITY - 2.0 * outer, ..Placement::HERE }
}

/// A change of the position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Warp {
    pub kind: WarpKind,
    pub place: Placement,
    /// Upper bound on the stretch, the ratio of distances inside to distances outside. Distances are divided by it.
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
    /// One of the copies nearest to a point.
    NearestCopy(Lattice),
}

/// Copies about the origin, of which one is selected: along each axis the nearer or the farther one of the two whose
/// cells are nearest to a point.
///
/// Let the box of the child be at most as wide as the spacing along an axis. Let `p` lie between the centres of two
/// neighbouring boxes, and let `q` be a point of a copy beyond the upper one. Its image `q - spacing` in the next lower
/// copy is at least as near to `p`, since `q - p` is at least half a spacing along the axis. So the nearest point of
/// all copies belongs to one of the two copies along each axis, and their union has the distances of the union of all.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    pub spacing: DVec3,
    /// Copies along each axis.
    pub counts: [u32; 3],
    /// Centre of the box of the child.
    pub middle: DVec3,
    /// Bit `a` selects the upper one of the two copies along axis `a`.
    pub upper: u8,
}

impl Lattice {
    /// For each axis: the spacing, its inverse, the position of the origin in cells, the largest lower cell, and the
    /// step from the lower cell to the copy that is selected, counted from the middle of all copies.
    pub fn numbers(&self, scale: f64) -> [[f64; 5]; 3] {
        [0, 1, 2].map(|axis| {
            let (spacing, count) = (scale * self.spacing[axis], f64::from(self.counts[axis]));
            if self.counts[axis] == 1 {
                return [0.0; 5];
            }
            let half = 0.5 * (count - 1.0);
            let step = f64::from(self.upper >> axis & 1) - half;
            [spacing, 1.0 / spacing, half - self.middle[axis] / self.spacing[axis], count - 2.0, step]
        })
    }

    /// Half the distance between the outermost copies along each axis.
    pub fn reach(&self) -> DVec3 {
        0.5 * self.spacing.abs() * (DVec3::from(self.counts.map(f64::from)) - 1.0)
    }
}

/// Stretch of a rotation whose angle grows along an axis. At distance `r` from the z axis, the derivative of the
/// position is a rotation plus a term of norm `rate * r`, so its norm is at most `1 + rate * r`. The bound is evaluated
/// at `max(r, radius)`, where `radius` is twice the child's: every point of a straight segment from a point at distance
/// `r` to the solid is at most that far from the axis.
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

/// The numbers of a lattice in the order of shaders: each as a vector over the axes.
pub(crate) fn by_number(axes: &[[f32; 5]; 3]) -> [[f32; 3]; 5] {
    std::array::from_fn(|number| axes.map(|axis| axis[number]))
}
