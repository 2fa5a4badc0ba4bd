//! Tangent planes from the mesh that a field was computed from.
//!
//! On an edge or a vertex of the mesh several faces meet. A point outside a convex edge has the same distance from both
//! of its faces, and rounding would decide which is the nearest. Such points therefore use all the faces: a probe adds
//! all of their planes, and a crossing has the mean of their normals.

use super::probes::{NEAR_STEP, PROBES, Place};
use super::{CrossedEdge, Crossing, ExtraPlanes, LevelSurface, probes};
use crate::bvh::Bvh;
use crate::bvh::nearest::closest::ClosestPoint;
use crate::bvh::rays::watertight::{FaceHit, Ray};
use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Number of crossings between two checks of the progress.
const CHUNK: usize = 1024;

/// A mesh farther than this many voxels (longest side) from the crossing of the samples counts as another sheet.
const REACH_VOXELS: f64 = 0.9;

/// Offsets below this many voxels use the normals of faces, since the direction to the nearest point has lost its
/// precision.
const FLAT_VOXELS: f64 = 1e-3;

/// Smallest offset, voxels, whose surface is so far from the mesh that all points near it lie on one side of the mesh.
const FAR_VOXELS: f64 = 2.0;

/// A bound on the distance of a point is used in place of the distance if the probes around the point are this many
/// times as far away. The search within the larger radius then costs less than the search of the distance.
const SHORT: f64 = 2.0;

/// Faces are equally near if their distances differ by at most this, local units: a million roundings of float64.
const TIE: f64 = 1e-9;

/// Replaces the planes of `crossings` by tangent planes of the surface at the distance `offset` from `mesh`, world
/// units. With `unsigned` the distance is without a sign, so a positive offset surrounds the mesh on both sides.
///
/// A signed offset of at most [`FLAT_VOXELS`] moves a crossing to the intersection of its edge with the mesh, and uses
/// the face there. Any other offset uses the sphere around the nearest point. A crossing keeps its plane where the mesh
/// is farther away than the samples indicate, as across an opening.
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
    // The tables are built before the loop. A worker that builds one inside it may steal a chunk that needs the same
    // table, and would wait for itself.
    rayon::join(|| mesh.bvh(), || mesh.topology());
    let is_flat = !unsigned && offset.abs() <= FLAT_VOXELS * voxel;
    if is_flat {
        mesh.ray_packs();
    }
    let reach = REACH_VOXELS * voxel;
    crossings.par_chunks_mut(CHUNK).enumerate().try_for_each_init(Vec::new, |hits, (i, chunk)| {
        let edges = (i * CHUNK..).take(chunk.len()).map(|edge| surface.edge(edge));
        if is_flat {
            let rays: Vec<Ray> = edges.clone().map(|edge| ray_of_edge(mesh, &edge)).collect();
            mesh.all_hits(rays.iter().copied(), true, hits);
        }
        for (i, (crossing, edge)) in
            chunk.iter_mut().zip(edges).enumerate().filter(|(_, (crossing, _))| !crossing.on_box)
        {
            let plane = if is_flat {
                crossed_face(mesh, crossing, &edge, &hits[i])
                    .or_else(|| nearest_face(mesh, edge.at(crossing.share), crossing.normal, reach))
            } else {
                offset_plane(mesh, edge.at(crossing.share), offset, unsigned, reach)
            };
            // The winding of the face does not matter.
            if let Some((point, normal)) = plane {
                crossing.set_plane(edge.at(crossing.share), point, normal);
            }
        }
        progress.advance(chunk.len() as u64)
    })
}

