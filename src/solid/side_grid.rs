//! The sides of the cells of a grid that no face enters.
//!
//! *Theory.* The winding number of a closed surface is constant along every path that does not meet a face. All points
//! of a cell without faces are therefore on the same side of the surface, and so are the points of all such cells that
//! are connected through their boundaries. One point decides a whole region. If caps close the openings of the mesh, a
//! cell also has to lie in a ball without caps where the fraction of the openings has one nearest integer
//! ([`Openings::is_uniform_within`]).
//!
//! A cell counts as entered if the box and the plane of a face meet it. It may then be free of faces, which costs time
//! but changes no side. The index of a cell is a monotonic function of each coordinate, rounding included, so every
//! point of a face has an index between the indices of the corners of its box.

use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignRule;
use crate::sign::openings::Openings;
use glam::{DVec3, UVec3};
use rayon::prelude::*;
use std::collections::VecDeque;

/// Points for each cell. More cells leave fewer points in entered cells, but have a cost of their own.
const POINTS_PER_CELL: usize = 2;

/// Fewest points for a grid.
const LEAST_POINTS: usize = 32_768;

/// Largest number of faces for each point.
const FACES_PER_POINT: usize = 2;

/// Largest number of cells. They take 4 MB, and 16 MB more while their sides are decided.
const MOST_CELLS: f64 = 4_194_304.0;

/// Largest number of comparisons of cells with faces: for each cell, and for each face. Many large faces have a higher
/// cost than rays.
const COMPARISONS: (usize, usize) = (8, 8);

/// At most one block of cells is compared with the openings for this many cells.
const CELLS_PER_BLOCK: usize = 4;

/// Margin around the bounds of the mesh, and the least extent of the grid, relative to the largest extent.
const MARGIN: f64 = 1e-3;

/// Relative margin for the rounding of the distance between a cell and a plane.
const ROUNDING: f64 = 1e-6;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Cell {
    /// No face enters it; the side is not known yet.
    Free,
    Entered,
    Outside,
    Inside,
}

/// A grid around a mesh, local units. See the description of the module.
#[derive(Debug)]
pub(crate) struct SideGrid {
    lower: DVec3,
    cells_per_unit: DVec3,
    shape: UVec3,
    /// x fastest.
    cells: Vec<Cell>,
}

impl SideGrid {
    /// The grid for a number of points. None if rays are faster, or if the rule has no integer winding number.
    pub(crate) fn new(mesh: &Mesh, rule: &SignRule, points: usize, progress: &Progress) -> Result<Option<Self>, Error> {
        let SignRule::Counted(openings) = rule else { return Ok(None) };
        if points < LEAST_POINTS || mesh.faces().len() > FACES_PER_POINT * points {
            return Ok(None);
        }
        let mut grid = Self::empty(mesh, points);
        if grid.enter_faces(mesh).is_none() {
            return Ok(None);
        }
        progress.check()?;
        if !openings.caps.is_empty() {
            grid.enter_openings(openings);
        }
        grid.decide(|p| rule.is_inside_without_distance(mesh, p), progress)?;
        Ok(Some(grid))
    }

    /// Whether a local point is inside. None in entered cells and outside the grid.
    pub(crate) fn side(&self, p: DVec3) -> Option<bool> {
        let place = self.place(p);
        // A comparison with NaN is false.
        let is_within = place.cmpge(DVec3::ZERO).all() && place.cmplt(self.shape.as_dvec3()).all();
        match self.cells[self.index(is_within.then(|| place.as_uvec3())?)] {
            Cell::Outside => Some(false),
            Cell::Inside => Some(true),
            Cell::Entered | Cell::Free => None,
        }
    }

    fn empty(mesh: &Mesh, points: usize) -> Self {
        let bounds = mesh.bvh().bounds;
        let (lower, upper) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let margin = MARGIN * (upper - lower).max_element().max(f64::MIN_POSITIVE);
        let (lower, upper) = (lower - margin, upper + margin);
        let extent = upper - lower;
        let count = (points as f64 / POINTS_PER_CELL as f64).min(MOST_CELLS);
        let side = (extent.x * extent.y * extent.z / count).cbrt();
        // The cells of a flat or thin box are longer than cubes would be, so that their number stays near `count`.
        let most = count.sqrt();
        let shape = (extent / side).floor().clamp(DVec3::ONE, DVec3::splat(most)).as_uvec3();
        let cells = vec![Cell::Free; shape.element_product() as usize];
        Self { lower, cells_per_unit: shape.as_dvec3() / extent, shape, cells }
    }

    /// The place of a point in cells. Its whole part is the cell.
    fn place(&self, p: DVec3) -> DVec3 {
        (p - self.lower) * self.cells_per_unit
    }

    fn index(&self, cell: UVec3) -> usize {
        cell.x as usize + self.shape.x as usize * (cell.y as usize + self.shape.y as usize * cell.z as usize)
    }

