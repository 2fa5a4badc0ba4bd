//! Fields divided into cubic blocks of cells, for ray marching.
//!
//! Cell -1 of the grid is the first cell of block 0. [`super::empty`] gives the distance that a ray may leap; elsewhere
//! the ray visits the cells of a block one by one. An implementation states which of its blocks contain a surface, and
//! the corners of their cells.

use crate::error::{ArgumentError, Error};
use crate::progress::Progress;
use crate::volume::{FieldView, Texel, Trilinear};
use glam::IVec3;
use rayon::prelude::*;

/// A field whose blocks have the same number of voxels along each side.
pub trait Blocks: Trilinear {
    /// Side of a block, voxels.
    const SIDE: i32;
    type Block<'b>: Block
    where
        Self: 'b;

    /// Whether each block, x fastest, has a corner that is <= 0. Fails if a value is not finite or too large.
    fn occupied(&self, progress: &Progress) -> Result<Vec<bool>, Error>;

    /// The cells of a block that contains a surface.
    fn block(&self, index: [i32; 3]) -> Self::Block<'_>;

    /// Number of blocks along each axis. The cells run from -1 to n - 1: n + 1 cells.
    fn block_counts(&self) -> [usize; 3] {
        self.grid().shape.map(|n| (n + 1).div_ceil(Self::SIDE as usize))
    }

    /// Index of the block that contains a cell, along one axis.
    #[inline]
    fn block_of(cell: i32) -> i32 {
        // Cells below the grid belong to block -1.
        (cell + 1).div_euclid(Self::SIDE)
    }

    /// Index of the first cell of a block along one axis, for blocks outside the grid too.
    #[inline]
    fn first_cell(block: i32) -> i32 {
        block * Self::SIDE - 1
    }
}

/// A cube of cells of equal size.
pub trait Block {
    /// Grid coordinates of the lower corner of cell 0 of the block.
    fn origin(&self) -> [i32; 3];
    /// log2 of the side of a cell, voxels.
    fn cell_shift(&self) -> u32;
    /// Whether the block has cells at this index along an axis.
    fn contains(&self, axis: usize, cell: i32) -> bool;
    /// The samples at the corners of a cell that may contain a root; None if all are above zero.
    fn corners_around_root(&self, cell: [i32; 3]) -> Option<[f32; 8]>;
}

/// Largest magnitude of a field value. The coefficients of a cell's cubic are up to ten times as large.
pub(super) const LARGEST_VALUE: f32 = 1e37;

impl<T: Texel> Blocks for FieldView<'_, T> {
    const SIDE: i32 = 4;
    type Block<'b>
        = DenseBlock<'b, T>
    where
        Self: 'b;

    fn occupied(&self, progress: &Progress) -> Result<Vec<bool>, Error> {
        let [bx, by, bz] = self.block_counts();
        let side = Self::SIDE as usize;
        let grid = *self.grid();
        let mut occupied = vec![false; bx * by * bz];
        occupied.par_chunks_mut(bx * by).enumerate().try_for_each(|(z_block, slice)| {
            progress.check()?;
            let mut row = vec![0.0; grid.shape[0]];
            // Voxels that are corners of the block's cells: from one before the upper corner of its first cell to its
            // end.
            let voxels = |block: usize, n: usize| (block * side).saturating_sub(1)..(block * side + side).min(n);
            for y_block in 0..by {
                let row_of_blocks = &mut slice[y_block * bx..][..bx];
                for z in voxels(z_block, grid.shape[2]) {
                    for y in voxels(y_block, grid.shape[1]) {
                        let texels = &self.texels()[grid.offset(0, y, z)..][..grid.shape[0]];
                        for (value, texel) in row.iter_mut().zip(texels) {
                            *value = texel.decode(self.scale());
                        }
                        check_row(&row, y, z)?;
                        for (x_block, occupied) in row_of_blocks.iter_mut().enumerate() {
                            let lowest = row[voxels(x_block, row.len())].iter().copied().fold(f32::INFINITY, f32::min);
                            *occupied |= lowest <= 0.0;
                        }
                    }
                }
            }
            Ok::<(), Error>(())
        })?;
        Ok(occupied)
    }

    #[inline]
    fn block(&self, index: [i32; 3]) -> DenseBlock<'_, T> {
        DenseBlock::new(*self, index)
    }
}

