//! Selection of the bricks of a sparse field.
//!
//! The box is divided into *regions* of 4^3 bricks, each as large as a brick of the coarsest level. Regions are
//! independent. Samples are evaluated brick by brick when they are needed, and bricks near the surface are stored.
//! Then, from fine to coarse, eight bricks are replaced by one if its trilinear function is within the tolerance of
//! every sample in the band, and does not exceed the distance elsewhere. The working memory is one region per thread.

use super::{
    BRICK_CELLS, BRICK_LEN, BRICK_SAMPLES, Entry, MAX_LEVEL, REGION_BRICKS, SparseField, Texel, brick_counts,
    coarse_value, node_grid, sample_in_brick,
};
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::{FieldView, Trilinear};
use glam::DVec3;
use rayon::prelude::*;

/// Number of samples along the side of a region, including those on its faces.
const REGION_SAMPLES: usize = REGION_BRICKS * BRICK_CELLS + 1;
/// Number of bricks of a region.
const REGION_LEN: usize = REGION_BRICKS * REGION_BRICKS * REGION_BRICKS;

/// Weight of a region in the progress of a job. The weight of a sample is one.
pub(crate) const REGION_WORK: u64 = 512;

/// Options of a sparse field.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SparseOptions {
    /// Bricks with a sample nearer to the surface are stored. Unit: the longest side of a voxel.
    pub band: f64,
    /// Largest deviation of a coarser brick, voxels; bricks are not coarsened if absent.
    pub tolerance: Option<f64>,
}

/// Smallest band, in longest sides of a voxel. A narrower band would leave cells at the surface without samples: the
/// corners of a cell that contains a root are up to a diagonal, 1.74 voxels, away from it.
const LEAST_BAND: f64 = 2.0;

impl SparseOptions {
    pub fn check(&self) -> Result<(), ArgumentError> {
        if !(self.band.is_finite() && self.band >= LEAST_BAND) {
            let problem = format!("must be at least {LEAST_BAND} voxels, got {}", self.band);
            return Err(ArgumentError::new("band", problem));
        }
        match self.tolerance {
            Some(tolerance) if !(tolerance.is_finite() && tolerance >= 0.0) => {
                Err(ArgumentError::new("tolerance", format!("must be 0 or more voxels, got {tolerance}")))
            }
            _ => Ok(()),
        }
    }
}

/// Source of the samples of a grid.
pub(crate) trait SampleSource: Sync {
    /// Working memory of one thread.
    type Worker: Send;

    fn worker(&self) -> Self::Worker;

    /// The side of a brick that certainly has no sample to store; None if its samples must be evaluated.
    fn far_side(&self, worker: &mut Self::Worker, brick: &SampleBox) -> Option<Side>;

    /// Evaluates signed distances of a box of samples and passes each to `put`.
    fn samples(&self, worker: &mut Self::Worker, of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32));
}

/// Samples from `low` up to, but excluding, `high`; within the grid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SampleBox {
    pub low: [usize; 3],
    pub high: [usize; 3],
}

impl SampleBox {
    /// The samples of a grid of `shape` among `count` along each axis from `first` on; at least the nearest one.
    pub(crate) fn clipped(first: [i32; 3], count: usize, shape: [usize; 3]) -> Self {
        let clip = |axis: usize, i: i32| (i.max(0) as usize).min(shape[axis] - 1);
        Self {
            low: [0, 1, 2].map(|axis| clip(axis, first[axis])),
            high: [0, 1, 2].map(|axis| clip(axis, first[axis].saturating_add(count as i32 - 1)) + 1),
        }
    }

    pub(crate) fn shape(&self) -> [usize; 3] {
        [0, 1, 2].map(|axis| self.high[axis] - self.low[axis])
    }

    /// Number of samples.
    pub(crate) fn len(&self) -> usize {
        self.shape().iter().product()
    }

    /// Index of a sample of this box, x fastest.
    #[inline]
    fn place(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.shape();
        x - self.low[0] + nx * (y - self.low[1] + ny * (z - self.low[2]))
    }

