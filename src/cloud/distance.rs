//! The nearest disk of a point.
//!
//! With v from the centre of a disk to q, height k = v.n and radius rho = |v - k n| about the axis, the distance is |k|
//! over the disk (rho <= r), and the distance to its rim, sqrt(k^2 + (rho - r)^2), elsewhere. The tree is searched by
//! the boxes of the disks in float32, with a slack for their rounding; disks are compared in float64. Among equally
//! near disks the lowest row wins, so the result depends neither on the tree nor on the first bound.

use super::{Disks, PointCloud};
use crate::bvh::{Bvh, Stack};
use crate::simd::with_vectors;
use glam::DVec3;

/// The nearest disk of a point, local units.
#[derive(Debug, Clone, Copy)]
pub struct NearestDisk {
    /// Row of the point.
    pub row: u32,
    /// Distance to the disk.
    pub distance: f64,
    /// Nearest point of the disk.
    pub point: DVec3,
}

impl Disks {
    /// The nearest point of a disk.
    #[inline(always)]
    fn nearest_point(&self, lane: usize, q: DVec3) -> DVec3 {
        let (center, n, radius) = (self.center(lane), self.normal(lane), self.radius[lane]);
        let v = q - center;
        let across = v - n * v.dot(n);
        let rho = across.length();
        if rho <= radius { center + across } else { center + across * (radius / rho) }
    }
}

impl PointCloud {
    /// The nearest disk to a local point. `bound` is at least its distance; infinity is valid.
    pub fn nearest(&self, p: DVec3, bound: f64) -> NearestDisk {
        self.nearest_within(p, bound).unwrap_or_else(|| {
            // A bound that is too small leaves no candidate. Any disk is one, and its distance is a bound.
            let first = self.first_disk(p);
            self.nearest_within(p, first.distance).unwrap_or(first)
        })
    }

    /// The first disk of the tree as a candidate.
    fn first_disk(&self, p: DVec3) -> NearestDisk {
        let point = self.disks[0].nearest_point(0, p);
        NearestDisk { row: self.bvh.packs[0].face(0), distance: point.distance(p), point }
    }

    fn nearest_within(&self, p: DVec3, bound: f64) -> Option<NearestDisk> {
        with_vectors!((cloud: &PointCloud = self, p: DVec3 = p, bound: f64 = bound) -> Option<NearestDisk> {
            cloud.nearest_portable(p, bound)
        })
    }

    #[inline(always)]
    fn nearest_portable(&self, p: DVec3, bound: f64) -> Option<NearestDisk> {
        let slack = f64::from(Bvh::nearest_slack(p.abs().max_element()));
        let beyond = |distance: f64| ((distance + slack).powi(2) as f32).min(f32::MAX);
        let mut best: Option<NearestDisk> = None;
        let mut limit = beyond(bound);
        let mut stack = Stack::of_root();
        while let Some(index) = self.bvh.next_pack(&mut stack, p.as_vec3(), limit) {
            let disks = &self.disks[index];
            for (lane, &row) in self.bvh.packs[index].faces().iter().enumerate() {
                let point = disks.nearest_point(lane, p);
                let distance = point.distance(p);
                if best.is_none_or(|best| distance < best.distance || (distance == best.distance && row < best.row)) {
                    best = Some(NearestDisk { row, distance, point });
                    limit = limit.min(beyond(distance));
                }
            }
        }
        best
    }
}
