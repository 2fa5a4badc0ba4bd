//! The regular grid of a volume.
//!
//! Samples lie at voxel centres: `p = lower + (index + 0.5) * spacing`. Memory order is x fastest:
//! `offset = x + nx * (y + ny * z)`.

use crate::error::{ArgumentError, Error};
use glam::DVec3;

/// An axis-aligned box divided into `shape` voxels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Grid {
    /// Lower corner of the box, world units.
    pub lower: DVec3,
    /// Upper corner of the box, world units.
    pub upper: DVec3,
    /// Number of voxels along x, y and z.
    pub shape: [usize; 3],
}

impl Grid {
    /// Checks a box and a number of voxels. `lower`, `upper` and `shape` are named as in `fieldbake.arrays`.
    pub fn new(lower: DVec3, upper: DVec3, shape: [usize; 3]) -> Result<Self, Error> {
        if !lower.is_finite() || !upper.is_finite() {
            return Err(ArgumentError::new("bounds", format!("must be finite, got {lower} to {upper}")).into());
        }
        if !(upper - lower).cmpgt(DVec3::ZERO).all() {
            return Err(ArgumentError::new(
                "bounds",
                format!("upper must exceed lower on every axis, got {lower} to {upper}"),
            )
            .into());
        }
        if shape.contains(&0) {
            return Err(ArgumentError::new(
                "resolution",
                format!("every side needs at least one voxel, got {shape:?}"),
            )
            .into());
        }
        let samples = shape.iter().try_fold(1usize, |product, &n| product.checked_mul(n));
        if samples.is_none_or(|n| n > MAX_SAMPLES) {
            return Err(ArgumentError::new("resolution", format!("{shape:?} is more than {MAX_SAMPLES} voxels")).into());
        }
        Ok(Self { lower, upper, shape })
    }

    /// Number of voxels.
    pub fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Whether there are no voxels.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Size of a voxel, world units.
    pub fn spacing(&self) -> DVec3 {
        (self.upper - self.lower) / DVec3::new(self.shape[0] as f64, self.shape[1] as f64, self.shape[2] as f64)
    }

    /// Centre of voxel `(x, y, z)`.
    pub fn center(&self, x: usize, y: usize, z: usize) -> DVec3 {
        self.lower + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * self.spacing()
    }

    /// Index of voxel `(x, y, z)` in memory.
    pub fn offset(&self, x: usize, y: usize, z: usize) -> usize {
        x + self.shape[0] * (y + self.shape[1] * z)
    }

    /// Length of the diagonal of the box, world units.
    pub fn diagonal(&self) -> f64 {
        (self.upper - self.lower).length()
    }
}

/// 2^40 voxels are 4 TiB of distances, far beyond any machine. Every product below it fits in `usize`.
const MAX_SAMPLES: usize = 1 << 40;