    /// Spreads the samples of this box over `count` along each axis from `first` on, x fastest. A sample outside the
    /// box repeats the nearest one of the box.
    pub(crate) fn spread(&self, samples: &[f32], first: [i32; 3], count: usize, out: &mut [f32]) {
        if samples.len() == out.len() {
            return out.copy_from_slice(samples);
        }
        for (i, value) in out.iter_mut().enumerate() {
            let step = [i % count, i / count % count, i / (count * count)];
            let nearest = |axis: usize| {
                let sample = first[axis].saturating_add(step[axis] as i32).max(0) as usize;
                sample.clamp(self.low[axis], self.high[axis] - 1)
            };
            *value = samples[self.place([0, 1, 2].map(nearest))];
        }
    }
}

/// The side of the surface on which a whole box lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Side {
    Outside,
    Inside,
}

/// Builds the regions of a sparse field and joins them.
#[derive(Debug)]
pub(crate) struct SparseBuilder<T> {
    pub(super) field: SparseField<T>,
    pub(super) bricks: [usize; 3],
    tolerance: Option<f32>,
}

impl<T: Texel> SparseBuilder<T> {
    /// `nodes` have the layout of [`SparseField`].
    pub(crate) fn new(grid: Grid, options: &SparseOptions, nodes: Vec<f32>) -> Result<Self, Error> {
        options.check()?;
        let bricks = brick_counts(&grid);
        let voxel = grid.spacing().max_element();
        let band = (options.band * voxel) as f32;
        let scale = T::ENCODING.scale(voxel, options.band * voxel);
        let index = vec![Entry::Empty { inside: false }.to_word(); bricks.iter().product()];
        let field = SparseField { grid, band, scale, index, nodes, texels: Vec::new() };
        Ok(Self { field, bricks, tolerance: options.tolerance.map(|tolerance| (tolerance * voxel) as f32) })
    }

    /// Number of regions along each axis.
    pub(crate) fn regions(&self) -> [usize; 3] {
        self.bricks.map(|bricks| bricks.div_ceil(REGION_BRICKS))
    }

    /// The range of samples along z that a layer of regions needs.
    pub(crate) fn planes_of_layer(&self, layer: usize) -> std::ops::Range<usize> {
        let bounds = self.clipped([0, 0, layer * REGION_BRICKS], REGION_BRICKS);
        bounds.low[2]..bounds.high[2]
    }

    /// Builds one layer of regions. Layers must be added in order.
    pub(crate) fn add_layer<S: SampleSource>(
        &mut self,
        source: &S,
        layer: usize,
        progress: &Progress,
    ) -> Result<(), Error> {
        let [rx, ry, _] = self.regions();
        let regions: Vec<Region<T>> = (0..rx * ry)
            .into_par_iter()
            .map_init(
                || Worker { source: source.worker(), samples: vec![0.0; REGION_SAMPLES.pow(3)] },
                |worker, i| {
                    progress.check()?;
                    let corner = [i % rx, i / rx, layer].map(|r| r * REGION_BRICKS);
                    let region =
                        RegionJob { builder: self, source, corner, worker, is_filled: [false; REGION_LEN] }.build();
                    progress.advance(REGION_WORK)?;
                    Ok(region)
                },
            )
            .collect::<Result<_, Error>>()?;
        for region in regions {
            let first = (self.field.texels.len() / BRICK_LEN) as u32;
            self.field.texels.extend_from_slice(&region.texels);
            for (brick, entry) in region.entries {
                let entry = match entry {
                    Entry::Stored { level, brick } => Entry::Stored { level, brick: brick + first },
                    empty => empty,
                };
                let [nx, ny, _] = self.bricks;
                self.field.index[brick[0] + nx * (brick[1] + ny * brick[2])] = entry.to_word();
            }
        }
        Ok(())
    }

    /// The samples of a brick, x fastest. Those beyond the faces of the box repeat the ones on the faces.
    pub(super) fn samples_of_brick<S: SampleSource>(
        &self,
        source: &S,
        worker: &mut S::Worker,
        brick: [usize; 3],
    ) -> [f32; BRICK_LEN] {
        let bounds = self.clipped(brick, 1);
        let mut own = [0.0; BRICK_LEN];
        source.samples(worker, &bounds, &mut |sample, distance| own[bounds.place(sample)] = distance);
        let mut samples = [0.0; BRICK_LEN];
        bounds.spread(&own[..bounds.len()], first_sample(brick), BRICK_SAMPLES, &mut samples);
        samples
    }

