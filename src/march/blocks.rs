//! Fields divided into cubic blocks of cells, for ray marching.
//!
//! Cell -1 of the grid is the first cell of block 0. [`super::empty`] gives the distance that a ray may leap; elsewhere
//! the ray visits the cells of a block one by one. An implementation states which of its blocks and cells may contain a
//! surface, and the corners of these cells.

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
    /// Data of the blocks from the signs of all samples, computed once.
    type Signs: std::fmt::Debug + Clone + Send + Sync;

    /// The data of the blocks. Fails if a sample that was not checked before is not finite or too large.
    fn signs(&self, progress: &Progress) -> Result<Self::Signs, Error>;

    /// Whether each block, x fastest, has a corner that is <= 0.
    fn occupied(&self, signs: &Self::Signs) -> Vec<bool>;

    /// The cells of a block that contains a surface.
    fn block<'b>(&'b self, signs: &'b Self::Signs, index: [i32; 3]) -> Self::Block<'b>;

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
    /// The cells of a cube that may contain a root. `side` is the number of cells along its sides, a divisor of the
    /// side of the block, and divides the index `first` of its first cell.
    fn occupancy(&self, first: [i32; 3], side: i32) -> Occupancy;
}

/// The cells of a cube that may contain a root.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Occupancy {
    Empty,
    /// Some cells, or an unknown number.
    Mixed,
    /// All cells.
    Full,
}

/// Largest magnitude of a field value. The coefficients of a cell's cubic are up to ten times as large.
pub(crate) const LARGEST_VALUE: f32 = 1e37;

/// Side of a block of a dense field, voxels.
const SIDE: usize = 4;

/// The cells of a dense block with a corner that is <= 0: bit x + 4 y + 16 z.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct BlockMask(u64);

impl<T: Texel> Blocks for FieldView<'_, T> {
    const SIDE: i32 = SIDE as i32;
    type Block<'b>
        = DenseBlock<'b, T>
    where
        Self: 'b;
    type Signs = Vec<BlockMask>;

    fn signs(&self, progress: &Progress) -> Result<Vec<BlockMask>, Error> {
        let [bx, by, bz] = self.block_counts();
        let grid = *self.grid();
        let [nx, ny, nz] = grid.shape;
        let mut masks = vec![BlockMask::default(); bx * by * bz];
        masks.par_chunks_mut(bx * by).enumerate().try_for_each(|(z_block, slice)| {
            progress.check()?;
            let mut row = vec![0.0; nx];
            let mut cells = vec![0; (nx + 1).div_ceil(64)];
            // The corners of the block's cells along z.
            for z in (z_block * SIDE).saturating_sub(1)..(z_block * SIDE + SIDE).min(nz) {
                let layers = around_sample(z, z_block, SIDE * SIDE);
                for y in 0..ny {
                    let texels = &self.texels()[grid.offset(0, y, z)..][..nx];
                    for (value, texel) in row.iter_mut().zip(texels) {
                        *value = texel.decode(self.scale());
                    }
                    check_row(&row, y, z)?;
                    cells_beside(texels, &mut cells);
                    for y_block in y / SIDE..=(y + 1) / SIDE {
                        let rows = layers * around_sample(y, y_block, SIDE);
                        let masks = &mut slice[y_block * bx..][..bx];
                        for (masks, &cells) in masks.chunks_mut(64 / SIDE).zip(&cells).filter(|(_, cells)| **cells != 0)
                        {
                            for (i, mask) in masks.iter_mut().enumerate() {
                                mask.0 |= (cells >> (SIDE * i) & 0xf) * rows;
                            }
                        }
                    }
                }
            }
            Ok::<(), Error>(())
        })?;
        Ok(masks)
    }

    fn occupied(&self, signs: &Vec<BlockMask>) -> Vec<bool> {
        signs.iter().map(|mask| mask.0 != 0).collect()
    }

    #[inline]
    fn block<'b>(&'b self, signs: &'b Vec<BlockMask>, index: [i32; 3]) -> DenseBlock<'b, T> {
        DenseBlock::new(*self, signs, index)
    }
}

/// A bit for each layer of cells in a block beside the layer of samples `i`: cells i - 1 and i. The bits of
/// neighbouring layers are `step` apart.
fn around_sample(i: usize, block: usize, step: usize) -> u64 {
    // The first cell of block 0 is cell -1.
    (i..i + 2).filter(|&cell| cell / SIDE == block).map(|cell| 1 << (cell % SIDE * step)).sum()
}

