//! Samples and gradients of a field in device memory (`shaders/field/field_cells.wgsl`).
//!
//! *Theory.* The value at a point depends on the corners of one or two cells of the grid. The device copies these
//! corners, and the CPU interpolates them. The results have the bits of a field in host memory, also for the bound
//! outside the box, and no other sample leaves the device.
//!
//! *Practice.* Each point is evaluated twice by the same code. The first pass records the cells that it reads. The
//! second pass reads their corners in the same order. Which cells are read depends on the point only.

use super::device::DeviceField;
use super::{Cell, SampleFilter, Trilinear, outside};
use crate::error::Error;
use crate::gpu::layout::CellParams;
use crate::gpu::pace::in_groups;
use crate::grid::Grid;
use crate::progress::Progress;
use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};

/// Number of points on the device at a time. At most two cells of 44 bytes each fit within any binding.
const BATCH: usize = 1 << 20;
/// Number of points that a thread evaluates at a time.
const CHUNK: usize = 4096;

/// The trilinear field at points, and the lower bound outside the box. See [`Trilinear::sample`].
pub(crate) fn sample(
    field: &DeviceField,
    grid: &Grid,
    points: &[DVec3],
    inner: [DVec3; 2],
    filter: SampleFilter,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    evaluate(field, grid, points, progress, |cells, p| cells.sample_or_bound(p, inner, filter))
}

/// [`Trilinear::gradients`] of a field in device memory.
pub(crate) fn gradients(
    field: &DeviceField,
    grid: &Grid,
    points: &[DVec3],
    progress: &Progress,
) -> Result<Vec<Vec3>, Error> {
    evaluate(field, grid, points, progress, |cells, p| cells.gradient_or_nan(p))
}

/// Evaluates a function of a field at every point.
fn evaluate<T: Copy + Default + Send>(
    field: &DeviceField,
    grid: &Grid,
    points: &[DVec3],
    progress: &Progress,
    value: impl Fn(&CellReader<'_>, DVec3) -> T + Sync,
) -> Result<Vec<T>, Error> {
    progress.set_total(points.len() as u64);
    let mut values = vec![T::default(); points.len()];
    for (points, values) in points.chunks(BATCH).zip(values.chunks_mut(BATCH)) {
        let recorded: Vec<Vec<[i32; 3]>> = points
            .par_chunks(CHUNK)
            .map(|points| {
                let reader = CellReader { grid, corners: &[], read: Mutex::default() };
                for &p in points {
                    value(&reader, p);
                }
                reader.read.into_inner().unwrap_or_else(PoisonError::into_inner)
            })
            .collect();
        let corners = corners_of(field, &recorded.concat(), progress)?;
        let mut rest = &corners[..];
        let corners: Vec<&[[f32; 8]]> = recorded
            .iter()
            .map(|cells| {
                let (own, others) = rest.split_at(cells.len());
                rest = others;
                own
            })
            .collect();
        values.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK)).zip(corners).for_each(
            |((values, points), corners)| {
                let reader = CellReader { grid, corners, read: Mutex::default() };
                for (slot, &p) in values.iter_mut().zip(points) {
                    *slot = value(&reader, p);
                }
            },
        );
        progress.advance(points.len() as u64)?;
    }
    Ok(values)
}

/// The cells that an evaluation reads, in order, and their corners if they are known.
struct CellReader<'a> {
    grid: &'a Grid,
    /// Corners of the cells in the order in which they are read; empty while the cells are recorded.
    corners: &'a [[f32; 8]],
    /// Cells that were read, in order. One thread uses a reader, but [`Trilinear`] requires a type that threads can
    /// share.
    read: Mutex<Vec<[i32; 3]>>,
}

impl Trilinear for CellReader<'_> {
    fn grid(&self) -> &Grid {
        self.grid
    }

    fn cell(&self, index: IVec3) -> Cell {
        let mut read = self.read.lock().unwrap_or_else(PoisonError::into_inner);
        let corners = self.corners.get(read.len()).copied().unwrap_or_default();
        read.push(index.to_array());
        Cell { corners, first: index, size: 1 }
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        outside::bound_outside(self, p, inner)
    }
}

