//! Vertices and faces of the dual mesh.

use super::cells::{SurfaceCell, owner_of};
use super::probes::ExtraPlanes;
use super::qef::Planes;
use super::quad::Quad;
use super::{Crossing, LevelSurface, MARGIN, MeshOptions};
use crate::volume::{trilinear, trilinear_gradient};
use glam::DVec3;
use rayon::prelude::*;

/// Number of steps of Newton's method onto the trilinear surface. Each squares the error, which is below a voxel at the
/// start.
const NEWTON_STEPS: usize = 4;

/// Largest number of times that clamped vertices are tried at their best places.
const FREE_PASSES: usize = 4;

/// Triangles of a level set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// Counter-clockwise seen from the side of larger values.
    pub faces: Vec<[u32; 3]>,
    /// Number of vertices that are not at their optimal position, because it lies outside the region around their cell in
    /// which the surface cannot fold.
    pub clamped: usize,
}

impl LevelSurface {
    /// The mesh over `crossings`, one entry per crossed edge as [`LevelSurface::crossings`] returns them, and over the
    /// planes that probes have found.
    pub fn mesh(&self, crossings: &[Crossing], extra: &ExtraPlanes, options: MeshOptions) -> SurfaceMesh {
        assert_eq!(crossings.len(), self.edge_count(), "one crossing for each crossed edge");
        // Only planes of a source justify a vertex outside its cell; planes of the samples alone do not.
        let (mut vertices, mut clamped) = self.vertices(crossings, extra, options, options.sharp && !extra.is_empty());
        let mut quads = self.quads(&vertices);
        if !extra.is_empty() {
            clamped += self.keep_sides(&mut vertices, &mut quads, crossings, extra);
        }
        if self.separate(&mut vertices) {
            quads = self.quads(&vertices);
            if !extra.is_empty() {
                clamped += self.keep_sides(&mut vertices, &mut quads, crossings, extra);
            }
        }
        let faces: Vec<[[u32; 3]; 2]> = quads
            .par_iter()
            .zip(crossings)
            .filter(|(_, crossing)| options.capped || !crossing.on_box)
            .map(|(quad, _)| quad.triangles())
            .collect();
        let faces = faces.into_flattened();
        let mesh = SurfaceMesh { vertices, faces, clamped };
        if options.capped { mesh } else { mesh.without_unused_vertices() }
    }

    /// The vertices of all patches, and the number of those that were clamped. `free` vertices may lie outside their
    /// cell where that folds no face.
    pub(super) fn vertices(
        &self,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        options: MeshOptions,
        free: bool,
    ) -> (Vec<DVec3>, usize) {
        let placed: Vec<(DVec3, bool)> = self
            .cells
            .cells()
            .par_iter()
            .flat_map_iter(|cell| {
                (cell.first_patch..)
                    .zip(cell.patches())
                    .map(move |(id, _)| self.vertex(cell, id, crossings, extra.of(id), options, free))
            })
            .collect();
        let mut vertices: Vec<DVec3> = placed.iter().map(|(vertex, _)| *vertex).collect();
        let mut clamped = placed.iter().filter(|(_, clamped)| *clamped).count();
        if !extra.is_empty() {
            clamped -= self.free_clamped(&placed, &mut vertices, crossings, extra);
        }
        (vertices, clamped)
    }

    /// Moves clamped vertices to their best place up to a voxel outside their region, one after the other, if that
    /// folds no quadrilateral. A ridge or a corner may pass between the edges of the grid through a cell that has a
    /// patch of its own. Returns the number of vertices that moved there.
    fn free_clamped(
        &self,
        placed: &[(DVec3, bool)],
        vertices: &mut [DVec3],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
    ) -> usize {
        let patches = self.cells.cells().iter().flat_map(|cell| {
            let ids = (cell.first_patch..).take(cell.patches().count());
            ids.map(move |id| (cell, id))
        });
        let mut waiting: Vec<(&SurfaceCell, u32, DVec3)> = patches
            .filter(|&(_, id)| placed[id as usize].1)
            .map(|(cell, id)| {
                let [lower, upper] = self.region(cell, cell.free);
                let planes = self.planes(cell, id, crossings, extra.of(id));
                let best = planes.minimum(lower - self.spacing, upper + self.spacing).point;
                (cell, id, (self.world(cell.index, DVec3::ZERO) + best).clamp(self.lower, self.upper))
            })
            .collect();
        let count = waiting.len();
        // A vertex that cannot move at first may do so when its neighbours have moved.
        for _ in 0..FREE_PASSES {
            let before = waiting.len();
            waiting.retain(|&(cell, id, best)| !self.moves_to(cell, id, best, vertices));
            if waiting.len() == before {
                break;
            }
        }
        for &(cell, id, best) in &waiting {
            // The error decreases all the way to the best place.
            let start = vertices[id as usize];
            if [0.75, 0.5, 0.25].into_iter().any(|share| self.moves_to(cell, id, start.lerp(best, share), vertices)) {
                continue;
            }
            // Planes beyond the cell would bend the surface; the crossings alone may have a place inside.
            let [lower, upper] = self.region(cell, cell.free);
            let own = self.planes(cell, id, crossings, &[]).minimum(lower, upper);
            if !own.clamped {
                vertices[id as usize] = self.world(cell.index, DVec3::ZERO) + own.point;
            }
        }
        count - waiting.len()
    }

