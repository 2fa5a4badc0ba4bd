//! Flat profiles for extrusion and revolution.

use super::checks::positive;
use crate::error::ShapeError;
use crate::gpu::constants::csg_field::MAX_CORNERS;
use glam::DVec2;

/// A flat region about the origin.
#[derive(Debug, Clone, PartialEq)]
pub enum Profile {
    Circle {
        radius: f64,
    },
    Rectangle {
        half: DVec2,
    },
    /// Corners of a closed polygon in order. A point is inside if an odd number of edges lies to its right.
    Polygon {
        corners: Vec<DVec2>,
        is_simple: bool,
    },
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

    pub fn polygon(corners: &[[f64; 2]]) -> Result<Self, ShapeError> {
        let error = |problem: String| Err(ShapeError::argument("points", problem));
        if !(3..=MAX_CORNERS).contains(&corners.len()) {
            return error(format!("a polygon has 3 to {MAX_CORNERS} corners, got {}", corners.len()));
        }
        if let Some(i) = corners.iter().position(|corner| !corner.iter().all(|x| x.abs() <= 1e37)) {
            return error(format!("[{i}] is {:?}, expected finite numbers", corners[i]));
        }
        let corners: Vec<DVec2> = corners.iter().copied().map(DVec2::from_array).collect();
        let n = corners.len();
        if let Some(i) = (0..n).find(|&i| corners[i] == corners[(i + 1) % n]) {
            return error(format!("[{i}] and [{}] are the same point {}", (i + 1) % n, corners[i]));
        }
        let area: f64 = (0..n).map(|i| corners[i].perp_dot(corners[(i + 1) % n])).sum();
        if area == 0.0 {
            return error("the polygon has no area".to_owned());
        }
        let is_simple = is_simple(&corners);
        Ok(Self::Polygon { corners, is_simple })
    }

    /// Whether the distance is exact inside too.
    pub fn is_exact(&self) -> bool {
        match self {
            Self::Polygon { is_simple, .. } => *is_simple,
            _ => true,
        }
    }

    /// The largest `n . p` over the profile.
    pub fn support(&self, n: DVec2) -> f64 {
        match self {
            Self::Circle { radius } => radius * n.length(),
            Self::Rectangle { half } => (n.abs() * *half).element_sum(),
            Self::Polygon { corners, .. } => corners.iter().map(|p| n.dot(*p)).fold(f64::NEG_INFINITY, f64::max),
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
        offset >= self.support(-DVec2::X) || (offset == 0.0 && !matches!(self, Self::Polygon { .. }))
    }
}

/// Whether no two edges touch except at their common corner. Quadratic in the number of corners, which is small.
fn is_simple(corners: &[DVec2]) -> bool {
    let n = corners.len();
    let edge = |i: usize| (corners[i], corners[(i + 1) % n]);
    let side = |a: DVec2, b: DVec2, p: DVec2| (b - a).perp_dot(p - a);
    for i in 0..n {
        for j in i + 1..n {
            if j == i + 1 || (i == 0 && j == n - 1) {
                continue;
            }
            let ((a, b), (c, d)) = (edge(i), edge(j));
            let crosses = side(a, b, c) * side(a, b, d) <= 0.0 && side(c, d, a) * side(c, d, b) <= 0.0;
            // Collinear edges touch only if their boxes do.
            let meets = a.min(b).cmple(c.max(d)).all() && c.min(d).cmple(a.max(b)).all();
            if crosses && meets {
                return false;
            }
        }
    }
    true
}
