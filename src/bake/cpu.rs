//! The bake on the CPU.

use super::band::Band;
use super::{Bake, BakeOptions, LocalGrid, Report, dense};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::crossing::{Axes, Surface, scan_row};
use crate::sign::openings::{Openings, SampleBlock};
use crate::sign::{SignChoice, SignMethod, SignRule, parity};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Planes of a slab, the unit of parallel work: enough of them for many cores, thick enough to share block decisions.
const SLAB_PLANES: usize = 4;
/// The tree costs about this much a face while it is built; used to refuse what cannot fit.
const BUILD_BYTES_PER_FACE: usize = 256;

pub(super) fn bake(mesh: &Mesh, grid: &Grid, options: &BakeOptions, progress: &Progress) -> Result<Bake, Error> {
    let scratch = mesh.faces().len() * BUILD_BYTES_PER_FACE;
    let what = format!("a field of {} x {} x {} samples", grid.shape[0], grid.shape[1], grid.shape[2]);
    let mut distances = allocate_samples(&what, grid.len(), scratch)?;
    let local = LocalGrid::new(grid, mesh);
    let mut seconds = Vec::new();
    let mut stage = |name, since: Instant| seconds.push((name, since.elapsed().as_secs_f64()));
    progress.set_total(2 * grid.len() as u64);

    let start = Instant::now();
    let (_, topology) = rayon::join(|| mesh.bvh(), || mesh.topology());
    progress.check()?;
    stage("tree and topology", start);

    let start = Instant::now();
    let method = if options.thickness.is_some() { SignMethod::Unsigned } else { options.sign };
    let choice = SignChoice::new(mesh, method);
    choice.rule.prepare(mesh);
    let mut report = Report::new(mesh, topology, &choice);
    progress.check()?;
    stage("sign rule", start);

    let start = Instant::now();
    let job = Job { mesh, grid, local, rule: &choice.rule, progress };
    let band = options.band.map(|voxels| Band::new(mesh, &local, voxels, progress)).transpose()?;
    let by_closest = job.distances(&mut distances, band.as_ref())?;
    stage("distance", start);

    let start = Instant::now();
    let counts = job.signs(&mut distances, by_closest)?;
    if let Some(thickness) = options.thickness {
        distances.par_iter_mut().for_each(|d| *d = (f64::from(*d) - 0.5 * thickness) as f32);
        let inside = distances.par_iter().filter(|&&d| d < 0.0).count();
        report.finish(inside, 0);
    } else {
        report.finish(counts.inside, counts.undecided);
    }
    stage("sign", start);

    report.device = "cpu".into();
    report.peak_bytes = size_of_val(&distances[..]) + mesh.bytes() + band.as_ref().map_or(0, Band::bytes);
    report.seconds = seconds;
    Ok(Bake { distances, report })
}

/// Samples by outcome.
#[derive(Debug, Clone, Copy, Default)]
struct Counts {
    inside: usize,
    undecided: usize,
}

impl Counts {
    fn add(self, other: Self) -> Self {
        Self { inside: self.inside + other.inside, undecided: self.undecided + other.undecided }
    }
}

struct Job<'a> {
    mesh: &'a Mesh,
    grid: &'a Grid,
    local: LocalGrid,
    rule: &'a SignRule,
    progress: &'a Progress,
}

