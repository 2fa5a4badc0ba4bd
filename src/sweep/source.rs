//! The samples of a swept solid, brick by brick.
//!
//! A brick that is certainly outside the band, or certainly inside, stores no sample. The bounds at the corners of all
//! bricks decide most of them. The others narrow the motion to the intervals that can matter in the brick, then in each
//! of its eight parts, and every sample searches those intervals only.

use super::Sweep;
use super::search::{Found, Goal, Interval, Searcher};
use crate::assembly::Geometry;
use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::require;
use crate::progress::Progress;
use crate::volume::Texel;
use crate::volume::outside::round_down;
use crate::volume::sparse::build::{REGION_WORK, SampleBox, SampleSource, Side, SparseBuilder, SparseOptions};
use crate::volume::sparse::{BRICK_CELLS, SparseField, brick_counts, node_grid};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// Tolerance of the distances at the corners of bricks: a share of the distance, or of the side of a brick.
const CORNER_TOLERANCE: f64 = 0.1;

/// The share of the tolerance that remains for the search; the rest is for the rounding of samples to float32.
const ROUNDED: f64 = 0.999;

/// Options of a sweep, world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepOptions {
    /// Amount that is subtracted from the distance.
    pub offset: f64,
    /// Largest difference of a sample in the band from the distance.
    pub tolerance: f64,
    /// Bricks with a sample nearer to the surface are stored.
    pub band: f64,
}

/// The cost of a sweep.
#[derive(Debug, Clone, Copy, Default)]
pub struct Cost {
    /// Number of evaluated samples.
    pub samples: u64,
    /// Number of distances from a posed body, for these samples and for the choice of bricks.
    pub evaluations: u64,
}

impl Sweep {
    /// The sparse field of the smallest distance over the motion minus the offset.
    pub fn bake<T: Texel>(
        &self,
        grid: &Grid,
        options: &SweepOptions,
        progress: &Progress,
    ) -> Result<(SparseField<T>, Cost), Error> {
        let voxel = grid.spacing().max_element();
        let sparse = SparseOptions { band: options.band / voxel, tolerance: None };
        sparse.check()?;
        self.check_reach(grid)?;
        let nodes_on = node_grid(grid);
        require("the index of a sparse field", 2 * size_of::<f32>() as u64 * nodes_on.len() as u64, 0)?;
        let regions = brick_counts(grid).map(|n| n.div_ceil(4)).iter().product::<usize>() as u64;
        progress.set_total(nodes_on.len() as u64 + regions * REGION_WORK);

        let cost = SharedCost::default();
        let corners = self.corners(&nodes_on, options, &cost, progress)?;
        let nodes = corners.iter().map(|&corner| round_down(corner.abs())).collect();
        let scale = T::ENCODING.scale(voxel, options.band);
        let mut builder = SparseBuilder::new(*grid, &sparse, nodes)?;
        let source = Source {
            sweep: self,
            is_still: self.is_still(),
            grid,
            options,
            corners: &corners,
            encoding: T::ENCODING,
            scale,
            cost: &cost,
            progress,
        };
        for layer in 0..builder.regions()[2] {
            builder.add_layer(&source, layer, progress)?;
        }
        let cost = Cost {
            samples: cost.samples.load(Ordering::Relaxed),
            evaluations: cost.evaluations.load(Ordering::Relaxed),
        };
        Ok((builder.finish(), cost))
    }

    /// Lower bounds of the magnitude of the field at the corners of all bricks, with the sign of the field; 0 where the
    /// sign is not certain.
    fn corners(
        &self,
        nodes_on: &Grid,
        options: &SweepOptions,
        cost: &SharedCost,
        progress: &Progress,
    ) -> Result<Vec<f64>, Error> {
        let mut corners = vec![0.0; nodes_on.len()];
        let [nx, ny, _] = nodes_on.shape;
        let tolerance = CORNER_TOLERANCE * nodes_on.spacing().max_element();
        let goal = Goal { tolerance, share: CORNER_TOLERANCE, above: f64::INFINITY, below: f64::NEG_INFINITY };
        corners.par_chunks_mut(nx).enumerate().try_for_each_init(
            || Counted { searcher: Searcher::new(self), cost },
            |counted, (row, corners)| {
                for (x, corner) in corners.iter_mut().enumerate() {
                    let p = nodes_on.center(x, row % ny, row / ny);
                    let whole = counted.searcher.whole(p);
                    let Found { lower, upper } = counted.searcher.smallest(p, &whole, 0.0, &goal);
                    // The surface of the samples lies within the tolerance of the field's.
                    let outside = lower - options.offset - options.tolerance;
                    let inside = upper - options.offset;
                    *corner = if outside > 0.0 { outside } else { inside.min(0.0) };
                    progress.check()?;
                }
                progress.advance(nx as u64)
            },
        )?;
        Ok(corners)
    }

    /// Fails if a body is too far from a sample for the search of its mesh.
    fn check_reach(&self, grid: &Grid) -> Result<(), Error> {
        let mut all = [grid.lower, grid.upper];
        if let Some([lower, upper]) = self.bounds() {
            all = [all[0].min(lower), all[1].max(upper)];
        }
        let reach = DVec3::splat(2.0 * (all[1] - all[0]).length());
        for element in &self.bodies.elements {
            if let Geometry::Mesh(mesh) = &element.geometry
                && !mesh.can_reach(mesh.center() + reach)
            {
                let problem = "the box is too far from a body for float32 distances";
                return Err(ArgumentError::new("bounds", problem).into());
            }
        }
        Ok(())
    }
}

#[derive(Debug, Default)]
struct SharedCost {
    samples: AtomicU64,
    evaluations: AtomicU64,
}

