//! Parts of a grid that is too large for memory, and the side of whole blocks of it that contain no surface.
//!
//! A window computes the positions of its samples from the whole grid and evaluates each of them by itself, so its
//! samples have the bits of the whole bake.

use super::band::{BeyondBand, width};
use super::cpu::Job;
use super::{BakeOptions, LocalGrid};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SideWalk, SignChoice, SignMethod, SignRule};
use glam::DVec3;
use rayon::prelude::*;

/// Number of balls between two checks of the progress.
const CHUNK: usize = 256;
/// Margin for the relative rounding error of a distance, ten times the error.
const ROUNDING: f64 = 1e-6;

/// Samples `low..low + shape` of the bake of `grid`, world units, x fastest. Distances beyond the band are cut to its
/// half width.
pub fn bake_window(
    mesh: &Mesh,
    grid: &Grid,
    low: [usize; 3],
    shape: [usize; 3],
    options: &BakeOptions,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    options.check(mesh, grid)?;
    let fits = (0..3).all(|axis| shape[axis] > 0 && low[axis].saturating_add(shape[axis]) <= grid.shape[axis]);
    if !fits {
        let problem = format!("{shape:?} samples from {low:?} on are no part of a grid of {:?}", grid.shape);
        return Err(ArgumentError::new("window", problem).into());
    }
    let count = shape.iter().product();
    let mut distances = allocate_samples(&format!("a window of {shape:?} samples"), count, 0)?;
    progress.set_total(2 * count as u64);
    rayon::join(|| mesh.bvh(), || mesh.topology());
    let (choice, _) = options.choose_sign(mesh);
    let whole = LocalGrid::new(grid, mesh);
    let job = Job { mesh, local: whole.part(low, shape), rule: &choice.rule, progress };
    let far = options.band.map_or(BeyondBand::Exact, |voxels| BeyondBand::Cut(width(&whole, voxels)));
    let by_closest = job.distances(&mut distances, &far)?;
    job.signs(&mut distances, by_closest)?;
    if let Some(thickness) = options.thickness {
        distances.par_iter_mut().for_each(|d| *d = (f64::from(*d) - 0.5 * thickness) as f32);
    }
    Ok(distances)
}

/// For each ball the distance of the surface from its centre, world units, and the side of all its points: 1 outside,
/// -1 inside, 0 where the surface is in the ball or the sign rule decides each point by itself.
pub fn sides_of_balls(
    mesh: &Mesh,
    method: SignMethod,
    centers: &[[f64; 3]],
    radii: &[f64],
    progress: &Progress,
) -> Result<(Vec<f64>, Vec<i8>), Error> {
    rayon::join(|| mesh.bvh(), || mesh.topology());
    let made;
    let rule = match method {
        SignMethod::Auto | SignMethod::Winding => &mesh.winding_choice().rule,
        _ => {
            made = SignChoice::new(mesh, method);
            &made.rule
        }
    };
    let (mut distances, mut sides) = (vec![0.0; centers.len()], vec![0i8; centers.len()]);
    distances.par_chunks_mut(CHUNK).zip(sides.par_chunks_mut(CHUNK)).enumerate().try_for_each(
        |(chunk, (distances, sides))| {
            let mut walk = SideWalk::default();
            for i in 0..distances.len() {
                let place = chunk * CHUNK + i;
                let p = mesh.local_from_world(DVec3::from_array(centers[place]));
                let closest = mesh.closest_point(p);
                distances[i] = closest.distance * mesh.scale();
                let radius = radii[place] / mesh.scale();
                let is_uniform = || match rule {
                    SignRule::Counted(openings) => openings.is_uniform_within(p, radius),
                    SignRule::Unsigned => true,
                    SignRule::Winding | SignRule::Parity | SignRule::Pseudonormal | SignRule::Normal => false,
                };
                if radius < closest.distance * (1.0 - ROUNDING) && is_uniform() {
                    sides[i] = if walk.is_inside(rule, mesh, p, &closest) { -1 } else { 1 };
                }
            }
            progress.check()
        },
    )?;
    Ok((distances, sides))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::bake;
    use crate::mesh::random::soup;

    /// Two overlapping tetrahedra, one of them open.
    fn open_mesh() -> Mesh {
        let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let other = corners.map(|p: [f64; 3]| p.map(|x| x * 0.9 + 0.2));
        let faces = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3], [4, 6, 5], [4, 5, 7], [4, 7, 6]];
        Mesh::new(&[corners, other].concat(), &faces).expect("the faces have areas")
    }

    #[test]
    fn a_window_has_the_bits_of_the_whole_bake() {
        let grid = Grid::new(DVec3::splat(-0.31), DVec3::splat(1.37), [37, 41, 45]).expect("a grid");
        for mesh in [open_mesh(), soup(48, 0.3, 7)] {
            for (name, sign) in SignMethod::NAMES {
                let options = BakeOptions { sign, ..Default::default() };
                let whole = bake(&mesh, &grid, &options, &Progress::new()).expect("a bake").distances;
                for (low, shape) in [([0, 0, 0], [37, 41, 45]), ([3, 17, 9], [23, 11, 30]), ([36, 40, 44], [1, 1, 1])] {
                    let part = bake_window(&mesh, &grid, low, shape, &options, &Progress::new()).expect("a window");
                    let cut = BakeOptions { band: Some(1.5), ..options };
                    let banded = bake_window(&mesh, &grid, low, shape, &cut, &Progress::new()).expect("a window");
                    let limit = (1.5 * grid.spacing().max_element()) as f32;
                    for (i, (&sample, &short)) in part.iter().zip(&banded).enumerate() {
                        let [x, y, z] = [i % shape[0], i / shape[0] % shape[1], i / (shape[0] * shape[1])];
                        let expected = whole[grid.offset(low[0] + x, low[1] + y, low[2] + z)];
                        assert_eq!(sample.to_bits(), expected.to_bits(), "{name} {low:?} sample {i}");
                        let cut = expected.clamp(-limit, limit);
                        assert_eq!(short.to_bits(), cut.to_bits(), "{name} {low:?} sample {i}, band");
                    }
                }
            }
        }
    }

    #[test]
    fn a_window_that_leaves_the_grid_is_an_error() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [8, 8, 8]).expect("a grid");
        for (low, shape) in [([0, 0, 1], [8, 8, 8]), ([0, 0, 0], [0, 1, 1]), ([usize::MAX, 0, 0], [2, 1, 1])] {
            let result = bake_window(&open_mesh(), &grid, low, shape, &BakeOptions::default(), &Progress::new());
            assert!(result.is_err(), "{low:?} {shape:?}");
        }
    }
}
