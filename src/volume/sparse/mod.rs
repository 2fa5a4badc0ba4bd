//! A sparse field: bricks of samples near the surface, a bound on the distance everywhere else.
//!
//! # Theory
//!
//! The box is divided into *bricks* of 7^3 cells. A brick has the 8^3 samples at the corners of its cells, so
//! neighbouring bricks share those on their faces and a trilinear lookup reads one brick only (Hansson-Söderlund, Evans
//! and Akenine-Möller, *Ray Tracing of Signed Distance Function Grids*, JCGT 11(3), 2022, call it a sparse brick set).
//! The index, a grid of one word per brick, locates its samples. Cell -1 of the grid is the first cell of brick 0.
//!
//! ```text
//!   samples  -1  0  1  2  3  4  5  6  7 ...     (-1 is 0 again: the outer half voxel is constant)
//!   brick 0   |--------------------|
//!   brick 1                        |-----...
//! ```
//!
//! *Near the surface*, where a sample of the brick is closer than the band or the sign changes, the samples are stored.
//! A brick of *level* `l` has cells of `2^l` voxels and covers `8^l` bricks. It replaces them if its trilinear function
//! is within the tolerance of every sample in the band that it replaces, and does not exceed the other samples
//! ([`build`]). The resolution therefore follows the detail of the mesh, as in the adaptively sampled fields of
//! Frisken, Perry, Rockwood and Jones (SIGGRAPH 2000).
//!
//! *Elsewhere* a brick stores only its sign, and bounds on the distance at its eight corners, the *nodes*. By Jensen's
//! inequality ([`super::outside`]) these give a lower bound at every point between them. The half width of the band
//! gives another one, and the larger of both is used. Rays leap over such bricks.
//!
//! # Practice
//!
//! [`SparseField`] owns the arrays, [`SparseView`] borrows them. At 512^3 the index and the nodes take 3 MB; the memory
//! of the bricks is proportional to the surface.

pub(crate) mod build;
mod follow;
#[cfg(test)]
mod tests;

use super::outside::{bound_outside, round_down, square_bound};
use super::{Cell, FieldView, Texel, Trilinear, trilinear};
use crate::error::{ArgumentError, Error};
pub(crate) use crate::gpu::constants::bricks::{BRICK_CELLS, BRICK_LEN, BRICK_SAMPLES};
use crate::gpu::constants::bricks::{BRICK_MASK, LEVEL_SHIFT, NOTHING_STORED};
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

/// The coarsest cells have a side of `1 << MAX_LEVEL` voxels.
pub(crate) const MAX_LEVEL: u32 = 2;
/// Number of bricks along the side of the region that a brick of the coarsest level covers.
pub(crate) const REGION_BRICKS: usize = 1 << MAX_LEVEL;

/// Layout of a word of the index:
///
/// ```text
/// 31 30 29                                   0
/// +-----+------------------------------------+
/// |level| index of the stored brick          |  level 0 to 2: cells of 2^level voxels
/// +-----+------------------------------------+
/// |  3  | unused                       inside|  level 3: no samples stored; bit 0 is 1 inside, 0 outside
/// +-----+------------------------------------+
/// ```
const EMPTY: u32 = NOTHING_STORED << LEVEL_SHIFT;
const EMPTY_INSIDE: u32 = EMPTY | 1;

/// Entry of a brick in the index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Entry {
    Stored { level: u32, brick: u32 },
    Empty { inside: bool },
}

impl Entry {
    pub fn from_word(word: u32) -> Self {
        match word >> LEVEL_SHIFT {
            3 => Self::Empty { inside: word & 1 == 1 },
            level => Self::Stored { level, brick: word & BRICK_MASK },
        }
    }

    pub fn to_word(self) -> u32 {
        match self {
            Self::Stored { level, brick } => level << LEVEL_SHIFT | brick,
            Self::Empty { inside: false } => EMPTY,
            Self::Empty { inside: true } => EMPTY_INSIDE,
        }
    }
}

/// A sparse field that owns its arrays.
#[derive(Debug, Clone, PartialEq)]
pub struct SparseField<T> {
    pub grid: Grid,
    /// Distance from the surface up to which samples are stored, world units.
    pub band: f32,
    /// Scale of the stored samples.
    pub scale: f32,
    /// One word per brick, x fastest.
    pub index: Vec<u32>,
    /// Distances at the corners of the bricks, or lower bounds on them, x fastest.
    pub nodes: Vec<f32>,
    /// [`BRICK_LEN`] samples per stored brick, x fastest.
    pub texels: Vec<T>,
}

