//! The side and the winding number of points, without distances.

use super::{answer_in_order, check_points, prepare};
use crate::error::Error;
use crate::gpu::Place;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SignMethod, SignRule};

/// Whether each world position is inside.
pub fn contains(mesh: &Mesh, points: &[[f64; 3]], method: SignMethod, progress: &Progress) -> Result<Vec<bool>, Error> {
    check_points(mesh, points)?;
    let choice = prepare(mesh, method);
    let bounds = mesh.bvh().bounds;
    let (lower, upper) = (bounds.min.as_dvec3(), bounds.max.as_dvec3());
    let closed = mesh.topology().closed;
    if closed && matches!(choice.rule, SignRule::Counted(_)) {
        mesh.ray_packs();
    }
    let answers = answer_in_order(&Place::Cpu, mesh, points, progress, |walk, p, row| {
        match &choice.rule {
            SignRule::Pseudonormal | SignRule::Normal => {
                let closest = walk.closest_point(p, row);
                walk.is_inside(&choice.rule, p, &closest)
            }
            // No point outside the box of a closed surface is inside.
            SignRule::Counted(_) if closed && (p.cmplt(lower).any() || p.cmpgt(upper).any()) => false,
            rule if closed && matches!(rule, SignRule::Counted(_)) => match mesh.winding_by_ray(p) {
                Some(winding) => winding != 0,
                None => rule.is_inside_without_distance(mesh, p),
            },
            rule => walk.sides.is_inside_without_distance(rule, mesh, p),
        }
    })?;
    Ok(answers.into_rows())
}

/// The winding number of each world position, of the faces as they are wound.
pub fn winding_numbers(mesh: &Mesh, points: &[[f64; 3]], error: f64, progress: &Progress) -> Result<Vec<f64>, Error> {
    check_points(mesh, points)?;
    if !mesh.is_prepared() {
        rayon::join(|| mesh.bvh(), || mesh.topology());
    }
    let closure = mesh.raw_closure();
    // The dipoles use the repaired orientation, so they apply to surfaces without a repair only.
    let topology = mesh.topology();
    let repaired = topology.flipped_faces > 0 || topology.duplicate_faces > 0;
    let fast = error >= DIPOLE_ERROR && !repaired && closure.is_costly(mesh);
    if fast {
        mesh.moments();
    }
    let answers = answer_in_order(&Place::Cpu, mesh, points, progress, |_, p, _| {
        if fast { mesh.moments().winding(mesh, p) } else { closure.winding(mesh, p) }
    })?;
    Ok(answers.into_rows())
}

/// Typical error of the dipoles of `sign::winding`, turns: an estimate from test meshes, not a bound. Close to large
/// smooth sheets the error may be ten times larger.
const DIPOLE_ERROR: f64 = 0.01;
