//! Boxes of solids and of their level sets, carried from the leaves to the root.
//!
//! An operator may raise or lower the field of its operands (an offset, a fillet), so a box alone is not sufficient. An
//! [`Extent`] bounds *every* level set: `{field <= t}` lies in the box grown by `slack + growth * t` on every side for
//! `t > 0`, and shrunk by `-shrink * t` for `t < 0`. A box may be inverted: the intersection of two disjoint boxes has
//! a lower corner above its upper one. It grows into a proper box at the level at which the two grown boxes touch.

use crate::csg::tree::kind::{Blend, Op};
use crate::csg::tree::placement::{Placement, Warp, WarpKind};
use crate::csg::tree::primitive::Primitive;
use glam::DVec3;
use std::f64::consts::FRAC_1_SQRT_2;

/// Bounds of the level sets of a field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extent {
    pub lower: DVec3,
    pub upper: DVec3,
    pub growth: f64,
    pub slack: f64,
    /// Inverse of the Lipschitz constant of the field; 0 if that is unknown.
    pub shrink: f64,
    /// Name of the leaf whose side is infinite, for the message.
    pub unbounded: Option<&'static str>,
}

impl Extent {
    pub const EMPTY: Self = Self {
        lower: DVec3::INFINITY,
        upper: DVec3::NEG_INFINITY,
        growth: 1.0,
        slack: 0.0,
        shrink: 1.0,
        unbounded: None,
    };

    /// The box of a placed primitive, tight under any rotation.
    pub fn of_leaf(primitive: &Primitive, place: &Placement) -> Self {
        // The world axes in the space of the leaf.
        let axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| place.rotation.transpose() * axis);
        let upper = DVec3::from(axes.map(|axis| place.scale * primitive.support(axis)));
        let lower = DVec3::from(axes.map(|axis| -place.scale * primitive.support(-axis)));
        let (growth, slack) = primitive.growth();
        // The field of a leaf with slack may be steeper than the distance.
        let shrink = if slack > 0.0 { 0.0 } else { 1.0 };
        Self { growth, slack: place.scale * slack, shrink, ..Self::of_box(lower, upper, primitive.name()) }
            .moved(place.translation)
    }

    fn of_box(lower: DVec3, upper: DVec3, name: &'static str) -> Self {
        let is_bounded = lower.is_finite() && upper.is_finite();
        Self { lower, upper, growth: 1.0, slack: 0.0, shrink: 1.0, unbounded: (!is_bounded).then_some(name) }
    }

    fn moved(self, by: DVec3) -> Self {
        Self { lower: self.lower + by, upper: self.upper + by, ..self }
    }

    /// Whether the level set of zero is empty.
    pub fn is_empty(&self) -> bool {
        !self.lower.cmple(self.upper).all()
    }

    /// The extent of `field - t`.
    pub fn level(self, t: f64) -> Self {
        let grown = if t > 0.0 { self.slack + self.growth * t } else { self.shrink * t };
        // Growing uses up the slack.
        let slack = if t > 0.0 { 0.0 } else { self.slack };
        Self { lower: self.lower - grown, upper: self.upper + grown, slack, ..self }
    }

    /// The extent of `factor * field`.
    pub fn times(self, factor: f64) -> Self {
        Self { growth: self.growth / factor, shrink: self.shrink / factor, ..self }
    }

    /// The complement is unbounded.
    pub fn complement(self) -> Self {
        Self { lower: DVec3::NEG_INFINITY, upper: DVec3::INFINITY, unbounded: Some("complement"), ..self }
    }

    fn intersection(self, other: Self) -> Self {
        let (lower, upper) = (self.lower.max(other.lower), self.upper.min(other.upper));
        let is_bounded = lower.is_finite() && upper.is_finite();
        Self {
            lower,
            upper,
            growth: self.growth.max(other.growth),
            slack: self.slack.max(other.slack),
            shrink: self.shrink.min(other.shrink),
            unbounded: if is_bounded { None } else { self.unbounded.or(other.unbounded) },
        }
    }

    fn union(self, other: Self) -> Self {
        Self {
            lower: self.lower.min(other.lower),
            upper: self.upper.max(other.upper),
            growth: self.growth.max(other.growth),
            slack: self.slack.max(other.slack),
            shrink: self.shrink.min(other.shrink),
            unbounded: self.unbounded.or(other.unbounded),
        }
    }

    pub fn combined(op: Op, blend: Blend, a: Self, b: Self) -> Self {
        match op {
            Op::Union | Op::Xor => {
                let both = a.union(b);
                // A fillet lies where both fields are at most k; see `Blend`.
                let filleted = |k| both.union(a.level(k).intersection(b.level(k)));
                match blend {
                    Blend::Sharp => both,
                    Blend::Smooth(k) => filleted(k),
                    // The field of a chamfer is steeper than its operands by sqrt(2) at most; see `Blend`.
                    Blend::Chamfer(k) => {
                        let chamfered = filleted(k);
                        Self { shrink: chamfered.shrink * FRAC_1_SQRT_2, ..chamfered }
                    }
                }
            }
            Op::Intersection => a.intersection(b),
            // Subtraction can only reduce the solid.
            Op::Difference => a,
        }
    }

    /// The extent in the space around a warp.
    pub fn warped(self, warp: &Warp) -> Self {
        let inside = match warp.kind {
            WarpKind::Elongate(half) => Self { lower: self.lower - half, upper: self.upper + half, ..self },
            WarpKind::NearestCopy(lattice) => {
                let reach = lattice.reach();
                Self { lower: self.lower - reach, upper: self.upper + reach, ..self }
            }
            WarpKind::Twist(_) | WarpKind::Bend(_) => {
                // The distance from the z axis stays the same, the direction may be any.
                let r = self.radius_about_z();
                let stretch = warp.stretch.at(0.0);
                Self {
                    lower: DVec3::new(-r, -r, self.lower.z),
                    upper: DVec3::new(r, r, self.upper.z),
                    growth: self.growth * stretch,
                    ..self
                }
            }
        };
        let middle = warp.place.rotation * (0.5 * (inside.lower + inside.upper)) + warp.place.translation;
        let half = 0.5 * (inside.upper - inside.lower);
        let rows = warp.place.rotation.transpose();
        let turned = DVec3::new(rows.x_axis.abs().dot(half), rows.y_axis.abs().dot(half), rows.z_axis.abs().dot(half));
        if inside.unbounded.is_some() || !middle.is_finite() {
            return Self { lower: DVec3::NEG_INFINITY, upper: DVec3::INFINITY, ..inside };
        }
        Self { lower: middle - turned, upper: middle + turned, ..inside }
    }

    /// Largest distance of a corner from the z axis.
    pub fn radius_about_z(&self) -> f64 {
        let far = self.lower.abs().max(self.upper.abs());
        far.x.hypot(far.y)
    }
}
