//! Bake of a mesh to a sparse field: bricks are baked one by one, without the dense grid.
//!
//! # Theory
//!
//! The distances at the corners of all bricks, every seventh sample, come first. The distance is 1-Lipschitz. If all
//! corners of a brick are farther from the surface than the band plus the brick's diagonal, no sample of the brick is
//! in the band. The remaining bricks are tested again at their centres, and those that pass are baked by the blocks of
//! [`super::dense`].
//!
//! Rules that count by planes ([`super::signs`]) classify a layer of regions at a time, one bit per sample. The other
//! rules classify single samples: all samples of bricks near the surface, and corners of the others, one corner if the
//! mesh is closed. The side of an open mesh changes far from its triangles too; the bricks there are found from their
//! neighbours ([`SparseBuilder::follow`](crate::volume::sparse::build::SparseBuilder::follow)).
//!
//! # Cost
//!
//! Time and memory are proportional to the number of bricks near the surface, except for the bits of a layer, which
//! cover all its samples: 15 MB of bits at 2048^3, and less than a nanosecond per sample.

use super::signs::SignPass;
use super::{BakeOptions, LocalGrid, Report, dense};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::require;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignRule;
use crate::volume::Texel;
use crate::volume::sparse::build::{REGION_WORK, SampleBox, SampleSource, Side, SparseBuilder, SparseOptions};
use crate::volume::sparse::{BRICK_CELLS, BRICK_LEN, REGION_BRICKS, SparseField, brick_counts, node_grid};
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// Bakes a sparse field on the CPU. The band of `sparse` is used, `bake.band` is ignored.
pub fn bake_sparse<T: Texel>(
    mesh: &Mesh,
    grid: &Grid,
    bake: &BakeOptions,
    sparse: &SparseOptions,
    progress: &Progress,
) -> Result<(SparseField<T>, Report), Error> {
    sparse.check()?;
    bake.check(mesh, grid)?;
    let mut seconds = Vec::new();
    let mut stage = |name, since: Instant| seconds.push((name, since.elapsed().as_secs_f64()));
    let nodes_on = node_grid(grid);
    require("the index of a sparse field", 2 * size_of::<f32>() as u64 * nodes_on.len() as u64, 0)?;

    let start = Instant::now();
    rayon::join(|| mesh.bvh(), || mesh.topology());
    progress.check()?;
    stage("tree and topology", start);

    let start = Instant::now();
    let (choice, mut report) = bake.choose_sign(mesh);
    progress.check()?;
    stage("sign rule", start);

    // Distances of the two-sided sheet are the distances of the triangles minus this.
    let half_thickness = bake.thickness.map_or(0.0, |thickness| 0.5 * thickness);
    let start = Instant::now();
    let mut nodes = vec![0.0; nodes_on.len()];
    let scale = mesh.scale() as f32;
    let regions = brick_counts(grid).map(|bricks| bricks.div_ceil(REGION_BRICKS)).iter().product::<usize>() as u64;
    progress.set_total(nodes.len() as u64 + regions * REGION_WORK);
    dense::distances(mesh, &LocalGrid::new(&nodes_on, mesh), f32::INFINITY, scale, progress, &mut nodes)?;
    nodes.par_iter_mut().for_each(|node| *node = (f64::from(*node) - half_thickness).abs() as f32);
    stage("brick corners", start);

    let start = Instant::now();
    let corners = nodes.clone();
    let local = LocalGrid::new(grid, mesh);
    let voxel = grid.spacing();
    let job = SparseJob {
        mesh,
        rule: &choice.rule,
        local,
        corners: &corners,
        bricks: brick_counts(grid),
        half_thickness,
        near: sparse.band * voxel.max_element() + 0.5 * BRICK_CELLS as f64 * voxel.length(),
        is_closed: report.closed,
    };
    require("a sparse field", (job.count_near() * BRICK_LEN * size_of::<T>()) as u64, 0)?;
    let mut builder = SparseBuilder::new(*grid, sparse, nodes)?;
    let (mut undecided, mut layer_bytes) = (0, 0);
    for layer in 0..builder.regions()[2] {
        let source = job.layer(builder.planes_of_layer(layer), progress)?;
        builder.add_layer(&source, layer, progress)?;
        undecided += source.undecided;
        layer_bytes = layer_bytes.max(size_of_val(&source.words[..]));
    }
    if job.sides_by_corners() {
        builder.follow(&job.layer(0..0, progress)?, progress)?;
    }
    let field = builder.finish();
    stage("bricks", start);

    report.finish(field.view()?.count_inside(), undecided, bake.thickness, grid);
    report.device = "cpu".into();
    report.peak_bytes = field.bytes() + size_of_val(job.corners) + layer_bytes + mesh.bytes();
    report.seconds = seconds;
    Ok((field, report))
}

