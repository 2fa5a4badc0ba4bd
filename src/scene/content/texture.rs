//! Images on surfaces: stored as sRGB bytes, filtered in linear light.
//!
//! Each level of the pyramid has half the size of the one below, averaged in linear light with colours weighted by
//! their opacity. A sample is bilinear in the two levels around the footprint's size and linear between them (Williams,
//! *Pyramidal parametrics*, 1983). Coordinates repeat; v points upwards.

use crate::error::{Error, SceneError};
use glam::{Vec2, Vec4};
use rayon::prelude::*;
use std::sync::LazyLock;

/// A pyramid of RGBA texels, 8 bits sRGB and opacity, level after level, rows from the top.
#[derive(Debug)]
pub struct Texture {
    pub levels: Vec<MipLevel>,
    /// One texel per word, red in the lowest byte.
    pub texels: Vec<u32>,
}

/// A level of the pyramid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MipLevel {
    pub first: u32,
    pub width: u32,
    pub height: u32,
}

/// Largest side of a texture, texels.
const MAX_SIDE: usize = 16384;

/// Linear light of every sRGB byte.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb(byte as f32 / 255.0)));

/// IEC 61966-2-1.
pub(crate) fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Linear values at which the nearest sRGB byte changes: entry `b` lies between the bytes `b` and `b + 1`.
static STEPS: LazyLock<[f32; 255]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb((byte as f32 + 0.5) / 255.0)));

/// Intervals of [`FIRST_BYTE`]. sRGB rises by at most 12.92 * 255 = 3295 bytes per unit of light, so an interval holds
/// at most two steps.
const INTERVALS: usize = 4096;

/// Nearest sRGB byte at the lower end of each interval of linear light.
static FIRST_BYTE: LazyLock<Vec<u8>> = LazyLock::new(|| {
    (0..=INTERVALS).map(|i| STEPS.partition_point(|&step| step <= i as f32 / INTERVALS as f32) as u8).collect()
});

/// The sRGB byte nearest to a linear value.
fn srgb_byte(value: f32) -> u8 {
    let value = value.clamp(0.0, 1.0);
    let mut byte = FIRST_BYTE[(value * INTERVALS as f32) as usize];
    while byte < 255 && value >= STEPS[byte as usize] {
        byte += 1;
    }
    byte
}

impl Texture {
    /// `pixels` are RGBA bytes, row 0 on top.
    pub fn new(pixels: &[u8], width: usize, height: usize) -> Result<Self, Error> {
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE || pixels.len() != 4 * width * height {
            let problem = format!("expected 1 to {MAX_SIDE} pixels a side, RGBA, got {width} x {height}");
            return Err(SceneError::new("texture", problem).into());
        }
        // A pyramid has at most 4/3 as many texels as its base, plus one per level for odd sides.
        let mut texels = Vec::with_capacity(width * height / 3 * 4 + 64);
        texels.extend(pixels.as_chunks::<4>().0.iter().map(|&texel| u32::from_le_bytes(texel)));
        let mut levels = vec![MipLevel { first: 0, width: width as u32, height: height as u32 }];
        let mut size = [width, height];
        // Levels stay unrounded until they are stored, so rounding errors do not accumulate.
        let mut level: Vec<Vec4> = Vec::new();
        while size != [1, 1] {
            level = match levels.len() {
                1 => halved(size, |i| unpack(texels[i])),
                _ => halved(size, |i| level[i]),
            };
            size = size.map(|side| (side / 2).max(1));
            levels.push(MipLevel { first: texels.len() as u32, width: size[0] as u32, height: size[1] as u32 });
            texels.par_extend(level.par_iter().map(|&texel| pack(texel)));
        }
        Ok(Self { levels, texels })
    }

    /// Linear RGB and opacity at `uv`; `footprint` is the side of the area that the pixel covers, in texture widths.
    pub fn sample(&self, uv: Vec2, footprint: f32) -> Vec4 {
        let base = self.levels[0];
        let texels = footprint * (base.width.max(base.height)) as f32;
        let last = (self.levels.len() - 1) as f32;
        let level = if texels > 1.0 { texels.log2().min(last) } else { 0.0 };
        let low = level.floor();
        let near = self.bilinear(self.levels[low as usize], uv);
        if level == low {
            return near;
        }
        near.lerp(self.bilinear(self.levels[low as usize + 1], uv), level - low)
    }

