//! A stored field: samples, gradients, other resolutions.
//!
//! # Theory
//!
//! Samples lie at voxel centres. Between the centres the field is trilinear. In the outer half voxel of the box, it has
//! the value of the nearest point between centres (the "clamp to edge" of texture samplers). [`Trilinear`] is the only
//! implementation of this function: sampling, gradients, resampling and the ray marcher read the field through it, so a
//! picture shows exactly the surface that `sample` reports.
//!
//! Positions are in *grid space*: voxel centres at integers, `p_grid = (p_world - lower) / spacing - 1/2`. The
//! subtraction is done in f64, so a box far from the origin loses no precision; the weights are f32.
//!
//! Cell `i` on an axis lies between the centres `i` and `i + 1`. With `n` voxels the cells run from -1 to n - 1: the
//! first and the last are the outer half voxels, whose corners are clamped to the same sample.
//!
//! ```text
//!   box   |   .   |   .   |   .   |     n = 3 voxels, centres at 0, 1, 2
//!   cells |-1 |   0   |   1   | 2 |     cells -1 and 2 are constant along this axis
//! ```
//!
//! Outside the box nothing is stored; see [`outside`] for the lower bound that is returned there.
//!
//! # Practice
//!
//! [`FieldView`] borrows the distances and is cheap to make. Batches run on all cores in chunks, count their progress
//! in points, and stop when they are cancelled.

pub(crate) mod cells;
pub(crate) mod device;
pub(crate) mod outside;
mod resample;
pub(crate) mod sparse;
mod texel;
mod trilinear;

pub use texel::Texel;
pub use trilinear::{Cell, SampleFilter, Trilinear, trilinear, trilinear_gradient};

use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::memory::{prefetch, zeroed_rows};
use crate::progress::Progress;
use crate::simd::with_vectors;
use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

/// Number of samples that are converted between two checks of the progress.
const CONVERTED: usize = 1 << 18;

/// Converts samples to another encoding, one by one.
pub fn convert<A: Copy + Sync, B: bytemuck::Zeroable + Send>(
    samples: &[A],
    progress: &Progress,
    convert: impl Fn(A) -> B + Sync,
) -> Result<Vec<B>, Error> {
    progress.set_total(samples.len() as u64);
    let mut out = zeroed_rows("samples", samples.len())?;
    out.par_chunks_mut(CONVERTED).zip(samples.par_chunks(CONVERTED)).try_for_each(|(out, samples)| {
        out.iter_mut().zip(samples).for_each(|(out, &sample)| *out = convert(sample));
        progress.advance(samples.len() as u64)
    })?;
    Ok(out)
}

/// A grid and its distances, x fastest, in any encoding.
#[derive(Debug, Clone, Copy)]
pub struct FieldView<'a, T = f32> {
    grid: Grid,
    texels: &'a [T],
    scale: f32,
}

impl<'a> FieldView<'a> {
    /// A view of samples on a grid. Fails unless there is one sample per voxel.
    pub fn new(grid: Grid, distances: &'a [f32]) -> Result<Self, Error> {
        Self::encoded(grid, distances, 1.0)
    }

    /// The view of a grid and distances that [`Self::new`] accepted before.
    #[inline]
    pub fn checked(grid: Grid, distances: &'a [f32]) -> Self {
        debug_assert_eq!(distances.len(), grid.len());
        Self { grid, texels: distances, scale: 1.0 }
    }

    /// The samples, x fastest.
    pub fn distances(&self) -> &'a [f32] {
        self.texels
    }
}

impl<'a, T: Texel> FieldView<'a, T> {
    /// Stored samples and their scale ([`crate::encoding`]).
    pub fn encoded(grid: Grid, texels: &'a [T], scale: f32) -> Result<Self, Error> {
        if texels.len() != grid.len() {
            let [nx, ny, nz] = grid.shape;
            let problem = format!("{nx} x {ny} x {nz} voxels need {} values, got {}", grid.len(), texels.len());
            return Err(ArgumentError::new("distances", problem).into());
        }
        T::ENCODING.check_scale(scale)?;
        Ok(Self { grid, texels, scale })
    }

