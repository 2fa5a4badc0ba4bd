//! Axis-aligned boxes in float32, as the search tree stores them.

use glam::Vec3;

/// A box from `min` to `max`; empty when `min` exceeds `max`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Aabb {
    /// Lower corner.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
}

impl Aabb {
    /// The box of no points.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around points.
    pub fn of_points(points: &[Vec3]) -> Self {
        points.iter().fold(Self::EMPTY, |bounds, &p| bounds.grown(p))
    }

    /// The box with another point.
    pub fn grown(self, p: Vec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }

    /// The smallest box around two boxes.
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// Lengths of the sides.
    pub fn extent(self) -> Vec3 {
        self.max - self.min
    }

    /// Half the surface area; the surface area heuristic needs only ratios.
    pub fn half_area(self) -> f32 {
        let e = self.extent().max(Vec3::ZERO);
        e.x * e.y + e.y * e.z + e.z * e.x
    }
}
