//! The search of the tree by one ray, which [`super::cast`] and [`super::packet`] share.

use super::ray_lanes::{LaneRay, RayPack};
use super::watertight::{Clip, ClippedRay, FaceHit, Ray};
use crate::bvh::stack::Stack;
use crate::bvh::{Bvh, ChildRef, Node, WIDTH};
use crate::memory::prefetch;
use crate::mesh::Mesh;
use glam::DVec3;

/// A ray prepared for a search: its part inside the box of the mesh, in float64 and in float32.
#[derive(Debug)]
pub(crate) struct ReadyRay {
    clipped: ClippedRay,
    pub lanes: LaneRay,
}

/// The result of many rays.
pub(crate) trait Collector {
    /// State of one ray during its search.
    type Kept;

    /// Adds a hit, and returns the new limit of the ray; see `Mesh::traverse`.
    fn accept(&mut self, kept: &mut Self::Kept, hit: FaceHit) -> f64;

    /// Receives the index of a ray after its search, and resets what was kept.
    fn finish(&mut self, index: usize, kept: &mut Self::Kept);
}

impl ReadyRay {
    #[inline(always)]
    pub(crate) fn new(ray: &Ray, clip: &Clip) -> Self {
        let clipped = ClippedRay::from_clip(ray, clip);
        let lanes = LaneRay::new(&clipped.sheared);
        Self { clipped, lanes }
    }

    /// The limit of a search of the whole ray.
    #[inline(always)]
    pub(crate) fn limit(&self) -> f32 {
        self.clipped.search_limit(f64::INFINITY)
    }
}

/// A mesh with the tables that rays need.
pub(crate) struct RayTables<'a> {
    mesh: &'a Mesh,
    pub bvh: &'a Bvh,
    pub packs: &'a [RayPack],
    /// The box of the mesh.
    pub min: DVec3,
    pub max: DVec3,
}

impl<'a> RayTables<'a> {
    pub(crate) fn new(mesh: &'a Mesh) -> Self {
        let bvh = mesh.bvh();
        let [min, max] = [bvh.bounds.min, bvh.bounds.max].map(|corner| corner.as_dvec3());
        Self { mesh, bvh, packs: &mesh.ray_packs().0, min, max }
    }

    /// None if the ray misses the box of the mesh.
    #[inline(always)]
    pub(crate) fn ready(&self, ray: &Ray) -> Option<ReadyRay> {
        Clip::of(ray, self.min, self.max).map(|clip| ReadyRay::new(ray, &clip))
    }

    /// Searches the part of the tree below `start`. The limit is negative infinity once `accept` returned that.
    #[inline(always)]
    pub(crate) fn search(
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
    pub(crate) fn search_pack(
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
    pub(crate) fn decide(
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

    /// Brings the corners of the candidates of a pack into the cache.
    #[inline(always)]
    pub(crate) fn prefetch_corners(&self, pack: &RayPack, mut candidates: u32) {
        while candidates != 0 {
            let lane = candidates.trailing_zeros() as usize % WIDTH;
            candidates &= candidates - 1;
            pack.vertices[lane].iter().for_each(|&vertex| prefetch(&self.mesh.world_positions()[vertex as usize]));
        }
    }
}
