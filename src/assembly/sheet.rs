//! The common point of a flat sheet and a solid. A sheet has no inside, so their clearance there is exactly 0.

use super::Similarity;
use super::solid::Solid;
use crate::geometry::closest_point_on_triangle;
use crate::mesh::Mesh;
use glam::DVec3;

/// Largest number of projections onto one triangle.
const MAX_PROJECTIONS: usize = 200;
/// Number of bisections between a point inside and a point outside: the digits of float64.
const BISECTIONS: usize = 53;

/// A point of a sheet within `rounding` of a solid or in it. It lies on the surface of the solid, if a triangle with an
/// inner point also has a corner outside. `place` belongs to the sheet. The search in a triangle is local where the
/// solid is not convex.
pub(super) fn common_point(sheet: &Mesh, place: &Similarity, solid: &mut Solid<'_>, rounding: f64) -> Option<DVec3> {
    let world = sheet.world_positions();
    let mut inner = None;
    for face in sheet.faces() {
        let corners = face.map(|vertex| place.point(DVec3::from_array(world[vertex as usize])));
        let Some(deepest) = deepest_point(corners, solid, rounding) else { continue };
        let outside = corners.into_iter().find(|&corner| solid.distance(corner) > rounding);
        let Some(mut outer) = outside else {
            inner = inner.or(Some(deepest));
            continue;
        };
        let mut common = deepest;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (common + outer);
            if solid.distance(middle) <= 0.0 {
                common = middle;
            } else {
                outer = middle;
            }
        }
        return Some(common);
    }
    inner
}

/// A point of a triangle whose distance from a solid is at most `rounding`, by projected gradients.
fn deepest_point(corners: [DVec3; 3], solid: &mut Solid<'_>, rounding: f64) -> Option<DVec3> {
    let [a, b, c] = corners;
    for start in [(a + b + c) / 3.0, a, b, c] {
        let (mut point, mut value) = (start, solid.value(start));
        for _ in 0..MAX_PROJECTIONS {
            if value.distance <= rounding {
                return Some(point);
            }
            let next = closest_point_on_triangle(point - value.distance * value.gradient, corners).point;
            let found = solid.value(next);
            if found.distance >= value.distance - rounding {
                break;
            }
            (point, value) = (next, found);
        }
    }
    None
}
