//! Rays against the tree: the first hit, any hit, or all of them, without a gap between faces that share an edge.
//!
//! *Theory.* Eight boxes, then eight triangles, are tested at a time in float32 with bounds on the rounding. These
//! tests are conservative: they never reject a hit. The candidates are decided in float64 in a space that is sheared
//! along the ray (Woop, Benthin and Wald, *Watertight Ray/Triangle Intersection*, JCGT 2(1), 2013). The ray becomes the
//! point (0, 0) of a plane, a triangle is hit where its three edge functions have no two opposite signs, and both faces
//! of an edge evaluate the same function of the same two points. We add exact signs: a difference of two rounded
//! products has the right sign or is zero, and where it is zero the exact predicate of Shewchuk (crate `robust`)
//! decides. The projected surface is therefore continuous with exact answers: no ray passes between faces, and a hit
//! lies on an edge or a vertex if and only if the corresponding functions are zero.
//!
//! The search starts where the ray enters the box of the mesh. Float32 then represents only the part of the ray inside
//! the box, at any distance of the origin.

use super::{Bvh, ChildRef, MAX_STACK, Node, WIDTH};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::mesh::topology::Orientation;
use glam::DVec3;
use robust::{Coord, orient2d};

/// The intersection of a ray with a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceHit {
    /// Distance in multiples of the direction.
    pub t: f64,
    pub face: u32,
    /// Weights of the face's corners: not negative, their sum is 1.
    pub weights: [f64; 3],
    /// Bit i is set if the weight of corner i is exactly zero.
    pub zeros: u8,
    /// Whether the ray comes from the counter-clockwise side.
    pub is_front: bool,
}

/// The part of a line that is searched, `t` from `t_min` to `t_max` in multiples of the direction.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Origin in local units.
    pub origin: DVec3,
    pub direction: DVec3,
    pub t_min: f64,
    pub t_max: f64,
}

/// Corners of up to eight triangles side by side, in the order of the tree's packs.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
struct RayPack {
    /// Indexed by corner, axis and lane. Absent lanes hold points far outside the box.
    corners: [[[f32; WIDTH]; 3]; 3],
    faces: [u32; WIDTH],
}

/// Data that rays need besides the tree; 40 bytes per face.
#[derive(Debug)]
pub struct RayPacks(Vec<RayPack>);

/// Margin of the boxes, local units. Coordinates are below 1 and rounded to 6e-8, three times in a slab test.
const BOX_MARGIN: f32 = 1e-6;
/// Rounding error of a sheared float32 coordinate, local units. Vertices, origin, shear and four operations on values
/// below 2.2 are rounded to 6e-8 each. The float64 positions differ from the float32 ones by 3e-8.
const SHEAR_ROUNDING: f32 = 1e-6;
/// Rounding error of a product of two sheared coordinates, relative to the square of the largest: three roundings of
/// 6e-8.
const PRODUCT_ROUNDING: f32 = 3e-7;
/// Inverse of a zero component of the direction. It is large, and its products with local coordinates are finite.
const PARALLEL: f32 = 1e30;
/// Coordinates of absent lanes.
const ABSENT: f32 = 1e4;

