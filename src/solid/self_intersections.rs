//! Pairs of faces that intersect.
//!
//! Two triangles cross where an edge of one passes through the inside of the other, decided by exact orientations of
//! float64 positions (crate `robust`). Faces with a common vertex are excluded, since they touch there by construction.
//! Faces that only touch, and overlapping faces in one plane, do not count.

use crate::bvh::BOX_ROUNDING;
use crate::bvh::boxes::round_down;
use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use robust::{Coord3D, orient3d};

/// Number of faces between two checks of the progress.
const CHUNK: usize = 1 << 12;

/// The number of pairs of faces that cross.
pub fn count_self_intersections(mesh: &Mesh, progress: &Progress) -> Result<u64, Error> {
    let count = mesh.faces().len();
    progress.set_total(count as u64);
    mesh.bvh();
    mesh.topology();
    (0..count.div_ceil(CHUNK))
        .into_par_iter()
        .map(|chunk| {
            let faces = chunk * CHUNK..((chunk + 1) * CHUNK).min(count);
            let found = faces.clone().map(|face| crossings_of(mesh, face as u32)).sum::<u64>();
            progress.advance(faces.len() as u64)?;
            Ok(found)
        })
        .try_reduce(|| 0, |a, b| Ok(a + b))
}

/// Faces of a higher index that cross this one.
fn crossings_of(mesh: &Mesh, face: u32) -> u64 {
    let corners = mesh.exact_triangle(face);
    let [own_lower, own_upper] = box_of(corners);
    // The boxes of nodes contain float32 positions.
    let (low, high) = (round_down(own_lower - 2.0 * BOX_ROUNDING), -round_down(-own_upper - 2.0 * BOX_ROUNDING));
    let welded = |face: u32| mesh.faces()[face as usize].map(|v| mesh.topology().welded[v as usize]);
    let own = welded(face);
    let mut count = 0;
    mesh.bvh().visit(
        |node| node.overlaps(low, high),
        |pack| {
            for &other in pack.faces().iter().filter(|&&other| other > face) {
                let others = mesh.exact_triangle(other);
                let [lower, upper] = box_of(others);
                // Most faces of a pack lie beside this one, and a comparison of boxes is the cheapest test.
                if lower.cmple(own_upper).all()
                    && own_lower.cmple(upper).all()
                    && !welded(other).iter().any(|vertex| own.contains(vertex))
                    && cross(corners, others)
                {
                    count += 1;
                }
            }
        },
    );
    count
}

fn box_of([a, b, c]: [DVec3; 3]) -> [DVec3; 2] {
    [a.min(b).min(c), a.max(b).max(c)]
}

/// Whether an edge of either triangle passes through the inside of the other.
fn cross(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    // Two triangles do not cross if one of them lies on one side of the plane of the other.
    let has_both = |heights: [f64; 3]| heights.iter().any(|&h| h > 0.0) && heights.iter().any(|&h| h < 0.0);
    let heights_of_b = b.map(|p| volume(a[0], a[1], a[2], p));
    if !has_both(heights_of_b) {
        return false;
    }
    let heights_of_a = a.map(|p| volume(b[0], b[1], b[2], p));
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
    fn crossing_triangles_count_and_touching_ones_do_not() {
        let mut vertices: Vec<[f64; 3]> = vec![[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];
        let faces = [[0, 1, 2], [3, 4, 5]];
        let mut with = |second: [[f64; 3]; 3]| {
            vertices.truncate(3);
            vertices.extend(second);
            count_self_intersections(&Mesh::new(&vertices, &faces).unwrap(), &Progress::new()).unwrap()
        };
        assert_eq!(with([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]), 1);
        // Above it, touching it with a corner, and beside it.
        assert_eq!(with([[1.0, 1.0, 1.0], [1.0, 2.0, 1.0], [2.0, 1.0, 1.0]]), 0);
        assert_eq!(with([[1.0, 1.0, 0.0], [1.0, 2.0, 1.0], [2.0, 1.0, 1.0]]), 0);
        assert_eq!(with([[5.0, 5.0, -1.0], [5.0, 5.0, 1.0], [6.0, 5.0, 1.0]]), 0);
    }
}
