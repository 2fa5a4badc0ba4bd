//! Comparisons of the eight lanes of a node or a pack.

use super::WIDTH;
use glam::Vec4;

/// Mask of the lanes whose value is at most `limit`.
#[inline(always)]
pub(super) fn mask_within(values: &[f32; WIDTH], limit: f32) -> u32 {
    // The compiler finds the instruction for a mask in these types only.
    let [a, b, c, d, e, f, g, h] = *values;
    let half = |row: [f32; 4]| Vec4::from_array(row).cmple(Vec4::splat(limit)).bitmask();
    half([a, b, c, d]) | half([e, f, g, h]) << 4
}

#[inline(always)]
pub(super) fn least_of(values: &[f32; WIDTH]) -> f32 {
    let less = |x: f32, y: f32| if x < y { x } else { y };
    let halves: [f32; 4] = std::array::from_fn(|i| less(values[i], values[i + 4]));
    less(less(halves[0], halves[2]), less(halves[1], halves[3]))
}
