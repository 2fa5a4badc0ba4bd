//! The field of a baked volume at a point in local units ([`crate::csg::tree::volume_leaf`]).

use super::scalar::Scalar;
use crate::csg::tree::volume_leaf::VolumeLeaf;
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
            None => self.interpolated(volume.distances(), at),
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
    fn interpolated(&self, distances: &[f32], at: [F; 3]) -> F {
        let mut cell = [0usize; 3];
        let mut fraction = [F::default(); 3];
        for axis in 0..3 {
            // Truncation rounds a non-negative value down. The last centre belongs to the cell before it.
            cell[axis] = (at[axis].widen() as usize).min(self.shape[axis].saturating_sub(2));
            fraction[axis] = at[axis] - F::of(cell[axis] as f64);
        }
        let [nx, ny, _] = self.shape;
        let steps = [0, 1, 2].map(|axis| usize::from(self.shape[axis] > 1));
        let value = |dx: usize, dy: usize, dz: usize| {
            let [x, y, z] = [cell[0] + dx * steps[0], cell[1] + dy * steps[1], cell[2] + dz * steps[2]];
            F::of(f64::from(distances[x + nx * (y + ny * z)]))
        };
        let lerp = |a: F, b: F, f: F| a + (b - a) * f;
        let row = |dy, dz| lerp(value(0, dy, dz), value(1, dy, dz), fraction[0]);
        let plane = |dz| lerp(row(0, dz), row(1, dz), fraction[1]);
        lerp(plane(0), plane(1), fraction[2])
    }
}
