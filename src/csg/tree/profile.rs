//! Flat profiles for extrusion and revolution.

use super::checks::positive;
use super::region::{Region, Rule};
use crate::error::ShapeError;
use glam::DVec2;
use std::sync::Arc;

/// A flat region about the origin.
#[derive(Debug, PartialEq)]
pub enum Profile {
    Circle {
        radius: f64,
    },
    Rectangle {
        half: DVec2,
    },
    /// Polygons with holes.
    Polygon(Arc<Region>),
}

impl Profile {
    pub fn circle(radius: f64) -> Result<Self, ShapeError> {
        Ok(Self::Circle { radius: positive("radius", radius)? })
    }

    /// `size` is the full width and height.
    pub fn rectangle(size: [f64; 2]) -> Result<Self, ShapeError> {
        let half = DVec2::new(positive("size", size[0])?, positive("size", size[1])?) / 2.0;
        Ok(Self::Rectangle { half })
    }

    /// The region of closed polygons under a rule.
    pub fn polygon(loops: &[&[[f64; 2]]], rule: Rule) -> Result<Self, ShapeError> {
        if let Some(short) = loops.iter().find(|corners| corners.len() < 3) {
            let problem = format!("a polygon has 3 corners at least, got {}", short.len());
            return Err(ShapeError::argument("points", problem));
        }
        let loops = loops.iter().map(|corners| corners.iter().copied().map(DVec2::from_array).collect());
        Ok(Self::Polygon(Arc::new(Region::new(loops.collect(), rule)?)))
    }

    /// The largest `n . p` over the profile.
    pub fn support(&self, n: DVec2) -> f64 {
        match self {
            Self::Circle { radius } => radius * n.length(),
            Self::Rectangle { half } => (n.abs() * *half).element_sum(),
            Self::Polygon(region) => region.loops.iter().flatten().map(|p| n.dot(*p)).fold(f64::NEG_INFINITY, f64::max),
        }
    }

    /// An upper bound of the largest `n . p` over the points of the profile that are `inset` from the outside. It is
    /// exact for circles and rectangles.
    pub fn support_of_inset(&self, n: DVec2, inset: f64) -> f64 {
        match self {
            Self::Circle { radius } => (radius - inset).max(0.0) * n.length(),
            Self::Rectangle { half } => (n.abs() * (*half - inset).max(DVec2::ZERO)).element_sum(),
            Self::Polygon(_) => self.support(n) - inset * n.length(),
        }
    }

    /// Largest distance from the axis in a revolution about x = -`offset`; negative if the profile lies beyond the
    /// axis.
    pub fn reach(&self, offset: f64) -> f64 {
        offset + self.support(DVec2::X)
    }

    /// Whether the part beyond the axis of a revolution, if any, is the mirror image of the part before it. Then the
    /// nearest point of the profile is a point of the solid.
    pub fn is_clear_of_axis(&self, offset: f64) -> bool {
        offset >= self.support(-DVec2::X) || (offset == 0.0 && !matches!(self, Self::Polygon(_)))
    }
}
