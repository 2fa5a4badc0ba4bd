//! Rays against the tree: the first hit, any hit, or all of them, without a gap between faces that share an edge.
//!
//! *Theory.* Eight boxes, then eight triangles, are tested at a time in float32 ([`super::ray_lanes`]). These tests are
//! conservative: they never reject a hit. The candidates are decided in float64 ([`super::watertight`]), so the results
//! do not depend on the order of the search. Many rays are searched in packets of eight if they are near
//! each other ([`super::packet`]), else in turns ([`super::turns`]).
//!
//! The search starts where the ray enters the box of the mesh. Float32 then represents only the part of the ray inside
//! the box, at any distance of the origin.

#[cfg(target_arch = "x86_64")]
use super::packet;
use super::ray_group::RayGroup;
use super::ray_lanes::{LaneRay, RayPack};
use super::ray_search::{Collector, RayTables, ReadyRay};
use super::sorted_stack::SortedStack;
use super::turns;
use super::watertight::{ClippedRay, FaceHit, Ray};
use crate::bvh::{Bvh, Node, WIDTH};
#[cfg(target_arch = "x86_64")]
use crate::gpu::constants::cast_rays::{MISSED, UNSUITED};
use crate::gpu::layout::CastRay;
use crate::mesh::Mesh;
use crate::mesh::topology::Orientation;
use glam::DVec3;

/// Largest distance between the points that two faces compute for one hit on their common edge, local units: the
/// rounding of the weights (`watertight::CANCELLED`).
const SAME_POINT: f64 = 1e-12;
/// Ratio of the distance between two hits to the largest `t` above which they are not the same point.
const NEAR_HITS: f64 = 1e-9;

impl Mesh {
    /// The first hit of a ray that `accept` returns true for. Among equal distances the lowest face is returned.
    /// `accept` gets only hits that lie before the accepted ones.
    pub fn first_hit(&self, ray: &Ray, mut accept: impl FnMut(&FaceHit) -> bool) -> Option<FaceHit> {
        let mut best: Option<FaceHit> = None;
        self.traverse(ray, |hit| {
            if best.is_none_or(|best| is_before(&hit, &best)) && accept(&hit) {
                best = Some(hit);
            }
            best.map_or(f64::INFINITY, |best| best.t)
        });
        best
    }

    /// The intersection of a ray with one face, equal to the intersection of [`Mesh::first_hit`].
    pub fn hit_of_face(&self, face: u32, ray: &Ray) -> Option<FaceHit> {
        self.clipped(ray)?.hit(face, self.exact_triangle(face))
    }

    /// The part of a ray inside the box of the mesh.
    fn clipped(&self, ray: &Ray) -> Option<ClippedRay> {
        let bounds = self.bvh().bounds;
        ClippedRay::new(ray, bounds.min.as_dvec3(), bounds.max.as_dvec3())
    }

    /// A ray for a search on a device. Its limit is [`MISSED`] or [`UNSUITED`] if the device must not search it.
    pub(crate) fn device_ray(&self, ray: &Ray) -> CastRay {
        let without_search = |limit: f32| CastRay { limit, ..CastRay::default() };
        let Some(clipped) = self.clipped(ray) else { return without_search(MISSED) };
        clipped.for_device().unwrap_or_else(|| without_search(UNSUITED))
    }

    /// [`Mesh::first_hit`] of a ray that hits no other faces.
    pub(crate) fn first_hit_of_faces(&self, faces: &[u32], ray: &Ray) -> Option<FaceHit> {
        self.hits_of_faces(faces, ray).reduce(|best, hit| if is_before(&hit, &best) { hit } else { best })
    }

    /// [`Mesh::is_occluded`] of a ray that hits no other faces.
    pub(crate) fn is_occluded_by_faces(&self, faces: &[u32], ray: &Ray) -> bool {
        self.hits_of_faces(faces, ray).next().is_some()
    }

    /// [`Mesh::cast_all`] of a ray that hits no other faces.
    pub(crate) fn cast_at_faces(&self, faces: &[u32], ray: &Ray, hits: &mut Vec<FaceHit>) {
        hits.clear();
        hits.extend(self.hits_of_faces(faces, ray));
        self.sort_and_merge(hits);
    }

    fn hits_of_faces(&self, faces: &[u32], ray: &Ray) -> impl Iterator<Item = FaceHit> {
        let clipped = if faces.is_empty() { None } else { self.clipped(ray) };
        clipped
            .into_iter()
            .flat_map(move |clipped| faces.iter().filter_map(move |&face| clipped.hit(face, self.exact_triangle(face))))
    }

