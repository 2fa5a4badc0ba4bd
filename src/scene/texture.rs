//! Images on surfaces: stored as sRGB bytes, filtered in linear light.
//!
//! Each level of the pyramid is half the one below, averaged in linear light with colours weighed by their opacity. A
//! sample is bilinear in the two levels around the footprint's size and linear between them (Williams, *Pyramidal
//! parametrics*, 1983). Coordinates repeat; v runs upwards.

use crate::error::{Error, SceneError};
use glam::{Vec2, Vec4};
use std::sync::LazyLock;

/// A pyramid of RGBA texels, 8 bits sRGB and opacity, levels one after the other, rows from the top.
#[derive(Debug)]
pub struct Texture {
    pub levels: Vec<Level>,
    /// Red in the lowest byte.
    pub texels: Vec<u32>,
}

/// A picture of the pyramid.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Level {
    pub first: u32,
    pub width: u32,
    pub height: u32,
}

/// Side of a texture at most.
const MAX_SIDE: usize = 16384;

/// Linear light of every sRGB byte.
static LINEAR: LazyLock<[f32; 256]> =
    LazyLock::new(|| std::array::from_fn(|byte| linear_from_srgb(byte as f32 / 255.0)));

/// IEC 61966-2-1.
pub fn linear_from_srgb(value: f32) -> f32 {
    if value <= 0.04045 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

fn srgb_from_linear(value: f32) -> f32 {
    if value <= 0.003_130_8 { 12.92 * value } else { 1.055 * value.powf(1.0 / 2.4) - 0.055 }
}

impl Texture {
    /// `pixels` are RGBA bytes, row 0 on top.
    pub fn new(pixels: &[u8], width: usize, height: usize) -> Result<Self, Error> {
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE || pixels.len() != 4 * width * height {
            let problem = format!("expected 1 to {MAX_SIDE} pixels a side, RGBA, got {width} x {height}");
            return Err(SceneError::new("texture", problem).into());
        }
        let mut level: Vec<Vec4> =
            pixels.as_chunks::<4>().0.iter().map(|&texel| unpack(u32::from_le_bytes(texel))).collect();
        let (mut width, mut height) = (width, height);
        let mut levels = Vec::new();
        let mut texels = Vec::new();
        loop {
            levels.push(Level { first: texels.len() as u32, width: width as u32, height: height as u32 });
            texels.extend(level.iter().map(|&texel| pack(texel)));
            if width == 1 && height == 1 {
                return Ok(Self { levels, texels });
            }
            (level, width, height) = halved(&level, width, height);
        }
    }

    /// Linear RGB and opacity at `uv`; `footprint` is the side of what the pixel covers, in texture widths.
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

    fn bilinear(&self, level: Level, uv: Vec2) -> Vec4 {
        let ([a, b, c, d], f) = self.around(level, uv);
        unpack(a).lerp(unpack(b), f.x).lerp(unpack(c).lerp(unpack(d), f.x), f.y)
    }

    /// The four texels around `uv`, upper left first, row by row, and the place between them.
    fn around(&self, level: Level, uv: Vec2) -> ([u32; 4], Vec2) {
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
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let color = [texel.x, texel.y, texel.z].map(|c| byte(srgb_from_linear(c)));
    u32::from_le_bytes([color[0], color[1], color[2], byte(texel.w)])
}

/// The next smaller picture; an odd side keeps its last row or column in the mean of its neighbour.
fn halved(level: &[Vec4], width: usize, height: usize) -> (Vec<Vec4>, usize, usize) {
    let (w, h) = ((width / 2).max(1), (height / 2).max(1));
    let mut smaller = Vec::with_capacity(w * h);
    let span = |i: usize, half: usize, whole: usize| (i * whole / half, ((i + 1) * whole).div_ceil(half));
    for y in 0..h {
        let (y0, y1) = span(y, h, height);
        for x in 0..w {
            let (x0, x1) = span(x, w, width);
            let (mut light, mut plain, mut opacity, mut count) = (Vec4::ZERO, Vec4::ZERO, 0.0, 0.0);
            for texel in (y0..y1).flat_map(|y| level[y * width + x0..y * width + x1].iter()) {
                light += *texel * texel.w;
                plain += *texel;
                opacity += texel.w;
                count += 1.0;
            }
            let color = if opacity > 0.0 { light / opacity } else { plain / count };
            smaller.push(color.truncate().extend(opacity / count));
        }
    }
    (smaller, w, h)
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
    fn odd_sizes_and_bad_ones() {
        let texture = Texture::new(&[200; 4 * 5 * 3], 5, 3).unwrap();
        assert_eq!(texture.levels.iter().map(|l| (l.width, l.height)).collect::<Vec<_>>(), [(5, 3), (2, 1), (1, 1)]);
        assert!((texture.sample(Vec2::ZERO, 1.0).x - LINEAR[200]).abs() < 1e-6);
        assert!(Texture::new(&[], 0, 3).is_err());
        assert!(Texture::new(&[0; 12], 2, 2).is_err());
    }
}
