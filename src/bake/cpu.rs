//! The bake on the CPU.

use super::band::{Band, BeyondBand};
use super::signs::{Counts, SignPass};
use super::{Bake, BakeOptions, LocalGrid, dense};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignRule;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// Approximate memory of the tree per face while it is built, bytes. Used to refuse requests that do not fit.
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
    rayon::join(|| mesh.bvh(), || mesh.topology());
    progress.check()?;
    stage("tree and topology", start);

    let start = Instant::now();
    let (choice, mut report) = options.choose_sign(mesh);
    progress.check()?;
    stage("sign rule", start);

    let start = Instant::now();
    let job = Job { mesh, local, rule: &choice.rule, progress };
    let far = match options.band {
        Some(voxels) => BeyondBand::Bound(Band::new(mesh, &local, voxels, progress)?),
        None => BeyondBand::Exact,
    };
    let by_closest = job.distances(&mut distances, &far)?;
    stage("distance", start);

    let start = Instant::now();
    let counts = job.signs(&mut distances, by_closest)?;
    if let Some(thickness) = options.thickness {
        distances.par_iter_mut().for_each(|d| *d = (f64::from(*d) - 0.5 * thickness) as f32);
    }
    let (inside, undecided) = match options.thickness {
        Some(_) => (distances.par_iter().filter(|&&d| d < 0.0).count(), 0),
        None => (counts.inside, counts.undecided),
    };
    report.finish(inside, undecided, options.thickness, grid);
    stage("sign", start);

    report.device = "cpu".into();
    report.peak_bytes = size_of_val(&distances[..]) + mesh.bytes() + far.bytes();
    report.seconds = seconds;
    Ok(Bake { distances, report })
}

/// A mesh, a grid or a part of one, and the rule for the sign.
pub(super) struct Job<'a> {
    pub mesh: &'a Mesh,
    pub local: LocalGrid,
    pub rule: &'a SignRule,
    pub progress: &'a Progress,
}

impl Job<'_> {
    /// Computes unsigned distances, world units. Rules that use the closest point set the sign here too; returns the
    /// number of samples that they found inside.
    pub(super) fn distances(&self, out: &mut [f32], far: &BeyondBand) -> Result<Counts, Error> {
        if matches!(self.rule, SignRule::Pseudonormal | SignRule::Normal) {
            return self.closest_points(out, far);
        }
        // The scale is a power of two, so the product is exact.
        let scale = self.mesh.scale();
        dense::distances(self.mesh, &self.local, far.width() as f32, scale as f32, self.progress, out)?;
        if !matches!(far, BeyondBand::Exact) {
            out.par_chunks_mut(self.local.shape()[0]).enumerate().try_for_each(|(row, samples)| {
                self.progress.check()?;
                for (x, sample) in samples.iter_mut().enumerate() {
                    *sample = (far.clip(self.voxel(x, row), f64::from(*sample) / scale) * scale) as f32;
                }
                Ok::<_, Error>(())
            })?;
        }
        Ok(Counts::default())
    }

    fn voxel(&self, x: usize, row: usize) -> [usize; 3] {
        let rows = self.local.shape()[1];
        [x, row % rows, row / rows]
    }

    /// Computes closest points sample by sample, for the rules that need them.
    fn closest_points(&self, out: &mut [f32], far: &BeyondBand) -> Result<Counts, Error> {
        let nx = self.local.shape()[0];
        let inside = AtomicUsize::new(0);
        out.par_chunks_mut(nx).enumerate().try_for_each(|(row, samples)| {
            for (x, sample) in samples.iter_mut().enumerate() {
                let voxel = self.voxel(x, row);
                let p = self.local.at(voxel);
                let closest = self.mesh.closest_point(p);
                let mut stored = far.clip(voxel, closest.distance);
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

    /// Negates the samples inside, for the rules that need no closest point. The other rules have done so in
    /// [`Job::distances`], which returned `by_closest`.
    pub(super) fn signs(&self, distances: &mut [f32], by_closest: Counts) -> Result<Counts, Error> {
        let Self { mesh, local, rule, progress } = *self;
        if matches!(rule, SignRule::Unsigned | SignRule::Pseudonormal | SignRule::Normal) {
            progress.advance(distances.len() as u64)?;
            return Ok(by_closest);
        }
        SignPass { mesh, local, rule, progress }.negate(distances)
    }
}