/// Data shared by all layers.
struct SparseJob<'a> {
    mesh: &'a Mesh,
    rule: &'a SignRule,
    local: LocalGrid,
    /// Distances at the corners of the bricks.
    corners: &'a [f32],
    bricks: [usize; 3],
    half_thickness: f64,
    /// A brick whose centre or corner is farther from the surface than this has no sample in the band, local units.
    near: f64,
    is_closed: bool,
}

impl SparseJob<'_> {
    /// Upper bound on the number of bricks with a sample in the band, from the distances at their corners.
    fn count_near(&self) -> usize {
        let [nx, ny, nz] = self.bricks;
        let half = 0.5 * self.near;
        (0..nz)
            .into_par_iter()
            .map(|z| (0..nx * ny).filter(|i| self.nearest_corner([i % nx, i / nx, z]) < self.near - half).count())
            .sum()
    }

    /// The smallest distance at the corners of a brick.
    fn nearest_corner(&self, [x, y, z]: [usize; 3]) -> f64 {
        let [nx, ny, _] = self.bricks.map(|bricks| bricks + 1);
        let first = x + nx * (y + ny * z);
        let row = |offset: usize| self.corners[first + offset].min(self.corners[first + offset + 1]);
        f64::from(row(0).min(row(nx)).min(row(nx * ny)).min(row(nx * ny + nx)))
    }

    /// Whether the rule counts by planes, which gives the side of every sample.
    fn counts_planes(&self) -> bool {
        matches!(self.rule, SignRule::Counted(_) | SignRule::Parity)
    }

    /// Whether the side of a brick far from the mesh follows from its corners alone, although the side may change
    /// across an opening.
    fn sides_by_corners(&self) -> bool {
        let by_point = matches!(self.rule, SignRule::Winding | SignRule::Pseudonormal | SignRule::Normal);
        by_point && !self.is_closed
    }

    /// Signs of the planes of a layer, for rules that count by planes.
    fn layer(&self, planes: Range<usize>, progress: &Progress) -> Result<RegionLayer<'_>, Error> {
        let [nx, ny, _] = self.local.shape();
        let words_per_row = nx.div_ceil(64);
        let mut layer =
            RegionLayer { job: self, first_plane: planes.start, words_per_row, words: Vec::new(), undecided: 0 };
        if !self.counts_planes() {
            return Ok(layer);
        }
        layer.words = vec![0; words_per_row * ny * planes.len()];
        // The pass counts samples, but the progress of the bake counts regions. The pass therefore has a progress of
        // its own.
        let apart = Progress::new();
        let pass = SignPass { mesh: self.mesh, local: self.local, rule: self.rule, progress: &apart };
        layer.undecided = layer
            .words
            .par_chunks_mut(words_per_row * ny * SLAB_PLANES)
            .enumerate()
            .map(|(slab, words)| {
                progress.check()?;
                let count = words.len() / (words_per_row * ny);
                let counts = pass.slab(planes.start + slab * SLAB_PLANES, count, &mut |i| {
                    words[i / nx * words_per_row + i % nx / 64] |= 1 << (i % nx % 64);
                })?;
                Ok::<usize, Error>(counts.undecided)
            })
            .try_reduce(|| 0, |a, b| Ok(a + b))?;
        Ok(layer)
    }
}

