//! Vertices and faces of the dual mesh.

use super::cells::{SurfaceCell, owner_of};
use super::probes::ExtraPlanes;
use super::qef::Planes;
use super::{Crossing, LevelSurface, MARGIN, MeshOptions};
use crate::volume::{trilinear, trilinear_gradient};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Number of steps of Newton's method onto the trilinear surface. Each squares the error, which is below a voxel at the
/// start.
const NEWTON_STEPS: usize = 4;

/// Triangles of a level set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// Counter-clockwise seen from the side of larger values.
    pub faces: Vec<[u32; 3]>,
    /// Number of vertices whose optimal position is outside the region around their cell in which the surface cannot
    /// fold. They lie on the border of that region.
    pub clamped: usize,
}

impl LevelSurface {
    /// The mesh over `crossings`, one entry per crossed edge as [`LevelSurface::crossings`] returns them, and over the
    /// planes that probes have found.
    pub fn mesh(&self, crossings: &[Crossing], extra: &ExtraPlanes, options: MeshOptions) -> SurfaceMesh {
        assert_eq!(crossings.len(), self.edge_count(), "one crossing for each crossed edge");
        let (vertices, clamped) = self.vertices(crossings, extra, options);
        let faces: Vec<[u32; 3]> = self
            .cells
            .cells()
            .par_iter()
            .flat_map_iter(|cell| (0..3).filter(|&axis| cell.owns(axis)).map(move |axis| (cell, axis)))
            .filter(|&(cell, axis)| options.capped || !crossings[cell.edge(axis) as usize].on_box)
            .flat_map_iter(|(cell, axis)| self.triangles(cell, axis, &vertices))
            .collect();
        let mesh = SurfaceMesh { vertices, faces, clamped };
        if options.capped { mesh } else { mesh.without_unused_vertices() }
    }

    /// The vertices of all patches, and the number of those that were clamped.
    pub(super) fn vertices(
        &self,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        options: MeshOptions,
    ) -> (Vec<DVec3>, usize) {
        let placed: Vec<(DVec3, bool)> = self
            .cells
            .cells()
            .par_iter()
            .flat_map_iter(|cell| {
                (cell.first_patch..)
                    .zip(cell.patches())
                    .map(move |(id, _)| self.vertex(cell, id, crossings, extra, options))
            })
            .collect();
        let mut vertices: Vec<DVec3> = placed.iter().map(|(vertex, _)| *vertex).collect();
        let mut clamped = placed.iter().filter(|(_, clamped)| *clamped).count();
        // Only planes of a source justify a vertex outside its cell; planes of the samples alone do not.
        if !extra.is_empty() {
            clamped -= self.free_clamped(&placed, &mut vertices, crossings, extra);
        }
        (vertices, clamped)
    }

    /// Moves clamped vertices to their best place up to a voxel outside their region, one after the other, if that
    /// folds no quadrilateral. A ridge or a corner may pass between the edges of the grid through a cell that has a
    /// patch of its own. Returns the number of vertices that moved.
    fn free_clamped(
        &self,
        placed: &[(DVec3, bool)],
        vertices: &mut [DVec3],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
    ) -> usize {
        let mut moved = 0;
        for cell in self.cells.cells() {
            for (id, patch) in (cell.first_patch..).zip(cell.patches()) {
                if !placed[id as usize].1 {
                    continue;
                }
                let corner = self.world(cell.index, DVec3::ZERO);
                let [lower, upper] = self.allowed(cell);
                let planes = self.planes(cell, id, crossings, extra);
                let best = planes.minimum(lower - self.spacing, upper + self.spacing).point;
                let clamped = vertices[id as usize];
                vertices[id as usize] = (corner + best).clamp(self.lower, self.upper);
                let folds = (0..12).filter(|edge| patch >> edge & 1 == 1).any(|edge| {
                    let (owner, axis) = owner_of(cell, edge);
                    self.cells.find(owner).is_none_or(|owner| self.folds(owner, axis, vertices))
                });
                if folds {
                    // Planes beyond the cell would bend the surface; the crossings alone may have a place inside.
                    let own = self.planes(cell, id, crossings, &ExtraPlanes::default()).minimum(lower, upper);
                    vertices[id as usize] = if own.clamped { clamped } else { corner + own.point };
                } else {
                    moved += 1;
                }
            }
        }
        moved
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
        extra: &ExtraPlanes,
        options: MeshOptions,
    ) -> (DVec3, bool) {
        let corner = self.world(cell.index, DVec3::ZERO);
        let planes = self.planes(cell, id, crossings, extra);
        let [lower, upper] = self.allowed(cell);
        let (vertex, clamped) = if options.sharp {
            let minimum = planes.minimum(lower, upper);
            (minimum.point, minimum.clamped)
        } else {
            // Smooth vertices stay in the cell, where its trilinear function holds.
            let (lower, upper) = (lower.max(DVec3::ZERO), upper.min(self.spacing));
            (self.on_trilinear(cell, planes.mean().clamp(lower, upper), lower, upper), false)
        };
        // The sum rounds; no vertex lies outside the box.
        ((corner + vertex).clamp(self.lower, self.upper), clamped)
    }

