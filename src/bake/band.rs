//! Far samples of a banded bake: a proven lower bound instead of a search.
//!
//! *Theory.* The squared distance minus the squared position is a concave function of p: it is the minimum of the
//! functions |q|^2 - 2 p.q over the surface points q, each linear in p. Let c_i be the nodes of a coarse grid around p,
//! with trilinear weights w_i and exact distances d_i, H the spacing of the nodes, and f the position of p between two
//! nodes, 0 to 1 along each axis. By Jensen's inequality
//!
//! ```text
//! d(p)^2 >= sum_i w_i d_i^2 - sum_i w_i |c_i - p|^2,   where the last sum is sum over axes of H^2 f (1 - f)
//! ```
//!
//! The bound is exact at the nodes, continuous, and off by about H^2 / 8d between them. Where it exceeds the band, no
//! search is needed.

use super::{LocalGrid, coarse_grid, dense};
use crate::error::Error;
use crate::gpu::constants::bake_finish::SLACK;
use crate::mesh::Mesh;
use crate::progress::Progress;
use rayon::prelude::*;

/// Distance between neighbouring nodes of the coarse grid, voxels.
pub(super) const STRIDE: usize = 4;

/// Values that a bake stores for samples beyond the band.
#[derive(Debug)]
pub(super) enum BeyondBand {
    /// The distance itself; there is no band.
    Exact,
    /// A lower bound on the distance.
    Bound(Band),
    /// The half width of the band, local units.
    Cut(f64),
}

impl BeyondBand {
    /// Half width of the band, local units.
    pub(super) fn width(&self) -> f64 {
        match self {
            Self::Exact => f64::INFINITY,
            Self::Bound(band) => band.width,
            Self::Cut(width) => *width,
        }
    }

    /// The value to store for a distance.
    pub(super) fn clip(&self, voxel: [usize; 3], distance: f64) -> f64 {
        match self {
            Self::Exact => distance,
            Self::Bound(band) => band.clip(voxel, distance),
            Self::Cut(width) => distance.min(*width),
        }
    }

    pub(super) fn bytes(&self) -> usize {
        match self {
            Self::Bound(band) => size_of_val(&band.squares[..]),
            Self::Exact | Self::Cut(_) => 0,
        }
    }
}

/// Exact distances on a coarse grid, local units.
#[derive(Debug)]
pub(super) struct Band {
    width: f64,
    nodes: [usize; 3],
    squares: Vec<f32>,
    /// Squared spacing of the nodes along each axis.
    spacing_squared: [f64; 3],
}

/// Half width of a band of `voxels`, counted in the longest side of a voxel, local units.
pub(super) fn width(local: &LocalGrid, voxels: f64) -> f64 {
    voxels * local.step().max_element()
}

impl Band {
    /// `voxels` is the half width of the band, in the longest side of a voxel.
    pub(super) fn new(mesh: &Mesh, local: &LocalGrid, voxels: f64, progress: &Progress) -> Result<Self, Error> {
        let coarse = coarse_grid(local, STRIDE);
        let nodes = coarse.shape();
        let mut squares = vec![0.0; nodes.iter().product()];
        dense::distances(mesh, &coarse, f32::INFINITY, 1.0, progress, &mut squares)?;
        squares.par_iter_mut().for_each(|distance| *distance *= *distance);
        Ok(Self {
            width: width(local, voxels),
            nodes,
            squares,
            spacing_squared: local.step().to_array().map(|h| (h * STRIDE as f64).powi(2)),
        })
    }

    /// The value to store for a distance: the distance itself within the band, a lower bound beyond it.
    fn clip(&self, voxel: [usize; 3], distance: f64) -> f64 {
        if distance <= self.width { distance } else { self.lower_bound(voxel).max(self.width) }
    }

    /// A lower bound on the distance at a sample.
    fn lower_bound(&self, voxel: [usize; 3]) -> f64 {
        let node = voxel.map(|i| i / STRIDE);
        let fraction = voxel.map(|i| (i % STRIDE) as f64 / STRIDE as f64);
        let mut mean = 0.0;
        for corner in 0..8 {
            let offset = [corner & 1, corner >> 1 & 1, corner >> 2];
            let weight: f64 = (0..3).map(|a| if offset[a] == 1 { fraction[a] } else { 1.0 - fraction[a] }).product();
            if weight > 0.0 {
                let [x, y, z] = [0, 1, 2].map(|a| node[a] + offset[a]);
                mean += weight * f64::from(self.squares[x + self.nodes[0] * (y + self.nodes[1] * z)]);
            }
        }
        let spread: f64 = (0..3).map(|a| self.spacing_squared[a] * fraction[a] * (1.0 - fraction[a])).sum();
        (mean * (1.0 - SLACK) - spread).max(0.0).sqrt()
    }
}
