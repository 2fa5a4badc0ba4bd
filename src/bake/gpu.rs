//! The bake on a graphics device: the device computes distances while the CPU computes signs.
//!
//! # Theory
//!
//! One invocation per sample searches the tree for its nearest triangle (`shaders/mesh/bake_distance.wgsl`). A coarse
//! pass over every fourth sample precedes it. Its triangles are the initial bounds of all other searches, and in a
//! banded bake its distances bound the far samples. Positions are computed here in float64 and rounded once, in the
//! local coordinates of the CPU, so both devices agree to float32 rounding.
//!
//! Alternative tried: culling by convexity for a whole block, as on the CPU ([`super::dense`]). It was slower on
//! lavapipe (`benches/results/2026-11-21-software-adapter.md`); no hardware GPU was measured.
//!
//! Signs require exact predicates in float64, which WGSL does not have. The code of the CPU ([`super::signs`]) computes
//! them while the device is busy, and uploads them as bits.
//!
//! # Practice
//!
//! The field is divided into slabs that fit a binding, and a slab into dispatches of about 100 ms
//! ([`crate::gpu::pace`]). A search may run out of its bounded rounds, as at the centre of a finely meshed sphere,
//! which is equally near to every triangle. It is counted and repeated on the CPU, so no value is silently wrong.

use super::signs::{Counts, InsideBits, SignPass};
use super::{BakeOptions, LocalGrid, Report, coarse_grid};
use crate::bvh::binary::BinaryTree;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::constants::bake_distance::BLOCK;
use crate::gpu::constants::bake_finish::WORKGROUPS_PER_ROW;
use crate::gpu::constants::bvh::FAR;
use crate::gpu::layout::{DistanceParams, FinishParams};
use crate::gpu::pace::in_pieces;
use crate::grid::Grid;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignRule;
use crate::volume::device::{DeviceField, Slab};
use std::sync::Arc;
use std::time::Instant;

/// Distance between neighbouring coarse samples along each axis, in samples.
const STRIDE: usize = super::band::STRIDE;
/// Number of blocks of the first dispatch, and largest number of any, by the limit of one dimension of workgroups. The
/// first dispatch is small because a software adapter may compute during the submission, which cannot be interrupted.
const BLOCKS: (u64, u64) = (4, 65_535);
/// Relative slack above the half width of the band for the rounding of a square.
const LIMIT_SLACK: f64 = 1e-5;

/// Bakes into device memory. No slab is larger than `slab_bytes`.
pub(super) fn bake(
    context: &Arc<Context>,
    mesh: &Mesh,
    grid: &Grid,
    options: &BakeOptions,
    slab_bytes: u64,
    progress: &Progress,
) -> Result<(DeviceField, Report), Error> {
    let mut seconds = Vec::new();
    let mut stage = |name, since: Instant| seconds.push((name, since.elapsed().as_secs_f64()));
    progress.set_total(2 * grid.len() as u64);
    let start = Instant::now();
    let field = DeviceField::allocate(context, grid.shape, slab_bytes)?;
    stage("device memory", start);

    let start = Instant::now();
    rayon::join(|| mesh.bvh(), || mesh.topology());
    let tree = BinaryTree::new(mesh.distance_bvh(f64::INFINITY), mesh.positions(), mesh.faces());
    progress.check()?;
    stage("tree and topology", start);

    let start = Instant::now();
    let (choice, mut report) = options.choose_sign(mesh);
    stage("sign rule", start);

    let start = Instant::now();
    let local = LocalGrid::new(grid, mesh);
    let job = DeviceJob::new(context, mesh, local, options, &tree, progress)?;
    stage("upload", start);

    // The device computes distances while the threads of the CPU compute signs.
    let pass = SignPass { mesh, local, rule: &choice.rule, progress };
    let (measured, decided) = std::thread::scope(|scope| {
        let measuring = scope.spawn(|| {
            let start = Instant::now();
            let found = job.measure(&field);
            (found, start.elapsed().as_secs_f64())
        });
        let start = Instant::now();
        let decided = if matches!(choice.rule, SignRule::Unsigned) {
            progress.advance(grid.len() as u64).map(|()| (None, Counts::default()))
        } else {
            pass.bits().map(|(bits, counts)| (Some(bits), counts))
        };
        let signing = start.elapsed().as_secs_f64();
        // A panic of that thread is raised here again.
        let measured = measuring.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        (measured, (decided, signing))
    });
    seconds.push(("distance", measured.1));
    seconds.push(("sign", decided.1));
    let redone = measured.0?;
    let (bits, counts) = decided.0?;

    let start = Instant::now();
    let below_zero = job.finish(&field, bits.as_ref(), options.thickness)?;
    seconds.push(("finish", start.elapsed().as_secs_f64()));
    // A sample on the surface may be inside by the rule and have the distance negative zero.
    let inside = if options.thickness.is_some() { below_zero } else { counts.inside };
    report.finish(inside, counts.undecided, options.thickness, grid);
    if redone > 0 {
        report
            .warnings
            .push(format!("{redone} samples are as near to very many faces; their distances were measured on the CPU"));
    }
    report.device = context.label();
    report.peak_bytes = field.bytes() as usize
        + mesh.bytes()
        + job.bytes()
        + bits.as_ref().map_or(0, |bits| size_of_val(&bits.words[..]));
    report.seconds = seconds;
    Ok((field, report))
}

