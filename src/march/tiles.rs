//! The depths between which the rays of a tile of the picture can meet a surface.
//!
//! # Theory
//!
//! Only cells with a corner that is <= 0 contain a surface ([`super::empty`]). Cubes of them are projected to the
//! picture, and each tile keeps the range of depths of the cubes that its pixels can see. The ray of a pixel begins at
//! the least depth of its tile and ends at the largest, and a tile without cubes shows the background.
//!
//! A cube is a block of cells, or a part of it if the block overlaps many tiles. Blocks are left out if all their
//! cells, and all cells of the six blocks beside them, have such a corner. A ray enters a region of such blocks through
//! a block that is full of projected cells, and leaves it through another, so its range contains the region.
//!
//! The least depths and the largest are found separately. Each search takes the blocks in the order of the rays or
//! against it, and leaves out cubes that change no tile, so a field with a surface in every block costs little more.
//!
//! The values need not be distances, as for the empty blocks.
//!
//! # Practice
//!
//! The blocks are in grid space relative to the eye, so that a far origin of the world costs no precision. They are
//! grown by a fraction of a voxel, far more than the rounding of the rays. If a block lies beside or behind the eye, or
//! so far away that rounding reaches the margin, all rays begin at the eye.

use super::blocks::{Block, Blocks, Occupancy};
use super::marcher::{Marcher, each_axis};
use crate::error::Error;
use crate::picture::Camera;
use crate::progress::Progress;
use glam::{DMat3, DVec2, DVec3, IVec3};
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// Side of a tile, pixels.
const TILE: usize = 4;

/// Largest number of tiles that a cube of cells overlaps before it is divided.
const MOST_TILES: usize = 4;

/// Margin around cubes, voxels.
const MARGIN: f64 = 1.0 / 16.0;

/// Least depth of a block before the eye, in voxels: points closer to the eye are not projected.
const NEAREST: f64 = 1.0;

/// The camera of a picture in the grid space of a field.
#[derive(Debug, Clone, Copy)]
pub struct GridCamera {
    camera: Camera,
    /// World units in a voxel along each axis of the grid, which need not be perpendicular in the world.
    world_from_grid: DMat3,
    /// Position of the camera in grid space.
    eye: DVec3,
    /// Width and height of the picture, pixels.
    size: [u32; 2],
}

impl GridCamera {
    /// `eye` is the position of the camera in grid space.
    pub(crate) fn new(camera: &Camera, world_from_grid: DMat3, eye: DVec3, size: [u32; 2]) -> Self {
        Self { camera: *camera, world_from_grid, eye, size }
    }
}

/// The range of depths of each tile, in multiples of the directions of its rays.
#[derive(Debug)]
pub struct Tiles {
    columns: usize,
    /// By rows, the row at the top first. Empty if all rays begin at the eye.
    depths: Vec<[f64; 2]>,
}

/// A tile without cubes.
const NOTHING: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

/// An end of the ranges of depths.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum End {
    Near,
    Far,
}

impl Tiles {
    pub(crate) fn new<F: Blocks>(
        marcher: &Marcher<F>,
        camera: &GridCamera,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let view = Projection::new::<F>(camera);
        let empty = marcher.empty();
        let [nx, ny, nz] = empty.shape();
        let corners = (0..8).map(|i| view.lower_corner([nx * (i & 1), ny * (i >> 1 & 1), nz * (i >> 2)]));
        if !corners.fold(true, |all, corner| all & view.is_projected(corner)) {
            return Ok(Self { columns: 0, depths: Vec::new() });
        }
        let near = view.depths(marcher, End::Near, progress)?;
        let far = view.depths(marcher, End::Far, progress)?;
        Ok(Self { columns: view.columns, depths: near.into_iter().zip(far).map(|(near, far)| [near, -far]).collect() })
    }

