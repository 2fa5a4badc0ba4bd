//! Local thickness: the largest ball inside that touches a point of the surface.
//!
//! *Theory.* A ball that touches the surface at p with outward unit normal n has its centre at p - r n. If the surface
//! has a point q nearer to the centre than r, the ball through p and q is smaller: r' = |p - q|^2 / (2 n.(p - q)). The
//! radii decrease to the largest empty ball (Ma, Bae and Choi, *3D medial axis point approximation using nearest
//! neighbors and the normal field*, 2012). The step is that of Newton's method, so a few searches suffice.
//!
//! A facet beside p that is tilted by a few degrees limits every ball near the common edge, however thick the body is.
//! A point q at less than [`FLAT`] above the tangent plane, as seen from p, therefore belongs to the same side and ends
//! the search.

use super::nearest::outward_normal;
use super::{answer_in_order, check_points, prepare};
use crate::error::{ArgumentError, Error};
use crate::gpu::Place;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignMethod;
use glam::DVec3;

/// Sine of 15 degrees. Neighbouring facets that differ by less are one side of the body.
const FLAT: f64 = 0.258_819_045_102_520_74;
/// Radius of the first ball, local units. The longest side of a mesh is at most 1, so no inscribed ball is larger.
const FIRST: f64 = 2.0;
/// A ball is empty if the surface is at most this much nearer than its radius, relative: ten times the rounding of
/// float64.
const EMPTY: f64 = 1e-13;
/// Rounding of a distance between a centre and the surface, local units: coordinates are at most 1. On an edge or a
/// corner the radius falls to it.
const ROUNDING: f64 = 1e-15;
/// Largest number of searches for one point. Newton's method needs six from a radius a thousand times too large.
const STEPS: usize = 60;

/// Diameter of the largest ball inside that touches the surface at each point; infinite if no surface bounds it.
///
/// Points are moved to the surface first. `normals` point away from the inside; the default is the pseudonormals.
pub fn thickness(
    mesh: &Mesh,
    points: &[[f64; 3]],
    normals: Option<&[[f64; 3]]>,
    progress: &Progress,
) -> Result<Vec<f64>, Error> {
    check_points(mesh, points)?;
    check_normals(points, normals)?;
    let choice = prepare(mesh, SignMethod::Auto);
    mesh.pseudonormals();
    let answers = answer_in_order(&Place::Cpu, mesh, points, progress, |walk, p, row| {
        let closest = walk.exact_closest_point(p, row);
        let normal = match normals {
            Some(normals) => DVec3::from_array(normals[row as usize]).normalize(),
            None => outward_normal(mesh, &choice.rule, &closest),
        };
        2.0 * radius(mesh, closest.on_triangle.point, normal) * mesh.scale()
    })?;
    Ok(answers.into_rows())
}

fn radius(mesh: &Mesh, p: DVec3, normal: DVec3) -> f64 {
    let mut radius = FIRST;
    for _ in 0..STEPS {
        let center = p - radius * normal;
        let closest = mesh.exact_closest_point(center, radius * (1.0 + 1e-9));
        if closest.distance >= radius * (1.0 - EMPTY) - ROUNDING {
            break;
        }
        let chord = p - closest.on_triangle.point;
        let above = chord.dot(normal);
        if above < FLAT * chord.length() {
            break;
        }
        let smaller = chord.length_squared() / (2.0 * above);
        if smaller >= radius {
            break;
        }
        radius = smaller;
    }
    if radius < FIRST { radius } else { f64::INFINITY }
}

fn check_normals(points: &[[f64; 3]], normals: Option<&[[f64; 3]]>) -> Result<(), ArgumentError> {
    let Some(normals) = normals else { return Ok(()) };
    if normals.len() != points.len() {
        let problem = format!("one per point ({}) expected, got {}", points.len(), normals.len());
        return Err(ArgumentError::new("normals", problem));
    }
    let usable = |n: &[f64; 3]| n.iter().all(|x| x.is_finite()) && *n != [0.0; 3];
    match normals.iter().position(|n| !usable(n)) {
        Some(row) => {
            let problem = format!("normals[{row}] = {:?} is zero or not finite", normals[row]);
            Err(ArgumentError::new("normals", problem))
        }
        None => Ok(()),
    }
}