/// Resources that the kernels of one bake share.
struct DeviceJob<'a> {
    context: &'a Arc<Context>,
    mesh: &'a Mesh,
    local: LocalGrid,
    progress: &'a Progress,
    /// Half width of the band, local units; None if all distances are exact.
    width: Option<f64>,
    nodes: wgpu::Buffer,
    triangles: wgpu::Buffer,
    axes: wgpu::Buffer,
    coarse: LocalGrid,
    coarse_slots: wgpu::Buffer,
    coarse_squares: wgpu::Buffer,
}

impl<'a> DeviceJob<'a> {
    fn new(
        context: &'a Arc<Context>,
        mesh: &'a Mesh,
        local: LocalGrid,
        options: &BakeOptions,
        tree: &BinaryTree,
        progress: &'a Progress,
    ) -> Result<Self, Error> {
        let coarse = coarse_grid(&local, STRIDE);
        let count = coarse.shape().iter().product::<usize>() as u64;
        Ok(Self {
            context,
            mesh,
            local,
            progress,
            width: options.band.map(|voxels| voxels * local.step().max_element()),
            nodes: context.upload("tree", &tree.nodes)?,
            triangles: context.upload("triangles", &tree.frames(mesh))?,
            axes: context.upload("sample positions", &positions(&local))?,
            coarse,
            coarse_slots: context.storage("coarse triangles", 4 * count)?,
            coarse_squares: context.storage("coarse distances", 4 * count)?,
        })
    }

    fn bytes(&self) -> usize {
        let buffers = [&self.nodes, &self.triangles, &self.axes, &self.coarse_slots, &self.coarse_squares];
        buffers.iter().map(|buffer| buffer.size() as usize).sum()
    }

    /// Computes unsigned local distances of the whole field. Returns the number of samples repeated on the CPU.
    fn measure(&self, field: &DeviceField) -> Result<usize, Error> {
        let whole = Slab { first_plane: 0, planes: self.coarse.shape()[2], buffer: self.coarse_squares.clone() };
        let coarse_axes = self.context.upload("coarse positions", &positions(&self.coarse))?;
        let mut redone = self.search("coarse", &self.coarse, &coarse_axes, &whole, FAR)?;
        let limit = self.width.map_or(FAR, |width| (width * width * (1.0 + LIMIT_SLACK)) as f32);
        for slab in field.slabs() {
            redone += self.search("main", &self.local, &self.axes, slab, limit)?;
        }
        Ok(redone)
    }

