//! The stack of a depth-first search that sorts the children of a node without branches.
//!
//! The number of children that a search enters and their order are hard to foresee, and a branch that depends on them
//! costs more than the comparisons of a sorting network. A key holds the distance of a child above its lane: the
//! distance is rounded down to a multiple of eight in its last place.

use crate::bvh::{ChildRef, MAX_STACK, WIDTH};

/// Boxes that are still to be searched, the nearest of each node on top.
pub(crate) struct SortedStack {
    keys: [i32; SLOTS],
    children: [ChildRef; SLOTS],
    /// Number of boxes. The slot below the first box marks the end of the search.
    top: usize,
}

/// The end of the search, and space for the eight lanes of a node, of which only some are kept.
const SLOTS: usize = 1 + MAX_STACK + WIDTH;
/// Bits of a key that hold the lane.
const LANE: i32 = WIDTH as i32 - 1;

impl SortedStack {
    pub(crate) fn new() -> Self {
        Self { keys: [0; SLOTS], children: [ChildRef::NONE; SLOTS], top: 0 }
    }

    /// The next box whose distance is at most `limit`, or [`ChildRef::NONE`] at the end of the search. A limit below
    /// zero ends it.
    #[inline(always)]
    pub(crate) fn pop(&mut self, limit: f32) -> ChildRef {
        while self.top > 0 && f32::from_bits((self.keys[self.top] & !LANE) as u32) > limit {
            self.top -= 1;
        }
        let child = self.children[self.top];
        self.top -= usize::from(self.top > 0);
        child
    }

    /// Adds the lanes of a mask with their distances, which must not be negative.
    #[inline(always)]
    pub(crate) fn push(&mut self, mut mask: u32, distances: &[f32; WIDTH], children: &[ChildRef; WIDTH]) {
        let bottom = self.top;
        while mask != 0 {
            let lane = mask.trailing_zeros() as usize % WIDTH;
            mask &= mask - 1;
            let key = (distances[lane].to_bits() as i32 & !LANE) | lane as i32;
            self.top += 1;
            let mut slot = self.top;
            while slot > bottom + 1 && self.keys[slot - 1] < key {
                self.keys[slot] = self.keys[slot - 1];
                self.children[slot] = self.children[slot - 1];
                slot -= 1;
            }
            (self.keys[slot], self.children[slot]) = (key, children[lane]);
        }
    }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{ChildRef, LANE, SortedStack, WIDTH};
    use std::arch::x86_64::*;

    /// Key of a lane that is not entered, less than the key of every distance.
    const ABSENT: i32 = -1;

