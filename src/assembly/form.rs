//! Meshes whose signed distance has a bound everywhere: convex solids and flat sheets.
//!
//! The signed distance of a convex solid is a convex function, so each of its tangents bounds it from below everywhere.
//! The winding number of a flat sheet whose triangles do not overlap is at most 1/2, so a sheet has no inside.

use crate::geometry::triangle_cross;
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use glam::DVec3;

/// Part of the size by which vertices may lie beyond a plane: the rounding of their positions by a rotation, sixteen
/// ulps, twice.
const ROUNDING: f64 = 32.0 * f64::EPSILON;
/// Largest number of pairs of a face and a vertex that are compared for a convex solid: a hundredth of a second.
const MAX_PAIRS: usize = 4_000_000;
/// Largest number of faces of a sheet, which are compared with each other.
const MAX_SHEET: usize = 256;

/// The form of a mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Form {
    /// A closed mesh that is the boundary of a convex solid, to rounding.
    Convex,
    /// Triangles of one plane that do not overlap.
    Sheet,
    Other,
}

impl Derived for Form {
    fn derive(mesh: &Mesh) -> Self {
        let world = mesh.world_positions();
        let corner = |v: u32| DVec3::from_array(world[v as usize]);
        let faces: Vec<[DVec3; 3]> = mesh.faces().iter().map(|face| face.map(corner)).collect();
        let mut used = vec![false; world.len()];
        mesh.faces().iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
        let points: Vec<DVec3> = (0..world.len()).filter(|&i| used[i]).map(|i| corner(i as u32)).collect();
        let (lower, upper) = points
            .iter()
            .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lower, upper), p| (lower.min(*p), upper.max(*p)));
        let allowed = ROUNDING * ((upper - lower).length() + lower.abs().max(upper.abs()).max_element());
        // A face without an area has no plane: the limit contains the rounding of its cross product.
        let limit = |face: &[DVec3; 3], cross: DVec3| allowed * cross.length().max(allowed * longest_side(face));
        if mesh.topology().closed {
            // A concave edge between neighbours in the list of faces ends most tests.
            let is_concave = |pair: &[[DVec3; 3]]| {
                let cross = triangle_cross(pair[0]);
                pair[1].iter().any(|p| cross.dot(*p - pair[0][0]) > limit(&pair[0], cross))
            };
            let is_comparable = faces.len().saturating_mul(points.len()) <= MAX_PAIRS;
            let is_below = |face: &[DVec3; 3]| {
                let cross = triangle_cross(*face);
                let limit = limit(face, cross);
                points.iter().all(|p| cross.dot(*p - face[0]) <= limit)
            };
            let is_convex = is_comparable && !faces.windows(2).any(is_concave) && faces.iter().all(is_below);
            return if is_convex { Self::Convex } else { Self::Other };
        }
        if faces.len() > MAX_SHEET {
            return Self::Other;
        }
        let crosses = faces.iter().map(|face| triangle_cross(*face));
        let Some(normal) = crosses.max_by(|a, b| a.length().total_cmp(&b.length())).and_then(DVec3::try_normalize)
        else {
            return Self::Other;
        };
        let is_flat = points.iter().all(|p| normal.dot(*p - faces[0][0]).abs() <= allowed);
        let overlaps = |i: usize| faces[..i].iter().any(|other| overlap_in_plane(&faces[i], other, normal, allowed));
        if is_flat && !(0..faces.len()).any(overlaps) { Self::Sheet } else { Self::Other }
    }

    fn bytes(&self) -> usize {
        0
    }
}

fn longest_side([a, b, c]: &[DVec3; 3]) -> f64 {
    a.distance(*b).max(b.distance(*c)).max(c.distance(*a))
}

/// Whether two triangles of a plane overlap by more than `allowed`. If not, a line along a side separates them.
fn overlap_in_plane(a: &[DVec3; 3], b: &[DVec3; 3], normal: DVec3, allowed: f64) -> bool {
    let separates = |first: &[DVec3; 3], second: &[DVec3; 3]| {
        (0..3).any(|i| {
            let Some(across) = (first[(i + 1) % 3] - first[i]).cross(normal).try_normalize() else { return false };
            [across, -across].into_iter().any(|n| {
                let along = |triangle: &[DVec3; 3]| triangle.map(|p| n.dot(p - first[i]));
                let highest = along(first).into_iter().fold(f64::NEG_INFINITY, f64::max);
                let lowest = along(second).into_iter().fold(f64::INFINITY, f64::min);
                lowest >= highest - allowed
            })
        })
    };
    !separates(a, b) && !separates(b, a)
}
