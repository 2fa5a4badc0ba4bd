//! Light interpolated from evaluated neighbours: joint bilateral upsampling (Kopf et al., SIGGRAPH 2007).

use super::light_buffer::LightBuffer;
use super::pass::Pass;
use crate::error::Error;
use crate::scene::content::options::RenderOptions;
use crate::scene::light::lit_surface::LitSurface;
use crate::scene::visibility::gbuffer::{GBuffer, Layer};
use glam::{DVec3, Mat3, Vec3};
use rayon::prelude::*;

/// Smallest cosine between normals of surfaces that share their light: 18 degrees.
const SAME_NORMAL: f32 = 0.95;
/// The same for occlusion, whose change with the normal is estimated: 26 degrees.
const SIMILAR_NORMAL: f32 = 0.9;
/// Values that differ by less may be averaged, if they are at most two pixels apart. For four pixels the limit is half
/// as large.
const AGREE: f32 = 0.125;
/// Smallest sum of the bilinear weights of matching neighbours.
const ENOUGH: f32 = 0.5;
/// The sum of the weights if all neighbours match, less rounding.
const ALL: f32 = 1.0 - 1e-4;

/// Limits for the interpolation of occlusion and indirect light, which are smooth except near contacts. Errors seen in
/// a picture spread over an area, so the limits fall with the distance between evaluated pixels.
#[derive(Debug, Clone, Copy)]
struct OpenLimits {
    /// Values that differ by less may be averaged.
    agree: f32,
    /// Values that differ by less may be interpolated if the values beyond them show how they change.
    smooth: f32,
    /// Largest estimate of the error of linear interpolation for that.
    bend: f32,
    /// Smallest sum of the bilinear weights of matching neighbours. Values are not extended over four pixels.
    enough: f32,
    /// Largest distance in pixels, along rows and columns, of other surfaces whose contact would be missed.
    apart: u32,
}

impl OpenLimits {
    /// Limits for evaluated pixels that are `every` pixels apart.
    fn new(every: u32) -> Self {
        let smooth = 1.0 / every as f32;
        let agree = if every == 1 { 0.25 } else { (smooth * smooth).min(1.0 / 16.0) };
        let enough = if every > 4 { ALL } else { ENOUGH };
        Self { agree, smooth, bend: smooth / 16.0, enough, apart: every / 2 }
    }
}

/// Smallest level of indirect light, times the exposure, to which limits are relative.
const LEAST_LEVEL: f32 = 1.0 / 16.0;
/// Smallest level of indirect light to which limits are relative.
fn least_level(options: &RenderOptions) -> f32 {
    LEAST_LEVEL / options.exposure.max(f32::MIN_POSITIVE)
}

/// Smallest difference of values for which their change is estimated.
const NOTABLE: f32 = 1.0 / 32.0;
/// Weight of the values beyond the neighbours in the estimate of the change with the normal.
const BEYOND_WEIGHT: f32 = 0.25;
/// Variance of the normals, per axis, at which half of a change is attributed to them.
const NORMAL_VARIANCE: f32 = 0.01;

/// Interpolates light for the surfaces of the pass from `evaluated`, the light on the picture `source`, which has light
/// at every `every`-th pixel. Values are interpolated at every `finer`-th pixel.
pub(crate) fn gather(
    pass: &Pass<'_>,
    light: &mut LightBuffer,
    source: &GBuffer,
    evaluated: &LightBuffer,
    [every, finer]: [u32; 2],
) -> Result<(), Error> {
    let stride = light.stride;
    // Without lights, these are the values of occlusion or of indirect light.
    let open = pass.lights.lights.is_empty().then(|| OpenLimits::new(every));
    let agree = AGREE * (2.0 / every as f32).min(1.0);
    light.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut neighbours = Vec::with_capacity(4);
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !layer.x.is_multiple_of(finer) || !(y as u32).is_multiple_of(finer) {
                continue;
            }
            let is_lattice = layer.x.is_multiple_of(every) && (y as u32).is_multiple_of(every);
            if every > finer && is_lattice {
                continue;
            }
            let values = &mut row.values[i * stride..][..stride];
            let around = Around::new(pass.buffer, (y, layer), (source, evaluated), every);
            if let Some(limits) = open {
                let unit = pass.bounces.map(|_| least_level(pass.options));
                row.is_evaluated[i] = around.smooth_light(&limits, unit, &mut neighbours, values);
                continue;
            }
            around.fitting(SAME_NORMAL, &mut neighbours);
            row.is_evaluated[i] = mean(&neighbours, agree, values);
            let surface = LitSurface::new(pass.traced.scene, pass.buffer, y, layer);
            for (light, share) in pass.lights.lights.iter().zip(&mut values[1..]) {
                if let Some(plain) = surface.plain_share(&light.seen_from(surface.place.p).0, pass.options) {
                    *share = plain;
                }
            }
        }
        pass.progress.check()
    })
}