    pub(crate) fn finish(mut self) -> SparseField<T> {
        self.field.texels.shrink_to_fit();
        self.field
    }

    /// The samples of `count` bricks along each axis from `brick` on, clipped to the grid.
    fn clipped(&self, brick: [usize; 3], count: usize) -> SampleBox {
        SampleBox::clipped(first_sample(brick), count * BRICK_CELLS + 1, self.field.grid.shape)
    }
}

/// The first sample of a brick. The bricks start one sample before the grid.
fn first_sample(brick: [usize; 3]) -> [i32; 3] {
    brick.map(|brick| (brick * BRICK_CELLS) as i32 - 1)
}

/// The contribution of a region to the field.
struct Region<T> {
    /// Bricks of the box and their entries in the index, with stored bricks counted from the region's first.
    entries: Vec<([usize; 3], Entry)>,
    texels: Vec<T>,
}

struct Worker<W> {
    source: W,
    /// Samples of the whole region, x fastest.
    samples: Vec<f32>,
}

struct RegionJob<'a, T, S: SampleSource> {
    builder: &'a SparseBuilder<T>,
    source: &'a S,
    /// The region's first brick.
    corner: [usize; 3],
    worker: &'a mut Worker<S::Worker>,
    is_filled: [bool; REGION_LEN],
}

