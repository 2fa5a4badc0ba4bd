//! Tangent planes of the source around the vertices, beside those at the crossings.
//!
//! The tip of an edge or corner may lie between the edges of the grid. Then the crossings of a patch do not contain all
//! faces that meet there. A vertex is *sharp* if its patch, or a neighbouring patch, has different normals. For a sharp
//! vertex the source is evaluated at points around it, and the tangent planes found there are added to the planes of
//! the crossings. All other vertices have one probe, at the vertex itself, which moves it onto the surface.

use super::cells::SurfaceCell;
use super::{Crossing, LevelSurface, MeshOptions};
use glam::DVec3;
use rayon::prelude::*;

/// Patches with normals farther apart than the angle with this cosine, 18 degrees, are sharp.
const SHARP_COSINE: f64 = 0.95;

/// Probes around a sharp vertex lie this far from it along each axis, voxels.
const STEP: f64 = 0.4;

/// A plane is added to a patch if its point lies at most this far outside the region where the vertex may lie, voxels.
const REACH: f64 = 0.1;

/// A plane is added to a patch if the cosine between its normal and the mean normal of the patch is larger. Planes with
/// a smaller cosine belong to the other side of a thin wall.
const OTHER_SIDE: f64 = -0.1;

/// A plane within this angle (its cosine) and distance (voxels) of another plane of the patch is left out.
const SAME: (f64, f64) = (0.9999, 1e-3);

/// Points where the source is evaluated.
#[derive(Debug, Default)]
pub struct Probes {
    /// World positions.
    pub points: Vec<DVec3>,
    /// Patch of each point, in ascending order.
    patches: Vec<u32>,
}

/// Planes that joined the patches: a point, relative to the lower corner of the cell, and a unit normal.
#[derive(Debug, Default)]
pub struct ExtraPlanes {
    /// First plane of each patch, and the number of planes at the end; empty without planes.
    firsts: Vec<u32>,
    planes: Vec<(DVec3, DVec3)>,
}

impl ExtraPlanes {
    /// Whether no plane has joined.
    pub(super) fn is_empty(&self) -> bool {
        self.planes.is_empty()
    }

    /// The planes of a patch.
    pub(super) fn of(&self, patch: u32) -> &[(DVec3, DVec3)] {
        match self.firsts.get(patch as usize..patch as usize + 2) {
            Some(&[first, end]) => &self.planes[first as usize..end as usize],
            _ => &[],
        }
    }
}

impl LevelSurface {
    /// The probes of all vertices, or only those of the sharp vertices.
    pub fn probes(&self, crossings: &[Crossing], extra: &ExtraPlanes, sharp_only: bool) -> Probes {
        let is_sharp = self.sharp_patches(crossings);
        let options = MeshOptions { sharp: true, capped: true };
        let (vertices, _) = self.vertices(crossings, extra, options);
        let found: Vec<(u32, DVec3)> = (0..vertices.len())
            .into_par_iter()
            .filter(|&id| !sharp_only || is_sharp[id])
            .flat_map_iter(|id| {
                let (vertex, spacing) = (vertices[id], self.spacing);
                (0..if is_sharp[id] { 7 } else { 1 }).map(move |i: usize| {
                    let mut step = DVec3::ZERO;
                    if i > 0 {
                        step[(i - 1) / 2] = if i % 2 == 1 { STEP } else { -STEP };
                    }
                    (id as u32, vertex + step * spacing)
                })
            })
            .collect();
        let (patches, points) = found.into_iter().unzip();
        Probes { points, patches }
    }

    /// Patches with different normals, and their neighbours.
    fn sharp_patches(&self, crossings: &[Crossing]) -> Vec<bool> {
        let own: Vec<bool> = self
            .cells
            .cells()
            .par_iter()
            .flat_map_iter(|cell| {
                (cell.first_patch..).zip(cell.patches()).map(move |(id, _)| {
                    let mut normals = self.crossings_of(id, crossings).map(|crossing| crossing.normal);
                    let first = normals.next().unwrap_or(DVec3::X);
                    // The angle to the first normal is at least half of the largest angle.
                    normals.any(|normal| normal.dot(first) < SHARP_COSINE)
                })
            })
            .collect();
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
                let mut planes = extra.of(id).to_vec();
                for (&point, &normal) in points[rows.clone()].iter().zip(&normals[rows]) {
                    self.join_plane(cell, id, crossings, &mut planes, point, normal);
                }
                planes
            })
            .collect();
        let mut firsts = Vec::with_capacity(joined.len() + 1);
        firsts.push(0);
        let mut count = 0;
        for planes in &joined {
            count += planes.len() as u32;
            firsts.push(count);
        }
        ExtraPlanes { firsts, planes: joined.concat() }
    }

    fn join_plane(
        &self,
        cell: &SurfaceCell,
        id: u32,
        crossings: &[Crossing],
        planes: &mut Vec<(DVec3, DVec3)>,
        point: DVec3,
        normal: DVec3,
    ) {
        let Some(normal) = normal.try_normalize().filter(|_| point.is_finite()) else { return };
        let point = point - self.world(cell.index, DVec3::ZERO);
        let [lower, upper] = self.allowed(cell);
        let reach = self.spacing * REACH;
        if point.cmplt(lower - reach).any() || point.cmpgt(upper + reach).any() {
            return;
        }
        let mean: DVec3 = self.crossings_of(id, crossings).map(|crossing| crossing.normal).sum();
        if normal.dot(mean.normalize_or_zero()) <= OTHER_SIDE {
            return;
        }
        let near = SAME.1 * self.spacing.min_element();
        let is_same = |&(other, direction): &(DVec3, DVec3)| {
            direction.dot(normal) >= SAME.0 && direction.dot(point - other).abs() <= near
        };
        if !planes.iter().any(is_same) {
            planes.push((point, normal));
        }
    }
}
