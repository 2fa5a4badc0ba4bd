//! Pairs of faces that intersect.
//!
//! Two triangles cross where an edge of one passes through the inside of the other, decided by exact orientations of
//! float32 positions (crate `robust`). Faces with a common vertex are excluded, since they touch there by construction.
//! Faces that only touch, and overlapping faces in one plane, do not count.

use crate::error::Error;
use crate::geometry::Aabb;
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
    let corners = mesh.triangle(face);
    let bounds = Aabb::of_points(&corners.map(|corner| corner.as_vec3()));
    let welded = |face: u32| mesh.faces()[face as usize].map(|v| mesh.topology().welded[v as usize]);
    let own = welded(face);
    let mut count = 0;
    mesh.bvh().visit(
        |node| node.overlaps(bounds.min, bounds.max),
        |pack| {
            for &other in pack.faces() {
                if other > face
                    && !welded(other).iter().any(|vertex| own.contains(vertex))
                    && cross(corners, mesh.triangle(other))
                {
                    count += 1;
                }
            }
        },
    );
    count
}

/// Whether an edge of either triangle passes through the inside of the other.
fn cross(a: [DVec3; 3], b: [DVec3; 3]) -> bool {
    let edges = |t: [DVec3; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    edges(a).iter().any(|&edge| passes_through(edge, b)) || edges(b).iter().any(|&edge| passes_through(edge, a))
}

fn passes_through([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> bool {
    let (above, below) = (volume(a, b, c, p), volume(a, b, c, q));
    if !((above > 0.0 && below < 0.0) || (above < 0.0 && below > 0.0)) {
        return false;
    }
    let sides = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
    sides.iter().all(|&side| side > 0.0) || sides.iter().all(|&side| side < 0.0)
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
