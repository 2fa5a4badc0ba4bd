//! Vertices and faces of the dual mesh.

use super::cells::{SurfaceCell, edges_from, patches_of};
use super::division::{Corner, Division};
use super::links::{PatchLinks, edges_of};
use super::patches::edge_corners;
use super::probes::{ExtraPlanes, NearInstances, PatchRegion, Place, SHARP_COSINE};
use super::qef::{Planes, is_within};
use super::quad::Quad;
use super::refine::{corner_normal, refine};
use super::{Crossing, LevelSurface, MARGIN, MeshOptions};
use crate::error::Error;
use crate::progress::Progress;
use crate::volume::{trilinear, trilinear_gradient};
use glam::DVec3;
use rayon::prelude::*;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};

/// Number of steps of Newton's method onto the trilinear surface. Each squares the error, which is below a voxel at the
/// start.
const NEWTON_STEPS: usize = 4;

/// Number of clamped vertices that one task processes.
const CHUNK: usize = 256;

/// Largest number of times that clamped vertices are tried at their best places.
const FREE_PASSES: usize = 4;

/// A corrected vertex does not move closer than this to another one of its quadrilaterals, voxels: the least distance
/// of vertices in different cells.
const APART: f64 = 2.0 * MARGIN;

/// Distance between the boundaries of the regions of the patches of one cell, voxels. A cell has four patches at most.
const INSET: f64 = MARGIN / 4.0;

/// A vertex on flat faces is corrected if the root of the sum of its squared distances to the planes of its patch is
/// larger, voxels.
const LEAST_ERROR: f64 = 0.005;

/// Largest correction of a vertex along an axis, voxels. Planes that move it farther belong to another feature.
const FARTHEST: f64 = 0.25;

/// Largest distance of a corrected vertex from a smooth surface, voxels.
const MOST_BALANCE: f64 = 0.05;

/// Triangles of a level set.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SurfaceMesh {
    /// Positions in world units.
    pub vertices: Vec<DVec3>,
    /// Counter-clockwise seen from the side of larger values.
    pub faces: Vec<[u32; 3]>,
    /// Number of vertices that are not at their optimal position, because it lies outside the region around their cell
    /// in which the surface cannot fold, or far from the source.
    pub clamped: usize,
}

/// The vertices of all patches.
#[derive(Debug)]
pub(super) struct Vertices {
    /// Positions in world units.
    pub places: Vec<DVec3>,
    /// Whether each vertex counts as clamped; see [`SurfaceMesh::clamped`].
    pub is_clamped: Vec<bool>,
}

impl Vertices {
    /// The number of clamped vertices.
    fn clamped(&self) -> usize {
        self.is_clamped.iter().filter(|&&is_clamped| is_clamped).count()
    }
}

/// A vertex that may move to `place`, world units.
#[derive(Debug, Clone, Copy)]
struct Loose<'a> {
    cell: &'a SurfaceCell,
    /// Its patch.
    id: u32,
    place: DVec3,
    /// Whether the place is farther than [`FARTHEST`] from the source close to it.
    is_far: bool,
}

impl LevelSurface {
    /// The mesh over `crossings`, one entry per crossed edge as [`LevelSurface::crossings`] returns them, and over the
    /// planes that probes have found.
    ///
    /// Everything that the faces do not need is freed before they are made.
    pub fn into_mesh(
        self,
        crossings: Vec<Crossing>,
        extra: ExtraPlanes,
        options: MeshOptions,
        progress: &Progress,
    ) -> Result<SurfaceMesh, Error> {
        let (mut vertices, mut quads) = self.settled(&crossings, &extra, options);
        let division = self.untangle(&mut vertices.places, &mut quads, &crossings, &extra, options.sharp, progress)?;
        let is_open = if options.capped { Vec::new() } else { on_box(&crossings) };
        // Flat faces of a source are reproduced by the vertices alone.
        let is_refined = options.sharp && options.capped && extra.nearby().is_some_and(|(_, is_flat)| !is_flat);
        let mut normals = if is_refined { self.patch_normals(&crossings) } else { Vec::new() };
        let mut mesh = if division.is_empty() {
            drop((self.cells, crossings));
            SurfaceMesh::new(vertices, &quads, &self.links, &is_open)
        } else {
            self.divided_mesh(vertices, &quads, &crossings, &division, &is_open, &mut normals)
        };
        drop((self.links, quads));
        if let Some((nearby, _)) = extra.nearby().filter(|_| !normals.is_empty()) {
            refine((&mut mesh.vertices, &mut mesh.faces), normals, nearby, self.spacing, self.within, progress)?;
        }
        Ok(mesh)
    }