/// A surface, and the evaluated surfaces around it.
struct Around<'s, 'a> {
    buffer: &'s GBuffer,
    layer: &'s Layer,
    y: usize,
    /// World position of the surface.
    p: DVec3,
    /// Half the distance between two evaluated pixels on the surface.
    apart: f64,
    /// The picture of the evaluated surfaces.
    source: &'s GBuffer,
    /// The light on the surfaces of `source`.
    light: &'a LightBuffer,
    /// Distance between evaluated pixels, pixels.
    every: u32,
}

/// An evaluated surface that can share its light.
#[derive(Clone, Copy)]
struct Neighbour<'a> {
    values: &'a [f32],
    normal: Vec3,
    /// Bilinear weight.
    weight: f32,
    /// Position in units of the distance between evaluated pixels, relative to the surface.
    offset: [f64; 2],
}

impl<'s, 'a> Around<'s, 'a> {
    /// Describes the surroundings of one layer of row `y` of `buffer`. The second pair is the picture of the evaluated
    /// surfaces and the light on them; every `every`-th pixel of it is evaluated.
    fn new(
        buffer: &'s GBuffer,
        (y, layer): (usize, &'s Layer),
        (source, light): (&'s GBuffer, &'a LightBuffer),
        every: u32,
    ) -> Self {
        let view = &buffer.view;
        let p = view.position(layer.x, y as u32, layer.depth);
        let apart = 0.5 * view.pixel_size_at(layer.depth) * f64::from(every);
        Self { buffer, layer, y, p, apart, source, light, every }
    }

    /// Position of the surface in units of the distance between evaluated pixels.
    fn position(&self) -> [f64; 2] {
        let offset = self.buffer.view.offset;
        let at = |pixel: u32, offset: f64| (f64::from(pixel) + offset - 0.5) / f64::from(self.every);
        [at(self.layer.x, offset[0]), at(self.y as u32, offset[1])]
    }

    /// The evaluated surfaces around the surface that can share their light with it. The cosine between the normals is
    /// at least `least_cosine`.
    fn fitting(&self, least_cosine: f32, neighbours: &mut Vec<Neighbour<'a>>) {
        neighbours.clear();
        let [u, v] = self.position();
        for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let (column, line) = (u.floor() + dx, v.floor() + dy);
            let weight = ((1.0 - (u - column).abs()) * (1.0 - (v - line).abs())) as f32;
            if weight > 0.0
                && let Some((values, normal)) = self.evaluated(column, line, least_cosine, 1.0)
            {
                neighbours.push(Neighbour { values, normal, weight, offset: [column - u, line - v] });
            }
        }
    }

    /// The values and normal at an evaluated pixel, if its surface belongs to the same instance, lies in the plane of
    /// the surface, and has a similar normal. Column and line are in units of the distance between evaluated pixels.
    /// `far` scales the permitted distance from the plane.
    fn evaluated(&self, column: f64, line: f64, least_cosine: f32, far: f64) -> Option<(&'a [f32], Vec3)> {
        let (x, y) = (column * f64::from(self.every), line * f64::from(self.every));
        let view = &self.source.view;
        if x < 0.0 || y < 0.0 || y >= f64::from(view.size[1]) {
            return None;
        }
        let (x, y) = (x as u32, y as usize);
        let layers = &self.source.rows[y];
        let first = layers.partition_point(|layer| layer.x < x);
        let same = layers[first..].iter().take_while(|layer| layer.x == x).position(|other| {
            let layer = self.layer;
            other.instance == layer.instance && other.normal.dot(layer.normal) >= least_cosine && {
                let q = view.position(x, y as u32, other.depth);
                layer.normal.as_dvec3().dot(q - self.p).abs() <= far * self.apart
            }
        });
        let i = first + same?;
        Some((self.light.values_at(y, i).0, layers[i].normal))
    }

    /// Interpolates occlusion or indirect light from the neighbours; false if it must be evaluated.
    ///
    /// Limits are relative to 1 for occlusion, and to the level of the neighbours for indirect light: at least
    /// `least_level`, which is None for occlusion.
    fn smooth_light(
        &self,
        limits: &OpenLimits,
        least_level: Option<f32>,
        neighbours: &mut Vec<Neighbour<'a>>,
        values: &mut [f32],
    ) -> bool {
        self.fitting(SIMILAR_NORMAL, neighbours);
        let total: f32 = neighbours.iter().map(|near| near.weight).sum();
        if total < limits.enough || !self.is_alone(limits.apart) {
            return false;
        }
        let brightest = |near: &Neighbour<'_>| near.values.iter().copied().fold(0.0, f32::max);
        let level = neighbours.iter().map(|near| near.weight * brightest(near)).sum::<f32>() / total;
        let (unit, most) = least_level.map_or((1.0, 1.0), |least| (level.max(least), f32::INFINITY));
        values.iter_mut().enumerate().all(|(channel, value)| {
            let found = self.smooth_value(limits, neighbours, &|values| values[channel] / unit);
            *value = unit * found.unwrap_or_default().clamp(0.0, most);
            found.is_some()
        })
    }