    /// The first and the last cell of the box of a face.
    fn range(&self, corners: [DVec3; 3]) -> [UVec3; 2] {
        let [a, b, c] = corners;
        // Casting rounds down, and saturates at zero.
        [a.min(b).min(c), a.max(b).max(c)].map(|p| self.place(p).as_uvec3().min(self.shape - 1))
    }

    /// Marks the cells that faces enter. None if that would take too many comparisons.
    fn enter_faces(&mut self, mesh: &Mesh) -> Option<()> {
        let corners = |face: &[u32; 3]| face.map(|v| mesh.exact_position(v));
        let mut remaining = COMPARISONS.0 * self.cells.len() + COMPARISONS.1 * mesh.faces().len();
        for face in mesh.faces() {
            let [first, last] = self.range(corners(face));
            remaining = remaining.checked_sub((last - first + 1).element_product() as usize)?;
        }
        let half = 0.5 / self.cells_per_unit;
        for face in mesh.faces() {
            let corners = corners(face);
            let [first, last] = self.range(corners);
            let (ab, ac) = (corners[1] - corners[0], corners[2] - corners[0]);
            let normal = ab.cross(ac);
            // The normal of a sliver consists of rounding. Local coordinates are below 1, the grid is little larger.
            let rounding = 16.0 * f64::EPSILON * ab.abs().max_element() * ac.abs().max_element();
            // In one layer of cells, the plane rejects few of them.
            let is_thin = (last - first).min_element() == 0;
            let reach = normal.abs().dot(half) * (1.0 + ROUNDING) + rounding;
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    for x in first.x..=last.x {
                        let cell = UVec3::new(x, y, z);
                        let center = self.lower + (cell.as_dvec3() + 0.5) / self.cells_per_unit;
                        if is_thin || normal.dot(center - corners[0]).abs() <= reach {
                            let index = self.index(cell);
                            self.cells[index] = Cell::Entered;
                        }
                    }
                }
            }
        }
        Some(())
    }

    /// Marks the cells where the nearest integer of the fraction of the openings may change. Blocks of cells are
    /// halved, the largest first, until it is uniform in them or the number of comparisons has reached its limit.
    fn enter_openings(&mut self, openings: &Openings) {
        let mut blocks = VecDeque::from([[UVec3::ZERO, self.shape]]);
        let mut remaining = self.cells.len() / CELLS_PER_BLOCK;
        while let Some([first, end]) = blocks.pop_front() {
            let [lower, upper] = [first, end].map(|cell| self.lower + cell.as_dvec3() / self.cells_per_unit);
            let radius = 0.5 * (upper - lower).length() * (1.0 + ROUNDING);
            if remaining > 0 {
                remaining -= 1;
                if openings.is_uniform_within(0.5 * (lower + upper), radius) {
                    continue;
                }
            }
            let size = end - first;
            let longest = size.max_element();
            if remaining > 0 && longest > 1 {
                let axis = (0..3).find(|&axis| size[axis] == longest).unwrap_or(0);
                let (mut middle_end, mut middle_first) = (end, first);
                middle_end[axis] = first[axis] + longest / 2;
                middle_first[axis] = middle_end[axis];
                blocks.extend([[first, middle_end], [middle_first, end]]);
                continue;
            }
            for z in first.z..end.z {
                for y in first.y..end.y {
                    let start = self.index(UVec3::new(first.x, y, z));
                    self.cells[start..start + size.x as usize].fill(Cell::Entered);
                }
            }
        }
    }

    /// Decides the side of every free cell by one point of its region.
    fn decide(&mut self, is_inside: impl Fn(DVec3) -> bool + Sync, progress: &Progress) -> Result<(), Error> {
        const NONE: u32 = u32::MAX;
        // Union-find over numbers of regions; a region is known by its first cell.
        let (mut parents, mut seeds) = (Vec::<u32>::new(), Vec::new());
        let mut regions = vec![NONE; self.cells.len()];
        let root = |parents: &mut [u32], mut region: u32| {
            while parents[region as usize] != region {
                let grand = parents[parents[region as usize] as usize];
                parents[region as usize] = grand;
                region = grand;
            }
            region
        };
        let [row, layer] = [self.shape.x as usize, (self.shape.x * self.shape.y) as usize];
        for z in 0..self.shape.z {
            for y in 0..self.shape.y {
                for x in 0..self.shape.x {
                    let cell = UVec3::new(x, y, z);
                    let index = self.index(cell);
                    if self.cells[index] == Cell::Entered {
                        continue;
                    }
                    let mut region = NONE;
                    for (at, step) in [(x, 1), (y, row), (z, layer)] {
                        let before = if at > 0 { regions[index - step] } else { NONE };
                        if before == NONE || before == region {
                            continue;
                        }
                        let before = root(&mut parents, before);
                        if region != NONE {
                            parents[region.max(before) as usize] = region.min(before);
                        }
                        region = region.min(before);
                    }
                    if region == NONE {
                        region = parents.len() as u32;
                        parents.push(region);
                        seeds.push(cell);
                    }
                    regions[index] = region;
                }
            }
            progress.check()?;
        }
        let mut sides: Vec<Cell> = parents
            .par_iter()
            .zip(&seeds)
            .enumerate()
            .map(|(region, (&parent, seed))| {
                let center = self.lower + (seed.as_dvec3() + 0.5) / self.cells_per_unit;
                match parent as usize == region {
                    true if is_inside(center) => Cell::Inside,
                    true => Cell::Outside,
                    false => Cell::Free,
                }
            })
            .collect();
        for region in 0..parents.len() {
            sides[region] = sides[root(&mut parents, region as u32) as usize];
        }
        for (cell, &region) in self.cells.iter_mut().zip(&regions).filter(|(_, region)| **region != NONE) {
            *cell = sides[region as usize];
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::uniform;
    use crate::sign::{SignChoice, SignMethod};
    use glam::DQuat;

    /// Adds the sides of a turned box, each of `n` by `n` squares of two faces. Without a lid if `open`.
    fn add_box(geometry: &mut (Vec<[f64; 3]>, Vec<[i64; 3]>), center: DVec3, size: f64, n: i64, open: bool) {
        let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
        let (vertices, faces) = geometry;
        for side in 0..if open { 5 } else { 6 } {
            let (axis, is_upper) = (side % 3, side / 3 == 0);
            let first = vertices.len() as i64;
            for (j, i) in (0..=n).flat_map(|j| (0..=n).map(move |i| (j, i))) {
                let mut p = DVec3::ZERO;
                p[axis] = if is_upper { 0.5 } else { -0.5 };
                p[(axis + 1) % 3] = i as f64 / n as f64 - 0.5;
                p[(axis + 2) % 3] = j as f64 / n as f64 - 0.5;
                vertices.push((center + size * (turn * p)).to_array());
            }
            for (j, i) in (0..n).flat_map(|j| (0..n).map(move |i| (j, i))) {
                let a = first + i + j * (n + 1);
                let pair = [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]];
                faces.extend(pair.map(|[a, b, c]| if is_upper { [a, b, c] } else { [a, c, b] }));
            }
        }
    }

    /// The share of random points that the grid decides, all of them as the sign rule does. None without a grid.
    fn decided(geometry: &(Vec<[f64; 3]>, Vec<[i64; 3]>), count: usize) -> Option<f64> {
        let mesh = Mesh::new(&geometry.0, &geometry.1).unwrap();
        let rule = SignChoice::new(&mesh, SignMethod::Auto).rule;
        let grid = SideGrid::new(&mesh, &rule, count, &Progress::new()).unwrap()?;
        let bounds = mesh.bvh().bounds;
        let (lower, extent) = (bounds.min.as_dvec3(), (bounds.max - bounds.min).as_dvec3());
        let mut random = uniform(5);
        let found = (0..count).filter(|i| {
            let mut p = lower + extent * DVec3::new(random(), random(), random());
            if i % 16 == 0 {
                // Corners of cells.
                p = grid.lower + (grid.place(p).floor() + 1.0) / grid.cells_per_unit;
            }
            let side = grid.side(p);
            let is_known = side.is_some();
            assert!(!is_known || side == Some(rule.is_inside_without_distance(&mesh, p)), "{p}");
            is_known
        });
        Some(found.count() as f64 / count as f64)
    }

    #[test]
    fn cells_have_the_side_of_their_points() {
        for n in [1, 8] {
            for open in [false, true] {
                let mut geometry = (Vec::new(), Vec::new());
                add_box(&mut geometry, DVec3::ZERO, 1.0, n, open);
                // A second shell in the first one, and a part beside both.
                add_box(&mut geometry, DVec3::new(0.1, 0.0, 0.0), 0.4, n, false);
                add_box(&mut geometry, DVec3::new(1.5, 0.2, 0.0), 0.7, n, false);
                let share = decided(&geometry, 60_000).unwrap();
                assert!(share >= 0.7, "n = {n}, open = {open}: {share}");
            }
        }
    }

    #[test]
    fn flat_and_thin_meshes_have_grids() {
        for scale in [DVec3::new(1.0, 1.0, 1e-7), DVec3::new(1.0, 1e-4, 1e-4)] {
            let mut geometry = (Vec::new(), Vec::new());
            add_box(&mut geometry, DVec3::ZERO, 1.0, 3, false);
            geometry.0.iter_mut().for_each(|v| *v = (DVec3::from_array(*v) * scale).to_array());
            assert!(decided(&geometry, LEAST_POINTS).is_some_and(|share| share > 0.0), "{scale}");
        }
    }

    #[test]
    fn few_points_and_many_large_faces_have_no_grid() {
        let mut geometry = (Vec::new(), Vec::new());
        add_box(&mut geometry, DVec3::ZERO, 1.0, 1, false);
        assert_eq!(decided(&geometry, LEAST_POINTS - 1), None);
        assert!(decided(&geometry, LEAST_POINTS).is_some());
        for i in 0..200 {
            add_box(&mut geometry, DVec3::splat(1e-4 * f64::from(i)), 1.0, 1, false);
        }
        assert_eq!(decided(&geometry, LEAST_POINTS), None);
    }
}