/// The tangent planes of the surface at the distance `offset` from `mesh` around all vertices; see [`planes_of_mesh`].
/// None if the offset is so small that the side of the mesh on which a point lies is uncertain.
pub fn planes_around_of_offset(
    surface: &LevelSurface,
    crossings: &[Crossing],
    mesh: &Arc<Mesh>,
    offset: f64,
    unsigned: bool,
    progress: &Progress,
) -> Result<Option<ExtraPlanes>, Error> {
    let voxel = surface.spacing.max_element();
    if offset.abs() < FAR_VOXELS * voxel {
        return Ok(None);
    }
    progress.set_total(surface.cells.cells().len() as u64);
    mesh.bvh();
    let mesh = Arc::clone(mesh);
    let plane = move |place: DVec3| offset_plane(&mesh, place, offset, unsigned, REACH_VOXELS * voxel);
    let around = |(): &mut (), places: &[DVec3; PROBES], _, _: &mut _, found: &mut Vec<(DVec3, DVec3)>| {
        found.extend(places.iter().filter_map(|&place| plane(place)));
    };
    let planes = surface.planes_around(crossings, || (), around, progress)?;
    let nearby = move |places: &[Place], found: &mut dyn FnMut(usize, DVec3, DVec3)| {
        for (i, place) in places.iter().enumerate().filter(|(_, place)| !place.is_sharp) {
            if let Some((point, normal)) = plane(place.point) {
                found(i, point, normal);
            }
        }
    };
    Ok(Some(planes.with_nearby(Box::new(nearby), false)))
}

/// The tangent planes of the faces of `mesh` around the sharp vertices, and close to vertices with an error. The faces
/// must be oriented alike; `inward` tells that their normals point to the inside.
pub fn planes_around_of_mesh(
    surface: &LevelSurface,
    crossings: &[Crossing],
    mesh: &Arc<Mesh>,
    inward: bool,
    progress: &Progress,
) -> Result<ExtraPlanes, Error> {
    progress.set_total(surface.cells.cells().len() as u64);
    mesh.bvh();
    let sign = if inward { -1.0 } else { 1.0 };
    let around = |(): &mut (), places: &[DVec3; PROBES], near, known: &mut _, found: &mut Vec<(DVec3, DVec3)>| {
        let points = places.map(|place| mesh.local_from_world(place));
        let bound = points[0].distance(mesh.local_from_world(near));
        nearest_faces(mesh, &points, bound, known, |closest| found.extend(plane_of(mesh, &closest, sign)));
    };
    let planes = surface.planes_around(crossings, || (), around, progress)?;
    let mesh = Arc::clone(mesh);
    let step = NEAR_STEP * surface.spacing;
    // Most vertices lie within this distance of the mesh.
    let bound = 0.4 * step.max_element() / mesh.scale();
    let nearby = move |places: &[Place], found: &mut dyn FnMut(usize, DVec3, DVec3)| {
        let mut known = Vec::new();
        for (i, place) in places.iter().enumerate() {
            known.clear();
            if place.is_sharp {
                let points = probes::around(place.point, step).map(|point| mesh.local_from_world(point));
                nearest_faces(&mesh, &points, bound, &mut known, |closest| {
                    if let Some((point, normal)) = plane_of(&mesh, &closest, sign) {
                        found(i, point, normal);
                    }
                });
            } else {
                let closest = mesh.exact_closest_point(mesh.local_from_world(place.point), f64::INFINITY);
                if let Some((point, normal)) = plane_of(&mesh, &closest, sign) {
                    found(i, point, normal);
                }
            }
        }
    };
    Ok(planes.with_nearby(Box::new(nearby), true))
}

/// The plane of the face at a closest point, world units; its normal is multiplied by `sign`.
fn plane_of(mesh: &Mesh, closest: &ClosestPoint, sign: f64) -> Option<(DVec3, DVec3)> {
    let normal = normal_of(mesh, closest.face)?;
    Some((mesh.world_from_local(closest.on_triangle.point), sign * normal))
}