    /// Whether a ray hits anything.
    pub fn is_occluded(&self, ray: &Ray) -> bool {
        let mut found = false;
        self.traverse(ray, |_| {
            found = true;
            f64::NEG_INFINITY
        });
        found
    }

    /// [`Mesh::first_hit`] of many rays. `finish` receives the index of each ray and its hit, in no particular order.
    /// The results do not depend on `near`, see [`Mesh::traverse_many`].
    pub fn first_hits(&self, rays: impl Iterator<Item = Ray>, near: bool, finish: impl FnMut(usize, Option<FaceHit>)) {
        self.traverse_many(rays, near, FirstHits(finish));
    }

    /// [`Mesh::is_occluded`] of many rays. `finish` is called as by [`Mesh::first_hits`].
    pub fn are_occluded(&self, rays: impl Iterator<Item = Ray>, near: bool, finish: impl FnMut(usize, bool)) {
        self.traverse_many(rays, near, Occlusion(finish));
    }

    /// The winding number of a local point by one ray. The faces are wound as the topology oriented them. None if the
    /// ray passes through an edge or a vertex. The ray must not leave through an opening of the surface.
    pub fn winding_by_ray(&self, p: DVec3, direction: DVec3) -> Option<i32> {
        let (mut winding, mut on_edge) = (0, false);
        self.traverse(&Ray { origin: p, direction, t_min: 0.0, t_max: f64::INFINITY }, |hit| {
            on_edge |= hit.zeros != 0;
            let side = if hit.is_front { -1 } else { 1 };
            winding += match self.topology().orientation[hit.face as usize] {
                Orientation::Kept => side,
                Orientation::Flipped => -side,
                Orientation::Skipped => 0,
            };
            if on_edge { f64::NEG_INFINITY } else { f64::INFINITY }
        });
        (!on_edge).then_some(winding)
    }

    /// All intersections of a ray in order of `t`, then face. An edge or a vertex that several faces share counts once.
    pub fn cast_all(&self, ray: &Ray, hits: &mut Vec<FaceHit>) {
        hits.clear();
        self.traverse(ray, |hit| {
            hits.push(hit);
            f64::INFINITY
        });
        self.sort_and_merge(hits);
    }

    /// [`Mesh::cast_all`] of many rays.
    pub fn all_hits(&self, rays: impl ExactSizeIterator<Item = Ray>, near: bool, lists: &mut Vec<Vec<FaceHit>>) {
        lists.resize_with(rays.len(), Vec::new);
        lists.iter_mut().for_each(Vec::clear);
        self.traverse_many(rays, near, AllHits { mesh: self, lists });
    }

