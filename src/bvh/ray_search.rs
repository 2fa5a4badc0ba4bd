//! The search of the tree by one ray, which [`super::cast`] and [`super::packet`] share.
//!
//! The nearest child is searched first; the others wait on a stack in the order of their distances.

use super::ray_lanes::{LaneRay, RayPack};
use super::watertight::{ClippedRay, FaceHit, Ray};
use super::{Bvh, ChildRef, MAX_STACK, Node, WIDTH};
use crate::memory::prefetch;
use crate::mesh::Mesh;
use glam::DVec3;
use std::mem::MaybeUninit;

/// A ray prepared for a search: its part inside the box of the mesh, in float64 and in float32.
#[derive(Debug)]
pub(super) struct ReadyRay {
    clipped: ClippedRay,
    pub lanes: LaneRay,
}

impl ReadyRay {
    /// The limit of a search of the whole ray.
    #[inline(always)]
    pub(super) fn limit(&self) -> f32 {
        self.clipped.search_limit(f64::INFINITY)
    }
}

/// A mesh with the tables that rays need.
pub(super) struct RayTables<'a> {
    mesh: &'a Mesh,
    pub bvh: &'a Bvh,
    pub packs: &'a [RayPack],
    min: DVec3,
    max: DVec3,
}

impl<'a> RayTables<'a> {
    pub(super) fn new(mesh: &'a Mesh) -> Self {
        let bvh = mesh.bvh();
        let [min, max] = [bvh.bounds.min, bvh.bounds.max].map(|corner| corner.as_dvec3());
        Self { mesh, bvh, packs: &mesh.ray_packs().0, min, max }
    }

    /// None if the ray misses the box of the mesh.
    #[inline(always)]
    pub(super) fn ready(&self, ray: &Ray) -> Option<ReadyRay> {
        let clipped = ClippedRay::new(ray, self.min, self.max)?;
        let lanes = LaneRay::new(&clipped.sheared);
        Some(ReadyRay { clipped, lanes })
    }

    /// Searches the part of the tree below `start`. The limit is negative infinity once `accept` returned that.
    #[inline(always)]
    pub(super) fn search(
        &self,
        ray: &ReadyRay,
        start: ChildRef,
        limit: &mut f32,
        boxes: impl Fn(&LaneRay, &Node, f32) -> (u32, [f32; WIDTH]),
        triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
        accept: &mut impl FnMut(FaceHit) -> f64,
    ) {
        let mut stack = Stack::new();
        let mut child = start;
        loop {
            if child.is_pack() {
                self.search_pack(ray, child, limit, &triangles, accept);
                if *limit == f32::NEG_INFINITY {
                    return;
                }
            } else {
                let node = &self.bvh.nodes[child.index()];
                let (mask, entered) = boxes(&ray.lanes, node, *limit);
                if mask != 0 {
                    child = stack.push_all_but_nearest(mask, &entered, &node.children);
                    continue;
                }
            }
            child = match stack.pop(*limit) {
                Some(next) => next,
                None => return,
            };
        }
    }

    /// Tests the triangles of one pack.
    #[inline(always)]
    pub(super) fn search_pack(
        &self,
        ray: &ReadyRay,
        child: ChildRef,
        limit: &mut f32,
        triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
        accept: &mut impl FnMut(FaceHit) -> f64,
    ) {
        let pack = &self.packs[child.index()];
        let candidates = triangles(&ray.lanes, pack, *limit);
        self.decide(ray, pack, candidates, limit, accept);
    }

    /// The exact tests of the candidates of a pack, a mask of its lanes.
    #[inline(always)]
    pub(super) fn decide(
        &self,
        ray: &ReadyRay,
        pack: &RayPack,
        mut candidates: u32,
        limit: &mut f32,
        accept: &mut impl FnMut(FaceHit) -> f64,
    ) {
        while candidates != 0 {
            let lane = candidates.trailing_zeros() as usize % WIDTH;
            candidates &= candidates - 1;
            let corners = pack.vertices[lane].map(|vertex| self.mesh.exact_position(vertex));
            let Some(hit) = ray.clipped.hit(pack.faces[lane], corners) else { continue };
            *limit = limit.min(ray.clipped.search_limit(accept(hit)));
            if *limit == f32::NEG_INFINITY {
                return;
            }
        }
    }

    /// Brings a node or a pack into the cache.
    #[inline(always)]
    pub(super) fn prefetch(&self, child: ChildRef) {
        if child.is_pack() {
            prefetch(&self.packs[child.index()]);
        } else {
            prefetch(&self.bvh.nodes[child.index()]);
        }
    }

    /// Brings the corners of the candidates of a pack into the cache.
    #[inline(always)]
    pub(super) fn prefetch_corners(&self, pack: &RayPack, mut candidates: u32) {
        while candidates != 0 {
            let lane = candidates.trailing_zeros() as usize % WIDTH;
            candidates &= candidates - 1;
            pack.vertices[lane].iter().for_each(|&vertex| prefetch(&self.mesh.world_positions()[vertex as usize]));
        }
    }
}

/// Boxes that are still to be searched, with the t of entry, the nearest of each node on top.
///
/// The memory is not initialised, since that takes longer than a short search.
pub(super) struct Stack {
    slots: [MaybeUninit<(f32, ChildRef)>; MAX_STACK],
    /// Number of slots in use. All of them have been written.
    top: usize,
}

impl Stack {
    #[inline(always)]
    pub(super) const fn new() -> Self {
        Self { slots: [const { MaybeUninit::uninit() }; MAX_STACK], top: 0 }
    }

    #[inline(always)]
    fn push(&mut self, entry: (f32, ChildRef)) {
        self.slots[self.top].write(entry);
        self.top += 1;
    }

    /// The entry at an index; None from `top` on.
    #[inline(always)]
    fn at(&self, index: usize) -> Option<(f32, ChildRef)> {
        // SAFETY: every slot below `top` has been written, and the type has no destructor.
        (index < self.top).then(|| unsafe { self.slots[index].assume_init() })
    }

    /// The nearest child of a mask that is not zero; the others are pushed.
    #[inline(always)]
    pub(super) fn push_all_but_nearest(
        &mut self,
        mut mask: u32,
        entered: &[f32; WIDTH],
        children: &[ChildRef; WIDTH],
    ) -> ChildRef {
        let mut take = || {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            ((entered[lane], children[lane]), mask != 0)
        };
        let (mut nearest, mut more) = take();
        let bottom = self.top;
        while more {
            let next;
            (next, more) = take();
            // The nearer of the two stays out of the stack; the other one goes to its place.
            let farther = if next.0 < nearest.0 { std::mem::replace(&mut nearest, next) } else { next };
            let mut slot = self.top;
            self.push(farther);
            while slot > bottom && self.at(slot - 1).is_some_and(|above| above.0 < farther.0) {
                self.slots[slot] = self.slots[slot - 1];
                slot -= 1;
            }
            self.slots[slot].write(farther);
        }
        nearest.1
    }

    /// The next box that the ray enters before the limit.
    #[inline(always)]
    pub(super) fn pop(&mut self, limit: f32) -> Option<ChildRef> {
        while let Some((near, child)) = self.at(self.top.wrapping_sub(1)) {
            self.top -= 1;
            if near <= limit {
                return Some(child);
            }
        }
        None
    }
}
