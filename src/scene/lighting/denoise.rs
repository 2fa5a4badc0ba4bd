//! Removes the noise of sampled light by a filter over the pixels of a picture. Its width grows until the light changes
//! by more than its noise.
//!
//! # Theory
//!
//! Light that is sampled by random paths has noise. Each pixel has paths of its own, so the errors of neighbours
//! differ, and a mean over pixels is more precise than each of them. Where light changes, the mean has an error of its
//! own, the bias. The best width of the filter therefore depends on the noise and on the light, and it differs from
//! pixel to pixel.
//!
//! Each pixel has the light of two halves of its paths. The squared difference of the halves is four times the variance
//! of their mean, plus noise that a mean over neighbours removes. The filter fits a quadratic polynomial to the light
//! in discs of growing radii around the pixel, by weighted least squares. Its value at the pixel is a linear function
//! of the light, so the variance of the value follows from the variance of the light. The radius grows as long as the
//! intervals of all radii, [`CONFIDENCE`] standard deviations around the values, have a point in common: then the bias
//! is not much larger than the noise (intersection of confidence intervals: Goldenshluger and Nemirovski, *On spatially
//! adaptive estimation of nonparametric regression*, 1997; for images: Katkovnik, *A new method for varying adaptive
//! bandwidth selection*, IEEE Transactions on Signal Processing 47(9), 1999). An edge of a shadow ends the growth,
//! since the values on both sides differ by more than their noise. Noise ends it at some pixels too, so each pixel has
//! the median of the radii of the pixels around it.
//!
//! Two pixels share light if their surfaces belong to one instance, lie in one plane and have similar normals. The
//! emission that arrives directly and the rest of the light are filtered apart, because the first one has edges of
//! shadows and little noise, and the second one much noise and no edges.

use crate::error::Error;
use crate::progress::Progress;
use crate::scene::light::bounces::PathLight;
use crate::scene::visibility::gbuffer::{GBuffer, Layer};
use glam::{DVec3, Vec3, Vec3A, Vec4};
use rayon::prelude::*;

/// Radii of the discs, pixels.
const RADII: [f32; 4] = [1.5, 3.0, 6.0, 12.0];
/// Half the length of a confidence interval, standard deviations: of emission that arrives directly, which has edges,
/// and of the rest.
const CONFIDENCE: [f32; 2] = [1.0, 1.5];
/// The weight of a pixel falls with its squared distance, and would be 0 at this multiple of the squared radius.
const TAPER: f32 = 1.3;
/// Weights of the pulls of the linear and of the quadratic coefficients of a polynomial to 0, relative to the pixels,
/// for offsets in units of the radius.
const PULLS: [f32; 2] = [0.001, 0.003];
/// Radius of the disc in which variances are averaged, pixels.
const VARIANCE_RADIUS: f32 = 3.0;
/// Radius of the disc in which the median of the radii is taken, pixels.
const MEDIAN_RADIUS: f32 = 2.9;
/// Smallest cosine between the normals of surfaces that share light.
const LEAST_COSINE: f32 = 0.8;
/// Angle between normals that reduces the weight to 1/e, as a difference of the cosine from 1.
const NORMAL: f32 = 0.05;
/// The same of normals that are equal but for rounding.
const SAME_NORMAL: f32 = 1e-6;
/// Largest distance from the plane of a surface at which others share its light, in pixels between the two.
const OFF_PLANE: f64 = 0.5;

/// The light on a layer in two parts: the emission that arrives directly, and the rest.
#[derive(Debug, Clone, Copy)]
struct Noisy {
    light: [Vec3; 2],
    variance: [Vec3; 2],
}

impl Noisy {
    fn new(halves: &[PathLight; 2]) -> Self {
        let [a, b] = halves.map(|half| [half.emitted, half.rest]);
        let part = |k: usize| (0.5 * (a[k] + b[k]), 0.25 * (a[k] - b[k]) * (a[k] - b[k]));
        let [emitted, rest] = [part(0), part(1)];
        Self { light: [emitted.0, rest.0], variance: [emitted.1, rest.1] }
    }
}