    /// The mesh of all quadrilaterals, some of them divided.
    pub(super) fn divided_mesh(
        &self,
        vertices: Vertices,
        quads: &[Quad],
        crossings: &[Crossing],
        division: &Division,
        is_open: &[bool],
        normals: &mut Vec<DVec3>,
    ) -> SurfaceMesh {
        let clamped = vertices.clamped();
        let mut places = vertices.places;
        let mut added: HashMap<Corner, u32> = HashMap::new();
        let mut faces = Vec::with_capacity(2 * quads.len());
        for (edge, quad) in (0..).zip(quads) {
            if is_open.get(edge as usize) == Some(&true) {
                continue;
            }
            division.for_triangles(edge, corners(&self.links, edge, quad), quad, |triangle| {
                faces.push(triangle.map(|corner| match corner {
                    Corner::Patch(id) => id,
                    corner => *added.entry(corner).or_insert_with(|| {
                        places.push(self.place(corner, division, &places, crossings));
                        if !normals.is_empty() {
                            normals.push(corner_normal(corner, normals, crossings));
                        }
                        places.len() as u32 - 1
                    }),
                }));
            });
        }
        let mesh = SurfaceMesh { vertices: places, faces, clamped };
        if is_open.is_empty() { mesh } else { mesh.without_unused_vertices() }
    }

    /// The vertices of all patches and the quadrilaterals around all crossed edges.
    pub(super) fn settled(
        &self,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        options: MeshOptions,
    ) -> (Vertices, Vec<Quad>) {
        assert_eq!(crossings.len(), self.edge_count(), "one crossing for each crossed edge");
        // Only planes of a source justify a vertex outside its cell; planes of the samples alone do not.
        let mut vertices = self.vertices(crossings, extra, options, options.sharp && !extra.is_empty());
        let quads = self.settle(&mut vertices, crossings, extra);
        (vertices, quads)
    }

    /// The vertices of all patches. `free` vertices may lie outside their cell where that folds no face.
    pub(super) fn vertices(
        &self,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        options: MeshOptions,
        free: bool,
    ) -> Vertices {
        let is_clamped: Vec<AtomicBool> = (0..self.cells.patch_count()).map(|_| AtomicBool::new(false)).collect();
        let nearby = extra.nearby().filter(|_| options.sharp);
        let places = self.cells.for_patches(DVec3::ZERO, |cells, places| {
            let mut waiting = Vec::new();
            for ((cell, id), to) in patches_of(cells).zip(&mut *places) {
                let planes = self.planes(cell, id, crossings, extra.of(id));
                let (place, clamped) = self.vertex(cell, &planes, options, free);
                let place = self.apart_from_first(cell, id, place);
                *to = place;
                is_clamped[id as usize].store(clamped, Ordering::Relaxed);
                let Some((_, is_flat)) = nearby.filter(|_| !clamped) else { continue };
                let error = || planes.error(place - self.world(cell.index, DVec3::ZERO));
                if !is_flat || error() > (LEAST_ERROR * self.spacing.min_element()).powi(2) {
                    waiting.push(Loose { cell, id, place, is_far: false });
                }
            }
            if let Some(nearby) = nearby {
                self.correct(&mut waiting, false, crossings, extra, nearby);
                let first = cells[0].first_patch;
                for vertex in &waiting {
                    places[(vertex.id - first) as usize] = vertex.place;
                    is_clamped[vertex.id as usize].store(vertex.is_far, Ordering::Relaxed);
                }
            }
        });
        let is_clamped = is_clamped.into_iter().map(AtomicBool::into_inner).collect();
        let mut vertices = Vertices { places, is_clamped };
        if !extra.is_empty() {
            self.free_clamped(&mut vertices, crossings, extra);
        }
        vertices
    }

