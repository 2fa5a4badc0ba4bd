//! The cells of a grid that a level set passes through.
//!
//! Cell (i, j, k) lies between the voxel centres i and i + 1, j and j + 1, k and k + 1. Around the grid there is one
//! layer of *padding*: centres -1 and n, half a voxel outside the box, which are outside the solid. Their value is the
//! mirror `|d - level|` of the nearest sample of the grid, so a surface that leaves the box crosses an edge to the
//! padding exactly on the face of the box. That closes the surface: it bounds the part of the solid that lies in the
//! box.
//!
//! Memory grows with the number of crossed cells, plus one value per row of cells.

use super::patches::{face_corners, face_edges, is_ambiguous, patches};
use crate::error::Error;
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::sparse::{BRICK_CELLS, SparseView};
use crate::volume::{FieldView, Texel, Trilinear};
use rayon::prelude::*;
use std::ops::Range;

/// A cell that the surface passes through.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SurfaceCell {
    /// Indices of its lower corner, from -1 to n - 1.
    pub index: [i32; 3],
    /// Samples at the corners minus the level; negative inside.
    pub values: [f32; 8],
    /// Corners inside the solid, bit `c` for corner `c`.
    pub inside: u8,
    /// Ambiguous faces whose inside corners are joined, bit `f` for face `f`.
    pub joined: u8,
    /// Faces without crossed edges beyond which no cell is crossed, bit `f` for face `f`.
    pub free: u8,
    /// Index of its first patch among all patches.
    pub first_patch: u32,
    /// Index of the first of the crossed edges that start at its lower corner, among all crossed edges.
    pub first_edge: u32,
}

impl SurfaceCell {
    /// The cell, if the surface passes through it.
    fn new(index: [i32; 3], values: [f32; 8]) -> Option<Self> {
        let inside = values.iter().enumerate().fold(0, |bits, (c, &value)| bits | u8::from(value < 0.0) << c);
        if inside == 0 || inside == 255 {
            return None;
        }
        let joined = (0..6).filter(|&face| is_ambiguous(inside, face) && joins_inside(&values, face));
        let joined = joined.fold(0, |bits, face| bits | 1 << face);
        Some(Self { index, values, inside, joined, free: 0, first_patch: 0, first_edge: 0 })
    }

    /// Sets of edges, one for each patch.
    pub(crate) fn patches(&self) -> impl Iterator<Item = u16> + use<> {
        patches(self.inside, self.joined).iter().copied().take_while(|&patch| patch != 0)
    }

    /// The indices of its patches among all patches.
    pub(crate) fn patch_ids(&self) -> Range<u32> {
        self.first_patch..self.first_patch + self.patches().count() as u32
    }

    /// Whether the edge from the lower corner along an axis is crossed.
    pub(crate) fn owns(&self, axis: usize) -> bool {
        (self.inside ^ self.inside >> (1 << axis)) & 1 == 1
    }

    /// Index of the crossed edge from the lower corner along an axis, among all crossed edges.
    pub(crate) fn edge(&self, axis: usize) -> u32 {
        self.first_edge + (0..axis).filter(|&a| self.owns(a)).count() as u32
    }
}

/// The patches of some cells: the cell, and the index among all patches.
pub(crate) fn patches_of(cells: &[SurfaceCell]) -> impl Iterator<Item = (&SurfaceCell, u32)> {
    cells.iter().flat_map(|cell| (cell.first_patch..).zip(cell.patches()).map(move |(id, _)| (cell, id)))
}

/// The crossed edges that start at the lower corners of some cells: the cell and the axis.
pub(crate) fn edges_from(cells: &[SurfaceCell]) -> impl Iterator<Item = (&SurfaceCell, usize)> {
    cells.iter().flat_map(|cell| (0..3).filter(|&axis| cell.owns(axis)).map(move |axis| (cell, axis)))
}

/// Whether the bilinear function of an ambiguous face is inside at its saddle point (Nielson and Hamann, "The
/// Asymptotic Decider", 1991). Both cells of a face compare the same products, so they agree.
fn joins_inside(values: &[f32; 8], face: usize) -> bool {
    let [a, b, c, d] = face_corners(face).map(|corner| f64::from(values[corner]));
    let (first, second) = (a * c, b * d);
    if a < 0.0 { first > second } else { second > first }
}

/// Number of cells that one task processes.
const CHUNK: usize = 1024;

/// A level of a field. A sample within the rounding of the level counts as the level itself, which is outside:
/// otherwise rounding decides the sides of the samples of a plane through them, and its faces would cross.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Level {
    value: f32,
    rounding: f32,
}