/// Bits of the cells of a row, from cell -1, beside a sample that is not above zero.
fn cells_beside<T: Texel>(texels: &[T], cells: &mut [u64]) {
    let mut carry = 0;
    for (i, cells) in cells.iter_mut().enumerate() {
        let texels = &texels[(64 * i).min(texels.len())..];
        let mut bytes = [0u8; 64];
        for (byte, texel) in bytes.iter_mut().zip(texels) {
            *byte = u8::from(!texel.is_above_zero());
        }
        let mut bits = 0;
        for (j, bytes) in bytes.chunks_exact(8).enumerate() {
            // The product has bit 8 k of the factor, which is byte k, at bit 56 + k.
            let bytes = bytes.iter().rev().fold(0, |word, &byte| word << 8 | u64::from(byte));
            bits |= (bytes.wrapping_mul(0x0102_0408_1020_4080) >> 56) << (8 * j);
        }
        *cells = bits | bits << 1 | carry;
        carry = bits >> 63;
    }
}

/// A block of a dense field. Its cells are single voxels.
#[derive(Debug, Clone, Copy)]
pub struct DenseBlock<'a, T = f32> {
    field: FieldView<'a, T>,
    mask: BlockMask,
    origin: [i32; 3],
}

impl<'a, T: Texel> DenseBlock<'a, T> {
    #[inline]
    pub fn new(field: FieldView<'a, T>, signs: &[BlockMask], [x, y, z]: [i32; 3]) -> Self {
        let [bx, by, _] = field.block_counts();
        let mask = signs[x as usize + bx * (y as usize + by * z as usize)];
        Self { field, mask, origin: [x, y, z].map(FieldView::<T>::first_cell) }
    }
}

impl<T: Texel> Block for DenseBlock<'_, T> {
    #[inline]
    fn origin(&self) -> [i32; 3] {
        self.origin
    }

    #[inline]
    fn cell_shift(&self) -> u32 {
        0
    }

    #[inline]
    fn contains(&self, _: usize, cell: i32) -> bool {
        (0..SIDE as i32).contains(&cell)
    }

    #[inline]
    fn corners_around_root(&self, [x, y, z]: [i32; 3]) -> Option<[f32; 8]> {
        let may_contain_root = self.mask.0 >> ((x + 4 * y + 16 * z) & 63) & 1 == 1;
        may_contain_root.then(|| self.field.corners(IVec3::from(self.origin) + IVec3::new(x, y, z)))
    }

    #[inline]
    fn occupancy(&self, [x, y, z]: [i32; 3], side: i32) -> Occupancy {
        // The cells of the cube at the origin.
        let cube = match side {
            1 => 1,
            2 => 0x0033_0033,
            _ => u64::MAX,
        };
        match self.mask.0 >> ((x + 4 * y + 16 * z) & 63) & cube {
            0 => Occupancy::Empty,
            cells if cells == cube => Occupancy::Full,
            _ => Occupancy::Mixed,
        }
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
    use super::*;
    use crate::grid::Grid;
    use crate::march::empty::{EmptySpace, MAX_DISTANCE};
    use glam::DVec3;
    use proptest::prelude::*;

    fn empty_space(field: &FieldView<'_>) -> Result<EmptySpace, Error> {
        let progress = Progress::new();
        EmptySpace::new(field.block_counts(), &field.occupied(&field.signs(&progress)?), &progress)
    }

    fn grid(shape: [usize; 3]) -> Grid {
        Grid::new(DVec3::ZERO, DVec3::ONE, shape).unwrap()
    }

    proptest! {
        #[test]
        fn distances_are_those_of_brute_force(
            shape in (1..120usize, 1..20usize, 1..20usize),
            solid in prop::collection::vec((0..120usize, 0..20usize, 0..20usize), 0..4),
        ) {
            let grid = grid(shape.into());
            let mut values = vec![1.0; grid.len()];
            for (x, y, z) in solid {
                values[grid.offset(x % shape.0, y % shape.1, z % shape.2)] = -1.0;
            }
            let field = FieldView::new(grid, &values).unwrap();
            let empty = empty_space(&field).unwrap();
            let signs = field.signs(&Progress::new()).unwrap();

            let [nx, ny, nz] = grid.shape.map(|n| n as i32);
            let cells = |n: i32| -1..n;
            let mut occupied = Vec::new();
            for z in cells(nz) {
                for y in cells(ny) {
                    for x in cells(nx) {
                        let cell = IVec3::new(x, y, z);
                        let index = cell.to_array().map(<FieldView<'_> as Blocks>::block_of);
                        let block = field.block(&signs, index);
                        let local = cell - IVec3::from(block.origin());
                        let corners = field.corners(cell);
                        let may_contain_root = corners.iter().any(|&value| value <= 0.0);
                        let expected = may_contain_root.then_some(corners);
                        prop_assert_eq!(block.corners_around_root(local.to_array()), expected);
                        if may_contain_root {
                            occupied.push(IVec3::from(index));
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
