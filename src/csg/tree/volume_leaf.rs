//! A baked field as a leaf, which combines a mesh with primitives.
//!
//! Inside the box of its grid the field is the trilinear one, cut by the box: `max(field, distance to the faces)`, so
//! the box closes a surface that it cuts. Outside, at distance `a` from the box, it is `sqrt(a^2 + max(0, s)^2)`, where
//! `s` is the field at the nearest point of the box. Together this is continuous, and it has the Lipschitz constant of
//! the trilinear field: outside, the gradient is a mean of the unit vector away from the box and the gradient along it,
//! which are perpendicular.

use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::volume::FieldView;
use glam::DVec3;

/// Distances on a grid, x fastest, in their own units.
#[derive(Debug, PartialEq)]
pub struct VolumeLeaf {
    grid: Grid,
    distances: Vec<f32>,
    lipschitz: f64,
    /// Box of the surface: no cell outside it has a sample at or below zero.
    surface: [DVec3; 2],
    /// Largest difference between the field and the distance in the box, world units; None if the samples may be no
    /// distances.
    error: Option<f64>,
}

impl VolumeLeaf {
    pub fn new(grid: Grid, distances: Vec<f32>, error: Option<f64>) -> Result<Self, Error> {
        FieldView::new(grid, &distances)?;
        if let Some(i) = distances.iter().position(|d| !d.is_finite()) {
            return Err(
                ArgumentError::new("volume", format!("sample {i} is {}, expected a number", distances[i])).into()
            );
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
        Ok(Self { grid, distances, lipschitz, surface, error })
    }

    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    pub fn distances(&self) -> &[f32] {
        &self.distances
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
