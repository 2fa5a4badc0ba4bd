//! Quadrilaterals divided at the crossed edges and at the faces of cells, so that they do not pass through each other.
//!
//! # Theory
//!
//! Two triangles across each quadrilateral may leave the cells of its corners, and then pass through another sheet of
//! the surface. A *divided* patch has faces that stay in its cell: a fan of triangles from its vertex to a closed
//! polygon on the boundary of the cell. The polygon has a point on each crossed edge of the patch and a point on each
//! face of the cell between two of those edges (T. Ju and T. Udeshi, "Intersection-free Contouring on an Octree Grid",
//! Pacific Graphics 2006). A quadrilateral with a divided corner becomes a fan around the point on its edge; the other
//! quadrilaterals stay as they are, so sharp edges do too.
//!
//! Seen from an inner point of a convex cell, its boundary is a sphere, and a simple polygon on it stays simple. The
//! fan of a patch therefore never crosses itself. The fans of several patches of one cell lie in the convex hulls of
//! their polygons if their vertices do. The hulls are disjoint: a patch that cuts off one corner, or the two ends of an
//! edge, is separated from all others by the plane through the neighbouring corners, since the point on a face that
//! cuts off a corner lies on that corner's side of the diagonal. Vertices of such cells move towards the mean of their
//! polygons until the fans are disjoint. Only two patches around opposite diagonals of the cell have no such plane.

use super::cells::SurfaceCell;
use super::patches::is_ambiguous;
use super::probes::{ExtraPlanes, SHARP_COSINE};
use super::qef::is_within;
use super::quad::Quad;
use super::{CrossedEdge, Crossing, LevelSurface, MARGIN};
use crate::geometry::triangles_cross;
use glam::{DMat2, DVec2, DVec3};
use std::collections::HashMap;

/// Weight of the pull of a point on a face towards the middle of the two crossings, relative to one plane.
const PULL: f64 = 1e-3;

/// Shares of the way to the mean of its polygon at which the vertex of a patch is tried.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];

/// A vertex of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub(super) enum Corner {
    /// The vertex of a patch.
    Patch(u32),
    /// The point on a crossed edge.
    Edge(u32),
    /// The point on the face between the cells of two patches, the smaller index first.
    Face(u32, u32),
}

/// The patches whose quadrilaterals are divided.
#[derive(Debug, Default)]
pub(super) struct Division {
    /// Whether each patch is divided; empty if none is.
    is_divided: Vec<bool>,
    /// Points on the faces between two patches, of which one is divided; world units.
    on_faces: HashMap<(u32, u32), DVec3>,
}

/// The face between two patches as a key.
fn face(a: u32, b: u32) -> (u32, u32) {
    (a.min(b), a.max(b))
}

impl Division {
    /// Whether no patch is divided.
    pub(super) fn is_empty(&self) -> bool {
        self.is_divided.is_empty()
    }

    pub(super) fn contains(&self, patch: u32) -> bool {
        self.is_divided.get(patch as usize).is_some_and(|&is_divided| is_divided)
    }

    /// Marks some patches as divided.
    fn add(&mut self, patches: &[u32], count: usize) {
        self.is_divided.resize(count, false);
        patches.iter().for_each(|&patch| self.is_divided[patch as usize] = true);
    }

    /// Calls `found` with the triangles of the quadrilateral around a crossed edge. `corners` are its patches,
    /// counter-clockwise seen from outside.
    pub(super) fn for_triangles(&self, edge: u32, corners: [u32; 4], quad: &Quad, mut found: impl FnMut([Corner; 3])) {
        if !corners.iter().any(|&patch| self.contains(patch)) {
            quad.triangles(corners).into_iter().for_each(|triangle| found(triangle.map(Corner::Patch)));
            return;
        }
        let (mut ring, mut count) = ([Corner::Edge(edge); 9], 0);
        let mut push = |corner| {
            ring[count] = corner;
            count += 1;
        };
        for i in 0..4 {
            let (here, next) = (corners[i], corners[(i + 1) % 4]);
            push(Corner::Patch(here));
            if self.contains(here) || self.contains(next) {
                let (a, b) = face(here, next);
                push(Corner::Face(a, b));
            }
        }
        ring[count] = ring[0];
        ring[..=count].windows(2).for_each(|pair| found([Corner::Edge(edge), pair[0], pair[1]]));
    }
}