/// Memory of the filter for each layer, bytes.
pub(crate) const LAYER_BYTES: usize = size_of::<[PathLight; 2]>()
    + size_of::<Surface>()
    + 2 * size_of::<Noisy>()
    + size_of::<Fitted>()
    + size_of::<Vec3>();

/// Filters light by the paths of all layers, which has two halves. Returns the filtered light.
pub(crate) fn filter(
    buffer: &GBuffer,
    halves: Vec<Vec<[PathLight; 2]>>,
    progress: &Progress,
) -> Result<Vec<Vec<Vec3>>, Error> {
    let firsts: Vec<Vec<u32>> = buffer.rows.par_iter().map(|row| first_layers(row, buffer.view.size[0])).collect();
    let surfaces = buffer.rows.par_iter().enumerate().map(|(y, row)| {
        let place = |layer: &Layer| buffer.view.position(layer.x, y as u32, layer.depth);
        let surface = |layer| Surface { place: place(layer), normal: layer.normal, instance: layer.instance };
        row.iter().map(surface).collect::<Vec<Surface>>()
    });
    let picture = Picture { buffer, firsts: &firsts, surfaces: &surfaces.collect::<Vec<_>>() };
    let samples: Vec<Vec<Noisy>> = halves.into_iter().map(|row| row.iter().map(Noisy::new).collect()).collect();
    let disc = Disc::new(VARIANCE_RADIUS);
    let noisy = picture.map(progress, |y, i, _| picture.with_mean_variance(&samples, &disc, y, i))?;
    drop(samples);
    let disc = Disc::new(RADII[RADII.len() - 1]);
    let fitted = picture.map(progress, |y, i, near| picture.fitted(&noisy, &disc, (y, i), near))?;
    drop(noisy);
    let disc = Disc::new(MEDIAN_RADIUS);
    picture.map(progress, |y, i, _| picture.chosen(&fitted, &disc, y, i))
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

/// The pixels of a disc, in the order of their distance.
struct Disc(Vec<Offset>);

/// The offset of a pixel from the middle of a disc, pixels.
struct Offset {
    column: i32,
    line: i32,
    squared: i32,
    /// The products of its coordinates: the terms of a polynomial of the fourth degree.
    products: [Vec4; MOMENTS],
}

impl Disc {
    fn new(radius: f32) -> Self {
        let most = radius as i32;
        let across = || -most..=most;
        let mut offsets: Vec<Offset> = across()
            .flat_map(|line| across().map(move |column| Offset::new(column, line)))
            .filter(|offset| offset.squared as f32 <= radius * radius)
            .collect();
        offsets.sort_by_key(|offset| offset.squared);
        Self(offsets)
    }
}

impl Offset {
    fn new(column: i32, line: i32) -> Self {
        let [x, y] = [column as f32, line as f32];
        let (xx, xy, yy) = (x * x, x * y, y * y);
        let products = [
            Vec4::new(1.0, x, y, xx),
            Vec4::new(xy, yy, xx * x, xx * y),
            Vec4::new(x * yy, yy * y, xx * xx, xx * xy),
            Vec4::new(xx * yy, xy * yy, yy * yy, 0.0),
        ];
        Self { column, line, squared: column * column + line * line, products }
    }
}

/// A pixel that shares light with another one.
struct Near {
    /// Index in the disc, and the squared distance.
    offset: usize,
    squared: f32,
    weight: f32,
    light: [Vec3A; 2],
}

/// The surfaces of a picture.
struct Picture<'a> {
    buffer: &'a GBuffer,
    firsts: &'a [Vec<u32>],
    surfaces: &'a [Vec<Surface>],
}

/// The surface of a layer.
struct Surface {
    /// World position.
    place: DVec3,
    normal: Vec3,
    instance: u32,
}

