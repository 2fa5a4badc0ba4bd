//! The search for faces that pass through each other, and the division of their quadrilaterals until none do.
//!
//! A quadrilateral whose corners lie in the four cells around its edge stays in these cells. If two such quadrilaterals
//! cross in a cell with one patch, both have this patch as a corner. The quadrilaterals at a patch are a *star*, and do
//! not cross, if each lies in its own wedge around the vertex of the patch, seen along the mean of their normals. All
//! other pairs are compared by exact orientations ([`triangles_cross`]): pairs at the patches of one cell, and pairs of
//! a quadrilateral with a corner outside its cell and any quadrilateral whose box overlaps its box.
//!
//! Where a pair crosses, the patches at its corners are divided ([`super::division`]). Division changes the
//! quadrilaterals around, so these are compared again. Each round divides at least one patch, and divided patches do
//! not cross, so the search ends.

use super::cells::SurfaceCell;
use super::division::{Corner, Division};
use super::mesh::corners;
use super::probes::ExtraPlanes;
use super::quad::Quad;
use super::{Crossing, LevelSurface};
use crate::error::Error;
use crate::geometry::triangles_cross;
use crate::progress::Progress;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use rustc_hash::FxHashSet;

/// Number of cells or quadrilaterals that one task processes.
const CHUNK: usize = 1 << 10;

/// Number of blocks of cells that one task compares.
const BLOCKS: usize = 1 << 6;

/// Binary logarithm of the side of a block of cells.
const BLOCK: i32 = 2;

/// Smallest cross product of the sides of a wedge, voxels squared, far above the rounding of positions.
const LEAST_WEDGE: f64 = 1e-6;

/// A triangle of the quadrilateral around a crossed edge.
struct Triangle {
    edge: u32,
    corners: [Corner; 3],
    places: [DVec3; 3],
    extent: Extent,
}

/// A box: lower and upper corner, world units.
type Extent = [DVec3; 2];

/// A block of cells, and an edge: whether its quadrilateral lies in the cells around it, and its number.
type Entry = ([i32; 3], bool, u32);

impl LevelSurface {
    /// Divides patches until no two faces cross each other. Vertices of divided patches move into their cells.
    pub(super) fn untangle(
        &self,
        vertices: &mut [DVec3],
        quads: &mut [Quad],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        is_sharp: bool,
        progress: &Progress,
    ) -> Result<Division, Error> {
        let mut division = Division::default();
        let mut changed: Vec<u32> = (0..quads.len() as u32).collect();
        let mut is_changed = vec![true; quads.len()];
        let mut extents = Vec::new();
        loop {
            let tangle =
                Tangle { surface: self, vertices, quads, crossings, division: &division, is_changed: &is_changed };
            tangle.update_extents(&changed, &mut extents);
            let mut patches = tangle.crossing_patches(&changed, &extents, progress)?;
            patches.retain(|&patch| !division.contains(patch));
            if patches.is_empty() {
                return Ok(division);
            }
            let added = self.divide(&patches, &mut division, vertices, crossings, extra, is_sharp);
            changed.iter().for_each(|&edge| is_changed[edge as usize] = false);
            changed = self.update_quads(&added, vertices, quads);
            changed.sort_unstable();
            changed.dedup();
            changed.iter().for_each(|&edge| is_changed[edge as usize] = true);
        }
    }
}

/// A surface with its vertices and quadrilaterals.
struct Tangle<'a> {
    surface: &'a LevelSurface,
    vertices: &'a [DVec3],
    quads: &'a [Quad],
    crossings: &'a [Crossing],
    division: &'a Division,
    /// Quadrilaterals that were not compared yet.
    is_changed: &'a [bool],
}

