//! Pairs of faces that intersect.
//!
//! Two triangles cross where an edge of one passes through the inside of the other ([`triangles_cross`]). Faces with a
//! common edge are excluded, since they touch there by construction. Faces that only touch, and overlapping faces in
//! one plane, do not count.

use crate::bvh::BOX_ROUNDING;
use crate::bvh::boxes::round_down;
use crate::error::Error;
use crate::geometry::triangles_cross;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

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
                    && may_cross(&own, &welded(other), &corners, &others)
                    && triangles_cross(corners, others)
                {
                    count += 1;
                }
            }
        },
    );
    count
}

/// Whether two faces have no common vertex, or one at exactly the same position in both. Their welded vertices and
/// corners are in the same order.
fn may_cross(own: &[u32; 3], others: &[u32; 3], corners: &[DVec3; 3], other_corners: &[DVec3; 3]) -> bool {
    let mut common = (0..9).filter(|pair| own[pair / 3] == others[pair % 3]);
    match (common.next(), common.next()) {
        (None, _) => true,
        (Some(pair), None) => corners[pair / 3] == other_corners[pair % 3],
        _ => false,
    }
}

fn box_of([a, b, c]: [DVec3; 3]) -> [DVec3; 2] {
    [a.min(b).min(c), a.max(b).max(c)]
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
