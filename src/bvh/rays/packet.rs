//! Eight rays in one search of the tree, with AVX2.
//!
//! *Theory.* One box is tested against eight rays at a time, and a child is searched by the rays that enter its box.
//! Near rays visit the same nodes, so they share the reads of the nodes and the order of the children. Where few rays
//! are left, each is searched alone: a search of one ray tests eight boxes at a time.
//!
//! The tests equal the tests of [`super::ray_lanes`], with the same operations.

use super::ray_group::{RayGroup, Slabs};
use super::ray_lanes::{LaneRay, RayPack};
use super::ray_search::{RayTables, ReadyRay};
use super::watertight::FaceHit;
use crate::bvh::{Bvh, ChildRef, MAX_STACK, Node, WIDTH};
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

/// Largest number of rays that are searched one by one.
const FEW: u32 = 2;

/// Eight rays side by side. An absent ray has the limit of negative infinity and enters no box.
struct Packet {
    /// Origins moved by the margin of the boxes, for the lower and the upper sides, indexed by axis.
    low: [__m256; 3],
    high: [__m256; 3],
    inverse: [__m256; 3],
}

/// A child that is still to be searched.
#[derive(Clone, Copy)]
struct Entry {
    /// The t at which each ray enters the box.
    entered: __m256,
    child: ChildRef,
    /// The rays that enter the box.
    mask: u32,
    /// The t of the first of these rays.
    key: f32,
}

/// Passes the hits of the rays of a clipped group to `accept` with the lane of the ray; see `Mesh::traverse`.
#[inline]
#[target_feature(enable = "avx2")]
pub(crate) fn traverse(tables: &RayTables<'_>, group: &RayGroup, accept: &mut impl FnMut(usize, FaceHit) -> f64) {
    let boxes = |lanes: &LaneRay, node: &Node, limit: f32| lanes.boxes_avx2(node, limit);
    let triangles = |lanes: &LaneRay, pack: &RayPack, limit: f32| lanes.triangles_avx2(pack, limit);
    let mut mask = group.mask;
    if mask == 0 {
        return;
    }
    let mut limits = group.slabs.limits;
    for (lane, limit) in limits.iter_mut().enumerate() {
        if mask >> lane & 1 == 0 {
            *limit = f32::NEG_INFINITY;
        }
    }
    // Most rays that miss the surface need no tests of their own.
    let mut ready = [const { None::<ReadyRay> }; WIDTH];
    let packet = Packet::new(&group.slabs);
    let mut stack = [const { MaybeUninit::<Entry>::uninit() }; MAX_STACK + WIDTH];
    let mut top = 0;
    let mut child = Bvh::ROOT;
    loop {
        if child.is_pack() || mask.count_ones() <= FEW {
            while mask != 0 {
                let lane = mask.trailing_zeros() as usize % WIDTH;
                mask &= mask - 1;
                let ray = &*ready[lane].get_or_insert_with(|| group.ready(lane));
                let mut accept = |hit: FaceHit| accept(lane, hit);
                if child.is_pack() {
                    tables.search_pack(ray, child, &mut limits[lane], triangles, &mut accept);
                } else {
                    tables.search(ray, child, &mut limits[lane], boxes, triangles, &mut accept);
                }
            }
        } else {
            let node = &tables.bvh.nodes[child.index()];
            let limit = load(&limits);
            let bottom = top;
            for lane in 0..WIDTH {
                let (found, entered) = packet.enter(node, lane, limit);
                let mask = if node.children[lane].is_none() { 0 } else { found & mask };
                // The slot is kept if a ray enters. The condition costs less without a branch.
                let key = at(entered, mask.trailing_zeros());
                stack[top].write(Entry { entered, child: node.children[lane], mask, key });
                top += usize::from(mask != 0);
            }
            // The nearest child goes on top.
            // SAFETY: all slots below `top` have been written, and only these are sorted.
            let key = |entry: &MaybeUninit<Entry>| unsafe { entry.assume_init_ref() }.key;
            for next in bottom + 1..top {
                let entry = stack[next];
                let mut slot = next;
                while slot > bottom && key(&stack[slot - 1]) < key(&entry) {
                    stack[slot] = stack[slot - 1];
                    slot -= 1;
                }
                stack[slot] = entry;
            }
        }
        let limit = load(&limits);
        loop {
            if top == 0 {
                return;
            }
            top -= 1;
            // SAFETY: every slot below the old `top` has been written.
            let entry = unsafe { stack[top].assume_init_ref() };
            let before = _mm256_cmp_ps::<_CMP_LE_OQ>(entry.entered, limit);
            mask = entry.mask & _mm256_movemask_ps(before) as u32;
            if mask != 0 {
                child = entry.child;
                break;
            }
        }
    }
}

impl Packet {
    #[inline]
    #[target_feature(enable = "avx2")]
    fn new(slabs: &Slabs) -> Self {
        let Slabs { low, high, inverse, .. } = slabs;
        Self {
            low: [load(&low[0]), load(&low[1]), load(&low[2])],
            high: [load(&high[0]), load(&high[1]), load(&high[2])],
            inverse: [load(&inverse[0]), load(&inverse[1]), load(&inverse[2])],
        }
    }

    /// Mask of the rays that enter the box of a child before their limits, and the t of entry.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn enter(&self, node: &Node, lane: usize, limit: __m256) -> (u32, __m256) {
        let mut enter = _mm256_setzero_ps();
        let mut leave = limit;
        for axis in 0..3 {
            let (low, high) = (_mm256_set1_ps(node.min[axis][lane]), _mm256_set1_ps(node.max[axis][lane]));
            let low = _mm256_mul_ps(_mm256_sub_ps(low, self.low[axis]), self.inverse[axis]);
            let high = _mm256_mul_ps(_mm256_sub_ps(high, self.high[axis]), self.inverse[axis]);
            enter = _mm256_max_ps(_mm256_min_ps(low, high), enter);
            leave = _mm256_min_ps(_mm256_max_ps(low, high), leave);
        }
        let leave = _mm256_mul_ps(leave, _mm256_set1_ps(1.000_001));
        (_mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave)) as u32, enter)
    }
}

#[inline]
#[target_feature(enable = "avx2")]
fn load(row: &[f32; WIDTH]) -> __m256 {
    // SAFETY: the array has eight floats, and the load needs no alignment.
    unsafe { _mm256_loadu_ps(row.as_ptr()) }
}

/// One lane; the index counts modulo 8.
#[inline]
#[target_feature(enable = "avx2")]
fn at(row: __m256, lane: u32) -> f32 {
    _mm256_cvtss_f32(_mm256_permutevar8x32_ps(row, _mm256_set1_epi32(lane as i32)))
}
