//! The largest slope of stored samples. A field that is far steeper than a distance is divided by it.
//!
//! The surface stays where it is, and cones past it no longer take its values for clearances that it does not have.

use crate::volume::sparse::{BRICK_LEN, BRICK_SAMPLES, Entry, SparseField};
use glam::DVec3;
use rayon::prelude::*;

/// Slope above which samples are no distances. The rounding of 8-bit samples, whose range is 4 voxels, adds less.
const STEEP: f64 = 1.25;

/// The number by which samples of this slope are divided: 1 for the samples of a distance.
pub(crate) fn divisor(slope: f64) -> f64 {
    if slope > STEEP && slope.is_finite() { slope } else { 1.0 }
}

/// Divides all samples by a number of at least 1.
pub(crate) fn divide(samples: &mut [f32], divisor: f64) {
    if divisor > 1.0 {
        samples.par_iter_mut().for_each(|sample| *sample = (f64::from(*sample) / divisor) as f32);
    }
}

/// Largest difference of neighbouring samples of a grid, x fastest, relative to their distance: along edges, diagonals
/// of faces, and diagonals of cells.
pub(crate) fn largest_slope(samples: &[f32], shape: [usize; 3], spacing: DVec3) -> f64 {
    (0..shape[2]).into_par_iter().map(|k| slope_of_layer(samples, shape, spacing, k)).reduce(|| 0.0, f64::max)
}

/// Largest slope from the samples of layer `k` to the samples of this layer and of the next one.
fn slope_of_layer(samples: &[f32], [nx, ny, nz]: [usize; 3], spacing: DVec3, k: usize) -> f64 {
    let row = |y: usize, z: usize| &samples[nx * (y + ny * z)..][..nx];
    let of_pair = |[x, y, z]: [i32; 3]| {
        let [before, after] = [x.min(0).unsigned_abs() as usize, x.max(0) as usize].map(|i| i.min(nx));
        let (low, high) = (y.min(0).unsigned_abs() as usize, ny.saturating_sub(y.max(0) as usize));
        // Maxima of lanes, so that the compiler uses vectors.
        let mut most = [0f32; 8];
        for j in if k + (z as usize) < nz { low..high } else { 0..0 } {
            let (a, b) = (row(j, k), row((j as i32 + y) as usize, k + z as usize));
            for (a, b) in a[before..].chunks(8).zip(b[after..].chunks(8)) {
                a.iter().zip(b).zip(&mut most).for_each(|((a, b), most)| *most = most.max((a - b).abs()));
            }
        }
        let step = DVec3::new(x.into(), y.into(), z.into()) * spacing;
        f64::from(most.into_iter().fold(0.0, f32::max)) / step.length()
    };
    // The 13 pairs of opposite neighbours.
    let all = (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1]);
    all.filter(|&[x, y, z]: &[i32; 3]| [z, y, x] > [0; 3]).map(of_pair).fold(0.0, f64::max)
}

/// Largest slope between the stored samples of a sparse field.
pub(crate) fn largest_slope_of_bricks(field: &SparseField<f32>) -> f64 {
    let of_word = |&word: &u32| match Entry::from_word(word) {
        Entry::Empty { .. } => 0.0,
        Entry::Stored { level, brick } => {
            let samples = &field.texels[brick as usize * BRICK_LEN..][..BRICK_LEN];
            let spacing = field.grid.spacing() * f64::from(1u32 << level);
            let layers = (0..BRICK_SAMPLES).map(|k| slope_of_layer(samples, [BRICK_SAMPLES; 3], spacing, k));
            layers.fold(0.0, f64::max)
        }
    };
    field.index.par_iter().map(of_word).reduce(|| 0.0, f64::max)
}
