//! The box around a block of samples, and arithmetic in lanes that compiles to vector instructions.

use crate::bake::LocalGrid;
use crate::bvh::{Node, WIDTH};
use glam::Vec3;

/// Number of corners of a block.
pub(super) const CORNERS: usize = 8;

/// A box of samples: centre and half size of the box around their positions.
#[derive(Clone, Copy)]
pub(super) struct SampleBox {
    pub center: Vec3,
    pub half: Vec3,
}

impl SampleBox {
    /// The box of the samples `low..high` of a grid.
    pub(super) fn new(grid: &LocalGrid, low: [usize; 3], high: [usize; 3]) -> Self {
        let (first, last) = (grid.at(low), grid.at(high.map(|i| i - 1)));
        Self { center: ((first + last) * 0.5).as_vec3(), half: ((last - first) * 0.5).as_vec3() }
    }

    /// Positions of the corners; bit `axis` of the index selects the upper side.
    #[inline(always)]
    pub(super) fn corners(&self) -> [[f32; CORNERS]; 3] {
        let mut corners = [[0.0; CORNERS]; 3];
        for axis in 0..3 {
            for i in 0..CORNERS {
                let half = self.half[axis];
                corners[axis][i] = self.center[axis] + if i >> axis & 1 == 1 { half } else { -half };
            }
        }
        corners
    }

    /// A tangent lies above the bounds at all corners if its value at the centre exceeds this: the maximum over the
    /// corners of the bound there minus the rise of the tangent to that corner.
    #[inline(always)]
    pub(super) fn slackest(&self, gradient: [f32; 3], bounds: &[f32; CORNERS]) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| gradient[axis] * self.half[axis]);
        let (sum, difference) = (x + y, x - y);
        // The rise to the corners with x and y up, x up, y up, and neither; for the lower and the upper side in z.
        let rises = [sum, difference, -difference, -sum];
        let mut slackest = f32::NEG_INFINITY;
        for (corner, rise) in [3, 1, 2, 0].into_iter().zip(rises) {
            slackest = max(slackest, max(bounds[corner] - (rise - z), bounds[corner + 4] - (rise + z)));
        }
        slackest
    }
}

/// A linear function over a block: its value at the centre, and its gradient.
#[derive(Clone, Copy)]
pub(super) struct Linear {
    pub value: f32,
    pub gradient: [f32; 3],
}

/// Distance of `p` to the box of each child of a node, and its gradient.
#[inline(always)]
pub(super) fn tangents_of_boxes(node: &Node, p: Vec3) -> ([f32; WIDTH], [[f32; WIDTH]; 3]) {
    let mut value = [0.0; WIDTH];
    let mut gradient = [[0.0; WIDTH]; 3];
    for i in 0..WIDTH {
        // Vector from the nearest point of the box to `p`.
        let mut g = [0.0f32; 3];
        for axis in 0..3 {
            let above_min = p[axis] - node.min[axis][i];
            let above_max = p[axis] - node.max[axis][i];
            g[axis] = max(above_max, min(above_min, 0.0));
        }
        value[i] = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
        // An absent child is infinitely far and its gradient is NaN, which fails every comparison.
        let inverse = if value[i] > 0.0 { 1.0 / value[i] } else { 0.0 };
        for axis in 0..3 {
            gradient[axis][i] = g[axis] * inverse;
        }
    }
    (value, gradient)
}

#[inline(always)]
pub(super) fn roots<const N: usize>(mut squares: [f32; N]) -> [f32; N] {
    for i in 0..N {
        squares[i] = squares[i].sqrt();
    }
    squares
}

#[inline(always)]
pub(super) fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
pub(super) fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Bit i is set if lane i is zero or less.
#[inline(always)]
pub(super) fn not_positive(lanes: &[f32; WIDTH]) -> u8 {
    let mut bits = 0;
    for i in 0..WIDTH {
        bits |= u8::from(lanes[i] <= 0.0) << i;
    }
    bits
}