/// Rounding of distances relative to a voxel: float32 positions in a grid of some hundred voxels.
const ROUNDING: f64 = 1.0 / (1 << 14) as f64;

impl Level {
    pub(crate) fn new(value: f32, grid: &Grid) -> Self {
        Self { value, rounding: (ROUNDING * grid.spacing().min_element()) as f32 }
    }

    /// A sample relative to the level, negative inside.
    #[inline]
    fn relative(self, sample: f32) -> f32 {
        let value = sample - self.value;
        if value.abs() <= self.rounding { 0.0 } else { value }
    }

    #[inline]
    fn is_inside(self, sample: f32) -> bool {
        sample - self.value < -self.rounding
    }
}

/// All crossed cells of a grid, sorted by z, then y, then x.
#[derive(Debug)]
pub(crate) struct SurfaceCells {
    /// Voxels along each axis.
    shape: [i32; 3],
    cells: Vec<SurfaceCell>,
    /// First cell of each row; rows are sorted by z, then y, from -1.
    rows: Vec<u32>,
    patches: u32,
    /// The cell from whose lower corner each crossed edge starts.
    owners: Vec<u32>,
}

impl SurfaceCells {
    /// The crossed cells of a stored field.
    pub(crate) fn of_field<T: Texel>(field: &FieldView<'_, T>, level: f32, progress: &Progress) -> Result<Self, Error> {
        let shape = field.grid().shape.map(|n| n as i32);
        let [nx, ny, nz] = field.grid().shape;
        progress.set_total(nz as u64 + 1);
        let (texels, scale) = (field.texels(), field.scale());
        let level = Level::new(level, field.grid());
        let row = |y: i32, z: i32| {
            let clamp = |i: i32, n: usize| (i.max(0) as usize).min(n - 1);
            let first = nx * (clamp(y, ny) + ny * clamp(z, nz));
            &texels[first..first + nx]
        };
        let bits = InsideBits::new(texels, nx, |texel: &T| level.is_inside(texel.decode(scale)));
        let slabs: Vec<Vec<SurfaceCell>> = (-1..shape[2])
            .into_par_iter()
            .map(|z| {
                let mut found = Vec::new();
                for y in -1..shape[1] {
                    let rows = [(y, z), (y + 1, z), (y, z + 1), (y + 1, z + 1)];
                    let padded = rows.map(|(y, z)| y < 0 || z < 0 || y >= shape[1] || z >= shape[2]);
                    let samples = rows.map(|(y, z)| row(y, z));
                    let numbers: [Option<usize>; 4] =
                        std::array::from_fn(|r| (!padded[r]).then(|| rows[r].0 as usize + ny * rows[r].1 as usize));
                    bits.for_each_crossed(numbers, |x| {
                        let values = std::array::from_fn(|corner| {
                            let (r, x) = (corner >> 1, x + (corner & 1) as i32);
                            let value = level.relative(samples[r][(x.max(0) as usize).min(nx - 1)].decode(scale));
                            if padded[r] || x < 0 || x >= shape[0] { value.abs() } else { value }
                        });
                        found.extend(SurfaceCell::new([x, y, z], values));
                    });
                }
                progress.advance(1).map(|()| found)
            })
            .collect::<Result<_, _>>()?;
        Ok(Self::new(shape, slabs.concat()))
    }

    /// The crossed cells of a sparse field. Coarse bricks are read at every voxel centre, so bricks of different levels
    /// have the same values on their common faces.
    pub(crate) fn of_sparse<T: Texel>(
        field: &SparseView<'_, T>,
        level: f32,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let shape = field.grid().shape.map(|n| n as i32);
        let bricks = field.bricks().map(|n| n as i32);
        let level = Level::new(level, field.grid());
        progress.set_total(bricks[2] as u64);
        let slabs: Vec<Vec<SurfaceCell>> = (0..bricks[2])
            .into_par_iter()
            .map(|z| {
                let mut found = Vec::new();
                for y in 0..bricks[1] {
                    for x in 0..bricks[0] {
                        if let Some((origin, values)) = field.voxels_of_brick([x, y, z]) {
                            found.extend(cells_of_block(shape, BRICK_CELLS, origin, &values, level));
                        }
                    }
                }
                progress.advance(1).map(|()| found)
            })
            .collect::<Result<_, _>>()?;
        Ok(Self::sorted(shape, slabs.concat()))
    }

