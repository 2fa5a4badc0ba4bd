//! A baked field as a leaf, which combines a mesh with primitives.
//!
//! Inside the box of its grid the field is the trilinear one, cut by the box: `max(field, distance to the faces)`, so
//! the box closes a surface that it cuts. Outside, at distance `a` from the box, it is `sqrt(a^2 + max(0, s)^2)`, where
//! `s` is the field at the nearest point of the box. Together this is continuous, and it has the Lipschitz constant of
//! the trilinear field: outside, the gradient is a mean of the unit vector away from the box and the gradient along it,
//! which are perpendicular.
//!
//! Linear interpolation smooths the crease of a distance where the nearest point changes from one part of a surface to
//! another. The cells of such places may be divided into [`PARTS`] along each axis ([`DividedCells`]).

use crate::error::{ArgumentError, Error};
use crate::gpu::constants::csg_leaves::CELL_PARTS;
use crate::grid::Grid;
use crate::memory::zeroed_rows;
use crate::volume::FieldView;
use glam::DVec3;

/// Number of parts of a divided cell along each axis.
pub(crate) const PARTS: usize = CELL_PARTS;
/// Number of samples of a divided cell.
pub(crate) const PART_SAMPLES: usize = (PARTS + 1).pow(3);

/// Finer samples in some of the cells between the centres of voxels.
#[derive(Debug, Default, PartialEq)]
pub struct DividedCells {
    /// For each cell, x fastest, the number of its block plus one, or 0. Empty if no cell is divided.
    blocks: Vec<u32>,
    /// [`PART_SAMPLES`] of each block, x fastest, from the first corner of the cell to the last one.
    samples: Vec<f32>,
}

impl DividedCells {
    /// Blocks of samples for cells, which are numbered with x fastest.
    pub fn new(grid: &Grid, cells: &[usize], samples: Vec<f32>) -> Result<Self, Error> {
        if samples.len() != cells.len() * PART_SAMPLES {
            let problem = format!("has {} numbers, expected {PART_SAMPLES} for each cell", samples.len());
            return Err(ArgumentError::new("samples", problem).into());
        }
        if cells.is_empty() {
            return Ok(Self::default());
        }
        let count = grid.shape.map(|n| n.saturating_sub(1)).iter().product();
        let mut blocks = zeroed_rows::<u32>("cells", count)?;
        for (block, &cell) in cells.iter().enumerate() {
            let Some(place) = blocks.get_mut(cell) else {
                return Err(ArgumentError::new("cells", format!("has {cell}, but the grid has {count} cells")).into());
            };
            if *place != 0 {
                return Err(ArgumentError::new("cells", format!("has {cell} twice")).into());
            }
            *place = block as u32 + 1;
        }
        Ok(Self { blocks, samples })
    }

    /// The samples of a cell, if it is divided.
    #[inline(always)]
    pub fn samples_of(&self, cell: usize) -> Option<&[f32; PART_SAMPLES]> {
        let block = self.blocks.get(cell)?.checked_sub(1)? as usize;
        self.samples.as_chunks().0.get(block)
    }

    pub fn blocks(&self) -> &[u32] {
        &self.blocks
    }

    pub fn samples(&self) -> &[f32] {
        &self.samples
    }
}

/// Distances on a grid, x fastest, in their own units.
#[derive(Debug, PartialEq)]
pub struct VolumeLeaf {
    grid: Grid,
    distances: Vec<f32>,
    divided: DividedCells,
    lipschitz: f64,
    /// Box of the surface: no cell outside it has a sample at or below zero.
    surface: [DVec3; 2],
    /// Largest difference between the field and the distance in the box, world units; None if the samples may be no
    /// distances.
    error: Option<f64>,
}

