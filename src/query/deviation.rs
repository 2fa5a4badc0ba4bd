//! The largest distance from the surface of one mesh to another, within a proven bound.
//!
//! *Theory.* The distance to one triangle F is a convex function, so over a triangle T it is largest at a corner of T. The
//! distance to a mesh is the least over its faces, hence `max over T of d <= max over the corners c of T of d(c, F)` for
//! every face F. The nearest faces of the corners of T are tried as F. The bound is exact where T lies over one face, and
//! elsewhere T is halved at its longest edge: branch and bound, largest bound first. Distances at corners bound the result
//! from below. This is the scheme of M. Tang, M. Lee and Y. Kim, "Interactive Hausdorff distance computation for general
//! polygonal models", ACM Transactions on Graphics 28 (2009).
//!
//! Triangles are taken from the pool in batches of fixed size, so the result does not depend on the number of threads.

use crate::error::Error;
use crate::geometry::closest_point_on_triangle;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Relative gap between the bounds at which the search ends.
const GAP: f64 = 5e-4;

/// Distances below this are zero, units of the other mesh's size: its float64 positions are rounded to 1e-16, and those
/// of a mesh extracted from it to a few times that.
const ZERO: f64 = 1e-12;

/// Triangles halved between two comparisons with the best distance.
const BATCH: usize = 1 << 14;

/// Triangles halved at most, some minutes of work. The bounds differ by more than [`GAP`] then.
const MOST: usize = 1 << 26;

/// Bounds of the largest distance, world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Deviation {
    /// A distance that a point of the mesh has.
    pub lower: f64,
    /// No point has a larger one.
    pub upper: f64,
}

/// A corner of a triangle, its distance from the other mesh and the nearest face there, local units.
#[derive(Debug, Clone, Copy)]
struct Corner {
    point: DVec3,
    distance: f64,
    face: u32,
}

/// A triangle and an upper bound of the distance of its points.
#[derive(Debug, Clone, Copy)]
struct TrianglePiece {
    corners: [Corner; 3],
    bound: f64,
}

impl PartialEq for TrianglePiece {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for TrianglePiece {}

impl PartialOrd for TrianglePiece {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for TrianglePiece {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.total_cmp(&other.bound)
    }
}

/// The largest distance of a point on the surface of `mesh` from the surface of `other`.
pub fn deviation(mesh: &Mesh, other: &Mesh, progress: &Progress) -> Result<Deviation, Error> {
    other.bvh();
    let world = mesh.world_positions();
    let corners: Vec<Corner> =
        world.par_iter().map(|&p| corner_at(other, other.local_from_world(DVec3::from_array(p)))).collect();
    // Vertices without a face are no part of the surface.
    let attained = |face: &[u32; 3]| face.map(|v| corners[v as usize].distance).into_iter().fold(0.0, f64::max);
    let mut best = mesh.faces().par_iter().map(attained).reduce(|| 0.0, f64::max);
    let pool: Vec<TrianglePiece> = mesh
        .faces()
        .par_iter()
        .map(|face| TrianglePiece::new(other, face.map(|v| corners[v as usize])))
        .filter(|piece| piece.bound > limit(best))
        .collect();
    let mut pool = BinaryHeap::from(pool);
    let mut halved = 0;
    while halved < MOST && pool.peek().is_some_and(|piece| piece.bound > limit(best)) {
        let mut batch = Vec::with_capacity(BATCH);
        while batch.len() < BATCH
            && let Some(piece) = pool.peek().filter(|piece| piece.bound > limit(best))
        {
            batch.push(*piece);
            pool.pop();
        }
        halved += batch.len();
        let halves: Vec<[TrianglePiece; 2]> = batch.par_iter().map(|piece| piece.halves(other)).collect();
        let distances = halves.iter().flatten().flat_map(|half| half.corners).map(|corner| corner.distance);
        best = distances.fold(best, f64::max);
        pool.extend(halves.into_iter().flatten().filter(|half| half.bound > limit(best)));
        progress.check()?;
    }
    let upper = pool.peek().map_or(limit(best), |piece| piece.bound.max(limit(best)));
    Ok(Deviation { lower: best * other.scale(), upper: upper * other.scale() })
}

/// A bound up to which a triangle needs no search.
fn limit(best: f64) -> f64 {
    best * (1.0 + GAP) + ZERO
}

fn corner_at(other: &Mesh, point: DVec3) -> Corner {
    let closest = other.exact_closest_point(point, f64::INFINITY);
    Corner { point, distance: closest.distance, face: closest.face }
}

impl TrianglePiece {
    fn new(other: &Mesh, corners: [Corner; 3]) -> Self {
        let mut bound = f64::INFINITY;
        for face in corners.map(|corner| corner.face) {
            let triangle = other.exact_triangle(face);
            let distance = |corner: &Corner| {
                if corner.face == face {
                    corner.distance
                } else {
                    closest_point_on_triangle(corner.point, triangle).point.distance(corner.point)
                }
            };
            bound = bound.min(corners.iter().map(distance).fold(0.0, f64::max));
        }
        Self { corners, bound }
    }