    /// The samples in their stored encoding.
    pub fn texels(&self) -> &'a [T] {
        self.texels
    }

    /// The samples decoded to f32.
    pub fn decoded(&self, progress: &Progress) -> Result<Vec<f32>, Error> {
        convert(self.texels, progress, |texel| texel.decode(self.scale))
    }

    /// Scale of the stored samples.
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// The samples at the corners of a cell; bit 0 of the index is x, bit 1 y, bit 2 z. Cells run from -1 to n - 1.
    #[inline]
    pub fn corners(&self, cell: IVec3) -> [f32; 8] {
        self.decode(self.texels_around(cell))
    }

    /// Decodes the samples at the corners of a cell. Written out, because the compiler does not inline `map` here.
    #[inline(always)]
    pub fn decode(&self, texels: [T; 8]) -> [f32; 8] {
        let scale = self.scale;
        let [a, b, c, d, e, f, g, h] = texels;
        [
            a.decode(scale),
            b.decode(scale),
            c.decode(scale),
            d.decode(scale),
            e.decode(scale),
            f.decode(scale),
            g.decode(scale),
            h.decode(scale),
        ]
    }

    /// [`FieldView::corners`] in the stored encoding. Always inlined, so that the samples stay in registers.
    #[inline(always)]
    pub fn texels_around(&self, cell: IVec3) -> [T; 8] {
        let [nx, ny, nz] = self.grid.shape;
        // A cell between centres needs no clamping. Negative indices become large ones here.
        let [x, y, z] = [cell.x as u32 as usize, cell.y as u32 as usize, cell.z as u32 as usize];
        if x + 1 < nx && y + 1 < ny && z + 1 < nz {
            return corners_of_first(&self.texels[x + nx * (y + ny * z)..], nx, nx * ny);
        }
        self.clamped_texels(cell)
    }

    /// Values of the field at points. The samples of a group of points are requested from memory before the first of
    /// them is used, so that their latencies overlap.
    #[inline(always)]
    fn sample_in_groups(&self, points: &[DVec3], inner: [DVec3; 2], values: &mut [f32]) {
        let (lower, spacing, last) = (self.grid.lower, self.grid.spacing(), self.shape() - 1.0);
        let [nx, ny, _] = self.grid.shape;
        let mut firsts = [0; GROUP];
        let mut fractions = [Vec3::ZERO; GROUP];
        for (points, values) in points.chunks(GROUP).zip(values.chunks_mut(GROUP)) {
            for (i, &p) in points.iter().enumerate() {
                // As in `Trilinear::sample_linear`. A point between centres lies in the box.
                let p_grid = (p - lower) / spacing - 0.5;
                let is_between = p_grid.cmpge(DVec3::ZERO).all() && p_grid.cmplt(last).all();
                let cell = if is_between { p_grid.floor() } else { DVec3::ZERO };
                fractions[i] = (p_grid - cell).as_vec3();
                let [x, y, z] = cell.as_ivec3().to_array().map(|i| i as usize);
                let first = x + nx * (y + ny * z);
                for row in [0, nx, nx * ny, nx * ny + nx] {
                    if let Some(texel) = self.texels.get(first + row) {
                        prefetch(texel);
                    }
                }
                firsts[i] = if is_between { first } else { usize::MAX };
            }
            for (i, value) in values.iter_mut().enumerate() {
                *value = match self.texels.get(firsts[i]..) {
                    Some(texels) => trilinear(&self.decode(corners_of_first(texels, nx, nx * ny)), fractions[i]),
                    None => self.sample_or_bound(points[i], inner, SampleFilter::Linear),
                };
            }
        }
    }

    #[cold]
    fn clamped_texels(&self, cell: IVec3) -> [T; 8] {
        let [nx, ny, nz] = self.grid.shape;
        let clamp = |i: i32, n: usize| (i.max(0) as usize).min(n - 1);
        let [x0, y0, z0] = [clamp(cell.x, nx), clamp(cell.y, ny), clamp(cell.z, nz)];
        let [x1, y1, z1] = [clamp(cell.x + 1, nx), clamp(cell.y + 1, ny), clamp(cell.z + 1, nz)];
        let texel = |x, y, z| self.texels[self.grid.offset(x, y, z)];
        [
            texel(x0, y0, z0),
            texel(x1, y0, z0),
            texel(x0, y1, z0),
            texel(x1, y1, z0),
            texel(x0, y0, z1),
            texel(x1, y0, z1),
            texel(x0, y1, z1),
            texel(x1, y1, z1),
        ]
    }
}

