//! Tangent planes of the source around the vertices, beside those at the crossings.
//!
//! The tip of an edge or corner may lie between the edges of the grid. Then the crossings of a patch do not contain all
//! faces that meet there. A vertex is *sharp* if its patch, or a neighbouring patch, has different normals. For a sharp
//! vertex the source is evaluated at points around it, and the tangent planes found there are added to the planes of
//! the crossings.
//!
//! Planes up to a voxel away do not meet on the surface where it is curved. A vertex within its cell, or the best place
//! of a vertex outside its cell, is therefore finally corrected: the source is evaluated close to it, at [`NEAR_STEP`]
//! around a sharp vertex, otherwise at the vertex itself ([`ExtraPlanes::with_nearby`]). A vertex at a crease, or on
//! small flat faces, moves onto the planes found. On a curved smooth part the plane joins the planes of the patch: the
//! vertex stays slightly outside, and the faces between vertices slightly inside, so that the volume is kept. Crossings
//! of a mesh have its faces as planes, so a vertex that lies on all of them needs no correction.

use super::cells::{SurfaceCell, patches_of};
use super::{Crossing, LevelSurface, MeshOptions};
use crate::error::Error;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// Patches with normals farther apart than the angle with this cosine, 18 degrees, are sharp.
pub(super) const SHARP_COSINE: f64 = 0.95;

/// Probes around a sharp vertex lie this far from it along each axis, voxels.
const STEP: f64 = 0.4;

/// Probes that correct a vertex lie this far from it along each axis, voxels. Within this distance the source is flat
/// but for its creases.
pub(crate) const NEAR_STEP: f64 = 0.1;

/// A plane is added to a patch if its point lies at most this far outside the region where the vertex may lie, voxels.
const REACH: f64 = 0.1;

/// A plane is added to a patch if the cosine between its normal and the mean normal of the patch is larger. Planes with
/// a smaller cosine belong to the other side of a thin wall.
const OTHER_SIDE: f64 = -0.1;

/// A plane within this angle (its cosine) and distance (voxels) of another plane of the patch is left out.
const SAME: (f64, f64) = (0.9999, 1e-3);

/// Number of times that a vertex of a mesh is probed at most. The second probes lie around the place where the planes
/// of the first have put it.
const ROUNDS: usize = 2;

/// Number of cells between two checks of the progress.
const CHUNK: usize = 256;

/// A vertex that planes have moved farther than this along an axis is probed again at its new place, voxels.
const MOVED: f64 = 0.1;

/// Points where the source is evaluated.
#[derive(Debug, Default)]
pub struct Probes {
    /// World positions.
    pub points: Vec<DVec3>,
    /// Patch of each point, in ascending order.
    patches: Vec<u32>,
}

/// A vertex whose place the source corrects.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place {
    /// World position.
    pub point: DVec3,
    /// Whether several tangent planes meet near it; else one plane suffices.
    pub is_sharp: bool,
}

/// Evaluates the tangent planes close to some places: the index of the place, a point of the plane and its normal are
/// passed to the second argument. The planes of one place follow each other; the places may come in any order.
pub(crate) type NearInstances = dyn Fn(&[Place], &mut dyn FnMut(usize, DVec3, DVec3)) + Send + Sync;

/// Planes that joined the patches: a point, relative to the lower corner of the cell, and a unit normal.
#[derive(Default)]
pub struct ExtraPlanes {
    /// First plane of each patch, and the number of planes at the end; empty without planes.
    firsts: Vec<u32>,
    planes: Vec<(DVec3, DVec3)>,
    /// Evaluates planes close to the vertices when they are placed, so that those planes are not stored.
    nearby: Option<Box<NearInstances>>,
    /// Whether the source consists of flat faces.
    is_flat: bool,
}

impl ExtraPlanes {
    /// `counts` has the number of planes of each patch.
    fn new(counts: impl Iterator<Item = u32>, planes: Vec<(DVec3, DVec3)>) -> Self {
        let ends = counts.scan(0, |end, count| {
            *end += count;
            Some(*end)
        });
        Self { firsts: std::iter::once(0).chain(ends).collect(), planes, nearby: None, is_flat: false }
    }

    /// These planes, and those that `nearby` evaluates close to the vertices. `is_flat` states that the source consists
    /// of flat faces.
    pub(crate) fn with_nearby(self, nearby: Box<NearInstances>, is_flat: bool) -> Self {
        Self { nearby: Some(nearby), is_flat, ..self }
    }

