//! Light interpolated from evaluated neighbours: joint bilateral upsampling (Kopf et al., SIGGRAPH 2007).

use super::gbuffer::GBuffer;
use super::light_buffer::{LightBuffer, stride};
use super::lit_surface::LitSurface;
use super::pass::Pass;
use crate::error::Error;
use glam::DVec3;
use rayon::prelude::*;

/// Smallest cosine between normals of surfaces that share their light: 18 degrees.
const SAME_NORMAL: f32 = 0.95;
/// Values that differ by less may be averaged, if they are at most two pixels apart. For four pixels the limit is half
/// as large.
const AGREE: f32 = 0.125;
/// Values of occlusion that differ by less may be averaged. The limit is larger than [`AGREE`], because the edges of
/// occlusion are softer than those of shadows.
const AGREE_OPEN: f32 = 0.25;
/// Smallest sum of the bilinear weights of matching neighbours.
const ENOUGH: f32 = 0.5;

/// Interpolates light for the surfaces of the pass from a buffer that has light at every `every`-th pixel. Values are
/// interpolated at every `finer`-th pixel.
pub(crate) fn gather(
    pass: &Pass<'_>,
    known: &mut LightBuffer,
    source: &GBuffer,
    asked: &LightBuffer,
    [every, finer]: [u32; 2],
) -> Result<(), Error> {
    let lights = known.lights;
    let is_open_only = pass.lights.lights.is_empty();
    let agree = if is_open_only && every <= 2 { AGREE_OPEN } else { AGREE * (2.0 / every as f32).min(1.0) };
    known.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut neighbours = Vec::with_capacity(4);
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !layer.x.is_multiple_of(finer) || !(y as u32).is_multiple_of(finer) {
                continue;
            }
            let surface = LitSurface::new(pass.casters.scene, pass.buffer, y, layer);
            neighbours.clear();
            fitting(pass, &surface, y, source, asked, every, &mut neighbours);
            let values = &mut row.values[i * stride(lights)..][..stride(lights)];
            row.is_known[i] = mean(&neighbours, agree, values);
            for (light, share) in pass.lights.lights.iter().zip(&mut values[1..]) {
                if let Some(plain) = surface.plain_share(&light.seen_from(surface.place.p).0, pass.options) {
                    *share = plain;
                }
            }
        }
        pass.progress.check()
    })
}

/// The evaluated surfaces around a surface that can share their light with it, and their bilinear weights.
fn fitting<'a>(
    pass: &Pass<'_>,
    surface: &LitSurface<'_>,
    y: usize,
    source: &GBuffer,
    asked: &'a LightBuffer,
    every: u32,
    neighbours: &mut Vec<(&'a [f32], f32)>,
) {
    let view = &pass.buffer.view;
    let eye = view.camera.eye;
    let p = eye + surface.layer.depth * view.direction(surface.layer.x, y as u32);
    let normal = surface.layer.normal.as_dvec3();
    // Half the distance between two evaluated pixels on the surface.
    let apart = 0.5 * view.camera.pixel_size(view.size[1]) * surface.layer.depth * f64::from(every);
    let at = |pixel: u32, offset: f64| (f64::from(pixel) + offset - 0.5) / f64::from(every);
    let (u, v) = (at(surface.layer.x, view.offset[0]), at(y as u32, view.offset[1]));
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, line) = (u.floor() + dx, v.floor() + dy);
        let weight = ((1.0 - (u - column).abs()) * (1.0 - (v - line).abs())) as f32;
        let (x, y) = (column * f64::from(every), line * f64::from(every));
        if weight <= 0.0 || x < 0.0 || y < 0.0 || y >= f64::from(view.size[1]) {
            continue;
        }
        let (x, y) = (x as u32, y as usize);
        let layers = &source.rows[y];
        let first = layers.partition_point(|layer| layer.x < x);
        let same = layers[first..].iter().take_while(|layer| layer.x == x).position(|layer| {
            layer.instance == surface.layer.instance && layer.normal.dot(surface.layer.normal) >= SAME_NORMAL && {
                let q: DVec3 = eye + layer.depth * source.view.direction(x, y as u32);
                normal.dot(q - p).abs() <= apart
            }
        });
        if let Some(i) = same {
            neighbours
                .push((&asked.rows[y].values[(first + i) * stride(asked.lights)..][..stride(asked.lights)], weight));
        }
    }
}

/// The weighted mean of values; false if there are too few or they differ by more than `agree`.
fn mean(neighbours: &[(&[f32], f32)], agree: f32, values: &mut [f32]) -> bool {
    let total: f32 = neighbours.iter().map(|(_, weight)| weight).sum();
    if total < ENOUGH {
        return false;
    }
    for (i, value) in values.iter_mut().enumerate() {
        let of = |neighbour: &(&[f32], f32)| neighbour.0[i];
        let low = neighbours.iter().map(of).fold(f32::INFINITY, f32::min);
        let high = neighbours.iter().map(of).fold(0.0, f32::max);
        if high - low > agree {
            return false;
        }
        *value = neighbours.iter().map(|(values, weight)| values[i] * weight).sum::<f32>() / total;
    }
    true
}
