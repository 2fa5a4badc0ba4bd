//! The triangles that differ between two meshes, and the blocks of samples whose distance they may change.
//!
//! *Theory.* Two meshes have the same faces and some vertices at other positions. Let C be the changed triangles at
//! their old and their new positions. A sample p with the old distance d(p) keeps it, to the bit, if every triangle of
//! C is farther than d(p): then an unchanged triangle is nearest before and after, and no new one is nearer.
//!
//! The distance to a triangle of C, or to a box of several, is convex. Over a block with the centre c it therefore lies
//! above its tangent at c (see [`super`]). Let l be a linear function with l(p) >= d(p) at all samples of the block.
//! A triangle or box whose tangent lies above l at the eight corners of the block changes no sample. With the gradients
//! h of l and g of the tangent, and the half sizes s of the block, that is
//!
//! ```text
//! tangent(c) > l(c) + |h.x - g.x| s.x + |h.y - g.y| s.y + |h.z - g.z| s.z
//! ```
//!
//! h is the mean gradient of d between the corners, and l(c) the smallest value that bounds all samples. In the
//! smallest blocks the tangent of a triangle is then compared with the samples themselves. All of it is float32, and
//! the culling test of the bake has the same margin.

use super::super::LocalGrid;
use super::block::{CORNERS, Linear, SampleBox, max, not_positive, tangents_of_boxes};
use super::{Candidates, LEAF, SLACK, TASK, blocks, leaf_of_tile, open_large, reach};
use crate::bvh::{Bvh, WIDTH};
use crate::simd::with_vectors;

/// Changed triangles, and the samples of the field before the change.
pub(in crate::bake) struct Changes<'a> {
    /// The changed triangles at their old and at their new positions.
    triangles: &'a Bvh,
    /// Stored samples of the whole grid, world units, x fastest.
    samples: &'a [f32],
    /// Local units per world unit.
    inverse_scale: f32,
    /// Half the thickness of a two-sided sheet, local units. The samples are the distances minus this.
    half_thickness: Option<f32>,
    slack: f32,
}

impl<'a> Changes<'a> {
    /// `triangles` are the changed ones at their old and at their new positions, local units. `samples` are the samples
    /// of the whole grid, `scale` world units to the local unit. `half_thickness` is in world units.
    pub(crate) fn new(
        triangles: &'a Bvh,
        grid: &LocalGrid,
        samples: &'a [f32],
        scale: f64,
        half_thickness: Option<f64>,
    ) -> Self {
        let half_thickness = half_thickness.map(|half| (half / scale) as f32);
        // The thickness is rounded twice, each time by 6e-8 of the larger summand.
        let slack = SLACK * (reach(grid) as f32).max(1.0) + 1e-6 * half_thickness.unwrap_or(0.0);
        Self { triangles, samples, inverse_scale: scale.recip() as f32, half_thickness, slack }
    }

    /// The blocks of [`LEAF`]^3 samples of a tile that a change may reach, one bit each, x fastest.
    pub(super) fn leaves(
        &self,
        buffers: [&mut Candidates; 3],
        grid: &LocalGrid,
        low: [usize; 3],
        high: [usize; 3],
    ) -> u64 {
        with_vectors!(
            (changes: &Changes<'_> = self, buffers: [&mut Candidates; 3] = buffers, grid: &LocalGrid = grid,
             low: [usize; 3] = low, high: [usize; 3] = high)
            -> u64 { changes.leaves_portable(buffers, grid, low, high) }
        )
    }

    #[inline(always)]
    fn leaves_portable(
        &self,
        [of_tile, of_octant, stack]: [&mut Candidates; 3],
        grid: &LocalGrid,
        low: [usize; 3],
        high: [usize; 3],
    ) -> u64 {
        stack.clear();
        stack.push((0, u8::MAX));
        Block::new(self, grid, low, high).cull_nodes(stack, of_tile);
        if of_tile.is_empty() {
            return 0;
        }
        let mut leaves = 0;
        for octant in blocks(low, high, [TASK / 2; 3]) {
            stack.clear();
            stack.extend_from_slice(of_tile);
            Block::new(self, grid, octant.0, octant.1).cull_nodes(stack, of_octant);
            if of_octant.is_empty() {
                continue;
            }
            for leaf in blocks(octant.0, octant.1, [LEAF; 3]) {
                stack.clear();
                stack.extend_from_slice(of_octant);
                let is_reached = Block::new(self, grid, leaf.0, leaf.1).is_reached(stack);
                leaves |= u64::from(is_reached) << leaf_of_tile(low, leaf.0);
            }
        }
        leaves
    }

    /// The distance of a stored sample, local units.
    #[inline(always)]
    fn distance(&self, stored: f32) -> f32 {
        match self.half_thickness {
            Some(half) => stored * self.inverse_scale + half,
            None => stored.abs() * self.inverse_scale,
        }
    }
}

/// A block of samples before the change.
struct Block<'a> {
    changes: &'a Changes<'a>,
    grid: &'a LocalGrid,
    low: [usize; 3],
    /// Number of samples along each axis.
    shape: [usize; 3],
    bounds: SampleBox,
    /// Positions of the samples along each axis, from the centre of the block.
    offsets: [[f32; TASK]; 3],
}