impl VolumeLeaf {
    pub fn new(grid: Grid, distances: Vec<f32>, divided: DividedCells, error: Option<f64>) -> Result<Self, Error> {
        FieldView::new(grid, &distances)?;
        for samples in [&distances, &divided.samples] {
            if let Some(i) = samples.iter().position(|d| !d.is_finite()) {
                let problem = format!("sample {i} is {}, expected a number", samples[i]);
                return Err(ArgumentError::new("volume", problem).into());
            }
        }
        let [nx, ny, nz] = grid.shape;
        let h = grid.spacing();
        let (mut low, mut high) = ([usize::MAX; 3], [0usize; 3]);
        let mut steepest = [0f64; 3];
        for z in 0..nz {
            for y in 0..ny {
                for x in 0..nx {
                    let here = distances[grid.offset(x, y, z)];
                    if here <= 0.0 {
                        for (axis, i) in [x, y, z].into_iter().enumerate() {
                            low[axis] = low[axis].min(i);
                            high[axis] = high[axis].max(i);
                        }
                    }
                    for (axis, next) in [(x + 1, y, z), (x, y + 1, z), (x, y, z + 1)].into_iter().enumerate() {
                        if next.0 < nx && next.1 < ny && next.2 < nz {
                            let there = distances[grid.offset(next.0, next.1, next.2)];
                            steepest[axis] = steepest[axis].max((f64::from(there) - f64::from(here)).abs());
                        }
                    }
                }
            }
        }
        let cells = grid.shape.map(|n| n.saturating_sub(1));
        let divided_cells = (0..divided.blocks.len()).filter_map(|cell| Some((cell, divided.samples_of(cell)?)));
        for (cell, samples) in divided_cells {
            let first = [cell % cells[0], cell / cells[0] % cells[1], cell / cells[0] / cells[1]];
            if samples.iter().any(|sample| *sample <= 0.0) {
                for axis in 0..3 {
                    low[axis] = low[axis].min(first[axis]);
                    high[axis] = high[axis].max(first[axis] + 1);
                }
            }
            for (axis, step) in [1, PARTS + 1, (PARTS + 1).pow(2)].into_iter().enumerate() {
                for (i, here) in samples.iter().enumerate().filter(|(i, _)| i / step % (PARTS + 1) < PARTS) {
                    let change = (f64::from(samples[i + step]) - f64::from(*here)).abs();
                    steepest[axis] = steepest[axis].max(change * PARTS as f64);
                }
            }
        }
        // Each derivative of the trilinear field is a mean of differences along its axis.
        let lipschitz = (DVec3::from_array(steepest) / h).length().max(1.0);
        let surface = if low[0] == usize::MAX {
            // Nothing is inside: the box is empty, and so is the leaf.
            let middle = 0.5 * (grid.lower + grid.upper);
            [middle, middle]
        } else {
            let centre = |i: [usize; 3]| grid.center(i[0], i[1], i[2]);
            // The surface ends before the next centre, which is outside.
            [(centre(low) - h).max(grid.lower), (centre(high) + h).min(grid.upper)]
        };
        Ok(Self { grid, distances, divided, lipschitz, surface, error })
    }

    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    pub fn distances(&self) -> &[f32] {
        &self.distances
    }

    pub fn divided(&self) -> &DividedCells {
        &self.divided
    }

    pub fn error(&self) -> Option<f64> {
        self.error
    }

    pub fn lipschitz(&self) -> f64 {
        self.lipschitz
    }

    pub fn support(&self, n: DVec3) -> f64 {
        let [low, high] = self.surface;
        (n * low).max(n * high).element_sum()
    }

    /// Largest distance from the box of the surface to the box of the grid. Between them the field may have any value,
    /// unless it is a distance with a known error.
    pub fn slack(&self) -> f64 {
        if let Some(error) = self.error {
            return error;
        }
        let [low, high] = self.surface;
        (low - self.grid.lower).max(self.grid.upper - high).max_element()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distance from the plane x = -0.8 on a grid of three voxels of side 1.
    fn leaf(cells: &[usize], samples: Vec<f32>) -> Result<VolumeLeaf, Error> {
        let grid = Grid::new(DVec3::ZERO, DVec3::splat(3.0), [3; 3]).unwrap();
        let distances = (0..27).map(|i| (i % 3) as f32 + 0.5 + 0.8).collect();
        VolumeLeaf::new(grid, distances, DividedCells::new(&grid, cells, samples)?, None)
    }

    #[test]
    fn divided_cells_must_fit_the_grid() {
        let message = |cells: &[usize], samples| leaf(cells, samples).unwrap_err().to_string();
        assert!(leaf(&[0, 7], vec![1.0; 250]).is_ok());
        assert!(message(&[8], vec![1.0; 125]).contains("has 8, but the grid has 8 cells"));
        assert!(message(&[usize::MAX], vec![1.0; 125]).contains("but the grid has 8 cells"));
        assert!(message(&[1, 1], vec![1.0; 250]).contains("has 1 twice"));
        assert!(message(&[1], vec![1.0; 124]).contains("has 124 numbers, expected 125 for each cell"));
        assert!(message(&[], vec![1.0; 125]).contains("has 125 numbers"));
        assert!(message(&[1], vec![f32::NAN; 125]).contains("sample 0 is NaN"));
    }

    #[test]
    fn bounds_include_the_samples_of_divided_cells() {
        // All corners are outside, and one sample of the cell of the largest indices is inside.
        let mut samples = vec![1.0; PART_SAMPLES];
        samples[62] = -0.5;
        let whole = leaf(&[], Vec::new()).unwrap();
        let divided = leaf(&[7], samples).unwrap();
        assert_eq!(whole.support(DVec3::X), 1.5);
        assert_eq!([DVec3::X, DVec3::NEG_X].map(|n| divided.support(n)), [3.0, -0.5]);
        // The steps in the cell are a quarter of a voxel.
        assert_eq!(whole.lipschitz(), 1.0);
        assert!((divided.lipschitz() - 3f64.sqrt() * 4.0 * 1.5).abs() <= 1e-12);
    }
}