impl<T: Texel> SparseField<T> {
    pub fn view(&self) -> Result<SparseView<'_, T>, Error> {
        let Self { grid, band, scale, index, nodes, texels } = self;
        SparseView::new(*grid, *band, *scale, index, nodes, texels)
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.index[..]) + size_of_val(&self.nodes[..]) + size_of_val(&self.texels[..])
    }
}

/// Number of bricks along each axis of a grid. Its cells run from -1 to n - 1.
pub(crate) fn brick_counts(grid: &Grid) -> [usize; 3] {
    grid.shape.map(|n| (n + 1).div_ceil(BRICK_CELLS))
}

/// The grid whose voxel centres are the corners of the bricks.
pub(crate) fn node_grid(grid: &Grid) -> Grid {
    let shape = brick_counts(grid).map(|bricks| bricks + 1);
    let step = grid.spacing() * BRICK_CELLS as f64;
    // Node 0 coincides with sample -1; the voxel around it begins half a step before it.
    let lower = grid.center(0, 0, 0) - grid.spacing() - 0.5 * step;
    let count = DVec3::new(shape[0] as f64, shape[1] as f64, shape[2] as f64);
    Grid { lower, upper: lower + count * step, shape }
}

/// A sparse field that borrows its arrays.
#[derive(Debug, Clone, Copy)]
pub struct SparseView<'a, T> {
    grid: Grid,
    bricks: [usize; 3],
    index: &'a [u32],
    texels: &'a [T],
    scale: f32,
    nodes: FieldView<'a>,
    /// Smallest distance of any point of an empty brick from the surface, world units.
    floor: f64,
}

impl<'a, T: Texel> SparseView<'a, T> {
    /// Checks that the arrays are consistent, including every word of the index.
    pub fn new(
        grid: Grid,
        band: f32,
        scale: f32,
        index: &'a [u32],
        nodes: &'a [f32],
        texels: &'a [T],
    ) -> Result<Self, Error> {
        let error = |argument, problem: String| Error::from(ArgumentError::new(argument, problem));
        let bricks = brick_counts(&grid);
        let count: usize = bricks.iter().product();
        if index.len() != count {
            return Err(error("index", format!("{bricks:?} bricks need {count} words, got {}", index.len())));
        }
        if !texels.len().is_multiple_of(BRICK_LEN) {
            return Err(error("bricks", format!("{} samples are no whole number of bricks", texels.len())));
        }
        let stored = texels.len() / BRICK_LEN;
        for (i, &word) in index.iter().enumerate() {
            if let Entry::Stored { brick, .. } = Entry::from_word(word)
                && brick as usize >= stored
            {
                return Err(error("index", format!("[{i}] refers to brick {brick}, there are {stored}")));
            }
        }
        if !(band.is_finite() && band > 0.0) {
            return Err(error("band", format!("must be a positive number, got {band}")));
        }
        T::ENCODING.check_scale(scale)?;
        let nodes = FieldView::new(node_grid(&grid), nodes)?;
        // A point lies within half the diagonal of a voxel of a sample, and no sample of an empty brick is in the band.
        let floor = (f64::from(band) - 0.5 * grid.spacing().length()).max(0.0);
        Ok(Self { grid, bricks, index, texels, scale, nodes, floor })
    }

    pub fn bricks(&self) -> [usize; 3] {
        self.bricks
    }