    /// Corrects vertices by the planes of the source close to them; see [`super::probes`]. They move within their
    /// regions, or within a voxel of them if they are `free`. `is_flat` states that the source consists of flat faces.
    fn correct(
        &self,
        vertices: &mut [Loose<'_>],
        free: bool,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        (nearby, is_flat): (&NearInstances, bool),
    ) {
        let place = |vertex: &Loose<'_>| Place { point: vertex.place, is_sharp: !extra.of(vertex.id).is_empty() };
        let targets: Vec<Place> = vertices.iter().map(place).collect();
        let mut found = Vec::with_capacity(targets.len());
        nearby(&targets, &mut |row, point, normal| found.push((row, point, normal)));
        let mut own = Vec::new();
        for near in found.chunk_by(|a, b| a.0 == b.0) {
            let Loose { cell, id, place, is_far } = &mut vertices[near[0].0];
            let corner = self.world(cell.index, DVec3::ZERO);
            let before = *place - corner;
            let [lower, upper] = if free { self.region_beyond(cell) } else { self.region(cell, cell.free) };
            own.clear();
            let region = PatchRegion::new(self, cell, *id, crossings, if free { 1.0 } else { 0.0 });
            near.iter().for_each(|&(_, point, normal)| region.join(&mut own, point, normal));
            let is_crease = own.iter().any(|plane| plane.1.dot(own[0].1) < SHARP_COSINE);
            let after = if is_flat || is_crease {
                let mut planes = Planes::new();
                own.iter().for_each(|&(point, normal)| planes.add_near(point, normal));
                // An edge may pass beside the cell. Planes that do not meet in it belong to a corner outside, and on
                // smooth parts vertices slightly outside balance the faces.
                let best = planes.moved(before, lower, upper);
                let meet = planes.error(best) <= (LEAST_ERROR * self.spacing.min_element()).powi(2);
                let to_edge = is_crease && meet && is_within(before, [lower, upper]);
                if to_edge { best } else { planes.refined(before, lower, upper) }
            } else {
                // The planes around a sharp vertex balance the curvature already.
                let is_sharp = targets[near[0].0].is_sharp;
                let planes = || self.planes(cell, *id, crossings, &own);
                let best = if is_sharp { before } else { planes().minimum(lower, upper).point };
                // Where the curvature is large, the planes meet far outside the surface.
                let most = MOST_BALANCE * self.spacing.min_element();
                own.first().map_or(best, |&(point, normal)| {
                    let height = (best - point).dot(normal);
                    (best - normal * (height - height.clamp(-most, most))).clamp(lower, upper)
                })
            };
            if !own.is_empty() && self.is_near(after, before) {
                *place = self.in_box(corner + after);
            }
            *is_far = near.iter().all(|(_, point, _)| !self.is_near(*place, *point));
        }
    }

    /// Moves clamped vertices to their best place up to a voxel outside their region, one after the other, if that
    /// folds no quadrilateral and the source is close to the place; they are then no longer clamped. A ridge or a
    /// corner may pass between the edges of the grid through a cell that has a patch of its own. Planes may also meet
    /// where another part of the source cuts their edge off, as at the crest of a thread.
    fn free_clamped(&self, vertices: &mut Vertices, crossings: &[Crossing], extra: &ExtraPlanes) {
        let Vertices { places: vertices, is_clamped } = vertices;
        let clamped = patches_of(self.cells.cells()).filter(|&(_, id)| is_clamped[id as usize]);
        let mut corrected: Vec<Loose<'_>> = clamped
            .collect::<Vec<_>>()
            .into_par_iter()
            .with_min_len(CHUNK)
            .map(|(cell, id)| {
                let [lower, upper] = self.region_beyond(cell);
                let best = self.planes(cell, id, crossings, extra.of(id)).minimum(lower, upper).point;
                Loose { cell, id, place: self.in_box(self.world(cell.index, DVec3::ZERO) + best), is_far: false }
            })
            .collect();
        let best: Vec<DVec3> = corrected.iter().map(|vertex| vertex.place).collect();
        if let Some(nearby) = extra.nearby() {
            let parts = corrected.par_chunks_mut(CHUNK);
            parts.for_each(|vertices| self.correct(vertices, true, crossings, extra, nearby));
        }
        // Vertices at their corrected places, with their best places where the correction is small.
        let with_best = corrected.into_iter().zip(best).map(|(vertex, best)| {
            let is_small = self.is_near(best, vertex.place);
            (vertex, is_small.then_some(best))
        });
        let (far, mut waiting): (Vec<_>, Vec<_>) = with_best.partition(|(vertex, _)| vertex.is_far);
        // A vertex that cannot move at first may do so when its neighbours have moved.
        for _ in 0..FREE_PASSES {
            let before = waiting.len();
            waiting.retain(|&(Loose { id, place, .. }, best)| {
                // Two vertices must not have the same place, as at a corner.
                let is_apart = self.is_apart(id, place, vertices);
                let has_moved = (is_apart && self.moves_to(id, place, vertices))
                    || best.is_some_and(|best| self.moves_to(id, best, vertices));
                is_clamped[id as usize] = !has_moved;
                !has_moved
            });
            if waiting.len() == before {
                break;
            }
        }
        waiting.retain(|&(Loose { id, place, .. }, best)| {
            // The error decreases all the way to the best place.
            let (start, end) = (vertices[id as usize], best.unwrap_or(place));
            ![0.75, 0.5, 0.25].into_iter().any(|share| self.moves_to(id, start.lerp(end, share), vertices))
        });
        let staying: Vec<Loose<'_>> = far.into_iter().chain(waiting).map(|(vertex, _)| vertex).collect();
        let parts = staying.par_chunks(CHUNK).map(|clamped| self.places_near(clamped, vertices, crossings, extra));
        let places: Vec<DVec3> = parts.collect::<Vec<_>>().concat();
        staying.iter().zip(places).for_each(|(vertex, place)| vertices[vertex.id as usize] = place);
    }

    /// The best places of the planes at the crossings of clamped vertices, since planes beyond the cell would bend the
    /// surface. A place that is not close to the source gives way to the place of the vertex, or to the mean of the
    /// crossings.
    fn places_near(
        &self,
        clamped: &[Loose<'_>],
        vertices: &[DVec3],
        crossings: &[Crossing],
        extra: &ExtraPlanes,
    ) -> Vec<DVec3> {
        let choices = clamped.iter().flat_map(|&Loose { cell, id, .. }| {
            let own = self.planes(cell, id, crossings, &[]);
            let corner = self.world(cell.index, DVec3::ZERO);
            let [lower, upper] = self.region(cell, cell.free);
            let best = own.minimum(lower, upper);
            let start = vertices[id as usize];
            let [lower, upper] = self.region(cell, 0);
            let mean = self.in_box(corner + own.mean().clamp(lower, upper));
            [if best.clamped { start } else { corner + best.point }, start, mean]
        });
        let places: Vec<Place> = choices.map(|point| Place { point, is_sharp: false }).collect();
        let mut distances = vec![0.0; places.len()];
        if let Some((nearby, _)) = extra.nearby() {
            distances.fill(f64::INFINITY);
            nearby(&places, &mut |i, point, _| {
                let away = ((point - places[i].point) / self.spacing).length();
                distances[i] = distances[i].min(if away > FARTHEST { away } else { 0.0 });
            });
        }
        let choices = places.as_chunks::<3>().0.iter().zip(distances.as_chunks::<3>().0);
        let nearest = |(places, distances): (&[Place; 3], &[f64; 3])| {
            let nearest = (0..3).min_by(|&a, &b| distances[a].total_cmp(&distances[b])).unwrap_or(0);
            places[nearest].point
        };
        choices.map(nearest).collect()
    }

    /// Whether two places differ by [`FARTHEST`] or less along each axis.
    fn is_near(&self, place: DVec3, other: DVec3) -> bool {
        (other - place).abs().cmple(self.spacing * FARTHEST).all()
    }

    /// Whether a place, world units, is at least [`APART`] from all other vertices of the quadrilaterals at a patch.
    fn is_apart(&self, id: u32, place: DVec3, vertices: &[DVec3]) -> bool {
        let mut others = self.links.edges_of(id).iter().flat_map(|&edge| self.links.patches_around(edge));
        others.all(|other| other == id || ((vertices[other as usize] - place) / self.spacing).length() >= APART)
    }

    /// Moves the vertex of a patch to a place, world units, unless that folds a quadrilateral. Returns whether it
    /// moved.
    fn moves_to(&self, id: u32, place: DVec3, vertices: &mut [DVec3]) -> bool {
        let before = std::mem::replace(&mut vertices[id as usize], place);
        let folds = self.folds_around(id, vertices);
        if folds {
            vertices[id as usize] = before;
        }
        !folds
    }

    /// Whether a quadrilateral at the vertex of a patch is folded.
    pub(super) fn folds_around(&self, id: u32, vertices: &[DVec3]) -> bool {
        self.links.edges_of(id).iter().any(|&edge| {
            let (owner, axis) = self.cells.of_edge(edge);
            self.quad(owner, axis, vertices).folds
        })
    }

    /// Computes the quadrilaterals at the vertices of some patches again. Returns their crossed edges.
    pub(super) fn update_quads(&self, patches: &[u32], vertices: &[DVec3], quads: &mut [Quad]) -> Vec<u32> {
        let edges: Vec<u32> = patches.iter().flat_map(|&patch| self.links.edges_of(patch)).copied().collect();
        for &edge in &edges {
            let (cell, axis) = self.cells.of_edge(edge);
            quads[edge as usize] = self.quad(cell, axis, vertices);
        }
        edges
    }

    /// The crossings of the edges of a patch.
    pub(super) fn crossings_of<'a>(
        &'a self,
        patch: u32,
        crossings: &'a [Crossing],
    ) -> impl Iterator<Item = &'a Crossing> {
        self.links.edges_of(patch).iter().map(|&edge| &crossings[edge as usize])
    }

