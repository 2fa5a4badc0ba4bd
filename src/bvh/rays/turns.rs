//! Several rays in turns, each in a search of its own.
//!
//! *Theory.* Rays that are far from each other share no nodes. A search of one of them waits for memory at every node
//! that is not in the cache, and for the processor wherever the next step is not foreseen. Each turn moves every ray by
//! one step and prefetches what the ray reads in its next step, so the rays wait at the same time. Rays with the same
//! kind of step form a list, and the steps of a list have no branch that depends on the ray.

use super::ray_group::RayGroup;
use super::ray_lanes::{LaneRay, RayPack};
use super::ray_search::{Collector, RayTables, ReadyRay};
use super::sorted_stack::SortedStack;
use super::watertight::Ray;
use crate::bvh::{Bvh, ChildRef, Node, WIDTH};
use crate::memory::prefetch;

/// Number of rays that take turns. More rays would not fit into the cache with their stacks.
const IN_TURNS: usize = 16;

/// A ray in the middle of its search.
struct Search<K> {
    ray: ReadyRay,
    /// Index of the ray.
    index: usize,
    /// State of the result; see [`Collector`].
    kept: K,
    limit: f32,
    /// Node or pack that the next step searches.
    child: ChildRef,
    /// Lanes of the pack `child` that are still to be decided in float64.
    candidates: u32,
    stack: SortedStack,
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

/// Indices of the searches with the same kind of step.
struct List {
    /// One slot more than searches, for a search that is not added.
    searches: [u8; IN_TURNS + 1],
    count: usize,
}

impl List {
    const EMPTY: Self = Self { searches: [0; IN_TURNS + 1], count: 0 };

    fn iter(&self) -> impl Iterator<Item = usize> {
        self.searches[..self.count].iter().map(|&search| usize::from(search))
    }

    /// Adds a search if `condition` holds, without a branch.
    #[inline(always)]
    fn push_if(&mut self, condition: bool, search: usize) {
        self.searches[self.count] = search as u8;
        self.count += usize::from(condition);
    }
}

/// The searches by the kind of their next step.
struct Lists {
    nodes: List,
    packs: List,
    finished: List,
}

impl Lists {
    const EMPTY: Self = Self { nodes: List::EMPTY, packs: List::EMPTY, finished: List::EMPTY };

    /// Adds a search to the list of its child.
    #[inline(always)]
    fn push(&mut self, child: ChildRef, search: usize) {
        self.nodes.push_if(!child.is_pack(), search);
        self.packs.push_if(child.is_pack() && !child.is_none(), search);
        self.finished.push_if(child.is_none(), search);
    }
}

/// Searches all rays; see `Mesh::traverse_many`. `clip` clips a group of rays to the box of the mesh.
#[inline(always)]
pub(crate) fn traverse<K: Default>(
    tables: &RayTables<'_>,
    rays: impl Iterator<Item = Ray>,
    clip: impl Fn(&mut RayGroup),
    push_boxes: impl Fn(&LaneRay, &Node, f32, &mut SortedStack),
    triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
    collector: &mut impl Collector<Kept = K>,
) {
    let mut waiting = Waiting { rays, clip, group: RayGroup::new(), lanes: 0, first: 0 };
    let mut searches = Vec::with_capacity(IN_TURNS);
    let mut lists = Lists::EMPTY;
    while searches.len() < IN_TURNS
        && let Some((index, ray)) = waiting.next(collector)
    {
        lists.push(Bvh::ROOT, searches.len());
        let limit = ray.limit();
        let (child, stack) = (Bvh::ROOT, SortedStack::new());
        searches.push(Search { ray, index, kept: K::default(), limit, child, candidates: 0, stack });
    }
    let mut undecided = List::EMPTY;
    let mut busy = searches.len();
    while busy > 0 {
        let now = std::mem::replace(&mut lists, Lists::EMPTY);
        for slot in undecided.iter() {
            let search = &mut searches[slot];
            let pack = &tables.packs[search.child.index()];
            let mut accept = |hit| collector.accept(&mut search.kept, hit);
            tables.decide(&search.ray, pack, search.candidates, &mut search.limit, &mut accept);
            search.child = search.stack.pop(search.limit);
            lists.push(search.child, slot);
        }
        for slot in now.finished.iter() {
            let search = &mut searches[slot];
            collector.finish(search.index, &mut search.kept);
            // The stack is empty, and `finish` has reset what was kept.
            match waiting.next(collector) {
                Some((index, ray)) => {
                    (search.index, search.child, search.limit) = (index, Bvh::ROOT, ray.limit());
                    search.ray = ray;
                    lists.push(Bvh::ROOT, slot);
                }
                None => busy -= 1,
            }
        }
        for slot in now.nodes.iter() {
            let search = &mut searches[slot];
            let node = &tables.bvh.nodes[search.child.index()];
            push_boxes(&search.ray.lanes, node, search.limit, &mut search.stack);
            search.child = search.stack.pop(search.limit);
            lists.push(search.child, slot);
        }
        undecided = List::EMPTY;
        for slot in now.packs.iter() {
            let search = &mut searches[slot];
            let pack = &tables.packs[search.child.index()];
            search.candidates = triangles(&search.ray.lanes, pack, search.limit);
            if search.candidates == 0 {
                search.child = search.stack.pop(search.limit);
                lists.push(search.child, slot);
            } else {
                undecided.push_if(true, slot);
                tables.prefetch_corners(pack, search.candidates);
            }
        }
        for slot in lists.nodes.iter() {
            prefetch(&tables.bvh.nodes[searches[slot].child.index()]);
        }
        for slot in lists.packs.iter() {
            prefetch(&tables.packs[searches[slot].child.index()]);
        }
    }
}