impl Job<'_> {
    /// Unsigned distances, world units. Rules that look at the closest point set the sign here too; returns the number
    /// of samples they found inside.
    fn distances(&self, out: &mut [f32], band: Option<&Band>) -> Result<Counts, Error> {
        if matches!(self.rule, SignRule::Pseudonormal | SignRule::Normal) {
            return self.closest_points(out, band);
        }
        let limit = band.map_or(f64::INFINITY, Band::width);
        // The scale is a power of two: the product is exact.
        let scale = self.mesh.scale();
        dense::distances(self.mesh.bvh(), &self.local, limit as f32, scale as f32, self.progress, out)?;
        if let Some(band) = band {
            out.par_chunks_mut(self.grid.shape[0]).enumerate().for_each(|(row, samples)| {
                for (x, sample) in samples.iter_mut().enumerate() {
                    *sample = (band.clip(self.voxel(x, row), f64::from(*sample) / scale) * scale) as f32;
                }
            });
        }
        Ok(Counts::default())
    }

    fn voxel(&self, x: usize, row: usize) -> [usize; 3] {
        [x, row % self.grid.shape[1], row / self.grid.shape[1]]
    }

    /// Closest points sample by sample, for the rules that need them.
    fn closest_points(&self, out: &mut [f32], band: Option<&Band>) -> Result<Counts, Error> {
        let nx = self.grid.shape[0];
        let inside = AtomicUsize::new(0);
        out.par_chunks_mut(nx).enumerate().try_for_each(|(row, samples)| {
            for (x, sample) in samples.iter_mut().enumerate() {
                let voxel = self.voxel(x, row);
                let p = self.local.at(voxel);
                let closest = self.mesh.closest_point(p);
                let mut stored = band.map_or(closest.distance, |band| band.clip(voxel, closest.distance));
                if self.rule.is_inside(self.mesh, p, &closest) {
                    stored = -stored;
                    inside.fetch_add(1, Ordering::Relaxed);
                }
                *sample = (stored * self.mesh.scale()) as f32;
            }
            self.progress.advance(nx as u64)
        })?;
        Ok(Counts { inside: inside.into_inner(), undecided: 0 })
    }

    /// Negate what is inside.
    fn signs(&self, out: &mut [f32], by_closest: Counts) -> Result<Counts, Error> {
        let [nx, ny, _] = self.grid.shape;
        if matches!(self.rule, SignRule::Unsigned | SignRule::Pseudonormal | SignRule::Normal) {
            self.progress.advance(self.grid.len() as u64)?;
            return Ok(by_closest);
        }
        out.par_chunks_mut(nx * ny * SLAB_PLANES)
            .enumerate()
            .map(|(slab, samples)| {
                let first_plane = slab * SLAB_PLANES;
                match self.rule {
                    SignRule::Counted(openings) => self.count_slab(first_plane, samples, openings),
                    SignRule::Parity => self.vote_slab(first_plane, samples),
                    _ => self.wind_slab(first_plane, samples),
                }
            })
            .try_reduce(Counts::default, |a, b| Ok(a.add(b)))
    }

    /// Exact winding numbers against the closed surface, and the cones' share of them.
    fn count_slab(&self, first_plane: usize, samples: &mut [f32], openings: &Openings) -> Result<Counts, Error> {
        let [nx, ny, _] = self.grid.shape;
        let planes = samples.len() / (nx * ny);
        let mut counts = Counts::default();
        let mut fractions = vec![0i8; if openings.caps.is_empty() { 0 } else { samples.len() }];
        if !openings.caps.is_empty() {
            let at = |[x, y, z]: [usize; 3]| self.local.at([x, y, first_plane + z]);
            let mut set = |[x, y, z]: [usize; 3], rounded| fractions[x + nx * (y + ny * z)] = rounded;
            let block = SampleBlock { low: [0; 3], high: [nx, ny, planes], at: &at };
            counts.undecided = openings.for_each_rounded_fraction(&block, &mut set);
        }
        let surface = Surface::new(self.mesh, &openings.caps);
        let mut windings = vec![0i16; nx * ny];
        for (k, plane) in samples.chunks_exact_mut(nx * ny).enumerate() {
            let row = self.local.axes[2].at(first_plane + k);
            scan_row(&surface, Axes::X, row, &self.local.axes[1], &self.local.axes[0], &mut windings);
            for (i, sample) in plane.iter_mut().enumerate() {
                let rounded = fractions.get(k * nx * ny + i).copied().unwrap_or(0);
                if windings[i] != i16::from(rounded) {
                    *sample = -*sample;
                    counts.inside += 1;
                }
            }
            self.progress.advance((nx * ny) as u64)?;
        }
        Ok(counts)
    }

    /// Parity along x and y by plane; along z only where those two disagree.
    fn vote_slab(&self, first_plane: usize, samples: &mut [f32]) -> Result<Counts, Error> {
        let [nx, ny, _] = self.grid.shape;
        let surface = Surface::new(self.mesh, &[]);
        let mut counts = Counts::default();
        let (mut along_x, mut along_y) = (vec![0i16; nx * ny], vec![0i16; nx * ny]);
        // The same row, with the other in-plane axis as the ray.
        let across = Axes { ray: 1, column: 0, row: 2 };
        for (k, plane) in samples.chunks_exact_mut(nx * ny).enumerate() {
            let z = first_plane + k;
            let row = self.local.axes[2].at(z);
            scan_row(&surface, Axes::X, row, &self.local.axes[1], &self.local.axes[0], &mut along_x);
            scan_row(&surface, across, row, &self.local.axes[0], &self.local.axes[1], &mut along_y);
            for y in 0..ny {
                for x in 0..nx {
                    let (a, b) = (along_x[x + nx * y] & 1 == 1, along_y[y + ny * x] & 1 == 1);
                    let (inside, agreed) = if a == b { (a, true) } else { parity(self.mesh, self.local.at([x, y, z])) };
                    counts.inside += usize::from(inside);
                    counts.undecided += usize::from(!agreed);
                    if inside {
                        plane[x + nx * y] = -plane[x + nx * y];
                    }
                }
            }
            self.progress.advance((nx * ny) as u64)?;
        }
        Ok(counts)
    }

    /// Fast winding number of every sample.
    fn wind_slab(&self, first_plane: usize, samples: &mut [f32]) -> Result<Counts, Error> {
        let [nx, ny, _] = self.grid.shape;
        let moments = self.mesh.moments();
        let mut counts = Counts::default();
        for (i, row) in samples.chunks_exact_mut(nx).enumerate() {
            for (x, sample) in row.iter_mut().enumerate() {
                let p = self.local.at([x, i % ny, first_plane + i / ny]);
                let winding = moments.winding(self.mesh, p).abs();
                counts.undecided += usize::from((winding - 0.5).abs() < NEAR_HALF);
                if winding > 0.5 {
                    *sample = -*sample;
                    counts.inside += 1;
                }
            }
            self.progress.advance(nx as u64)?;
        }
        Ok(counts)
    }
}

/// A winding number this close to 1/2 is reported as undecided.
const NEAR_HALF: f64 = 0.05;
