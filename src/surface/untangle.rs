//! The search for faces that pass through each other, and the division of their quadrilaterals until none do.
//!
//! A quadrilateral whose corners lie in the four cells around its edge stays in these cells. If two such quadrilaterals
//! cross in a cell with one patch, both have this patch as a corner. The quadrilaterals at a patch are a *star*, and do
//! not cross, if each lies in its own wedge around the vertex of the patch, seen along the mean of their normals. All
//! other pairs are compared by exact orientations ([`triangles_cross`]): pairs at the patches of one cell, and pairs of
//! a quadrilateral with a corner outside its cell and a quadrilateral in the cells that its box overlaps.
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
use glam::{DVec2, DVec3, IVec3};
use rayon::prelude::*;
use std::collections::HashSet;

/// Number of cells between two checks of the progress.
const CHUNK: usize = 1 << 10;

/// Binary logarithm of the side of a block of cells.
const BLOCK: i32 = 2;

/// Most triangles of a quadrilateral: a fan around its edge over four vertices and four points on faces.
const MOST_TRIANGLES: usize = 8;

/// Smallest cross product of the sides of a wedge, voxels squared, far above the rounding of positions.
const LEAST_WEDGE: f64 = 1e-6;

/// The triangles of a quadrilateral: vertices and positions.
struct Triangles {
    edge: u32,
    corners: [[Corner; 3]; MOST_TRIANGLES],
    places: [[DVec3; 3]; MOST_TRIANGLES],
    count: usize,
}

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
        let mut is_changed = vec![true; quads.len()];
        loop {
            let tangle =
                Tangle { surface: self, vertices, quads, crossings, division: &division, is_changed: &is_changed };
            let mut patches = tangle.crossing_patches(progress)?;
            patches.retain(|&patch| !division.contains(patch));
            if patches.is_empty() {
                return Ok(division);
            }
            let added = self.divide(&patches, &mut division, vertices, crossings, extra, is_sharp);
            is_changed.fill(false);
            for edge in self.update_quads(&added, vertices, quads) {
                is_changed[edge as usize] = true;
            }
        }
    }
}

