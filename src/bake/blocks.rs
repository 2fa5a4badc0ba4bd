//! Signed distances in blocks of a grid, for surfaces that are extracted without the whole grid.
//!
//! The samples of a block share their candidates for the nearest triangle ([`super::dense`]). A sample mostly has the
//! side of its neighbour ([`SideWalk`]), so the side is counted beside the surface only.

use super::{BakeOptions, LocalGrid};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SideWalk, SignRule};
use crate::volume::sparse::build::SampleBox;
use rayon::prelude::*;

/// Largest side of a block, voxels: 4 GiB of samples.
const MOST_SIDE: usize = 1023;

/// Distances, world units, at the `(side + 1)^3` samples of each block, x fastest; the first sample of a block is
/// `origins[b]`. A sample outside the grid repeats the nearest one of the grid. Distances are negative inside by the
/// winding number, or without a sign if `unsigned`.
pub fn bake_blocks(
    mesh: &Mesh,
    grid: &Grid,
    side: usize,
    origins: &[[i32; 3]],
    unsigned: bool,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    BakeOptions::default().check(mesh, grid)?;
    if !(1..=MOST_SIDE).contains(&side) {
        return Err(ArgumentError::new("side", format!("must be from 1 to {MOST_SIDE}, got {side}")).into());
    }
    let count = (side + 1).pow(3);
    let mut values = allocate_samples(&format!("{} blocks of samples", origins.len()), origins.len() * count, 0)?;
    progress.set_total(origins.len() as u64);
    rayon::join(|| mesh.bvh(), || mesh.topology());
    let rule = if unsigned { &SignRule::Unsigned } else { &mesh.winding_choice().rule };
    rule.prepare(mesh);
    let whole = LocalGrid::new(grid, mesh);
    values.par_chunks_mut(count).zip(origins).try_for_each(|(values, origin)| {
        let bounds = SampleBox::clipped(*origin, side + 1, grid.shape);
        let [nx, ny, _] = bounds.shape();
        let mut own = vec![0.0; bounds.len()];
        whole.distances_in(&bounds, mesh, 1.0, &mut own);
        let part = whole.part(bounds.low, bounds.shape());
        let mut walk = SideWalk::default();
        for (row, distances) in own.chunks_mut(nx).enumerate() {
            for i in 0..nx {
                // Every second row runs backwards, so that samples follow their neighbours.
                let x = if row % 2 == 0 { i } else { nx - 1 - i };
                let distance = f64::from(distances[x]);
                let is_inside = walk.is_inside_at(rule, mesh, part.at([x, row % ny, row / ny]), distance);
                let world = (distance * mesh.scale()) as f32;
                distances[x] = if is_inside && distance > 0.0 { -world } else { world };
            }
        }
        bounds.spread(&own, *origin, side + 1, values);
        progress.advance(1)
    })?;
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::bake;
    use crate::mesh::random::soup;
    use crate::sign::SignMethod;
    use glam::DVec3;

    #[test]
    fn blocks_far_outside_repeat_a_corner_and_sides_are_limited() {
        let grid = Grid::new(DVec3::splat(-0.3), DVec3::splat(1.4), [5, 6, 7]).unwrap();
        let mesh = soup(12, 0.3, 7);
        let blocks = |side, first: i32| bake_blocks(&mesh, &grid, side, &[[first; 3]], true, &Progress::new());
        let whole = bake_blocks(&mesh, &grid, 6, &[[0; 3]], true, &Progress::new()).unwrap();
        for (first, corner) in [(i32::MIN, 0), (i32::MAX - 1, whole.len() - 1)] {
            let values = blocks(2, first).unwrap();
            assert!(values.len() == 27 && values.iter().all(|&value| value == whole[corner]), "{first}");
        }
        for side in [0, MOST_SIDE + 1, usize::MAX] {
            assert!(blocks(side, 0).is_err_and(|error| error.to_string().contains("side")), "{side}");
        }
    }

    #[test]
    fn blocks_have_the_samples_of_the_whole_bake() {
        let grid = Grid::new(DVec3::splat(-0.3), DVec3::splat(1.4), [19, 23, 17]).unwrap();
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let closed = Mesh::new(&corners, &faces).unwrap();
        let open = Mesh::new(&corners, &faces[1..]).unwrap();
        let side = 6;
        let origins: Vec<[i32; 3]> =
            (0..64).map(|i| [i % 4, i / 4 % 4, i / 16].map(|block| block * side as i32 - 1)).collect();
        for mesh in [closed, open, soup(48, 0.3, 7)] {
            for (name, sign) in [("auto", SignMethod::Auto), ("unsigned", SignMethod::Unsigned)] {
                let options = BakeOptions { sign, ..Default::default() };
                let whole = bake(&mesh, &grid, &options, &Progress::new()).unwrap().distances;
                let blocks = bake_blocks(&mesh, &grid, side, &origins, name == "unsigned", &Progress::new()).unwrap();
                for (origin, values) in origins.iter().zip(blocks.chunks(343)) {
                    for (i, value) in values.iter().enumerate() {
                        let local = [i % 7, i / 7 % 7, i / 49];
                        let [x, y, z] = [0, 1, 2].map(|axis| {
                            (origin[axis] + local[axis] as i32).clamp(0, grid.shape[axis] as i32 - 1) as usize
                        });
                        let expected = whole[grid.offset(x, y, z)];
                        // Both distances are rounded to float32; the sides are the same.
                        assert!((value - expected).abs() <= 1e-6, "{name} {origin:?} {i}: {value} {expected}");
                    }
                }
            }
        }
    }
}