/// Number of planes of a slab of signs, the unit of parallel work.
const SLAB_PLANES: usize = 4;

/// A layer of regions, and the signs of its samples if they are known.
struct RegionLayer<'a> {
    job: &'a SparseJob<'a>,
    first_plane: usize,
    words_per_row: usize,
    /// One bit per sample, set if inside; each row of samples begins with a new word. Empty for rules that classify
    /// single points.
    words: Vec<u64>,
    undecided: usize,
}

impl RegionLayer<'_> {
    fn is_inside(&self, [x, y, z]: [usize; 3]) -> bool {
        if self.words.is_empty() {
            let SparseJob { mesh, rule, local, .. } = self.job;
            let p = local.at([x, y, z]);
            return match rule {
                SignRule::Unsigned => false,
                SignRule::Winding => mesh.moments().winding(mesh, p).abs() > 0.5,
                _ => rule.is_inside(mesh, p, &mesh.closest_point(p)),
            };
        }
        let row = y + self.job.local.axes[1].count * (z - self.first_plane);
        self.words[row * self.words_per_row + x / 64] >> (x % 64) & 1 == 1
    }

    /// The common side of all samples of a box; None if they differ. Rules for single points are evaluated at the
    /// corners.
    fn common_side(&self, of: &SampleBox) -> Option<Side> {
        let last = of.high.map(|i| i - 1);
        let corner = |i: usize| [0, 1, 2].map(|axis| if i >> axis & 1 == 0 { of.low[axis] } else { last[axis] });
        let inside = self.is_inside(corner(0));
        let is_common = if self.job.is_closed {
            // No face of a closed surface is near, so one sample determines the side of all.
            true
        } else if self.words.is_empty() {
            (1..8).all(|i| self.is_inside(corner(i)) == inside)
        } else {
            (of.low[2]..of.high[2]).all(|z| {
                (of.low[1]..of.high[1]).all(|y| (of.low[0]..of.high[0]).all(|x| self.is_inside([x, y, z]) == inside))
            })
        };
        is_common.then_some(if inside { Side::Inside } else { Side::Outside })
    }
}

impl SampleSource for RegionLayer<'_> {
    type Worker = ();

    fn worker(&self) {}

    fn far_side(&self, (): &mut (), of: &SampleBox) -> Option<Side> {
        let job = self.job;
        let brick = of.high.map(|i| (i - 1) / BRICK_CELLS);
        let is_far = job.nearest_corner(brick) > job.near;
        if is_far && job.half_thickness == 0.0 {
            return self.common_side(of);
        }
        let center = 0.5 * (job.local.at(of.low) + job.local.at(of.high.map(|i| i - 1)));
        let distance = job.mesh.closest_point(center).distance * job.mesh.scale() - job.half_thickness;
        if distance.abs() <= job.near {
            return None;
        }
        if job.half_thickness > 0.0 {
            return Some(if distance < 0.0 { Side::Inside } else { Side::Outside });
        }
        self.common_side(of)
    }

    fn samples(&self, (): &mut (), of: &SampleBox, put: &mut dyn FnMut([usize; 3], f32)) {
        let job = self.job;
        let mut distances = [0.0; BRICK_LEN];
        let shape = of.shape();
        let distances = &mut distances[..shape.iter().product()];
        job.local.distances_in(of, job.mesh, job.mesh.scale() as f32, distances);
        for (i, &distance) in distances.iter().enumerate() {
            let step = [i % shape[0], i / shape[0] % shape[1], i / (shape[0] * shape[1])];
            let sample = [0, 1, 2].map(|axis| of.low[axis] + step[axis]);
            let distance = if job.half_thickness > 0.0 {
                (f64::from(distance) - job.half_thickness) as f32
            } else if self.is_inside(sample) {
                -distance
            } else {
                distance
            };
            put(sample, distance);
        }
    }
}
