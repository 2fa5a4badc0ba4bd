//! The trilinear field at the voxel centres of another grid over the same box.
//!
//! Positions and weights are the same for all rows of an axis, so they are computed once per axis. Halving an even
//! resolution places every new centre in the middle of eight old ones: the result is their mean. A reduction by more
//! than two at once skips samples; halve repeatedly to include all of them.

use super::{FieldView, Texel, Trilinear, trilinear};
use crate::error::Error;
use crate::grid::Grid;
use crate::progress::Progress;
use glam::{IVec3, Vec3};
use rayon::prelude::*;

impl<T: Texel> FieldView<'_, T> {
    /// Distances for `shape` voxels over the same box, x fastest.
    pub fn resample(&self, shape: [usize; 3], progress: &Progress) -> Result<Vec<f32>, Error> {
        let source = self.grid();
        let target = Grid::new(source.lower, source.upper, shape)?;
        let [nx, ny, nz] = shape;
        let [x, y, z] = [0, 1, 2].map(|axis| axis_positions(source.shape[axis], shape[axis]));

        progress.set_total(nz as u64);
        let mut distances = vec![0.0; target.len()];
        distances.par_chunks_mut(nx * ny).zip(&z).try_for_each(|(slice, &(cell_z, fraction_z))| {
            for (row, &(cell_y, fraction_y)) in slice.chunks_mut(nx).zip(&y) {
                progress.check()?;
                for (value, &(cell_x, fraction_x)) in row.iter_mut().zip(&x) {
                    let corners = self.corners(IVec3::new(cell_x, cell_y, cell_z));
                    *value = trilinear(&corners, Vec3::new(fraction_x, fraction_y, fraction_z));
                }
            }
            progress.advance(1)
        })?;
        Ok(distances)
    }
}

/// Cell and fraction of `target` voxel centres on an axis of `source` voxels.
fn axis_positions(source: usize, target: usize) -> Vec<(i32, f32)> {
    (0..target)
        .map(|index| {
            let position = (index as f64 + 0.5) * source as f64 / target as f64 - 0.5;
            let cell = position.floor();
            (cell as i32, (position - cell) as f32)
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::fill;
    use super::*;
    use glam::DVec3;

    fn grid(shape: [usize; 3]) -> Grid {
        Grid::new(DVec3::new(-1.0, 3.0, 0.0), DVec3::new(1.0, 4.0, 5.0), shape).unwrap()
    }

    #[test]
    fn halving_gives_the_mean_of_eight() {
        let grid = grid([4, 6, 2]);
        let distances = fill(&grid, |p| (7.0 * p.x).sin() + (3.0 * p.y).cos() * p.z);
        let half = FieldView::new(grid, &distances).unwrap().resample([2, 3, 1], &Progress::new()).unwrap();
        for y in 0..3 {
            for x in 0..2 {
                let mut sum = 0.0;
                for corner in 0..8 {
                    sum += distances[grid.offset(2 * x + (corner & 1), 2 * y + (corner >> 1 & 1), corner >> 2)];
                }
                // Values are below 6, and seven interpolations have two roundings each.
                assert!((half[x + 2 * y] - sum / 8.0).abs() <= 6.0 * 14.0 * f32::EPSILON);
            }
        }
    }

    #[test]
    fn every_value_is_the_sampled_field() {
        let source = grid([5, 4, 3]);
        let distances = fill(&source, |p| (7.0 * p.x).sin() + (3.0 * p.y).cos() * p.z);
        let field = FieldView::new(source, &distances).unwrap();
        let target = grid([7, 2, 11]);
        let values = field.resample(target.shape, &Progress::new()).unwrap();
        let expected = fill(&target, |p| field.sample_linear(p) as f64);
        for (value, expected) in values.iter().zip(expected) {
            assert!((value - expected).abs() <= 6.0 * 14.0 * f32::EPSILON);
        }
    }

    #[test]
    fn the_same_shape_returns_the_same_bytes() {
        let grid = grid([5, 4, 3]);
        let distances = fill(&grid, |p| p.length().sin());
        assert_eq!(FieldView::new(grid, &distances).unwrap().resample([5, 4, 3], &Progress::new()).unwrap(), distances);
    }

    #[test]
    fn an_empty_shape_is_refused() {
        let grid = grid([1, 1, 1]);
        assert!(FieldView::new(grid, &[1.0]).unwrap().resample([2, 0, 2], &Progress::new()).is_err());
    }
}
