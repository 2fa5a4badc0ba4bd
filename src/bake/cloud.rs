//! Bakes of a cloud of points: a dense grid sample by sample, and bricks near the disks.
//!
//! Samples of a row follow each other, so the nearest disk of one bounds the search of the next. The distance is
//! 1-Lipschitz: a brick whose centre is farther from the disks than the band and half its diagonal has no sample in the
//! band, and its side is that of its corners.

use crate::cloud::PointCloud;
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use crate::volume::Texel;
use crate::volume::sparse::build::{REGION_WORK, SampleBox, SampleSource, Side, SparseBuilder, SparseOptions};
use crate::volume::sparse::{BRICK_CELLS, REGION_BRICKS, SparseField, brick_counts, node_grid};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of samples inside, and of those whose side is a guess across a hole.
#[derive(Debug, Clone, Copy, Default)]
pub struct CloudCounts {
    /// Number of samples inside.
    pub inside: usize,
    /// Number of samples whose side is a guess.
    pub undecided: usize,
}

/// Distances of a grid, world units, x fastest; negative inside if `signed`.
pub fn bake_cloud(
    cloud: &PointCloud,
    grid: &Grid,
    signed: bool,
    progress: &Progress,
) -> Result<(Vec<f32>, CloudCounts), Error> {
    check(cloud, grid)?;
    let [nx, ny, nz] = grid.shape;
    let mut distances = allocate_samples(&format!("a field of {nx} x {ny} x {nz} samples"), grid.len(), 0)?;
    progress.set_total(grid.len() as u64);
    let sampler = Sampler::new(cloud, grid, signed);
    distances.par_chunks_mut(nx).enumerate().try_for_each(|(row, samples)| {
        let mut last = None;
        for (x, sample) in samples.iter_mut().enumerate() {
            *sample = sampler.sample([x, row % ny, row / ny], &mut last);
            progress.check()?;
        }
        progress.advance(nx as u64)
    })?;
    Ok((distances, sampler.counts()))
}

/// Bricks of a cloud near its disks.
pub fn bake_cloud_sparse<T: Texel>(
    cloud: &PointCloud,
    grid: &Grid,
    signed: bool,
    options: &SparseOptions,
    progress: &Progress,
) -> Result<(SparseField<T>, CloudCounts), Error> {
    options.check()?;
    check(cloud, grid)?;
    let nodes_on = node_grid(grid);
    let regions = brick_counts(grid).map(|bricks| bricks.div_ceil(REGION_BRICKS)).iter().product::<usize>() as u64;
    progress.set_total(nodes_on.len() as u64 + regions * REGION_WORK);
    let mut nodes = allocate_samples("the index of a sparse field", nodes_on.len(), 0)?;
    let at_nodes = Sampler::new(cloud, &nodes_on, false);
    let [nx, ny, _] = nodes_on.shape;
    nodes.par_chunks_mut(nx).enumerate().try_for_each(|(row, samples)| {
        let mut last = None;
        for (x, sample) in samples.iter_mut().enumerate() {
            *sample = at_nodes.sample([x, row % ny, row / ny], &mut last);
        }
        progress.advance(nx as u64)
    })?;
    let voxel = grid.spacing();
    let near = options.band * voxel.max_element() + 0.5 * BRICK_CELLS as f64 * voxel.length();
    let source = Bricks { sampler: Sampler::new(cloud, grid, signed), near };
    let mut builder = SparseBuilder::new(*grid, options, nodes)?;
    for layer in 0..builder.regions()[2] {
        builder.add_layer(&source, layer, progress)?;
    }
    if signed {
        builder.follow(&source, progress)?;
    }
    let field = builder.finish();
    let inside = field.view()?.count_inside();
    Ok((field, CloudCounts { inside, ..source.sampler.counts() }))
}

fn check(cloud: &PointCloud, grid: &Grid) -> Result<(), ArgumentError> {
    match [grid.lower, grid.upper].into_iter().find(|corner| !cloud.can_reach(corner.to_array())) {
        Some(corner) => Err(ArgumentError::new("bounds", format!("the corner {corner} is too far from the cloud"))),
        None => Ok(()),
    }
}

/// Evaluates samples of a grid and counts them.
struct Sampler<'a> {
    cloud: &'a PointCloud,
    grid: &'a Grid,
    signed: bool,
    inside: AtomicUsize,
    undecided: AtomicUsize,
}

impl<'a> Sampler<'a> {
    fn new(cloud: &'a PointCloud, grid: &'a Grid, signed: bool) -> Self {
        Self { cloud, grid, signed, inside: AtomicUsize::new(0), undecided: AtomicUsize::new(0) }
    }

    fn counts(&self) -> CloudCounts {
        let read = |count: &AtomicUsize| count.load(Ordering::Relaxed);
        CloudCounts { inside: read(&self.inside), undecided: read(&self.undecided) }
    }

    fn local(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        self.cloud.local_from_world(self.grid.center(x, y, z).to_array())
    }

    /// The distance of a sample. `last` is the nearest point of the sample before.
    fn sample(&self, at: [usize; 3], last: &mut Option<DVec3>) -> f32 {
        let p = self.local(at);
        let found = self.cloud.nearest(p, last.map_or(f64::INFINITY, |near| p.distance(near)));
        *last = Some(found.point);
        let distance = found.distance * self.cloud.scale();
        if !self.signed {
            return distance as f32;
        }
        let (inside, excess) = self.cloud.side(p);
        self.inside.fetch_add(usize::from(inside), Ordering::Relaxed);
        let is_guess = self.cloud.is_undecided(distance, excess);
        self.undecided.fetch_add(usize::from(is_guess), Ordering::Relaxed);
        (if inside { -distance } else { distance }) as f32
    }
}

/// Bricks of a cloud.
struct Bricks<'a> {
    sampler: Sampler<'a>,
    /// A brick whose centre is farther from the disks than this has no sample in the band, world units.
    near: f64,
}

impl SampleSource for Bricks<'_> {
    type Worker = ();

    fn worker(&self) {}

    fn far_side(&self, (): &mut (), of: &SampleBox) -> Option<Side> {
        let Sampler { cloud, signed, .. } = self.sampler;
        let last = of.high.map(|i| i - 1);
        let center = 0.5 * (self.sampler.local(of.low) + self.sampler.local(last));
        if cloud.nearest(center, f64::INFINITY).distance * cloud.scale() <= self.near {
            return None;
        }
        if !signed {
            return Some(Side::Outside);
        }
        let inside = |i: usize| {
            let corner = [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { of.low[axis] } else { last[axis] });
            cloud.side(self.sampler.local(corner)).0
        };
        let first = inside(0);
        (1..8).all(|i| inside(i) == first).then_some(if first { Side::Inside } else { Side::Outside })
    }

    fn samples(&self, (): &mut (), of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32)) {
        let mut last = None;
        for z in of.low[2]..of.high[2] {
            for y in of.low[1]..of.high[1] {
                for x in of.low[0]..of.high[0] {
                    put([x, y, z], self.sampler.sample([x, y, z], &mut last));
                }
            }
        }
    }
}
