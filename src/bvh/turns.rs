//! Several rays in turns, each in a search of its own.
//!
//! *Theory.* Rays that are far from each other share no nodes, and a search waits for memory at every node that is not
//! in the cache. Each turn moves one ray by one node or one pack and prefetches what that ray reads in its next turn.
//! The other rays are searched while the memory arrives.

use super::cast::Collector;
use super::ray_group::RayGroup;
use super::ray_lanes::{LaneRay, RayPack};
use super::ray_search::{RayTables, ReadyRay};
use super::stack::Stack;
use super::watertight::Ray;
use super::{Bvh, ChildRef, Node, WIDTH};

/// Number of rays that take turns. More rays would not fit into the cache with their stacks.
const IN_TURNS: usize = 8;

/// A ray in the middle of its search.
struct Search<K> {
    ray: ReadyRay,
    /// Index of the ray.
    index: usize,
    /// What is known of the result.
    kept: K,
    limit: f32,
    /// Node or leaf that the next turn searches.
    child: ChildRef,
    /// Lanes of the pack `child` that the next turn decides in float64. If zero, the next turn finds them.
    candidates: u32,
    stack: Stack,
}

/// The rays that still wait for their search.
struct Waiting<I, C> {
    rays: I,
    clip: C,
    group: RayGroup,
    /// Lanes of the group whose search has not begun.
    lanes: u32,
    /// Index of the first ray of the group.
    first: usize,
}

impl<I: Iterator<Item = Ray>, C: Fn(&mut RayGroup)> Waiting<I, C> {
    /// The next ray that reaches the box. Rays that miss it are finished.
    #[inline(always)]
    fn next<K: Default>(&mut self, collector: &mut impl Collector<Kept = K>) -> Option<(usize, ReadyRay)> {
        while self.lanes == 0 {
            self.first += self.group.count;
            if !self.group.fill(&mut self.rays) {
                return None;
            }
            (self.clip)(&mut self.group);
            self.lanes = self.group.mask;
            for lane in (0..self.group.count).filter(|lane| self.lanes >> lane & 1 == 0) {
                collector.finish(self.first + lane, &mut K::default());
            }
        }
        let lane = self.lanes.trailing_zeros() as usize % WIDTH;
        self.lanes &= self.lanes - 1;
        Some((self.first + lane, self.group.ready(lane)))
    }
}

/// Searches all rays; see `Mesh::traverse_many`. `clip` clips a group of rays to the box of the mesh.
#[inline(always)]
pub(super) fn traverse<K: Default>(
    tables: &RayTables<'_>,
    rays: impl Iterator<Item = Ray>,
    clip: impl Fn(&mut RayGroup),
    boxes: impl Fn(&LaneRay, &Node, f32) -> (u32, [f32; WIDTH]),
    triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
    collector: &mut impl Collector<Kept = K>,
) {
    let mut waiting = Waiting { rays, clip, group: RayGroup::new(), lanes: 0, first: 0 };
    let mut searches = Vec::with_capacity(IN_TURNS);
    while searches.len() < IN_TURNS
        && let Some((index, ray)) = waiting.next(collector)
    {
        let limit = ray.limit();
        let (child, stack) = (Bvh::ROOT, Stack::new());
        searches.push(Search { ray, index, kept: K::default(), limit, child, candidates: 0, stack });
    }
    while !searches.is_empty() {
        let mut slot = 0;
        while let Some(search) = searches.get_mut(slot) {
            slot += 1;
            if search.child.is_pack() {
                let pack = &tables.packs[search.child.index()];
                if search.candidates == 0 {
                    search.candidates = triangles(&search.ray.lanes, pack, search.limit);
                    if search.candidates != 0 {
                        tables.prefetch_corners(pack, search.candidates);
                        continue;
                    }
                } else {
                    let mut accept = |hit| collector.accept(&mut search.kept, hit);
                    tables.decide(&search.ray, pack, search.candidates, &mut search.limit, &mut accept);
                    search.candidates = 0;
                }
            } else {
                let node = &tables.bvh.nodes[search.child.index()];
                let (mask, entered) = boxes(&search.ray.lanes, node, search.limit);
                if mask != 0 {
                    search.child = search.stack.push_all_but_nearest(mask, &entered, &node.children);
                    tables.prefetch(search.child);
                    continue;
                }
            }
            match search.stack.pop(search.limit) {
                Some(child) => {
                    search.child = child;
                    tables.prefetch(child);
                }
                None => {
                    collector.finish(search.index, &mut search.kept);
                    match waiting.next(collector) {
                        Some((index, ray)) => {
                            // The stack is empty, and `finish` has reset what was kept.
                            (search.index, search.child, search.limit) = (index, Bvh::ROOT, ray.limit());
                            search.ray = ray;
                        }
                        None => {
                            slot -= 1;
                            searches.swap_remove(slot);
                        }
                    }
                }
            }
        }
    }
}
