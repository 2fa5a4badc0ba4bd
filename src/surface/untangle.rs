//! The search for faces that pass through each other, and the division of their quadrilaterals until none do.
//!
//! Quadrilaterals that cross have overlapping boxes. Each is entered into the cells that its box overlaps, and pairs of
//! one cell are compared by exact orientations ([`triangles_cross`]). Where a pair crosses, the patches at its corners
//! are divided ([`super::division`]). Division changes the quadrilaterals around, so these are compared again. Each
//! round divides at least one patch, and divided patches do not cross, so the search ends.

use super::division::{Corner, Division};
use super::mesh::corners;
use super::probes::ExtraPlanes;
use super::quad::Quad;
use super::{Crossing, LevelSurface};
use crate::error::Error;
use crate::geometry::triangles_cross;
use crate::progress::Progress;
use glam::{DVec3, IVec3};
use rayon::prelude::*;

/// Number of cells between two checks of the progress.
const CHUNK: usize = 1 << 12;

/// Most triangles of a quadrilateral: a fan around its edge over four vertices and four points on faces.
const MOST_TRIANGLES: usize = 8;

/// The triangles of a quadrilateral: vertices and positions.
struct Triangles {
    corners: [[Corner; 3]; MOST_TRIANGLES],
    places: [[DVec3; 3]; MOST_TRIANGLES],
    count: usize,
}

/// The box of a quadrilateral.
#[derive(Debug, Clone, Copy, Default)]
struct Extent {
    lower: DVec3,
    upper: DVec3,
    /// First and last cell.
    cells: [IVec3; 2],
}

