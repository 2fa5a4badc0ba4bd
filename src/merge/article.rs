//! The aggregation of the article *Signed Distance Fields in Unity*, for comparison.
//!
//! At every cell and for every volume: inside the box the sample, outside it the distance to the nearest point of the
//! box plus the sample there; the result is the minimum over all volumes. By the triangle inequality the sum is never
//! below the distance, and almost always above it. The author's other construction, the circle in which two spheres
//! intersect, is `sphere_intersection` in Python. With the sphere of radius `s` around the nearest point and the plane
//! of the box it gives the bound `sqrt(a^2 + s^2)` of [`super::placed`].
//!
//! The article does not discuss scaled volumes. Here the sample is scaled by the mean stretch, the cube root of the
//! determinant.

use super::{Geometry, Placed};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use crate::volume::Trilinear;
use glam::DVec3;
use rayon::prelude::*;

/// The loop over all volumes at every sample.
pub fn merge_as_article(grid: &Grid, placed: &[Placed<'_>], progress: &Progress) -> Result<Vec<f32>, Error> {
    let [nx, ny, nz] = grid.shape;
    let mut distances = allocate_samples(&format!("a merged field of {:?} samples", grid.shape), grid.len(), 0)?;
    progress.set_total((ny * nz) as u64);
    distances.par_chunks_mut(nx).enumerate().try_for_each(|(row, values)| {
        for (x, value) in values.iter_mut().enumerate() {
            let p = grid.center(x, row % ny, row / ny);
            *value = placed.iter().map(|placed| value_at(placed, p)).fold(f64::INFINITY, f64::min) as f32;
        }
        progress.advance(1)
    })?;
    Ok(distances)
}

fn value_at(placed: &Placed<'_>, p: DVec3) -> f64 {
    match &placed.geometry {
        Geometry::Quadric(local) => local.distance_bound(p),
        Geometry::Volume { field, .. } => {
            let p_local = placed.local_from_world.transform_point3(p);
            let nearest = p_local.clamp(field.grid().lower, field.grid().upper);
            let to_box = placed.world_from_local.transform_vector3(p_local - nearest).length();
            let stretch = placed.world_from_local.matrix3.determinant().abs().cbrt();
            to_box + stretch * f64::from(field.sample_linear(nearest))
        }
    }
}