    /// The range of depths of a pixel; `None` if its ray meets no block.
    #[inline]
    pub(crate) fn depths(&self, x: usize, y: usize) -> Option<[f64; 2]> {
        if self.depths.is_empty() {
            return Some([0.0, f64::INFINITY]);
        }
        Some(self.depths[x / TILE + self.columns * (y / TILE)]).filter(|depths| *depths != NOTHING)
    }
}

/// Whether a block that is not empty has an empty cell, lies beside such a block, or at the boundary of the grid.
fn is_border<F: Blocks>(marcher: &Marcher<F>, index: [i32; 3]) -> bool {
    let shape = marcher.empty().shape();
    let is_full = |index: [i32; 3]| {
        marcher.empty().distance(index) == 0 && marcher.block(index).occupancy([0; 3], F::SIDE) == Occupancy::Full
    };
    let is_beside = |axis: usize| {
        let [mut before, mut after] = [index; 2];
        before[axis] -= 1;
        after[axis] += 1;
        before[axis] < 0 || after[axis] as usize == shape[axis] || !is_full(before) || !is_full(after)
    };
    !is_full(index) || (0..3).any(is_beside)
}

/// The projection of blocks and their parts to the picture. Lengths are in the longest side of a voxel.
struct Projection {
    /// Right, up and depth from grid space relative to the eye.
    view_from_grid: DMat3,
    /// Position of the camera in grid space.
    eye: DVec3,
    side: f64,
    /// Blocks, their eighths, and so on.
    cubes: Vec<Cube>,
    is_parallel: bool,
    pixels_per_unit: f64,
    size: [usize; 2],
    columns: usize,
    /// Length of the unit, world units.
    unit: f64,
    /// Largest distance from the eye at which rounding is far below the margin around cubes.
    farthest: f64,
}

/// A cube of cells in the projection, relative to its lower corner.
struct Cube {
    /// Side, voxels.
    side: i32,
    /// The corners of the cube with its margin.
    corners: [DVec3; 8],
    /// Least and largest depth of `corners`.
    reach: [f64; 2],
}

impl Cube {
    fn new(side: i32, view_from_grid: &DMat3) -> Self {
        let ends = [-MARGIN, side as f64 + MARGIN];
        let corners =
            std::array::from_fn(|i| *view_from_grid * DVec3::new(ends[i & 1], ends[i >> 1 & 1], ends[i >> 2]));
        let depths = corners.iter().map(|corner: &DVec3| corner.z);
        let reach = [depths.clone().fold(f64::INFINITY, f64::min), depths.fold(f64::NEG_INFINITY, f64::max)];
        Self { side, corners, reach }
    }
}

impl Projection {
    fn new<F: Blocks>(&GridCamera { camera, world_from_grid, eye, size }: &GridCamera) -> Self {
        let longest = |m: DMat3| m.x_axis.length().max(m.y_axis.length()).max(m.z_axis.length());
        let unit = longest(world_from_grid);
        let shortest = 1.0 / longest(world_from_grid.inverse().transpose());
        let view_from_grid = camera.view_from_world() * (world_from_grid * (1.0 / unit));
        let sides = std::iter::successors(Some(F::SIDE), |&side| (side % 2 == 0).then_some(side / 2));
        let pixel = camera.pixel_size(size[1]);
        let size = size.map(|n| n as usize);
        Self {
            view_from_grid,
            eye,
            side: F::SIDE as f64,
            cubes: sides.map(|side| Cube::new(side, &view_from_grid)).collect(),
            is_parallel: camera.is_parallel(),
            pixels_per_unit: if camera.is_parallel() { unit / pixel } else { 1.0 / pixel },
            size,
            columns: size[0].div_ceil(TILE),
            unit,
            farthest: MARGIN * shortest / unit / (16.0 * f64::EPSILON),
        }
    }

    /// The lower corner of a block. Its cells begin at -1.
    #[inline]
    fn lower_corner(&self, block: [usize; 3]) -> DVec3 {
        self.view_from_grid * (DVec3::from(block.map(|i| i as f64)) * self.side - 1.0 - self.eye)
    }

