//! Conservative float32 tests of a ray against eight boxes or eight triangles.
//!
//! The tests allow for the rounding of their own operations, so that they never reject a hit. The portable functions
//! and the AVX2 functions apply the same operations in the same order and give the same bits.

use super::sorted_stack::SortedStack;
use super::watertight::{BOX_MARGIN, PARALLEL, Sheared};
use crate::bvh::{Node, WIDTH};
use crate::gpu::constants::cast_rays::SHEAR_ROUNDING;
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use glam::DVec3;

/// Corners of up to eight triangles side by side, in the order of the tree's packs.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
pub struct RayPack {
    /// Indexed by corner, axis and lane. Absent lanes hold points far outside the box.
    corners: [[[f32; WIDTH]; 3]; 3],
    pub faces: [u32; WIDTH],
    /// Corners of the faces as vertices of the mesh. An absent lane has `[0; 3]`, a triangle without area, so the exact
    /// test rejects it.
    pub vertices: [[u32; 3]; WIDTH],
}

/// Data that rays need besides the tree; 52 bytes per face.
#[derive(Debug)]
pub struct RayPacks(pub Vec<RayPack>);

impl Derived for RayPacks {
    fn derive(mesh: &Mesh) -> Self {
        let packs = mesh.bvh().packs.iter().map(|pack| {
            let mut corners = [[[ABSENT; WIDTH]; 3]; 3];
            let mut faces = [u32::MAX; WIDTH];
            let mut vertices = [[0; 3]; WIDTH];
            for (lane, &face) in pack.faces().iter().enumerate() {
                faces[lane] = face;
                vertices[lane] = mesh.faces()[face as usize];
                for (corner, &vertex) in mesh.faces()[face as usize].iter().enumerate() {
                    let position = mesh.positions()[vertex as usize];
                    for axis in 0..3 {
                        corners[corner][axis][lane] = position[axis];
                    }
                }
            }
            RayPack { corners, faces, vertices }
        });
        Self(packs.collect())
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

/// Rounding error of a product of two sheared coordinates, relative to the square of the largest: three roundings of
/// 6e-8.
const PRODUCT_ROUNDING: f32 = 3e-7;
/// Coordinates of absent lanes.
const ABSENT: f32 = 1e4;

/// A float32 ray for tests of eight boxes or triangles.
#[derive(Debug)]
pub(crate) struct LaneRay {
    /// Origin moved by the margin of the boxes, for the sides that the ray enters and leaves through.
    enter_origin: [f32; 3],
    leave_origin: [f32; 3],
    inverse: [f32; 3],
    /// Rows of a node's boxes with the sides that the ray enters and leaves through: 0 to 2 are the lower sides, 3 to 5
    /// the upper ones.
    near: [usize; 3],
    far: [usize; 3],
    /// Origin for triangles, by sheared axis.
    origin: [f32; 3],
    shear: [f32; 2],
    axes: [usize; 3],
    /// 1 or -1. `t` is the sheared z times this.
    ahead: f32,
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

impl LaneRay {
    #[inline(always)]
    pub(crate) fn new(sheared: &Sheared) -> Self {
        let (position, [x, y, z]) = (sheared.origin.as_vec3().to_array(), sheared.axes);
        let mut ray = Self {
            enter_origin: position,
            leave_origin: position,
            inverse: sheared.inverse.clamp(DVec3::splat(-PARALLEL), DVec3::splat(PARALLEL)).as_vec3().to_array(),
            near: [0, 1, 2],
            far: [3, 4, 5],
            origin: [position[x], position[y], position[z]],
            shear: [sheared.shear[0] as f32, sheared.shear[1] as f32],
            axes: sheared.axes,
            ahead: sheared.shear[2] as f32,
        };
        for axis in 0..3 {
            let negative = ray.inverse[axis] < 0.0;
            let margin = if negative { -BOX_MARGIN } else { BOX_MARGIN };
            ray.enter_origin[axis] += margin;
            ray.leave_origin[axis] -= margin;
            if negative {
                (ray.near[axis], ray.far[axis]) = (3 + axis, axis);
            }
        }
        ray
    }

    /// The origin moved by the margin of the boxes for their lower and upper sides, and the inverse of the direction.
    #[cfg(all(test, target_arch = "x86_64"))]
    pub(crate) fn slabs(&self) -> [[f32; 3]; 3] {
        let ahead = |axis: usize| self.near[axis] < 3;
        let side = |lower: bool| {
            std::array::from_fn(|i| if ahead(i) == lower { self.enter_origin[i] } else { self.leave_origin[i] })
        };
        [side(true), side(false), self.inverse]
    }

    /// Mask of the lanes whose box the ray enters before `limit`, and the t of entry.
    #[inline(always)]
    pub(crate) fn boxes(&self, node: &Node, limit: f32) -> (u32, [f32; WIDTH]) {
        let mut entered = [0.0f32; WIDTH];
        let mut mask = 0;
        for lane in 0..WIDTH {
            let (mut enter, mut leave) = (0.0f32, limit);
            for axis in 0..3 {
                let (low, high) = (node.min[axis][lane], node.max[axis][lane]);
                let (near, far) = if self.near[axis] > 2 { (high, low) } else { (low, high) };
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

    /// Adds the children whose box the ray enters before `limit` to a stack.
    #[inline(always)]
    pub(crate) fn push_boxes(&self, node: &Node, limit: f32, stack: &mut SortedStack) {
        let (mask, entered) = self.boxes(node, limit);
        stack.push(mask, &entered, &node.children);
    }

    /// Mask of the lanes whose triangle the ray may hit before `limit`.
    #[inline(always)]
    pub(crate) fn triangles(&self, pack: &RayPack, limit: f32) -> u32 {
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
    use super::{BOX_MARGIN, LaneRay, Node, PRODUCT_ROUNDING, RayPack, SHEAR_ROUNDING, SortedStack, WIDTH};
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
        pub(in crate::bvh) fn boxes_avx2(&self, node: &Node, limit: f32) -> (u32, [f32; WIDTH]) {
            let (found, enter) = self.enter_boxes(node, limit);
            let mut entered = [0.0f32; WIDTH];
            // SAFETY: the array has eight floats, and the store needs no alignment.
            unsafe { _mm256_storeu_ps(entered.as_mut_ptr(), enter) };
            (_mm256_movemask_ps(found) as u32, entered)
        }

        /// [`LaneRay::push_boxes`] in eight lanes.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub(in crate::bvh) fn push_boxes_avx2(&self, node: &Node, limit: f32, stack: &mut SortedStack) {
            let (found, enter) = self.enter_boxes(node, limit);
            stack.push_avx2(found, enter, &node.children);
        }

        /// All bits of the lanes whose box the ray enters before `limit`, and the t of entry.
        #[inline]
        #[target_feature(enable = "avx2")]
        fn enter_boxes(&self, node: &Node, limit: f32) -> (__m256, __m256) {
            let rows = node.rows();
            let mut enter = _mm256_setzero_ps();
            let mut leave = _mm256_set1_ps(limit);
            for axis in 0..3 {
                let inverse = _mm256_set1_ps(self.inverse[axis]);
                let (near, far) = (row!(rows[self.near[axis]]), row!(rows[self.far[axis]]));
                let near = _mm256_mul_ps(_mm256_sub_ps(near, _mm256_set1_ps(self.enter_origin[axis])), inverse);
                let far = _mm256_mul_ps(_mm256_sub_ps(far, _mm256_set1_ps(self.leave_origin[axis])), inverse);
                enter = _mm256_max_ps(near, enter);
                leave = _mm256_min_ps(far, leave);
            }
            let leave = _mm256_mul_ps(leave, _mm256_set1_ps(1.000_001));
            (_mm256_cmp_ps::<_CMP_LE_OQ>(enter, leave), enter)
        }

        /// [`LaneRay::triangles`] in eight lanes: the same operations, the same bits.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub(in crate::bvh) fn triangles_avx2(&self, pack: &RayPack, limit: f32) -> u32 {
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