/// Number of points whose samples are requested together.
const GROUP: usize = 32;

/// The samples at the corners of a cell, of which `texels` begin with the first; `y` and `z` are the steps to the next
/// sample along these axes.
#[inline(always)]
fn corners_of_first<T: Texel>(texels: &[T], y: usize, z: usize) -> [T; 8] {
    let d = &texels[..y + z + 2];
    [d[0], d[1], d[y], d[y + 1], d[z], d[z + 1], d[y + z], d[y + z + 1]]
}

impl<T: Texel> Trilinear for FieldView<'_, T> {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    #[inline]
    fn cell(&self, index: IVec3) -> Cell {
        Cell { corners: self.corners(index), first: index, size: 1 }
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        outside::bound_outside(self, p, inner)
    }

    fn sample_chunk(&self, points: &[DVec3], inner: [DVec3; 2], filter: SampleFilter, values: &mut [f32]) {
        if filter == SampleFilter::Nearest {
            for (value, &p) in values.iter_mut().zip(points) {
                *value = self.sample_or_bound(p, inner, filter);
            }
            return;
        }
        with_vectors!(
            [T: Texel] (field: &FieldView<'_, T> = self, points: &[DVec3] = points, inner: [DVec3; 2] = inner,
             values: &mut [f32] = values)
            { field.sample_in_groups(points, inner, values) }
        )
    }

    #[inline]
    fn prefetch(&self, p: DVec3) {
        // Truncation finds another cell only in the outer half voxel, where an address next to the sample is enough.
        let p_grid = self.grid_from_world(p).max(DVec3::ZERO).min(self.shape() - 1.0);
        let [nx, ny, _] = self.grid.shape;
        let first = self.grid.offset(p_grid.x as usize, p_grid.y as usize, p_grid.z as usize);
        for row in [0, nx, nx * ny, nx * ny + nx] {
            if let Some(texel) = self.texels.get(first + row) {
                prefetch(texel);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::progress::Progress;
    use proptest::prelude::*;

    /// A field that trilinear interpolation reproduces: every product of x, y, z to the first power.
    fn multilinear(p: DVec3) -> f64 {
        1.0 + 2.0 * p.x - p.y + 0.5 * p.z + 0.3 * p.x * p.y - 0.7 * p.y * p.z + 0.2 * p.z * p.x + 0.1 * p.x * p.y * p.z
    }

    fn multilinear_gradient(p: DVec3) -> DVec3 {
        DVec3::new(
            2.0 + 0.3 * p.y + 0.2 * p.z + 0.1 * p.y * p.z,
            -1.0 + 0.3 * p.x - 0.7 * p.z + 0.1 * p.z * p.x,
            0.5 - 0.7 * p.y + 0.2 * p.x + 0.1 * p.x * p.y,
        )
    }

    fn oblong_grid() -> Grid {
        Grid::new(DVec3::new(-1.0, 0.5, 2.0), DVec3::new(1.0, 2.0, 2.5), [5, 4, 3]).unwrap()
    }

    pub(super) fn fill(grid: &Grid, f: impl Fn(DVec3) -> f64) -> Vec<f32> {
        let mut values = Vec::with_capacity(grid.len());
        for z in 0..grid.shape[2] {
            for y in 0..grid.shape[1] {
                for x in 0..grid.shape[0] {
                    values.push(f(grid.center(x, y, z)) as f32);
                }
            }
        }
        values
    }

    /// The magnitude of the test field is below 8. Twelve f32 roundings stay below this.
    const ROUNDING: f64 = 8.0 * 12.0 * f32::EPSILON as f64;

    proptest! {
        #[test]
        fn linear_reproduces_a_multilinear_field_and_its_gradient(u in 0.0..1.0f64, v in 0.0..1.0f64, w in 0.0..1.0f64) {
            let grid = oblong_grid();
            let distances = fill(&grid, multilinear);
            let field = FieldView::new(grid, &distances).unwrap();
            let h = grid.spacing();
            let p = grid.lower + 0.5 * h + (grid.upper - grid.lower - h) * DVec3::new(u, v, w);
            prop_assert!((field.sample_linear(p) as f64 - multilinear(p)).abs() < ROUNDING);
            // The difference of two samples is divided by the smallest spacing, 1/6.
            prop_assert!((field.gradient(p).as_dvec3() - multilinear_gradient(p)).abs().max_element() < 6.0 * 2.0 * ROUNDING);
        }

        #[test]
        fn gradient_is_the_derivative_of_the_samples(seed in any::<[i8; 27]>(), u in 0.0..1.0f64, v in 0.0..1.0f64, w in 0.0..1.0f64) {
            let grid = Grid::new(DVec3::ZERO, DVec3::new(3.0, 6.0, 1.5), [3, 3, 3]).unwrap();
            let distances: Vec<f32> = seed.iter().map(|&value| value as f32 / 127.0).collect();
            let field = FieldView::new(grid, &distances).unwrap();
            let h = grid.spacing();
            let step = 1e-3;
            // Points stay away from the cell faces at the integers, where the gradient jumps.
            let inside = |a: f64| a.fract().clamp(2.0 * step, 1.0 - 2.0 * step) + a.floor();
            let p_grid = DVec3::new(inside(2.0 * u), inside(2.0 * v), inside(2.0 * w));
            let p = grid.lower + (p_grid + 0.5) * h;
            for axis in 0..3 {
                let mut offset = DVec3::ZERO;
                offset[axis] = step * h[axis];
                let slope = (field.sample_linear(p + offset) as f64 - field.sample_linear(p - offset) as f64) / (2.0 * step * h[axis]);
                let tolerance = 8.0 * f32::EPSILON as f64 / (2.0 * step * h[axis]);
                prop_assert!((slope - field.gradient(p)[axis] as f64).abs() <= tolerance);
            }
        }
    }

    /// A batch has the bits of single points: between centres, on them, in the outer half voxel, outside, and at NaN.
    #[test]
    fn a_batch_has_the_bits_of_single_points() {
        let mut random = crate::mesh::random::uniform(7);
        for shape in [[5, 4, 3], [1, 6, 2], [2, 1, 1], [40, 3, 17]] {
            let grid = Grid { shape, ..oblong_grid() };
            let distances: Vec<f32> = (0..grid.len()).map(|_| random() as f32 - 0.5).collect();
            let field = FieldView::new(grid, &distances).unwrap();
            let texels: Vec<i16> = (0..grid.len()).map(|_| (random() * 65535.0) as i32 as i16).collect();
            let encoded = FieldView::encoded(grid, &texels, 0.7).unwrap();
            let mut points: Vec<DVec3> = (0..500)
                .map(|_| {
                    grid.lower + (grid.upper - grid.lower) * (DVec3::new(random(), random(), random()) * 1.4 - 0.2)
                })
                .collect();
            points.extend(
                (0..grid.len()).map(|i| grid.center(i % shape[0], i / shape[0] % shape[1], i / (shape[0] * shape[1]))),
            );
            points.extend([grid.lower, grid.upper, DVec3::new(0.0, f64::NAN, 2.1), DVec3::INFINITY]);
            let inner = [grid.lower, grid.upper];
            let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            for filter in [SampleFilter::Linear, SampleFilter::Nearest] {
                let single = points.iter().map(|&p| field.sample_or_bound(p, inner, filter)).collect();
                assert_eq!(bits(field.sample(&points, inner, filter, &Progress::new()).unwrap()), bits(single));
                let single = points.iter().map(|&p| encoded.sample_or_bound(p, inner, filter)).collect();
                assert_eq!(bits(encoded.sample(&points, inner, filter, &Progress::new()).unwrap()), bits(single));
            }
        }
    }

    #[test]
    fn voxel_centres_return_the_stored_samples() {
        let grid = oblong_grid();
        let distances = fill(&grid, multilinear);
        let field = FieldView::new(grid, &distances).unwrap();
        for z in 0..3 {
            for y in 0..4 {
                for x in 0..5 {
                    let stored = distances[grid.offset(x, y, z)];
                    let p = grid.center(x, y, z);
                    assert_eq!(field.sample_nearest(p), stored);
                    assert!((field.sample_linear(p) - stored).abs() as f64 <= ROUNDING);
                    assert!(
                        (field.gradient(p).as_dvec3() - multilinear_gradient(p)).abs().max_element() < 12.0 * ROUNDING
                    );
                }
            }
        }
    }

    #[test]
    fn the_outer_half_voxel_has_the_value_and_the_slope_of_the_outermost_samples() {
        let grid = Grid::new(DVec3::ZERO, DVec3::new(4.0, 4.0, 4.0), [4, 4, 4]).unwrap();
        let distances = fill(&grid, |p| p.x + 10.0 * p.y);
        let field = FieldView::new(grid, &distances).unwrap();
        assert_eq!(field.sample_linear(DVec3::new(0.1, 2.0, 2.0)), 20.5);
        for outside in [DVec3::new(0.1, 2.0, 2.0), DVec3::new(-7.0, 2.0, 2.0), DVec3::splat(4.0), DVec3::splat(9.0)] {
            assert_eq!(field.gradient(outside), Vec3::new(1.0, 10.0, 0.0));
        }
        assert_eq!(field.sample_linear(DVec3::splat(4.0)), 38.5);
        assert_eq!(field.sample_nearest(DVec3::splat(4.0)), 38.5);
    }

    #[test]
    fn a_single_voxel_is_constant() {
        let grid = Grid::new(DVec3::ZERO, DVec3::ONE, [1, 1, 1]).unwrap();
        let field = FieldView::new(grid, &[-3.0]).unwrap();
        for p in [DVec3::ZERO, DVec3::splat(0.5), DVec3::ONE, DVec3::splat(9.0)] {
            assert_eq!(field.sample_linear(p), -3.0);
            assert_eq!(field.sample_nearest(p), -3.0);
            assert_eq!(field.gradient(p), Vec3::ZERO);
        }
    }

    #[test]
    fn an_offset_costs_no_precision() {
        let shift = DVec3::splat(1e6);
        let here = Grid::new(DVec3::ZERO, DVec3::ONE, [8, 8, 8]).unwrap();
        let there = Grid::new(shift, shift + 1.0, [8, 8, 8]).unwrap();
        let distances = fill(&here, multilinear);
        let (near, far) = (FieldView::new(here, &distances).unwrap(), FieldView::new(there, &distances).unwrap());
        // World coordinates of 1e6 have steps of 1.2e-10; the slope of the field is below 4.
        for p in [DVec3::new(0.3, 0.6, 0.9), DVec3::new(0.11, 0.22, 0.33)] {
            assert!((near.sample_linear(p) - far.sample_linear(p + shift)).abs() < 2.0 * 8.0 * f32::EPSILON);
        }
    }

    #[test]
    fn points_that_are_no_numbers_give_nan_and_infinity_an_infinite_bound() {
        let grid = oblong_grid();
        let distances = fill(&grid, multilinear);
        let field = FieldView::new(grid, &distances).unwrap();
        let points = [DVec3::new(f64::NAN, 1.0, 2.2), DVec3::new(f64::INFINITY, 1.0, 2.2)];
        let inner = [grid.lower, grid.upper];
        let values = field.sample(&points, inner, SampleFilter::Linear, &Progress::new()).unwrap();
        assert!(values[0].is_nan());
        assert_eq!(values[1], f32::INFINITY);
        assert!(field.gradients(&points, &Progress::new()).unwrap()[0].is_nan());
    }

    #[test]
    fn batches_stop_when_cancelled() {
        let grid = oblong_grid();
        let distances = fill(&grid, multilinear);
        let field = FieldView::new(grid, &distances).unwrap();
        let progress = Progress::new();
        progress.cancel();
        let result = field.sample(&[DVec3::ONE], [grid.lower, grid.upper], SampleFilter::Linear, &progress);
        assert_eq!(result, Err(Error::Cancelled));
    }

    #[test]
    fn wrong_length_and_unknown_filter_are_refused() {
        let message = FieldView::new(oblong_grid(), &[0.0; 7]).unwrap_err().to_string();
        assert_eq!(message, "distances: 5 x 4 x 3 voxels need 60 values, got 7");
        assert!(SampleFilter::from_name("cubic").unwrap_err().to_string().contains("cubic"));
        assert_eq!(SampleFilter::from_name("nearest"), Ok(SampleFilter::Nearest));
    }
}
