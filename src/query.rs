//! Closest points and signed distances at arbitrary positions.

use crate::error::{ArgumentError, Error};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SignChoice, SignMethod};
use glam::DVec3;
use rayon::prelude::*;

/// Points answered between two looks at the progress: a few milliseconds of work.
const CHUNK: usize = 1024;

/// The closest points of a mesh, one entry a query point.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ClosestPoints {
    /// World positions.
    pub points: Vec<[f64; 3]>,
    /// Unsigned, world units.
    pub distances: Vec<f32>,
    /// Indices into the mesh's faces.
    pub faces: Vec<u32>,
}

/// Closest point of the mesh to each world position.
pub fn closest_points(mesh: &Mesh, points: &[[f64; 3]], progress: &Progress) -> Result<ClosestPoints, Error> {
    check_points(points)?;
    mesh.bvh();
    let mut found = ClosestPoints {
        points: vec![[0.0; 3]; points.len()],
        distances: vec![0.0; points.len()],
        faces: vec![0; points.len()],
    };
    progress.set_total(points.len() as u64);
    let chunks = points.par_chunks(CHUNK).zip(found.points.par_chunks_mut(CHUNK));
    let results = found.distances.par_chunks_mut(CHUNK).zip(found.faces.par_chunks_mut(CHUNK));
    chunks.zip(results).try_for_each(|((queries, positions), (distances, faces))| {
        for (i, &query) in queries.iter().enumerate() {
            let closest = mesh.closest_point(mesh.local_from_world(DVec3::from_array(query)));
            positions[i] = mesh.world_from_local(closest.on_triangle.point).to_array();
            distances[i] = (closest.distance * mesh.scale()) as f32;
            faces[i] = closest.face;
        }
        progress.advance(queries.len() as u64)
    })?;
    Ok(found)
}

/// Signed distance of each world position, world units, negative inside.
pub fn signed_distances(
    mesh: &Mesh,
    points: &[[f64; 3]],
    method: SignMethod,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    check_points(points)?;
    mesh.bvh();
    let choice = SignChoice::new(mesh, method);
    choice.rule.prepare(mesh);
    progress.set_total(points.len() as u64);
    let mut distances = vec![0.0; points.len()];
    points.par_chunks(CHUNK).zip(distances.par_chunks_mut(CHUNK)).try_for_each(|(queries, distances)| {
        for (&query, distance) in queries.iter().zip(distances) {
            let p = mesh.local_from_world(DVec3::from_array(query));
            let closest = mesh.closest_point(p);
            let unsigned = closest.distance * mesh.scale();
            *distance = if choice.rule.is_inside(mesh, p, &closest) { -unsigned } else { unsigned } as f32;
        }
        progress.advance(queries.len() as u64)
    })?;
    Ok(distances)
}

fn check_points(points: &[[f64; 3]]) -> Result<(), ArgumentError> {
    match points.iter().position(|point| point.iter().any(|x| !x.is_finite())) {
        None => Ok(()),
        Some(row) => {
            let [x, y, z] = points[row];
            Err(ArgumentError::new("points", format!("points[{row}] = ({x}, {y}, {z}) is not finite")))
        }
    }
}