    /// Runs one entry point of the distance kernel over a slab.
    fn search(
        &self,
        entry: &'static str,
        grid: &LocalGrid,
        axes: &wgpu::Buffer,
        slab: &Slab,
        limit_squared: f32,
    ) -> Result<usize, Error> {
        let context = self.context;
        let [nx, ny, _] = grid.shape();
        let blocks = [nx, ny, slab.planes].map(|n| n.div_ceil(BLOCK) as u64).iter().product::<u64>();
        let mut params = DistanceParams {
            shape: grid.shape().map(|n| n as u32),
            coarse_shape: self.coarse.shape().map(|n| n as u32),
            stride: STRIDE as u32,
            first_plane: slab.first_plane as u32,
            planes: slab.planes as u32,
            limit_squared,
            ..DistanceParams::default()
        };
        let uniform = context.uniform("distance parameters", &params)?;
        let overflows = context.storage("overflow count", 4)?;
        let kernel = context.kernel("bake_distance", entry)?;
        let buffers = [
            (0, &uniform),
            (1, &self.nodes),
            (2, &self.triangles),
            (3, axes),
            (4, &self.coarse_slots),
            (5, &slab.buffer),
            (6, &overflows),
        ];
        let group = context.bind("distance", &kernel, &buffers)?;
        // Progress counts the samples of the grid, without the coarse pass.
        let samples = if entry == "main" { (nx * ny * slab.planes) as u64 } else { 0 };
        in_pieces(context, "the distance kernel", blocks, BLOCKS.0, BLOCKS.1, self.progress, |first, count| {
            params.first_block = first as u32;
            context.write("distance parameters", &uniform, 0, &[params])?;
            let submission = context.dispatch("distance", &kernel, &group, [count as u32, 1, 1])?;
            self.progress.advance(samples * (first + count) / blocks - samples * first / blocks)?;
            Ok(submission)
        })?;

        let mut count = [0u32];
        context.read("overflow count", &overflows, &mut count, self.progress)?;
        if count[0] > 0 {
            self.redo(grid, slab, entry == "coarse")?;
        }
        Ok(count[0] as usize)
    }

    /// Replaces the negative results of searches that ran out of rounds.
    fn redo(&self, grid: &LocalGrid, slab: &Slab, squared: bool) -> Result<(), Error> {
        let [nx, ny, _] = grid.shape();
        let mut results = vec![0.0f32; nx * ny * slab.planes];
        self.context.read("unfinished searches", &slab.buffer, &mut results, self.progress)?;
        for (i, _) in results.iter().enumerate().filter(|(_, result)| **result < 0.0) {
            let p = grid.at([i % nx, i / nx % ny, slab.first_plane + i / (nx * ny)]);
            let distance = self.mesh.closest_point(p).distance;
            let result = if squared { distance * distance } else { distance } as f32;
            self.context.write("redone searches", &slab.buffer, 4 * i as u64, &[result])?;
            self.progress.check()?;
        }
        Ok(())
    }

    /// Applies band, units, signs and thickness. Returns the number of samples below zero.
    fn finish(&self, field: &DeviceField, bits: Option<&InsideBits>, thickness: Option<f64>) -> Result<usize, Error> {
        let context = self.context;
        let [nx, ny, _] = field.shape();
        let kernel = context.kernel("bake_finish", "main")?;
        let count = context.storage("negative count", 4)?;
        let spacing = self.coarse.step();
        let mut inside = 0;
        for slab in field.slabs() {
            let part = bits.map_or(&[][..], |bits| {
                let plane = bits.words_per_row * ny;
                &bits.words[plane * slab.first_plane..][..plane * slab.planes]
            });
            let params = FinishParams {
                shape: field.shape().map(|n| n as u32),
                first_plane: slab.first_plane as u32,
                coarse_shape: self.coarse.shape().map(|n| n as u32),
                planes: slab.planes as u32,
                spacing_squared: (spacing * spacing).as_vec3().to_array(),
                scale: self.mesh.scale() as f32,
                width: self.width.map_or(-1.0, |width| width as f32),
                half_thickness: thickness.map_or(0.0, |thickness| 0.5 * thickness) as f32,
                words_per_row: bits.map_or(0, |bits| bits.words_per_row as u32),
                stride: STRIDE as u32,
            };
            let uniform = context.uniform("finish parameters", &params)?;
            let words = context.upload("signs", part)?;
            context.write("negative count", &count, 0, &[0u32])?;
            let buffers = [(0, &uniform), (1, &words), (2, &self.coarse_squares), (4, &slab.buffer), (5, &count)];
            let group = context.bind("finish", &kernel, &buffers)?;
            let workgroups = ((nx * ny * slab.planes) as u64).div_ceil(64);
            let across = workgroups.min(WORKGROUPS_PER_ROW);
            let size = [across as u32, workgroups.div_ceil(across) as u32, 1];
            context.dispatch("finish", &kernel, &group, size)?;
            let mut found = [0u32];
            context.read("negative count", &count, &mut found, self.progress)?;
            inside += found[0] as usize;
        }
        Ok(inside)
    }
}

/// Positions along x, then y, then z, in the layout of the shaders.
pub(super) fn positions(grid: &LocalGrid) -> Vec<f32> {
    grid.axes.iter().flat_map(|axis| (0..axis.count).map(|i| axis.at(i) as f32)).collect()
}