    /// The surface through cells in any order.
    pub(crate) fn sorted(shape: [i32; 3], mut cells: Vec<SurfaceCell>) -> Self {
        // Keys are sorted first, since they are smaller than cells. A row has 33 bits at most, and x + 1 has 31.
        let key = |[x, y, z]: [i32; 3]| (row(&shape, y, z) as u64) << 31 | (x + 1) as u64;
        cells.par_sort_by_cached_key(|cell| key(cell.index));
        Self::new(shape, cells)
    }

    fn new(shape: [i32; 3], cells: Vec<SurfaceCell>) -> Self {
        let row_count = (shape[1] + 1) as usize * (shape[2] + 1) as usize;
        let mut surface =
            Self { shape, cells, rows: Vec::with_capacity(row_count + 1), patches: 0, owners: Vec::new() };
        for (i, cell) in surface.cells.iter().enumerate() {
            let row = row(&shape, cell.index[1], cell.index[2]);
            surface.rows.resize(row + 1, i as u32);
        }
        surface.rows.resize(row_count + 1, surface.cells.len() as u32);
        surface.part_doubly_joined_patches();
        let mut free = vec![0u8; surface.cells.len()];
        free.par_chunks_mut(CHUNK).zip(surface.cells.par_chunks(CHUNK)).for_each(|(free, cells)| {
            let mut search = surface.search();
            free.iter_mut().zip(cells).for_each(|(free, cell)| *free = free_faces(cell, &mut search));
        });
        for (number, (cell, free)) in surface.cells.iter_mut().zip(free).enumerate() {
            (cell.free, cell.first_patch, cell.first_edge) = (free, surface.patches, surface.owners.len() as u32);
            surface.patches += cell.patches().count() as u32;
            let edges = (0..3).filter(|&axis| cell.owns(axis)).count();
            surface.owners.extend(std::iter::repeat_n(number as u32, edges));
        }
        surface
    }

    /// Voxels along each axis.
    pub(crate) fn shape(&self) -> [i32; 3] {
        self.shape
    }

    pub(crate) fn cells(&self) -> &[SurfaceCell] {
        &self.cells
    }

    /// Number of patches, one vertex each.
    pub(crate) fn patch_count(&self) -> usize {
        self.patches as usize
    }

    /// Number of crossed edges, one quadrilateral each.
    pub(crate) fn edge_count(&self) -> usize {
        self.owners.len()
    }

    /// One value for each patch, in order. `fill` computes the values of some consecutive cells.
    pub(crate) fn for_patches<T: Copy + Send>(
        &self,
        empty: T,
        fill: impl Fn(&[SurfaceCell], &mut [T]) + Sync + Send,
    ) -> Vec<T> {
        self.for_parts(self.patch_count(), empty, |cell| cell.first_patch, fill)
    }

    /// One value for each crossed edge, in order. `fill` computes the values of some consecutive cells.
    pub(crate) fn for_edges<T: Copy + Send>(
        &self,
        empty: T,
        fill: impl Fn(&[SurfaceCell], &mut [T]) + Sync + Send,
    ) -> Vec<T> {
        self.for_parts(self.edge_count(), empty, |cell| cell.first_edge, fill)
    }

    /// `count` values. The values of a cell start at the index `first`. `fill` computes the values of some consecutive
    /// cells.
    pub(crate) fn for_parts<T: Copy + Send>(
        &self,
        count: usize,
        empty: T,
        first: impl Fn(&SurfaceCell) -> u32,
        fill: impl Fn(&[SurfaceCell], &mut [T]) + Sync + Send,
    ) -> Vec<T> {
        let mut all = vec![empty; count];
        let mut parts = Vec::with_capacity(self.cells.len().div_ceil(CHUNK));
        let mut rest = &mut all[..];
        for (start, cells) in (0..).step_by(CHUNK).zip(self.cells.chunks(CHUNK)) {
            let end = self.cells.get(start + CHUNK).map_or(count, |cell| first(cell) as usize);
            let (part, after) = rest.split_at_mut(end - first(&cells[0]) as usize);
            parts.push((cells, part));
            rest = after;
        }
        parts.into_par_iter().for_each(|(cells, part)| fill(cells, part));
        all
    }

    /// The cell of a patch.
    pub(crate) fn of_patch(&self, patch: u32) -> &SurfaceCell {
        &self.cells[self.cells.partition_point(|cell| cell.first_patch <= patch) - 1]
    }

    /// The cells of some patches, each once, in order.
    pub(crate) fn of_patches(&self, patches: impl IntoIterator<Item = u32>) -> Vec<&SurfaceCell> {
        let mut cells: Vec<&SurfaceCell> = patches.into_iter().map(|patch| self.of_patch(patch)).collect();
        cells.sort_unstable_by_key(|cell| cell.first_patch);
        cells.dedup_by_key(|cell| cell.first_patch);
        cells
    }

