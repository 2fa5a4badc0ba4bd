//! Removes the noise of sampled light: an edge-aware filter over the pixels of a picture.
//!
//! # Theory
//!
//! Light that is sampled by random paths has noise. Each evaluated pixel has paths of its own, so the errors of
//! neighbours differ, and their mean is more precise than each of them. The filter is the à-trous wavelet
//! transform with edge-stopping weights (Dammertz et al., *Edge-avoiding à-trous wavelet transform for fast global
//! illumination filtering*, HPG 2010): repeated sums over 5 x 5 pixels whose distance doubles from one to the next.
//!
//! Two pixels share light if their surfaces belong to one instance, lie in one plane and have similar normals, and if a
//! guide has similar values there. The guide is the same light by fewer paths, which have the same directions at all
//! pixels. It has errors too, but they change slowly from pixel to pixel, so it shows where light really changes: at
//! contacts, and at the edges of shadows.
//!
//! Only some pixels are evaluated. The sums are normalised convolutions: a pixel without a value has the weight 0, and
//! obtains one from its neighbours (Knutsson and Westin, CVPR 1993). A sum takes the value of the linear function
//! nearest to the pixels, since a mean is displaced where they lie on one side, as at the end of a surface. The weight
//! of a value is the number of evaluated pixels that it has the precision of. A sum replaces only the part of a value
//! that reduces its error to [`PRECISE`] of the light, by the noise of the picture, so places with many evaluated
//! pixels keep their detail.
//!
//! A mean over pixels flattens peaks of light. The filter is therefore applied a second time to what it has removed,
//! and the result is added (twicing: Tukey, *Exploratory data analysis*, 1977).

use super::light_buffer::LightBuffer;
use crate::error::Error;
use crate::progress::Progress;
use crate::scene::visibility::gbuffer::{GBuffer, Layer};
use glam::{Mat3, Vec2, Vec3};
use rayon::prelude::*;

/// Number of sums. The pixels of the last one are 32 apart at most.
const SUMS: u32 = 5;
/// Weights of the five pixels of a row or column: a cubic B-spline.
const SPLINE: [f32; 3] = [3.0 / 8.0, 1.0 / 4.0, 1.0 / 16.0];
/// Relative error of light that is precise enough. One step of an 8-bit sRGB value at white is 0.9 %.
const PRECISE: f32 = 1.0 / 128.0;
/// Smallest level of light to which the noise is relative, in units of the smallest level for differences.
const DARK: f32 = 1.0 / 16.0;
/// Largest distance of two evaluated pixels in a row whose difference shows the noise.
const NEIGHBOURS: u32 = 8;
/// Ratio of the standard deviation of a normal distribution to the median of its magnitude.
const DEVIATION_OF_MEDIAN: f32 = 1.4826;
/// Relative difference of two values of the guide that reduces their weight to 1/e.
const GUIDE: f32 = 0.15;
/// Smallest cosine between the normals of surfaces that share light.
const LEAST_COSINE: f32 = 0.8;
/// Angle between normals that reduces the weight to 1/e, as a difference of the cosine from 1.
const NORMAL: f32 = 0.005;
/// Weight of the pull of the slopes of light to 0, relative to the pixels, for offsets in steps of a sum.
const SLOPE_PULL: f32 = 0.02;
/// Largest distance from the plane of a surface at which others share its light, in pixels between the two.
const OFF_PLANE: f64 = 0.5;

/// Light on the layers of a row: RGB, and the number of evaluated pixels that each value has the precision of.
type Row = Vec<(Vec3, f32)>;

/// Filters the light of evaluated pixels, those that are known in `own`. `guide` has light on all layers. `unit` is the
/// smallest level of light to which differences are relative. Returns filtered light on all layers.
pub(crate) fn filter(
    buffer: &GBuffer,
    guide: &LightBuffer,
    mut own: LightBuffer,
    unit: f32,
    progress: &Progress,
) -> Result<LightBuffer, Error> {
    let firsts: Vec<Vec<u32>> = buffer.rows.par_iter().map(|row| first_layers(row, buffer.view.size[0])).collect();
    let evaluated: Vec<Row> = own
        .rows
        .iter()
        .map(|row| {
            let values = row.values.as_chunks::<3>().0.iter().zip(&row.is_evaluated);
            values.map(|(value, &known)| (Vec3::from_array(*value), f32::from(u8::from(known)))).collect()
        })
        .collect();
    let enough = (noise(buffer, guide, &evaluated, unit) / PRECISE).powi(2).max(1.0);
    let picture = Picture { buffer, firsts: &firsts, guide, unit, enough };
    let mut light = picture.sums(evaluated.clone(), progress)?;
    let rest = evaluated
        .iter()
        .zip(&light)
        .map(|(row, light)| row.iter().zip(light).map(|(&(value, count), &(mean, _))| (value - mean, count)).collect());
    let rest = picture.sums(rest.collect(), progress)?;
    for (row, rest) in light.iter_mut().zip(rest) {
        row.iter_mut().zip(rest).for_each(|((value, _), (rest, _))| *value += rest);
    }
    for ((row, light), guide) in own.rows.iter_mut().zip(light).zip(&guide.rows) {
        for (i, (value, count)) in light.into_iter().enumerate() {
            let value = if count > 0.0 { value } else { Vec3::from_slice(&guide.values[3 * i..][..3]) };
            row.values[3 * i..][..3].copy_from_slice(&value.to_array());
            row.is_evaluated[i] = true;
        }
    }
    Ok(own)
}

