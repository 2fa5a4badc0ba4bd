//! The search for the nearest faces of a list of points on a graphics device (`shaders/query_points.wgsl`).
//!
//! Only the search runs there. The CPU computes the distance to the nearest face in float64, and the side.

use crate::bvh::binary::BinaryTree;
use crate::error::Error;
use crate::gpu::Context;
pub(super) use crate::gpu::constants::tree::NOTHING as UNFINISHED;
use crate::gpu::layout::QueryParams;
use crate::gpu::pace::in_pieces;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;

/// Number of workgroups of a dispatch: in the first one, and at most, by the limit of one dimension. Each processes 64
/// points.
const WORKGROUPS: (u64, u64) = (4, 65_535);
/// Number of points on the device at a time. 16 bytes each fit within any binding.
const BATCH: usize = 1 << 22;

/// The nearest face of every point, on a device.
pub(super) fn nearest_faces(
    context: &Context,
    mesh: &Mesh,
    points: &[[f64; 3]],
    progress: &Progress,
) -> Result<Vec<u32>, Error> {
    let mut faces = vec![0u32; points.len()];
    if points.is_empty() {
        return Ok(faces);
    }
    let tree: &BinaryTree = mesh.derived();
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
