//! The nearest neighbours of points.

use super::{Frame, tree_of};
use crate::bvh::{Bvh, Stack};
use glam::DVec3;

/// Points and the tree over them.
#[derive(Debug)]
pub(crate) struct PointTree {
    pub(crate) bvh: Bvh,
    /// Local positions.
    pub(crate) points: Vec<DVec3>,
}

impl PointTree {
    pub(crate) fn new(points: &[[f64; 3]], frame: &Frame) -> Self {
        Self::of_local(points.iter().map(|&p| frame.local(p)).collect())
    }

    /// The tree over local positions.
    pub(crate) fn of_local(points: Vec<DVec3>) -> Self {
        let bvh = tree_of(points.iter().map(|&p| (p, DVec3::ZERO)));
        Self { bvh, points }
    }

    /// Replaces `found` by the `count` nearest points, or all if there are fewer: squared distances and rows, the
    /// nearest first, equal distances in the order of their rows.
    pub(crate) fn nearest(&self, p: DVec3, count: usize, found: &mut Vec<(f64, u32)>) {
        found.clear();
        let slack = f64::from(Bvh::nearest_slack(p.abs().max_element()));
        let mut stack = Stack::of_root();
        let mut limit = f32::MAX;
        while let Some(index) = self.bvh.next_pack(&mut stack, p.as_vec3(), limit) {
            for &row in self.bvh.packs[index].faces() {
                let next = (self.points[row as usize].distance_squared(p), row);
                let place = found.partition_point(|other| *other < next);
                if place < count {
                    found.truncate(count - 1);
                    found.insert(place, next);
                }
            }
            if found.len() >= count {
                limit = (found[count - 1].0.sqrt() + slack).powi(2) as f32;
            }
        }
    }
}