/// The relative standard deviation of evaluated light. The light and the guide change alike from a pixel to the next
/// one, so the differences of their difference are noise.
fn noise(buffer: &GBuffer, guide: &LightBuffer, evaluated: &[Row], unit: f32) -> f32 {
    let rows = buffer.rows.par_iter().zip(evaluated).enumerate();
    let mut differences: Vec<f32> = rows
        .flat_map_iter(|(y, (layers, values))| {
            let mut before: Option<(u32, u32, f32)> = None;
            layers.iter().zip(values).enumerate().filter_map(move |(i, (layer, &(value, count)))| {
                if count == 0.0 {
                    return None;
                }
                let level = Vec3::from_slice(guide.values_at(y, i).0);
                let off = (value - level).element_sum() / (3.0 * DARK * unit).max(level.element_sum());
                let last = before.replace((layer.x, layer.instance, off));
                let (_, _, other) =
                    last.filter(|&(x, instance, _)| instance == layer.instance && layer.x.abs_diff(x) <= NEIGHBOURS)?;
                Some((off - other).abs())
            })
        })
        .collect();
    if differences.is_empty() {
        return 0.0;
    }
    let middle = differences.len() / 2;
    let (_, median, _) = differences.select_nth_unstable_by(middle, f32::total_cmp);
    *median * DEVIATION_OF_MEDIAN / std::f32::consts::SQRT_2
}

/// Index of the first layer of each pixel of a row, and the number of layers.
fn first_layers(row: &[Layer], width: u32) -> Vec<u32> {
    let mut firsts = Vec::with_capacity(width as usize + 1);
    let mut next = 0;
    for x in 0..=width {
        while row.get(next).is_some_and(|layer| layer.x < x) {
            next += 1;
        }
        firsts.push(next as u32);
    }
    firsts
}

/// The surfaces of a picture and its guide.
struct Picture<'a> {
    buffer: &'a GBuffer,
    firsts: &'a [Vec<u32>],
    guide: &'a LightBuffer,
    /// Smallest level of light to which differences are relative.
    unit: f32,
    /// Number of evaluated pixels whose mean is precise enough.
    enough: f32,
}

impl Picture<'_> {
    /// All sums of the light on the layers.
    fn sums(&self, mut light: Vec<Row>, progress: &Progress) -> Result<Vec<Row>, Error> {
        for sum in 0..SUMS {
            light = (0..light.len())
                .into_par_iter()
                .map(|y| {
                    progress.check()?;
                    Ok((0..light[y].len()).map(|i| self.sum(&light, y, i, 1 << sum)).collect())
                })
                .collect::<Result<_, Error>>()?;
        }
        Ok(light)
    }

    /// The value at layer `i` of row `y` of the linear function nearest to 5 x 5 pixels around it, which are `apart`
    /// from each other.
    fn sum(&self, light: &[Row], y: usize, i: usize, apart: i32) -> (Vec3, f32) {
        let own = light[y][i];
        if own.1 >= self.enough {
            return own;
        }
        let view = &self.buffer.view;
        let layer = &self.buffer.rows[y][i];
        let p = view.position(layer.x, y as u32, layer.depth);
        let pixel = view.pixel_size_at(layer.depth);
        let level = Vec3::from_slice(self.guide.values_at(y, i).0);
        let mut fit = LinearFit::new();
        for dy in -2..=2i32 {
            let line = y as i32 + dy * apart;
            let Some(firsts) = usize::try_from(line).ok().and_then(|line| self.firsts.get(line)) else { continue };
            let line = line as usize;
            for dx in -2..=2i32 {
                let column = layer.x as i32 + dx * apart;
                if column < 0 || column >= view.size[0] as i32 {
                    continue;
                }
                let column = column as usize;
                for k in firsts[column] as usize..firsts[column + 1] as usize {
                    let (value, count) = light[line][k];
                    let other = &self.buffer.rows[line][k];
                    let cosine = other.normal.dot(layer.normal);
                    if count == 0.0 || other.instance != layer.instance || cosine < LEAST_COSINE {
                        continue;
                    }
                    let off = view.position(other.x, line as u32, other.depth) - p;
                    let reach = OFF_PLANE * pixel * f64::from(apart * dx.abs().max(dy.abs())).max(1.0);
                    if layer.normal.as_dvec3().dot(off).abs() > reach {
                        continue;
                    }
                    let other_level = Vec3::from_slice(self.guide.values_at(line, k).0);
                    let brightest = level.max(other_level).max_element().max(self.unit);
                    let change = (other_level - level).abs().max_element() / (GUIDE * brightest);
                    let weight = SPLINE[dx.unsigned_abs() as usize]
                        * SPLINE[dy.unsigned_abs() as usize]
                        * (-change * change - (1.0 - cosine) / NORMAL).exp();
                    fit.add(Vec2::new(dx as f32, dy as f32), weight, count, value);
                    break;
                }
            }
        }
        let (value, count) = fit.at_center();
        if count <= own.1 {
            return own;
        }
        // The part of the sum that reduces the error of the value to the error of the mean of enough pixels.
        let part = ((1.0 - (own.1 / self.enough).sqrt()) / (1.0 - (own.1 / count).sqrt())).min(1.0);
        (own.0.lerp(value, part), count.min(self.enough))
    }
}