impl LevelSurface {
    /// Divides some patches and all patches of their cells, and moves their vertices into their cells.
    pub(super) fn divide(
        &self,
        patches: &[u32],
        division: &mut Division,
        vertices: &mut [DVec3],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        is_sharp: bool,
    ) -> Vec<u32> {
        let cells = self.cells.of_patches(patches.iter().copied());
        let added: Vec<u32> = cells.iter().flat_map(|cell| cell.patch_ids()).collect();
        division.add(&added, self.cells.patch_count());
        for &id in &added {
            for &edge in self.links.edges_of(id) {
                let around = self.links.patches_around(edge);
                for (i, &here) in around.iter().enumerate() {
                    let next = around[(i + 1) % 4];
                    if here == id || next == id {
                        let place = || self.point_on_face(here, next, crossings, is_sharp);
                        division.on_faces.entry(face(here, next)).or_insert_with(place);
                    }
                }
            }
        }
        for cell in cells {
            for id in cell.patch_ids() {
                let corner = self.world(cell.index, DVec3::ZERO);
                let [lower, upper] = self.region(cell, 0);
                if !is_within(vertices[id as usize] - corner, [lower, upper]) {
                    let planes = self.planes(cell, id, crossings, extra.of(id));
                    let place = self.in_box(corner + planes.minimum(lower, upper).point);
                    vertices[id as usize] = self.apart_from_first(cell, id, place);
                }
            }
            if cell.patch_ids().len() > 1 {
                self.separate_fans(cell.patch_ids(), division, vertices, crossings);
            }
        }
        added
    }

    /// Moves the vertices of the patches of one cell towards the means of their polygons until their fans are disjoint.
    fn separate_fans(
        &self,
        patches: std::ops::Range<u32>,
        division: &Division,
        vertices: &mut [DVec3],
        crossings: &[Crossing],
    ) {
        let polygons: Vec<Vec<[DVec3; 2]>> = patches.clone().map(|id| self.polygon(id, division, crossings)).collect();
        let means: Vec<DVec3> = polygons
            .iter()
            .map(|sides| sides.iter().map(|side| side[0] + side[1]).sum::<DVec3>() / (2 * sides.len()) as f64)
            .collect();
        let starts: Vec<DVec3> = patches.clone().map(|id| vertices[id as usize]).collect();
        for share in SHARES {
            let places: Vec<DVec3> = starts.iter().zip(&means).map(|(start, &mean)| start.lerp(mean, share)).collect();
            let fan = |i: usize| polygons[i].iter().map(move |&[a, b]| (a, b));
            let crosses = (0..places.len()).any(|i| {
                (0..i).any(|j| {
                    fan(i).any(|(a, b)| fan(j).any(|(c, d)| triangles_cross([places[i], a, b], [places[j], c, d])))
                })
            });
            if !crosses || share == SHARES[SHARES.len() - 1] {
                patches.clone().zip(places).for_each(|(id, place)| vertices[id as usize] = place);
                return;
            }
        }
    }

    /// The sides of the polygon of a patch on the boundary of its cell, in any order.
    fn polygon(&self, id: u32, division: &Division, crossings: &[Crossing]) -> Vec<[DVec3; 2]> {
        let mut sides = Vec::new();
        for &edge in self.links.edges_of(id) {
            let around = self.links.patches_around(edge);
            for (i, &here) in around.iter().enumerate() {
                let next = around[(i + 1) % 4];
                if (here == id || next == id)
                    && let Some(&point) = division.on_faces.get(&face(here, next))
                {
                    sides.push([self.point_on_edge(edge, crossings), point]);
                }
            }
        }
        sides
    }

    /// The position of a vertex of the mesh.
    pub(super) fn place(
        &self,
        corner: Corner,
        division: &Division,
        vertices: &[DVec3],
        crossings: &[Crossing],
    ) -> DVec3 {
        match corner {
            Corner::Patch(id) => vertices[id as usize],
            Corner::Edge(edge) => self.point_on_edge(edge, crossings),
            Corner::Face(a, b) => division.on_faces.get(&(a, b)).copied().unwrap_or(vertices[a as usize]),
        }
    }