impl Tangle<'_> {
    /// Computes the boxes of changed quadrilaterals; at first all have changed. Boxes are not necessary if all corners
    /// lie in their cells. No vertex moves out of its cell later.
    fn update_extents(&self, changed: &[u32], extents: &mut Vec<Extent>) {
        if changed.len() == self.quads.len() && !self.quads.par_iter().all(|quad| quad.is_around) {
            let edges = (0..self.quads.len() as u32).into_par_iter();
            edges.map(|edge| self.extent(edge)).collect_into_vec(extents);
        } else if !extents.is_empty() {
            changed.iter().for_each(|&edge| extents[edge as usize] = self.extent(edge));
        }
    }

    /// The patches at the corners of triangles that cross another one, sorted.
    fn crossing_patches(&self, changed: &[u32], extents: &[Extent], progress: &Progress) -> Result<Vec<u32>, Error> {
        let is_first = changed.len() == self.quads.len();
        let cells: Vec<&SurfaceCell> = if is_first {
            self.surface.cells.cells().iter().collect()
        } else {
            let patches = changed.iter().flat_map(|&edge| self.surface.links.patches_around(edge));
            self.surface.cells.of_patches(patches)
        };
        let mut is_star = vec![false; self.surface.cells.patch_count()];
        let stars = cells.par_iter().with_min_len(CHUNK).flat_map_iter(|cell| cell.patch_ids());
        let stars: Vec<u32> = stars.filter(|&patch| self.is_star(patch)).collect();
        stars.into_iter().for_each(|patch| is_star[patch as usize] = true);
        let in_cells = cells.par_chunks(CHUNK).map(|cells| {
            let (mut found, mut triangles) = (Vec::new(), Vec::new());
            for cell in cells {
                let patches = cell.patch_ids();
                let first = cell.first_patch;
                let is_known = patches.len() == 1 && (is_star[first as usize] || self.division.contains(first));
                if !is_known {
                    triangles.clear();
                    let edges = patches.flat_map(|patch| self.surface.links.edges_of(patch)).copied();
                    // The other ones are compared by their boxes.
                    let edges = edges.filter(|&edge| self.quads[edge as usize].is_around);
                    edges.for_each(|edge| self.append_triangles(edge, &mut triangles));
                    self.compare_all(&triangles, &mut found);
                }
            }
            progress.check()?;
            Ok(found)
        });
        let entries = if extents.is_empty() { Vec::new() } else { self.entries(changed, extents) };
        let blocks: Vec<&[Entry]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let beyond = blocks.par_chunks(BLOCKS).map(|blocks| {
            let (mut found, mut triangles) = (Vec::new(), [Vec::new(), Vec::new()]);
            blocks.iter().for_each(|block| self.compare_outside(block, extents, &is_star, &mut triangles, &mut found));
            progress.check()?;
            Ok(found)
        });
        let mut found = in_cells.chain(beyond).collect::<Result<Vec<_>, Error>>()?.concat();
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    /// Whether the quadrilaterals at a patch are a star. They may be one that is not found, where some are divided or
    /// none has changed.
    fn is_star(&self, patch: u32) -> bool {
        let links = &self.surface.links;
        let edges = links.edges_of(patch);
        if self.division.contains(patch) || !edges.iter().any(|&edge| self.is_changed[edge as usize]) {
            return false;
        }
        let center = self.vertices[patch as usize];
        // The other corners of each quadrilateral, counter-clockwise from the patch.
        let mut others = [[DVec3::ZERO; 3]; 12];
        let mut normal = DVec3::ZERO;
        for (&edge, others) in edges.iter().zip(&mut others) {
            let around = corners(links, edge, &self.quads[edge as usize]);
            if around.iter().any(|&patch| self.division.contains(patch)) {
                return false;
            }
            let own = around.iter().position(|&other| other == patch).unwrap_or(0);
            *others = [1, 2, 3]
                .map(|step| (self.vertices[around[(own + step) % 4] as usize] - center) / self.surface.spacing);
            normal += others[0].cross(others[2]);
        }
        let Some(normal) = normal.try_normalize() else { return false };
        let (x, y) = normal.any_orthonormal_pair();
        let mut turns = 0;
        for &[next, opposite, previous] in &others[..edges.len()] {
            let [next, opposite, previous] = [next, opposite, previous].map(|p| DVec2::new(p.dot(x), p.dot(y)));
            let least = next.perp_dot(opposite).min(opposite.perp_dot(previous)).min(next.perp_dot(previous));
            if least <= LEAST_WEDGE {
                return false;
            }
            // A wedge below half a turn that begins below the x axis and ends above it contains the axis.
            turns += u32::from(next.y < 0.0 && previous.y >= 0.0);
        }
        turns == 1
    }

    fn place(&self, corner: Corner) -> DVec3 {
        self.surface.place(corner, self.division, self.vertices, self.crossings)
    }

    /// The box of a quadrilateral.
    fn extent(&self, edge: u32) -> Extent {
        let around = self.surface.links.patches_around(edge);
        let [a, b, c, d] = around.map(|patch| self.vertices[patch as usize]);
        let (mut lower, mut upper) = (a.min(b).min(c.min(d)), a.max(b).max(c.max(d)));
        if !around.iter().any(|&patch| self.division.contains(patch)) {
            return [lower, upper];
        }
        self.division.for_triangles(edge, around, &self.quads[edge as usize], |corners| {
            for place in corners.map(|corner| self.place(corner)) {
                (lower, upper) = (lower.min(place), upper.max(place));
            }
        });
        [lower, upper]
    }

    /// Appends the triangles of a quadrilateral.
    fn append_triangles(&self, edge: u32, triangles: &mut Vec<Triangle>) {
        let quad = &self.quads[edge as usize];
        self.division.for_triangles(edge, corners(&self.surface.links, edge, quad), quad, |corners| {
            let places @ [a, b, c] = corners.map(|corner| self.place(corner));
            triangles.push(Triangle { edge, corners, places, extent: [a.min(b).min(c), a.max(b).max(c)] });
        });
    }

    /// Compares all pairs of some triangles.
    fn compare_all(&self, triangles: &[Triangle], found: &mut Vec<u32>) {
        for (i, first) in triangles.iter().enumerate() {
            triangles[..i].iter().for_each(|second| self.compare(first, second, found));
        }
    }

    /// The quadrilaterals in the blocks where a pair has to be compared by boxes, sorted by block. In each block those
    /// with a corner outside their cell come first.
    fn entries(&self, changed: &[u32], extents: &[Extent]) -> Vec<Entry> {
        let is_first = changed.len() == self.quads.len();
        let is_outside = |&&edge: &&u32| !self.quads[edge as usize].is_around;
        let seeds = changed.iter().filter(|edge| !is_first || is_outside(edge));
        let blocks: FxHashSet<[i32; 3]> = seeds.flat_map(|&edge| self.blocks(extents[edge as usize])).collect();
        let edges = (0..extents.len()).into_par_iter().with_min_len(CHUNK);
        let entries = edges.flat_map_iter(|edge| {
            let own = self.blocks(extents[edge]).filter(|block| blocks.contains(block));
            own.map(move |block| (block, self.quads[edge].is_around, edge as u32))
        });
        let mut entries: Vec<Entry> = entries.collect();
        entries.par_sort_unstable();
        entries
    }

    /// The blocks of cells that a box overlaps.
    fn blocks(&self, extent: Extent) -> impl Iterator<Item = [i32; 3]> + use<> {
        let [low, high] = extent.map(|place| self.block_at(place));
        let rows = (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).map(move |y| (y, z)));
        rows.flat_map(move |(y, z)| (low[0]..=high[0]).map(move |x| [x, y, z]))
    }

    /// The block of cells of a position.
    fn block_at(&self, place: DVec3) -> [i32; 3] {
        (((place - self.surface.lower) / self.surface.spacing - 0.5).floor().as_ivec3() >> BLOCK).to_array()
    }

    /// Compares the quadrilaterals of a block that have a corner outside their cell with all others there. A pair is
    /// compared in the first of their common blocks. `triangles` are buffers.
    fn compare_outside(
        &self,
        block: &[Entry],
        extents: &[Extent],
        is_star: &[bool],
        [own, others]: &mut [Vec<Triangle>; 2],
        found: &mut Vec<u32>,
    ) {
        for (i, &(here, _, first)) in block.iter().enumerate().take_while(|(_, entry)| !entry.1) {
            let [lower, upper] = extents[first as usize];
            own.clear();
            for &(_, _, second) in &block[i + 1..] {
                let [low, high] = extents[second as usize];
                if (self.is_changed[first as usize] || self.is_changed[second as usize])
                    && lower.cmple(high).all()
                    && low.cmple(upper).all()
                    && self.block_at(lower.max(low)) == here
                    && !self.are_in_one_star(first, second, is_star)
                {
                    if own.is_empty() {
                        self.append_triangles(first, own);
                    }
                    others.clear();
                    self.append_triangles(second, others);
                    for triangle in &*own {
                        others.iter().for_each(|other| self.compare(triangle, other, found));
                    }
                }
            }
        }
    }

    /// Whether two quadrilaterals have a common patch whose quadrilaterals are a star, so that they do not cross.
    fn are_in_one_star(&self, first: u32, second: u32, is_star: &[bool]) -> bool {
        let around = self.surface.links.patches_around(second);
        let own = self.surface.links.patches_around(first);
        own.iter().any(|patch| is_star[*patch as usize] && around.contains(patch))
    }

    /// Appends the patches at the corners of two triangles that cross, of different quadrilaterals of which one has
    /// changed.
    fn compare(&self, first: &Triangle, second: &Triangle, found: &mut Vec<u32>) {
        let ([lower, upper], [low, high]) = (first.extent, second.extent);
        // Faces on both sides of an edge touch there.
        if first.edge != second.edge
            && (self.is_changed[first.edge as usize] || self.is_changed[second.edge as usize])
            && lower.cmple(high).all()
            && low.cmple(upper).all()
            && first.corners.iter().filter(|corner| second.corners.contains(corner)).count() < 2
            && triangles_cross(first.places, second.places)
        {
            found.extend(first.corners.iter().chain(&second.corners).filter_map(|corner| match corner {
                Corner::Patch(patch) => Some(*patch),
                Corner::Edge(_) | Corner::Face(..) => None,
            }));
        }
    }
}
