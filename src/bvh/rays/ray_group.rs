//! Eight consecutive rays, prepared side by side for a search.
//!
//! Many rays of a picture miss the mesh or its triangles. Their preparation therefore takes as long as their search,
//! and the AVX2 functions prepare four rays at a time. They apply the operations of [`Clip::of`] and give the same
//! bits.

use super::ray_search::ReadyRay;
use super::watertight::{Clip, Ray};
use crate::bvh::WIDTH;
use glam::DVec3;

/// Up to eight rays and their parts inside the box of a mesh.
pub(crate) struct RayGroup {
    rays: [Ray; WIDTH],
    /// Number of rays.
    pub count: usize,
    /// Mask of the rays that reach the box.
    pub mask: u32,
    clips: [Clip; WIDTH],
    /// The rays for tests of one box against all of them.
    #[cfg(target_arch = "x86_64")]
    pub slabs: Slabs,
}

/// Eight float32 rays for the test of one box, indexed by axis and ray.
#[cfg(target_arch = "x86_64")]
#[derive(Default)]
pub(crate) struct Slabs {
    /// Origins moved by the margin of the boxes, for the lower and the upper sides.
    pub low: [[f32; WIDTH]; 3],
    pub high: [[f32; WIDTH]; 3],
    pub inverse: [[f32; WIDTH]; 3],
    /// Limits of searches of the whole rays.
    pub limits: [f32; WIDTH],
}

impl RayGroup {
    pub(crate) fn new() -> Self {
        let nowhere = Ray { origin: DVec3::ZERO, direction: DVec3::X, t_min: 0.0, t_max: 0.0 };
        Self {
            rays: [nowhere; WIDTH],
            count: 0,
            mask: 0,
            clips: [Clip::default(); WIDTH],
            #[cfg(target_arch = "x86_64")]
            slabs: Slabs::default(),
        }
    }

    /// Takes the next rays. Returns false if there are none. They have to be clipped next.
    #[inline(always)]
    pub(crate) fn fill(&mut self, rays: &mut impl Iterator<Item = Ray>) -> bool {
        self.count = 0;
        for (slot, ray) in self.rays.iter_mut().zip(rays) {
            *slot = ray;
            self.count += 1;
        }
        self.count > 0
    }

    /// The ray of a lane of the mask, prepared for tests of its own.
    #[inline(always)]
    pub(crate) fn ready(&self, lane: usize) -> ReadyRay {
        ReadyRay::new(&self.rays[lane], &self.clips[lane])
    }

