//! Tangent planes from the mesh that a field was computed from.

use super::probes::PROBES;
use super::{Crossing, ExtraPlanes, LevelSurface};
use crate::bvh::watertight::Ray;
use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// Number of crossings between two checks of the progress.
const CHUNK: usize = 1024;

/// A mesh farther than this many voxels (longest side) from the crossing of the samples counts as another sheet.
const REACH_VOXELS: f64 = 0.9;

/// Offsets below this many voxels use the normals of faces, since the direction to the nearest point has lost its
/// precision.
const FLAT_VOXELS: f64 = 1e-3;

/// Replaces the planes of `crossings` by tangent planes of the surface at the distance `offset` from `mesh`, world
/// units. With `unsigned` the distance is without a sign, so a positive offset surrounds the mesh on both sides.
///
/// An offset of zero uses the face that the edge crosses. Any other offset uses the sphere around the nearest point. A
/// crossing keeps its plane where the mesh is farther away than the samples indicate, as across an opening.
pub fn planes_of_mesh(
    surface: &LevelSurface,
    crossings: &mut [Crossing],
    mesh: &Mesh,
    offset: f64,
    unsigned: bool,
    progress: &Progress,
) -> Result<(), Error> {
    let voxel = surface.spacing.max_element();
    progress.set_total(crossings.len() as u64);
    mesh.bvh();
    crossings.par_chunks_mut(CHUNK).try_for_each(|chunk| {
        for crossing in chunk.iter_mut().filter(|crossing| !crossing.on_box) {
            let plane = if !unsigned && offset.abs() <= FLAT_VOXELS * voxel {
                crossed_face(surface, mesh, crossing).or_else(|| nearest_face(mesh, crossing, REACH_VOXELS * voxel))
            } else {
                offset_plane(mesh, crossing, offset, unsigned, REACH_VOXELS * voxel)
            };
            if let Some((point, normal)) = plane {
                // The plane faces the larger values of the samples, independent of the winding of the face.
                let outward = if normal.dot(crossing.normal) < 0.0 { -normal } else { normal };
                (crossing.point, crossing.normal) = (point, outward);
            }
        }
        progress.advance(chunk.len() as u64)
    })
}

/// The tangent planes of the faces of `mesh` around the sharp vertices. The faces must be oriented alike; `inward` tells
/// that their normals point to the inside.
pub fn planes_around_of_mesh(
    surface: &LevelSurface,
    crossings: &[Crossing],
    mesh: &Mesh,
    inward: bool,
    progress: &Progress,
) -> Result<ExtraPlanes, Error> {
    progress.set_total(surface.cells.cells().len() as u64);
    mesh.bvh();
    let sign = if inward { -1.0 } else { 1.0 };
    let planes = |places: &[DVec3; PROBES], near: DVec3, known: &mut Vec<u32>, found: &mut Vec<(DVec3, DVec3)>| {
        let points = places.map(|place| mesh.local_from_world(place));
        for (face, point) in nearest_faces(mesh, &points, mesh.local_from_world(near)).into_iter().zip(points) {
            if known.contains(&face) {
                continue;
            }
            known.push(face);
            let nearest = mesh.closest_point_on_face(face, point).on_triangle.point;
            found.extend(normal_of(mesh, face).map(|normal| (mesh.world_from_local(nearest), sign * normal)));
        }
    };
    surface.planes_around(crossings, planes, progress)
}

/// The nearest faces of points around the first one, in local units. `near` is a point of the mesh.
fn nearest_faces(mesh: &Mesh, points: &[DVec3; PROBES], near: DVec3) -> [u32; PROBES] {
    let reach = points.iter().map(|point| point.distance(points[0])).fold(0.0, f64::max);
    let bvh = mesh.bvh_within(points[0].abs().max_element() + reach);
    let nearest = |point: DVec3, bound: f64| {
        // The factor covers the rounding of float32.
        let bound = (bound * 1.001 + f64::from(f32::EPSILON)) as f32;
        bvh.nearest(point.as_vec3(), bound * bound).or_else(|| bvh.nearest(point.as_vec3(), f32::INFINITY))
    };
    let Some(first) = nearest(points[0], points[0].distance(near)) else { return [0; PROBES] };
    // The surface lies within `distance` of the first point, so within `distance + reach` of every other one. The
    // triangle that is nearest to it lies within `reach` more of the first point.
    let distance = f64::from(first.distance_squared).sqrt();
    let radius = (distance + 2.0 * reach) * 1.001 + f64::from(f32::EPSILON);
    let rows = [0, 1, 2].map(|axis| std::array::from_fn(|i| points[i.min(PROBES - 1)][axis] as f32));
    match bvh.nearest_of_group(points[0].as_vec3(), radius as f32, &rows) {
        Some(faces) => std::array::from_fn(|i| faces[i]),
        None => points.map(|point| nearest(point, distance + reach).map_or(first.face, |nearest| nearest.face)),
    }
}

/// The intersection of the crossing's edge with the mesh that is nearest to the crossing, and the normal of its face.
fn crossed_face(surface: &LevelSurface, mesh: &Mesh, crossing: &Crossing) -> Option<(DVec3, DVec3)> {
    let [start, end] = surface.ends(crossing);
    let (origin, tip) = (mesh.local_from_world(start), mesh.local_from_world(end));
    let mut best = (f64::INFINITY, None);
    mesh.first_hit(&Ray { origin, direction: tip - origin, t_min: 0.0, t_max: 1.0 }, |hit| {
        if (hit.t - crossing.share).abs() < best.0 {
            best = ((hit.t - crossing.share).abs(), Some(*hit));
        }
        false
    });
    let hit = best.1?;
    Some((start + (end - start) * hit.t, normal_of(mesh, hit.face)?))
}

/// The nearest point of the mesh and the normal of its face.
fn nearest_face(mesh: &Mesh, crossing: &Crossing, reach: f64) -> Option<(DVec3, DVec3)> {
    let closest = mesh.closest_point(mesh.local_from_world(crossing.on_edge));
    (closest.distance * mesh.scale() <= reach).then_some(())?;
    Some((mesh.world_from_local(closest.on_triangle.point), normal_of(mesh, closest.face)?))
}

/// The tangent plane of the offset surface on the line from the nearest point of the mesh through the crossing.
fn offset_plane(mesh: &Mesh, crossing: &Crossing, offset: f64, unsigned: bool, reach: f64) -> Option<(DVec3, DVec3)> {
    let closest = mesh.closest_point(mesh.local_from_world(crossing.on_edge));
    let distance = closest.distance * mesh.scale();
    ((distance - offset.abs()).abs() <= reach && distance > 0.0).then_some(())?;
    let nearest = mesh.world_from_local(closest.on_triangle.point);
    let away = (crossing.on_edge - nearest).normalize_or_zero();
    let outward = if unsigned || offset > 0.0 { away } else { -away };
    (outward != DVec3::ZERO).then_some((nearest + outward * offset, outward))
}

/// Unit normal of a face, in the order of its corners.
fn normal_of(mesh: &Mesh, face: u32) -> Option<DVec3> {
    let [a, b, c] = mesh.triangle(face);
    (b - a).cross(c - a).try_normalize()
}