    /// Whether no plane has joined.
    pub(super) fn is_empty(&self) -> bool {
        self.planes.is_empty() && self.nearby.is_none()
    }

    /// Evaluates the planes close to vertices, and whether the source consists of flat faces.
    pub(super) fn nearby(&self) -> Option<(&NearInstances, bool)> {
        self.nearby.as_deref().map(|nearby| (nearby, self.is_flat))
    }

    /// The planes of a patch.
    pub(super) fn of(&self, patch: u32) -> &[(DVec3, DVec3)] {
        match self.firsts.get(patch as usize..patch as usize + 2) {
            Some(&[first, end]) => &self.planes[first as usize..end as usize],
            _ => &[],
        }
    }
}

/// A patch that planes may join.
pub(super) struct PatchRegion<'a> {
    surface: &'a LevelSurface,
    /// Lower corner of its cell, world units.
    corner: DVec3,
    /// The region of its vertex, relative to the corner.
    lower: DVec3,
    upper: DVec3,
    /// Mean normal of its crossings.
    normal: DVec3,
}

impl<'a> PatchRegion<'a> {
    /// The vertex may lie `beyond` voxels outside the region of its cell.
    pub(super) fn new(
        surface: &'a LevelSurface,
        cell: &SurfaceCell,
        id: u32,
        crossings: &[Crossing],
        beyond: f64,
    ) -> Self {
        let [lower, upper] = surface.region(cell, cell.free);
        let [lower, upper] = [lower - beyond * surface.spacing, upper + beyond * surface.spacing];
        let normal: DVec3 = surface.crossings_of(id, crossings).map(|crossing| crossing.normal).sum();
        let corner = surface.world(cell.index, DVec3::ZERO);
        Self { surface, corner, lower, upper, normal: normal.normalize_or_zero() }
    }

    /// Adds the plane through the world position `point` to `planes`, unless it is not finite, does not belong to the
    /// patch, or is known already.
    pub(super) fn join(&self, planes: &mut Vec<(DVec3, DVec3)>, point: DVec3, normal: DVec3) {
        let Some(normal) = normal.try_normalize().filter(|_| point.is_finite()) else { return };
        let point = point - self.corner;
        let reach = self.surface.spacing * REACH;
        let is_near = point.cmpge(self.lower - reach).all() && point.cmple(self.upper + reach).all();
        if !is_near || normal.dot(self.normal) <= OTHER_SIDE {
            return;
        }
        let near = SAME.1 * self.surface.spacing.min_element();
        let is_same = |&(other, direction): &(DVec3, DVec3)| {
            direction.dot(normal) >= SAME.0 && direction.dot(point - other).abs() <= near
        };
        if !planes.iter().any(is_same) {
            planes.push((point, normal));
        }
    }
}

/// Number of probes of a sharp vertex.
pub(crate) const PROBES: usize = 7;

/// A point and the six points at the distance `step` from it along the axes.
pub(crate) fn around(point: DVec3, step: DVec3) -> [DVec3; PROBES] {
    let [x, y, z] = DVec3::AXES.map(|axis| axis * step);
    [DVec3::ZERO, x, -x, y, -y, z, -z].map(|offset| point + offset)
}

impl LevelSurface {
    /// The probes of all vertices, or only the probes of the sharp vertices.
    pub fn probes(&self, crossings: &[Crossing], extra: &ExtraPlanes, sharp_only: bool) -> Probes {
        let is_sharp = self.sharp_patches(crossings);
        let options = MeshOptions { sharp: true, capped: true };
        let vertices = self.vertices(crossings, extra, options, true).places;
        let found: Vec<(u32, DVec3)> = (0..vertices.len())
            .into_par_iter()
            .filter(|&id| !sharp_only || is_sharp[id])
            .flat_map_iter(|id| {
                let places = around(vertices[id], STEP * self.spacing);
                places.into_iter().take(if is_sharp[id] { PROBES } else { 1 }).map(move |place| (id as u32, place))
            })
            .collect();
        let (patches, points) = found.into_iter().unzip();
        Probes { points, patches }
    }

