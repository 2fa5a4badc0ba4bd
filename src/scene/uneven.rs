//! Several samples for the pixels whose colour is uneven.
//!
//! A picture with several samples per pixel draws the centres of all pixels first. Where the colours of neighbouring
//! centres change evenly, the colour at the centre is the mean over the pixel, to a fraction of the second difference.
//! The other pixels and those around them are divided evenly, and the mean of their samples is their colour. Where the
//! samples of a pixel differ, an edge passes through it. All its neighbours are divided too, so that a line thinner
//! than a pixel, which most centres miss, has no gaps (adaptive sampling: Mitchell, "Generating antialiased images at
//! low sampling densities", SIGGRAPH 1987).

use super::visibility::gbuffer::Pixels;
use crate::error::Error;
use crate::picture::Frame;
use glam::{Vec3, Vec4};
use rayon::prelude::*;

/// Second differences of the displayed colours of neighbouring centres up to this one are even. An edge between two
/// such colours changes the mean of a pixel by half as much: 4 of 255 steps.
const EVEN: f32 = 1.0 / 32.0;
/// Smallest range of the displayed colours in a pixel with an edge.
const EDGE: f32 = 1.0 / 16.0;
/// Smallest cosine between the normals of neighbouring centres on an even surface: 26 degrees.
const LEAST_COSINE: f32 = 0.9;

/// Replaces the colours of uneven pixels of a picture by the mean of `sides` times `sides` samples. `draw` returns the
/// colours of the chosen pixels in their order, through a point of each pixel.
pub(super) fn sample(
    frame: &mut Frame,
    sides: u32,
    mut draw: impl FnMut([f64; 2], &Pixels) -> Result<Vec<Vec4>, Error>,
) -> Result<(), Error> {
    let size = [frame.width, frame.height];
    let share = 1.0 / (sides * sides) as f32;
    let mut is_sampled = vec![false; size[0] * size[1]];
    let mut beside = around(&uneven(frame), size);
    loop {
        let is_chosen: Vec<bool> =
            beside.iter().zip(&is_sampled).map(|(&beside, &sampled)| beside && !sampled).collect();
        let places: Vec<usize> = (0..is_chosen.len()).filter(|&pixel| is_chosen[pixel]).collect();
        if places.is_empty() {
            return Ok(());
        }
        let chosen = Pixels { width: size[0], is_chosen };
        let colors = frame.color.as_chunks_mut::<4>().0;
        let mut sums = vec![Vec4::ZERO; places.len()];
        let mut ranges: Vec<[Vec4; 2]> = places.iter().map(|&pixel| [displayed(colors[pixel]); 2]).collect();
        for i in 0..sides * sides {
            let offset = [i % sides, i / sides].map(|k| (f64::from(k) + 0.5) / f64::from(sides));
            for ((sum, [low, high]), color) in sums.iter_mut().zip(&mut ranges).zip(draw(offset, &chosen)?) {
                *sum += color;
                let color = displayed(color.to_array());
                (*low, *high) = (low.min(color), high.max(color));
            }
        }
        let mut has_edge = vec![false; is_sampled.len()];
        for ((pixel, sum), [low, high]) in places.into_iter().zip(sums).zip(ranges) {
            colors[pixel] = (share * sum).to_array();
            is_sampled[pixel] = true;
            has_edge[pixel] = (high - low).max_element() > EDGE;
        }
        beside = around(&has_edge, size);
    }
}

/// The colour on a screen, near enough to compare colours: its square root.
fn displayed(color: [f32; 4]) -> Vec4 {
    let [red, green, blue, opacity] = color.map(|value| value.clamp(0.0, 1.0));
    Vec4::new(red.sqrt(), green.sqrt(), blue.sqrt(), opacity)
}

/// The pixels whose neighbours to the left and right, or above and below, show another object, a turned surface, or a
/// colour that changes unevenly.
fn uneven(frame: &Frame) -> Vec<bool> {
    let (width, height) = (frame.width, frame.height);
    let displayed: Vec<Vec4> = frame.color.as_chunks().0.par_iter().map(|&color| displayed(color)).collect();
    let normal = |pixel: usize| Vec3::from_slice(&frame.normal[3 * pixel..]);
    let is_apart = |a: usize, b: usize| {
        frame.object_id[a] != frame.object_id[b] || frame.object_id[a] >= 0 && normal(a).dot(normal(b)) < LEAST_COSINE
    };
    let is_uneven = |pixel: usize| {
        let (x, y) = (pixel % width, pixel / width);
        // A pixel at the border of the picture has one neighbour, whose difference must be small.
        let pairs = [
            [if x > 0 { pixel - 1 } else { pixel }, if x + 1 < width { pixel + 1 } else { pixel }],
            [if y > 0 { pixel - width } else { pixel }, if y + 1 < height { pixel + width } else { pixel }],
        ];
        pairs.into_iter().any(|[a, b]| {
            let bend = displayed[a] + displayed[b] - 2.0 * displayed[pixel];
            bend.abs().max_element() > EVEN || is_apart(pixel, a) || is_apart(pixel, b)
        })
    };
    (0..width * height).into_par_iter().map(is_uneven).collect()
}

/// Some pixels, and all their neighbours.
fn around(pixels: &[bool], [width, height]: [usize; 2]) -> Vec<bool> {
    let mut all = vec![false; pixels.len()];
    for pixel in (0..pixels.len()).filter(|&pixel| pixels[pixel]) {
        let (x, y) = (pixel % width, pixel / width);
        for y in y.saturating_sub(1)..=(y + 1).min(height - 1) {
            all[x.saturating_sub(1) + width * y..=(x + 1).min(width - 1) + width * y].fill(true);
        }
    }
    all
}