/// Finds the nearest faces of points around the first one, local units: for each point in order all nearest faces, in
/// ascending order. Those that are not in `known` are added to it and passed to `on_face`. `bound` is the probable
/// distance of the first point from the mesh; a smaller one costs further searches.
fn nearest_faces(
    mesh: &Mesh,
    points: &[DVec3; PROBES],
    bound: f64,
    known: &mut Vec<u32>,
    mut on_face: impl FnMut(ClosestPoint),
) {
    let step = points.iter().map(|point| point.distance(points[0])).fold(0.0, f64::max);
    let reach = points[0].abs().max_element() + step;
    let bvh = mesh.bvh_within(reach);
    let slack = Bvh::nearest_slack(reach);
    let nearest = |point: DVec3, bound: f64| {
        // The factor covers the rounding of float32.
        let bound = (bound * 1.001 + f64::from(f32::EPSILON)) as f32;
        let found = bvh.nearest(point.as_vec3(), bound * bound).or_else(|| bvh.nearest(point.as_vec3(), f32::INFINITY));
        found.map_or(0.0, |found| found.distance_squared.sqrt())
    };
    let rows = [0, 1, 2].map(|axis| std::array::from_fn(|i| points[i.min(PROBES - 1)][axis] as f32));
    let mut found = Vec::with_capacity(2 * PROBES);
    // The surface lies within `distance` of the first point, so within `distance + step` of every other one. The
    // triangle that is nearest to it lies within `step` more of the first point.
    let group = |distance: f64, found: &mut Vec<(u32, u8)>| {
        let radius = ((distance + 2.0 * step) * 1.001 + f64::from(f32::EPSILON)) as f32 + slack;
        bvh.nearest_of_group(points[0].as_vec3(), radius, &rows, slack, found)
    };
    // A small bound takes the place of the distance if it is not smaller.
    let is_found = step >= SHORT * bound && group(bound, &mut found) && {
        let mut of_first = found.iter().filter(|(_, of)| of & 1 == 1);
        of_first.any(|&(face, _)| mesh.exact_point_on_face(face, points[0]).distance <= bound)
    };
    if !is_found {
        found.clear();
        let distance = f64::from(nearest(points[0], bound));
        if !group(distance, &mut found) {
            for (i, &point) in points.iter().enumerate() {
                let least = nearest(point, distance + step);
                bvh.faces_within(point.as_vec3(), least + slack, |face| found.push((face, 1 << i)));
            }
        }
    }
    // The order must not depend on the tree.
    found.sort_unstable();
    let mut closest = Vec::with_capacity(PROBES);
    for (i, &point) in points.iter().enumerate() {
        let faces = found.iter().filter(|(_, of)| of >> i & 1 == 1).map(|&(face, _)| face);
        if faces.clone().all(|face| known.contains(&face)) {
            continue;
        }
        closest.clear();
        closest.extend(faces.map(|face| mesh.exact_point_on_face(face, point)));
        let least = closest.iter().map(|found| found.distance).fold(f64::INFINITY, f64::min);
        for &found in closest.iter().filter(|found| found.distance <= least + TIE) {
            if !known.contains(&found.face) {
                known.push(found.face);
                on_face(found);
            }
        }
    }
}

/// An edge in local units, `t` from 0 to 1.
fn ray_of_edge(mesh: &Mesh, edge: &CrossedEdge) -> Ray {
    let [origin, tip] = [edge.start, edge.start + edge.along].map(|end| mesh.local_from_world(end));
    Ray { origin, direction: tip - origin, t_min: 0.0, t_max: 1.0 }
}

/// Moves the crossing to the nearest of the intersections of its edge with the mesh. Returns the point and the normal
/// there.
fn crossed_face(mesh: &Mesh, crossing: &mut Crossing, edge: &CrossedEdge, hits: &[FaceHit]) -> Option<(DVec3, DVec3)> {
    let away = |hit: &FaceHit| (hit.t - f64::from(crossing.share)).abs();
    let hit = hits.iter().min_by(|a, b| away(a).total_cmp(&away(b)))?;
    let point = edge.start + edge.along * hit.t;
    let normal = if hit.weights.iter().any(|&weight| weight <= TIE) {
        mean_normal(mesh, mesh.local_from_world(point), 0.0, crossing.normal)
    } else {
        hit.cross.try_normalize()
    };
    let normal = normal?;
    crossing.share = hit.t as f32;
    Some((point, normal))
}

/// The point of the mesh nearest to a world position, and the normal of its face, turned towards `side`.
fn nearest_face(mesh: &Mesh, place: DVec3, side: DVec3, reach: f64) -> Option<(DVec3, DVec3)> {
    let p = mesh.local_from_world(place);
    let closest = mesh.exact_closest_point(p, f64::INFINITY);
    (closest.distance * mesh.scale() <= reach).then_some(())?;
    let normal = mean_normal(mesh, p, closest.distance, side);
    Some((mesh.world_from_local(closest.on_triangle.point), normal?))
}

