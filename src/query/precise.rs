//! Signed distances in float64: magnitudes from the mesh's own positions, signs as in the float32 functions.

use super::{CHUNK, check_points, evaluate_in_order, prepare};
use crate::error::Error;
use crate::gpu::Place;
use crate::grid::Grid;
use crate::memory::zeroed_rows;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SignMethod, SignRule};
use glam::DVec3;
use rayon::prelude::*;

/// Slack of a float32 distance as a bound for the float64 search: relative, and local units for each local unit of the
/// largest coordinate. Ten times the error of a bake and of a device.
const BOUND_SLACK: (f64, f64) = (1e-5, 1e-5);

/// [`super::signed_distances`] in float64. A device finds a face, and the CPU searches again within its distance.
pub fn precise_signed_distances(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    method: SignMethod,
    progress: &Progress,
) -> Result<Vec<f64>, Error> {
    check_points(mesh, points)?;
    let choice = prepare(mesh, method);
    let ordered = evaluate_in_order(place, mesh, points, progress, |walk, p, row| {
        let closest = match walk.face_of_device(row) {
            Some(face) => exact_within(mesh, p, mesh.exact_point_on_face(face, p).distance),
            None => walk.exact_closest_point(p, row),
        };
        // These rules read the face that the float32 search chooses.
        let inside = match &choice.rule {
            SignRule::Pseudonormal | SignRule::Normal => choice.rule.is_inside(mesh, p, &mesh.closest_point(p)),
            rule => walk.is_inside(rule, p, &closest),
        };
        let unsigned = closest.distance * mesh.scale();
        if inside && unsigned > 0.0 { -unsigned } else { unsigned }
    })?;
    ordered.into_rows(progress)
}

/// Float64 distances of the samples of a grid, x fastest, with the signs of `samples`, their float32 distances.
pub fn refined(mesh: &Mesh, grid: &Grid, samples: &[f32], progress: &Progress) -> Result<Vec<f64>, Error> {
    mesh.bvh();
    let [nx, ny, _] = grid.shape;
    let mut distances: Vec<f64> = zeroed_rows("samples", samples.len())?;
    progress.set_total(samples.len() as u64);
    let parts = distances.par_chunks_mut(CHUNK).zip(samples.par_chunks(CHUNK)).enumerate();
    parts.try_for_each(|(part, (distances, samples))| {
        for (i, (distance, sample)) in distances.iter_mut().zip(samples).enumerate() {
            let row = part * CHUNK + i;
            let p = mesh.local_from_world(grid.center(row % nx, row / nx % ny, row / (nx * ny)));
            let closest = exact_within(mesh, p, f64::from(sample.abs()) / mesh.scale());
            *distance = (closest.distance * mesh.scale()).copysign(f64::from(*sample));
            progress.check()?;
        }
        progress.advance(samples.len() as u64)
    })?;
    Ok(distances)
}

/// The closest point, given its distance but for the rounding of float32.
fn exact_within(mesh: &Mesh, p: DVec3, about: f64) -> crate::bvh::nearest::closest::ClosestPoint {
    let bound = about * (1.0 + BOUND_SLACK.0) + BOUND_SLACK.1 * p.abs().max_element().max(1.0);
    mesh.exact_closest_point(p, bound)
}
