//! Pictures as arrays.

use crate::error::Error;
use crate::memory::require_for;
use crate::progress::Progress;
use rayon::prelude::*;

/// A picture and its arrays by rows, row 0 on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// Number of pixels of a row.
    pub width: usize,
    /// Number of rows.
    pub height: usize,
    /// Number of lights per pixel in `shadow`.
    pub lights: usize,
    /// Linear RGBA, 4 values per pixel.
    pub color: Vec<f32>,
    /// Distance along the viewing axis, world units; infinite without a hit.
    pub depth: Vec<f32>,
    /// Unit normal in world space, 3 values per pixel; zero without a hit.
    pub normal: Vec<f32>,
    /// 0 for the field, -1 without a hit.
    pub object_id: Vec<i32>,
    /// Fraction of each light that arrives, 1 lit, 0 dark, `lights` values per pixel; 1 without a hit.
    pub shadow: Vec<f32>,
    /// Number of cells visited and empty regions skipped by the ray of the pixel.
    pub steps: Vec<u32>,
}

/// One row of every array of a frame.
pub(crate) struct Row<'a> {
    pub lights: usize,
    pub color: &'a mut [f32],
    pub depth: &'a mut [f32],
    pub normal: &'a mut [f32],
    pub object_id: &'a mut [i32],
    pub shadow: &'a mut [f32],
    pub steps: &'a mut [u32],
}

impl Frame {
    /// A picture without any hit.
    pub(crate) fn new(width: usize, height: usize, lights: usize) -> Result<Self, Error> {
        let pixels = width * height;
        let bytes = (4 * (10 + lights) * pixels) as u64;
        require_for(&format!("a picture of {width} x {height} pixels"), bytes, bytes / 2, "draw fewer pixels")?;
        Ok(Self {
            width,
            height,
            lights,
            color: vec![0.0; 4 * pixels],
            depth: vec![f32::INFINITY; pixels],
            normal: vec![0.0; 3 * pixels],
            object_id: vec![-1; pixels],
            shadow: vec![1.0; lights * pixels],
            steps: vec![0; pixels],
        })
    }

    /// A picture that `draw_pixel` fills one pixel at a time: pixel `x` of row `y`, initialised to "no hit". Runs on
    /// all cores by rows, which the progress counts.
    pub(crate) fn by_pixels(
        size: [u32; 2],
        lights: usize,
        progress: &Progress,
        draw_pixel: impl Fn(usize, usize, &mut Row<'_>) + Sync,
    ) -> Result<Self, Error> {
        let [width, height] = size.map(|n| n as usize);
        progress.set_total(height as u64);
        let mut frame = Self::new(width, height, lights)?;
        frame.rows().into_par_iter().enumerate().try_for_each(|(y, mut row)| {
            for x in 0..width {
                draw_pixel(x, y, &mut row);
            }
            progress.advance(1)
        })?;
        Ok(frame)
    }

    pub(crate) fn rows(&mut self) -> Vec<Row<'_>> {
        let (width, lights) = (self.width, self.lights);
        let mut shadow = self.shadow.as_mut_slice();
        self.color
            .chunks_mut(4 * width)
            .zip(self.depth.chunks_mut(width))
            .zip(self.normal.chunks_mut(3 * width))
            .zip(self.object_id.chunks_mut(width))
            .zip(self.steps.chunks_mut(width))
            .map(|((((color, depth), normal), object_id), steps)| {
                // `shadow` is not chunked like the other arrays, since its rows are empty without lights.
                let (row, rest) = std::mem::take(&mut shadow).split_at_mut(lights * width);
                shadow = rest;
                Row { lights, color, depth, normal, object_id, shadow: row, steps }
            })
            .collect()
    }
}