    /// Whether a block at a lower corner has a projection.
    fn is_projected(&self, corner: DVec3) -> bool {
        corner.length() <= self.farthest && (self.is_parallel || corner.z + self.cubes[0].reach[0] >= NEAREST)
    }

    /// The least depth of each tile, or the negated largest one.
    fn depths<F: Blocks>(&self, marcher: &Marcher<F>, end: End, progress: &Progress) -> Result<Vec<f64>, Error> {
        let empty = marcher.empty();
        let shape = empty.shape();
        // A ray passes through blocks in this order or against it. Blocks that come later seldom change a tile.
        let forward = [self.view_from_grid.x_axis, self.view_from_grid.y_axis, self.view_from_grid.z_axis]
            .map(|axis| (axis.z > 0.0) == (end == End::Near));
        let in_order = |axis: usize, i: usize| if forward[axis] { i } else { shape[axis] - 1 - i };
        let blank = || vec![f64::INFINITY; self.columns * self.size[1].div_ceil(TILE)];
        let pieces = (0..shape[2]).into_par_iter().with_min_len(shape[2].div_ceil(rayon::current_num_threads()));
        let parts = pieces.try_fold(blank, |mut depths, z| {
            progress.check()?;
            for (y, x) in (0..shape[1]).flat_map(|y| (0..shape[0]).map(move |x| (y, x))) {
                let block = [in_order(0, x), in_order(1, y), in_order(2, z)];
                let index = block.map(|i| i as i32);
                if empty.distance(index) == 0 && is_border(marcher, index) {
                    self.add(&marcher.block(index), self.lower_corner(block), [0; 3], 0, end, &mut depths);
                }
            }
            Ok(depths)
        });
        let join = |mut a: Vec<f64>, b: Vec<f64>| {
            a.iter_mut().zip(b).for_each(|(a, b)| *a = a.min(b));
            Ok(a)
        };
        parts.try_reduce_with(join).unwrap_or_else(|| Ok(blank()))
    }

    /// Adds the depth of a cube of cells to the tiles that it overlaps. `lower` is its lower corner, and `first` the
    /// first of its cells in the block.
    fn add<B: Block>(&self, block: &B, lower: DVec3, first: [i32; 3], level: usize, end: End, depths: &mut [f64]) {
        let cube = &self.cubes[level];
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        for offset in &cube.corners {
            let corner = lower + *offset;
            let scale = if self.is_parallel { self.pixels_per_unit } else { self.pixels_per_unit / corner.z };
            let p = scale * corner.truncate();
            (low, high) = (low.min(p), high.max(p));
        }
        // The rays of the picture pass through the centres of its pixels. Rows run downwards.
        let middle = self.size.map(|n| 0.5 * n as f64 - 0.5);
        let columns = overlap([middle[0] + low.x, middle[0] + high.x], self.size[0]);
        let rows = overlap([middle[1] - high.y, middle[1] - low.y], self.size[1]);
        let (Some(columns), Some(rows)) = (columns, rows) else { return };
        let depth = match end {
            End::Near => self.unit * (lower.z + cube.reach[0]),
            End::Far => -self.unit * (lower.z + cube.reach[1]),
        };
        let row_of = |row: usize| self.columns * row + columns.start()..=self.columns * row + columns.end();
        if !rows.clone().any(|row| depths[row_of(row)].iter().any(|known| depth < *known)) {
            return;
        }
        let is_divided = level + 1 < self.cubes.len() && columns.clone().count() * rows.clone().count() > MOST_TILES;
        if is_divided && block.occupancy(first, cube.side) == Occupancy::Mixed {
            let side = cube.side / 2;
            for i in 0..8 {
                let offset = [i & 1, i >> 1 & 1, i >> 2].map(|i| side * i);
                let first = each_axis(|axis| first[axis] + offset[axis]);
                if block.occupancy(first, side) != Occupancy::Empty {
                    let offset = self.view_from_grid * IVec3::from(offset).as_dvec3();
                    self.add(block, lower + offset, first, level + 1, end, depths);
                }
            }
            return;
        }
        for row in rows {
            depths[row_of(row)].iter_mut().for_each(|known| *known = known.min(depth));
        }
    }
}