    /// Clips the rays to a box.
    #[inline(always)]
    pub(crate) fn clip(&mut self, min: DVec3, max: DVec3) {
        self.mask = 0;
        for lane in 0..self.count {
            if let Some(clip) = Clip::of(&self.rays[lane], min, max) {
                self.clips[lane] = clip;
                self.mask |= 1 << lane;
            }
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{DVec3, RayGroup, WIDTH};
    use crate::bvh::rays::watertight::{BOX_MARGIN, FAR_MARGIN, PARALLEL};
    use std::arch::x86_64::*;

    /// Number of float64 lanes of a register.
    const HALF: usize = WIDTH / 2;

    /// A component of four rays. It is a macro, because a field cannot be an argument of a function.
    macro_rules! column {
        ($rays:expr, $($field:tt)+) => {
            _mm256_set_pd($rays[3].$($field)+, $rays[2].$($field)+, $rays[1].$($field)+, $rays[0].$($field)+)
        };
    }

    /// Writes a component of four clips.
    macro_rules! store {
        ($clips:expr, $value:expr, $($field:tt)+) => {{
            let mut row = [0.0; HALF];
            // SAFETY: the array has four doubles, and the store needs no alignment.
            unsafe { _mm256_storeu_pd(row.as_mut_ptr(), $value) };
            for lane in 0..HALF {
                $clips[lane].$($field)+ = row[lane];
            }
        }};
    }

    impl RayGroup {
        /// [`RayGroup::clip`] and the slabs: the same operations, the same bits.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub(in crate::bvh) fn clip_avx2(&mut self, min: DVec3, max: DVec3) {
            self.mask = self.clip_half(0, min, max) | self.clip_half(HALF, min, max) << HALF;
            self.mask &= (1 << self.count) - 1;
        }

        /// Clips four rays. Returns the mask of those that reach the box.
        #[inline]
        #[target_feature(enable = "avx2")]
        fn clip_half(&mut self, first: usize, min: DVec3, max: DVec3) -> u32 {
            let rays = &self.rays[first..first + HALF];
            let clips = &mut self.clips[first..first + HALF];
            let origin = [column!(rays, origin.x), column!(rays, origin.y), column!(rays, origin.z)];
            let direction = [column!(rays, direction.x), column!(rays, direction.y), column!(rays, direction.z)];
            let (t_min, t_max) = (column!(rays, t_min), column!(rays, t_max));
            let sign = _mm256_set1_pd(-0.0);
            let infinity = _mm256_set1_pd(f64::INFINITY);

            // The largest component of the direction.
            let one = _mm256_set1_pd(1.0);
            let mut size = _mm256_andnot_pd(sign, direction[0]);
            let mut largest = _mm256_div_pd(one, direction[0]);
            let mut reciprocal = [largest; 3];
            let mut axes = [0; 3];
            for axis in 1..3 {
                let magnitude = _mm256_andnot_pd(sign, direction[axis]);
                reciprocal[axis] = _mm256_div_pd(one, direction[axis]);
                let is_larger = _mm256_cmp_pd::<_CMP_GT_OQ>(magnitude, size);
                size = _mm256_blendv_pd(size, magnitude, is_larger);
                largest = _mm256_blendv_pd(largest, reciprocal[axis], is_larger);
                axes[axis] = _mm256_movemask_pd(is_larger);
            }
            let unscale = _mm256_andnot_pd(sign, largest);

            // The slabs of the enlarged box.
            let mut inverse = reciprocal;
            let (mut enter, mut leave) = (_mm256_set1_pd(f64::NEG_INFINITY), infinity);
            for axis in 0..3 {
                let margin = 2.0 * f64::from(BOX_MARGIN);
                let low = _mm256_sub_pd(_mm256_set1_pd(min[axis] - margin), origin[axis]);
                let high = _mm256_sub_pd(_mm256_set1_pd(max[axis] + margin), origin[axis]);
                inverse[axis] = _mm256_mul_pd(reciprocal[axis], size);
                let (low, high) = (_mm256_mul_pd(low, inverse[axis]), _mm256_mul_pd(high, inverse[axis]));
                enter = _mm256_max_pd(_mm256_blendv_pd(low, high, inverse[axis]), enter);
                leave = _mm256_min_pd(_mm256_blendv_pd(high, low, inverse[axis]), leave);
            }
            let (enter_size, leave_size) = (_mm256_andnot_pd(sign, enter), _mm256_andnot_pd(sign, leave));
            let farthest = _mm256_max_pd(enter_size, leave_size);
            let room = _mm256_mul_pd(_mm256_set1_pd(FAR_MARGIN), farthest);
            let (enter, leave) = (_mm256_sub_pd(enter, room), _mm256_add_pd(leave, room));
            let start = _mm256_max_pd(_mm256_mul_pd(enter, unscale), _mm256_min_pd(t_min, _mm256_setzero_pd()));
            let end = _mm256_min_pd(_mm256_mul_pd(leave, unscale), t_max);

            let is_finite = _mm256_and_pd(
                _mm256_and_pd(
                    _mm256_cmp_pd::<_CMP_LT_OQ>(unscale, infinity),
                    _mm256_cmp_pd::<_CMP_LT_OQ>(farthest, infinity),
                ),
                _mm256_cmp_pd::<_CMP_LT_OQ>(_mm256_andnot_pd(sign, start), infinity),
            );
            let is_long =
                _mm256_and_pd(_mm256_cmp_pd::<_CMP_LE_OQ>(enter, leave), _mm256_cmp_pd::<_CMP_LE_OQ>(start, end));
            let mask = _mm256_movemask_pd(_mm256_and_pd(is_finite, is_long)) as u32;

            // The clipped rays, for their own tests and for the tests of one box.
            for lane in 0..HALF {
                let is_larger = |axis: usize| axes[axis] >> lane & 1 == 1;
                clips[lane].axis = if is_larger(2) { 2 } else { usize::from(is_larger(1)) };
            }
            store!(clips, start, t_start);
            store!(clips, end, t_end);
            store!(clips, size, size);
            store!(clips, unscale, unscale);
            store!(clips, inverse[0], inverse.x);
            store!(clips, inverse[1], inverse.y);
            store!(clips, inverse[2], inverse.z);
            let length = _mm256_cvtpd_ps(_mm256_mul_pd(_mm256_sub_pd(end, start), size));
            let limit = _mm_add_ps(_mm_mul_ps(length, _mm_set1_ps(1.000_001)), _mm_set1_ps(2.0 * BOX_MARGIN));
            put(&mut self.slabs.limits, first, limit);
            let (margin, parallel) = (_mm_set1_ps(BOX_MARGIN), _mm256_set1_pd(PARALLEL));
            for axis in 0..3 {
                let moved = _mm256_add_pd(origin[axis], _mm256_mul_pd(start, direction[axis]));
                let position = _mm256_cvtpd_ps(moved);
                let inverse = _mm256_min_pd(_mm256_max_pd(inverse[axis], _mm256_xor_pd(sign, parallel)), parallel);
                put(&mut self.slabs.low[axis], first, _mm_add_ps(position, margin));
                put(&mut self.slabs.high[axis], first, _mm_sub_ps(position, margin));
                put(&mut self.slabs.inverse[axis], first, _mm256_cvtpd_ps(inverse));
            }
            mask
        }
    }

    /// Writes four lanes of a row, from lane `first`.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn put(row: &mut [f32; WIDTH], first: usize, values: __m128) {
        let half = &mut row[first..first + HALF];
        // SAFETY: the slice has four floats, and the store needs no alignment.
        unsafe { _mm_storeu_ps(half.as_mut_ptr(), values) };
    }
}

