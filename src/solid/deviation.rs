//! The largest distance from the surface of one mesh to another, within a proven bound.
//!
//! *Theory.* The distance to one triangle F is a convex function, so over a triangle T it is largest at a corner of T.
//! The distance to a mesh is the least over its faces, hence `max over T of d <= max over the corners c of T of d(c,
//! F)` for every face F. The nearest faces of the corners of T are tried as F. The bound is exact where T lies over one
//! face, and elsewhere T is divided: branch and bound, largest bound first. Distances at corners bound the result from
//! below. This is the scheme of M. Tang, M. Lee and Y. Kim, "Interactive Hausdorff distance computation for general
//! polygonal models", ACM Transactions on Graphics 28 (2009).
//!
//! A triangle over two faces that meet in an edge would have to be halved down to the size of the deviation. It is cut
//! instead by the plane through that edge that bisects the angle of the faces, so each piece lies over one face. Some
//! cuts in a row are followed by halving the longest side of the box, which shrinks every piece in the end. The pieces
//! are convex polygons: a cut divides only the pieces that it is made for.
//!
//! Pieces are taken from the pool in batches of fixed size, so the result does not depend on the number of threads.

use crate::error::Error;
use crate::geometry::{closest_point_on_triangle, triangle_cross};
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Relative gap between the bounds at which the search ends.
const GAP: f64 = 5e-4;

/// Distances below this are zero, units of the other mesh's size: its float64 positions are rounded to 1e-16, and the
/// positions of a mesh extracted from it to a few times that.
const ZERO: f64 = 1e-12;

/// Pieces divided between two comparisons with the best distance.
const BATCH: usize = 1 << 14;

/// Cuts between faces in a row. A piece over a vertex of the other mesh needs about six.
const MOST_CUTS: u8 = 8;

/// A corner this close to a plane lies on it, local units. Positions are rounded to 1e-16.
const ON_PLANE: f64 = 1e-13;

/// Slack for the rounding of a bound, relative and in local units.
const SLACK: f64 = 1e-9;

/// Pieces divided at most, some minutes of work. The bounds differ by more than [`GAP`] then.
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

/// A convex part of a triangle, and an upper bound of the distance of its points.
#[derive(Debug, Clone)]
struct ConvexPiece {
    corners: Vec<Corner>,
    bound: f64,
    /// Cuts between faces since the last halving.
    cuts: u8,
}

impl PartialEq for ConvexPiece {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for ConvexPiece {}

impl PartialOrd for ConvexPiece {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for ConvexPiece {
    fn cmp(&self, other: &Self) -> Ordering {
        self.bound.total_cmp(&other.bound)
    }
}

/// The largest distance of a point on the surface of `mesh` from the surface of `other`.
pub fn deviation(mesh: &Mesh, other: &Mesh, progress: &Progress) -> Result<Deviation, Error> {
    Ok(search(mesh, other, progress)?.0)
}

/// The deviation, and the number of triangles that were divided.
fn search(mesh: &Mesh, other: &Mesh, progress: &Progress) -> Result<(Deviation, usize), Error> {
    other.bvh();
    let world = mesh.world_positions();
    let corners: Vec<Corner> = world
        .par_iter()
        .map(|&p| corner_at(other, other.local_from_world(DVec3::from_array(p)), f64::INFINITY))
        .collect();
    // Vertices without a face are no part of the surface.
    let attained = |face: &[u32; 3]| face.map(|v| corners[v as usize].distance).into_iter().fold(0.0, f64::max);
    let mut best = mesh.faces().par_iter().map(attained).reduce(|| 0.0, f64::max);
    let pool: Vec<ConvexPiece> = mesh
        .faces()
        .par_iter()
        .map(|face| ConvexPiece::new(other, face.map(|v| corners[v as usize]).to_vec()))
        .filter(|piece| piece.bound > limit(best))
        .collect();
    let mut pool = BinaryHeap::from(pool);
    let mut divided = 0;
    while divided < MOST && pool.peek().is_some_and(|piece| piece.bound > limit(best)) {
        let mut batch = Vec::with_capacity(BATCH);
        while batch.len() < BATCH && pool.peek().is_some_and(|piece| piece.bound > limit(best)) {
            batch.extend(pool.pop());
        }
        divided += batch.len();
        let parts: Vec<[ConvexPiece; 2]> = batch.par_iter().map(|piece| piece.parts(other)).collect();
        let distances = parts.iter().flatten().flat_map(|part| &part.corners).map(|corner| corner.distance);
        best = distances.fold(best, f64::max);
        pool.extend(parts.into_iter().flatten().filter(|part| part.bound > limit(best)));
        progress.check()?;
    }
    let upper = pool.peek().map_or(limit(best), |piece| piece.bound.max(limit(best)));
    Ok((Deviation { lower: best * other.scale(), upper: upper * other.scale() }, divided))
}

/// A bound up to which a triangle needs no search.
fn limit(best: f64) -> f64 {
    best * (1.0 + GAP) + ZERO
}

/// A corner of a mesh. No more than `bound` away from the other mesh, local units.
fn corner_at(other: &Mesh, point: DVec3, bound: f64) -> Corner {
    let closest = other.exact_closest_point(point, bound);
    Corner { point, distance: closest.distance, face: closest.face }
}

impl ConvexPiece {
    fn new(other: &Mesh, corners: Vec<Corner>) -> Self {
        let mut bound = f64::INFINITY;
        for (i, &Corner { face, .. }) in corners.iter().enumerate() {
            if corners[..i].iter().any(|corner| corner.face == face) {
                continue;
            }
            let distance = |corner: &Corner| {
                if corner.face == face { corner.distance } else { distance_to_face(other, face, corner.point) }
            };
            bound = bound.min(corners.iter().map(distance).fold(0.0, f64::max));
        }
        Self { corners, bound, cuts: 0 }
    }