    /// Sorts the hits of a ray. Of several hits at one point of the edges or vertices of their faces the first one is
    /// kept: the faces share that edge or vertex, or only slivers lie between their edges.
    fn sort_and_merge(&self, hits: &mut Vec<FaceHit>) {
        hits.sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.face.cmp(&b.face)));
        let (Some(first), Some(last)) = (hits.first(), hits.last()) else { return };
        let reach = NEAR_HITS * first.t.abs().max(last.t.abs());
        if hits.windows(2).all(|pair| pair[1].t - pair[0].t > reach) {
            return;
        }
        let mut kept: Vec<DVec3> = Vec::new();
        hits.retain(|hit| {
            let Some(point) = self.boundary_point(hit) else { return true };
            let is_new = kept.iter().all(|other| point.distance(*other) > SAME_POINT);
            if is_new {
                kept.push(point);
            }
            is_new
        });
    }

    /// The point of a hit on the boundary of its face, local units; None inside the face.
    fn boundary_point(&self, hit: &FaceHit) -> Option<DVec3> {
        let [a, b, c] = self.exact_triangle(hit.face);
        let weights = hit.weights;
        // A weight times the double area is the length of the opposite edge times the distance from it.
        let area = hit.cross.length();
        let is_on = |i: usize, edge: DVec3| weights[i] * area <= SAME_POINT * edge.length();
        (is_on(0, c - b) || is_on(1, a - c) || is_on(2, b - a))
            .then(|| a * weights[0] + b * weights[1] + c * weights[2])
    }

    /// Passes every hit that may lie before the limit to `accept`, in no particular order. `accept` returns the new
    /// limit. The limits of the ray are exact.
    #[inline(always)]
    fn traverse(&self, ray: &Ray, mut accept: impl FnMut(FaceHit) -> f64) {
        let tables = RayTables::new(self);
        let Some(ready) = tables.ready(ray) else { return };
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(tables: &RayTables<'_>, ray: &ReadyRay, accept: &mut impl FnMut(FaceHit) -> f64) {
                let triangles = |lanes: &LaneRay, pack: &RayPack, limit: f32| lanes.triangles_avx2(pack, limit);
                let boxes = |lanes: &LaneRay, node: &Node, limit: f32| lanes.boxes_avx2(node, limit);
                tables.search(ray, Bvh::ROOT, &mut ray.limit(), boxes, triangles, accept);
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(&tables, &ready, &mut accept) };
            }
        }
        tables.search(&ready, Bvh::ROOT, &mut ready.limit(), LaneRay::boxes, LaneRay::triangles, &mut accept);
    }

    /// [`Mesh::traverse`] for many rays. Consecutive rays that are `near` each other share the upper part of their
    /// searches; other rays are searched in turns.
    #[inline(always)]
    fn traverse_many<K: Default>(
        &self,
        mut rays: impl Iterator<Item = Ray>,
        near: bool,
        mut collector: impl Collector<Kept = K>,
    ) {
        let tables = RayTables::new(self);
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide<K: Default>(
                tables: &RayTables<'_>,
                rays: &mut impl Iterator<Item = Ray>,
                near: bool,
                collector: &mut impl Collector<Kept = K>,
            ) {
                if !near {
                    let clip = |group: &mut RayGroup| group.clip_avx2(tables.min, tables.max);
                    let triangles = |lanes: &LaneRay, pack: &RayPack, limit: f32| lanes.triangles_avx2(pack, limit);
                    let push = |lanes: &LaneRay, node: &Node, limit: f32, stack: &mut SortedStack| {
                        lanes.push_boxes_avx2(node, limit, stack);
                    };
                    return turns::traverse(tables, rays, clip, push, triangles, collector);
                }
                let mut group = RayGroup::new();
                let mut kept: [K; WIDTH] = std::array::from_fn(|_| K::default());
                let mut first = 0;
                while group.fill(rays) {
                    group.clip_avx2(tables.min, tables.max);
                    packet::traverse(tables, &group, &mut |lane, hit| collector.accept(&mut kept[lane], hit));
                    for (lane, kept) in kept[..group.count].iter_mut().enumerate() {
                        collector.finish(first + lane, kept);
                    }
                    first += group.count;
                }
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(&tables, &mut rays, near, &mut collector) };
            }
        }
        if near {
            let mut kept = K::default();
            for (i, ray) in rays.enumerate() {
                self.traverse(&ray, |hit| collector.accept(&mut kept, hit));
                collector.finish(i, &mut kept);
            }
        } else {
            let clip = |group: &mut RayGroup| group.clip(tables.min, tables.max);
            turns::traverse(&tables, rays, clip, LaneRay::push_boxes, LaneRay::triangles, &mut collector);
        }
    }
}

/// Passes the first hit of each ray to a function.
struct FirstHits<F>(F);

impl<F: FnMut(usize, Option<FaceHit>)> Collector for FirstHits<F> {
    type Kept = Option<FaceHit>;

    #[inline(always)]
    fn accept(&mut self, best: &mut Option<FaceHit>, hit: FaceHit) -> f64 {
        match best {
            Some(best) if !is_before(&hit, best) => best.t,
            best => best.insert(hit).t,
        }
    }

    #[inline(always)]
    fn finish(&mut self, index: usize, best: &mut Option<FaceHit>) {
        (self.0)(index, best.take());
    }
}

/// Passes to a function whether each ray hits anything.
struct Occlusion<F>(F);

impl<F: FnMut(usize, bool)> Collector for Occlusion<F> {
    type Kept = bool;

    #[inline(always)]
    fn accept(&mut self, found: &mut bool, _: FaceHit) -> f64 {
        *found = true;
        f64::NEG_INFINITY
    }

    #[inline(always)]
    fn finish(&mut self, index: usize, found: &mut bool) {
        (self.0)(index, std::mem::take(found));
    }
}

/// Fills the list of each ray. The lists must be empty at first.
struct AllHits<'a> {
    mesh: &'a Mesh,
    lists: &'a mut [Vec<FaceHit>],
}

