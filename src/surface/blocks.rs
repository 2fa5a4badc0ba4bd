//! A level set from blocks of samples, a few blocks at a time.

use super::cells::{Level, SurfaceCell, SurfaceCells, cells_of_block};
use super::{LevelSurface, check_level, check_shape};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::require;
use crate::progress::Progress;
use rayon::prelude::*;

/// Number of blocks whose cells are found between two checks of the free memory.
const BATCH: usize = 4096;

/// The crossed cells of blocks of samples. The samples themselves are not kept.
#[derive(Debug)]
pub struct SurfaceBlocks {
    grid: Grid,
    level: f32,
    cells: Vec<SurfaceCell>,
}

impl SurfaceBlocks {
    /// No blocks yet.
    pub fn new(grid: Grid, level: f32) -> Result<Self, Error> {
        check_level(level)?;
        check_shape(grid.shape)?;
        Ok(Self { grid, level, cells: Vec::new() })
    }

    /// Adds blocks. Block `b` has `side`^3 cells from cell `origins[b]` on, and `(side + 1)^3` samples, x fastest, from
    /// `values[b * (side + 1)^3]` on; a sample outside the grid repeats the nearest one of the grid. The blocks of all
    /// calls must not overlap, and hold every cell that the surface passes through.
    pub fn add(&mut self, side: usize, origins: &[[i32; 3]], values: &[f32]) -> Result<(), Error> {
        let samples = (side + 1).pow(3);
        if values.len() != origins.len() * samples {
            let problem = format!("{} blocks need {samples} values each, got {}", origins.len(), values.len());
            return Err(ArgumentError::new("values", problem).into());
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Err(ArgumentError::new("values", "must be finite").into());
        }
        let (shape, level) = (self.grid.shape.map(|n| n as i32), Level::new(self.level, &self.grid));
        let blocks = origins.par_iter().zip(values.par_chunks_exact(samples));
        let cells = blocks.flat_map_iter(|(&origin, values)| cells_of_block(shape, side, origin, values, level));
        self.cells.append(&mut cells.collect());
        Ok(())
    }

    /// As [`Self::add`], with samples that `fill` writes for the block at an origin. `init` makes its first argument,
    /// one for each thread.
    pub(crate) fn add_evaluated<S>(
        &mut self,
        side: usize,
        origins: &[[i32; 3]],
        init: impl Fn() -> S + Sync + Send,
        fill: impl Fn(&mut S, [i32; 3], &mut [f32]) + Sync + Send,
        progress: &Progress,
    ) -> Result<(), Error> {
        let (shape, level) = (self.grid.shape.map(|n| n as i32), Level::new(self.level, &self.grid));
        progress.set_total(origins.len() as u64);
        for origins in origins.chunks(BATCH) {
            let blocks = origins.par_iter().map_init(
                || (init(), vec![0.0; (side + 1).pow(3)]),
                |(state, samples), &origin| {
                    fill(state, origin, samples);
                    if samples.iter().any(|value| !value.is_finite()) {
                        return Err(ArgumentError::new("values", "must be finite").into());
                    }
                    let cells = cells_of_block(shape, side, origin, samples, level);
                    progress.advance(1).map(|()| cells)
                },
            );
            let cells: Vec<Vec<SurfaceCell>> = blocks.collect::<Result<_, Error>>()?;
            self.reserve(cells.iter().map(Vec::len).sum())?;
            self.cells.extend(cells.into_iter().flatten());
        }
        Ok(())
    }

    /// Reserves space for `count` more cells, or fails if the machine does not have the memory.
    fn reserve(&mut self, count: usize) -> Result<(), Error> {
        let (wanted, space) = (self.cells.len() + count, self.cells.capacity());
        if wanted > space {
            // The new array exists beside the old one while the cells are copied, and is at least twice as long.
            let bytes = wanted.max(2 * space) * size_of::<SurfaceCell>();
            require("the cells of a surface", bytes as u64, 0)?;
            self.cells.reserve(count);
        }
        Ok(())
    }

    /// The surface in all blocks.
    pub fn surface(self) -> LevelSurface {
        LevelSurface::new(&self.grid, SurfaceCells::sorted(self.grid.shape.map(|n| n as i32), self.cells))
    }
}