    /// The two parts on either side of a plane between the nearest faces of two corners, else of the middle of the box.
    fn parts(&self, other: &Mesh) -> [Self; 2] {
        let cut = if self.cuts < MOST_CUTS { self.sides_of_a_cut(other) } else { None };
        let sides = cut.clone().unwrap_or_else(|| self.sides_of_the_middle());
        let (mut below, mut above) = (Vec::new(), Vec::new());
        for (i, &corner) in self.corners.iter().enumerate() {
            let next = (i + 1) % self.corners.len();
            if sides[i] <= ON_PLANE {
                below.push(corner);
            }
            if sides[i] >= -ON_PLANE {
                above.push(corner);
            }
            let crosses =
                (sides[i] < -ON_PLANE && sides[next] > ON_PLANE) || (sides[i] > ON_PLANE && sides[next] < -ON_PLANE);
            if crosses {
                let end = self.corners[next];
                let point = corner.point.lerp(end.point, sides[i] / (sides[i] - sides[next]));
                let reach = |corner: &Corner| corner.distance + corner.point.distance(point);
                let between = corner_at(other, point, reach(&corner).min(reach(&end)) * (1.0 + SLACK) + SLACK);
                below.push(between);
                above.push(between);
            }
        }
        [below, above].map(|corners| {
            let part = Self::new(other, corners);
            // A part cannot be farther away than the whole.
            let bound = part.bound.min(self.bound);
            Self { bound, cuts: if cut.is_some() { self.cuts + 1 } else { 0 }, ..part }
        })
    }

    /// Signed distances of the corners from a plane through the common edge of the nearest faces of two corners, if it
    /// divides the piece.
    fn sides_of_a_cut(&self, other: &Mesh) -> Option<Vec<f64>> {
        let pairs = (1..self.corners.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        pairs
            .filter(|&(i, j)| self.corners[i].face != self.corners[j].face)
            .filter_map(|(i, j)| bisecting_plane(other, self.corners[i].face, self.corners[j].face))
            .map(|(point, normal)| self.corners.iter().map(|corner| normal.dot(corner.point - point)).collect())
            .find(|sides: &Vec<f64>| sides.iter().any(|&x| x > ON_PLANE) && sides.iter().any(|&x| x < -ON_PLANE))
    }

    /// Signed distances of the corners from the plane in the middle of the longest side of their box.
    fn sides_of_the_middle(&self) -> Vec<f64> {
        let points = self.corners.iter().map(|corner| corner.point);
        let (low, high) =
            points.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let axis = (high - low).max_position();
        let middle = 0.5 * (low + high)[axis];
        self.corners.iter().map(|corner| corner.point[axis] - middle).collect()
    }
}

/// A point and the unit normal of the plane through the common edge of two faces that bisects their angle.
fn bisecting_plane(other: &Mesh, first: u32, second: u32) -> Option<(DVec3, DVec3)> {
    let (first, second) = (other.exact_triangle(first), other.exact_triangle(second));
    let mut common = first.iter().filter(|corner| second.contains(corner));
    let (&start, &end) = (common.next()?, common.next()?);
    let normals = triangle_cross(first).try_normalize()? + triangle_cross(second).try_normalize()?;
    Some((start, (end - start).cross(normals).try_normalize()?))
}

fn distance_to_face(other: &Mesh, face: u32, point: DVec3) -> f64 {
    closest_point_on_triangle(point, other.exact_triangle(face)).point.distance(point)
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
    fn large_triangles_over_many_small_ones_take_few_pieces() {
        // A square of two faces over a lattice of 2 * 40^2 faces whose corners are up to 1e-5 away from its plane.
        let n = 40;
        let mut next = crate::mesh::random::uniform(3);
        let mut vertices = Vec::new();
        let mut largest: f64 = 0.0;
        for i in 0..=n {
            for j in 0..=n {
                let height = 1e-5 * next();
                largest = largest.max(height);
                vertices.push([i as f64 / n as f64, j as f64 / n as f64, height]);
            }
        }
        let at = |i: i64, j: i64| i * (n + 1) + j;
        let faces: Vec<[i64; 3]> = (0..n * n)
            .map(|k| (k / n, k % n))
            .flat_map(|(i, j)| [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]])
            .collect();
        let lattice = Mesh::new(&vertices, &faces).unwrap();
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
        let square = Mesh::new(&corners, &[[0, 1, 2], [0, 2, 3]]).unwrap();
        let (found, divided) = search(&square, &lattice, &Progress::new()).unwrap();
        // The square lies straight below the highest vertex; slopes of 1e-5 / 0.025 change its distance by 1e-7 of it.
        assert!((found.lower - largest).abs() <= 1e-3 * largest && found.upper >= largest * (1.0 - 1e-6), "{found:?}");
        // Halving alone takes 1e8 pieces to tell the faces apart along their edges.
        assert!(divided < 40 * faces.len(), "{divided}");
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