    pub fn index(&self) -> &'a [u32] {
        self.index
    }

    pub fn texels(&self) -> &'a [T] {
        self.texels
    }

    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// Distances at the corners of the bricks, x fastest.
    pub fn nodes(&self) -> &'a [f32] {
        self.nodes.distances()
    }

    /// Smallest distance of any point of an empty brick from the surface, world units.
    pub fn floor(&self) -> f64 {
        self.floor
    }

    /// The floor, the longest step between nodes, and the step along each axis as a fraction of it. Then the nodes in
    /// units of the longest step (`shaders/shared/field/bricks.wgsl`).
    pub(crate) fn for_devices(&self) -> ([f32; 5], Vec<f32>) {
        let step = self.grid.spacing() * BRICK_CELLS as f64;
        let longest = step.max_element();
        let nodes = self.nodes().iter().map(|&node| (f64::from(node) / longest) as f32).collect();
        let [x, y, z] = (step / longest).as_vec3().to_array();
        ([self.floor as f32, longest as f32, x, y, z], nodes)
    }

    /// Entry of a brick in the index.
    #[inline]
    pub fn entry(&self, [x, y, z]: [i32; 3]) -> Entry {
        let [nx, ny, _] = self.bricks;
        Entry::from_word(self.index[x as usize + nx * (y as usize + ny * z as usize)])
    }

    /// The brick that contains a cell of the grid.
    #[inline]
    fn entry_of_cell(&self, cell: IVec3) -> Entry {
        self.entry(cell.to_array().map(|i| (i + 1) / BRICK_CELLS as i32))
    }

    /// The samples of a stored brick, and their position.
    #[inline]
    pub fn brick(&self, of_brick: [i32; 3], level: u32, brick: u32) -> Brick<'a, T> {
        let start = brick as usize * BRICK_LEN;
        Brick {
            origin: brick_origin(of_brick, level),
            level,
            texels: &self.texels[start..start + BRICK_LEN],
            scale: self.scale,
        }
    }

    /// Number of stored bricks of each level, finest first.
    pub fn bricks_by_level(&self) -> [usize; MAX_LEVEL as usize + 1] {
        let mut counts = [0; MAX_LEVEL as usize + 1];
        let mut seen = vec![false; self.texels.len() / BRICK_LEN];
        for &word in self.index {
            if let Entry::Stored { level, brick } = Entry::from_word(word)
                && !std::mem::replace(&mut seen[brick as usize], true)
            {
                counts[level as usize] += 1;
            }
        }
        counts
    }

    /// The field at all voxel centres, x fastest; bounds in empty bricks.
    pub fn dense(&self, progress: &Progress) -> Result<Vec<f32>, Error> {
        let [nx, ny, nz] = self.grid.shape;
        let mut samples = allocate_samples(&format!("a field of {nx} x {ny} x {nz} samples"), self.grid.len(), 0)?;
        progress.set_total((ny * nz) as u64);
        samples.par_chunks_mut(nx).enumerate().try_for_each(|(row, samples)| {
            for (x, sample) in samples.iter_mut().enumerate() {
                let voxel = IVec3::new(x as i32, (row % ny) as i32, (row / ny) as i32);
                *sample = self.at_voxel(voxel);
            }
            progress.advance(1)
        })?;
        Ok(samples)
    }

    /// The field at the voxel centres around a brick: grid coordinates of the first one, and [`BRICK_LEN`] values, x
    /// fastest, equal to the values of [`SparseView::dense`]. Voxels outside the grid repeat the nearest voxel. None
    /// for an empty brick, unless the box cuts the solid there.
    pub fn voxels_of_brick(&self, of_brick: [i32; 3]) -> Option<([i32; 3], [f32; BRICK_LEN])> {
        let origin = brick_origin(of_brick, 0);
        let at_box =
            (0..3).any(|axis| origin[axis] < 0 || origin[axis] + BRICK_CELLS as i32 >= self.grid.shape[axis] as i32);
        match self.entry(of_brick) {
            Entry::Empty { inside } if !(inside && at_box) => return None,
            _ => {}
        }
        let last = IVec3::from(self.grid.shape.map(|n| n as i32 - 1));
        let value = |i: usize| {
            let voxel = IVec3::from(origin) + IVec3::from(sample_in_brick(i).map(|i| i as i32));
            self.at_voxel(voxel.clamp(IVec3::ZERO, last))
        };
        Some((origin, std::array::from_fn(value)))
    }

    /// The field at a voxel centre; a bound in an empty brick.
    fn at_voxel(&self, voxel: IVec3) -> f32 {
        match self.entry_of_cell(voxel) {
            Entry::Stored { .. } => self.cell(voxel).at(voxel.as_dvec3()),
            Entry::Empty { inside } => self.bound_at(voxel.as_dvec3(), inside),
        }
    }

    /// Number of samples of the grid below zero.
    pub fn count_inside(&self) -> usize {
        let [bx, by, _] = self.bricks;
        let count = |i: usize| {
            let index = [i % bx, i / bx % by, i / (bx * by)];
            // The samples that belong to this brick: its last ones are the first of the next brick.
            let first = index.map(|b| b as i32 * BRICK_CELLS as i32 - 1);
            let low = first.map(|i| i.max(0));
            let high = [0, 1, 2].map(|axis| (first[axis] + BRICK_CELLS as i32).min(self.grid.shape[axis] as i32));
            let own = |axis: usize| (high[axis] - low[axis]).max(0) as usize;
            match Entry::from_word(self.index[i]) {
                Entry::Empty { inside } => usize::from(inside) * own(0) * own(1) * own(2),
                Entry::Stored { level, brick } => {
                    let brick = self.brick(index.map(|b| b as i32), level, brick);
                    let is_inside = |p: IVec3| brick.cell(p).at(p.as_dvec3()) < 0.0;
                    let row = |y: i32, z: i32| (low[0]..high[0]).filter(|&x| is_inside(IVec3::new(x, y, z))).count();
                    (low[2]..high[2]).map(|z| (low[1]..high[1]).map(|y| row(y, z)).sum::<usize>()).sum()
                }
            }
        };
        (0..self.index.len()).into_par_iter().map(count).sum()
    }

    /// Bound on the distance at a point of an empty brick, with its sign; grid space.
    fn bound_at(&self, p_grid: DVec3, inside: bool) -> f32 {
        let p_world = self.grid.lower + (p_grid + 0.5) * self.grid.spacing();
        let bound = square_bound(&self.nodes, p_world).sqrt().max(self.floor);
        let bound = round_down(bound);
        if inside { -bound } else { bound }
    }
}