impl<T: Texel, S: SampleSource> RegionJob<'_, T, S> {
    fn build(mut self) -> Region<T> {
        let sides: [Option<Side>; REGION_LEN] = std::array::from_fn(|i| self.side_of(i));
        let mut region = Region { entries: Vec::new(), texels: Vec::new() };
        let whole = Cube { corner: [0; 3], level: MAX_LEVEL };
        self.store(&whole, &sides, &mut region);
        region
    }

    /// The side of a brick without samples to store. Bricks beyond the end of the box count as such.
    fn side_of(&mut self, i: usize) -> Option<Side> {
        let brick = self.brick(i);
        if (0..3).any(|axis| brick[axis] >= self.builder.bricks[axis]) {
            return Some(Side::Outside);
        }
        let bounds = self.builder.clipped(brick, 1);
        if let Some(side) = self.source.far_side(&mut self.worker.source, &bounds) {
            return Some(side);
        }
        self.fill(i);
        let band = self.builder.field.band;
        let mut inside = 0;
        let samples = self.samples(&Cube { corner: unravel(i), level: 0 });
        for &sample in &samples {
            if sample.abs() < band {
                return None;
            }
            inside += usize::from(sample < 0.0);
        }
        match inside {
            0 => Some(Side::Outside),
            BRICK_LEN => Some(Side::Inside),
            _ => None,
        }
    }

    /// Stores a cube of bricks, as a single brick if that is accurate enough. Returns whether one brick holds all
    /// stored samples.
    fn store(&mut self, cube: &Cube, sides: &[Option<Side>; REGION_LEN], region: &mut Region<T>) -> bool {
        let stored = cube.bricks().filter(|&i| sides[i].is_none()).count();
        if cube.level == 0 || stored == 0 {
            for i in cube.bricks() {
                self.push(&Cube { corner: unravel(i), level: 0 }, sides[i], region);
            }
            return stored > 0;
        }
        // From fine to coarse: if a part could not be stored as one brick, the whole cannot either.
        let before = (region.entries.len(), region.texels.len());
        let mut stored_parts = 0;
        let mut all_are_one = true;
        for part in cube.parts() {
            let is_empty = part.bricks().all(|i| sides[i].is_some());
            let is_one = self.store(&part, sides, region);
            stored_parts += usize::from(!is_empty);
            all_are_one &= is_empty || is_one;
        }
        if stored_parts < 2 || !all_are_one || !self.fits(cube) {
            return stored_parts < 2 && all_are_one;
        }
        region.entries.truncate(before.0);
        region.texels.truncate(before.1);
        self.push(cube, None, region);
        true
    }

    /// Whether the samples of a coarser brick represent all those that it would replace.
    fn fits(&mut self, cube: &Cube) -> bool {
        let Some(tolerance) = self.builder.tolerance else { return false };
        cube.bricks().for_each(|i| self.fill(i));
        // The samples as they will be stored.
        let limit = self.limit();
        let coarse = self.samples(cube).map(|sample| sample.clamp(-limit, limit));
        // From the distance `far` on, a lower bound is sufficient: beyond the band, and in cells with a corner that the
        // encoding clamps.
        let far = if limit < f32::MAX { 0.5 * limit } else { self.builder.field.band };
        let steps = 1usize << cube.level;
        let is_cut = |cell: [usize; 3]| {
            let first = cell[0] + BRICK_SAMPLES * (cell[1] + BRICK_SAMPLES * cell[2]);
            (0..8).any(|i| {
                coarse[first + (i & 1) + BRICK_SAMPLES * ((i >> 1 & 1) + BRICK_SAMPLES * (i >> 2))].abs() >= limit
            })
        };
        let (first, last) = self.first_and_last(cube);
        let samples = &self.worker.samples;
        for z in first[2]..=last[2] {
            for y in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let at = [x - first[0], y - first[1], z - first[2]];
                    let value = coarse_value(&coarse, at, cube.level);
                    let truth = samples[place([x, y, z])];
                    let error = (value - truth.clamp(-limit, limit)).abs();
                    // Beyond the band a neighbour may be empty and store only its side.
                    if error <= tolerance && (truth.abs() < self.builder.field.band || value * truth > 0.0) {
                        continue;
                    }
                    let cell = at.map(|i| (i / steps).min(BRICK_CELLS - 1));
                    let is_bound = value * truth > 0.0 && value.abs() <= truth.abs() + tolerance;
                    if !(is_bound && truth.abs() >= far && (limit == f32::MAX || is_cut(cell))) {
                        return false;
                    }
                }
            }
        }
        true
    }

    /// Magnitude from which a normalised encoding clamps; f32::MAX for floats, whose range ends far beyond the band.
    fn limit(&self) -> f32 {
        if T::ENCODING.is_normalised() { self.builder.field.scale } else { f32::MAX }
    }

    /// First and last sample of a cube inside the grid or half a voxel beside it, relative to the region.
    fn first_and_last(&self, cube: &Cube) -> ([usize; 3], [usize; 3]) {
        let first = cube.corner.map(|brick| brick * BRICK_CELLS);
        let last = [0, 1, 2].map(|axis| {
            let last = first[axis] + (BRICK_CELLS << cube.level);
            // Sample -1 of the grid has index 0. The n samples of the grid have indices 1 to n, and n + 1 repeats the
            // last.
            let end = self.builder.field.grid.shape[axis] + 1;
            last.min(end.saturating_sub(self.corner[axis] * BRICK_CELLS)).max(first[axis])
        });
        (first, last)
    }

    /// Appends a brick.
    fn push(&mut self, cube: &Cube, side: Option<Side>, region: &mut Region<T>) {
        let entry = match side {
            Some(side) => Entry::Empty { inside: side == Side::Inside },
            None => {
                let brick = (region.texels.len() / BRICK_LEN) as u32;
                let scale = self.builder.field.scale;
                cube.bricks().for_each(|i| self.fill(i));
                region.texels.extend(self.samples(cube).iter().map(|&sample| T::encode(sample, scale)));
                Entry::Stored { level: cube.level, brick }
            }
        };
        for i in cube.bricks() {
            let brick = self.brick(i);
            if (0..3).all(|axis| brick[axis] < self.builder.bricks[axis]) {
                region.entries.push((brick, entry));
            }
        }
    }

    /// The samples of a cube as a brick of its level.
    fn samples(&self, cube: &Cube) -> [f32; BRICK_LEN] {
        let first = cube.corner.map(|brick| brick * BRICK_CELLS);
        std::array::from_fn(|i| {
            let at = sample_in_brick(i);
            self.worker.samples[place([0, 1, 2].map(|axis| first[axis] + (at[axis] << cube.level)))]
        })
    }

    /// Evaluates the samples of a brick of the region, once.
    fn fill(&mut self, i: usize) {
        if std::mem::replace(&mut self.is_filled[i], true) {
            return;
        }
        let brick = self.brick(i);
        let first = unravel(i).map(|brick| brick * BRICK_CELLS);
        let Worker { source, samples } = &mut *self.worker;
        for (at, sample) in self.builder.samples_of_brick(self.source, source, brick).into_iter().enumerate() {
            let local = sample_in_brick(at);
            samples[place([0, 1, 2].map(|axis| first[axis] + local[axis]))] = sample;
        }
    }

    /// Position in the box of a brick of the region.
    fn brick(&self, i: usize) -> [usize; 3] {
        let local = unravel(i);
        [0, 1, 2].map(|axis| self.corner[axis] + local[axis])
    }
}