    /// One value of [`Self::smooth_light`]; None if it must be evaluated.
    ///
    /// Where the neighbours differ, the values beyond them are used too. A ridge regression attributes changes to the
    /// normal, because the light on a curved surface varies most with its normal. What remains is interpolated
    /// along each diagonal, row or column by the cubic polynomial through four values `a, b, c, d`:
    ///
    /// ```text
    ///   (9 b + 9 c - a - d) / 16  =  (b + c) / 2 + (b - a + c - d) / 16
    /// ```
    ///
    /// The second term estimates the error of linear interpolation.
    fn smooth_value(
        &self,
        limits: &OpenLimits,
        neighbours: &[Neighbour<'a>],
        value_of: &dyn Fn(&[f32]) -> f32,
    ) -> Option<f32> {
        let total: f32 = neighbours.iter().map(|near| near.weight).sum();
        let normal = self.layer.normal;
        let average = |value: &dyn Fn(&Neighbour<'a>) -> f32| {
            neighbours.iter().map(|near| near.weight * value(near)).sum::<f32>() / total
        };
        let mean = average(&|near| value_of(near.values));
        let range = |value: &dyn Fn(&Neighbour<'a>) -> f32| {
            let low = neighbours.iter().map(value).fold(f32::INFINITY, f32::min);
            neighbours.iter().map(value).fold(f32::NEG_INFINITY, f32::max) - low
        };
        if range(&|near| value_of(near.values)) <= limits.agree.min(NOTABLE) {
            return Some(mean);
        }
        let [u, v] = self.position();
        let beyond: [Option<(&[f32], Vec3)>; 4] = std::array::from_fn(|i| {
            let [x, y] = neighbours.get(i)?.offset;
            // A sample of a finer picture has no lattice position of its own.
            let is_lattice = [x, y].iter().all(|along| along.abs() == 0.5 || *along == 0.0);
            is_lattice.then(|| self.evaluated(u + 3.0 * x, v + 3.0 * y, 0.0, 3.0)).flatten()
        });
        let middle = neighbours.iter().map(|near| near.weight * near.normal).sum::<Vec3>() / total;
        let (mut spread, mut change) = (Mat3::from_diagonal(Vec3::splat(NORMAL_VARIANCE)), Vec3::ZERO);
        let mut include = |weight: f32, values: &[f32], normal: Vec3| {
            let off = normal - middle;
            spread += Mat3::from_cols(weight * off.x * off, weight * off.y * off, weight * off.z * off);
            change += weight * (value_of(values) - mean) * off;
        };
        for (near, beyond) in neighbours.iter().zip(&beyond) {
            include(near.weight, near.values, near.normal);
            if let Some((values, normal)) = beyond {
                include(BEYOND_WEIGHT * near.weight, values, *normal);
            }
        }
        // No fraction changes faster than the fraction of a half space, by 1 from one normal to its opposite.
        let slope = (spread.inverse() * change).clamp_length_max(1.0);
        let level = |values: &[f32], of: Vec3| value_of(values) + slope.dot(normal - of);
        let value = average(&|near| level(near.values, near.normal));
        let range = range(&|near| level(near.values, near.normal));
        let bend = neighbours.iter().zip(&beyond).map(|(near, beyond)| {
            let (values, normal) = (*beyond)?;
            Some(near.weight * (level(near.values, near.normal) - level(values, normal)) / 8.0)
        });
        let bend = bend.sum::<Option<f32>>().filter(|_| total >= ALL);
        let is_smooth = bend.is_some_and(|bend| bend.abs() <= limits.bend && range <= limits.smooth);
        let bend = bend.unwrap_or_default().clamp(-NOTABLE, NOTABLE);
        (is_smooth || range <= limits.agree).then_some(value + bend)
    }

    /// Whether no other surface is visible within this many pixels along rows and columns: another instance, or a face
    /// of the same instance with another normal.
    fn is_alone(&self, apart: u32) -> bool {
        let (x, y) = (self.layer.x, self.y);
        let rows = &self.buffer.rows;
        let lines = y.saturating_sub(apart as usize)..(y + apart as usize + 1).min(rows.len());
        apart == 0
            || lines.into_iter().all(|line| {
                let first = rows[line].partition_point(|layer| layer.x + apart < x);
                let mut near = rows[line][first..].iter().take_while(|layer| layer.x <= x + apart);
                near.all(|other| {
                    other.instance == self.layer.instance && other.normal.dot(self.layer.normal) >= SIMILAR_NORMAL
                })
            })
    }
}

/// The weighted mean of values; false if there are too few or they differ by more than `agree`.
fn mean(neighbours: &[Neighbour<'_>], agree: f32, values: &mut [f32]) -> bool {
    let total: f32 = neighbours.iter().map(|near| near.weight).sum();
    if total < ENOUGH {
        return false;
    }
    for (i, value) in values.iter_mut().enumerate() {
        let of = |near: &Neighbour<'_>| near.values[i];
        let low = neighbours.iter().map(of).fold(f32::INFINITY, f32::min);
        let high = neighbours.iter().map(of).fold(0.0, f32::max);
        if high - low > agree {
            return false;
        }
        *value = neighbours.iter().map(|near| near.values[i] * near.weight).sum::<f32>() / total;
    }
    true
}