/// Position in its brick of a sample by its index, x fastest.
#[inline]
fn sample_in_brick(i: usize) -> [usize; 3] {
    [i % BRICK_SAMPLES, i / BRICK_SAMPLES % BRICK_SAMPLES, i / (BRICK_SAMPLES * BRICK_SAMPLES)]
}

/// Grid coordinates of sample 0 of the brick of a given level that covers the brick `of_brick`.
#[inline]
pub(crate) fn brick_origin(of_brick: [i32; 3], level: u32) -> [i32; 3] {
    of_brick.map(|b| (b >> level << level) * BRICK_CELLS as i32 - 1)
}

/// A stored brick.
#[derive(Debug, Clone, Copy)]
pub struct Brick<'a, T> {
    /// Grid coordinates of sample 0.
    pub origin: [i32; 3],
    pub level: u32,
    texels: &'a [T],
    scale: f32,
}

impl<T: Texel> Brick<'_, T> {
    /// The samples at the corners of a cell of the brick.
    #[inline]
    pub fn corners(&self, [x, y, z]: [i32; 3]) -> [f32; 8] {
        const Y: usize = BRICK_SAMPLES;
        const Z: usize = BRICK_SAMPLES * BRICK_SAMPLES;
        let first = x as usize + Y * y as usize + Z * z as usize;
        let d = &self.texels[first..first + Z + Y + 2];
        [d[0], d[1], d[Y], d[Y + 1], d[Z], d[Z + 1], d[Y + Z], d[Y + Z + 1]].map(|texel| texel.decode(self.scale))
    }

    /// The cell of the brick that contains a cell of the grid.
    fn cell(&self, index: IVec3) -> Cell {
        let origin = IVec3::from(self.origin);
        let local = (index - origin) >> self.level as i32;
        Cell {
            corners: self.corners(local.to_array()),
            first: origin + (local << self.level as i32),
            size: 1 << self.level,
        }
    }
}

impl<T: Texel> Trilinear for SparseView<'_, T> {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    fn cell(&self, index: IVec3) -> Cell {
        match self.entry_of_cell(index) {
            Entry::Stored { level, brick } => {
                self.brick(index.to_array().map(|i| (i + 1) / BRICK_CELLS as i32), level, brick).cell(index)
            }
            Entry::Empty { inside } => {
                let corner = |i: i32| (index + IVec3::new(i & 1, i >> 1 & 1, i >> 2)).as_dvec3();
                let corners = std::array::from_fn(|i| self.bound_at(corner(i as i32), inside));
                Cell { corners, first: index, size: 1 }
            }
        }
    }

    fn sample_linear(&self, p: DVec3) -> f32 {
        let p_grid = self.clamp_to_box(self.grid_from_world(p));
        let index = p_grid.floor().as_ivec3();
        match self.entry_of_cell(index) {
            Entry::Stored { .. } => self.cell(index).at(p_grid),
            // The trilinear function of the corner bounds would exceed the bound between the corners.
            Entry::Empty { inside } => self.bound_at(p_grid, inside),
        }
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        bound_outside(&self.nodes, p, inner)
    }
}

/// A coarser brick at a sample of a finer lattice: the value of its trilinear function at sample `at`. The finer
/// lattice has `1 << levels` steps per cell.
#[inline]
pub(crate) fn coarse_value(samples: &[f32; BRICK_LEN], at: [usize; 3], levels: u32) -> f32 {
    let steps = 1usize << levels;
    // The last sample belongs to the last cell.
    let cell = at.map(|i| (i >> levels).min(BRICK_CELLS - 1));
    let fraction = [0, 1, 2].map(|axis| (at[axis] - cell[axis] * steps) as f32 / steps as f32);
    let first = cell[0] + BRICK_SAMPLES * (cell[1] + BRICK_SAMPLES * cell[2]);
    let corner = |i: usize| samples[first + (i & 1) + BRICK_SAMPLES * ((i >> 1 & 1) + BRICK_SAMPLES * (i >> 2))];
    trilinear(&std::array::from_fn(corner), Vec3::from(fraction))
}
