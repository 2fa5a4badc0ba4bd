//! A sparse field for ray marching: masks of the cells of its bricks that can contain a root.
//!
//! A stored brick has 7^3 cells. In most of the cells that a ray visits all corners are above zero. One bit per cell,
//! computed once from the signs of the samples, records this: 64 bytes per brick, one cache line, whereas the samples
//! of a cell lie in two to four lines. Samples are therefore decoded only where a root may lie.

use super::blocks::{Block, Blocks, LARGEST_VALUE, Occupancy};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::sparse::{BRICK_CELLS, BRICK_LEN, BRICK_SAMPLES, Brick, Entry, SparseView};
use crate::volume::{Cell, Texel, Trilinear};
use glam::{DVec3, IVec3};
use rayon::prelude::*;

/// The cells of a brick with a corner that is <= 0. One word per layer along z; the last word is unused. Bit x + 8 y of
/// a word is cell (x, y); bits 7, 15, ... and 56 to 63 are unused.
#[derive(Debug, Clone, Copy)]
#[repr(align(64))]
pub(crate) struct CellMask([u64; BRICK_SAMPLES]);

/// The bits of a layer that represent cells: seven bits in each of seven rows.
const CELLS_OF_LAYER: u64 = 0x007f_7f7f_7f7f_7f7f;

impl CellMask {
    fn of_brick<T: Texel>(texels: &[T]) -> Self {
        let mut layers = [0; BRICK_SAMPLES];
        for (bits, texels) in layers.iter_mut().zip(texels.chunks_exact(BRICK_SAMPLES * BRICK_SAMPLES)) {
            for (i, texel) in texels.iter().enumerate() {
                *bits |= u64::from(!texel.is_above_zero()) << i;
            }
            // Spreads the bits of samples to the cells of which they are corners, along x and y.
            *bits |= *bits >> 1;
            *bits |= *bits >> BRICK_SAMPLES;
        }
        let mut cells = [0; BRICK_SAMPLES];
        for z in 0..BRICK_CELLS {
            cells[z] = (layers[z] | layers[z + 1]) & CELLS_OF_LAYER;
        }
        Self(cells)
    }

    fn any(&self) -> bool {
        self.0.iter().any(|&layer| layer != 0)
    }

    #[inline]
    fn contains(&self, [x, y, z]: [i32; 3]) -> bool {
        self.0[z as usize % BRICK_SAMPLES] >> (x + BRICK_SAMPLES as i32 * y) & 1 == 1
    }
}

/// A sparse field and the masks of its cells that can contain a root.
#[derive(Debug)]
pub(crate) struct MaskedBricks<'a, T> {
    view: SparseView<'a, T>,
    /// One mask per stored brick.
    masks: Vec<CellMask>,
}

impl<'a, T: Texel> MaskedBricks<'a, T> {
    pub(crate) fn view(&self) -> &SparseView<'a, T> {
        &self.view
    }

    /// Fails if a sample is not finite or too large.
    pub(crate) fn new(view: SparseView<'a, T>, progress: &Progress) -> Result<Self, Error> {
        let masks = view
            .texels()
            .par_chunks_exact(BRICK_LEN)
            .enumerate()
            .map(|(i, texels)| {
                check_brick(texels, view.scale(), i)?;
                Ok(CellMask::of_brick(texels))
            })
            .collect::<Result<_, Error>>()?;
        progress.check()?;
        Ok(Self { view, masks })
    }
}

/// Fails if a sample is not finite or too large.
fn check_brick<T: Texel>(texels: &[T], scale: f32, number: usize) -> Result<(), Error> {
    // The magnitude of integers is at most the scale.
    if T::ENCODING.is_normalised() && scale <= LARGEST_VALUE {
        return Ok(());
    }
    let is_fine = |texel: &T| texel.decode(scale).abs() <= LARGEST_VALUE;
    if texels.iter().fold(true, |fine, texel| fine & is_fine(texel)) {
        return Ok(());
    }
    let bad = texels.iter().find(|&texel| !is_fine(texel)).map_or(f32::NAN, |texel| texel.decode(scale));
    let problem = format!("[{number}] holds {bad}; every distance must be finite, at most {LARGEST_VALUE:e}");
    Err(ArgumentError::new("bricks", problem).into())
}

impl<T: Texel> Trilinear for MaskedBricks<'_, T> {
    fn grid(&self) -> &Grid {
        self.view.grid()
    }

    #[inline]
    fn cell(&self, index: IVec3) -> Cell {
        self.view.cell(index)
    }

    fn sample_linear(&self, p: DVec3) -> f32 {
        self.view.sample_linear(p)
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        self.view.distance_bound(p, inner)
    }
}

