//! A baked field as one image of 16 bits, for files that store implicit functions.
//!
//! The sheets of the image along z, where `n` is the number of voxels of the field:
//!
//! ```text
//!   nz                the samples
//!   nz - 1, nz - 1    for each cell, the low and the high digit of the number of its block plus one, or 0
//!   5 for each row    blocks of the divided cells, 5 x 5 x 5 samples each, side by side along x, then along y
//! ```
//!
//! Only an image with divided cells has more than the samples. A texel is a whole number from 0 to 65535, which stands
//! for a value from `-reach` to `reach`, so a digit has the base 65536.

use crate::csg::tree::volume_leaf::{PART_SAMPLES, PARTS, VolumeLeaf};

const SIDE: usize = PARTS + 1;

/// Number of values of a texel.
pub(super) const DIGITS: usize = 1 << 16;

/// Where an image has its parts, in texels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layout {
    pub shape: [usize; 3],
    /// First sheets of the low digits, the high digits and the blocks.
    pub low_digits: usize,
    pub high_digits: usize,
    pub blocks: usize,
    /// Number of blocks along x and y.
    pub columns: usize,
    pub rows: usize,
}

impl Layout {
    pub(super) fn of(volume: &VolumeLeaf) -> Self {
        let [nx, ny, nz] = volume.grid().shape;
        let count = volume.divided().samples().len() / PART_SAMPLES;
        if count == 0 {
            return Self { shape: [nx, ny, nz], low_digits: nz, high_digits: nz, blocks: nz, columns: 1, rows: 1 };
        }
        let [width, height] = [nx.max(SIDE), ny.max(SIDE)];
        let (columns, rows) = (width / SIDE, height / SIDE);
        let [low_digits, high_digits, blocks] = [nz, 2 * nz - 1, 3 * nz - 2];
        let depth = blocks + SIDE * count.div_ceil(columns * rows);
        Self { shape: [width, height, depth], low_digits, high_digits, blocks, columns, rows }
    }
}

/// The largest magnitude of the samples, which the largest texel stands for.
pub(super) fn reach(volume: &VolumeLeaf) -> f32 {
    let reach = volume.distances().iter().chain(volume.divided().samples()).fold(0f32, |most, d| most.max(d.abs()));
    if reach > 0.0 { reach } else { 1.0 }
}

/// The values of the image, x fastest, and its shape.
pub(crate) fn image(volume: &VolumeLeaf) -> (Vec<f32>, [usize; 3]) {
    let divided = volume.divided();
    if divided.blocks().is_empty() {
        return (volume.distances().to_vec(), volume.grid().shape);
    }
    let (layout, reach) = (Layout::of(volume), reach(volume));
    let [width, height, depth] = layout.shape;
    let digit = |value: usize| ((value as f64 / ((DIGITS - 1) as f64 / 2.0) - 1.0) * f64::from(reach)) as f32;
    let mut values = vec![digit(0); width * height * depth];
    let place = |x: usize, y: usize, z: usize| x + width * (y + height * z);
    let [nx, ny, _] = volume.grid().shape;
    for (i, row) in volume.distances().chunks(nx).enumerate() {
        let first = place(0, i % ny, i / ny);
        values[first..first + nx].copy_from_slice(row);
    }
    for (i, &block) in divided.blocks().iter().enumerate() {
        let (x, y, z) = (i % (nx - 1), i / (nx - 1) % (ny - 1), i / (nx - 1) / (ny - 1));
        values[place(x, y, layout.low_digits + z)] = digit(block as usize % DIGITS);
        values[place(x, y, layout.high_digits + z)] = digit(block as usize / DIGITS);
    }
    for (i, row) in divided.samples().chunks(SIDE).enumerate() {
        let (block, y, z) = (i / (SIDE * SIDE), i % SIDE, i / SIDE % SIDE);
        let (column, line) = (block % layout.columns, block / layout.columns % layout.rows);
        let sheet = layout.blocks + SIDE * (block / layout.columns / layout.rows) + z;
        let first = place(SIDE * column, SIDE * line + y, sheet);
        values[first..first + SIDE].copy_from_slice(row);
    }
    (values, layout.shape)
}
