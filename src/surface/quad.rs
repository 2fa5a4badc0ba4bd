//! The quadrilateral around a crossed edge, and its division into two triangles.
//!
//! The samples at the ends of an edge of the grid lie on different sides of the mesh if the mesh meets the edge an odd
//! number of times, so every sample has its side if that holds for the crossed edges alone. A quadrilateral whose
//! corners lie in the four cells around its edge meets this edge once and no other. One with a corner outside these
//! cells may intersect any edge near it; [`Quad::intersected_edges`] lists them.

use super::MARGIN;
use glam::{DVec2, DVec3};

/// A division with a triangle of at most this area, seen along the edge, is slender: twice the area, voxels squared.
/// Three corners of a quadrilateral may lie on one edge of the source.
const SLENDER: f64 = MARGIN;

/// The four vertices around a crossed edge.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Quad {
    /// Whether the far end of the edge is outside; its corners are counter-clockwise seen from outside.
    pub far_is_outside: bool,
    /// Whether the first and the third corner are joined, else the second and the fourth.
    joins_first: bool,
    /// Whether both divisions fold a triangle over, as seen along the edge.
    pub folds: bool,
    /// Whether all corners lie in the four cells around the edge.
    pub is_around: bool,
}

impl Quad {
    /// `places` has the positions of the corners relative to the start of the edge, voxels. The edge is one voxel long
    /// and parallel to `axis`. The corners are counter-clockwise seen from the far end if `far_is_outside`.
    #[inline]
    pub(super) fn new(places: [DVec3; 4], axis: usize, far_is_outside: bool) -> Self {
        let (u, v) = if far_is_outside { ((axis + 1) % 3, (axis + 2) % 3) } else { ((axis + 2) % 3, (axis + 1) % 3) };
        let [a, b, c, d] = [0, 1, 2, 3].map(|i: usize| DVec2::new(places[i][u], places[i][v]));
        // Twice the area of the smaller triangle of each division, voxels squared; negative if it is folded over.
        let area = |a: DVec2, b: DVec2, c: DVec2| (b - a).perp_dot(c - a);
        let first = area(a, b, c).min(area(a, c, d));
        let second = area(b, c, d).min(area(b, d, a));
        let limit = MARGIN * MARGIN;
        // The division with the shorter diagonal is chosen if neither folds or is slender.
        let joins_first = if first <= SLENDER || second <= SLENDER {
            first >= second
        } else {
            places[0].distance_squared(places[2]) <= places[1].distance_squared(places[3])
        };
        let is_in_cell = |p: &DVec3| p[u].abs() < 1.0 && p[v].abs() < 1.0 && p[axis] > 0.0 && p[axis] < 1.0;
        let turns = a.perp_dot(b) > 0.0 && b.perp_dot(c) > 0.0 && c.perp_dot(d) > 0.0 && d.perp_dot(a) > 0.0;
        let is_around = turns && places.iter().all(is_in_cell);
        Self { far_is_outside, joins_first, folds: first <= limit && second <= limit, is_around }
    }

    /// Positions among the four corners of the corners of both triangles.
    fn indices(&self) -> [[usize; 3]; 2] {
        if self.joins_first { [[0, 1, 2], [0, 2, 3]] } else { [[1, 2, 3], [1, 3, 0]] }
    }

    /// Both triangles, as indices of vertices. `corners` are the vertices of the quadrilateral.
    pub(super) fn triangles(&self, corners: [u32; 4]) -> [[u32; 3]; 2] {
        self.indices().map(|triangle| triangle.map(|i| corners[i]))
    }

    /// The edges of the grid that the triangles meet: the index of the sample where each starts, and its axis. `places`
    /// has the positions of the corners in units of voxels, samples at whole numbers.
    pub(super) fn intersected_edges(&self, places: [DVec3; 4]) -> Vec<([i32; 3], usize)> {
        let mut edges = Vec::new();
        for corners in self.indices().map(|triangle| triangle.map(|i| places[i])) {
            let lower = corners[0].min(corners[1]).min(corners[2]).ceil().as_ivec3();
            let upper = corners[0].max(corners[1]).max(corners[2]).floor().as_ivec3();
            for axis in 0..3 {
                let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
                for (x, y) in (lower[u]..=upper[u]).flat_map(|x| (lower[v]..=upper[v]).map(move |y| (x, y))) {
                    let line = DVec2::new(f64::from(x), f64::from(y));
                    if let Some(height) = height(corners.map(|p| (DVec2::new(p[u], p[v]) - line, p[axis]))) {
                        let mut start = [0; 3];
                        (start[axis], start[u], start[v]) = (height.floor() as i32, x, y);
                        edges.push((start, axis));
                    }
                }
            }
        }
        edges
    }
}

/// The height at which a triangle meets a line. Its corners have a position relative to the line and a height.
fn height([a, b, c]: [(DVec2, f64); 3]) -> Option<f64> {
    let weights = [b.0.perp_dot(c.0), c.0.perp_dot(a.0), a.0.perp_dot(b.0)];
    let is_met = weights.iter().all(|&weight| weight > 0.0) || weights.iter().all(|&weight| weight < 0.0);
    is_met.then(|| (weights[0] * a.1 + weights[1] * b.1 + weights[2] * c.1) / weights.iter().sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quad(places: [[f64; 3]; 4]) -> Quad {
        Quad::new(places.map(DVec3::from_array), 2, true)
    }

    #[test]
    fn corners_around_the_edge_meet_it_alone() {
        let places = [[-0.5, -0.4, 0.2], [0.3, -0.6, 0.9], [0.7, 0.5, 0.1], [-0.2, 0.6, 0.4]];
        let quad = quad(places);
        assert!(quad.is_around && !quad.folds);
        assert_eq!(quad.intersected_edges(places.map(DVec3::from_array)), [([0, 0, 0], 2)]);
    }

    #[test]
    fn no_triangle_has_three_corners_on_a_line() {
        // The first three corners are nearly on a line, and the diagonal between the first and the third is shorter.
        let quad = quad([[-0.4, -0.4, 0.5], [0.02, -0.0015, 0.5], [0.4, 0.36, 0.5], [-0.9, 0.9, 0.5]]);
        assert!(!quad.folds);
        assert_eq!(quad.triangles([0, 1, 2, 3]), [[1, 2, 3], [1, 3, 0]]);
    }

    #[test]
    fn a_corner_beyond_the_end_of_the_edge_meets_other_edges() {
        // The first corner lies a voxel above its cell, so the surface passes above the far end of the edge.
        let places = [[-0.1, -0.2, 1.9], [0.9, -0.9, 0.9], [0.9, 0.9, 0.9], [-0.9, 0.9, 0.9]];
        let quad = quad(places);
        assert!(!quad.is_around);
        let edges = quad.intersected_edges(places.map(DVec3::from_array));
        assert!(edges.contains(&([0, 0, 1], 2)) && !edges.contains(&([0, 0, 0], 2)));
    }
}
