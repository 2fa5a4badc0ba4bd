//! The nearest triangle of one point: depth first, near child first, pruned by the smallest squared distance so far.
//!
//! The result is the least float32 distance of all triangles, and among equal ones the lowest face. Boxes are dropped
//! only beyond the rounding of float32, so that the result does not depend on the tree. Points far from the mesh use
//! the tree of a build ([`Mesh::bvh_within`]).

use crate::bvh::lanes::{least_of, mask_within};
use crate::bvh::pack::TriangleFrame;
use crate::bvh::{Bvh, FAR, Node, Stack, WIDTH};
use crate::geometry::{TrianglePoint, closest_point_on_triangle};
use crate::mesh::Mesh;
use crate::simd::with_vectors;
use glam::{DVec3, Vec3};

/// The nearest face of a point and its squared distance, as compared in float32.
#[derive(Debug, Clone, Copy)]
pub struct Nearest {
    /// Pack and lane of the face.
    pub slot: Slot,
    pub face: u32,
    pub distance_squared: f32,
    /// Number of packs that the search measured.
    pub packs: u32,
}

/// Position of a triangle in the tree.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Slot {
    pub pack: u32,
    pub lane: u8,
}

/// The nearest point of a mesh in float64, local units.
#[derive(Debug, Clone, Copy)]
pub struct ClosestPoint {
    pub face: u32,
    pub distance: f64,
    pub on_triangle: TrianglePoint,
}

impl Mesh {
    /// The closest point to a local position. Among equally near faces the lowest one is returned.
    pub fn closest_point(&self, p: DVec3) -> ClosestPoint {
        self.closest_point_within(p, f32::INFINITY).expect("a mesh has at least one face")
    }

    /// The closest point, or None if every squared float32 distance exceeds `bound_squared`.
    pub fn closest_point_within(&self, p: DVec3, bound_squared: f32) -> Option<ClosestPoint> {
        let nearest = self.distance_bvh(p.abs().max_element()).nearest(p.as_vec3(), bound_squared)?;
        Some(self.closest_point_on_face(nearest.face, p))
    }

    /// The closest point on one face.
    pub fn closest_point_on_face(&self, face: u32, p: DVec3) -> ClosestPoint {
        let on_triangle = closest_point_on_triangle(p, self.triangle(face));
        ClosestPoint { face, distance: on_triangle.point.distance(p), on_triangle }
    }
}

impl Node {
    /// Longest side of a child's box.
    #[inline(always)]
    pub fn size(&self, lane: usize) -> f32 {
        let side = |axis: usize| self.max[axis][lane] - self.min[axis][lane];
        side(0).max(side(1)).max(side(2))
    }

    /// Squared distance of `p` to each child's box, infinite for an absent child.
    #[inline(always)]
    pub fn distances_squared(&self, p: Vec3) -> [f32; WIDTH] {
        let mut result = [0.0; WIDTH];
        // With the lanes in the inner loop, each operation of an axis is one vector instruction.
        for axis in 0..3 {
            let (low, high, p) = (&self.min[axis], &self.max[axis], p[axis]);
            for i in 0..WIDTH {
                let (below, above) = (low[i] - p, p - high[i]);
                let outside = if below > above { below } else { above };
                let outside = if outside > 0.0 { outside } else { 0.0 };
                result[i] += outside * outside;
            }
        }
        result
    }
}

impl Bvh {
    /// The nearest face with a squared distance of at most `bound_squared`.
    pub fn nearest(&self, p: Vec3, bound_squared: f32) -> Option<Nearest> {
        with_vectors!((bvh: &Bvh = self, p: Vec3 = p, bound_squared: f32 = bound_squared) -> Option<Nearest> {
            bvh.nearest_portable(p, bound_squared)
        })
    }

    #[inline(always)]
    fn nearest_portable(&self, p: Vec3, bound_squared: f32) -> Option<Nearest> {
        let mut best = bound_squared;
        // A box may be dropped beyond the rounding of a distance to it and of one to a triangle in it.
        let reach = f64::from(p.abs().max_element());
        let slack = if reach <= FAR { Bvh::nearest_slack(reach) } else { 0.0 };
        let beyond = |squared: f32| {
            let limit = squared.sqrt() + slack;
            (limit * limit).min(f32::MAX)
        };
        let mut limit = beyond(best);
        let mut nearest: Option<(Slot, u32)> = None;
        let mut packs = 0;
        let mut stack = Stack::of_root();
        while let Some(index) = self.next_pack(&mut stack, p, limit) {
            packs += 1;
            let pack = &self.packs[index];
            let found = pack.distances_squared(p);
            let least = least_of(&found);
            if least <= best {
                for lane in pack.lanes_within(&found, least) {
                    let face = pack.face(lane);
                    if least < best || nearest.is_none_or(|(_, lowest)| face < lowest) {
                        best = least;
                        nearest = Some((Slot { pack: index as u32, lane: lane as u8 }, face));
                    }
                }
                limit = beyond(best);
            }
        }
        nearest.map(|(slot, face)| Nearest { slot, face, distance_squared: best, packs })
    }