    /// Opacity at `uv`, bilinear in the finest level.
    pub fn opacity(&self, uv: Vec2) -> f32 {
        let ([a, b, c, d], f) = self.around(self.levels[0], uv);
        let opacity = |texel: u32| (texel >> 24) as f32 / 255.0;
        let mix = |a: f32, b: f32, f: f32| a + f * (b - a);
        mix(mix(opacity(a), opacity(b), f.x), mix(opacity(c), opacity(d), f.x), f.y)
    }

    fn bilinear(&self, level: MipLevel, uv: Vec2) -> Vec4 {
        let ([a, b, c, d], f) = self.around(level, uv);
        unpack(a).lerp(unpack(b), f.x).lerp(unpack(c).lerp(unpack(d), f.x), f.y)
    }

    /// The four texels around `uv`, upper left first, row by row, and the position between them.
    fn around(&self, level: MipLevel, uv: Vec2) -> ([u32; 4], Vec2) {
        let size = Vec2::new(level.width as f32, level.height as f32);
        let wrapped = uv - uv.floor();
        let p = Vec2::new(wrapped.x, 1.0 - wrapped.y) * size - 0.5;
        let cell = p.floor();
        let f = p - cell;
        let texel = |dx: i32, dy: i32| {
            let x = (cell.x as i32 + dx).rem_euclid(level.width as i32) as u32;
            let y = (cell.y as i32 + dy).rem_euclid(level.height as i32) as u32;
            self.texels[(level.first + x + level.width * y) as usize]
        };
        ([texel(0, 0), texel(1, 0), texel(0, 1), texel(1, 1)], f)
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.texels[..])
    }
}

/// Linear RGB and opacity of a stored texel.
fn unpack(texel: u32) -> Vec4 {
    let [r, g, b, a] = texel.to_le_bytes();
    Vec4::new(LINEAR[r as usize], LINEAR[g as usize], LINEAR[b as usize], a as f32 / 255.0)
}

fn pack(texel: Vec4) -> u32 {
    let opacity = (texel.w.clamp(0.0, 1.0) * 255.0).round() as u8;
    u32::from_le_bytes([srgb_byte(texel.x), srgb_byte(texel.y), srgb_byte(texel.z), opacity])
}

/// Averages boxes of 2 x 2 texels, `texel(x + width * y)`, into a level of half the sides. If a side is odd the boxes
/// are wider by up to two texels and overlap, so that every texel counts.
fn halved([width, height]: [usize; 2], texel: impl Fn(usize) -> Vec4 + Sync) -> Vec<Vec4> {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let span = |i: usize, half: usize, whole: usize| (i * whole / half, ((i + 1) * whole).div_ceil(half));
    let mut smaller = vec![Vec4::ZERO; w * h];
    smaller.par_chunks_exact_mut(w).enumerate().for_each(|(y, row)| {
        let (y0, y1) = span(y, h, height);
        for (x, mean) in row.iter_mut().enumerate() {
            let (x0, x1) = span(x, w, width);
            let (mut light, mut plain) = (Vec4::ZERO, Vec4::ZERO);
            for y in y0..y1 {
                for x in x0..x1 {
                    let texel = texel(x + width * y);
                    light += texel * texel.w;
                    plain += texel;
                }
            }
            let count = ((x1 - x0) * (y1 - y0)) as f32;
            let color = if plain.w > 0.0 { light / plain.w } else { plain / count };
            *mean = color.truncate().extend(plain.w / count);
        }
    });
    smaller
}

#[cfg(test)]
mod tests {
    use super::*;

    fn checkers(n: usize) -> Texture {
        let pixels: Vec<u8> = (0..n * n)
            .flat_map(|i| if (i % n + i / n).is_multiple_of(2) { [255, 255, 255, 255] } else { [0, 0, 0, 255] })
            .collect();
        Texture::new(&pixels, n, n).unwrap()
    }