#[cfg(all(test, target_arch = "x86_64"))]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn component() -> impl Strategy<Value = f64> {
        let exponent = -200.0..200.0f64;
        prop_oneof![
            4 => -1.0..1.0f64,
            1 => (prop::bool::ANY, exponent).prop_map(|(way, e)| 10f64.powf(e) * if way { 1.0 } else { -1.0 }),
            1 => prop::sample::select(vec![0.0, -0.0, 1.0, -1.0, 5e-324, 2.3e-308, -1.7e308]),
        ]
    }

    fn ray() -> impl Strategy<Value = Ray> {
        let vector = || (component(), component(), component()).prop_map(|(x, y, z)| DVec3::new(x, y, z));
        let ends = prop::sample::select(vec![(0.0, f64::INFINITY), (-1.0, 0.5), (0.5, 0.5), (f64::NEG_INFINITY, 3.0)]);
        (vector(), vector(), ends)
            .prop_map(|(origin, direction, (t_min, t_max))| Ray { origin, direction, t_min, t_max })
            .prop_filter("a direction has a length", |ray| ray.direction.abs().max_element() >= f64::MIN_POSITIVE)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        /// AVX2 finds the bits of the portable functions, for directions along axes and origins at any distance too.
        #[test]
        fn groups_have_the_bits_of_single_rays(rays in prop::collection::vec(ray(), 1..=WIDTH)) {
            if !std::arch::is_x86_feature_detected!("avx2") {
                return Ok(());
            }
            let (min, max) = (DVec3::new(-0.5, -0.25, -0.4), DVec3::new(0.5, 0.25, 0.3));
            let (mut wide, mut portable) = (RayGroup::new(), RayGroup::new());
            wide.fill(&mut rays.iter().copied());
            portable.fill(&mut rays.iter().copied());
            // SAFETY: the processor has AVX2.
            unsafe { wide.clip_avx2(min, max) };
            portable.clip(min, max);
            prop_assert_eq!(wide.mask, portable.mask);
            for lane in (0..rays.len()).filter(|lane| portable.mask >> lane & 1 == 1) {
                prop_assert_eq!(wide.clips[lane], portable.clips[lane]);
                let ready = portable.ready(lane);
                let [low, high, inverse] = ready.lanes.slabs();
                for axis in 0..3 {
                    prop_assert_eq!(wide.slabs.low[axis][lane], low[axis]);
                    prop_assert_eq!(wide.slabs.high[axis][lane], high[axis]);
                    prop_assert_eq!(wide.slabs.inverse[axis][lane], inverse[axis]);
                }
                prop_assert_eq!(wide.slabs.limits[lane], ready.limit());
            }
        }
    }
}