/// The bricks of a region that a brick of some level covers.
#[derive(Debug, Clone, Copy)]
struct Cube {
    /// Its first brick in the region.
    corner: [usize; 3],
    level: u32,
}

impl Cube {
    fn parts(self) -> impl Iterator<Item = Cube> {
        let level = self.level - 1;
        (0..8usize).map(move |i| {
            let step = [i & 1, i >> 1 & 1, i >> 2];
            Cube { corner: [0, 1, 2].map(|axis| self.corner[axis] + (step[axis] << level)), level }
        })
    }

    fn bricks(self) -> impl Iterator<Item = usize> {
        let side = 1usize << self.level;
        (0..side * side * side).map(move |i| {
            let step = [i % side, i / side % side, i / (side * side)];
            let [x, y, z] = [0, 1, 2].map(|axis| self.corner[axis] + step[axis]);
            x + REGION_BRICKS * (y + REGION_BRICKS * z)
        })
    }
}

/// Position of brick `i` in a region.
fn unravel(i: usize) -> [usize; 3] {
    [i % REGION_BRICKS, i / REGION_BRICKS % REGION_BRICKS, i / (REGION_BRICKS * REGION_BRICKS)]
}

/// Index of a sample of a region in memory.
#[inline]
fn place([x, y, z]: [usize; 3]) -> usize {
    x + REGION_SAMPLES * (y + REGION_SAMPLES * z)
}

impl<T: Texel> FieldView<'_, T> {
    /// Converts the field to bricks. The surface must lie in the box `inner`.
    pub fn to_sparse<U: Texel>(
        &self,
        inner: [DVec3; 2],
        options: &SparseOptions,
        progress: &Progress,
    ) -> Result<SparseField<U>, Error> {
        options.check()?;
        let grid = *self.grid();
        let node_grid = node_grid(&grid);
        let mut nodes = vec![0.0; node_grid.len()];
        let [nx, ny, _] = node_grid.shape;
        nodes.par_chunks_mut(nx).enumerate().for_each(|(row, nodes)| {
            for (x, node) in nodes.iter_mut().enumerate() {
                let p = node_grid.center(x, row % ny, row / ny);
                // At a node beside the box only a bound is known.
                let is_sample = [x, row % ny, row / ny]
                    .into_iter()
                    .zip(grid.shape)
                    .all(|(i, n)| (1..=n).contains(&(i * BRICK_CELLS)));
                *node = if is_sample { self.sample_nearest(p).abs() } else { self.bound_beside(p, inner) };
            }
        });
        let mut builder = SparseBuilder::new(grid, options, nodes)?;
        let [rx, ry, rz] = builder.regions();
        progress.set_total((rx * ry * rz) as u64 * REGION_WORK);
        for layer in 0..rz {
            builder.add_layer(self, layer, progress)?;
        }
        Ok(builder.finish())
    }

    /// Lower bound on the distance at a point beyond the outermost samples.
    fn bound_beside(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        if !self.contains(p) {
            return self.distance_bound(p, inner);
        }
        let nearest = p.max(self.grid().center(0, 0, 0)).min(self.grid().upper - 0.5 * self.grid().spacing());
        (f64::from(self.sample_nearest(nearest).abs()) - (p - nearest).length()).max(0.0) as f32
    }
}

impl<T: Texel> SampleSource for FieldView<'_, T> {
    type Worker = ();

    fn worker(&self) {}

    fn far_side(&self, (): &mut (), _: &SampleBox) -> Option<Side> {
        None
    }

    fn samples(&self, (): &mut (), of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32)) {
        let SampleBox { low, high } = *of;
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                for x in low[0]..high[0] {
                    put([x, y, z], self.texels()[self.grid().offset(x, y, z)].decode(self.scale()));
                }
            }
        }
    }
}
