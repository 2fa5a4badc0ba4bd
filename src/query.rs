//! Closest points and signed distances at arbitrary positions.
//!
//! The search runs on the CPU or on a graphics device; what is returned is found from the winning face in float64 on the
//! CPU in both cases, and so is the sign.

use crate::bvh::binary::BinaryTree;
use crate::bvh::closest::ClosestPoint;
use crate::error::{ArgumentError, Error};
use crate::gpu::layout::QueryParams;
use crate::gpu::pace::in_pieces;
use crate::gpu::{Context, Place};
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
pub fn closest_points(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    progress: &Progress,
) -> Result<ClosestPoints, Error> {
    check_points(points)?;
    mesh.bvh();
    let search = Search::new(place, mesh, points, progress)?;
    let mut found = ClosestPoints {
        points: vec![[0.0; 3]; points.len()],
        distances: vec![0.0; points.len()],
        faces: vec![0; points.len()],
    };
    progress.set_total(place.passes() * points.len() as u64);
    let chunks = points.par_chunks(CHUNK).enumerate().zip(found.points.par_chunks_mut(CHUNK));
    let results = found.distances.par_chunks_mut(CHUNK).zip(found.faces.par_chunks_mut(CHUNK));
    chunks.zip(results).try_for_each(|(((chunk, queries), positions), (distances, faces))| {
        for (i, &query) in queries.iter().enumerate() {
            let p = mesh.local_from_world(DVec3::from_array(query));
            let closest = search.closest_point(p, chunk * CHUNK + i);
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
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    method: SignMethod,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    check_points(points)?;
    mesh.bvh();
    let choice = SignChoice::new(mesh, method);
    choice.rule.prepare(mesh);
    progress.set_total(place.passes() * points.len() as u64);
    let search = Search::new(place, mesh, points, progress)?;
    let mut distances = vec![0.0; points.len()];
    let chunks = points.par_chunks(CHUNK).enumerate().zip(distances.par_chunks_mut(CHUNK));
    chunks.try_for_each(|((chunk, queries), distances)| {
        for (i, (&query, distance)) in queries.iter().zip(distances).enumerate() {
            let p = mesh.local_from_world(DVec3::from_array(query));
            let closest = search.closest_point(p, chunk * CHUNK + i);
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

/// The search for the nearest face: done point by point, or ahead for all points on a device.
struct Search<'a> {
    mesh: &'a Mesh,
    /// By point, [`UNFINISHED`] where the device ran out of rounds; empty on the CPU.
    faces: Vec<u32>,
}

/// In place of a face, as in the shader.
const UNFINISHED: u32 = u32::MAX;
/// Workgroups of a dispatch: the first one, and the most that one dimension holds. Each answers 64 points.
const WORKGROUPS: (u64, u64) = (4, 65_535);
/// Points that are on the device at a time: 16 bytes each, within any binding.
const BATCH: usize = 1 << 22;

impl<'a> Search<'a> {
    fn new(place: &Place, mesh: &'a Mesh, points: &[[f64; 3]], progress: &Progress) -> Result<Self, Error> {
        let faces = match place {
            Place::Cpu => Vec::new(),
            Place::Gpu(context) => nearest_faces(context, mesh, points, progress)?,
        };
        Ok(Self { mesh, faces })
    }

    /// The closest point to a local position, that of point `index`.
    fn closest_point(&self, p: DVec3, index: usize) -> ClosestPoint {
        match self.faces.get(index) {
            Some(&face) if face != UNFINISHED => self.mesh.closest_point_on_face(face, p),
            _ => self.mesh.closest_point(p),
        }
    }
}

/// The nearest face of every point, on a device.
fn nearest_faces(context: &Context, mesh: &Mesh, points: &[[f64; 3]], progress: &Progress) -> Result<Vec<u32>, Error> {
    let mut faces = vec![0u32; points.len()];
    if points.is_empty() {
        return Ok(faces);
    }
    let tree = BinaryTree::new(mesh.bvh(), mesh.positions(), mesh.faces());
    let nodes = context.upload("tree", &tree.nodes)?;
    let triangles = context.upload("triangles", &tree.triangles)?;
    let kernel = context.kernel("query_points", "main")?;
    for (queries, faces) in points.chunks(BATCH).zip(faces.chunks_mut(BATCH)) {
        let local: Vec<f32> = queries
            .iter()
            .flat_map(|&query| mesh.local_from_world(DVec3::from_array(query)).as_vec3().to_array())
            .collect();
        let positions = context.upload("points", &local)?;
        let found = context.storage("nearest faces", size_of_val(faces) as u64)?;
        let mut params = QueryParams::default();
        let uniform = context.uniform("query parameters", &params)?;
        let buffers = [(0, &uniform), (1, &nodes), (2, &triangles), (3, &positions), (4, &found)];
        let group = context.bind("query", &kernel, &buffers)?;
        let workgroups = (queries.len() as u64).div_ceil(64);
        in_pieces(context, "the query kernel", workgroups, WORKGROUPS.0, WORKGROUPS.1, progress, |first, count| {
            params.first = 64 * first as u32;
            params.count = (64 * count as u32).min(queries.len() as u32 - params.first);
            context.write("query parameters", &uniform, 0, &[params])?;
            progress.advance(params.count.into())?;
            Ok(context.dispatch("query", &kernel, &group, [count as u32, 1, 1])?)
        })?;
        context.read("nearest faces", &found, faces, progress)?;
    }
    Ok(faces)
}