    /// The cell from whose lower corner a crossed edge starts, and its axis.
    pub(crate) fn of_edge(&self, edge: u32) -> (&SurfaceCell, usize) {
        let cell = &self.cells[self.owners[edge as usize] as usize];
        let mut axes = (0..3).filter(|&axis| cell.owns(axis));
        // The next cell's first edge follows after one edge for each axis that this cell owns, so the axis exists.
        (cell, axes.nth((edge - cell.first_edge) as usize).expect("the edge is one of the cell's"))
    }

    /// The crossed cell at an index.
    pub(crate) fn find(&self, index: [i32; 3]) -> Option<&SurfaceCell> {
        self.position(index).map(|i| &self.cells[i])
    }

    /// A search for the neighbours of cells.
    pub(crate) fn search(&self) -> NeighbourSearch<'_> {
        NeighbourSearch { cells: self, rows: [(usize::MAX, 0); 9] }
    }

    fn position(&self, index: [i32; 3]) -> Option<usize> {
        if index.iter().zip(&self.shape).any(|(&i, &n)| i < -1 || i >= n) {
            return None;
        }
        let row = row(&self.shape, index[1], index[2]);
        let (first, last) = (self.rows[row] as usize, self.rows[row + 1] as usize);
        self.cells[first..last].binary_search_by_key(&index[0], |cell| cell.index[0]).ok().map(|i| first + i)
    }

    /// Keeps the mesh a two-manifold. Where both segments of an ambiguous face belong to one patch in either cell, the
    /// two vertices would be joined by two edges of the mesh with the same ends, and four faces would meet there.
    /// Joining the other corners of that face instead parts the patch in both cells. Parting patches never creates
    /// another such face, so one pass over all faces suffices (the rule of R. Wenger, "Isosurfaces", 2013, for
    /// dual contouring).
    fn part_doubly_joined_patches(&mut self) {
        for i in 0..self.cells.len() {
            for axis in 0..3 {
                let face = 2 * axis + 1;
                let cell = &self.cells[i];
                if !is_ambiguous(cell.inside, face) {
                    continue;
                }
                let mut index = cell.index;
                index[axis] += 1;
                let Some(next) = self.position(index) else { continue };
                if one_patch(cell, face) && one_patch(&self.cells[next], face - 1) {
                    self.cells[i].joined ^= 1 << face;
                    self.cells[next].joined ^= 1 << (face - 1);
                }
            }
        }
    }
}

/// A search for the neighbours of cells, which takes constant time if the cells are visited in their order: each row is
/// searched from the place of its last result.
pub(crate) struct NeighbourSearch<'a> {
    cells: &'a SurfaceCells,
    /// A row and a cell of it, for each of the rows around the cell.
    rows: [(usize, usize); 9],
}

impl<'a> NeighbourSearch<'a> {
    /// The crossed cell whose index differs from the index of `cell` by -1, 0 or 1 along each axis.
    pub(crate) fn find(&mut self, cell: &SurfaceCell, step: [i32; 3]) -> Option<&'a SurfaceCell> {
        let index: [i32; 3] = std::array::from_fn(|axis| cell.index[axis] + step[axis]);
        if index.iter().zip(&self.cells.shape).any(|(&i, &n)| i < -1 || i >= n) {
            return None;
        }
        let row = row(&self.cells.shape, index[1], index[2]);
        let [first, end] = [self.cells.rows[row] as usize, self.cells.rows[row + 1] as usize];
        let (last_row, at) = &mut self.rows[(step[1] + 1 + 3 * (step[2] + 1)) as usize];
        if *last_row != row {
            (*last_row, *at) = (row, first);
        }
        let cells = &self.cells.cells;
        while *at < end && cells[*at].index[0] < index[0] {
            *at += 1;
        }
        while *at > first && cells[*at - 1].index[0] >= index[0] {
            *at -= 1;
        }
        cells[..end].get(*at).filter(|cell| cell.index[0] == index[0])
    }
}

/// The faces of a cell that have no crossed edge and beyond which no cell is crossed, one bit per face.
fn free_faces(cell: &SurfaceCell, search: &mut NeighbourSearch<'_>) -> u8 {
    let mut is_free = |face: usize| {
        let inside = face_corners(face).iter().filter(|&&corner| cell.inside >> corner & 1 == 1).count();
        let mut step = [0; 3];
        step[face / 2] = if face % 2 == 1 { 1 } else { -1 };
        inside % 4 == 0 && search.find(cell, step).is_none()
    };
    (0..6).filter(|&face| is_free(face)).fold(0, |bits, face| bits | 1 << face)
}