/// The state of one thread. Its cost is added to the sum at the end.
struct Counted<'a> {
    searcher: Searcher<'a>,
    cost: &'a SharedCost,
}

impl Drop for Counted<'_> {
    fn drop(&mut self) {
        self.cost.evaluations.fetch_add(self.searcher.evaluations, Ordering::Relaxed);
    }
}

struct Source<'a> {
    sweep: &'a Sweep,
    is_still: bool,
    grid: &'a Grid,
    options: &'a SweepOptions,
    corners: &'a [f64],
    encoding: Encoding,
    scale: f32,
    cost: &'a SharedCost,
    progress: &'a Progress,
}

struct Worker<'a> {
    counted: Counted<'a>,
    /// The brick of the last call, and the intervals that can matter there.
    brick: Option<(SampleBox, Vec<Interval>)>,
}

impl Source<'_> {
    /// The middle of a box of samples, and the distance of its corners.
    fn ball(&self, of: &SampleBox) -> (DVec3, f64) {
        let [a, b] = [of.low, of.high.map(|i| i - 1)].map(|[x, y, z]| self.grid.center(x, y, z));
        (0.5 * (a + b), 0.5 * (b - a).length())
    }

    /// The largest value of `sign * field` at the corners of a brick.
    fn farthest_corner(&self, of: &SampleBox, sign: f64) -> f64 {
        let [nx, ny, _] = brick_counts(self.grid).map(|bricks| bricks + 1);
        let [x, y, z] = of.low.map(|low| (low + 1) / BRICK_CELLS);
        let corner = |i: usize| self.corners[x + (i & 1) + nx * (y + (i >> 1 & 1) + ny * (z + (i >> 2)))];
        (0..8).map(|i| sign * corner(i)).fold(f64::NEG_INFINITY, f64::max)
    }

    /// The goal of a search for all points within a radius: whether they are all outside the band.
    fn goal(&self, radius: f64) -> Goal {
        let SweepOptions { offset, tolerance, band } = *self.options;
        // Bodies that stand still have exact samples.
        let tolerance = if self.is_still { 0.0 } else { tolerance };
        let above = offset + band + tolerance + radius;
        Goal { tolerance: ROUNDED * tolerance, share: 0.0, above, below: offset - band - radius }
    }

    /// A stored value that is at most the field, in the encoding of the samples.
    fn rounded(&self, field: f64) -> f32 {
        let value = round_down(field);
        if value >= 0.0 {
            // Encodings round toward zero.
            return value;
        }
        round_down(f64::from(value) - 1.01 * f64::from(self.encoding.error_bound(value.abs(), self.scale)))
    }
}

impl<'a> SampleSource for Source<'a> {
    type Worker = Worker<'a>;

    fn worker(&self) -> Worker<'a> {
        Worker { counted: Counted { searcher: Searcher::new(self.sweep), cost: self.cost }, brick: None }
    }

    fn far_side(&self, worker: &mut Worker<'a>, brick: &SampleBox) -> Option<Side> {
        let (center, radius) = self.ball(brick);
        let far = self.options.band + BRICK_CELLS as f64 * self.grid.spacing().length();
        if self.farthest_corner(brick, 1.0) >= far {
            return Some(Side::Outside);
        }
        if self.farthest_corner(brick, -1.0) >= far {
            return Some(Side::Inside);
        }
        if self.progress.check().is_err() {
            return Some(Side::Outside);
        }
        let searcher = &mut worker.counted.searcher;
        let whole = searcher.whole(center);
        let (found, intervals) = searcher.narrow(center, radius, &whole, 0.0, &self.goal(radius));
        worker.brick = None;
        let Some(intervals) = intervals else {
            let is_inside = found.upper <= self.goal(radius).below;
            return Some(if is_inside { Side::Inside } else { Side::Outside });
        };
        worker.brick = Some((*brick, intervals));
        None
    }

    fn samples(&self, worker: &mut Worker<'a>, of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32)) {
        let (middle, radius) = self.ball(of);
        let searcher = &mut worker.counted.searcher;
        let intervals = match worker.brick.take() {
            Some((brick, intervals)) if brick == *of => intervals,
            _ => searcher.whole(middle),
        };
        self.cost.samples.fetch_add(of.len() as u64, Ordering::Relaxed);
        let offset = self.options.offset;
        let half = [0, 1, 2].map(|axis| of.low[axis].midpoint(of.high[axis]));
        for part in 0..8 {
            let of = SampleBox {
                low: [0, 1, 2].map(|axis| if part >> axis & 1 == 0 { of.low[axis] } else { half[axis] }),
                high: [0, 1, 2].map(|axis| if part >> axis & 1 == 0 { half[axis] } else { of.high[axis] }),
            };
            // The caller drops the field of a cancelled job.
            if of.len() == 0 || self.progress.check().is_err() {
                continue;
            }
            let (center, own_radius) = self.ball(&of);
            let shift = center.distance(middle).min(radius);
            let goal = self.goal(own_radius);
            let (found, near) = searcher.narrow(center, own_radius, &intervals, shift, &goal);
            for z in of.low[2]..of.high[2] {
                for y in of.low[1]..of.high[1] {
                    for x in of.low[0]..of.high[0] {
                        let p = self.grid.center(x, y, z);
                        let away = p.distance(center);
                        let distance = match &near {
                            Some(near) => {
                                let own = self.goal(0.0);
                                let found = searcher.smallest(p, near, away, &own);
                                if found.upper <= own.below { found.upper } else { found.lower }
                            }
                            None if found.upper <= goal.below => found.upper + away,
                            None => found.lower - away,
                        };
                        put([x, y, z], self.rounded(distance - offset));
                    }
                }
            }
        }
    }
}
