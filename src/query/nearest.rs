//! The nearest point of a mesh in float64: position, distance, face, barycentric coordinates, normal, side and
//! gradient.
//!
//! The gradient of the distance at p with closest point c is (p - c) / |p - c|, negated inside. Within [`NEAR`] of a
//! face it is the normal of the face, which keeps its accuracy as the distance goes to zero. On the surface the
//! gradient is the angle-weighted pseudonormal of the nearest feature, turned to point away from the inside.
//!
//! Signs are decided with float32 positions, which differ from the mesh's own by 3e-8 local units. Within [`NEAR`] of
//! the surface the side follows from the pseudonormal and float64 positions: the sign rule determines the sides in
//! front of and behind the surface, and the pseudonormal determines on which of them the point lies.

use super::{CHUNK, SLACK, Walk, check_points, evaluate_in_order, prepare};
use crate::bake::Report;
use crate::bvh::nearest::closest::ClosestPoint;
use crate::error::Error;
use crate::geometry::{Feature, triangle_cross};
use crate::gpu::Place;
use crate::memory::zeroed_rows;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SideWalk, SignMethod, SignRule};
use glam::DVec3;
use std::time::Instant;

/// Distance below which float32 positions may put a point on the wrong side, local units: seven times their rounding.
const NEAR: f64 = 2e-7;
/// Distance from the surface at which the sign rule is evaluated for points nearer than that, local units.
const ASIDE: f64 = 2e-6;
/// Distance below which a point is on the surface, relative to the largest coordinate that was rounded: sixteen ulps.
const ON_SURFACE: f64 = 16.0 * f64::EPSILON;
/// Distance below which (p - c) has no direction to 1e-3, relative as above.
const NO_DIRECTION: f64 = 1e3 * f64::EPSILON;
/// A barycentric weight below this puts a point of the surface on the opposite edge.
const ON_EDGE: f64 = 1e-9;

/// The closest points of a mesh, one entry per query point.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ClosestPoints {
    /// World positions.
    pub points: Vec<[f64; 3]>,
    /// Unsigned, world units.
    pub distances: Vec<f64>,
    /// Indices into the mesh's faces.
    pub faces: Vec<i64>,
    /// Weights of the face's corners.
    pub barycentric: Vec<[f64; 3]>,
    /// Unit normals of the faces, by their own winding.
    pub normals: Vec<[f64; 3]>,
}

/// Results of a query, one entry per query point.
#[derive(Debug, Clone, Default)]
pub struct Query {
    /// Negative inside, world units.
    pub distances: Vec<f64>,
    /// Unit gradients of the signed distance.
    pub gradients: Vec<[f64; 3]>,
    /// Closest points, world positions.
    pub points: Vec<[f64; 3]>,
    /// Indices into the mesh's faces.
    pub faces: Vec<i64>,
    /// Weights of the face's corners.
    pub barycentric: Vec<[f64; 3]>,
    /// Properties of the surface, and the cost.
    pub report: Report,
}

/// Closest point of the mesh to each world position.
pub fn closest_points(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    progress: &Progress,
) -> Result<ClosestPoints, Error> {
    check_points(mesh, points)?;
    mesh.bvh();
    let ordered = evaluate_in_order(place, mesh, points, progress, |walk, p, row| {
        let closest = walk.exact_closest_point(p, row);
        (closest, unit_normal(mesh, triangle_cross(mesh.exact_triangle(closest.face)), closest.face))
    })?;
    let count = points.len();
    let mut found = ClosestPoints {
        points: zeroed_rows("results", count)?,
        distances: zeroed_rows("results", count)?,
        faces: zeroed_rows("results", count)?,
        barycentric: zeroed_rows("results", count)?,
        normals: zeroed_rows("results", count)?,
    };
    let columns = found.points.chunks_mut(CHUNK).zip(found.distances.chunks_mut(CHUNK));
    let columns = columns.zip(found.faces.chunks_mut(CHUNK)).zip(found.barycentric.chunks_mut(CHUNK));
    let columns = columns.zip(found.normals.chunks_mut(CHUNK));
    ordered.write_rows(progress, columns, |column, i, (closest, normal)| {
        let ((((points, distances), faces), barycentric), normals) = column;
        points[i] = mesh.world_from_local(closest.on_triangle.point).to_array();
        distances[i] = closest.distance * mesh.scale();
        faces[i] = closest.face.into();
        barycentric[i] = closest.on_triangle.weights;
        normals[i] = normal.to_array();
    })?;
    Ok(found)
}

