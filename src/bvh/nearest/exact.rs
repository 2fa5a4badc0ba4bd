//! The nearest face of a point, decided in float64.
//!
//! *Theory.* The float32 search of [`super::closest`] may choose the wrong one of two faces whose distances differ by
//! less than its rounding. On a nearly flat surface this moves the closest point by sqrt(2 d e) for a distance d and a
//! rounding e, a thousand times the rounding itself. This search therefore keeps every face within twice the rounding
//! of the best one, and float64 chooses among them: one to three faces for most points. Among equally near faces the
//! lowest index wins, so the result does not depend on the initial bound.
//!
//! The rounding grows with the distance. Beyond [`FAR`] local units the search would keep too many faces, and the boxes
//! are compared in float64 instead.

use super::closest::ClosestPoint;
use crate::bvh::lanes::least_of;
use crate::bvh::{BOX_ROUNDING, Bvh, FAR, Node, Stack, WIDTH};
use crate::geometry::{Feature, is_needle};
use crate::mesh::Mesh;
use crate::simd::with_vectors;
use glam::DVec3;

/// Number of faces kept before float64 compares them. A list of 4 kB would displace the nodes from the first-level
/// cache.
const KEPT: usize = 48;
/// A face whose plane float64 does not determine is the nearest one only if it is nearer than all others by more than
/// this, local units. The width of such a needle is below 1e-10, so its neighbours are as near, and have a normal.
const NEEDLE_PENALTY: f64 = 2e-10;

/// Faces that may be the nearest, and the best face compared in float64 so far.
struct ExactCandidates<'a> {
    mesh: &'a Mesh,
    p: DVec3,
    kept: [(f32, u32); KEPT],
    count: usize,
    best: Option<ClosestPoint>,
}

impl<'a> ExactCandidates<'a> {
    fn new(mesh: &'a Mesh, p: DVec3) -> Self {
        Self { mesh, p, kept: [(0.0, 0); KEPT], count: 0, best: None }
    }

    /// Compares one face in float64.
    fn compare(&mut self, face: u32) {
        if self.is_tied_at_a_vertex(face) {
            return;
        }
        let found = self.mesh.exact_point_on_face(face, self.p);
        if self.best.as_ref().is_none_or(|best| self.precedes(&found, best)) {
            self.best = Some(found);
        }
    }

    /// Whether a face precedes another one: by distance, where needles have a penalty, then by index.
    fn precedes(&self, found: &ClosestPoint, best: &ClosestPoint) -> bool {
        let mut difference = found.distance - best.distance;
        if difference.abs() <= NEEDLE_PENALTY && self.mesh.has_needles() {
            let penalty = |face: u32| if is_needle(self.mesh.exact_triangle(face)) { NEEDLE_PENALTY } else { 0.0 };
            difference = (found.distance + penalty(found.face)) - (best.distance + penalty(best.face));
        }
        difference < 0.0 || (difference == 0.0 && found.face < best.face)
    }

    /// Whether a face shares the best point, which is a vertex, has no nearer point, and has a higher index. Convex
    /// vertices are the closest points of many positions, and all their faces are candidates then.
    fn is_tied_at_a_vertex(&self, face: u32) -> bool {
        let Some(ClosestPoint { face: best, on_triangle, .. }) = self.best else { return false };
        let Feature::Vertex(corner) = on_triangle.feature else { return false };
        let faces = self.mesh.faces();
        let (vertex, corners) = (faces[best as usize][usize::from(corner)], faces[face as usize]);
        let Some(shared) = corners.iter().position(|&corner| corner == vertex) else { return false };
        let away = self.p - on_triangle.point;
        let leads_away = |corner: u32| (self.mesh.exact_position(corner) - on_triangle.point).dot(away) <= 0.0;
        face > best && leads_away(corners[(shared + 1) % 3]) && leads_away(corners[(shared + 2) % 3])
    }

    #[inline(always)]
    fn keep(&mut self, squared: f32, face: u32, limit: f32) {
        if self.count == KEPT {
            self.drop_beyond(limit);
        }
        self.kept[self.count] = (squared, face);
        self.count += 1;
    }

    /// Frees space: drops the faces beyond the limit, and compares the remaining faces if most are left.
    fn drop_beyond(&mut self, limit: f32) {
        let mut remaining = 0;
        for i in 0..self.count {
            if self.kept[i].0 <= limit {
                self.kept[remaining] = self.kept[i];
                remaining += 1;
            }
        }
        self.count = remaining;
        if remaining > KEPT / 2 {
            self.compare_kept();
        }
    }

    /// Compares the kept faces, the lowest one first: the others at the same vertex cost little then.
    fn compare_kept(&mut self) {
        let count = std::mem::take(&mut self.count);
        if count > 2 {
            self.kept[..count].sort_unstable_by_key(|&(_, face)| face);
        }
        for i in 0..count {
            self.compare(self.kept[i].1);
        }
    }
}