    /// The crossing of an edge, at a distance of [`MARGIN`] from its ends.
    fn point_on_edge(&self, edge: u32, crossings: &[Crossing]) -> DVec3 {
        let CrossedEdge { start, along } = self.edge(edge as usize);
        start + along * f64::from(crossings[edge as usize].share).clamp(MARGIN, 1.0 - MARGIN)
    }

    /// The point where the surface meets the face between the cells of two patches, between their common crossed
    /// edges: nearest to the lines in which the tangent planes there meet the face, if the surface `is_sharp`.
    fn point_on_face(&self, a: u32, b: u32, crossings: &[Crossing], is_sharp: bool) -> DVec3 {
        let mut common = self.links.edges_of(a).iter().filter(|edge| self.links.edges_of(b).contains(edge));
        // Two neighbouring patches have exactly two common edges.
        let (Some(&first), Some(&second)) = (common.next(), common.next()) else { return DVec3::ZERO };
        let [low, high] = {
            let cells = [a, b].map(|id| self.cells.of_patch(id));
            if cells[0].index.iter().sum::<i32>() < cells[1].index.iter().sum() { cells } else { [cells[1], cells[0]] }
        };
        let across = (0..3).find(|&axis| low.index[axis] != high.index[axis]).unwrap_or(0);
        let [u, v] = [(across + 1) % 3, (across + 2) % 3];
        let origin = self.world(high.index, DVec3::ZERO);
        let flat = |p: DVec3| DVec2::new(p[u], p[v]) / DVec2::new(self.spacing[u], self.spacing[v]);
        let points = [first, second].map(|edge| flat(self.point_on_edge(edge, crossings) - origin));
        let middle = 0.5 * (points[0] + points[1]);
        let mut point = middle;
        if is_sharp {
            let planes = [first, second].map(|edge| &crossings[edge as usize]);
            let best = self.nearest_to_lines(points, planes, [u, v]);
            // Tangents of a curve meet as far outside of it as the chord lies inside.
            let is_crease = planes[0].normal.dot(planes[1].normal) < SHARP_COSINE;
            point = if is_crease { best } else { 0.5 * (middle + best) };
        }
        let [lower, upper] = [self.within[0], self.within[1]].map(|corner| flat(corner - origin));
        point = point.max(lower).min(upper).clamp(DVec2::splat(MARGIN), DVec2::splat(1.0 - MARGIN));
        let axes = [first, second].map(|edge| self.cells.of_edge(edge).1);
        let has_several = |cell: &SurfaceCell| cell.patches().count() > 1;
        if axes[0] != axes[1] && (is_ambiguous(high.inside, 2 * across) || has_several(low) || has_several(high)) {
            // The corner that the segment cuts off lies on the lines of both edges.
            let along_u = usize::from(axes[0] != u);
            let corner = DVec2::new(points[1 - along_u].x, points[along_u].y).round();
            let from = point - corner;
            let sum = from.abs().element_sum();
            if sum > 1.0 - MARGIN {
                point = corner + from * ((1.0 - MARGIN) / sum);
            }
        }
        let mut place = origin;
        (place[u], place[v]) = (place[u] + point.x * self.spacing[u], place[v] + point.y * self.spacing[v]);
        place
    }

    /// The point of a face of a cell that is nearest to the lines of two tangent planes in it, with a pull towards the
    /// middle of the crossings. `points` are the crossings; all are in voxels along the axes of the face.
    fn nearest_to_lines(&self, points: [DVec2; 2], planes: [&Crossing; 2], [u, v]: [usize; 2]) -> DVec2 {
        let middle = 0.5 * (points[0] + points[1]);
        let mut matrix = DMat2::from_diagonal(DVec2::splat(2.0 * PULL));
        let mut vector = DVec2::ZERO;
        for (point, plane) in points.into_iter().zip(planes) {
            // The normal in voxels, and the height of the plane above the crossing along it.
            let scaled = plane.normal * self.spacing;
            let normal = DVec2::new(scaled[u], scaled[v]);
            let length = normal.length();
            if length > 0.0 {
                let (normal, height) = (normal / length, plane.height / length);
                matrix += DMat2::from_cols(normal * normal.x, normal * normal.y);
                vector += normal * (normal.dot(point - middle) + height);
            }
        }
        middle + matrix.inverse() * vector
    }
}
