//! The search for the faces that rays may hit, on a graphics device (`shaders/cast_rays.wgsl`).
//!
//! The device searches in float32 and returns up to [`SLOTS`] faces for each ray. They include every face of the result.
//! The CPU computes the hits of these faces in float64. It searches the rays itself for which more faces would be
//! needed, so the results are those of the CPU, to the bit.

use super::ray_list::{CHUNK, Rays};
use crate::bvh::binary::BinaryTree;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::constants::cast_rays::{ALL, ANY, CERTAIN, FIRST, UNDECIDED};
use crate::gpu::constants::tree::NOTHING;
use crate::gpu::layout::{CastParams, CastRay, Corners};
use crate::gpu::pace::in_pieces;
use crate::mesh::Mesh;
use crate::progress::Progress;
use rayon::prelude::*;

/// Largest number of faces of a ray.
const SLOTS: usize = 8;
/// Number of workgroups of a dispatch: in the first one, and at most, by the limit of one dimension. Each processes 64
/// rays.
const WORKGROUPS: (u64, u64) = (4, 65_535);
/// Number of rays on the device at a time. 48 bytes each fit within any binding.
const BATCH: usize = 1 << 20;

/// Which hits are searched for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Search {
    First,
    Any,
    All,
}

/// The faces that a ray may hit, as a device writes them.
#[derive(Debug, Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
#[repr(transparent)]
pub(super) struct Candidates([u32; SLOTS]);

impl Candidates {
    /// The faces; None if the CPU has to search.
    pub(super) fn faces(&self) -> Option<&[u32]> {
        let count = self.0.iter().position(|&face| face == NOTHING).unwrap_or(SLOTS);
        (self.0[0] != UNDECIDED).then(|| &self.0[..count])
    }

    /// Whether the ray hits a face, without a computation in float64. Only searches for any hit set this.
    pub(super) fn is_certain(&self) -> bool {
        self.0[0] == CERTAIN
    }
}

/// The candidates of every ray, on a device.
pub(super) fn candidates(
    context: &Context,
    mesh: &Mesh,
    rays: &Rays<'_>,
    search: Search,
    progress: &Progress,
) -> Result<Vec<Candidates>, Error> {
    let mut found = vec![Candidates([NOTHING; SLOTS]); rays.origins.len()];
    if found.is_empty() {
        return Ok(found);
    }
    let tree: &BinaryTree = mesh.derived();
    let corners: Vec<Corners> = tree.triangles.par_iter().map(|triangle| mesh.device_corners(triangle.face)).collect();
    let nodes = context.upload("tree", &tree.nodes)?;
    let triangles = context.upload("triangles", &corners)?;
    let kernel = context.kernel("cast_rays", "main")?;
    let mode = match search {
        Search::First => FIRST,
        Search::Any => ANY,
        Search::All => ALL,
    };
    for (batch, found) in found.chunks_mut(BATCH).enumerate() {
        let rows = batch * BATCH..batch * BATCH + found.len();
        let prepared: Vec<CastRay> = rows
            .clone()
            .into_par_iter()
            .step_by(CHUNK)
            .flat_map_iter(|row| rays.local(mesh, row..rows.end.min(row + CHUNK)).map(|ray| mesh.device_ray(&ray)))
            .collect();
        let uploaded = context.upload("rays", &prepared)?;
        let faces = context.storage("candidates", size_of_val(found) as u64)?;
        let mut params = CastParams { mode, ..CastParams::default() };
        let parameters = context.parameters("ray parameters", &params)?;
        let buffers = [(0, &parameters), (1, &nodes), (2, &triangles), (3, &uploaded), (4, &faces)];
        let group = context.bind("rays", &kernel, &buffers)?;
        let workgroups = (found.len() as u64).div_ceil(64);
        in_pieces(context, "the ray kernel", workgroups, WORKGROUPS.0, WORKGROUPS.1, progress, |first, count| {
            params.first = 64 * first as u32;
            params.count = (64 * count as u32).min(found.len() as u32 - params.first);
            context.write("ray parameters", &parameters, 0, &[params])?;
            progress.advance(params.count.into())?;
            Ok(context.dispatch("rays", &kernel, &group, [count as u32, 1, 1])?)
        })?;
        context.read("candidates", &faces, found, progress)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::test_context;
    use crate::mesh::random::{soup, uniform};

    /// The candidates contain every face of the results, certain hits are hits, and few rays remain for the CPU.
    #[test]
    fn candidates_contain_the_results() {
        let Some(context) = test_context() else { return };
        let mesh = soup(2000, 0.1, 3);
        let mut next = uniform(4);
        let mut vectors =
            |size: f64| -> Vec<[f64; 3]> { (0..2000).map(|_| [0; 3].map(|_| size * (next() - 0.5))).collect() };
        // The rays run from around the soup to its inner part and on.
        let (origins, mut directions) = (vectors(2.0), vectors(0.8));
        for (direction, origin) in directions.iter_mut().zip(&origins) {
            *direction = std::array::from_fn(|axis| direction[axis] - origin[axis]);
        }
        let rays = Rays { origins: &origins, directions: &directions, t_min: 0.0, t_max: 3.0 };
        let search = |kind| candidates(&context, &mesh, &rays, kind, &Progress::new()).unwrap();
        let (first, any, all) = (search(Search::First), search(Search::Any), search(Search::All));
        let [mut undecided, mut certain, mut occluded, mut listed] = [0; 4];
        for (row, ray) in rays.local(&mesh, 0..origins.len()).enumerate() {
            let hit = mesh.first_hit(&ray, |_| true);
            match first[row].faces() {
                Some(faces) => assert!(hit.is_none_or(|hit| faces.contains(&hit.face)), "{row}"),
                None => undecided += 1,
            }
            if any[row].is_certain() {
                assert!(hit.is_some(), "{row}");
                certain += 1;
            }
            occluded += usize::from(hit.is_some());
            let mut hits = Vec::new();
            mesh.cast_all(&ray, &mut hits);
            if let Some(faces) = all[row].faces() {
                assert!(hits.iter().all(|hit| faces.contains(&hit.face)), "{row}");
                listed += usize::from(hits.len() <= SLOTS);
            }
        }
        // Rays that miss the box are left to the CPU too; it finds that out by the first test of each.
        let outside = rays.local(&mesh, 0..origins.len()).filter(|ray| mesh.device_ray(ray).limit < 0.0).count();
        assert!(occluded > 500 && undecided <= outside + 20, "{occluded} {undecided} {outside}");
        assert!(certain * 100 >= occluded * 98, "{certain} {occluded}");
        assert!(listed > 500, "{listed}");
    }
}