    /// The planes around all sharp vertices. `planes` evaluates the tangent planes nearest to the probes of a vertex,
    /// world positions, and appends them to its last argument: a point and a unit normal each. Its first argument
    /// comes from `init`, one for some consecutive cells. Its third argument is a point of the surface near the vertex.
    /// Its fourth argument lists the faces whose planes the patch has already.
    pub(crate) fn planes_around<S>(
        &self,
        crossings: &[Crossing],
        init: impl Fn() -> S + Sync,
        planes: impl Fn(&mut S, &[DVec3; PROBES], DVec3, &mut Vec<u32>, &mut Vec<(DVec3, DVec3)>) + Sync,
        progress: &Progress,
    ) -> Result<ExtraPlanes, Error> {
        let is_sharp = self.sharp_patches(crossings);
        let options = MeshOptions { sharp: true, capped: true };
        let chunks = self.cells.cells().par_chunks(CHUNK).map(|cells| {
            let (mut counts, mut all) = (Vec::with_capacity(cells.len()), Vec::new());
            let (mut own, mut known, mut found) = (Vec::new(), Vec::new(), Vec::new());
            let mut state = init();
            for (cell, id) in patches_of(cells) {
                own.clear();
                known.clear();
                if is_sharp[id as usize] {
                    let region = PatchRegion::new(self, cell, id, crossings, 0.0);
                    let mut before = DVec3::INFINITY;
                    let mut near = self.point_near(id, crossings);
                    for _ in 0..ROUNDS {
                        let planes_of_patch = self.planes(cell, id, crossings, &own);
                        let vertex = self.vertex(cell, &planes_of_patch, options, true).0;
                        if (vertex - before).abs().cmple(self.spacing * MOVED).all() {
                            break;
                        }
                        before = vertex;
                        planes(&mut state, &around(vertex, STEP * self.spacing), near, &mut known, &mut found);
                        for (point, normal) in found.drain(..) {
                            near = point;
                            region.join(&mut own, point, normal);
                        }
                    }
                }
                counts.push(own.len() as u32);
                all.append(&mut own);
            }
            progress.advance(cells.len() as u64).map(|()| (counts, all))
        });
        let chunks = chunks.collect::<Result<Vec<_>, _>>()?;
        let counts = chunks.iter().flat_map(|(counts, _)| counts.iter().copied());
        let planes = chunks.iter().flat_map(|(_, planes)| planes.iter().copied()).collect();
        Ok(ExtraPlanes::new(counts, planes))
    }

    /// A point of the plane at the first crossing of a patch, world units.
    fn point_near(&self, id: u32, crossings: &[Crossing]) -> DVec3 {
        // A patch has three crossed edges or more.
        let edge = self.links.edges_of(id)[0] as usize;
        let crossing = &crossings[edge];
        self.edge(edge).at(crossing.share) + crossing.normal * crossing.height
    }

    /// Patches with different normals, and their neighbours.
    fn sharp_patches(&self, crossings: &[Crossing]) -> Vec<bool> {
        let own = self.cells.for_patches(false, |cells, is_sharp| {
            for ((_, id), is_sharp) in patches_of(cells).zip(is_sharp) {
                let mut normals = self.crossings_of(id, crossings).map(|crossing| crossing.normal);
                let first = normals.next().unwrap_or(DVec3::X);
                // The angle to the first normal is at least half of the largest angle.
                *is_sharp = normals.any(|normal| normal.dot(first) < SHARP_COSINE);
            }
        });
        let mut all = own.clone();
        for edge in 0..self.edge_count() as u32 {
            let around = self.links.patches_around(edge);
            if around.iter().any(|&patch| own[patch as usize]) {
                around.iter().for_each(|&patch| all[patch as usize] = true);
            }
        }
        all
    }

    /// Joins the planes through `points` with `normals`, one for each probe, to the patches of the probes. Planes that
    /// are not finite, do not belong to the patch or are known already are left out.
    pub fn join_planes(
        &self,
        crossings: &[Crossing],
        extra: &ExtraPlanes,
        probes: &Probes,
        points: &[DVec3],
        normals: &[DVec3],
    ) -> ExtraPlanes {
        let cells = self.cells.cells();
        let joined: Vec<Vec<(DVec3, DVec3)>> = cells
            .par_iter()
            .flat_map_iter(|cell| (cell.first_patch..).zip(cell.patches()).map(move |(id, _)| (cell, id)))
            .map(|(cell, id)| {
                let first = probes.patches.partition_point(|&other| other < id);
                let count = probes.patches[first..].iter().take_while(|&&other| other == id).count();
                let rows = first..first + count;
                let region = PatchRegion::new(self, cell, id, crossings, 0.0);
                let mut planes = extra.of(id).to_vec();
                for (&point, &normal) in points[rows.clone()].iter().zip(&normals[rows]) {
                    region.join(&mut planes, point, normal);
                }
                planes
            })
            .collect();
        ExtraPlanes::new(joined.iter().map(|planes| planes.len() as u32), joined.concat())
    }
}