impl Derived for RayPacks {
    fn derive(mesh: &Mesh) -> Self {
        let packs = mesh.bvh().packs.iter().map(|pack| {
            let mut corners = [[[ABSENT; WIDTH]; 3]; 3];
            let mut faces = [u32::MAX; WIDTH];
            for (lane, &face) in pack.faces().iter().enumerate() {
                faces[lane] = face;
                for (corner, &vertex) in mesh.faces()[face as usize].iter().enumerate() {
                    let position = mesh.positions()[vertex as usize];
                    for axis in 0..3 {
                        corners[corner][axis][lane] = position[axis];
                    }
                }
            }
            RayPack { corners, faces }
        });
        Self(packs.collect())
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

impl Mesh {
    /// Triangles packed for ray tests, built at the first call.
    pub fn ray_packs(&self) -> &RayPacks {
        self.derived()
    }

    /// Whether the packs for rays, the tree and the connectivity have been built.
    pub fn is_prepared_for_rays(&self) -> bool {
        self.is_prepared() && self.has_derived::<RayPacks>()
    }
}

impl Mesh {
    /// The first hit of a ray. Among equal distances the lowest face is returned.
    pub fn cast(&self, ray: &Ray) -> Option<FaceHit> {
        let mut best: Option<FaceHit> = None;
        self.traverse(ray, |hit| {
            if best.is_none_or(|best| hit.t < best.t || (hit.t == best.t && hit.face < best.face)) {
                best = Some(hit);
            }
            best.map_or(f64::INFINITY, |best| best.t)
        });
        best
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

    /// The winding number of a local point by one ray to the nearest side of the box. The faces are wound as the
    /// topology oriented them. None if the ray passes through an edge or a vertex. For closed surfaces.
    pub fn winding_by_ray(&self, p: DVec3) -> Option<i32> {
        let bounds = self.bvh().bounds;
        let (below, above) = (p - bounds.min.as_dvec3(), bounds.max.as_dvec3() - p);
        let mut direction = DVec3::X;
        let mut shortest = f64::INFINITY;
        for axis in 0..3 {
            for (way, towards) in [(below[axis], -1.0), (above[axis], 1.0)] {
                if way < shortest {
                    shortest = way;
                    direction = DVec3::ZERO;
                    direction[axis] = towards;
                }
            }
        }
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
        hits.sort_unstable_by(|a, b| a.t.total_cmp(&b.t).then(a.face.cmp(&b.face)));
        if hits.iter().filter(|hit| hit.zeros != 0).count() > 1 {
            let mut seen: Vec<[u32; 2]> = Vec::new();
            hits.retain(|hit| {
                let Some(shared) = self.shared_feature(hit) else { return true };
                let is_new = !seen.contains(&shared);
                if is_new {
                    seen.push(shared);
                }
                is_new
            });
        }
    }

    /// The welded ends of the edge that contains a hit; the same vertex twice for a vertex; None inside a face.
    fn shared_feature(&self, hit: &FaceHit) -> Option<[u32; 2]> {
        let corners = self.faces()[hit.face as usize].map(|v| self.topology().welded[v as usize]);
        let nonzero: Vec<u32> = (0..3).filter(|i| hit.zeros & (1 << i) == 0).map(|i| corners[i]).collect();
        match nonzero[..] {
            [vertex] => Some([vertex, vertex]),
            [a, b] => Some([a.min(b), a.max(b)]),
            _ => None,
        }
    }

    /// Passes every hit that may lie before the limit to `accept`, in no particular order. `accept` returns the new
    /// limit. The limits of the ray are exact.
    #[inline(always)]
    fn traverse(&self, ray: &Ray, accept: impl FnMut(FaceHit) -> f64) {
        #[cfg(target_arch = "x86_64")]
        {
            #[target_feature(enable = "avx2")]
            fn wide(mesh: &Mesh, ray: &Ray, accept: impl FnMut(FaceHit) -> f64) {
                let boxes = |lanes: &LaneRay, node: &Node, limit: f32| lanes.boxes_avx2(node, limit);
                let triangles = |lanes: &LaneRay, pack: &RayPack, limit: f32| lanes.triangles_avx2(pack, limit);
                mesh.traverse_by(ray, boxes, triangles, accept);
            }
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has AVX2.
                return unsafe { wide(self, ray, accept) };
            }
        }
        self.traverse_by(ray, LaneRay::boxes, LaneRay::triangles, accept);
    }

    #[inline(always)]
    fn traverse_by(
        &self,
        ray: &Ray,
        boxes: impl Fn(&LaneRay, &Node, f32) -> (u32, [f32; WIDTH]),
        triangles: impl Fn(&LaneRay, &RayPack, f32) -> u32,
        mut accept: impl FnMut(FaceHit) -> f64,
    ) {
        let bvh = self.bvh();
        let packs = &self.ray_packs().0;
        let (enter, leave) = slab(ray, bvh.bounds.min.as_dvec3(), bvh.bounds.max.as_dvec3());
        let (t_start, t_end) = (enter.max(ray.t_min), leave.min(ray.t_max));
        if t_start > t_end {
            return;
        }
        // The direction is scaled so that its largest component is 1.
        let size = ray.direction.abs().max_element();
        let sheared = Sheared::new(ray.origin + t_start * ray.direction, ray.direction / size);
        let lanes = LaneRay::new(&sheared);
        // Limit of the search in the scaled direction.
        let mut limit = single_above((t_end - t_start) * size);
        let mut stack = [(0.0f32, ChildRef::NONE); MAX_STACK];
        let mut top = 0;
        let mut next = (0.0f32, Bvh::ROOT);
        loop {
            let (near, child) = next;
            if near <= limit {
                if child.is_pack() {
                    let pack = &packs[child.index()];
                    let mut mask = triangles(&lanes, pack, limit);
                    while mask != 0 {
                        let face = pack.faces[mask.trailing_zeros() as usize];
                        mask &= mask - 1;
                        let Some(hit) = sheared.hit(self.exact_triangle(face)) else { continue };
                        let t = t_start + hit.t / size;
                        if t >= ray.t_min && t <= ray.t_max {
                            let t_limit = accept(FaceHit { t, face, ..hit });
                            if t_limit == f64::NEG_INFINITY {
                                return;
                            }
                            limit = limit.min(single_above((t_limit - t_start) * size));
                        }
                    }
                } else {
                    let node = &bvh.nodes[child.index()];
                    let (mut mask, entered) = boxes(&lanes, node, limit);
                    if mask != 0 {
                        let bottom = top;
                        while mask != 0 {
                            let lane = mask.trailing_zeros() as usize;
                            mask &= mask - 1;
                            let mut slot = top;
                            while slot > bottom && stack[slot - 1].0 < entered[lane] {
                                stack[slot] = stack[slot - 1];
                                slot -= 1;
                            }
                            stack[slot] = (entered[lane], node.children[lane]);
                            top += 1;
                        }
                    }
                }
            }
            if top == 0 {
                return;
            }
            top -= 1;
            next = stack[top];
        }
    }
}

/// A float32 value that is not below `x`, with slack for the rounding of the values compared with it.
fn single_above(x: f64) -> f32 {
    x as f32 * 1.000_001 + 2.0 * BOX_MARGIN
}

/// The interval of a line inside a slightly enlarged box. The second value is below the first if the line misses.
fn slab(ray: &Ray, min: DVec3, max: DVec3) -> (f64, f64) {
    let margin = 2.0 * f64::from(BOX_MARGIN);
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (min[axis] - margin - ray.origin[axis], max[axis] + margin - ray.origin[axis]);
        if ray.direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return (f64::INFINITY, f64::NEG_INFINITY);
            }
            continue;
        }
        let (a, b) = (low / ray.direction[axis], high / ray.direction[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    // For origins far away the ends are rounded by more than the margin.
    let room = 1e-14 * enter.abs().max(leave.abs());
    (enter - room, leave + room)
}

/// A float64 ray in coordinates whose z axis is the ray.
struct Sheared {
    origin: DVec3,
    direction: DVec3,
    axes: [usize; 3],
    shear: [f64; 3],
}

impl Sheared {
    /// The largest component of `direction` must be 1 or -1.
    fn new(origin: DVec3, direction: DVec3) -> Self {
        let magnitude = direction.abs();
        let z = (1..3).fold(0, |best, axis| if magnitude[axis] > magnitude[best] { axis } else { best });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        // Two axes are exchanged for a negative direction, which keeps the winding.
        let (x, y) = if direction[z] < 0.0 { (y, x) } else { (x, y) };
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        Self { origin, direction, axes: [x, y, z], shear }
    }

    /// The hit of a triangle; `t` is in the scaled direction, and the face is not set yet.
    #[inline]
    fn hit(&self, corners: [DVec3; 3]) -> Option<FaceHit> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let p = corner - self.origin;
            [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], p[z]]
        });
        let edges = [edge_function(c, b), edge_function(a, c), edge_function(b, a)];
        let (mut positive, mut negative, mut zeros) = (false, false, 0u8);
        for (i, &edge) in edges.iter().enumerate() {
            positive |= edge > 0.0;
            negative |= edge < 0.0;
            zeros |= u8::from(edge == 0.0) << i;
        }
        let sum = edges[0] + edges[1] + edges[2];
        // A triangle parallel to the ray has no inside. Its neighbours are hit at the common edges.
        if (positive && negative) || sum == 0.0 {
            return None;
        }
        let weights = edges.map(|edge| edge / sum);
        let t = self.shear[2] * (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]);
        Some(FaceHit { t, face: 0, weights, zeros, is_front: sum > 0.0 })
    }
}