    /// Moves the vertex of a patch to a place, world units, unless that folds a quadrilateral. Returns whether it moved.
    fn moves_to(&self, cell: &SurfaceCell, id: u32, place: DVec3, vertices: &mut [DVec3]) -> bool {
        let before = std::mem::replace(&mut vertices[id as usize], place);
        let folds = self.folds_around(cell, id, vertices);
        if folds {
            vertices[id as usize] = before;
        }
        !folds
    }

    /// Whether a quadrilateral at the vertex of a patch is folded.
    pub(super) fn folds_around(&self, cell: &SurfaceCell, id: u32, vertices: &[DVec3]) -> bool {
        let patch = cell.patches().nth((id - cell.first_patch) as usize).unwrap_or(0);
        (0..12).filter(|edge| patch >> edge & 1 == 1).any(|edge| {
            let (owner, axis) = owner_of(cell, edge);
            self.cells.find(owner).is_none_or(|owner| self.quad(owner, axis, vertices).folds)
        })
    }

    /// Moves vertices back into their cells until every sample has its side, and updates the quadrilaterals. Returns the
    /// number of vertices that moved.
    fn keep_sides(
        &self,
        vertices: &mut [DVec3],
        quads: &mut Vec<Quad>,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
    ) -> usize {
        let cells = self.cells.cells();
        let mut count = 0;
        // Each vertex moves once at most, so the loop ends even where a cell is a few roundings wide.
        let mut is_moved = vec![false; vertices.len()];
        loop {
            let before = count;
            for id in self.misplaced(quads, vertices).into_iter().flat_map(|quad| quads[quad as usize].corners) {
                let cell = &cells[cells.partition_point(|cell| cell.first_patch <= id) - 1];
                let corner = self.world(cell.index, DVec3::ZERO);
                let place = vertices[id as usize] - corner;
                let is_inside = place.cmpge(DVec3::ZERO).all() && place.cmple(self.spacing).all();
                if is_inside || std::mem::replace(&mut is_moved[id as usize], true) {
                    continue;
                }
                let [lower, upper] = self.region(cell, 0);
                let place = self.planes(cell, id, crossings, extra.of(id)).minimum(lower, upper).point;
                vertices[id as usize] = (corner + place).clamp(self.lower, self.upper);
                count += 1;
            }
            if count == before {
                return count;
            }
            *quads = self.quads(vertices);
        }
    }

    /// The quadrilaterals that meet an edge of the grid where they may put its ends on the wrong sides.
    fn misplaced(&self, quads: &[Quad], vertices: &[DVec3]) -> Vec<u32> {
        let spread = |(cell, axis): (&SurfaceCell, usize)| {
            let number = cell.edge(axis);
            let quad = &quads[number as usize];
            let met = if quad.is_around {
                vec![]
            } else {
                // The edge of the quadrilateral itself has an entry in any case.
                let places = quad.corners.map(|i| (vertices[i as usize] - self.lower) / self.spacing - 0.5);
                let met = quad.met_edges(places).into_iter().map(|edge| (edge, 1));
                met.chain([((cell.index, axis), 0)]).collect()
            };
            met.into_iter().map(move |(edge, meets): (([i32; 3], usize), u32)| (edge, number, meets))
        };
        let mut met: Vec<_> = self.edge_owners().flat_map_iter(spread).collect();
        met.par_sort_unstable();
        met.chunk_by(|a, b| a.0 == b.0)
            .filter(|met| {
                let (index, axis) = met[0].0;
                let crossed = self.cells.find(index).filter(|cell| cell.owns(axis)).map(|cell| cell.edge(axis));
                let own = crossed.is_some_and(|number| quads[number as usize].is_around);
                let meets = met.iter().map(|&(_, _, meets)| meets).sum::<u32>() + u32::from(own);
                (meets % 2 == 1) != crossed.is_some()
            })
            .flat_map(|met| met.iter().map(|&(_, number, _)| number))
            .collect()
    }

    /// The crossed edges in their order: the cell from whose lower corner each starts, and its axis.
    fn edge_owners(&self) -> impl ParallelIterator<Item = (&SurfaceCell, usize)> {
        let cells = self.cells.cells().par_iter();
        cells.flat_map_iter(|cell| (0..3).filter(|&axis| cell.owns(axis)).map(move |axis| (cell, axis)))
    }

