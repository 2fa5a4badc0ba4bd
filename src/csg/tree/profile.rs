//! Flat profiles for extrusion and revolution.

use super::checks::positive;
use super::loops::Loop;
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

    /// The profile and the offset whose revolution is the same solid and whose field is its distance: a rectangle or a
    /// polygon at the axis is joined with its mirror image, since an edge on the axis is no surface of the solid. A
    /// polygon that crosses the axis stays as it is, and so does one whose image would have too many corners.
    pub fn joined_at_axis(self: Arc<Self>, offset: f64) -> (Arc<Self>, f64) {
        let joined = match &*self {
            Self::Circle { .. } => None,
            Self::Rectangle { half } if offset.abs() <= half.x => {
                Some(Self::Rectangle { half: DVec2::new(half.x + offset, half.y) })
            }
            Self::Rectangle { .. } => None,
            Self::Polygon(region) => {
                let beside = region.loops.iter().all(|corners| is_beside_axis(corners, offset));
                let touches = region.loops.iter().any(|corners| has_axis_edge(corners, offset));
                let image = || region.loops.iter().flat_map(|corners| joined_with_image(corners, offset)).collect();
                let region = (beside && touches).then(|| Region::new(image(), Rule::NonZero).ok()).flatten();
                region.map(|region| Self::Polygon(Arc::new(region)))
            }
        };
        match joined {
            Some(joined) => (Arc::new(joined), 0.0),
            None => (self, offset),
        }
    }

    /// Whether the part beyond the axis of a revolution, if any, is the mirror image of the part before it, and no edge
    /// lies on the axis. Then the nearest point of the profile is a point of the surface of the solid.
    pub fn is_clear_of_axis(&self, offset: f64) -> bool {
        let Self::Polygon(region) = self else { return offset == 0.0 || offset >= self.support(-DVec2::X) };
        region.loops.iter().all(|corners| {
            let is_beside = is_beside_axis(corners, offset) && !has_axis_edge(corners, offset);
            is_beside || (offset == 0.0 && is_own_image(corners))
        })
    }
}

/// Whether a corner lies on the axis x = -`offset`, up to the rounding of the sum.
fn is_on_axis(corner: DVec2, offset: f64) -> bool {
    (corner.x + offset).abs() <= 4.0 * f64::EPSILON * offset.abs()
}

/// Whether no corner lies beyond the axis.
fn is_beside_axis(corners: &[DVec2], offset: f64) -> bool {
    corners.iter().all(|&corner| corner.x + offset >= 0.0 || is_on_axis(corner, offset))
}

fn has_axis_edge(corners: &[DVec2], offset: f64) -> bool {
    let next = corners.iter().cycle().skip(1);
    corners.iter().zip(next).any(|(&a, &b)| is_on_axis(a, offset) && is_on_axis(b, offset))
}

/// The loops of a loop and its mirror image in the axis, moved so that the axis is x = 0. Each part between two edges
/// on the axis makes a loop with its own image. A loop without such edges is only moved.
fn joined_with_image(corners: &[DVec2], offset: f64) -> Vec<Loop> {
    let moved = |corner: DVec2| DVec2::new(if is_on_axis(corner, offset) { 0.0 } else { corner.x + offset }, corner.y);
    let corners: Loop = corners.iter().map(|&corner| moved(corner)).collect();
    let n = corners.len();
    let is_axis_edge = |i: usize| corners[i % n].x == 0.0 && corners[(i + 1) % n].x == 0.0;
    let Some(first) = (0..n).find(|&i| is_axis_edge(i)) else { return vec![corners] };
    let mut loops = Vec::new();
    let mut part = Loop::new();
    for i in first + 1..=first + n {
        part.push(corners[i % n]);
        if is_axis_edge(i) {
            let image = part.iter().rev().filter(|corner| corner.x > 0.0).map(|corner| DVec2::new(-corner.x, corner.y));
            let image: Loop = image.collect();
            let mut joined = std::mem::take(&mut part);
            joined.extend(image);
            loops.push(joined);
        }
    }
    loops
}

/// Whether a loop is its own mirror image in the axis x = 0.
fn is_own_image(corners: &[DVec2]) -> bool {
    let n = corners.len();
    let image = |i: usize| DVec2::new(-corners[i].x, corners[i].y);
    // The image runs the other way around.
    let start = corners.iter().position(|&corner| corner == image(0));
    start.is_some_and(|start| (0..n).all(|i| corners[(start + n - i) % n] == image(i)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn polygon(corners: &[[f64; 2]]) -> Arc<Profile> {
        Arc::new(Profile::polygon(&[corners], Rule::NonZero).unwrap())
    }

    #[test]
    fn profiles_at_the_axis_are_joined_with_their_images() {
        // A cup: the bottom and the hollow both have an edge on the axis.
        let cup = polygon(&[[1.0, 0.0], [4.0, 0.0], [4.0, 5.0], [3.0, 5.0], [3.0, 1.0], [1.0, 1.0]]);
        let (joined, offset) = cup.joined_at_axis(-1.0);
        let Profile::Polygon(region) = &*joined else { panic!() };
        assert_eq!((offset, region.loops.len(), region.loops[0].len()), (0.0, 1, 10));
        assert!(joined.is_clear_of_axis(0.0));
        // A ball with a cavity, both on the axis: two loops.
        let shell = polygon(&[[0.0, -2.0], [2.0, 0.0], [0.0, 2.0], [0.0, 1.0], [1.0, 0.0], [0.0, -1.0]]);
        let (joined, _) = shell.joined_at_axis(0.0);
        let Profile::Polygon(region) = &*joined else { panic!() };
        assert_eq!(region.loops.len(), 2);
        assert!(joined.is_clear_of_axis(0.0));
        // Polygons that touch the axis at a corner, are apart from it, or cross it.
        for (corners, clear) in [
            ([[0.0, 0.0], [1.0, -1.0], [1.0, 1.0]], true),
            ([[0.5, 0.0], [1.0, -1.0], [1.0, 1.0]], true),
            ([[-0.5, 0.0], [1.0, -1.0], [1.0, 1.0]], false),
        ] {
            let before = polygon(&corners);
            let (after, _) = before.clone().joined_at_axis(0.0);
            assert!(Arc::ptr_eq(&before, &after));
            assert_eq!(after.is_clear_of_axis(0.0), clear);
        }
    }
}
