//! Fields that are trilinear in each of their cells: values, gradients, batches of points.

use crate::error::{ArgumentError, Error, choice};
use crate::grid::Grid;
use crate::memory::zeroed_rows;
use crate::progress::Progress;
use bytemuck::Zeroable;
use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

/// Interpolation of the stored samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SampleFilter {
    /// The trilinear field.
    #[default]
    Linear,
    /// The sample of the voxel that contains the point.
    Nearest,
}

impl SampleFilter {
    /// Converts the public name of a filter.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("filter", name, &[("linear", Self::Linear), ("nearest", Self::Nearest)])
    }
}

/// Number of points in a block of a batch: about 0.2 ms of work, so that cancelling is prompt and scheduling is cheap.
const CHUNK_POINTS: usize = 4096;

/// Number of points between the one that is evaluated and the one whose samples are prefetched. Their memory arrives
/// within the time of about ten evaluations.
const PREFETCH_POINTS: usize = 16;

/// A cube in which a field is the trilinear function of its corner values.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cell {
    /// Values at the corners; bit 0 of the index is x, bit 1 y, bit 2 z.
    pub corners: [f32; 8],
    /// Grid coordinates of corner 0.
    pub first: IVec3,
    /// Side of the cube, voxels.
    pub size: i32,
}

impl Cell {
    /// The field at a point of the cell; grid space.
    #[inline]
    pub fn at(&self, p_grid: DVec3) -> f32 {
        trilinear(&self.corners, self.fraction(p_grid))
    }

    /// Gradient at a point of the cell, distance per voxel.
    fn gradient(&self, p_grid: DVec3) -> Vec3 {
        trilinear_gradient(&self.corners, self.fraction(p_grid)) / self.size as f32
    }

    /// Position in the cell, 0 to 1 along each axis.
    fn fraction(&self, p_grid: DVec3) -> Vec3 {
        ((p_grid - self.first.as_dvec3()) / f64::from(self.size)).as_vec3()
    }
}

/// A field over a grid that is trilinear between samples.
pub trait Trilinear: Sync {
    /// The grid of the samples.
    fn grid(&self) -> &Grid;

    /// The cell from voxel centre `index` to the next; indices run from -1 to n - 1.
    fn cell(&self, index: IVec3) -> Cell;

    /// Lower bound, zero or more, on the distance from `p`, outside the box, to a surface inside the box `inner`
    /// (lower and upper corner).
    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32;

    /// The trilinear field at a world point. A point outside the box is replaced by the nearest point of the box.
    fn sample_linear(&self, p: DVec3) -> f32 {
        let p_grid = self.clamp_to_box(self.grid_from_world(p));
        self.cell(p_grid.floor().as_ivec3()).at(p_grid)
    }

    /// The sample of the voxel that contains `p`, or of the nearest voxel if `p` lies outside.
    fn sample_nearest(&self, p: DVec3) -> f32 {
        // A point on the upper face rounds to n.
        let voxel = self.clamp_to_box(self.grid_from_world(p)).round();
        let voxel = voxel.max(DVec3::ZERO).min(self.shape() - 1.0);
        self.at_voxel(voxel.as_ivec3())
    }

    /// The sample of a voxel.
    #[inline]
    fn at_voxel(&self, voxel: IVec3) -> f32 {
        self.cell(voxel).at(voxel.as_dvec3())
    }

    /// Gradient of the trilinear field, distance per world unit. A point beyond the outermost voxel centres is replaced
    /// by the nearest point between them: in the outer half voxel the field has no slope of its own. The gradient jumps
    /// between cells, and is zero along an axis of one voxel.
    fn gradient(&self, p: DVec3) -> Vec3 {
        let last = self.shape() - 1.0;
        let p_grid = self.grid_from_world(p).max(DVec3::ZERO).min(last);
        // The last centres belong to the cell before them.
        let index = p_grid.floor().min(last - 1.0);
        let per_voxel = self.cell(index.as_ivec3()).gradient(p_grid);
        (per_voxel.as_dvec3() / self.grid().spacing()).as_vec3()
    }

    /// Brings the samples around a world point into the cache, if their addresses are cheap to compute.
    #[inline]
    fn prefetch(&self, _p: DVec3) {}

    /// The field at points. Outside the box: [`Trilinear::distance_bound`]. A NaN coordinate gives NaN.
    fn sample(
        &self,
        points: &[DVec3],
        inner: [DVec3; 2],
        filter: SampleFilter,
        progress: &Progress,
    ) -> Result<Vec<f32>, Error> {
        batch(points, progress, |points, values| self.sample_chunk(points, inner, filter, values))
    }