impl Picture<'_> {
    /// Computes a value for each layer. `value` receives its row and its index, and a buffer for its neighbours.
    fn map<T: Send>(
        &self,
        progress: &Progress,
        value: impl Fn(usize, usize, &mut Vec<Near>) -> T + Sync,
    ) -> Result<Vec<Vec<T>>, Error> {
        let rows = self.surfaces.par_iter().enumerate().map(|(y, row)| {
            progress.check()?;
            let mut near = Vec::new();
            Ok((0..row.len()).map(|i| value(y, i, &mut near)).collect())
        });
        rows.collect()
    }

    /// Calls `visit` for a layer, and for layers of the other pixels in a disc that share light with it, one for each
    /// pixel: with the index in the disc, the weight, the row and the index of the layer.
    #[inline(always)]
    fn visit(&self, disc: &Disc, y: usize, i: usize, mut visit: impl FnMut(usize, f32, usize, usize)) {
        let layer = &self.buffer.rows[y][i];
        let own = &self.surfaces[y][i];
        let normal = own.normal.as_dvec3();
        let reach = OFF_PLANE * self.buffer.view.pixel_size_at(layer.depth);
        let [width, height] = [self.buffer.view.size[0] as i32, self.firsts.len() as i32];
        visit(0, 1.0, y, i);
        for (number, &Offset { column, line, .. }) in disc.0.iter().enumerate().skip(1) {
            let apart = f64::from(column.abs().max(line.abs()));
            let (column, line) = (layer.x as i32 + column, y as i32 + line);
            if column < 0 || line < 0 || column >= width || line >= height {
                continue;
            }
            let (column, line) = (column as usize, line as usize);
            let firsts = &self.firsts[line];
            for k in firsts[column] as usize..firsts[column + 1] as usize {
                let other = &self.surfaces[line][k];
                let cosine = other.normal.dot(own.normal);
                if other.instance == own.instance
                    && cosine >= LEAST_COSINE
                    && normal.dot(other.place - own.place).abs() <= reach * apart
                {
                    let turned = 1.0 - cosine;
                    let weight = if turned < SAME_NORMAL { 1.0 } else { (-turned / NORMAL).exp() };
                    visit(number, weight, line, k);
                    break;
                }
            }
        }
    }

    /// The light on a layer with the mean of the variances around it.
    fn with_mean_variance(&self, noisy: &[Vec<Noisy>], disc: &Disc, y: usize, i: usize) -> Noisy {
        let (mut sum, mut total) = ([Vec3::ZERO; 2], 0.0);
        self.visit(disc, y, i, |_, weight, line, k| {
            let variance = noisy[line][k].variance;
            sum = [0, 1].map(|part| sum[part] + weight * variance[part]);
            total += weight;
        });
        Noisy { light: noisy[y][i].light, variance: sum.map(|sum| sum / total) }
    }

    /// The values of all fits at a layer, and the largest radii with a small bias.
    fn fitted(&self, noisy: &[Vec<Noisy>], disc: &Disc, (y, i): (usize, usize), near: &mut Vec<Near>) -> Fitted {
        near.clear();
        self.visit(disc, y, i, |offset, weight, line, k| {
            let light = noisy[line][k].light.map(Vec3A::from);
            near.push(Near { offset, squared: disc.0[offset].squared as f32, weight, light });
        });
        let Noisy { light, variance } = noisy[y][i];
        let halves = [0, 1].map(|part| CONFIDENCE[part] * variance[part].map(f32::sqrt));
        let mut values = [light; RADII.len() + 1];
        let mut intervals = [0, 1].map(|part| Interval::new(light[part], halves[part]));
        for (values, radius) in values[1..].iter_mut().zip(RADII) {
            let within = near.partition_point(|near| near.squared <= radius * radius);
            let variance;
            (*values, variance) = Fit::new(disc, &near[..within], radius).at_center();
            for (part, interval) in intervals.iter_mut().enumerate() {
                interval.narrow(values[part], variance.sqrt() * halves[part]);
            }
        }
        Fitted { values, radius: intervals.map(|interval| interval.count) }
    }

    /// The light on a layer, by the median of the radii of the layers in a disc.
    fn chosen(&self, fitted: &[Vec<Fitted>], disc: &Disc, y: usize, i: usize) -> Vec3 {
        let mut counts = [[0; RADII.len() + 1]; 2];
        let mut layers = 0;
        self.visit(disc, y, i, |_, _, line, k| {
            for (counts, radius) in counts.iter_mut().zip(fitted[line][k].radius) {
                counts[radius] += 1;
            }
            layers += 1;
        });
        let values = &fitted[y][i].values;
        let parts = [0, 1].map(|part| {
            let mut below = 0;
            let radius = counts[part].iter().position(|count| {
                below += count;
                2 * below > layers
            });
            values[radius.unwrap_or(0)][part].max(Vec3::ZERO)
        });
        parts[0] + parts[1]
    }
}