    /// The vertex of a patch with the tangent planes `planes`, and whether it was clamped to its cell.
    pub(super) fn vertex(
        &self,
        cell: &SurfaceCell,
        planes: &Planes,
        options: MeshOptions,
        free: bool,
    ) -> (DVec3, bool) {
        let corner = self.world(cell.index, DVec3::ZERO);
        let [lower, upper] = self.region(cell, if free { cell.free } else { 0 });
        let (vertex, clamped) = if options.sharp {
            let minimum = planes.minimum(lower, upper);
            let [lower, upper] = self.region(cell, 0);
            let is_free = is_within(minimum.point, [lower, upper]) && !minimum.clamped;
            let point = if is_free { planes.refined(minimum.point, lower, upper) } else { minimum.point };
            (point, minimum.clamped)
        } else if self.is_exact {
            // Tangent planes of a curved surface meet as far outside of it as the mean of the crossings lies inside.
            (0.5 * (planes.mean().clamp(lower, upper) + planes.minimum(lower, upper).point), false)
        } else {
            (self.on_trilinear(cell, planes.mean().clamp(lower, upper), lower, upper), false)
        };
        // The sum rounds; no vertex lies outside the box.
        (self.in_box(corner + vertex), clamped)
    }

    /// A place moved away from the margin of its cell if the patch is not the first one of the cell. Otherwise vertices
    /// of several patches at the margin may lie on one line, and a vertex on a face of another sheet. Faces of the box
    /// are no margin.
    pub(super) fn apart_from_first(&self, cell: &SurfaceCell, id: u32, place: DVec3) -> DVec3 {
        let step = f64::from(id - cell.first_patch) * INSET * self.spacing;
        let [lower, upper] = [MARGIN, 1.0 - MARGIN].map(|share| self.world(cell.index, DVec3::splat(share)));
        let near = 0.5 * INSET * self.spacing;
        let inner = DVec3::select((place - lower).abs().cmple(near), lower + step, place);
        DVec3::select((place - upper).abs().cmple(near), upper - step, inner)
    }