    /// [`Trilinear::sample`] of a few points.
    fn sample_chunk(&self, points: &[DVec3], inner: [DVec3; 2], filter: SampleFilter, values: &mut [f32]) {
        in_order(points, values, |p| self.prefetch(p), |p| self.sample_or_bound(p, inner, filter));
    }

    /// The field at one point. See [`Trilinear::sample`].
    fn sample_or_bound(&self, p: DVec3, inner: [DVec3; 2], filter: SampleFilter) -> f32 {
        if p.is_nan() {
            f32::NAN
        } else if !self.contains(p) {
            self.distance_bound(p, inner)
        } else {
            match filter {
                SampleFilter::Linear => self.sample_linear(p),
                SampleFilter::Nearest => self.sample_nearest(p),
            }
        }
    }

    /// [`Trilinear::gradient`] at points. A NaN coordinate gives NaN.
    fn gradients(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<Vec3>, Error> {
        batch(points, progress, |points, values| {
            in_order(points, values, |p| self.prefetch(p), |p| self.gradient_or_nan(p));
        })
    }

    /// The gradient at one point. See [`Trilinear::gradients`].
    fn gradient_or_nan(&self, p: DVec3) -> Vec3 {
        if p.is_nan() { Vec3::NAN } else { self.gradient(p) }
    }

    /// Whether the box, faces included, contains `p`.
    fn contains(&self, p: DVec3) -> bool {
        p.cmpge(self.grid().lower).all() && p.cmple(self.grid().upper).all()
    }

    /// Grid space: voxel centres at integers.
    fn grid_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.grid().lower) / self.grid().spacing() - 0.5
    }

    /// The nearest point of the box, grid space.
    fn clamp_to_box(&self, p_grid: DVec3) -> DVec3 {
        p_grid.max(DVec3::splat(-0.5)).min(self.shape() - 0.5)
    }

    /// Number of voxels along each axis.
    fn shape(&self) -> DVec3 {
        let [nx, ny, nz] = self.grid().shape;
        DVec3::new(nx as f64, ny as f64, nz as f64)
    }
}

/// The trilinear function of a cell's corners: along x, then y, then z.
#[inline(always)]
pub fn trilinear(corners: &[f32; 8], fraction: Vec3) -> f32 {
    let x00 = lerp(corners[0], corners[1], fraction.x);
    let x10 = lerp(corners[2], corners[3], fraction.x);
    let x01 = lerp(corners[4], corners[5], fraction.x);
    let x11 = lerp(corners[6], corners[7], fraction.x);
    let y0 = lerp(x00, x10, fraction.y);
    let y1 = lerp(x01, x11, fraction.y);
    lerp(y0, y1, fraction.z)
}

/// Gradient of [`trilinear`] with respect to `fraction`: distance per voxel.
#[inline]
pub fn trilinear_gradient(corners: &[f32; 8], fraction: Vec3) -> Vec3 {
    let [c0, c1, c2, c3, c4, c5, c6, c7] = *corners;
    let Vec3 { x, y, z } = fraction;
    let along_x = lerp(lerp(c1 - c0, c3 - c2, y), lerp(c5 - c4, c7 - c6, y), z);
    let along_y = lerp(lerp(c2 - c0, c3 - c1, x), lerp(c6 - c4, c7 - c5, x), z);
    let along_z = lerp(lerp(c4 - c0, c5 - c1, x), lerp(c6 - c2, c7 - c3, x), y);
    Vec3::new(along_x, along_y, along_z)
}

#[inline(always)]
fn lerp(a: f32, b: f32, fraction: f32) -> f32 {
    a + (b - a) * fraction
}

/// Evaluates parts of the points in parallel.
fn batch<T: Zeroable + Copy + Send>(
    points: &[DVec3],
    progress: &Progress,
    evaluate: impl Fn(&[DVec3], &mut [T]) + Sync,
) -> Result<Vec<T>, Error> {
    progress.set_total(points.len() as u64);
    let mut values = zeroed_rows("results", points.len())?;
    values.par_chunks_mut(CHUNK_POINTS).zip(points.par_chunks(CHUNK_POINTS)).try_for_each(|(values, points)| {
        evaluate(points, values);
        progress.advance(points.len() as u64)
    })?;
    Ok(values)
}

/// Evaluates `f` at every point. `prefetch` is called some points earlier.
fn in_order<T>(points: &[DVec3], values: &mut [T], prefetch: impl Fn(DVec3), f: impl Fn(DVec3) -> T) {
    for (i, (value, &p)) in values.iter_mut().zip(points).enumerate() {
        if let Some(&later) = points.get(i + PREFETCH_POINTS) {
            prefetch(later);
        }
        *value = f(p);
    }
}