/// The values of the fits at a layer.
struct Fitted {
    /// Both parts of the light: of the pixel alone, then of each radius.
    values: [[Vec3; 2]; RADII.len() + 1],
    /// Index of the largest radius with a small bias, for both parts.
    radius: [usize; 2],
}

/// The values that lie in the confidence intervals of all radii so far.
struct Interval {
    lower: Vec3,
    upper: Vec3,
    /// Number of radii, without the pixel alone.
    count: usize,
    is_final: bool,
}

impl Interval {
    /// The interval of half the length `half` around the light of a pixel.
    fn new(light: Vec3, half: Vec3) -> Self {
        Self { lower: light - half, upper: light + half, count: 0, is_final: false }
    }

    /// Adds the interval of a radius, unless it has no point in common with the others.
    fn narrow(&mut self, value: Vec3, half: Vec3) {
        (self.lower, self.upper) = (self.lower.max(value - half), self.upper.min(value + half));
        self.is_final |= !self.lower.cmple(self.upper).all();
        self.count += usize::from(!self.is_final);
    }
}

/// Number of terms of a quadratic polynomial in two variables, and of vectors for the terms up to the fourth degree.
const TERMS: usize = 6;
const MOMENTS: usize = 4;
/// Index of the product of two terms `1, x, y, xx, xy, yy` in the terms `1, x, y, xx, xy, yy, xxx, ...`.
const PRODUCTS: [[usize; TERMS]; TERMS] = [
    [0, 1, 2, 3, 4, 5],
    [1, 3, 4, 6, 7, 8],
    [2, 4, 5, 7, 8, 9],
    [3, 6, 7, 10, 11, 12],
    [4, 7, 8, 11, 12, 13],
    [5, 8, 9, 12, 13, 14],
];
/// Degrees of the terms.
const DEGREES: [i32; TERMS] = [0, 1, 1, 2, 2, 2];

/// Weighted sums over pixels for the quadratic polynomial that is nearest to their light.
struct Fit {
    radius: f32,
    moments: [Vec4; MOMENTS],
    /// The moments with squared weights.
    squares: [Vec4; MOMENTS],
    /// The light times each term.
    right: [[Vec3A; 2]; TERMS],
}

impl Fit {
    fn new(disc: &Disc, near: &[Near], radius: f32) -> Self {
        let (mut moments, mut squares) = ([Vec4::ZERO; MOMENTS], [Vec4::ZERO; MOMENTS]);
        let mut right = [[Vec3A::ZERO; 2]; TERMS];
        let slope = 1.0 / (TAPER * radius * radius);
        for near in near {
            let weight = near.weight * (1.0 - slope * near.squared);
            let products = &disc.0[near.offset].products;
            for ((moment, square), &product) in moments.iter_mut().zip(&mut squares).zip(products) {
                let weighted = weight * product;
                *moment += weighted;
                *square += weight * weighted;
            }
            let [a, b] = near.light.map(|light| weight * light);
            let [first, second] = [products[0], products[1]];
            let terms = [1.0, first.y, first.z, first.w, second.x, second.y];
            for (right, term) in right.iter_mut().zip(terms) {
                right[0] += term * a;
                right[1] += term * b;
            }
        }
        Self { radius, moments, squares, right }
    }

    /// Both parts of the light at the centre, and the variance relative to the variance of a pixel.
    fn at_center(&self) -> ([Vec3; 2], f32) {
        let total = self.moments[0].x;
        // In units of the radius all products are about 1.
        let scales = DEGREES.map(|degree| self.radius.powi(-degree));
        let matrix_of = |sums: &[Vec4; MOMENTS]| -> [[f32; TERMS]; TERMS] {
            std::array::from_fn(|a| {
                std::array::from_fn(|b| {
                    let product = PRODUCTS[a][b];
                    sums[product / 4][product % 4] * scales[a] * scales[b] / total
                })
            })
        };
        let mut matrix = matrix_of(&self.moments);
        for (term, row) in matrix.iter_mut().enumerate().skip(1) {
            row[term] += PULLS[usize::from(term > 2)];
        }
        let shares = first_of_inverse(matrix);
        let mut values = [Vec3A::ZERO; 2];
        for ((share, scale), right) in shares.iter().zip(scales).zip(&self.right) {
            values = [0, 1].map(|part| values[part] + share * scale / total * right[part]);
        }
        let spread =
            matrix_of(&self.squares).map(|row| row.iter().zip(shares).map(|(x, share)| x * share).sum::<f32>());
        let variance = spread.iter().zip(shares).map(|(spread, share)| spread * share).sum::<f32>() / total;
        (values.map(Vec3::from), variance.max(0.0))
    }
}