impl<T: Texel> Blocks for MaskedBricks<'_, T> {
    const SIDE: i32 = BRICK_CELLS as i32;
    type Block<'b>
        = MaskedBrick<'b, T>
    where
        Self: 'b;
    type Signs = ();

    fn signs(&self, _: &Progress) -> Result<(), Error> {
        Ok(())
    }

    fn occupied(&self, (): &()) -> Vec<bool> {
        let is_occupied: Vec<bool> = self.masks.iter().map(CellMask::any).collect();
        let entry = |&word: &u32| match Entry::from_word(word) {
            Entry::Stored { brick, .. } => is_occupied[brick as usize],
            Entry::Empty { inside } => inside,
        };
        self.view.index().iter().map(entry).collect()
    }

    #[inline]
    fn block<'b>(&'b self, (): &'b (), index: [i32; 3]) -> MaskedBrick<'b, T> {
        match self.view.entry(index) {
            Entry::Stored { level, brick } => {
                MaskedBrick::Stored { mask: &self.masks[brick as usize], brick: self.view.brick(index, level, brick) }
            }
            Entry::Empty { .. } => MaskedBrick::Inside { first: index.map(Self::first_cell) },
        }
    }
}

/// A block of a sparse field: a stored brick, or a brick that lies inside completely.
#[derive(Debug, Clone, Copy)]
pub(crate) enum MaskedBrick<'a, T> {
    Stored { mask: &'a CellMask, brick: Brick<'a, T> },
    Inside { first: [i32; 3] },
}

impl<T: Texel> Block for MaskedBrick<'_, T> {
    #[inline]
    fn origin(&self) -> [i32; 3] {
        match self {
            Self::Stored { brick, .. } => brick.origin,
            Self::Inside { first } => *first,
        }
    }

    #[inline]
    fn cell_shift(&self) -> u32 {
        match self {
            Self::Stored { brick, .. } => brick.level,
            Self::Inside { .. } => 0,
        }
    }

    #[inline]
    fn contains(&self, _: usize, cell: i32) -> bool {
        (0..BRICK_CELLS as i32).contains(&cell)
    }

    #[inline]
    fn corners_around_root(&self, cell: [i32; 3]) -> Option<[f32; 8]> {
        match self {
            Self::Stored { mask, brick } => mask.contains(cell).then(|| brick.corners(cell)),
            Self::Inside { .. } => Some([-1.0; 8]),
        }
    }

    /// Stored bricks are not divided, because their side of 7 cells is odd.
    #[inline]
    fn occupancy(&self, _: [i32; 3], _: i32) -> Occupancy {
        match self {
            Self::Stored { .. } => Occupancy::Mixed,
            Self::Inside { .. } => Occupancy::Full,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use half::f16;
    use proptest::prelude::*;

    /// Compares every cell with its samples.
    fn check<T: Texel>(values: &[f32]) {
        let texels: Vec<T> = values.iter().map(|&value| T::encode(value, 1.0)).collect();
        let mask = CellMask::of_brick(&texels);
        let mut occupied = false;
        for z in 0..BRICK_CELLS {
            for y in 0..BRICK_CELLS {
                for x in 0..BRICK_CELLS {
                    let at = |i: usize| {
                        (x + (i & 1)) + BRICK_SAMPLES * ((y + (i >> 1 & 1)) + BRICK_SAMPLES * (z + (i >> 2)))
                    };
                    let expected = (0..8).any(|i| texels[at(i)].decode(1.0) <= 0.0);
                    assert_eq!(mask.contains([x, y, z].map(|i| i as i32)), expected);
                    occupied |= expected;
                }
            }
        }
        assert_eq!(mask.any(), occupied);
    }

    proptest! {
        #[test]
        fn a_mask_has_the_cells_with_a_corner_that_is_not_above_zero(
            below in prop::collection::vec((0..BRICK_LEN, -1.0..=0.0f32), 0..6),
            lift in 0.001..1.0f32,
        ) {
            let mut values = vec![lift; BRICK_LEN];
            for (i, value) in below {
                values[i] = value;
            }
            check::<f32>(&values);
            check::<f16>(&values);
            check::<i16>(&values);
            // Values below one step are stored as zero.
            check::<i8>(&values);
        }
    }

    #[test]
    fn samples_that_are_not_finite_are_named() {
        for bad in [f32::NAN, f32::INFINITY, -2e37] {
            let mut texels = [1.0; BRICK_LEN];
            texels[77] = bad;
            let told = check_brick(&texels, 1.0, 3).unwrap_err().to_string();
            assert!(told.starts_with("bricks: [3] holds "), "{told}");
        }
        let mut texels = [f16::ONE; BRICK_LEN];
        texels[500] = f16::NEG_INFINITY;
        assert!(check_brick(&texels, 1.0, 0).is_err());
        assert!(check_brick(&[127i8; BRICK_LEN], 1e38, 0).is_err());
        assert!(check_brick(&[1i8; BRICK_LEN], 1e36, 0).is_ok());
    }
}