impl Mesh {
    /// The closest point to a local position over all faces, in float64. `bound` must be at least the distance;
    /// infinity is valid.
    pub fn exact_closest_point(&self, p: DVec3, bound: f64) -> ClosestPoint {
        // A bound that is too small leaves no candidate. The unbounded search always finds one.
        self.exact_closest_point_within(p, bound).unwrap_or_else(|| self.closest_point_from_afar(p))
    }

    /// [`Mesh::exact_closest_point`] for any bound: none if no face is within it. A point beyond the bound may be
    /// found, and is not the closest one then.
    pub fn exact_closest_point_within(&self, p: DVec3, bound: f64) -> Option<ClosestPoint> {
        if p.abs().max_element() > FAR {
            return Some(self.closest_point_from_afar(p));
        }
        with_vectors!((mesh: &Mesh = self, p: DVec3 = p, bound: f64 = bound) -> Option<ClosestPoint> {
            mesh.exact_closest_point_near(p, bound)
        })
    }

    #[inline(always)]
    fn exact_closest_point_near(&self, p: DVec3, bound: f64) -> Option<ClosestPoint> {
        let bvh = self.distance_bvh(p.abs().max_element());
        let p_single = p.as_vec3();
        let slack = Bvh::nearest_slack(p.abs().max_element());
        let mut candidates = ExactCandidates::new(self, p);
        let reach = bound as f32 + slack;
        // Squared distances: the best one, and the largest one that float64 may still prefer.
        let mut limit = (reach * reach * (1.0 + 1e-6)).min(f32::MAX);
        let mut best = limit;
        let mut stack = Stack::of_root();
        while let Some(index) = bvh.next_pack(&mut stack, p_single, limit) {
            let pack = &bvh.packs[index];
            let found = pack.distances_squared(p_single);
            let least = least_of(&found);
            if least < best {
                best = least;
                let reach = best.sqrt() + slack;
                limit = limit.min(reach * reach);
            }
            if least <= limit {
                for lane in pack.lanes_within(&found, limit) {
                    candidates.keep(found[lane], pack.face(lane), limit);
                }
            }
        }
        candidates.drop_beyond(limit);
        candidates.compare_kept();
        candidates.best
    }

    /// The closest point by float64 boxes, for points outside the range of the float32 search.
    fn closest_point_from_afar(&self, p: DVec3) -> ClosestPoint {
        let bvh = self.distance_bvh(p.abs().max_element());
        let mut candidates = ExactCandidates::new(self, p);
        candidates.compare(bvh.nearest(p.as_vec3(), f32::INFINITY).map_or(0, |nearest| nearest.face));
        let mut stack = vec![(0.0f64, Bvh::ROOT)];
        while let Some((box_distance, child)) = stack.pop() {
            let limit = candidates.best.map_or(f64::INFINITY, |best| best.distance);
            if box_distance > limit {
                continue;
            }
            if child.is_pack() {
                bvh.packs[child.index()].faces().iter().for_each(|&face| candidates.compare(face));
                continue;
            }
            let node = &bvh.nodes[child.index()];
            let first = stack.len();
            for lane in (0..WIDTH).filter(|&lane| !node.children[lane].is_none()) {
                let distance = box_distance_from(node, lane, p);
                if distance <= limit {
                    stack.push((distance, node.children[lane]));
                }
            }
            stack[first..].sort_by(|a, b| b.0.total_cmp(&a.0));
        }
        candidates.best.expect("the first face was compared")
    }

    /// The closest point on one face of the mesh's own float64 positions, local units.
    pub fn exact_point_on_face(&self, face: u32, p: DVec3) -> ClosestPoint {
        let on_triangle = crate::geometry::closest_point_on_triangle(p, self.exact_triangle(face));
        ClosestPoint { face, distance: on_triangle.point.distance(p), on_triangle }
    }
}

/// A lower bound on the distance from `p` to the contents of a lane's box.
fn box_distance_from(node: &Node, lane: usize, p: DVec3) -> f64 {
    let outside = |axis: usize| {
        let below = f64::from(node.min[axis][lane]) - BOX_ROUNDING - p[axis];
        let above = p[axis] - f64::from(node.max[axis][lane]) - BOX_ROUNDING;
        below.max(above).max(0.0)
    };
    DVec3::new(outside(0), outside(1), outside(2)).length() * (1.0 - 1e-15)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::soup;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        /// The face is the face of brute force in float64, and the distance is equal to the bit, near and far.
        #[test]
        fn the_face_is_that_of_brute_force(
            count in 1usize..400, seed in any::<u64>(), x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64,
            far in prop::sample::select(vec![1.0, 1.0, 7.0, 9.0, 1e4, 1e12])
        ) {
            let mesh = soup(count, 0.1, seed);
            let p = DVec3::new(x, y, z) * far;
            let exact = (0..count as u32).map(|face| mesh.exact_point_on_face(face, p)).reduce(|best, next| {
                if next.distance < best.distance { next } else { best }
            }).unwrap();
            for bound in [f64::INFINITY, exact.distance, 1.5 * exact.distance] {
                let found = mesh.exact_closest_point(p, bound);
                prop_assert_eq!(found.distance, exact.distance);
                prop_assert_eq!(found.face, exact.face);
            }
        }
    }
}