/// The first row of the inverse of a positive definite matrix, by Gaussian elimination from the last row.
fn first_of_inverse(mut matrix: [[f32; TERMS]; TERMS]) -> [f32; TERMS] {
    // Elimination upwards leaves the first equation with one unknown; the others follow from it.
    for pivot in (1..TERMS).rev() {
        let lower = matrix[pivot];
        for row in &mut matrix[..pivot] {
            let factor = row[pivot] / lower[pivot];
            row.iter_mut().zip(lower).take(pivot + 1).for_each(|(value, below)| *value -= factor * below);
        }
    }
    let mut found = [0.0; TERMS];
    for term in 0..TERMS {
        let lower: f32 = (0..term).map(|k| matrix[term][k] * found[k]).sum();
        found[term] = (f32::from(u8::from(term == 0)) - lower) / matrix[term][term];
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pixels of a half disc of the radius 6 with this light, of the weight 1.
    fn half_disc(disc: &Disc, light: impl Fn(f32, f32) -> f32) -> Vec<Near> {
        let right = disc.0.iter().enumerate().filter(|(_, offset)| offset.column >= 0);
        right
            .map(|(number, offset)| {
                let value = Vec3A::splat(light(offset.column as f32, offset.line as f32));
                Near { offset: number, squared: offset.squared as f32, weight: 1.0, light: [value, 2.0 * value] }
            })
            .collect()
    }

    #[test]
    fn a_fit_to_pixels_on_one_side_is_the_polynomial_at_the_centre() {
        let disc = Disc::new(6.0);
        let near = half_disc(&disc, |x, y| 3.0 + 0.2 * x - 0.1 * y + 0.01 * (x * x - x * y + 2.0 * y * y));
        let ([first, second], variance) = Fit::new(&disc, &near, 6.0).at_center();
        let mean = near.iter().map(|near| near.light[0].x).sum::<f32>() / near.len() as f32;
        // The pulls are a thousandth of the pixels, whose squared coordinates have means of 1/6 and more.
        assert!((first.x - 3.0).abs() <= 0.1 * (mean - 3.0).abs(), "{first} {mean}");
        assert!((second - 2.0 * first).abs().max_element() <= 1e-5);
        // No fit has less noise than the mean, and the pixel alone is a worse fit.
        assert!(variance >= 1.0 / near.len() as f32 && variance <= 1.0, "{variance}");
    }

    #[test]
    fn the_variance_of_a_fit_is_the_sum_of_its_squared_shares() {
        let disc = Disc::new(6.0);
        let near = |k: usize| {
            half_disc(&disc, |x, y| f32::from(u8::from(disc.0[k].column as f32 == x && disc.0[k].line as f32 == y)))
        };
        let shares = (0..disc.0.len()).map(|k| Fit::new(&disc, &near(k), 6.0).at_center().0[0].x);
        let expected: f32 = shares.map(|share| share * share).sum();
        let (_, variance) = Fit::new(&disc, &near(0), 6.0).at_center();
        assert!((variance / expected - 1.0).abs() <= 1e-3, "{variance} {expected}");
    }

    #[test]
    fn an_interval_ends_where_values_differ_by_more_than_their_noise() {
        let half = Vec3::splat(0.5);
        let mut interval = Interval::new(Vec3::splat(1.0), half);
        interval.narrow(Vec3::splat(1.4), 0.5 * half);
        interval.narrow(Vec3::new(1.4, 1.4, 2.0), 0.1 * half);
        interval.narrow(Vec3::splat(1.4), 0.1 * half);
        assert_eq!(interval.count, 1);
    }
}