    /// The triangle in a slot.
    pub fn frame(&self, slot: Slot) -> TriangleFrame {
        self.packs[slot.pack as usize].frame(usize::from(slot.lane))
    }

    /// Calls `on_face` for all faces whose float32 distance to `p` is at most `radius`.
    pub fn faces_within(&self, p: Vec3, radius: f32, mut on_face: impl FnMut(u32)) {
        let radius_squared = radius * radius;
        self.visit(
            |node| mask_within(&node.distances_squared(p), radius_squared),
            |pack| {
                let found = pack.distances_squared(p);
                for (lane, &face) in pack.faces().iter().enumerate() {
                    if found[lane] <= radius_squared {
                        on_face(face);
                    }
                }
            },
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::soup;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        /// Every point finds what brute force finds, in any mesh size from one triangle to several levels.
        #[test]
        fn closest_point_matches_brute_force(
            count in 1usize..400, seed in any::<u64>(), x in -1.0..1.0f64, y in -1.0..1.0f64, z in -1.0..1.0f64
        ) {
            let mesh = soup(count, 0.1, seed);
            let p = DVec3::new(x, y, z);
            let exact = (0..count as u32).map(|f| mesh.closest_point_on_face(f, p).distance).fold(f64::INFINITY, f64::min);
            prop_assert!(mesh.closest_point(p).distance - exact < 1e-6);
        }

        /// A wider instruction set changes no bit.
        #[test]
        fn every_path_gives_the_same_bits(seed in any::<u64>(), x in -1.0..1.0f32, y in -1.0..1.0f32, z in -1.0..1.0f32) {
            let mesh = soup(200, 0.1, seed);
            let p = Vec3::new(x, y, z);
            let dispatched = mesh.bvh().nearest(p, f32::INFINITY).unwrap();
            let portable = mesh.bvh().nearest_portable(p, f32::INFINITY).unwrap();
            prop_assert_eq!(dispatched.face, portable.face);
            prop_assert_eq!(dispatched.distance_squared.to_bits(), portable.distance_squared.to_bits());
        }
    }

    /// Thousands of equal faces cost as much as one, and the lowest of equal faces is returned.
    #[test]
    fn equal_faces_are_measured_once() {
        let soup = soup(40, 0.3, 5);
        let corners = |face: usize| soup.faces()[face % 40].map(|v| soup.world_positions()[v as usize]);
        let vertices: Vec<[f64; 3]> = (0..4000).flat_map(corners).collect();
        let faces: Vec<[i64; 3]> = (0..4000).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
        let mesh = Mesh::new(&vertices, &faces).unwrap();
        assert!(mesh.bvh().packs.len() >= 500);
        let mut next = crate::mesh::random::uniform(3);
        for far in [1.0, 1.0, 1.0, 7.0, 9.0, 1e4] {
            let p = DVec3::new(next() - 0.5, next() - 0.5, next() - 0.5) * far;
            let nearest = mesh.distance_bvh(far).nearest(p.as_vec3(), f32::INFINITY).unwrap();
            let expected = mesh.bvh_within(far).nearest(p.as_vec3(), f32::INFINITY).unwrap();
            assert!(nearest.packs <= 12 && expected.packs >= 12, "{} {}", nearest.packs, expected.packs);
            assert_eq!((nearest.face, nearest.distance_squared), (expected.face, expected.distance_squared));
            assert!(nearest.face < 40);
            let exact = mesh.exact_closest_point(p, f64::INFINITY);
            let all = (0..4000).map(|face| mesh.exact_point_on_face(face, p));
            let least = all.reduce(|best, next| if next.distance < best.distance { next } else { best }).unwrap();
            assert_eq!((exact.face, exact.distance), (least.face, least.distance));
        }
        // Rays and other queries still have all faces.
        let mut found = 0;
        mesh.bvh().faces_within(Vec3::ZERO, 10.0, |_| found += 1);
        assert_eq!(found, 4000);
    }

    #[test]
    fn a_bound_below_the_distance_finds_nothing() {
        let mesh = soup(50, 0.1, 7);
        let p = DVec3::splat(3.0);
        let distance = mesh.closest_point(p).distance as f32;
        assert!(mesh.closest_point_within(p, (distance * 0.99).powi(2)).is_none());
        assert!(mesh.closest_point_within(p, (distance * 1.01).powi(2)).is_some());
    }
}
