//! Bake of a mesh: signed distances on a grid.
//!
//! Two passes over slabs of the grid compute distances, then signs. The distance of a sample is the distance of the
//! nearest triangle, found in float32 and evaluated in float64 (see `bvh`), and does not depend on the sign. The work
//! is divided by slabs of the grid, never by threads, so the same input gives the same bytes on any number of threads.

mod band;
mod blocks;
mod brute;
mod cloud;
mod cpu;
mod dense;
mod gpu;
#[cfg(test)]
mod gpu_tests;
mod report;
mod signs;
mod sparse;
mod update;
mod window;

pub use blocks::bake_blocks;
pub use brute::bake_brute;
pub use cloud::{CloudCounts, bake_cloud, bake_cloud_sparse};
pub use report::{Report, sign_warnings};
pub use sparse::bake_sparse;
pub use update::{Before, update};
pub use window::{bake_window, sides_of_balls};

use crate::error::{ArgumentError, Error};
use crate::gpu::{Context, Place};
use crate::grid::Grid;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::crossing::Samples;
use crate::sign::{SignChoice, SignMethod};
use crate::volume::device::DeviceField;
use crate::volume::sparse::build::SampleBox;
use glam::DVec3;
use std::sync::Arc;

/// Options of a bake.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct BakeOptions {
    /// Method for the signs.
    pub sign: SignMethod,
    /// Half width of the band in which distances are exact, voxels; beyond it they are lower bounds. All are exact if
    /// absent.
    pub band: Option<f64>,
    /// Thickness of a two-sided sheet, world units: the distance is the unsigned distance minus half of it.
    pub thickness: Option<f64>,
}

/// A finished field.
#[derive(Debug)]
pub struct Bake {
    /// Distances in world units, x fastest.
    pub distances: Vec<f32>,
    /// Properties of the surface, and the cost.
    pub report: Report,
}

/// A finished field in the memory where it was computed.
#[derive(Debug)]
pub enum BakedField {
    /// Distances in world units, x fastest.
    Host(Vec<f32>),
    /// Distances in the memory of a device.
    Device(DeviceField),
}

/// Bakes at a place.
pub fn bake_at(
    place: &Place,
    mesh: &Mesh,
    grid: &Grid,
    options: &BakeOptions,
    progress: &Progress,
) -> Result<(BakedField, Report), Error> {
    match place {
        Place::Cpu => {
            bake(mesh, grid, options, progress).map(|baked| (BakedField::Host(baked.distances), baked.report))
        }
        Place::Gpu(context) => bake_on_device(context, mesh, grid, options, progress)
            .map(|(field, report)| (BakedField::Device(field), report)),
    }
}

/// Bakes on a graphics device and leaves the field there.
pub fn bake_on_device(
    context: &Arc<Context>,
    mesh: &Mesh,
    grid: &Grid,
    options: &BakeOptions,
    progress: &Progress,
) -> Result<(DeviceField, Report), Error> {
    options.check(mesh, grid)?;
    gpu::bake(context, mesh, grid, options, u64::MAX, progress)
}

/// Bakes on the CPU.
pub fn bake(mesh: &Mesh, grid: &Grid, options: &BakeOptions, progress: &Progress) -> Result<Bake, Error> {
    options.check(mesh, grid)?;
    cpu::bake(mesh, grid, options, progress)
}

impl BakeOptions {
    fn check(&self, mesh: &Mesh, grid: &Grid) -> Result<(), ArgumentError> {
        if let Some(corner) = [grid.lower, grid.upper].into_iter().find(|&corner| !mesh.can_reach(corner)) {
            let problem = format!("the corner {corner} is too far from the mesh for float32 distances");
            return Err(ArgumentError::new("bounds", problem));
        }
        for (argument, value) in [("band", self.band), ("thickness", self.thickness)] {
            if let Some(value) = value.filter(|value| !(value.is_finite() && *value > 0.0)) {
                return Err(ArgumentError::new(argument, format!("must be a positive number, got {value}")));
            }
        }
        Ok(())
    }

    /// Chooses the sign rule and prepares it. Returns also the report on the mesh and the rule. A two-sided sheet has
    /// no inside.
    fn choose_sign(&self, mesh: &Mesh) -> (SignChoice, Report) {
        let method = if self.thickness.is_some() { SignMethod::Unsigned } else { self.sign };
        let choice = SignChoice::new(mesh, method);
        choice.rule.prepare(mesh);
        let report = Report::new(mesh, mesh.topology(), &choice);
        (choice, report)
    }
}

/// The grid in the local coordinates of a mesh: sample positions along each axis.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalGrid {
    pub axes: [Samples; 3],
}

impl LocalGrid {
    pub(crate) fn new(grid: &Grid, mesh: &Mesh) -> Self {
        let first = mesh.local_from_world(grid.center(0, 0, 0));
        let step = grid.spacing() / mesh.scale();
        Self { axes: [0, 1, 2].map(|i| Samples { first: first[i], step: step[i], start: 0, count: grid.shape[i] }) }
    }

    pub(crate) fn shape(&self) -> [usize; 3] {
        self.axes.map(|axis| axis.count)
    }

    /// The part of the grid with `shape` samples from `low` on.
    pub(crate) fn part(&self, low: [usize; 3], shape: [usize; 3]) -> Self {
        let part = |axis: usize| {
            let whole = self.axes[axis];
            Samples { start: whole.start + low[axis], count: shape[axis], ..whole }
        };
        Self { axes: [0, 1, 2].map(part) }
    }

    /// Unsigned distances of the samples of a small box, times `scale`.
    fn distances_in(&self, of: &SampleBox, mesh: &Mesh, scale: f32, out: &mut [f32]) {
        // One task of the dense bake. Its progress is private, and only a cancelled progress is an error.
        let _ = dense::distances(mesh, &self.part(of.low, of.shape()), f32::INFINITY, scale, &Progress::new(), out);
    }

    pub(crate) fn at(&self, [x, y, z]: [usize; 3]) -> DVec3 {
        DVec3::new(self.axes[0].at(x), self.axes[1].at(y), self.axes[2].at(z))
    }

    /// Index of a sample in the array of the grid, x fastest.
    #[inline(always)]
    pub(crate) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        let [nx, ny, _] = self.shape();
        x + nx * (y + ny * z)
    }

    pub(crate) fn step(&self) -> DVec3 {
        DVec3::new(self.axes[0].step, self.axes[1].step, self.axes[2].step)
    }
}

/// Every `stride`-th sample of a whole grid, and one beyond its end if the last sample is not one of them.
fn coarse_grid(grid: &LocalGrid, stride: usize) -> LocalGrid {
    debug_assert!(grid.axes.iter().all(|axis| axis.start == 0));
    LocalGrid {
        axes: grid.axes.map(|Samples { first, step, start, count }| Samples {
            first,
            step: step * stride as f64,
            start,
            count: (count - 1).div_ceil(stride) + 1,
        }),
    }
}