/// Twice the signed area of the triangle (0, 0), p, q; zero only where it is exactly zero.
#[inline(always)]
fn edge_function(p: [f64; 3], q: [f64; 3]) -> f64 {
    let difference = p[0] * q[1] - p[1] * q[0];
    if difference != 0.0 { difference } else { exact_edge_function(p, q) }
}

#[cold]
fn exact_edge_function(p: [f64; 3], q: [f64; 3]) -> f64 {
    let at = |p: [f64; 3]| Coord { x: p[0], y: p[1] };
    orient2d(at(p), at(q), Coord { x: 0.0, y: 0.0 })
}

/// A float32 ray for tests of eight boxes or triangles.
struct LaneRay {
    /// Origin moved by the margin of the boxes, for the sides that the ray enters and leaves through.
    enter_origin: [f32; 3],
    leave_origin: [f32; 3],
    inverse: [f32; 3],
    negative: [bool; 3],
    /// Origin for triangles, by sheared axis.
    origin: [f32; 3],
    shear: [f32; 2],
    axes: [usize; 3],
    /// 1 or -1. `t` is the sheared z times this.
    ahead: f32,
}

impl LaneRay {
    fn new(sheared: &Sheared) -> Self {
        let origin = sheared.origin.as_vec3().to_array();
        let direction = sheared.direction.as_vec3().to_array();
        let negative = direction.map(|d| d < 0.0);
        let inverse = direction.map(|d| if d.abs() < 1.0 / PARALLEL { PARALLEL } else { 1.0 / d });
        let margin = negative.map(|negative| if negative { -BOX_MARGIN } else { BOX_MARGIN });
        Self {
            enter_origin: [0, 1, 2].map(|axis| origin[axis] + margin[axis]),
            leave_origin: [0, 1, 2].map(|axis| origin[axis] - margin[axis]),
            inverse,
            negative,
            origin: sheared.axes.map(|axis| origin[axis]),
            shear: [sheared.shear[0] as f32, sheared.shear[1] as f32],
            axes: sheared.axes,
            ahead: sheared.shear[2] as f32,
        }
    }

