//! The search for the faces that rays may hit, on a graphics device (`shaders/cast_rays.wgsl`).
//!
//! The device searches in float32 and returns up to [`SLOTS`] faces for each ray. They include every face of the result.
//! The CPU computes the hits of these faces in float64. It searches the rays itself for which more faces would be
//! needed, so the results are those of the CPU, to the bit.

use super::device::search_tree;
use super::ray_list::{CHUNK, Rays};
use crate::bvh::binary::LeafCorners;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::constants::cast_rays::{ALL, ANY, CERTAIN, FIRST, UNDECIDED};
use crate::gpu::constants::tree::NOTHING;
use crate::gpu::layout::{CastParams, CastRay};
use crate::mesh::Mesh;
use crate::progress::Progress;
use rayon::prelude::*;
use std::ops::Range;

/// Largest number of faces of a ray.
const SLOTS: usize = 8;

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
    let items = |rows: Range<usize>| -> Vec<CastRay> {
        let chunks = rows.clone().into_par_iter().step_by(CHUNK);
        let of_chunk = |row| rays.local(mesh, row..rows.end.min(row + CHUNK)).map(|ray| mesh.device_ray(&ray));
        chunks.flat_map_iter(of_chunk).collect()
    };
    let mode = match search {
        Search::First => FIRST,
        Search::Any => ANY,
        Search::All => ALL,
    };
    let params = |first, count| CastParams { first, count, mode, ..CastParams::default() };
    let triangles: &LeafCorners = mesh.derived();
    search_tree(context, "cast_rays", mesh, &triangles.0, items, params, &mut found, progress)?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::test_context;
    use crate::mesh::random::{soup, uniform};

    /// Number of rays of the test.
    const COUNT: usize = 2000;
    /// Smallest share of the rays that hit a face, and whose faces all fit. Float64 gives 0.5 and 0.9; without so many the
    /// test would compare little.
    const MEANINGFUL: f64 = 0.25;
    /// Largest share of the rays that the CPU searches. A soup has no face within 1e-5 of another one on most rays, so
    /// only rays with more than [`SLOTS`] candidates before the first certain hit remain.
    const MOST_UNDECIDED: f64 = 0.01;
    /// Smallest share of the occluded rays that a device finds certain. A hit is uncertain within 1e-5 of an edge, and
    /// faces of the size 0.1 have a hundredth of a percent of their area there. Hits at the ends of the ray add to that.
    const LEAST_CERTAIN: f64 = 0.98;

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
