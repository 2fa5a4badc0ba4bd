//! Searches of the tree on a graphics device, one for each item of a list, and the search for the nearest faces of
//! points (`shaders/mesh/query_points.wgsl`).
//!
//! Only the search runs there. The CPU computes the distance to the nearest face in float64, and the side.

use crate::bvh::binary::{BinaryTree, LeafFrames};
use crate::error::Error;
use crate::gpu::Context;
pub(super) use crate::gpu::constants::tree::NOTHING as UNFINISHED;
use crate::gpu::layout::QueryParams;
use crate::gpu::pace::in_groups;
use crate::mesh::Mesh;
use crate::progress::Progress;
use bytemuck::Pod;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Size of the items and of the results on a device at a time, bytes: half of 128 MiB, the default limit of
/// a binding.
const BATCH_BYTES: usize = 1 << 26;

/// The nearest face of every point, on a device.
pub(super) fn nearest_faces(
    context: &Context,
    mesh: &Mesh,
    points: &[[f64; 3]],
    progress: &Progress,
) -> Result<Vec<u32>, Error> {
    let mut faces = vec![0u32; points.len()];
    let local = |point: &[f64; 3]| mesh.local_from_world(DVec3::from_array(*point)).as_vec3().to_array();
    let items = |rows: Range<usize>| -> Vec<[f32; 3]> { points[rows].par_iter().map(local).collect() };
    let params = |first, count| QueryParams { first, count, ..QueryParams::default() };
    let triangles = || &mesh.derived::<LeafFrames>().0[..];
    search_tree(context, "query_points", mesh, triangles, items, params, &mut faces, progress)?;
    Ok(faces)
}

/// Runs a kernel that searches the tree of a mesh for every item of a list and writes a result for each to `found`. The
/// kernel binds parameters, nodes, `triangles`, items and results, in this order. `items` are the items of some rows,
/// and `params(first, count)` the parameters of a dispatch for some items of a batch.
#[expect(clippy::too_many_arguments, reason = "each is an input of one search")]
pub(super) fn search_tree<'a, P: Pod, T: Pod, I: Pod, R: Pod>(
    context: &Context,
    kernel: &'static str,
    mesh: &'a Mesh,
    triangles: impl FnOnce() -> &'a [T],
    items: impl Fn(Range<usize>) -> Vec<I>,
    params: impl Fn(u32, u32) -> P,
    found: &mut [R],
    progress: &Progress,
) -> Result<(), Error> {
    if found.is_empty() {
        return Ok(());
    }
    let tree: &BinaryTree = mesh.derived();
    let batch = found.len().min(BATCH_BYTES / size_of::<I>().max(size_of::<R>()));
    let pipeline = context.kernel(kernel, "main")?;
    let parameters = context.parameters("search parameters", &params(0, 0))?;
    let nodes = context.upload("tree", &tree.nodes)?;
    let triangles = context.upload("triangles", triangles())?;
    let queries = context.storage("search items", (batch * size_of::<I>()) as u64)?;
    let results = context.storage("search results", (batch * size_of::<R>()) as u64)?;
    let buffers = [(0, &parameters), (1, &nodes), (2, &triangles), (3, &queries), (4, &results)];
    let group = context.bind(kernel, &pipeline, &buffers)?;
    let mut rows = 0..0;
    for found in found.chunks_mut(batch) {
        rows = rows.end..rows.end + found.len();
        context.fill("search items", &queries, &items(rows.clone()))?;
        in_groups(context, "the search of a tree", found.len(), progress, |first, count, workgroups| {
            context.write("search parameters", &parameters, 0, &[params(first, count)])?;
            progress.advance(count.into())?;
            Ok(context.dispatch(kernel, &pipeline, &group, workgroups)?)
        })?;
        context.read("search results", &results, found, progress)?;
    }
    Ok(())
}