    /// The tangent planes of a patch and `extra` ones, relative to the lower corner of its cell.
    pub(super) fn planes(
        &self,
        cell: &SurfaceCell,
        id: u32,
        crossings: &[Crossing],
        extra: &[(DVec3, DVec3)],
    ) -> Planes {
        let mut planes = Planes::new();
        // A cell has four patches at most, so the patch with this index is there.
        let edges = cell.patches().nth((id - cell.first_patch) as usize).unwrap_or(0);
        for (edge, crossing) in edges_of(edges).zip(self.crossings_of(id, crossings)) {
            let low = edge_corners(edge)[0];
            let mut on_edge = DVec3::new((low & 1) as f64, (low >> 1 & 1) as f64, (low >> 2) as f64);
            on_edge[edge / 4] = f64::from(crossing.share);
            planes.add(on_edge * self.spacing, crossing.normal, crossing.height);
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

    /// The region of a vertex outside its cell, relative to the lower corner of the cell: a voxel more on all sides.
    fn region_beyond(&self, cell: &SurfaceCell) -> [DVec3; 2] {
        let [lower, upper] = self.region(cell, cell.free);
        [lower - self.spacing, upper + self.spacing]
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
    pub(super) fn quads(&self, vertices: &[DVec3]) -> Vec<Quad> {
        self.cells.for_edges(Quad::default(), |cells, quads| {
            for ((cell, axis), quad) in edges_from(cells).zip(quads) {
                *quad = self.quad(cell, axis, vertices);
            }
        })
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
        Quad::new(places, axis, far_is_outside)
    }
}

/// The vertices of the quadrilateral around a crossed edge, counter-clockwise seen from outside.
pub(super) fn corners(links: &PatchLinks, edge: u32, quad: &Quad) -> [u32; 4] {
    let mut corners = links.patches_around(edge);
    if !quad.far_is_outside {
        corners.reverse();
    }
    corners
}

/// Whether each crossed edge leaves the box.
pub(super) fn on_box(crossings: &[Crossing]) -> Vec<bool> {
    crossings.iter().map(|crossing| crossing.on_box).collect()
}

impl SurfaceMesh {
    /// The mesh of all quadrilaterals, without those around the edges that `is_open` marks; it may be empty.
    fn new(vertices: Vertices, quads: &[Quad], links: &PatchLinks, is_open: &[bool]) -> Self {
        let mut faces = vec![[[0; 3]; 2]; quads.len()];
        let numbered = faces.par_iter_mut().zip(quads.par_iter().enumerate());
        numbered.for_each(|(faces, (edge, quad))| *faces = quad.triangles(corners(links, edge as u32, quad)));
        let clamped = vertices.clamped();
        let capped = Self { vertices: vertices.places, faces: Vec::new(), clamped };
        if is_open.is_empty() {
            return Self { faces: faces.into_flattened(), ..capped };
        }
        let mut is_open = is_open.iter();
        faces.retain(|_| is_open.next().is_some_and(|is_open| !is_open));
        Self { faces: faces.into_flattened(), ..capped }.without_unused_vertices()
    }

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
