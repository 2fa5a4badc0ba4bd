//! Whether two triangles pass through each other, decided exactly.

use glam::DVec3;
use robust::{Coord3D, orient3d};

/// Whether an edge of either triangle passes through the inside of the other, by exact orientations of float64
/// positions (crate `robust`). Triangles that only touch, as at a common vertex or edge, and overlapping triangles in
/// one plane do not cross.
pub fn triangles_cross(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    // Two triangles do not cross if one of them lies on one side of the plane of the other.
    let has_both = |heights: [f64; 3]| heights.iter().any(|&h| h > 0.0) && heights.iter().any(|&h| h < 0.0);
    // A common vertex lies in both planes; its exact height takes long.
    let height = |[a, b, c]: [DVec3; 3], p: DVec3| {
        if p == a || p == b || p == c { 0.0 } else { volume(a, b, c, p) }
    };
    let heights_of_b = b.map(|p| height(a, p));
    if !has_both(heights_of_b) {
        return false;
    }
    let heights_of_a = a.map(|p| height(b, p));
    has_both(heights_of_a) && (pass_through(b, heights_of_b, a) || pass_through(a, heights_of_a, b))
}

/// Whether an edge of `t` passes through the inside of a triangle; `heights` are the sides of the corners of `t`.
fn pass_through(t: [DVec3; 3], heights: [f64; 3], [a, b, c]: [DVec3; 3]) -> bool {
    [(0, 1), (1, 2), (2, 0)].into_iter().any(|(i, j)| {
        if !((heights[i] > 0.0 && heights[j] < 0.0) || (heights[i] < 0.0 && heights[j] > 0.0)) {
            return false;
        }
        let (p, q) = (t[i], t[j]);
        let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
        sides.iter().all(|&side| side > 0.0) || sides.iter().all(|&side| side < 0.0)
    })
}

/// Six times the signed volume of a tetrahedron; the sign is exact.
fn volume(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> f64 {
    let at = |p: DVec3| Coord3D { x: p.x, y: p.y, z: p.z };
    orient3d(at(a), at(b), at(c), at(d))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn triangles_with_a_common_vertex_cross_where_an_edge_passes_through_the_other() {
        let at = |points: [[f64; 3]; 3]| points.map(DVec3::from_array);
        let flat = at([[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]);
        // Both triangles have the origin as a vertex. The opposite edge of the second passes through the first, or the
        // opposite edge of the first through the second, or neither.
        assert!(triangles_cross(flat, at([[0.0, 0.0, 0.0], [1.0, 1.0, -1.0], [1.0, 1.0, 1.0]])));
        assert!(triangles_cross(flat, at([[0.0, 0.0, 0.0], [4.0, 4.0, -1.0], [4.0, 4.0, 1.0]])));
        assert!(!triangles_cross(flat, at([[0.0, 0.0, 0.0], [-1.0, -1.0, -1.0], [-1.0, -1.0, 1.0]])));
        assert!(!triangles_cross(flat, at([[0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]])));
        assert!(!triangles_cross(flat, flat));
    }
}
