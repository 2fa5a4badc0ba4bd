//! Samples of a shape on grids. Blocks of a grid evaluate the leaves near them alone ([`super::pruning`]).

use super::pruning::{Ball, NearTokens, Pruning};
use super::solid::{LANES, Solid, run_wide, saturated};
use crate::csg::evaluation::program::Stack;
use crate::csg::model::token::Token;
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// Side of a block of a baked grid, samples. A layer of it has [`LANES`] samples.
const BLOCK: usize = 8;

impl Solid {
    /// Samples of a block of a grid, `(side + 1)^3`, x fastest, from the sample `origin` on. A sample outside the grid
    /// repeats the nearest one of the grid. `tokens` must return the field at all samples
    /// of the block.
    pub(crate) fn samples_of_block(
        &self,
        tokens: &[Token],
        grid: &Grid,
        side: usize,
        origin: [i32; 3],
        stack: &mut Stack<f64, LANES>,
        samples: &mut [f32],
    ) {
        let n = side + 1;
        let local = |i: usize| {
            let clamped = |axis: usize| (origin[axis] + i as i32).clamp(0, grid.shape[axis] as i32 - 1) as usize;
            self.frame.local(grid.center(clamped(0), clamped(1), clamped(2))).to_array()
        };
        let along: Vec<[f64; 3]> = (0..n).map(local).collect();
        let mut places: Vec<[f64; 3]> = Vec::with_capacity(samples.len());
        for [_, _, z] in &along {
            for [_, y, _] in &along {
                places.extend(along.iter().map(|[x, ..]| [*x, *y, *z]));
            }
        }
        for (places, out) in places.chunks(LANES).zip(samples.chunks_mut(LANES)) {
            let mut at = [[0.0; LANES]; 3];
            for (i, place) in places.iter().enumerate() {
                (0..3).for_each(|axis| at[axis][i] = place[axis]);
            }
            let values = run_wide(self.precise(), tokens, &at, stack);
            for (out, value) in out.iter_mut().zip(values) {
                *out = saturated(value * self.frame.scale);
            }
        }
    }

    /// Samples at the voxel centres of a grid, x fastest. Blocks of the grid evaluate the leaves near them alone.
    pub fn bake(&self, grid: &Grid, progress: &Progress) -> Result<Vec<f32>, Error> {
        let [nx, ny, nz] = grid.shape;
        let what = format!("a field of {nx} x {ny} x {nz} samples");
        let mut samples = allocate_samples(&what, grid.len(), 0)?;
        progress.set_total(nz as u64);
        let along: [Vec<f64>; 3] = [0, 1, 2].map(|axis| {
            let local = |i: usize| {
                let mut index = [0; 3];
                index[axis] = i;
                self.frame.local(grid.center(index[0], index[1], index[2]))[axis]
            };
            (0..grid.shape[axis]).map(local).collect()
        });
        let (pruning, voxel) = (Pruning::new(self), grid.spacing().max_element() / self.frame.scale);
        // All threads have layers.
        let layers = nz.div_ceil(2 * rayon::current_num_threads()).min(BLOCK);
        let corners = |count: usize| (0..count).step_by(BLOCK);
        samples.par_chunks_mut(layers * nx * ny).enumerate().try_for_each_init(
            || (Stack::default(), NearTokens::new(voxel)),
            |(stack, near), (slab, samples)| {
                let depth = samples.len() / (nx * ny);
                for (y, x) in corners(ny).flat_map(|y| corners(nx).map(move |x| (y, x))) {
                    progress.check()?;
                    let [end_x, end_y] = [nx.min(x + BLOCK), ny.min(y + BLOCK)];
                    let places = [&along[0][x..end_x], &along[1][y..end_y], &along[2][slab * layers..][..depth]];
                    let corner =
                        |end: fn(&[f64]) -> Option<&f64>| DVec3::from(places.map(|along| *end(along).unwrap_or(&0.0)));
                    let (lower, upper) = (corner(<[f64]>::first), corner(<[f64]>::last));
                    let tokens = near.find_alone(&pruning, self, Ball::around(lower, upper));
                    for (layer, &z) in places[2].iter().enumerate() {
                        let rows = &mut samples[nx * (y + ny * layer)..];
                        self.fill_layer(tokens, places, z, stack, rows.chunks_mut(nx).map(|row| &mut row[x..end_x]));
                    }
                }
                progress.advance(depth as u64)
            },
        )?;
        Ok(samples)
    }

    /// Samples of a layer of a block, at given places along x and y, in its rows.
    fn fill_layer<'a>(
        &self,
        tokens: &[Token],
        [along_x, along_y, _]: [&[f64]; 3],
        z: f64,
        stack: &mut Stack<f32, LANES>,
        rows: impl Iterator<Item = &'a mut [f32]>,
    ) {
        let mut at = [[0.0; LANES]; 3];
        for (i, (&y, &x)) in along_y.iter().flat_map(|y| along_x.iter().map(move |x| (y, x))).enumerate() {
            (at[0][i], at[1][i], at[2][i]) = (x as f32, y as f32, z as f32);
        }
        let values = run_wide(&self.program, tokens, &at, stack);
        for (row, values) in rows.zip(values[..along_x.len() * along_y.len()].chunks(along_x.len())) {
            for (out, value) in row.iter_mut().zip(values) {
                *out = saturated(f64::from(*value) * self.frame.scale);
            }
        }
    }
}
