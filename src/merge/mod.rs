//! One coarse field for a whole scene: the minimum over all placed fields at each sample.
//!
//! # Theory
//!
//! The method is the coarse aggregate of *Signed Distance Fields in Unity* (a blog post), with two changes. First, the
//! article's value outside a volume, the distance to the box plus the value at the nearest point of the box, is an
//! upper bound on the distance, so rays pass through objects. Here each field gives a proven lower bound ([`placed`]),
//! and the minimum of lower bounds is a lower bound on the distance to the union. Second, the loop over all volumes
//! for every cell is replaced by a tree over their boxes.
//!
//! Samples are computed in blocks of 4^3. A block searches the tree from near to far. The search ends at the largest
//! value of its samples so far. A skipped field lies in a box that is farther away than the value of every sample, and
//! no field is below the distance to its box. The result therefore equals the result of a loop over all fields, bit for
//! bit.
//!
//! Every sample stores its owner, the field that gave the smallest value. If some fields move, blocks with samples that
//! they own are computed anew. In other blocks the new value is compared with the old one. The result equals a new
//! merge of all fields, bit for bit ([`update`]).
//!
//! # Practice
//!
//! [`merge`] runs on all cores by slabs of blocks. [`merge_on_device`] finds the owners on a graphics device. The
//! merged field is interpolated between samples, so it may exceed the distance there; at the samples it does not.

mod gpu;
pub(crate) mod placed;

pub use gpu::merge_on_device;
pub use placed::{Geometry, Placed};

use crate::bvh::boxes::{BoxTree, DISTANCE_SLACK};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::{allocate_samples, require, zeroed_rows};
use crate::progress::Progress;
use crate::volume::outside::round_down;
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Number of samples along a side of a block.
const BLOCK: usize = 4;
const BLOCK_SAMPLES: usize = BLOCK * BLOCK * BLOCK;

/// A merged field, x fastest.
#[derive(Debug, Clone, PartialEq)]
pub struct Merged {
    /// Lower bounds on the distance, world units, x fastest.
    pub distances: Vec<f32>,
    /// Index of the field that gave each distance.
    pub owners: Vec<u32>,
    /// Number of evaluated bounds.
    pub evaluations: u64,
}

/// The smallest lower bound of all fields at every sample of a grid.
pub fn merge(grid: &Grid, placed: &[Placed<'_>], progress: &Progress) -> Result<Merged, Error> {
    let merger = Merger::new(grid, placed)?;
    let what = format!("a merged field of {:?} samples", grid.shape);
    require(&what, 8 * grid.len() as u64, 0)?;
    let distances = allocate_samples(&what, grid.len(), 0)?;
    let mut merged = Merged { distances, owners: zeroed_rows("owners", grid.len())?, evaluations: 0 };
    merger.for_each_slab(&mut merged, progress, |slab, blocks| {
        let mut evaluations = 0;
        for block in blocks {
            let mut values = BlockValues::default();
            merger.fill(&block, &mut values);
            evaluations += values.evaluations;
            merger.store(&block, &values, slab);
        }
        evaluations
    })?;
    Ok(merged)
}

/// Updates a merged field after the fields in `changed` have moved; `placed` are all fields in their new state.
///
/// The distances equal the distances of [`merge`], bit for bit.
pub fn update(
    grid: &Grid,
    placed: &[Placed<'_>],
    changed: &[u32],
    merged: &mut Merged,
    progress: &Progress,
) -> Result<(), Error> {
    let merger = Merger::new(grid, placed)?;
    let mut has_changed = vec![false; placed.len()];
    for &field in changed {
        let Some(flag) = has_changed.get_mut(field as usize) else {
            return Err(ArgumentError::new("changed", format!("{field}: there are {} fields", placed.len())).into());
        };
        *flag = true;
    }
    merger.for_each_slab(merged, progress, |slab, blocks| {
        let mut evaluations = 0;
        for block in blocks {
            let mut values = merger.load(&block, slab);
            let rows = values.owners[..block.len()].iter();
            let owns = rows.clone().any(|&owner| has_changed.get(owner as usize) != Some(&false));
            if owns {
                values = BlockValues::default();
                merger.fill(&block, &mut values);
            } else {
                let mut limit = values.largest(&block);
                for &field in changed {
                    merger.lower(&block, field, &mut values, &mut limit);
                }
                if values.evaluations == 0 {
                    continue;
                }
            }
            evaluations += values.evaluations;
            merger.store(&block, &values, slab);
        }
        evaluations
    })
}

/// Samples of a block, and their owners.
#[derive(Debug, Clone)]
struct BlockValues {
    distances: [f32; BLOCK_SAMPLES],
    owners: [u32; BLOCK_SAMPLES],
    evaluations: u64,
}

impl Default for BlockValues {
    fn default() -> Self {
        Self { distances: [f32::INFINITY; BLOCK_SAMPLES], owners: [u32::MAX; BLOCK_SAMPLES], evaluations: 0 }
    }
}

impl BlockValues {
    fn largest(&self, block: &SampleBlock) -> f64 {
        self.distances[..block.len()].iter().fold(f64::NEG_INFINITY, |largest, d| largest.max(f64::from(*d)))
    }
}

/// A block of samples.
#[derive(Debug, Clone, Copy)]
struct SampleBlock {
    first: [usize; 3],
    shape: [usize; 3],
}

impl SampleBlock {
    fn len(&self) -> usize {
        self.shape.iter().product()
    }

    /// Rows along x: index of the row's first sample within the block, and its y and z in the grid.
    fn rows(&self) -> impl Iterator<Item = (usize, usize, usize)> {
        let Self { first, shape } = *self;
        (0..shape[1] * shape[2]).map(move |row| (row * shape[0], first[1] + row % shape[1], first[2] + row / shape[1]))
    }
}

/// The planes of a slab, mutable.
struct PlaneSlab<'a> {
    first_plane: usize,
    distances: &'a mut [f32],
    owners: &'a mut [u32],
}

/// Fields with a tree over their boxes.
struct Merger<'a> {
    grid: Grid,
    spacing: DVec3,
    placed: &'a [Placed<'a>],
    tree: BoxTree,
}