    /// Mask of the lanes whose box the ray enters before `limit`, and the t of entry.
    #[inline(always)]
    fn boxes(&self, node: &Node, limit: f32) -> (u32, [f32; WIDTH]) {
        let mut entered = [0.0f32; WIDTH];
        let mut mask = 0;
        for lane in 0..WIDTH {
            let (mut enter, mut leave) = (0.0f32, limit);
            for axis in 0..3 {
                let (low, high) = (node.min[axis][lane], node.max[axis][lane]);
                let (near, far) = if self.negative[axis] { (high, low) } else { (low, high) };
                let near = (near - self.enter_origin[axis]) * self.inverse[axis];
                let far = (far - self.leave_origin[axis]) * self.inverse[axis];
                enter = if near > enter { near } else { enter };
                leave = if far < leave { far } else { leave };
            }
            // A relative margin of 1e-6 covers the rounding of the products.
            entered[lane] = enter;
            mask |= u32::from(enter <= leave * 1.000_001) << lane;
        }
        (mask, entered)
    }

    /// Mask of the lanes whose triangle the ray may hit before `limit`.
    #[inline(always)]
    fn triangles(&self, pack: &RayPack, limit: f32) -> u32 {
        let [kx, ky, kz] = self.axes;
        let mut mask = 0;
        for lane in 0..WIDTH {
            let [a, b, c] = [0, 1, 2].map(|corner| {
                let rows = &pack.corners[corner];
                let z = rows[kz][lane] - self.origin[2];
                let x = rows[kx][lane] - self.origin[0] - self.shear[0] * z;
                let y = rows[ky][lane] - self.origin[1] - self.shear[1] * z;
                [x, y, z * self.ahead]
            });
            let u = c[0] * b[1] - c[1] * b[0];
            let v = a[0] * c[1] - a[1] * c[0];
            let w = b[0] * a[1] - b[1] * a[0];
            let magnitude = [a, b, c].iter().fold(0.0f32, |m, p| m.max(p[0].abs()).max(p[1].abs()));
            let slack = magnitude * (4.0 * SHEAR_ROUNDING + PRODUCT_ROUNDING * magnitude);
            let (least, most) = (u.min(v).min(w), u.max(v).max(w));
            let (first, last) = (a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2]));
            let may_hit = (least >= -slack || most <= slack) && first <= limit && last >= -2.0 * BOX_MARGIN;
            mask |= u32::from(may_hit) << lane;
        }
        mask
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{BOX_MARGIN, LaneRay, PRODUCT_ROUNDING, RayPack, SHEAR_ROUNDING, WIDTH};
    use crate::bvh::Node;
    use std::arch::x86_64::*;

    /// Loads eight values of an array into a register. It is a macro, because a closure or a generic function would be
    /// compiled without wide registers and return its result through memory.
    macro_rules! row {
        ($lanes:expr) => {{
            let lanes: &[f32; WIDTH] = &$lanes;
            // SAFETY: the array has eight floats, and the load needs no alignment.
            unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
        }};
    }

    /// One corner of eight triangles in the sheared space of a ray.
    macro_rules! sheared {
        ($rows:expr, $axes:expr, $origin:expr, $shear:expr, $ahead:expr) => {{
            let z = _mm256_sub_ps(row!($rows[$axes[2]]), $origin[2]);
            let x = _mm256_sub_ps(row!($rows[$axes[0]]), $origin[0]);
            let y = _mm256_sub_ps(row!($rows[$axes[1]]), $origin[1]);
            [
                _mm256_sub_ps(x, _mm256_mul_ps($shear[0], z)),
                _mm256_sub_ps(y, _mm256_mul_ps($shear[1], z)),
                _mm256_mul_ps(z, $ahead),
            ]
        }};
    }

    macro_rules! cross {
        ($p:expr, $q:expr) => {
            _mm256_sub_ps(_mm256_mul_ps($p[0], $q[1]), _mm256_mul_ps($p[1], $q[0]))
        };
    }

    impl LaneRay {
        /// [`LaneRay::boxes`] in eight lanes: the same operations, the same bits.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub fn boxes_avx2(&self, node: &Node, limit: f32) -> (u32, [f32; WIDTH]) {
            let mut enter = _mm256_setzero_ps();
            let mut leave = _mm256_set1_ps(limit);
            for axis in 0..3 {
                let (low, high) = (&node.min[axis], &node.max[axis]);
                let (near, far) = if self.negative[axis] { (high, low) } else { (low, high) };
                let inverse = _mm256_set1_ps(self.inverse[axis]);
                let near = _mm256_mul_ps(_mm256_sub_ps(row!(*near), _mm256_set1_ps(self.enter_origin[axis])), inverse);
                let far = _mm256_mul_ps(_mm256_sub_ps(row!(*far), _mm256_set1_ps(self.leave_origin[axis])), inverse);
                enter = _mm256_max_ps(near, enter);
                leave = _mm256_min_ps(far, leave);
            }
            let leave = _mm256_mul_ps(leave, _mm256_set1_ps(1.000_001));
            let mask = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave));
            let mut entered = [0.0f32; WIDTH];
            // SAFETY: the array has eight floats, and the store needs no alignment.
            unsafe { _mm256_storeu_ps(entered.as_mut_ptr(), enter) };
            (mask as u32, entered)
        }

        /// [`LaneRay::triangles`] in eight lanes: the same operations, the same bits.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub fn triangles_avx2(&self, pack: &RayPack, limit: f32) -> u32 {
            let [ox, oy, oz] = self.origin;
            let origin = [_mm256_set1_ps(ox), _mm256_set1_ps(oy), _mm256_set1_ps(oz)];
            let shear = [_mm256_set1_ps(self.shear[0]), _mm256_set1_ps(self.shear[1])];
            let ahead = _mm256_set1_ps(self.ahead);
            let a = sheared!(pack.corners[0], self.axes, origin, shear, ahead);
            let b = sheared!(pack.corners[1], self.axes, origin, shear, ahead);
            let c = sheared!(pack.corners[2], self.axes, origin, shear, ahead);
            let (u, v, w) = (cross!(c, b), cross!(a, c), cross!(b, a));
            let sign = _mm256_set1_ps(-0.0);
            let mut magnitude = _mm256_setzero_ps();
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, a[0]), magnitude);
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, a[1]), magnitude);
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, b[0]), magnitude);
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, b[1]), magnitude);
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, c[0]), magnitude);
            magnitude = _mm256_max_ps(_mm256_andnot_ps(sign, c[1]), magnitude);
            let relative = _mm256_mul_ps(_mm256_set1_ps(PRODUCT_ROUNDING), magnitude);
            let slack = _mm256_mul_ps(magnitude, _mm256_add_ps(_mm256_set1_ps(4.0 * SHEAR_ROUNDING), relative));
            let least = _mm256_min_ps(_mm256_min_ps(u, v), w);
            let most = _mm256_max_ps(_mm256_max_ps(u, v), w);
            let first = _mm256_min_ps(_mm256_min_ps(a[2], b[2]), c[2]);
            let last = _mm256_max_ps(_mm256_max_ps(a[2], b[2]), c[2]);
            let below = _mm256_cmp_ps::<_CMP_GE_OQ>(least, _mm256_xor_ps(slack, sign));
            let above = _mm256_cmp_ps::<_CMP_LE_OQ>(most, slack);
            let before = _mm256_cmp_ps::<_CMP_LE_OQ>(first, _mm256_set1_ps(limit));
            let behind = _mm256_cmp_ps::<_CMP_GE_OQ>(last, _mm256_set1_ps(-2.0 * BOX_MARGIN));
            let may_hit = _mm256_and_ps(_mm256_or_ps(below, above), _mm256_and_ps(before, behind));
            _mm256_movemask_ps(may_hit) as u32
        }
    }
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
                prop_assert_eq!(mesh.cast(&ray).map(|hit| hit.face), expected.first().map(|hit| hit.1));
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
            mesh.traverse_by(&ray, LaneRay::boxes, LaneRay::triangles, |hit| { portable.push(hit); f64::INFINITY });
            prop_assert_eq!(wide, portable);
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
