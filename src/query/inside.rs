//! The side and the winding number of points, without distances.

use super::{CHUNK, check_points, evaluate_in_order, prepare};
use crate::bvh::BOX_ROUNDING;
use crate::error::Error;
use crate::gpu::Place;
use crate::memory::{space_for, zeroed_rows};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SignMethod, SignRule};
use crate::solid::SideGrid;
use glam::DVec3;
use rayon::prelude::*;

/// Whether each world position is inside.
///
/// Many points are decided by the cells of a grid ([`SideGrid`]), the others along the curve.
pub fn contains(mesh: &Mesh, points: &[[f64; 3]], method: SignMethod, progress: &Progress) -> Result<Vec<bool>, Error> {
    check_points(mesh, points)?;
    let choice = prepare(mesh, method);
    let Some(grid) = SideGrid::new(mesh, &choice.rule, points.len(), progress)? else {
        return contains_each(mesh, points, &choice.rule, progress);
    };
    let mut inside: Vec<bool> = zeroed_rows("results", points.len())?;
    let parts = inside.par_chunks_mut(CHUNK).zip(points.par_chunks(CHUNK)).enumerate();
    let rows = parts
        .map(|(part, (inside, points))| {
            let mut rows = Vec::new();
            for (i, (inside, &point)) in inside.iter_mut().zip(points).enumerate() {
                match grid.side(mesh.local_from_world(DVec3::from_array(point))) {
                    Some(side) => *inside = side,
                    None => rows.push((part * CHUNK + i) as u32),
                }
            }
            progress.check().map(|()| rows)
        })
        .collect::<Result<Vec<Vec<u32>>, _>>()?;
    drop(grid);
    let rows = rows.concat();
    let mut others: Vec<[f64; 3]> = space_for("points", rows.len())?;
    rows.par_iter().map(|&row| points[row as usize]).collect_into_vec(&mut others);
    let sides = contains_each(mesh, &others, &choice.rule, progress)?;
    rows.into_iter().zip(sides).for_each(|(row, side)| inside[row as usize] = side);
    Ok(inside)
}

/// [`contains`] of points that each need a search.
fn contains_each(mesh: &Mesh, points: &[[f64; 3]], rule: &SignRule, progress: &Progress) -> Result<Vec<bool>, Error> {
    let bounds = mesh.bvh().bounds;
    // The box contains float32 positions.
    let (lower, upper) = (bounds.min.as_dvec3() - BOX_ROUNDING, bounds.max.as_dvec3() + BOX_ROUNDING);
    let closed = mesh.topology().closed;
    if matches!(rule, SignRule::Counted(_)) {
        mesh.ray_packs();
    }
    let ordered = evaluate_in_order(&Place::Cpu, mesh, points, progress, |walk, p, row| {
        match rule {
            SignRule::Pseudonormal | SignRule::Normal => {
                let closest = walk.closest_point(p, row);
                walk.is_inside(rule, p, &closest)
            }
            // No point outside the box of a closed surface is inside.
            SignRule::Counted(_) if closed && (p.cmplt(lower).any() || p.cmpgt(upper).any()) => false,
            rule => walk.sides.is_inside_by_ray(rule, mesh, p),
        }
    })?;
    ordered.into_rows(progress)
}

/// The winding number of each world position, of the faces as they are wound.
pub fn winding_numbers(mesh: &Mesh, points: &[[f64; 3]], error: f64, progress: &Progress) -> Result<Vec<f64>, Error> {
    check_points(mesh, points)?;
    if !mesh.is_prepared() {
        rayon::join(|| mesh.bvh(), || mesh.topology());
    }
    let closure = mesh.raw_closure();
    let fast = derive_winding_tables(mesh, error);
    let ordered = evaluate_in_order(&Place::Cpu, mesh, points, progress, |_, p, _| {
        if fast { mesh.moments().winding(mesh, p) } else { closure.winding(mesh, p) }
    })?;
    ordered.into_rows(progress)
}

/// Builds the tables that [`winding_numbers`] reads, and returns whether it sums dipoles.
pub fn derive_winding_tables(mesh: &Mesh, error: f64) -> bool {
    let is_costly = mesh.raw_closure().is_costly(mesh);
    // The dipoles use the repaired orientation, so they apply to surfaces without a repair only.
    let topology = mesh.topology();
    let is_repaired = topology.flipped_faces > 0 || topology.duplicate_faces > 0;
    let fast = error >= DIPOLE_ERROR && !is_repaired && is_costly;
    if fast {
        mesh.moments();
    }
    fast
}

/// Typical error of the dipoles of `sign::winding`, turns: an estimate from test meshes, not a bound. Close to large
/// smooth sheets the error may be ten times larger.
const DIPOLE_ERROR: f64 = 0.01;