impl<'a> Merger<'a> {
    fn new(grid: &Grid, placed: &'a [Placed<'a>]) -> Result<Self, Error> {
        if placed.is_empty() {
            return Err(ArgumentError::new("scene", "is empty: there is nothing to merge").into());
        }
        let boxes: Vec<_> = placed.iter().map(|placed| placed.bounds).collect();
        Ok(Self { grid: *grid, spacing: grid.spacing(), placed, tree: BoxTree::new(&boxes) })
    }

    /// Runs `work` on all slabs of blocks in parallel; `work` returns the number of bounds it evaluated.
    fn for_each_slab(
        &self,
        merged: &mut Merged,
        progress: &Progress,
        work: impl Fn(&mut PlaneSlab<'_>, Vec<SampleBlock>) -> u64 + Sync,
    ) -> Result<(), Error> {
        let [nx, ny, nz] = self.grid.shape;
        let evaluations = AtomicU64::new(0);
        progress.set_total((nz.div_ceil(BLOCK) * ny.div_ceil(BLOCK)) as u64);
        let planes =
            merged.distances.par_chunks_mut(nx * ny * BLOCK).zip(merged.owners.par_chunks_mut(nx * ny * BLOCK));
        planes.enumerate().try_for_each(|(slab, (distances, owners))| {
            let first_plane = slab * BLOCK;
            let mut slab = PlaneSlab { first_plane, distances, owners };
            for y in (0..ny).step_by(BLOCK) {
                let blocks = (0..nx).step_by(BLOCK).map(|x| SampleBlock {
                    first: [x, y, first_plane],
                    shape: [BLOCK.min(nx - x), BLOCK.min(ny - y), BLOCK.min(nz - first_plane)],
                });
                evaluations.fetch_add(work(&mut slab, blocks.collect()), Ordering::Relaxed);
                progress.advance(1)?;
            }
            Ok::<(), Error>(())
        })?;
        merged.evaluations = evaluations.into_inner();
        Ok(())
    }

    fn center(&self, x: usize, y: usize, z: usize) -> DVec3 {
        self.grid.lower + (DVec3::new(x as f64, y as f64, z as f64) + 0.5) * self.spacing
    }

    /// Box of the samples of a block.
    fn bounds(&self, block: &SampleBlock) -> [DVec3; 2] {
        let [x, y, z] = block.first;
        let [nx, ny, nz] = block.shape;
        [self.center(x, y, z), self.center(x + nx - 1, y + ny - 1, z + nz - 1)]
    }

    /// The minimum over all fields.
    fn fill(&self, block: &SampleBlock, values: &mut BlockValues) {
        self.tree.around(self.bounds(block), f64::INFINITY, |place, limit| {
            self.lower(block, self.tree.order[place], values, limit);
        });
    }

    /// Takes the values of one field where they are smaller; `limit` is the largest value of the block.
    fn lower(&self, block: &SampleBlock, field: u32, values: &mut BlockValues, limit: &mut f64) {
        let placed = &self.placed[field as usize];
        let [lower, upper] = self.bounds(block);
        let distance = (placed.bounds[0] - upper).max(lower - placed.bounds[1]).max(DVec3::ZERO).length();
        if distance > 0.0 && distance * (1.0 - DISTANCE_SLACK) >= *limit {
            return;
        }
        for (start, y, z) in block.rows() {
            for i in 0..block.shape[0] {
                let best = &mut values.distances[start + i];
                let bound = placed.lower_bound(self.center(block.first[0] + i, y, z), f64::from(*best));
                if bound < f64::from(*best) {
                    *best = round_down(bound);
                    values.owners[start + i] = field;
                }
            }
        }
        values.evaluations += block.len() as u64;
        *limit = values.largest(block);
    }

    fn offset(&self, slab: &PlaneSlab<'_>, block: &SampleBlock, y: usize, z: usize) -> usize {
        let [nx, ny, _] = self.grid.shape;
        block.first[0] + nx * (y + ny * (z - slab.first_plane))
    }

    fn load(&self, block: &SampleBlock, slab: &PlaneSlab<'_>) -> BlockValues {
        let mut values = BlockValues::default();
        let width = block.shape[0];
        for (start, y, z) in block.rows() {
            let offset = self.offset(slab, block, y, z);
            values.distances[start..][..width].copy_from_slice(&slab.distances[offset..][..width]);
            values.owners[start..][..width].copy_from_slice(&slab.owners[offset..][..width]);
        }
        values
    }

    fn store(&self, block: &SampleBlock, values: &BlockValues, slab: &mut PlaneSlab<'_>) {
        let width = block.shape[0];
        for (start, y, z) in block.rows() {
            let offset = self.offset(slab, block, y, z);
            slab.distances[offset..][..width].copy_from_slice(&values.distances[start..][..width]);
            slab.owners[offset..][..width].copy_from_slice(&values.owners[start..][..width]);
        }
    }
}
