//! Vertices moved back into their cells until every sample has its side of the surface.
//!
//! A line along an edge of the grid changes sides at every quadrilateral that it intersects. Both ends of the edge have
//! their sides if the number of intersections is odd on a crossed edge, and even on any other.

use super::mesh::{Vertices, corners};
use super::probes::ExtraPlanes;
use super::quad::Quad;
use super::{Crossing, LevelSurface};
use glam::DVec3;
use rayon::prelude::*;

/// Number of edges that one task checks.
const CHUNK: usize = 1 << 10;

/// An edge of the grid (the sample where it starts, and its axis), a quadrilateral, and the number of their
/// intersections.
type Intersection = (([i32; 3], usize), u32, u32);

impl LevelSurface {
    /// Moves vertices until every sample has its side and no two vertices are equal in single precision, except as
    /// [`Self::separate`] states. Returns the quadrilaterals.
    pub(super) fn settle(&self, vertices: &mut Vertices, crossings: &[Crossing], extra: &ExtraPlanes) -> Vec<Quad> {
        let mut quads = self.quads(&vertices.places);
        let mut is_back = vec![false; vertices.places.len()];
        // Without planes of a source no vertex lies outside its cell.
        let mut keep_sides = |vertices: &mut Vertices, quads: &mut [Quad]| {
            !extra.is_empty() && self.keep_sides(vertices, quads, &mut is_back, crossings, extra)
        };
        keep_sides(vertices, &mut quads);
        // A vertex that has moved back into its cell stays there. Each moves back once at most, so the loop ends.
        loop {
            let moved = self.separate(&mut vertices.places);
            self.update_quads(&moved, &vertices.places, &mut quads);
            if moved.is_empty() || !keep_sides(vertices, &mut quads) {
                return quads;
            }
        }
    }

    /// Moves vertices back into their cells until every sample has its side, and updates the quadrilaterals. The
    /// vertices are then clamped, and their entries in `is_back` are set. Each moves once at most, so the loop ends
    /// even where a cell is a few roundings wide. Returns whether a vertex has moved.
    fn keep_sides(
        &self,
        vertices: &mut Vertices,
        quads: &mut [Quad],
        is_back: &mut [bool],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
    ) -> bool {
        let Vertices { places: vertices, is_clamped } = vertices;
        let edges = (0..quads.len() as u32).into_par_iter();
        let mut found: Vec<Intersection> =
            edges.flat_map_iter(|edge| self.intersections(edge, quads, vertices)).collect();
        found.par_sort_unstable();
        let mut has_moved = false;
        loop {
            let mut moved = Vec::new();
            for id in self.misplaced(&found, quads).into_iter().flat_map(|edge| self.links.patches_around(edge)) {
                let cell = self.cells.of_patch(id);
                let corner = self.world(cell.index, DVec3::ZERO);
                let place = vertices[id as usize] - corner;
                let is_inside = place.cmpge(DVec3::ZERO).all() && place.cmple(self.spacing).all();
                if is_inside || std::mem::replace(&mut is_back[id as usize], true) {
                    continue;
                }
                let [lower, upper] = self.region(cell, 0);
                let place = self.planes(cell, id, crossings, extra.of(id)).minimum(lower, upper).point;
                vertices[id as usize] = self.apart_from_first(cell, id, self.in_box(corner + place));
                is_clamped[id as usize] = true;
                moved.push(id);
            }
            if moved.is_empty() {
                return has_moved;
            }
            has_moved = true;
            let mut changed = self.update_quads(&moved, vertices, quads);
            changed.sort_unstable();
            changed.dedup();
            found.retain(|&(_, quad, _)| changed.binary_search(&quad).is_err());
            found.extend(changed.iter().flat_map(|&edge| self.intersections(edge, quads, vertices)));
            // A stable sort takes linear time for few new entries.
            found.sort();
        }
    }

    /// The edges of the grid that the quadrilateral around a crossed edge intersects, and the crossed edge itself.
    /// Empty if the quadrilateral intersects its own edge alone.
    fn intersections(&self, edge: u32, quads: &[Quad], vertices: &[DVec3]) -> Vec<Intersection> {
        let quad = &quads[edge as usize];
        if quad.is_around {
            return Vec::new();
        }
        let (cell, axis) = self.cells.of_edge(edge);
        let places = corners(&self.links, edge, quad).map(|i| (vertices[i as usize] - self.lower) / self.spacing - 0.5);
        let intersected = quad.intersected_edges(places).into_iter().map(|place| (place, edge, 1));
        intersected.chain([((cell.index, axis), edge, 0)]).collect()
    }

    /// The quadrilaterals that intersect an edge of the grid where they may put its ends on the wrong sides. `found` is
    /// sorted.
    fn misplaced(&self, found: &[Intersection], quads: &[Quad]) -> Vec<u32> {
        let of_edges: Vec<&[Intersection]> = found.chunk_by(|a, b| a.0 == b.0).collect();
        let of_edges = of_edges.into_par_iter().with_min_len(CHUNK);
        of_edges
            .filter(|of_edge| {
                let (index, axis) = of_edge[0].0;
                let crossed = self.cells.find(index).filter(|cell| cell.owns(axis)).map(|cell| cell.edge(axis));
                let own = crossed.is_some_and(|number| quads[number as usize].is_around);
                let count = of_edge.iter().map(|&(_, _, count)| count).sum::<u32>() + u32::from(own);
                (count % 2 == 1) != crossed.is_some()
            })
            .flat_map_iter(|of_edge| of_edge.iter().map(|&(_, quad, _)| quad))
            .collect()
    }
}
