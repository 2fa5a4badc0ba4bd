//! The field of a baked volume at a point in local units ([`crate::csg::tree::volume_leaf`]).

use super::scalar::Scalar;
use crate::csg::tree::volume_leaf::{PARTS, VolumeLeaf};
use glam::DVec3;
use std::sync::Arc;

/// The data that a leaf reads at each point, in local units.
#[derive(Debug, Clone)]
pub struct PlacedVolume<F> {
    pub lower: [F; 3],
    pub upper: [F; 3],
    pub inverse_spacing: [F; 3],
    pub shape: [usize; 3],
    /// Number of local units in a unit of the stored distances.
    pub scale: F,
}

impl<F: Scalar> PlacedVolume<F> {
    pub fn new(volume: &VolumeLeaf, scale: f64) -> Self {
        let grid = volume.grid();
        let units = |v: DVec3| v.to_array().map(F::of);
        Self {
            lower: units(scale * grid.lower),
            upper: units(scale * grid.upper),
            inverse_spacing: units(1.0 / (scale * grid.spacing())),
            shape: grid.shape,
            scale: F::of(scale),
        }
    }

    pub fn distance(&self, volume: &Arc<VolumeLeaf>, p: [F; 3]) -> F {
        let zero = F::default();
        let half = F::of(0.5);
        let mut outside = zero;
        // Largest signed distance to the planes of the faces: inside the box, minus the distance to the nearest face.
        let mut to_face = -F::of(f64::from(f32::MAX));
        let mut at = [zero; 3];
        for axis in 0..3 {
            let inside = p[axis].between(self.lower[axis], self.upper[axis]);
            let away = p[axis] - inside;
            outside += away * away;
            to_face = to_face.most(self.lower[axis] - p[axis]).most(p[axis] - self.upper[axis]);
            let last = F::of((self.shape[axis] - 1) as f64);
            at[axis] = ((inside - self.lower[axis]) * self.inverse_spacing[axis] - half).between(zero, last);
        }
        let stored = match F::image_sample(volume, at) {
            Some(sample) => sample,
            None => self.interpolated(volume, at),
        };
        let stored = stored * self.scale;
        let beyond = || {
            let s = stored.most(zero);
            [(outside + s * s).sqrt()]
        };
        let [distance] = F::branch_less(zero, outside, beyond, || [stored.most(to_face)]);
        distance
    }

    /// The trilinear field at a position in voxels from the centre of the first one.
    #[inline(always)]
    fn interpolated(&self, volume: &VolumeLeaf, at: [F; 3]) -> F {
        let mut cell = [0usize; 3];
        let mut fraction = [F::default(); 3];
        for axis in 0..3 {
            // The last centre belongs to the cell before it.
            (cell[axis], fraction[axis]) = split(at[axis], self.shape[axis].saturating_sub(2));
        }
        let [nx, ny, _] = self.shape;
        let [x, y, z] = cell;
        if !volume.divided().blocks().is_empty()
            && let Some(samples) = volume.divided().samples_of(x + (nx - 1) * (y + (ny - 1) * z))
        {
            let side = PARTS + 1;
            let [(x, fx), (y, fy), (z, fz)] = fraction.map(|f| split(f * F::of(PARTS as f64), PARTS - 1));
            return trilinear(samples, x + side * (y + side * z), [1, side, side * side], [fx, fy, fz]);
        }
        let steps = [0, 1, 2].map(|axis| usize::from(self.shape[axis] > 1));
        trilinear(volume.distances(), x + nx * (y + ny * z), [steps[0], nx * steps[1], nx * ny * steps[2]], fraction)
    }
}

/// The whole part of a non-negative number, at most `last`, and the rest. Truncation rounds down.
#[inline(always)]
fn split<F: Scalar>(at: F, last: usize) -> (usize, F) {
    let whole = (at.widen() as usize).min(last);
    (whole, at - F::of(whole as f64))
}

/// The trilinear mean of eight samples: `first`, and those a step further along each axis.
#[inline(always)]
fn trilinear<F: Scalar>(samples: &[f32], first: usize, steps: [usize; 3], [fx, fy, fz]: [F; 3]) -> F {
    let value = |i: usize| F::of(f64::from(samples[i]));
    let lerp = |a: F, b: F, f: F| a + (b - a) * f;
    let row = |i: usize| lerp(value(i), value(i + steps[0]), fx);
    let plane = |i: usize| lerp(row(i), row(i + steps[1]), fy);
    lerp(plane(first), plane(first + steps[2]), fz)
}
