//! Bricks that the surface enters through their faces.
//!
//! A source may derive the side of a whole brick from some of its samples. The sign of a field of an open mesh jumps
//! across the openings, far from all triangles, so the surface may pass between those samples. A neighbour of such a
//! brick then has samples of the other side on the common face. [`SparseBuilder::follow`] stores these bricks, then the
//! bricks that the surface enters from them, until no surface leaves the stored bricks.

use super::build::{SampleSource, SparseBuilder};
use super::{BRICK_CELLS, BRICK_LEN, Entry, SparseView, Texel, brick_origin};
use crate::error::Error;
use crate::progress::Progress;
use glam::IVec3;
use rayon::prelude::*;

impl<T: Texel> SparseBuilder<T> {
    /// Stores every empty brick that the surface enters from a stored one.
    pub(crate) fn follow<S: SampleSource>(&mut self, source: &S, progress: &Progress) -> Result<(), Error> {
        let is_stored = |&i: &usize| matches!(Entry::from_word(self.field.index[i]), Entry::Stored { .. });
        let mut last: Vec<usize> = (0..self.field.index.len()).filter(is_stored).collect();
        loop {
            let view = self.field.view()?;
            let mut entered: Vec<usize> = last.par_iter().flat_map_iter(|&i| entered_from(&view, i)).collect();
            entered.par_sort_unstable();
            entered.dedup();
            if entered.is_empty() {
                return Ok(());
            }
            let [nx, ny, _] = self.bricks;
            let samples: Vec<[f32; BRICK_LEN]> = entered
                .par_iter()
                .map_init(
                    || source.worker(),
                    |worker, &i| {
                        progress.check()?;
                        Ok(self.samples_of_brick(source, worker, [i % nx, i / nx % ny, i / (nx * ny)]))
                    },
                )
                .collect::<Result<_, Error>>()?;
            for (&i, samples) in entered.iter().zip(&samples) {
                let brick = (self.field.texels.len() / BRICK_LEN) as u32;
                self.field.index[i] = Entry::Stored { level: 0, brick }.to_word();
                let scale = self.field.scale;
                self.field.texels.extend(samples.iter().map(|&sample| T::encode(sample, scale)));
            }
            last = entered;
        }
    }
}

/// Positions in the index of the empty neighbours of a stored brick that have samples of the other side on the common
/// face.
fn entered_from<T: Texel>(view: &SparseView<'_, T>, i: usize) -> Vec<usize> {
    let [nx, ny, nz] = view.bricks();
    let at = [i % nx, i / nx % ny, i / (nx * ny)].map(|b| b as i32);
    let Entry::Stored { level, brick } = view.entry(at) else { return Vec::new() };
    let brick = view.brick(at, level, brick);
    let origin = IVec3::from(brick_origin(at, 0));
    let last = BRICK_CELLS as i32;
    let is_inside = |local: IVec3| {
        let cell = origin + local.min(IVec3::splat(last - 1));
        brick.cell(cell).at((origin + local).as_dvec3()) < 0.0
    };
    let mut found = Vec::new();
    for axis in 0..3 {
        for (place, step) in [(0, -1), (last, 1)] {
            let mut next = at;
            next[axis] += step;
            if next.iter().zip([nx, ny, nz]).any(|(&b, n)| b < 0 || b >= n as i32) {
                continue;
            }
            let Entry::Empty { inside } = view.entry(next) else { continue };
            let on_face = |i: i32| {
                let mut local = IVec3::ZERO;
                (local[axis], local[(axis + 1) % 3], local[(axis + 2) % 3]) = (place, i % (last + 1), i / (last + 1));
                local
            };
            if (0..(last + 1).pow(2)).any(|i| is_inside(on_face(i)) != inside) {
                found.push(next[0] as usize + nx * (next[1] as usize + ny * next[2] as usize));
            }
        }
    }
    found
}
