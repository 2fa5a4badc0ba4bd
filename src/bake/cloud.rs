//! Bakes of a cloud of points: a dense grid sample by sample, and bricks near the disks.
//!
//! Samples of a row follow each other, so the nearest disk of one bounds the search of the next. The distance is
//! 1-Lipschitz: a brick whose centre is farther from the disks than the band and half its diagonal has no sample in the
//! band, and it has the side of its corners.

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
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Number of samples inside, and of those whose side is a guess across a hole.
#[derive(Debug, Clone, Copy, Default)]
pub struct CloudCounts {
    /// Number of samples inside.
    pub inside: usize,
    /// Number of samples whose side is a guess.
    pub undecided: usize,
}

impl CloudCounts {
    fn with(self, sample: &Sample) -> Self {
        self.and(Self { inside: sample.is_inside.into(), undecided: sample.is_guess.into() })
    }

    fn and(self, other: Self) -> Self {
        Self { inside: self.inside + other.inside, undecided: self.undecided + other.undecided }
    }
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
    let of_row = |(row, samples): (usize, &mut [f32])| -> Result<CloudCounts, Error> {
        let (mut last, mut counts) = (None, CloudCounts::default());
        for (x, place) in samples.iter_mut().enumerate() {
            let sample = sampler.sample([x, row % ny, row / ny], &mut last);
            *place = sample.distance;
            counts = counts.with(&sample);
            progress.check()?;
        }
        progress.advance(nx as u64).map(|()| counts)
    };
    let rows = distances.par_chunks_mut(nx).enumerate().map(of_row);
    let counts = rows.try_reduce(CloudCounts::default, |a, b| Ok(a.and(b)))?;
    Ok((distances, counts))
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
            *sample = at_nodes.sample([x, row % ny, row / ny], &mut last).distance;
        }
        progress.advance(nx as u64)
    })?;
    let voxel = grid.spacing();
    let near = options.band * voxel.max_element() + 0.5 * BRICK_CELLS as f64 * voxel.length();
    let is_counted = (0..brick_counts(grid).iter().product()).map(|_| AtomicBool::new(false)).collect();
    let sampler = Sampler::new(cloud, grid, signed);
    let source = Bricks { sampler, near, is_counted, undecided: AtomicUsize::new(0) };
    let mut builder = SparseBuilder::new(*grid, options, nodes)?;
    for layer in 0..builder.regions()[2] {
        builder.add_layer(&source, layer, progress)?;
    }
    if signed {
        builder.follow(&source, progress)?;
    }
    let field = builder.finish();
    let inside = field.view()?.count_inside();
    Ok((field, CloudCounts { inside, undecided: source.undecided.into_inner() }))
}

fn check(cloud: &PointCloud, grid: &Grid) -> Result<(), ArgumentError> {
    match [grid.lower, grid.upper].into_iter().find(|corner| !cloud.can_reach(corner.to_array())) {
        Some(corner) => Err(ArgumentError::new("bounds", format!("the corner {corner} is too far from the cloud"))),
        None => Ok(()),
    }
}

/// A sample of a grid.
struct Sample {
    distance: f32,
    is_inside: bool,
    /// Whether the side is a guess across a hole.
    is_guess: bool,
}

/// Evaluates samples of a grid.
struct Sampler<'a> {
    cloud: &'a PointCloud,
    grid: &'a Grid,
    signed: bool,
}

impl<'a> Sampler<'a> {
    fn new(cloud: &'a PointCloud, grid: &'a Grid, signed: bool) -> Self {
        Self { cloud, grid, signed }
    }

    fn local(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        self.cloud.local_from_world(self.grid.center(x, y, z).to_array())
    }

    /// `last` is the nearest point of the sample before.
    fn sample(&self, at: [usize; 3], last: &mut Option<DVec3>) -> Sample {
        let p = self.local(at);
        let found = self.cloud.nearest(p, last.map_or(f64::INFINITY, |near| p.distance(near)));
        *last = Some(found.point);
        let distance = found.distance * self.cloud.scale();
        let (is_inside, is_guess) = if self.signed { self.cloud.side(p, distance) } else { (false, false) };
        Sample { distance: (if is_inside { -distance } else { distance }) as f32, is_inside, is_guess }
    }
}

/// Bricks of a cloud.
struct Bricks<'a> {
    sampler: Sampler<'a>,
    /// A brick whose centre is farther from the disks than this has no sample in the band, world units.
    near: f64,
    /// Whether the guesses of a brick are counted. A brick may be evaluated several times.
    is_counted: Vec<AtomicBool>,
    /// Number of samples whose side is a guess, in the evaluated bricks.
    undecided: AtomicUsize,
}

/// The brick that owns a sample. The first samples of a brick are also the last ones of the brick before.
fn owner(sample: [usize; 3]) -> [usize; 3] {
    sample.map(|i| (i + 1) / BRICK_CELLS)
}

impl SampleSource for Bricks<'_> {
    type Worker = ();

    fn worker(&self) {}

    fn far_side(&self, (): &mut (), of: &SampleBox) -> Option<Side> {
        let Sampler { cloud, signed, .. } = self.sampler;
        let last = of.high.map(|i| i - 1);
        let center = 0.5 * (self.sampler.local(of.low) + self.sampler.local(last));
        let distance = cloud.nearest(center, f64::INFINITY).distance * cloud.scale();
        if distance <= self.near {
            return None;
        }
        if !signed {
            return Some(Side::Outside);
        }
        // A brick with guesses is evaluated, so that they are counted.
        let side = |p: DVec3| match cloud.side(p, distance) {
            (is_inside, false) => Some(if is_inside { Side::Inside } else { Side::Outside }),
            _ => None,
        };
        let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { of.low[axis] } else { last[axis] });
        let common = side(center)?;
        (0..8).all(|i| side(self.sampler.local(corner(i))) == Some(common)).then_some(common)
    }

    fn samples(&self, (): &mut (), of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32)) {
        let brick = owner(of.low);
        let mut guesses = 0;
        let mut last = None;
        for z in of.low[2]..of.high[2] {
            for y in of.low[1]..of.high[1] {
                for x in of.low[0]..of.high[0] {
                    let at = [x, y, z];
                    let sample = self.sampler.sample(at, &mut last);
                    put(at, sample.distance);
                    guesses += usize::from(sample.is_guess && owner(at) == brick);
                }
            }
        }
        let [nx, ny, _] = brick_counts(self.sampler.grid);
        if !self.is_counted[brick[0] + nx * (brick[1] + ny * brick[2])].swap(true, Ordering::Relaxed) {
            self.undecided.fetch_add(guesses, Ordering::Relaxed);
        }
    }
}