impl LevelSurface {
    /// Divides patches until no two faces cross each other. Vertices of divided patches move into their cells.
    pub(super) fn untangle(
        &self,
        vertices: &mut [DVec3],
        quads: &[Quad],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        is_sharp: bool,
        progress: &Progress,
    ) -> Result<Division, Error> {
        let mut division = Division::default();
        let mut is_changed = vec![true; quads.len()];
        loop {
            let tangle = Tangle { surface: self, vertices, quads, crossings, division: &division };
            let mut patches = tangle.crossing_patches(&is_changed, progress)?;
            patches.retain(|&patch| !division.contains(patch));
            if patches.is_empty() {
                return Ok(division);
            }
            let added = self.divide(&patches, &mut division, vertices, crossings, extra, is_sharp);
            is_changed.fill(false);
            let edges = added.iter().flat_map(|&patch| self.links.edges_of(patch));
            edges.for_each(|&edge| is_changed[edge as usize] = true);
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
}

impl Tangle<'_> {
    /// The patches at the corners of triangles that cross another one, sorted. One of the two belongs to a changed
    /// quadrilateral.
    fn crossing_patches(&self, is_changed: &[bool], progress: &Progress) -> Result<Vec<u32>, Error> {
        let extents: Vec<Extent> = (0..self.quads.len() as u32).into_par_iter().map(|edge| self.extent(edge)).collect();
        let [lower, upper] = extents.iter().fold([IVec3::MAX, IVec3::MIN], |[lower, upper], extent| {
            [lower.min(extent.cells[0]), upper.max(extent.cells[1])]
        });
        let size = (upper - lower + 1).as_u64vec3();
        let key = |cell: IVec3| {
            let at = (cell - lower).as_u64vec3();
            at.x + size.x * (at.y + size.y * at.z)
        };
        let entries = extents.par_iter().enumerate().flat_map_iter(|(edge, extent)| {
            let [first, last] = extent.cells;
            let rows = (first.z..=last.z).flat_map(move |z| (first.y..=last.y).map(move |y| (y, z)));
            let cells = rows.flat_map(move |(y, z)| (first.x..=last.x).map(move |x| IVec3::new(x, y, z)));
            cells.map(move |cell| (key(cell), edge as u32))
        });
        let mut entries: Vec<(u64, u32)> = entries.collect();
        entries.par_sort_unstable();
        let chunks: Vec<&[(u64, u32)]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let found = chunks.par_chunks(CHUNK).map(|chunks| {
            progress.check()?;
            let mut patches = Vec::new();
            for chunk in chunks {
                for (i, &(cell, first)) in chunk.iter().enumerate() {
                    for &(_, second) in &chunk[..i] {
                        let [a, b] = [first, second].map(|edge| &extents[edge as usize]);
                        let (lower, upper) = (a.lower.max(b.lower), a.upper.min(b.upper));
                        // A pair belongs to the first of its common cells.
                        if lower.cmple(upper).all()
                            && (is_changed[first as usize] || is_changed[second as usize])
                            && key(a.cells[0].max(b.cells[0])) == cell
                        {
                            self.compare(first, second, [lower, upper], &mut patches);
                        }
                    }
                }
            }
            Ok(patches)
        });
        let mut found = found.collect::<Result<Vec<_>, Error>>()?.concat();
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    fn extent(&self, edge: u32) -> Extent {
        let surface = self.surface;
        let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let around = surface.links.patches_around(edge);
        let mut add = |place: DVec3| (lower, upper) = (lower.min(place), upper.max(place));
        if around.iter().any(|&patch| self.division.contains(patch)) {
            self.division.for_triangles(edge, around, &self.quads[edge as usize], |triangle| {
                triangle.iter().for_each(|&corner| add(self.place(corner)));
            });
        } else {
            around.iter().for_each(|&patch| add(self.vertices[patch as usize]));
        }
        let cell = |place: DVec3| ((place - surface.lower) / surface.spacing - 0.5).floor().as_ivec3();
        Extent { lower, upper, cells: [cell(lower), cell(upper)] }
    }

    fn place(&self, corner: Corner) -> DVec3 {
        self.surface.place(corner, self.division, self.vertices, self.crossings)
    }

    /// The triangles of a quadrilateral that overlap a box.
    fn triangles(&self, edge: u32, [lower, upper]: [DVec3; 2]) -> Triangles {
        let quad = &self.quads[edge as usize];
        let mut all = Triangles {
            corners: [[Corner::Edge(edge); 3]; MOST_TRIANGLES],
            places: [[DVec3::ZERO; 3]; MOST_TRIANGLES],
            count: 0,
        };
        self.division.for_triangles(edge, corners(&self.surface.links, edge, quad), quad, |triangle| {
            let places = triangle.map(|corner| self.place(corner));
            let [a, b, c] = places;
            if a.min(b).min(c).cmple(upper).all() && a.max(b).max(c).cmpge(lower).all() {
                (all.corners[all.count], all.places[all.count]) = (triangle, places);
                all.count += 1;
            }
        });
        all
    }

    /// Appends the patches at the corners of triangles of two quadrilaterals that cross. `common` is the intersection
    /// of their boxes.
    fn compare(&self, first: u32, second: u32, common: [DVec3; 2], patches: &mut Vec<u32>) {
        let (first, second) = (self.triangles(first, common), self.triangles(second, common));
        for i in 0..first.count {
            for j in 0..second.count {
                let (own, others) = (first.corners[i], second.corners[j]);
                // Faces on both sides of an edge touch there.
                let shared = own.iter().filter(|corner| others.contains(corner)).count();
                let [(a, b), (c, d)] =
                    [first.places[i], second.places[j]].map(|[a, b, c]| (a.min(b).min(c), a.max(b).max(c)));
                let overlaps = a.cmple(d).all() && c.cmple(b).all();
                if shared < 2 && overlaps && triangles_cross(first.places[i], second.places[j]) {
                    let corners = own.into_iter().chain(others);
                    patches.extend(corners.filter_map(|corner| match corner {
                        Corner::Patch(patch) => Some(patch),
                        Corner::Edge(_) | Corner::Face(..) => None,
                    }));
                }
            }
        }
    }
}