    #[test]
    fn texel_centres_give_the_texels_with_v_upwards() {
        let pixels: Vec<u8> = [[255, 0, 0, 255], [0, 255, 0, 128], [0, 0, 255, 255], [255, 255, 255, 0]].concat();
        let texture = Texture::new(&pixels, 2, 2).unwrap();
        assert_eq!(texture.sample(Vec2::new(0.25, 0.75), 0.0), Vec4::new(1.0, 0.0, 0.0, 1.0));
        assert_eq!(texture.sample(Vec2::new(0.75, 0.75), 0.0), Vec4::new(0.0, 1.0, 0.0, 128.0 / 255.0));
        assert_eq!(texture.sample(Vec2::new(1.25, -0.75), 0.0), Vec4::new(0.0, 0.0, 1.0, 1.0));
    }

    #[test]
    fn a_wide_footprint_sees_the_mean_light() {
        let texture = checkers(16);
        assert_eq!(texture.levels.len(), 5);
        // Half the light, to the rounding of a byte of sRGB there: its slope is about 1 / 0.9.
        for footprint in [0.25, 1.0, 10.0] {
            assert!((texture.sample(Vec2::new(0.3, 0.6), footprint).x - 0.5).abs() < 1.0 / 255.0);
        }
        let sharp = texture.sample(Vec2::new(0.5 / 16.0, 1.0 - 0.5 / 16.0), 1.0 / 16.0);
        assert_eq!(sharp.x, 1.0);
    }

    #[test]
    fn every_level_is_the_mean_light_of_its_boxes() {
        // 32 x 8 random texels with opacity: the boxes of level n are 2^n x 2^n texels.
        let mut state = 1u32;
        let mut byte = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 24) as u8
        };
        let (width, height) = (32, 8);
        let pixels: Vec<u8> = (0..4 * width * height).map(|_| byte()).collect();
        let texture = Texture::new(&pixels, width, height).unwrap();
        let linear = |byte: u8| {
            let s = f64::from(byte) / 255.0;
            if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
        };
        let srgb = |l: f64| if l <= 0.003_130_8 { 12.92 * l } else { 1.055 * l.powf(1.0 / 2.4) - 0.055 };
        for n in 1..4 {
            let level = texture.levels[n];
            let side = 1 << n;
            assert_eq!([level.width as usize, level.height as usize], [width / side, height / side]);
            for (i, j) in (0..height / side).flat_map(|j| (0..width / side).map(move |i| (i, j))) {
                let stored = texture.texels[level.first as usize + i + j * (width / side)].to_le_bytes();
                let (mut sum, mut opacity) = ([0.0f64; 3], 0.0);
                for (x, y) in (0..side).flat_map(|y| (0..side).map(move |x| (i * side + x, j * side + y))) {
                    let texel = &pixels[4 * (x + y * width)..][..4];
                    let a = f64::from(texel[3]) / 255.0;
                    opacity += a;
                    sum = std::array::from_fn(|c| sum[c] + a * linear(texel[c]));
                }
                // Rounding to a byte, and float32 sums in front of it.
                let is_near = |byte: u8, exact: f64| (f64::from(byte) - 255.0 * exact).abs() <= 0.501;
                assert!(is_near(stored[3], opacity / (side * side) as f64));
                assert!((0..3).all(|c| is_near(stored[c], srgb(sum[c] / opacity))), "level {n}, texel {i}, {j}");
            }
        }
    }

    #[test]
    fn bytes_survive_the_way_through_linear_light() {
        for (byte, &light) in LINEAR.iter().enumerate() {
            assert_eq!(usize::from(srgb_byte(light)), byte);
        }
        assert_eq!([srgb_byte(-1.0), srgb_byte(2.0)], [0, 255]);
    }

    #[test]
    fn odd_sizes_and_bad_ones() {
        let texture = Texture::new(&[200; 4 * 5 * 3], 5, 3).unwrap();
        assert_eq!(texture.levels.iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), [(5, 3), (2, 1), (1, 1)]);
        assert!((texture.sample(Vec2::ZERO, 1.0).x - LINEAR[200]).abs() < 1e-6);
        assert!(Texture::new(&[], 0, 3).is_err());
        assert!(Texture::new(&[0; 12], 2, 2).is_err());
    }
}
