//! The search for the faces that rays may hit, on a graphics device (`shaders/mesh/cast_rays.wgsl`).
//!
//! The device searches in float32 and returns up to [`SLOTS`] faces for each ray. They include every face of the
//! result. The CPU computes the hits of these faces in float64. It searches the rays itself for which more faces would
//! be needed, so the results equal the results of the CPU, to the bit.

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
    let triangles = || &mesh.derived::<LeafCorners>().0[..];
    search_tree(context, "cast_rays", mesh, triangles, items, params, &mut found, progress)?;
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::constants::cast_rays::MISSED;
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
        // The rays run from around the soup to its inner part and on. Every fourth one runs the other way.
        let (origins, mut directions) = (vectors(2.0), vectors(0.8));
        for (row, (direction, origin)) in directions.iter_mut().zip(&origins).enumerate() {
            let way = if row % 4 == 0 { -1.0 } else { 1.0 };
            *direction = std::array::from_fn(|axis| way * (direction[axis] - origin[axis]));
        }
        let rays = Rays { origins: &origins, directions: &directions, t_min: 0.0, t_max: 3.0 };
        let search = |kind| candidates(&context, &mesh, &rays, kind, &Progress::new()).unwrap();
        let (first, any, all) = (search(Search::First), search(Search::Any), search(Search::All));
        let [mut missed, mut undecided, mut certain, mut occluded, mut listed] = [0; 5];
        for (row, ray) in rays.local(&mesh, 0..origins.len()).enumerate() {
            let hit = mesh.first_hit(&ray, |_| true);
            if mesh.device_ray(&ray).limit == MISSED {
                assert!([first[row], any[row], all[row]].iter().all(|found| found.faces() == Some(&[])), "{row}");
                missed += 1;
            }
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
        // Each kind of result must be frequent, or the comparisons above would mean little: a quarter of the rays hits,
        // a quarter has all of its hits in the list, and half of the rays that run away start outside the box.
        assert!(occluded > 500 && listed > 500 && missed > 250, "{occluded} {listed} {missed}");
        // The CPU searches rays with more than eight candidates before the first certain hit. The soup has four layers
        // of faces along a line, so eight within the uncertainty of one hit are rare: one percent.
        assert!(undecided <= 20, "{undecided}");
        // A hit is uncertain within about 1e-5 of an edge: 1e-3 of the area of a face of size 0.1 with a narrow shape.
        // Two percent leave room for narrower faces.
        assert!(certain * 100 >= occluded * 98, "{certain} {occluded}");
    }
}
