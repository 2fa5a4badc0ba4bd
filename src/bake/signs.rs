//! The samples of a grid that are inside, by slabs of planes.
//!
//! Both bakes use the same pass. The CPU negates its samples as they are decided. A graphics device receives one bit
//! per sample, because the exact predicates need float64, which WGSL does not have.

use super::LocalGrid;
use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::crossing::{Axes, ClosedSurface, scan_row};
use crate::sign::openings::{Openings, SampleBlock};
use crate::sign::{SignRule, parity};
use rayon::prelude::*;

/// Number of planes of a slab, the unit of parallel work. Enough slabs remain for many cores, and each is thick enough
/// to share decisions for blocks.
const SLAB_PLANES: usize = 4;

/// Number of samples by outcome.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Counts {
    pub inside: usize,
    pub undecided: usize,
}

impl Counts {
    fn add(self, other: Self) -> Self {
        Self { inside: self.inside + other.inside, undecided: self.undecided + other.undecided }
    }
}

/// One bit per sample, set if inside. Each row of samples begins with a new word.
#[derive(Debug)]
pub(super) struct InsideBits {
    pub words_per_row: usize,
    pub words: Vec<u32>,
}

/// A rule and the samples that it classifies.
pub(super) struct SignPass<'a> {
    pub mesh: &'a Mesh,
    pub local: LocalGrid,
    pub rule: &'a SignRule,
    pub progress: &'a Progress,
}

impl SignPass<'_> {
    /// Negates the samples that are inside.
    pub(super) fn negate(&self, samples: &mut [f32]) -> Result<Counts, Error> {
        let [nx, ny] = self.plane();
        samples
            .par_chunks_mut(nx * ny * SLAB_PLANES)
            .enumerate()
            .map(|(slab, samples)| {
                let planes = samples.len() / (nx * ny);
                self.slab(slab * SLAB_PLANES, planes, &mut |i| samples[i] = -samples[i])
            })
            .try_reduce(Counts::default, |a, b| Ok(a.add(b)))
    }

    /// Bits of the samples that are inside.
    pub(super) fn bits(&self) -> Result<(InsideBits, Counts), Error> {
        let [nx, ny] = self.plane();
        let words_per_row = nx.div_ceil(32);
        let mut words = vec![0u32; words_per_row * ny * self.local.axes[2].count];
        let counts = words
            .par_chunks_mut(words_per_row * ny * SLAB_PLANES)
            .enumerate()
            .map(|(slab, words)| {
                let planes = words.len() / (words_per_row * ny);
                self.slab(slab * SLAB_PLANES, planes, &mut |i| {
                    words[i / nx * words_per_row + i % nx / 32] |= 1 << (i % nx % 32);
                })
            })
            .try_reduce(Counts::default, |a, b| Ok(a.add(b)))?;
        Ok((InsideBits { words_per_row, words }, counts))
    }

    /// Number of samples along the first two axes.
    fn plane(&self) -> [usize; 2] {
        [self.local.axes[0].count, self.local.axes[1].count]
    }

    /// Calls `mark` with the position, within the slab, of every sample inside.
    pub(super) fn slab(
        &self,
        first_plane: usize,
        planes: usize,
        mark: &mut impl FnMut(usize),
    ) -> Result<Counts, Error> {
        match self.rule {
            SignRule::Counted(openings) => self.count_slab(first_plane, planes, openings, mark),
            SignRule::Parity => self.vote_slab(first_plane, planes, mark),
            SignRule::Winding => self.wind_slab(first_plane, planes, mark),
            SignRule::Pseudonormal | SignRule::Normal => self.search_slab(first_plane, planes, mark),
            SignRule::Unsigned => {
                let [nx, ny] = self.plane();
                self.progress.advance((nx * ny * planes) as u64)?;
                Ok(Counts::default())
            }
        }
    }

    /// Marks the samples inside by their closest points, for the rules that use them.
    fn search_slab(&self, first_plane: usize, planes: usize, mark: &mut impl FnMut(usize)) -> Result<Counts, Error> {
        let [nx, ny] = self.plane();
        let mut counts = Counts::default();
        for row in 0..ny * planes {
            for x in 0..nx {
                let p = self.local.at([x, row % ny, first_plane + row / ny]);
                if self.rule.is_inside(self.mesh, p, &self.mesh.closest_point(p)) {
                    mark(x + nx * row);
                    counts.inside += 1;
                }
            }
            self.progress.advance(nx as u64)?;
        }
        Ok(counts)
    }

    /// Marks the samples inside by exact winding numbers of the closed surface minus the contribution of the cones.
    fn count_slab(
        &self,
        first_plane: usize,
        planes: usize,
        openings: &Openings,
        mark: &mut impl FnMut(usize),
    ) -> Result<Counts, Error> {
        let [nx, ny] = self.plane();
        let mut counts = Counts::default();
        // Modulo 2^16, as the winding numbers of `scan_row`.
        let mut fractions = vec![0i16; if openings.caps.is_empty() { 0 } else { nx * ny * planes }];
        if !openings.caps.is_empty() {
            let at = |[x, y, z]: [usize; 3]| self.local.at([x, y, first_plane + z]);
            let mut set = |[x, y, z]: [usize; 3], rounded: i32| fractions[x + nx * (y + ny * z)] = rounded as i16;
            let block = SampleBlock { low: [0; 3], high: [nx, ny, planes], at: &at };
            counts.undecided = openings.for_each_rounded_fraction(&block, self.progress, &mut set)?;
        }
        let surface = ClosedSurface::new(self.mesh, &openings.caps);
        let mut windings = vec![0i16; nx * ny];
        for k in 0..planes {
            let row = self.local.axes[2].at(first_plane + k);
            scan_row(&surface, Axes::X, row, &self.local.axes[1], &self.local.axes[0], &mut windings);
            for (i, &winding) in windings.iter().enumerate() {
                let rounded = fractions.get(k * nx * ny + i).copied().unwrap_or(0);
                if winding != rounded {
                    mark(k * nx * ny + i);
                    counts.inside += 1;
                }
            }
            self.progress.advance((nx * ny) as u64)?;
        }
        Ok(counts)
    }

    /// Marks the samples inside by a vote of three parities: along x and y for whole planes, along z only where those
    /// two disagree.
    fn vote_slab(&self, first_plane: usize, planes: usize, mark: &mut impl FnMut(usize)) -> Result<Counts, Error> {
        let [nx, ny] = self.plane();
        let surface = ClosedSurface::new(self.mesh, &[]);
        let mut counts = Counts::default();
        let (mut along_x, mut along_y) = (vec![0i16; nx * ny], vec![0i16; nx * ny]);
        // The axes of the second scan: the rays of the row run along y.
        let across = Axes { ray: 1, column: 0, row: 2 };
        for k in 0..planes {
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
                        mark(x + nx * (y + ny * k));
                    }
                }
            }
            self.progress.advance((nx * ny) as u64)?;
        }
        Ok(counts)
    }

    /// Marks the samples inside by the fast winding number of each.
    fn wind_slab(&self, first_plane: usize, planes: usize, mark: &mut impl FnMut(usize)) -> Result<Counts, Error> {
        let [nx, ny] = self.plane();
        let moments = self.mesh.moments();
        let mut counts = Counts::default();
        for row in 0..ny * planes {
            for x in 0..nx {
                let p = self.local.at([x, row % ny, first_plane + row / ny]);
                let winding = moments.winding(self.mesh, p).abs();
                counts.undecided += usize::from((winding - 0.5).abs() < NEAR_HALF);
                if winding > 0.5 {
                    mark(x + nx * row);
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