/// The mean of the unit normals of the faces nearest to a local position, each turned towards `side`. `distance` is the
/// distance of one of them.
fn mean_normal(mesh: &Mesh, p: DVec3, distance: f64, side: DVec3) -> Option<DVec3> {
    let reach = p.abs().max_element();
    let radius = distance as f32 + Bvh::nearest_slack(reach);
    let mut faces = Vec::new();
    mesh.bvh_within(reach).faces_within(p.as_vec3(), radius, |face| faces.push(mesh.exact_point_on_face(face, p)));
    // The order of the sum must not depend on the tree.
    faces.sort_unstable_by_key(|closest| closest.face);
    let least = faces.iter().map(|closest| closest.distance).fold(f64::INFINITY, f64::min);
    let nearest = faces.iter().filter(|closest| closest.distance <= least + TIE);
    let normals = nearest.filter_map(|closest| normal_of(mesh, closest.face));
    normals.map(|normal| if normal.dot(side) < 0.0 { -normal } else { normal }).sum::<DVec3>().try_normalize()
}

/// The tangent plane of the offset surface on the line from the nearest point of the mesh through a world position.
fn offset_plane(mesh: &Mesh, place: DVec3, offset: f64, unsigned: bool, reach: f64) -> Option<(DVec3, DVec3)> {
    let closest = mesh.closest_point(mesh.local_from_world(place));
    let distance = closest.distance * mesh.scale();
    ((distance - offset.abs()).abs() <= reach && distance > 0.0).then_some(())?;
    let nearest = mesh.world_from_local(closest.on_triangle.point);
    let away = (place - nearest).normalize_or_zero();
    let outward = if unsigned || offset > 0.0 { away } else { -away };
    (outward != DVec3::ZERO).then_some((nearest + outward * offset, outward))
}

/// Unit normal of a face, in the order of its corners.
fn normal_of(mesh: &Mesh, face: u32) -> Option<DVec3> {
    let [a, b, c] = mesh.exact_triangle(face);
    (b - a).cross(c - a).try_normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::uniform;
    use glam::DQuat;

    /// A cube in a random position.
    fn turned_cube(seed: u64) -> Mesh {
        let mut random = uniform(seed);
        let mut random = || random() - 0.5;
        let turn = DQuat::from_xyzw(random(), random(), random(), random()).normalize();
        let corner = |i: usize| turn * (DVec3::new((i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64) - 0.5);
        let vertices: Vec<[f64; 3]> = (0..8).map(|i| corner(i).to_array()).collect();
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [0, 1, 5, 4], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let faces: Vec<[i64; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Mesh::new(&vertices, &faces).unwrap()
    }

    #[test]
    fn all_faces_at_an_edge_or_a_vertex_are_nearest_to_the_points_outside_it() {
        for seed in 0..50 {
            let cube = turned_cube(seed);
            for (a, b) in (0..8).flat_map(|a| (a..8).map(move |b| (a, b))) {
                let is_there = |face: &u32| [a, b].iter().all(|v| cube.faces()[*face as usize].contains(v));
                let expected: Vec<u32> = (0..12).filter(is_there).collect();
                // Other pairs of vertices are joined by no edge.
                if expected.is_empty() {
                    continue;
                }
                let foot = 0.5 * (cube.exact_position(a) + cube.exact_position(b));
                let normals: Vec<DVec3> = expected.iter().filter_map(|&face| normal_of(&cube, face)).collect();
                let outward = normals.iter().sum::<DVec3>().normalize();
                let mut found = Vec::new();
                nearest_faces(&cube, &[foot + 0.1 * outward; PROBES], 0.1, &mut found, |_| ());
                assert_eq!(found, expected, "seed {seed}, vertices {a} and {b}");
                let mean = mean_normal(&cube, foot, 0.0, outward).unwrap();
                // Rounding moves the foot off the edge by 1e-16.
                assert!((mean - outward).length() <= 1e-12, "seed {seed}, vertices {a} and {b}");
            }
        }
    }
}