/// Weighted sums over pixels for the linear function that is nearest to their values.
struct LinearFit {
    /// The normal equations for the value at the centre and the slopes along both axes.
    matrix: Mat3,
    right: [Vec3; 3],
    /// Sums of squared weights, times the same products as in the matrix.
    squares: Mat3,
    /// The range of the values.
    lower: Vec3,
    upper: Vec3,
}

impl LinearFit {
    fn new() -> Self {
        let (lower, upper) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        Self { matrix: Mat3::ZERO, right: [Vec3::ZERO; 3], squares: Mat3::ZERO, lower, upper }
    }

    /// Adds a pixel at an offset from the centre, whose value has the precision of `count` evaluated pixels.
    fn add(&mut self, offset: Vec2, weight: f32, count: f32, value: Vec3) {
        let row = Vec3::new(1.0, offset.x, offset.y);
        let products = Mat3::from_cols(row, row * offset.x, row * offset.y);
        self.matrix += products * (weight * count);
        self.squares += products * (weight * weight * count);
        (self.lower, self.upper) = (self.lower.min(value), self.upper.max(value));
        let value = weight * count * value;
        self.right = [self.right[0] + value, self.right[1] + value * offset.x, self.right[2] + value * offset.y];
    }

    /// The value at the centre, and the number of evaluated pixels that it has the precision of.
    fn at_center(&self) -> (Vec3, f32) {
        let total = self.matrix.x_axis.x;
        if total <= 0.0 {
            return (Vec3::ZERO, 0.0);
        }
        // A small pull of the slopes to 0 determines them where the pixels lie on a line.
        let pull = Mat3::from_diagonal(SLOPE_PULL * total * Vec3::new(0.0, 1.0, 1.0));
        let shares = ((self.matrix + pull) * (1.0 / total)).inverse().x_axis / total;
        let value = self.right[0] * shares.x + self.right[1] * shares.y + self.right[2] * shares.z;
        // A function through pixels on one side may leave their range.
        (value.clamp(self.lower, self.upper), 1.0 / shares.dot(self.squares * shares))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_to_pixels_on_one_side_is_the_linear_function_at_the_centre() {
        let value = |offset: Vec2| Vec3::new(2.0, 3.0, 5.0) + Vec3::new(0.1, -0.2, 0.3) * offset.x + 0.2 * offset.y;
        let (mut fit, mut mean) = (LinearFit::new(), Vec3::ZERO);
        for i in 0..15 {
            let offset = Vec2::new((i % 3) as f32, (i / 3) as f32 - 2.0);
            fit.add(offset, 1.0, 1.0, value(offset));
            mean += value(offset) / 15.0;
        }
        let (found, count) = fit.at_center();
        // The pull leaves a part of the error of the mean: of the slope along x, whose variance is 2/3.
        let left = SLOPE_PULL / (2.0 / 3.0 + SLOPE_PULL);
        assert!((found - value(Vec2::ZERO)).abs().max_element() <= 2.0 * left * 0.3);
        assert!(
            (found - value(Vec2::ZERO)).abs().max_element() <= 0.1 * (mean - value(Vec2::ZERO)).abs().max_element()
        );
        // The variance at an end of three equal steps is 1/3 + 1/2, and there are five rows of them.
        let expected = 5.0 / (1.0 / 3.0 + 1.0 / 2.0);
        assert!((count / expected - 1.0).abs() <= 0.1, "{count}");
    }

    #[test]
    fn a_fit_has_the_precision_of_all_pixels_around() {
        let mut fit = LinearFit::new();
        for i in 0..25 {
            fit.add(Vec2::new((i % 5) as f32 - 2.0, (i / 5) as f32 - 2.0), 1.0, 2.0, Vec3::splat((i % 2) as f32));
        }
        let (found, count) = fit.at_center();
        assert!((found.x - 12.0 / 25.0).abs() <= 1e-6 && (count - 50.0).abs() <= 1e-3);
    }
}