/// The samples at the corners of cells; bit 0 of the corner is x, bit 1 y, bit 2 z.
fn corners_of(field: &DeviceField, cells: &[[i32; 3]], progress: &Progress) -> Result<Vec<[f32; 8]>, Error> {
    let mut corners = vec![[0.0f32; 8]; cells.len()];
    if cells.is_empty() {
        return Ok(corners);
    }
    let context = field.context();
    let kernel = context.kernel("field_cells", "main")?;
    let positions = context.upload("cells", cells)?;
    let found = context.storage("corners of cells", size_of_val(&corners[..]) as u64)?;
    let mut params = CellParams { shape: field.shape().map(|n| n as u32), ..CellParams::default() };
    for slab in field.slabs() {
        params.first_plane = slab.first_plane as u32;
        params.end_plane = (slab.first_plane + slab.planes) as u32;
        let uniform = context.uniform("parameters of cells", &params)?;
        let buffers = [(0, &uniform), (1, &slab.buffer), (2, &positions), (3, &found)];
        let group = context.bind("cells", &kernel, &buffers)?;
        in_groups(context, "the kernel of cells", cells.len(), progress, |first, count, workgroups| {
            (params.first, params.count) = (first, count);
            context.write("parameters of cells", &uniform, 0, &[params])?;
            Ok(context.dispatch("cells", &kernel, &group, workgroups)?)
        })?;
    }
    context.read("corners of cells", &found, &mut corners, progress)?;
    Ok(corners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::tests::test_context;
    use crate::mesh::random::uniform;
    use crate::volume::FieldView;

    /// A device returns the bits of a field in host memory: between centres, in the outer half voxels, at centres, and
    /// outside. The field has several slabs, so that cells lie across their ends.
    #[test]
    fn a_device_has_the_bits_of_the_host() {
        let Some(context) = test_context() else { return };
        let grid = Grid::new(DVec3::new(-1.0, 0.5, 2.0), DVec3::new(1.0, 2.0, 2.5), [5, 4, 9]).unwrap();
        let mut random = uniform(5);
        let samples: Vec<f32> = (0..grid.len()).map(|_| random() as f32 - 0.5).collect();
        let field = DeviceField::allocate(&context, grid.shape, 5 * 4 * 4 * 2).unwrap();
        assert!(field.slabs().len() > 2);
        for slab in field.slabs() {
            let part = &samples[20 * slab.first_plane..][..20 * slab.planes];
            context.fill("a field", &slab.buffer, part).unwrap();
        }
        let mut points: Vec<DVec3> = (0..3 * CHUNK)
            .map(|_| grid.lower + (grid.upper - grid.lower) * (DVec3::new(random(), random(), random()) * 1.6 - 0.3))
            .collect();
        points.extend((0..4).map(|i| grid.center(i, i, 2 * i)));
        points.push(DVec3::new(f64::NAN, 1.0, 2.2));

        let host = FieldView::new(grid, &samples).unwrap();
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let progress = Progress::new();
        for inner in [[grid.lower, grid.upper], [DVec3::new(-0.5, 0.8, 2.1), DVec3::new(0.5, 1.6, 2.4)]] {
            for filter in [SampleFilter::Linear, SampleFilter::Nearest] {
                let here = host.sample(&points, inner, filter, &progress).unwrap();
                let there = sample(&field, &grid, &points, inner, filter, &progress).unwrap();
                assert_eq!(bits(there), bits(here));
            }
        }
        let flat = |values: Vec<Vec3>| bits(values.into_iter().flat_map(|v| v.to_array()).collect());
        let here = host.gradients(&points, &progress).unwrap();
        assert_eq!(flat(gradients(&field, &grid, &points, &progress).unwrap()), flat(here));
    }
}