    /// The tangent planes of a patch, relative to the lower corner of its cell.
    fn planes(&self, cell: &SurfaceCell, id: u32, crossings: &[Crossing], extra: &ExtraPlanes) -> Planes {
        let corner = self.world(cell.index, DVec3::ZERO);
        let mut planes = Planes::new();
        for crossing in self.crossings_of(id, crossings) {
            planes.add(crossing.on_edge - corner, crossing.point - corner, crossing.normal);
        }
        for &(point, normal) in extra.of(id) {
            planes.add_plane(point, normal);
        }
        planes
    }

    /// The region of the vertices of a cell, relative to its lower corner: the cell without a margin of [`MARGIN`]; the
    /// next cell across a face as well if neither the face nor that cell is crossed; all of it inside the box. The tip
    /// of a corner that holds no voxel centre lies in such a next cell.
    pub(super) fn allowed(&self, cell: &SurfaceCell) -> [DVec3; 2] {
        let mut lower = DVec3::splat(MARGIN);
        let mut upper = DVec3::splat(1.0 - MARGIN);
        for axis in 0..3 {
            let is_free = |side: usize| cell.free >> (2 * axis + side) & 1 == 1;
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

    /// The corners of the quadrilateral around the crossed edge from the lower corner of `cell` along `axis`,
    /// counter-clockwise seen from outside, and twice the smaller area, voxels squared, of the two triangles of either
    /// division, seen along the edge.
    fn quad(&self, cell: &SurfaceCell, axis: usize, vertices: &[DVec3]) -> ([u32; 4], [f64; 2]) {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut quad = self.links.patches_around(cell.edge(axis));
        // Seen from the outside end of the edge the order must be counter-clockwise.
        let far_is_outside = cell.inside & 1 == 1;
        if !far_is_outside {
            quad.reverse();
        }
        let flat = quad.map(|i| {
            let p = (vertices[i as usize] - self.world(cell.index, DVec3::ZERO)) / self.spacing;
            let p = DVec2::new(p[u], p[v]);
            if far_is_outside { p } else { DVec2::new(p.y, p.x) }
        });
        let area = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[a]);
        (quad, [area(0, 1, 2).min(area(0, 2, 3)), area(1, 2, 3).min(area(1, 3, 0))])
    }

    /// Whether both divisions of a quadrilateral fold it, seen along its edge.
    fn folds(&self, cell: &SurfaceCell, axis: usize, vertices: &[DVec3]) -> bool {
        let (_, areas) = self.quad(cell, axis, vertices);
        areas.into_iter().all(|area| area <= MARGIN * MARGIN)
    }

    /// The two triangles across the crossed edge from the lower corner of `cell` along `axis`.
    fn triangles(&self, cell: &SurfaceCell, axis: usize, vertices: &[DVec3]) -> [[u32; 3]; 2] {
        let (quad, [first, second]) = self.quad(cell, axis, vertices);
        let [a, b, c, d] = quad;
        if self.prefers_first(first, second, quad, vertices) { [[a, b, c], [a, c, d]] } else { [[b, c, d], [b, d, a]] }
    }

    /// Whether a quadrilateral is better divided from its first to its third corner. `first` and `second` are twice the
    /// smaller area, voxels squared, of the two triangles of either division, as seen along the edge. A division that
    /// folds has a negative one. Of two divisions that do not fold, the one with the shorter diagonal is chosen.
    fn prefers_first(&self, first: f64, second: f64, [a, b, c, d]: [u32; 4], vertices: &[DVec3]) -> bool {
        let folds = |area: f64| area <= MARGIN * MARGIN;
        if folds(first) || folds(second) {
            return first >= second;
        }
        let length = |i: u32, j: u32| ((vertices[i as usize] - vertices[j as usize]) / self.spacing).length_squared();
        length(a, c) <= length(b, d)
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
