//! Several rays in turns, each in a search of its own.
//!
//! *Theory.* Rays that are far from each other share no nodes, and a search waits for memory at every node that is not
//! in the cache. Each turn moves one ray by one node or one pack and prefetches what that ray reads in its next turn.
//! The other rays are searched while the memory arrives.

use super::ray_lanes::{LaneRay, RayPack};
use super::ray_search::{RayTables, ReadyRay};
use super::stack::Stack;
use super::watertight::{FaceHit, Ray};
use super::{Bvh, ChildRef, Node, WIDTH};

/// Number of rays that take turns. More rays would not fit into the cache with their stacks.
const IN_TURNS: usize = 8;

/// A ray in the middle of its search.
struct Search {
    ray: ReadyRay,
    /// Index of the ray.
    index: usize,
    limit: f32,
    /// Node or leaf that the next turn searches.
    child: ChildRef,
    /// Lanes of the pack `child` that the next turn decides in float64. If zero, the next turn finds them.
    candidates: u32,
}

/// Passes the hits of all rays to `accept` with the index of the ray; see `Mesh::traverse`.
#[inline(always)]
pub(super) fn traverse(
    tables: &RayTables<'_>,
    rays: &[Ray],
    boxes: impl Fn(&LaneRay, &Node, f32) -> (u32, [f32; WIDTH]),
    triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
    accept: &mut impl FnMut(usize, FaceHit) -> f64,
) {
    let mut waiting = rays.iter().enumerate();
    let mut start = || {
        waiting.find_map(|(index, ray)| {
            let ray = tables.ready(ray)?;
            Some(Search { limit: ray.limit(), ray, index, child: Bvh::ROOT, candidates: 0 })
        })
    };
    let mut stacks = [const { Stack::new() }; IN_TURNS];
    let mut searches: [Option<Search>; IN_TURNS] = std::array::from_fn(|_| start());
    let mut busy = searches.iter().flatten().count();
    while busy > 0 {
        for (slot, stack) in searches.iter_mut().zip(&mut stacks) {
            let Some(search) = slot else { continue };
            let mut accept = |hit: FaceHit| accept(search.index, hit);
            if search.child.is_pack() {
                let pack = &tables.packs[search.child.index()];
                if search.candidates == 0 {
                    search.candidates = triangles(&search.ray.lanes, pack, search.limit);
                    if search.candidates != 0 {
                        tables.prefetch_corners(pack, search.candidates);
                        continue;
                    }
                } else {
                    tables.decide(&search.ray, pack, search.candidates, &mut search.limit, &mut accept);
                    search.candidates = 0;
                }
            } else {
                let node = &tables.bvh.nodes[search.child.index()];
                let (mask, entered) = boxes(&search.ray.lanes, node, search.limit);
                if mask != 0 {
                    search.child = stack.push_all_but_nearest(mask, &entered, &node.children);
                    tables.prefetch(search.child);
                    continue;
                }
            }
            match stack.pop(search.limit) {
                Some(child) => {
                    search.child = child;
                    tables.prefetch(child);
                }
                None => {
                    *slot = start();
                    busy -= usize::from(slot.is_none());
                }
            }
        }
    }
}