    /// The crossings of the edges of a patch.
    pub(super) fn crossings_of<'a>(
        &'a self,
        patch: u32,
        crossings: &'a [Crossing],
    ) -> impl Iterator<Item = &'a Crossing> {
        self.links.edges_of(patch).iter().map(|&edge| &crossings[edge as usize])
    }

    /// The vertex of the patch with the index `id`, and whether it was clamped to its cell.
    pub(super) fn vertex(
        &self,
        cell: &SurfaceCell,
        id: u32,
        crossings: &[Crossing],
        extra: &[(DVec3, DVec3)],
        options: MeshOptions,
        free: bool,
    ) -> (DVec3, bool) {
        let corner = self.world(cell.index, DVec3::ZERO);
        let planes = self.planes(cell, id, crossings, extra);
        let [lower, upper] = self.region(cell, if free { cell.free } else { 0 });
        let (vertex, clamped) = if options.sharp {
            let minimum = planes.minimum(lower, upper);
            let [lower, upper] = self.region(cell, 0);
            let is_within = minimum.point.cmpge(lower).all() && minimum.point.cmple(upper).all();
            let is_free = is_within && !minimum.clamped;
            let point = if is_free { planes.refined(minimum.point, lower, upper) } else { minimum.point };
            (point, minimum.clamped)
        } else {
            (self.on_trilinear(cell, planes.mean().clamp(lower, upper), lower, upper), false)
        };
        // The sum rounds; no vertex lies outside the box.
        ((corner + vertex).clamp(self.lower, self.upper), clamped)
    }

    /// The tangent planes of a patch and `extra` ones, relative to the lower corner of its cell.
    pub(super) fn planes(
        &self,
        cell: &SurfaceCell,
        id: u32,
        crossings: &[Crossing],
        extra: &[(DVec3, DVec3)],
    ) -> Planes {
        let corner = self.world(cell.index, DVec3::ZERO);
        let mut planes = Planes::new();
        for crossing in self.crossings_of(id, crossings) {
            planes.add(crossing.on_edge - corner, crossing.point - corner, crossing.normal);
        }
        for &(point, normal) in extra {
            planes.add_plane(point, normal);
        }
        planes
    }

    /// The region of the vertices of a cell, relative to its lower corner: the cell without a margin of [`MARGIN`], and
    /// the next cell across each face in the set `free`; all of it inside the box. The tip of a corner that holds no
    /// voxel centre lies in a next cell that is not crossed.
    pub(super) fn region(&self, cell: &SurfaceCell, free: u8) -> [DVec3; 2] {
        let mut lower = DVec3::splat(MARGIN);
        let mut upper = DVec3::splat(1.0 - MARGIN);
        for axis in 0..3 {
            let is_free = |side: usize| free >> (2 * axis + side) & 1 == 1;
            if is_free(0) {
                lower[axis] -= 1.0;
            }
            if is_free(1) {
                upper[axis] += 1.0;
            }
            // The faces of the box lie half a voxel outside the first and the last voxel centre.
            let box_lower = -0.5 - f64::from(cell.index[axis]);
            lower[axis] = lower[axis].max(box_lower);
            upper[axis] = upper[axis].min(box_lower + f64::from(self.cells.shape()[axis]));
        }
        [lower * self.spacing, upper * self.spacing]
    }

    /// A point of the cell moved onto the surface of its trilinear function.
    fn on_trilinear(&self, cell: &SurfaceCell, start: DVec3, lower: DVec3, upper: DVec3) -> DVec3 {
        if (0..3).any(|axis| self.is_padding(cell.index[axis], axis) || self.is_padding(cell.index[axis] + 1, axis)) {
            return start;
        }
        let mut p = start;
        for _ in 0..NEWTON_STEPS {
            let fraction = (p / self.spacing).as_vec3();
            let value = f64::from(trilinear(&cell.values, fraction));
            let gradient = trilinear_gradient(&cell.values, fraction).as_dvec3() / self.spacing;
            let square = gradient.length_squared();
            if square == 0.0 {
                break;
            }
            p = (p - gradient * (value / square)).clamp(lower, upper);
        }
        p
    }

    /// The quadrilaterals around all crossed edges, in their order.
    fn quads(&self, vertices: &[DVec3]) -> Vec<Quad> {
        self.edge_owners().map(|(cell, axis)| self.quad(cell, axis, vertices)).collect()
    }

    /// The quadrilateral around the crossed edge from the lower corner of `cell` along `axis`.
    fn quad(&self, cell: &SurfaceCell, axis: usize, vertices: &[DVec3]) -> Quad {
        let mut corners = self.links.patches_around(cell.edge(axis));
        // Seen from the outside end of the edge the order must be counter-clockwise.
        let far_is_outside = cell.inside & 1 == 1;
        if !far_is_outside {
            corners.reverse();
        }
        let start = self.world(cell.index, DVec3::ZERO);
        let places = corners.map(|i| (vertices[i as usize] - start) / self.spacing);
        Quad::new(corners, places, axis, far_is_outside)
    }
}

impl SurfaceMesh {
    fn without_unused_vertices(self) -> Self {
        let mut number = vec![u32::MAX; self.vertices.len()];
        self.faces.iter().flatten().for_each(|&i| number[i as usize] = 0);
        let mut vertices = Vec::new();
        for (number, &vertex) in number.iter_mut().zip(&self.vertices).filter(|(number, _)| **number == 0) {
            *number = vertices.len() as u32;
            vertices.push(vertex);
        }
        let faces = self.faces.iter().map(|face| face.map(|i| number[i as usize])).collect();
        Self { vertices, faces, clamped: self.clamped }
    }
}