/// The samples inside the solid, one bit each. Bit x + 1 of a row stands for sample x, so the padding on both sides has
/// bits too; they are 0, since padding is outside.
struct InsideBits {
    words_per_row: usize,
    words: Vec<u64>,
    padding: Vec<u64>,
}

impl InsideBits {
    fn new<T: Sync>(texels: &[T], nx: usize, is_inside: impl Fn(&T) -> bool + Sync) -> Self {
        let words_per_row = (nx + 2).div_ceil(64);
        let mut words = vec![0; texels.len() / nx * words_per_row];
        words.par_chunks_mut(words_per_row).zip(texels.par_chunks(nx)).for_each(|(words, texels)| {
            for (i, texel) in texels.iter().enumerate() {
                words[(i + 1) / 64] |= u64::from(is_inside(texel)) << ((i + 1) % 64);
            }
        });
        Self { words_per_row, words, padding: vec![0; words_per_row] }
    }

    /// Calls `found` with the index along x of every crossed cell between four rows. None is a row of padding.
    fn for_each_crossed(&self, rows: [Option<usize>; 4], mut found: impl FnMut(i32)) {
        let words = self.words_per_row;
        let rows = rows.map(|row| row.map_or(&self.padding[..], |row| &self.words[row * words..(row + 1) * words]));
        let any = |word: usize| rows.iter().fold(0, |bits, row| bits | row[word]);
        let all = |word: usize| rows.iter().fold(u64::MAX, |bits, row| bits & row[word]);
        for word in 0..words {
            let is_last = word + 1 == words;
            let (next_any, next_all) = if is_last { (0, 0) } else { (any(word + 1), all(word + 1)) };
            let some = any(word) | any(word) >> 1 | next_any << 63;
            let every = all(word) & (all(word) >> 1 | next_all << 63);
            let mut crossed = some & !every;
            while crossed != 0 {
                found((word * 64) as i32 + crossed.trailing_zeros() as i32 - 1);
                crossed &= crossed - 1;
            }
        }
    }
}

/// The crossed cells of one block of samples, x fastest. It has `side`^3 cells from cell `origin` on, and
/// `(side + 1)^3` samples; a sample outside the grid repeats the nearest one of the grid.
pub(crate) fn cells_of_block(
    shape: [i32; 3],
    side: usize,
    origin: [i32; 3],
    samples: &[f32],
    level: Level,
) -> Vec<SurfaceCell> {
    let mut found = Vec::new();
    let n = side + 1;
    let inside = samples.iter().filter(|&&sample| level.is_inside(sample)).count();
    // Padding is outside, so a block that is inside everywhere may still have crossed cells at the box.
    let interior = (0..3).all(|axis| origin[axis] >= 0 && origin[axis] + (side as i32) < shape[axis]);
    if inside == 0 || (interior && inside == samples.len()) {
        return found;
    }
    for (z, y) in (0..side).flat_map(|z| (0..side).map(move |y| (z, y))) {
        let rows: [&[f32]; 4] = std::array::from_fn(|r| &samples[n * (y + (r & 1) + n * (z + (r >> 1)))..][..n]);
        let column = |x: usize| (0..4).fold(0u8, |bits, r| bits | u8::from(level.is_inside(rows[r][x])) << r);
        let mut next = column(0);
        for x in 0..side {
            let here = std::mem::replace(&mut next, column(x + 1));
            if interior && (here | next == 0 || here & next == 15) {
                continue;
            }
            let index = [0, 1, 2].map(|axis| origin[axis] + [x, y, z][axis] as i32);
            if (0..3).any(|axis| index[axis] < -1 || index[axis] >= shape[axis]) {
                continue;
            }
            let values = std::array::from_fn(|c| {
                let value = level.relative(rows[c >> 1][x + (c & 1)]);
                let at = |axis: usize| index[axis] + (c >> axis & 1) as i32;
                let padded = !interior && (0..3).any(|axis| at(axis) < 0 || at(axis) >= shape[axis]);
                if padded { value.abs() } else { value }
            });
            found.extend(SurfaceCell::new(index, values));
        }
    }
    found
}

/// Whether all four edges of an ambiguous face belong to one patch of the cell.
fn one_patch(cell: &SurfaceCell, face: usize) -> bool {
    let edges = face_edges(face).iter().fold(0u16, |bits, edge| bits | 1 << edge);
    cell.patches().any(|patch| patch & edges == edges)
}

fn row(shape: &[i32; 3], y: i32, z: i32) -> usize {
    (y + 1) as usize + (shape[1] + 1) as usize * (z + 1) as usize
}