/// Signed distance, gradient and closest point of each world position.
pub fn query(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    method: SignMethod,
    progress: &Progress,
) -> Result<Query, Error> {
    check_points(mesh, points)?;
    let started = Instant::now();
    let choice = prepare(mesh, method);
    let prepared = started.elapsed().as_secs_f64();
    let ordered = evaluate_in_order(place, mesh, points, progress, |walk, p, row| {
        let closest = walk.exact_closest_point(p, row);
        let (inside, gradient) = side_and_gradient(walk, &choice.rule, p, &closest);
        (closest, inside, gradient)
    })?;
    let count = points.len();
    let mut found = Query {
        distances: zeroed_rows("results", count)?,
        gradients: zeroed_rows("results", count)?,
        points: zeroed_rows("results", count)?,
        faces: zeroed_rows("results", count)?,
        barycentric: zeroed_rows("results", count)?,
        report: Report::default(),
    };
    let columns = found.distances.chunks_mut(CHUNK).zip(found.gradients.chunks_mut(CHUNK));
    let columns = columns.zip(found.points.chunks_mut(CHUNK)).zip(found.faces.chunks_mut(CHUNK));
    let mut inside_counts = vec![0usize; count.div_ceil(CHUNK)];
    let columns = columns.zip(found.barycentric.chunks_mut(CHUNK)).zip(&mut inside_counts);
    ordered.write_rows(progress, columns, |column, i, (closest, inside, gradient)| {
        let (((((distances, gradients), points), faces), barycentric), inside_count) = column;
        **inside_count += usize::from(*inside);
        let distance = closest.distance * mesh.scale();
        distances[i] = if *inside && distance > 0.0 { -distance } else { distance };
        gradients[i] = gradient.to_array();
        points[i] = mesh.world_from_local(closest.on_triangle.point).to_array();
        faces[i] = closest.face.into();
        barycentric[i] = closest.on_triangle.weights;
    })?;
    let inside_points = inside_counts.iter().sum();
    found.report = Report::of_query(mesh, &choice, count, inside_points);
    found.report.device = place.label();
    found.report.seconds = vec![("prepare", prepared), ("query", started.elapsed().as_secs_f64() - prepared)];
    found.report.peak_bytes = mesh.bytes() + count * size_of::<(u32, (ClosestPoint, [f64; 4], [f64; 7]))>() * 2;
    Ok(found)
}

/// The nearest surface point of one position.
#[derive(Debug, Clone, Copy)]
pub struct Nearest {
    /// Negative inside, world units.
    pub distance: f64,
    /// Unit gradient of the signed distance.
    pub gradient: DVec3,
    /// World position.
    pub point: DVec3,
    /// Index into the mesh's faces.
    pub face: u32,
    /// Weights of the face's corners.
    pub weights: [f64; 3],
}

/// A search of one mesh at one position after another, by the winding number. Positions that follow each other share
/// work if they are near each other; the results do not depend on their order.
pub struct Search<'a> {
    walk: Walk<'a>,
    rule: &'a SignRule,
}

impl<'a> Search<'a> {
    /// A search that has visited no position.
    pub fn new(mesh: &'a Mesh) -> Self {
        let walk = Walk { mesh, faces: &[], last: None, sides: SideWalk::default() };
        Self { walk, rule: &mesh.winding_choice().rule }
    }

    /// The nearest surface point of a world position; none if its signed distance certainly exceeds `limit`, world
    /// units.
    pub fn nearest(&mut self, p: DVec3, limit: f64) -> Option<Nearest> {
        let mesh = self.walk.mesh;
        let p = mesh.local_from_world(p);
        let bound = self.walk.bound(p);
        // The slack exceeds NEAR, so the side of a point that is left out does not depend on float32 positions.
        let least = (limit / mesh.scale()) * (1.0 + SLACK.0) + SLACK.1;
        let closest = if limit >= 0.0 && least < bound {
            let found = mesh.exact_closest_point_within(p, least).filter(|found| found.distance <= least);
            if found.is_none() && !self.walk.sides.is_inside_without_distance(self.rule, mesh, p) {
                return None;
            }
            found.unwrap_or_else(|| mesh.exact_closest_point(p, bound))
        } else {
            mesh.exact_closest_point(p, bound)
        };
        self.walk.last = Some(closest.on_triangle.point);
        let (inside, gradient) = side_and_gradient(&mut self.walk, self.rule, p, &closest);
        let distance = closest.distance * mesh.scale();
        Some(Nearest {
            distance: if inside && distance > 0.0 { -distance } else { distance },
            gradient,
            point: mesh.world_from_local(closest.on_triangle.point),
            face: closest.face,
            weights: closest.on_triangle.weights,
        })
    }
}