    impl SortedStack {
        /// [`SortedStack::push`] by a sorting network. `entered` has all bits of the lanes that are added.
        #[inline]
        #[target_feature(enable = "avx2")]
        pub(in crate::bvh) fn push_avx2(&mut self, entered: __m256, distances: __m256, children: &[ChildRef; WIDTH]) {
            /// Compares each lane with a partner. The lanes in `LOWER` keep the smaller key.
            macro_rules! layer {
                ($keys:ident, $partners:expr, $lower:literal) => {
                    let partners = $partners;
                    let (low, high) = (_mm256_min_epi32($keys, partners), _mm256_max_epi32($keys, partners));
                    $keys = _mm256_blend_epi32::<$lower>(high, low);
                };
            }
            let lanes = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            let rounded = _mm256_andnot_si256(_mm256_set1_epi32(LANE), _mm256_castps_si256(distances));
            let keys = _mm256_or_si256(rounded, lanes);
            let mut keys = _mm256_blendv_epi8(_mm256_set1_epi32(ABSENT), keys, _mm256_castps_si256(entered));
            // A bitonic network in decreasing order: the partners of lane i are i ^ 1, i ^ 3, i ^ 1, i ^ 7, i ^ 2, i ^
            // 1.
            let reverse = _mm256_setr_epi32(7, 6, 5, 4, 3, 2, 1, 0);
            layer!(keys, _mm256_shuffle_epi32::<0xb1>(keys), 0xaa);
            layer!(keys, _mm256_shuffle_epi32::<0x1b>(keys), 0xcc);
            layer!(keys, _mm256_shuffle_epi32::<0xb1>(keys), 0xaa);
            layer!(keys, _mm256_permutevar8x32_epi32(keys, reverse), 0xf0);
            layer!(keys, _mm256_shuffle_epi32::<0x4e>(keys), 0xcc);
            layer!(keys, _mm256_shuffle_epi32::<0xb1>(keys), 0xaa);
            let slots = self.top + 1..self.top + 1 + WIDTH;
            let (key_slots, child_slots) = (&mut self.keys[slots.clone()], &mut self.children[slots]);
            // SAFETY: the arrays have eight items of 32 bits, and loads and stores need no alignment. An index of a
            // permutation is the lane in the low bits of a key.
            unsafe {
                let children = _mm256_loadu_si256(children.as_ptr().cast());
                _mm256_storeu_si256(key_slots.as_mut_ptr().cast(), keys);
                let sorted = _mm256_permutevar8x32_epi32(children, keys);
                _mm256_storeu_si256(child_slots.as_mut_ptr().cast(), sorted);
            }
            self.top += _mm256_movemask_ps(entered).count_ones() as usize;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A lane and its distance rounded as in a key.
    fn rounded(lane: usize, distance: f32) -> (u32, usize) {
        (distance.to_bits() & !(LANE as u32), lane)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        /// Boxes leave the stack in the order of their distances, the lowest lane first among equal ones, up to the
        /// limit. The sorting network leaves the same slots.
        #[test]
        fn children_leave_in_the_order_of_distances(
            distances in prop::array::uniform8(prop_oneof![0.0..4.0f32, Just(0.0), Just(1.0), Just(f32::INFINITY)]),
            mask in 0..256u32, first in 0.0..8.0f32, limit in prop_oneof![0.0..4.0f32, Just(f32::INFINITY)]
        ) {
            let children = std::array::from_fn(ChildRef::node);
            let mut stack = SortedStack::new();
            stack.push(1, &[first; WIDTH], &[ChildRef::node(8); WIDTH]);
            stack.push(mask, &distances, &children);
            #[cfg(target_arch = "x86_64")]
            if std::arch::is_x86_feature_detected!("avx2") {
                let entered: [u32; WIDTH] = std::array::from_fn(|lane| if mask >> lane & 1 == 1 { u32::MAX } else { 0 });
                let mut wide = SortedStack::new();
                wide.push(1, &[first; WIDTH], &[ChildRef::node(8); WIDTH]);
                // SAFETY: the processor has AVX2, and the loads need no alignment.
                unsafe {
                    let entered = std::arch::x86_64::_mm256_loadu_ps(entered.as_ptr().cast());
                    let distances = std::arch::x86_64::_mm256_loadu_ps(distances.as_ptr());
                    wide.push_avx2(entered, distances, &children);
                }
                prop_assert_eq!(wide.top, stack.top);
                prop_assert_eq!(&wide.keys[..=stack.top], &stack.keys[..=stack.top]);
                prop_assert!(wide.children[..=stack.top] == stack.children[..=stack.top]);
            }
            let lanes = (0..WIDTH).filter(|lane| mask >> lane & 1 == 1);
            let mut expected: Vec<_> = lanes.map(|lane| rounded(lane, distances[lane])).collect();
            expected.sort_unstable();
            let boxes = expected.into_iter().chain([rounded(8, first)]);
            for (key, lane) in boxes.filter(|&(key, _)| f32::from_bits(key) <= limit) {
                prop_assert_eq!(stack.pop(limit), ChildRef::node(lane), "{}", key);
            }
            prop_assert!(stack.pop(limit).is_none());
            prop_assert!(stack.pop(f32::NEG_INFINITY).is_none());
        }
    }
}