impl Collector for AllHits<'_> {
    type Kept = Vec<FaceHit>;

    #[inline(always)]
    fn accept(&mut self, hits: &mut Vec<FaceHit>, hit: FaceHit) -> f64 {
        hits.push(hit);
        f64::INFINITY
    }

    #[inline(always)]
    fn finish(&mut self, index: usize, hits: &mut Vec<FaceHit>) {
        self.mesh.sort_and_merge(hits);
        // The empty list takes the hits of a later ray.
        std::mem::swap(&mut self.lists[index], hits);
    }
}

/// Whether a hit precedes another one: it is nearer, or equally near with a lower face.
#[inline(always)]
fn is_before(hit: &FaceHit, other: &FaceHit) -> bool {
    hit.t < other.t || (hit.t == other.t && hit.face < other.face)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::{soup, uniform};
    use proptest::prelude::*;

    /// All intersections by Cramer's rule, sorted. None if one lies within 1e-9 of an edge.
    fn brute_force(mesh: &Mesh, ray: &Ray) -> Option<Vec<(f64, u32)>> {
        let mut found = Vec::new();
        for face in 0..mesh.faces().len() as u32 {
            let [a, b, c] = mesh.exact_triangle(face);
            let (e1, e2) = (b - a, c - a);
            let p = ray.direction.cross(e2);
            let (det, s) = (e1.dot(p), ray.origin - a);
            let (u, q) = (s.dot(p) / det, s.cross(e1));
            let (v, t) = (ray.direction.dot(q) / det, e2.dot(q) / det);
            let least = u.min(v).min(1.0 - u - v);
            if least.abs() < 1e-9 {
                return None;
            }
            if least > 0.0 && t >= ray.t_min && t <= ray.t_max {
                found.push((t, face));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        Some(found)
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        #[test]
        fn hits_are_those_of_brute_force(
            count in 1usize..300, seed in any::<u64>(), origin in vector(), target in vector(), far in 0.0..2.0f64,
            scale in -6.0..6.0f64, t_min in 0.0..0.8f64
        ) {
            let mesh = soup(count, 0.3, seed);
            let origin = origin * (1.0 + 10f64.powf(2.0 * far) - 1.0);
            let direction = (target * 0.4 - origin) * 10f64.powf(scale);
            let ray = Ray { origin, direction, t_min: t_min / 10f64.powf(scale), t_max: 2.0 / 10f64.powf(scale) };
            if let Some(expected) = brute_force(&mesh, &ray) {
                let mut found = Vec::new();
                mesh.cast_all(&ray, &mut found);
                prop_assert_eq!(found.len(), expected.len());
                for (hit, &(t, face)) in found.iter().zip(&expected) {
                    prop_assert_eq!(hit.face, face);
                    // Far origins round the position by 1e-16 of their distance. Slanted faces increase the error.
                    prop_assert!((hit.t - t).abs() <= 1e-8 * t.abs().max(ray.t_max), "{} {}", hit.t, t);
                }
                let first = mesh.first_hit(&ray, |_| true);
                prop_assert_eq!(first.map(|hit| hit.face), expected.first().map(|hit| hit.1));
                prop_assert_eq!(first.and_then(|hit| mesh.hit_of_face(hit.face, &ray)), first);
                let second = mesh.first_hit(&ray, |hit| first.is_some_and(|first| hit.face != first.face));
                prop_assert_eq!(second.map(|hit| hit.face), expected.get(1).map(|hit| hit.1));
                prop_assert_eq!(mesh.is_occluded(&ray), !expected.is_empty());
            }
        }

        /// The result does not depend on the number of lanes.
        #[test]
        fn every_path_gives_the_same_hits(seed in any::<u64>(), origin in vector(), direction in vector()) {
            let mesh = soup(200, 0.2, seed);
            let ray = Ray { origin, direction, t_min: 0.0, t_max: f64::INFINITY };
            let (mut wide, mut portable) = (Vec::new(), Vec::new());
            mesh.traverse(&ray, |hit| { wide.push(hit); f64::INFINITY });
            let tables = RayTables::new(&mesh);
            if let Some(ready) = tables.ready(&ray) {
                let mut accept = |hit| { portable.push(hit); f64::INFINITY };
                let mut limit = ready.limit();
                tables.search(&ready, Bvh::ROOT, &mut limit, LaneRay::boxes, LaneRay::triangles, &mut accept);
            }
            prop_assert_eq!(&wide, &portable);
            let mut in_turns = [Vec::new()];
            let mut collector = AllHits { mesh: &mesh, lists: &mut in_turns };
            let clip = |group: &mut RayGroup| group.clip(tables.min, tables.max);
            turns::traverse(&tables, [ray].into_iter(), clip, LaneRay::push_boxes, LaneRay::triangles, &mut collector);
            mesh.sort_and_merge(&mut portable);
            prop_assert_eq!(&in_turns[0], &portable);
        }
    }

    /// Rays in groups have the hits of single rays, if they are near each other and if they are not.
    #[test]
    fn groups_have_the_hits_of_single_rays() {
        let mesh = soup(3000, 0.1, 5);
        let [a, b, c] = mesh.exact_triangle(0);
        let centre = (a + b + c) / 3.0;
        let mut random = uniform(11);
        let mut vector = || DVec3::new(random(), random(), random()) - 0.5;
        for spread in [1e-3, 0.1, 2.0] {
            // Even rays run to the centre of the first triangle, and odd ones to places around it.
            let origin = 2.0 * vector();
            let rays: Vec<Ray> = (0..203)
                .map(|i| {
                    let origin = origin + spread * vector();
                    let target = if i % 2 == 0 { centre } else { centre + spread * vector() };
                    Ray {
                        origin,
                        direction: if i % 50 == 7 { DVec3::Y } else { target - origin },
                        t_min: 0.01 * f64::from(i % 3),
                        t_max: if i % 5 == 0 { 0.4 } else { f64::INFINITY },
                    }
                })
                .collect();
            let (mut hits, mut occluded, mut lists) = (vec![None; rays.len()], vec![false; rays.len()], Vec::new());
            for near in [false, true] {
                mesh.first_hits(rays.iter().copied(), near, |i, hit| hits[i] = hit);
                mesh.are_occluded(rays.iter().copied(), near, |i, found| occluded[i] = found);
                mesh.all_hits(rays.iter().copied(), near, &mut lists);
                // There are 102 even rays. The range of 21 of them, the multiples of ten, ends before the centre.
                assert!(hits.iter().flatten().count() >= 102 - 21);
                for (i, ray) in rays.iter().enumerate() {
                    assert_eq!(hits[i], mesh.first_hit(ray, |_| true));
                    assert_eq!(occluded[i], hits[i].is_some());
                    let mut list = Vec::new();
                    mesh.cast_all(ray, &mut list);
                    assert_eq!(lists[i], list);
                }
            }
        }
    }

    /// A cube of float32 corners, each side a lattice of `n` by `n` squares, with common vertices along the edges.
    fn cube(n: i64) -> Mesh {
        let mut vertices = Vec::new();
        let mut faces = Vec::new();
        for axis in 0..3usize {
            for side in [0.0, 1.0] {
                let first = vertices.len() as i64;
                for j in 0..=n {
                    for i in 0..=n {
                        let mut p = [0.0; 3];
                        p[axis] = side;
                        p[(axis + 1) % 3] = i as f64 / n as f64;
                        p[(axis + 2) % 3] = j as f64 / n as f64;
                        vertices.push(p);
                    }
                }
                for j in 0..n {
                    for i in 0..n {
                        let a = first + i + j * (n + 1);
                        let (b, c, d) = (a + 1, a + n + 2, a + n + 1);
                        let quad = if side == 1.0 { [[a, b, c], [a, c, d]] } else { [[a, c, b], [a, d, c]] };
                        faces.extend(quad);
                    }
                }
            }
        }
        Mesh::new(&vertices, &faces).unwrap()
    }

    /// From inside a closed surface there is exactly one intersection, also through edges and vertices.
    #[test]
    fn edges_and_vertices_count_once() {
        let mesh = cube(7);
        let mut hits = Vec::new();
        let mut random = uniform(3);
        for face in 0..mesh.faces().len() as u32 {
            let [a, b, c] = mesh.exact_triangle(face);
            for target in [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (a + c) * 0.5] {
                for origin in [DVec3::ZERO, DVec3::new(random(), random(), random()) * 0.4 - 0.2] {
                    let ray = Ray { origin, direction: target - origin, t_min: 0.0, t_max: f64::INFINITY };
                    mesh.cast_all(&ray, &mut hits);
                    assert_eq!(hits.len(), 1, "{origin} {target} {hits:?}");
                    assert!((hits[0].t - 1.0).abs() < 1e-12);
                }
            }
        }
    }
}
