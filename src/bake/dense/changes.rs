//! The triangles that differ between two meshes, and the blocks of samples whose distance they may change.
//!
//! *Theory.* Two meshes have the same faces and some vertices at other positions. Let C be the changed triangles at
//! their old and their new positions. A sample p with the old distance d(p) keeps it, to the bit, if every triangle of
//! C is farther than d(p): then an unchanged triangle is nearest before and after, and no new one is nearer. The
//! distance to C has slope 1, so all samples of a block with the centre c keep their distance if
//!
//! ```text
//! distance(c, C) > max over samples p of (d(p) + |p - c|)
//! ```
//!
//! d has slope 1 too. A single sample q therefore bounds the right side by d(q) + |q - c| + 2 r for a block of radius
//! r, which suffices for large blocks. Both sides are float32. The margin is that of the culling test of the bake.

use super::super::LocalGrid;
use super::block::SampleBox;
use super::{LEAF, SLACK, reach};
use crate::bvh::Bvh;
use glam::{DVec3, Vec3};

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
    /// `triangles` are the changed ones at their old and at their new positions, local units. `samples` are those of
    /// the whole grid, `scale` world units to the local unit. `half_thickness` is in world units.
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

    /// Whether a change may reach a sample of the block `low..high`.
    pub(super) fn reach(&self, grid: &LocalGrid, block: &SampleBox, low: [usize; 3], high: [usize; 3]) -> bool {
        let bound = if (0..3).all(|axis| high[axis] - low[axis] <= LEAF) {
            self.bound_of_samples(grid, block, low, high)
        } else {
            let middle = [0, 1, 2].map(|axis| low[axis].midpoint(high[axis]));
            self.bound_at(grid, block, middle) + 2.0 * block.half.length() * (1.0 + 1e-5)
        };
        let limit = bound + self.slack;
        self.triangles.nearest(block.center, limit * limit).is_some()
    }

    fn bound_of_samples(&self, grid: &LocalGrid, block: &SampleBox, low: [usize; 3], high: [usize; 3]) -> f32 {
        let mut largest = 0.0f32;
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                for x in low[0]..high[0] {
                    largest = largest.max(self.bound_at(grid, block, [x, y, z]));
                }
            }
        }
        largest
    }

    /// The distance of a sample before the change, plus that from the sample to the centre of the block.
    #[inline(always)]
    fn bound_at(&self, grid: &LocalGrid, block: &SampleBox, [x, y, z]: [usize; 3]) -> f32 {
        let [nx, ny, _] = grid.shape();
        let stored = self.samples[x + nx * (y + ny * z)];
        let distance = match self.half_thickness {
            Some(half) => stored * self.inverse_scale + half,
            None => stored.abs() * self.inverse_scale,
        };
        let p = DVec3::new(grid.axes[0].at(x), grid.axes[1].at(y), grid.axes[2].at(z)).as_vec3();
        distance + Vec3::distance(p, block.center)
    }
}