/// The box of a quadrilateral: lower and upper corner, world units.
type Extent = [DVec3; 2];

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
    /// The patches at the corners of triangles that cross another one, sorted.
    fn crossing_patches(&self, progress: &Progress) -> Result<Vec<u32>, Error> {
        let cells = self.surface.cells.cells();
        let patches = (0..self.surface.cells.patch_count() as u32).into_par_iter();
        let is_star: Vec<bool> = patches.map(|patch| self.is_star(patch)).collect();
        let in_cells = cells.par_chunks(CHUNK).map(|cells| {
            let (mut found, mut edges, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
            for cell in cells {
                let count = cell.patches().count() as u32;
                let first = cell.first_patch;
                let is_known = count == 1 && (is_star[first as usize] || self.division.contains(first));
                if !is_known {
                    edges.clear();
                    let patches = cell.first_patch..cell.first_patch + count;
                    edges.extend(patches.flat_map(|patch| self.surface.links.edges_of(patch)));
                    self.compare_all(&edges, &mut triangles, &mut found);
                }
            }
            progress.check()?;
            Ok(found)
        });
        let outside: Vec<u32> =
            (0..self.quads.len() as u32).filter(|&edge| !self.quads[edge as usize].is_around).collect();
        // All quadrilaterals are near a changed one at first.
        let changed = self.is_changed.contains(&false).then(|| self.blocks_of_changed());
        let extents: Vec<Extent> = if outside.is_empty() {
            Vec::new()
        } else {
            (0..self.quads.len()).into_par_iter().map(|edge| self.extent(edge as u32)).collect()
        };
        let is_near = |edge: u32| {
            changed.as_ref().is_none_or(|blocks| {
                let mut own = self.blocks(extents[edge as usize]);
                own.any(|block| blocks.contains(&block))
            })
        };
        let outside: Vec<u32> = outside.into_iter().filter(|&edge| is_near(edge)).collect();
        let beyond = outside.par_chunks(CHUNK).map(|edges| {
            let (mut found, mut others) = (Vec::new(), Vec::new());
            edges.iter().for_each(|&edge| self.compare_around(edge, &extents, &is_star, &mut others, &mut found));
            progress.check()?;
            Ok(found)
        });
        let mut found = in_cells.chain(beyond).collect::<Result<Vec<_>, Error>>()?.concat();
        self.compare_outside(&outside, &extents, &is_star, &mut found);
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

    /// The triangles of a quadrilateral.
    fn triangles(&self, edge: u32) -> Triangles {
        let quad = &self.quads[edge as usize];
        let (corner, place) = (Corner::Edge(edge), DVec3::ZERO);
        let (corners_of, places) = ([[corner; 3]; MOST_TRIANGLES], [[place; 3]; MOST_TRIANGLES]);
        let mut all = Triangles { edge, corners: corners_of, places, count: 0 };
        self.division.for_triangles(edge, corners(&self.surface.links, edge, quad), quad, |triangle| {
            all.corners[all.count] = triangle;
            all.places[all.count] = triangle.map(|corner| self.place(corner));
            all.count += 1;
        });
        all
    }

    /// Compares all pairs of some quadrilaterals, of which one has changed. `triangles` is a buffer.
    fn compare_all(&self, edges: &[u32], triangles: &mut Vec<Triangles>, found: &mut Vec<u32>) {
        if !edges.iter().any(|&edge| self.is_changed[edge as usize]) {
            return;
        }
        triangles.clear();
        triangles.extend(edges.iter().map(|&edge| self.triangles(edge)));
        for (i, first) in triangles.iter().enumerate() {
            triangles[..i].iter().for_each(|second| self.compare(first, second, found));
        }
    }

    /// The blocks of cells that the boxes of changed quadrilaterals overlap.
    fn blocks_of_changed(&self) -> HashSet<IVec3> {
        let changed = (0..).zip(self.is_changed).filter(|&(_, &is_changed)| is_changed);
        changed.flat_map(|(edge, _)| self.blocks(self.extent(edge))).collect()
    }

    fn blocks(&self, extent: Extent) -> impl Iterator<Item = IVec3> + use<> {
        let [lower, upper] = extent.map(|place| self.surface.cell_at(place) >> BLOCK);
        indices(lower, upper)
    }

    /// Compares a quadrilateral with the quadrilaterals at the patches of the cells that its box overlaps. `others` is
    /// a buffer.
    fn compare_around(
        &self,
        edge: u32,
        extents: &[Extent],
        is_star: &[bool],
        others: &mut Vec<u32>,
        found: &mut Vec<u32>,
    ) {
        let surface = self.surface;
        let extent = extents[edge as usize];
        let [lower, upper] = extent.map(|place| surface.cell_at(place));
        let is_candidate = |other: u32| {
            other != edge
                && (self.is_changed[edge as usize] || self.is_changed[other as usize])
                && overlap(extent, extents[other as usize])
                && !self.are_in_one_star(edge, other, is_star)
        };
        others.clear();
        for cell in indices(lower, upper).filter_map(|index| surface.cells.find(index.to_array())) {
            others.extend(edges_at(surface, cell).filter(|&other| is_candidate(other)));
        }
        others.sort_unstable();
        others.dedup();
        if !others.is_empty() {
            let own = self.triangles(edge);
            others.iter().for_each(|&other| self.compare(&own, &self.triangles(other), found));
        }
    }

    /// Whether two quadrilaterals have a common patch whose quadrilaterals are a star, so that they do not cross.
    fn are_in_one_star(&self, first: u32, second: u32, is_star: &[bool]) -> bool {
        let around = self.surface.links.patches_around(second);
        let own = self.surface.links.patches_around(first);
        own.iter().any(|patch| is_star[*patch as usize] && around.contains(patch))
    }

    /// Compares quadrilaterals with corners outside their cells with each other.
    fn compare_outside(&self, edges: &[u32], extents: &[Extent], is_star: &[bool], found: &mut Vec<u32>) {
        let mut entries: Vec<([i32; 3], u32)> = Vec::with_capacity(8 * edges.len());
        for &edge in edges {
            let [lower, upper] = extents[edge as usize].map(|place| self.surface.cell_at(place));
            entries.extend(indices(lower, upper).map(|index| (index.to_array(), edge)));
        }
        entries.par_sort_unstable();
        let mut pairs = Vec::new();
        for group in entries.chunk_by(|a, b| a.0 == b.0) {
            for (i, &(_, first)) in group.iter().enumerate() {
                let others = group[..i].iter().map(|entry| entry.1);
                let overlapping = others.filter(|&other| {
                    overlap(extents[first as usize], extents[other as usize])
                        && !self.are_in_one_star(first, other, is_star)
                });
                pairs.extend(overlapping.map(|other| (first, other)));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        for (first, second) in pairs {
            self.compare(&self.triangles(first), &self.triangles(second), found);
        }
    }

    /// Appends the patches at the corners of triangles of two quadrilaterals that cross.
    fn compare(&self, first: &Triangles, second: &Triangles, found: &mut Vec<u32>) {
        if !self.is_changed[first.edge as usize] && !self.is_changed[second.edge as usize] {
            return;
        }
        for i in 0..first.count {
            for j in 0..second.count {
                let (own, others) = (&first.corners[i], &second.corners[j]);
                let [[a, b, c], [d, e, f]] = [&first.places[i], &second.places[j]];
                let overlaps = a.min(*b).min(*c).cmple(d.max(*e).max(*f)).all()
                    && d.min(*e).min(*f).cmple(a.max(*b).max(*c)).all();
                // Faces on both sides of an edge touch there.
                if overlaps
                    && own.iter().filter(|corner| others.contains(corner)).count() < 2
                    && triangles_cross(first.places[i], second.places[j])
                {
                    found.extend(own.iter().chain(others).filter_map(|corner| match corner {
                        Corner::Patch(patch) => Some(*patch),
                        Corner::Edge(_) | Corner::Face(..) => None,
                    }));
                }
            }
        }
    }
}

/// Whether two boxes overlap.
fn overlap([lower, upper]: Extent, [low, high]: Extent) -> bool {
    lower.cmple(high).all() && low.cmple(upper).all()
}

/// The indices from `lower` to `upper`.
fn indices(lower: IVec3, upper: IVec3) -> impl Iterator<Item = IVec3> + use<> {
    let rows = (lower.z..=upper.z).flat_map(move |z| (lower.y..=upper.y).map(move |y| (y, z)));
    rows.flat_map(move |(y, z)| (lower.x..=upper.x).map(move |x| IVec3::new(x, y, z)))
}

/// The crossed edges at the patches of a cell.
fn edges_at<'a>(surface: &'a LevelSurface, cell: &SurfaceCell) -> impl Iterator<Item = u32> + use<'a> {
    let patches = cell.first_patch..cell.first_patch + cell.patches().count() as u32;
    patches.flat_map(|patch| surface.links.edges_of(patch)).copied()
}

impl LevelSurface {
    /// The cell of a position.
    fn cell_at(&self, place: DVec3) -> IVec3 {
        ((place - self.lower) / self.spacing - 0.5).floor().as_ivec3()
    }
}