    /// The two halves on either side of the middle of the longest edge.
    fn halves(&self, other: &Mesh) -> [Self; 2] {
        let length = |i: usize| self.corners[i].point.distance_squared(self.corners[(i + 1) % 3].point);
        let longest = (0..3).max_by(|&i, &j| length(i).total_cmp(&length(j))).unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|i| self.corners[(longest + i) % 3]);
        let middle = corner_at(other, 0.5 * (a.point + b.point));
        [[a, middle, c], [middle, b, c]].map(|corners| {
            let half = Self::new(other, corners);
            // A part of a triangle cannot be farther away than the triangle.
            Self { bound: half.bound.min(self.bound), ..half }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::soup;

    fn both(mesh: &Mesh, other: &Mesh) -> Deviation {
        deviation(mesh, other, &Progress::new()).unwrap()
    }

    #[test]
    fn parallel_squares_are_their_distance_apart() {
        let square = |side: f64, z: f64| {
            let vertices = [[0.0, 0.0, z], [side, 0.0, z], [side, side, z], [0.0, side, z]];
            Mesh::new(&vertices, &[[0, 1, 2], [0, 2, 3]]).unwrap()
        };
        let (small, large) = (square(1.0, 0.25), square(3.0, 0.0));
        let there = both(&small, &large);
        assert!(there.lower <= 0.25 * (1.0 + 1e-9) && there.upper >= 0.25 * (1.0 - 1e-9));
        assert!(there.upper <= there.lower * (1.0 + 2.0 * GAP));
        // The farthest point of the large square is its corner.
        let back = both(&large, &small);
        let truth = (2.0f64 * 2.0 + 2.0 * 2.0 + 0.25 * 0.25).sqrt();
        assert!((back.lower - truth).abs() <= 1e-6 && back.upper >= truth * (1.0 - 1e-9));
        assert!(both(&large, &large).upper <= 1e-9);
    }

    #[test]
    fn the_largest_distance_between_two_walls_lies_between_them() {
        // A long triangle over two parallel strips: its points are farthest in the middle of the gap.
        let vertices: Vec<[f64; 3]> =
            [-1.0, 1.0].into_iter().flat_map(|x| [[x, -5.0, 0.0], [x, 5.0, 0.0], [x * 1.1, 0.0, 0.0]]).collect();
        let strips = Mesh::new(&vertices, &[[0, 1, 2], [3, 4, 5]]).unwrap();
        let bridge = Mesh::new(&[[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.1, 0.0]], &[[0, 1, 2]]).unwrap();
        let found = both(&bridge, &strips);
        assert!((found.lower - 1.0).abs() <= 1e-3 && found.upper >= 1.0 - 1e-9);
    }

    #[test]
    fn dense_samples_never_exceed_the_bound() {
        for seed in 0..20 {
            let (mesh, other) = (soup(12, 0.4, seed), soup(30, 0.3, seed + 100));
            let found = both(&mesh, &other);
            let mut largest: f64 = 0.0;
            for face in mesh.faces() {
                let [a, b, c] = face.map(|v| DVec3::from_array(mesh.world_positions()[v as usize]));
                let n = 40;
                for i in 0..=n {
                    for j in 0..=n - i {
                        let (u, v) = (f64::from(i) / f64::from(n), f64::from(j) / f64::from(n));
                        let p = other.local_from_world(a + (b - a) * u + (c - a) * v);
                        let brute = (0..other.faces().len() as u32)
                            .map(|face| other.exact_point_on_face(face, p).distance)
                            .fold(f64::INFINITY, f64::min);
                        largest = largest.max(brute * other.scale());
                    }
                }
            }
            assert!(largest <= found.upper * (1.0 + 1e-12), "seed {seed}: {largest} {found:?}");
            assert!(largest <= found.lower * (1.0 + 1e-3), "seed {seed}: {largest} {found:?}");
            assert!(found.upper <= found.lower * (1.0 + 2.0 * GAP));
        }
    }
}