impl<'a, T: Texel> DenseBlock<'a, T> {
    pub fn new(field: FieldView<'a, T>, index: [i32; 3]) -> Self {
        Self { field, index }
    }
}

/// A block of a dense field. Its cells are single voxels with the indices of the grid.
#[derive(Debug, Clone, Copy)]
pub struct DenseBlock<'a, T = f32> {
    field: FieldView<'a, T>,
    index: [i32; 3],
}

impl<T: Texel> Block for DenseBlock<'_, T> {
    #[inline]
    fn origin(&self) -> [i32; 3] {
        [0; 3]
    }

    #[inline]
    fn cell_shift(&self) -> u32 {
        0
    }

    #[inline]
    fn contains(&self, axis: usize, cell: i32) -> bool {
        FieldView::<T>::block_of(cell) == self.index[axis]
    }

    #[inline]
    fn corners_around_root(&self, cell: [i32; 3]) -> Option<[f32; 8]> {
        let texels = self.field.texels_around(IVec3::from(cell));
        let all_above_zero = texels.iter().fold(true, |all, texel| all & texel.is_above_zero());
        if all_above_zero { None } else { Some(self.field.decode(texels)) }
    }
}

fn check_row(row: &[f32], y: usize, z: usize) -> Result<(), Error> {
    if row.iter().fold(true, |fine, value| fine & (value.abs() <= LARGEST_VALUE)) {
        return Ok(());
    }
    let x = row.iter().position(|value| value.is_nan() || value.abs() > LARGEST_VALUE).unwrap_or(0);
    let problem = format!("[{x}, {y}, {z}] is {}; every distance must be finite, at most {LARGEST_VALUE:e}", row[x]);
    Err(ArgumentError::new("distances", problem).into())
}

#[cfg(test)]
mod tests {
    use super::super::empty::{EmptySpace, MAX_DISTANCE};
    use super::*;
    use crate::grid::Grid;
    use glam::DVec3;
    use proptest::prelude::*;

    fn empty_space(field: &FieldView<'_>) -> Result<EmptySpace, Error> {
        let progress = Progress::new();
        EmptySpace::new(field.block_counts(), &field.occupied(&progress)?, &progress)
    }

    fn grid(shape: [usize; 3]) -> Grid {
        Grid::new(DVec3::ZERO, DVec3::ONE, shape).unwrap()
    }

    proptest! {
        #[test]
        fn distances_are_those_of_brute_force(
            shape in prop::array::uniform3(1..20usize),
            solid in prop::collection::vec(prop::array::uniform3(0..20usize), 0..4),
        ) {
            let grid = grid(shape);
            let mut values = vec![1.0; grid.len()];
            for [x, y, z] in solid {
                values[grid.offset(x % shape[0], y % shape[1], z % shape[2])] = -1.0;
            }
            let field = FieldView::new(grid, &values).unwrap();
            let empty = empty_space(&field).unwrap();

            let [nx, ny, nz] = shape.map(|n| n as i32);
            let cells = |n: i32| -1..n;
            let mut occupied = Vec::new();
            for z in cells(nz) {
                for y in cells(ny) {
                    for x in cells(nx) {
                        let cell = IVec3::new(x, y, z);
                        if field.corners(cell).iter().any(|&value| value <= 0.0) {
                            occupied.push(IVec3::from(cell.to_array().map(<FieldView<'_> as Blocks>::block_of)));
                        }
                    }
                }
            }
            for z in cells(nz) {
                for y in cells(ny) {
                    for x in cells(nx) {
                        let block = IVec3::from([x, y, z].map(<FieldView<'_> as Blocks>::block_of));
                        let nearest = occupied.iter().map(|other| (block - other).abs().max_element()).min();
                        prop_assert_eq!(empty.distance(block.to_array()), nearest.unwrap_or(MAX_DISTANCE as i32));
                    }
                }
            }
        }
    }

    #[test]
    fn values_that_are_not_finite_are_named() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2e37] {
            let values = [1.0, 1.0, 1.0, bad];
            let field = FieldView::new(grid([2, 2, 1]), &values).unwrap();
            let message = empty_space(&field).unwrap_err().to_string();
            assert!(message.starts_with("distances: [1, 1, 0] is "), "{message}");
        }
    }
}