impl<'a> Block<'a> {
    #[inline(always)]
    fn new(changes: &'a Changes<'a>, grid: &'a LocalGrid, low: [usize; 3], high: [usize; 3]) -> Self {
        let shape = [0, 1, 2].map(|axis| high[axis] - low[axis]);
        let bounds = SampleBox::new(grid, low, high);
        let mut offsets = [[0.0; TASK]; 3];
        for axis in 0..3 {
            for i in 0..shape[axis] {
                offsets[axis][i] = grid.axes[axis].at(low[axis] + i) as f32 - bounds.center[axis];
            }
        }
        Self { changes, grid, low, shape, bounds, offsets }
    }

    /// A linear function that is at least the distance at each sample.
    #[inline(always)]
    fn bound(&self) -> Linear {
        let gradient = self.gradient();
        Linear { value: self.most_above(gradient), gradient }
    }

    /// Moves the nodes of `stack` that may change a sample to `kept`, opening those larger than the block.
    #[inline(always)]
    fn cull_nodes(&self, stack: &mut Candidates, kept: &mut Candidates) {
        kept.clear();
        let bound = self.bound();
        let size = 2.0 * self.bounds.half.max_element();
        while let Some((index, mask)) = stack.pop() {
            let node = &self.changes.triangles.nodes[index as usize];
            let (value, gradient) = tangents_of_boxes(node, self.bounds.center);
            let lanes = self.not_above(&value, &gradient, &bound) & mask;
            let rest = open_large(node, lanes, size, stack);
            if rest != 0 {
                kept.push((index, rest));
            }
        }
    }

    /// Whether a triangle in the nodes of `stack` may change a sample of the block.
    #[inline(always)]
    fn is_reached(&self, stack: &mut Candidates) -> bool {
        let Changes { triangles, slack, .. } = *self.changes;
        let bound = self.bound();
        while let Some((index, mask)) = stack.pop() {
            let node = &triangles.nodes[index as usize];
            let (value, gradient) = tangents_of_boxes(node, self.bounds.center);
            let mut rest = self.not_above(&value, &gradient, &bound) & mask;
            while rest != 0 {
                let child = node.children[rest.trailing_zeros() as usize];
                rest &= rest - 1;
                if !child.is_pack() {
                    stack.push((child.index() as u32, u8::MAX));
                    continue;
                }
                let pack = &triangles.packs[child.index()];
                let (value, gradient) = pack.tangents(self.bounds.center);
                let mut rest = self.not_above(&value, &gradient, &bound) & pack.mask();
                while rest != 0 {
                    let lane = rest.trailing_zeros() as usize;
                    rest &= rest - 1;
                    let gradient = [gradient[0][lane], gradient[1][lane], gradient[2][lane]];
                    if self.most_above(gradient) + slack >= value[lane] {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Mask of the lanes whose tangent does not lie above a bound throughout the block.
    #[inline(always)]
    fn not_above(&self, value: &[f32; WIDTH], gradient: &[[f32; WIDTH]; 3], bound: &Linear) -> u8 {
        let mut excess = [0.0f32; WIDTH];
        for i in 0..WIDTH {
            excess[i] = value[i] - bound.value - self.changes.slack;
            for axis in 0..3 {
                excess[i] -= (bound.gradient[axis] - gradient[axis][i]).abs() * self.bounds.half[axis];
            }
        }
        not_positive(&excess)
    }

    /// The gradient of the distances, from the samples at the corners.
    #[inline(always)]
    fn gradient(&self) -> [f32; 3] {
        let mut rise = [0.0f32; 3];
        for corner in 0..CORNERS {
            let mut voxel = self.low;
            for axis in 0..3 {
                voxel[axis] += (corner >> axis & 1) * (self.shape[axis] - 1);
            }
            let distance = self.changes.distance(self.changes.samples[self.grid.index(voxel)]);
            for axis in 0..3 {
                rise[axis] += if corner >> axis & 1 == 1 { distance } else { -distance };
            }
        }
        // Each is the sum of four differences over the whole width of the block. Rounding makes it steep where samples
        // are very close together. The margin covers the rounding of positions only for a slope of at most 1.
        for axis in 0..3 {
            let half = self.bounds.half[axis];
            rise[axis] = if half > 0.0 { (rise[axis] / (8.0 * half)).clamp(-1.0, 1.0) } else { 0.0 };
        }
        rise
    }

    /// The largest difference between the distance of a sample and the linear function with the given gradient that is
    /// zero at the centre.
    #[inline(always)]
    fn most_above(&self, gradient: [f32; 3]) -> f32 {
        let [x, y, z] = self.low;
        let mut most = [f32::NEG_INFINITY; LEAF];
        for k in 0..self.shape[2] {
            for j in 0..self.shape[1] {
                let rise = gradient[1] * self.offsets[1][j] + gradient[2] * self.offsets[2][k];
                let row = &self.changes.samples[self.grid.index([x, y + j, z + k])..][..self.shape[0]];
                let above = |sample: f32, offset: f32| self.changes.distance(sample) - (gradient[0] * offset + rise);
                let (whole, rest) = row.as_chunks::<LEAF>();
                for (samples, offsets) in whole.iter().zip(self.offsets[0].as_chunks::<LEAF>().0) {
                    for i in 0..LEAF {
                        most[i] = max(most[i], above(samples[i], offsets[i]));
                    }
                }
                for (&sample, &offset) in rest.iter().zip(&self.offsets[0][LEAF * whole.len()..]) {
                    most[0] = max(most[0], above(sample, offset));
                }
            }
        }
        max(max(most[0], most[1]), max(most[2], most[3]))
    }
}