/// Whether a point is inside, and the unit gradient of its signed distance.
fn side_and_gradient(walk: &mut Walk<'_>, rule: &SignRule, p: DVec3, closest: &ClosestPoint) -> (bool, DVec3) {
    let away = p - closest.on_triangle.point;
    if closest.distance > NEAR {
        let inside = walk.is_inside(rule, p, closest);
        // A difference, not a change of sign, so that equal coordinates give 0 and not -0.
        let outwards = if inside { closest.on_triangle.point - p } else { away };
        return (inside, outwards / closest.distance);
    }
    let mesh = walk.mesh;
    // The rounding of a position is the rounding of the larger of its local and world coordinates.
    let magnitude = 1.0 + mesh.center().abs().max_element() / mesh.scale();
    let on_surface = closest.distance <= ON_SURFACE * magnitude;
    let feature = if on_surface { nearest_feature(closest) } else { closest.on_triangle.feature };
    let (normal, front, back) = sides(mesh, rule, &mut walk.sides, closest, feature);
    let outwards = if front && !back { -normal } else { normal };
    if on_surface {
        return (false, outwards);
    }
    let inside = if away.dot(normal) < 0.0 { back } else { front };
    if closest.distance <= NO_DIRECTION * magnitude && feature != Feature::Face {
        return (inside, outwards);
    }
    let unit = direction_from(away, closest, mesh.exact_triangle(closest.face));
    (inside, if inside { -unit } else { unit })
}

/// The pseudonormal of the closest point, and whether the sign rule finds the inside in front of the surface and behind
/// it.
fn sides(
    mesh: &Mesh,
    rule: &SignRule,
    walk: &mut SideWalk,
    closest: &ClosestPoint,
    feature: Feature,
) -> (DVec3, bool, bool) {
    let point = closest.on_triangle.point;
    let own = || triangle_cross(mesh.exact_triangle(closest.face)).try_normalize();
    let normal = mesh.pseudonormals().at(mesh, closest.face, feature).try_normalize().or_else(own).unwrap_or(DVec3::X);
    if matches!(rule, SignRule::Unsigned) {
        return (normal, false, false);
    }
    let mut inside_at = |q: DVec3| match rule {
        SignRule::Pseudonormal | SignRule::Normal => rule.is_inside(mesh, q, &mesh.closest_point(q)),
        _ => walk.is_inside_without_distance(rule, mesh, q),
    };
    (normal, inside_at(point + normal * ASIDE), inside_at(point - normal * ASIDE))
}

/// The unit pseudonormal at a closest point, turned away from the inside; unchanged if both sides are alike.
pub(super) fn outward_normal(mesh: &Mesh, rule: &SignRule, closest: &ClosestPoint) -> DVec3 {
    let feature = nearest_feature(closest);
    let (normal, front, back) = sides(mesh, rule, &mut SideWalk::default(), closest, feature);
    if front && !back { -normal } else { normal }
}

/// The unit vector from the closest point to the query point. Inside a face it is the normal of the face.
fn direction_from(away: DVec3, closest: &ClosestPoint, corners: [DVec3; 3]) -> DVec3 {
    let plain = away / closest.distance;
    if closest.on_triangle.feature != Feature::Face {
        return plain;
    }
    match triangle_cross(corners).try_normalize() {
        Some(normal) if away.dot(normal) >= 0.0 => normal,
        Some(normal) => -normal,
        None => plain,
    }
}

/// The feature that contains a point of the surface: an edge or a vertex if the other weights vanish.
fn nearest_feature(closest: &ClosestPoint) -> Feature {
    let weights = closest.on_triangle.weights;
    let largest = (0..3u8).max_by(|&i, &j| weights[usize::from(i)].total_cmp(&weights[usize::from(j)])).unwrap_or(0);
    let vanishing = |i: u8| weights[usize::from(i)] < ON_EDGE;
    let vertices: Vec<u8> = (0..3).filter(|&i| vanishing(i)).collect();
    match vertices[..] {
        [_, _] => Feature::Vertex(largest),
        [opposite] => Feature::Edge((opposite + 1) % 3),
        _ => closest.on_triangle.feature,
    }
}

/// The unit normal of a face by its own winding. `cross` is the cross product of its edges.
pub(super) fn unit_normal(mesh: &Mesh, cross: DVec3, face: u32) -> DVec3 {
    cross
        .try_normalize()
        // Any direction across the face suits one whose corners lie on a line.
        .or_else(|| {
            let [a, b, _] = mesh.exact_triangle(face);
            (b - a).try_normalize().map(|along| along.any_orthonormal_vector())
        })
        .unwrap_or(DVec3::X)
}