/// The tiles along an axis of `count` pixels that an interval of positions overlaps.
#[inline]
fn overlap([low, high]: [f64; 2], count: usize) -> Option<RangeInclusive<usize>> {
    let last = (count - 1) as f64;
    if high < 0.0 || low > last {
        return None;
    }
    Some(low.max(0.0) as usize / TILE..=high.ceil().min(last) as usize / TILE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::march::bricks::MaskedBricks;
    use crate::march::marcher::clip_to_box;
    use crate::picture::Filter;
    use crate::picture::camera::tests::look_at;
    use crate::volume::sparse::build::SparseOptions;
    use crate::volume::{FieldView, Trilinear};
    use proptest::prelude::*;

    const SIZE: [u32; 2] = [37, 29];

    /// The cameras of a pose: perspective and parallel.
    fn cameras(pose: &[[f64; 4]; 4], fov_deg: f64) -> [Camera; 2] {
        [Camera::from_pose(pose, fov_deg).unwrap(), Camera::orthographic(pose, 0.1 * fov_deg).unwrap()]
    }

    /// Compares the hits of all pixels with the hits of whole rays, and returns the number of hits and of pixels whose
    /// rays are shorter.
    fn check<F: Blocks>(field: F, camera: &Camera, filter: Filter) -> [usize; 2] {
        let marcher = Marcher::new(field, &Progress::new()).unwrap();
        let field = &marcher.field;
        let spacing = field.grid().spacing();
        let eye = field.grid_from_world(camera.eye);
        let camera_in_grid = GridCamera::new(camera, DMat3::from_diagonal(spacing), eye, SIZE);
        let tiles = Tiles::new(&marcher, &camera_in_grid, &Progress::new()).unwrap();
        let [mut hits, mut shorter] = [0, 0];
        for i in 0..SIZE[0] * SIZE[1] {
            let (x, y) = (i % SIZE[0], i / SIZE[0]);
            let start = field.grid_from_world(camera.pixel_start(x, y, SIZE));
            let direction = camera.pixel_direction(x, y, SIZE) / spacing;
            let Some(clipped) = clip_to_box(start, direction, field.shape()) else { continue };
            let part = tiles.depths(x as usize, y as usize).and_then(|d| clipped.between(d, direction.length()));
            shorter += usize::from(part.is_none_or(|part| part != clipped.ray));
            let whole = marcher.trace(&clipped.ray, filter).hit;
            let hit = part.and_then(|part| marcher.trace(&part, filter).hit);
            hits += usize::from(whole.is_some());
            match (whole, hit) {
                (None, None) => {}
                (Some(a), Some(b)) => {
                    assert_eq!((a.at_start, a.face), (b.at_start, b.face));
                    // The rounding of positions and roots in cells; `t` and coordinates are below 64 voxels.
                    assert!((a.t - b.t).abs() <= 64.0 * 8.0 * f32::EPSILON, "{a:?} {b:?}");
                }
                _ => panic!("{whole:?} becomes {hit:?} at ({x}, {y})"),
            }
        }
        [hits, shorter]
    }

    proptest! {
        #[test]
        fn rays_in_tiles_have_the_hits_of_whole_rays(
            shape in prop::array::uniform3(1..28usize),
            spacing in prop::array::uniform3(0.05..1.0f64),
            cubes in prop::collection::vec((prop::array::uniform3(0..24usize), 1..28usize, -1.0..0.3f32), 1..4),
            holes in prop::collection::vec((prop::array::uniform3(0..24usize), 1..3usize, 0.1..0.9f32), 0..4),
            away in 0.0..3.0f64,
            way in prop::array::uniform3(-1.0..1.0f64),
            skew in -4e-4..4e-4f64,
            fov_deg in 10.0..150.0f64,
            offset in prop::sample::select(vec![0.0, 1e6]),
        ) {
            let lower = DVec3::splat(offset);
            let upper = lower + DVec3::from(spacing) * DVec3::from(shape.map(|n| n as f64));
            let grid = Grid::new(lower, upper, shape).unwrap();
            let mut values = vec![1.0; grid.len()];
            for (first, side, value) in cubes.into_iter().chain(holes) {
                let range = |axis: usize| {
                    let first = first[axis] % shape[axis];
                    first..(first + side).min(shape[axis])
                };
                for (x, y, z) in range(2).flat_map(|z| range(1).flat_map(move |y| range(0).map(move |x| (x, y, z)))) {
                    values[grid.offset(x, y, z)] = value;
                }
            }
            let field = FieldView::new(grid, &values).unwrap();
            let middle = 0.5 * (lower + upper);
            let way = DVec3::from(way) + 1e-3;
            let mut pose = look_at(middle + away * (upper - lower).length() * way.normalize(), middle);
            // The axes of a pose may lie at angles that are not quite right.
            for row in &mut pose[..3] {
                row[0] += skew * row[1];
                row[2] -= skew * row[0];
            }
            for camera in cameras(&pose, fov_deg) {
                for filter in [Filter::Linear, Filter::Nearest] {
                    check(field, &camera, filter);
                }
            }
        }
    }

    #[test]
    fn tiles_shorten_rays() {
        let grid = Grid::new(DVec3::splat(-1.0), DVec3::splat(1.0), [48; 3]).unwrap();
        let distances: Vec<f32> =
            (0..grid.len()).map(|i| grid.center(i % 48, i / 48 % 48, i / (48 * 48)).length() as f32 - 0.4).collect();
        let field = FieldView::new(grid, &distances).unwrap();
        for camera in cameras(&look_at(DVec3::new(1.5, 2.0, 3.0), DVec3::ZERO), 20.0) {
            let [hits, shorter] = check(field, &camera, Filter::Linear);
            assert!(hits > 50);
            let all = (0..SIZE[0] * SIZE[1]).filter(|i| {
                let start = field.grid_from_world(camera.pixel_start(i % SIZE[0], i / SIZE[0], SIZE));
                let direction = camera.pixel_direction(i % SIZE[0], i / SIZE[0], SIZE) / grid.spacing();
                clip_to_box(start, direction, field.shape()).is_some()
            });
            assert_eq!(shorter, all.count());
        }
        // Bricks of a solid block have samples only near its surface.
        let inside: Vec<f32> = distances.iter().map(|distance| distance - 0.4).collect();
        let options = SparseOptions { band: 3.0, tolerance: None };
        let dense = FieldView::new(grid, &inside).unwrap();
        let sparse = dense.to_sparse::<f32>([grid.lower, grid.upper], &options, &Progress::new()).unwrap();
        for camera in cameras(&look_at(DVec3::new(1.5, 2.0, 3.0), DVec3::ZERO), 25.0) {
            for filter in [Filter::Linear, Filter::Nearest] {
                let bricks = MaskedBricks::new(sparse.view().unwrap(), &Progress::new()).unwrap();
                let [hits, shorter] = check(bricks, &camera, filter);
                assert!(hits > 200 && shorter > 200, "{hits} {shorter}");
            }
        }
        // The eye is so far away that rays cannot begin precisely at a surface.
        let [_, parallel] = cameras(&look_at(DVec3::new(1e14, 2e14, 3e14), DVec3::ZERO), 20.0);
        assert_eq!(check(field, &parallel, Filter::Linear)[1], 0);
        // The eye is in the box.
        let [perspective, _] = cameras(&look_at(DVec3::splat(0.6), DVec3::ZERO), 30.0);
        let [hits, shorter] = check(field, &perspective, Filter::Linear);
        assert!(hits > 100);
        assert_eq!(shorter, 0);
    }
}
