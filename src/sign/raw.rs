//! The signed winding number of the faces as they are wound, in float64.
//!
//! *Theory.* The edges that the faces do not traverse equally often in both directions form closed loops, the rims. A
//! cone from all rim edges to one apex closes the surface. The closed surface has an integer winding number, counted by
//! an axis-parallel ray with exact predicates (see [`super::crossing`]), and solid angles are additive: w(faces) =
//! integer - w(cone). The cost is therefore one ray and one solid angle per rim edge. The error comes from the sum of
//! those angles, about 1e-15 each.
//!
//! The sign rules of the other modules use repaired orientations. This module takes every face as it is wound,
//! including repeated and flipped ones. If the rims have more edges than the mesh has faces, the solid angles of the
//! faces themselves are summed.

use super::crossing::{Axes, RayBox, crossing};
use crate::geometry::SolidAngles;
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use glam::DVec3;
use rustc_hash::FxHashMap;
use std::f64::consts::PI;

/// Offset of the apex from the centre of the mesh's box, local units. It points away from the planes of typical points
/// and models, so that no point lies on the cone by symmetry.
const APEX: DVec3 = DVec3::new(0.003_69, 0.005_37, 0.007_58);

/// The triangles that close the surface of a mesh, local units.
#[derive(Debug)]
pub struct RawClosure {
    /// The cone over all rims.
    cone: Vec<[DVec3; 3]>,
}

impl Derived for RawClosure {
    fn derive(mesh: &Mesh) -> Self {
        let welded = &mesh.topology().welded;
        let mut net: FxHashMap<[u32; 2], i32> = FxHashMap::default();
        for face in mesh.faces() {
            for i in 0..3 {
                let [from, to] = [face[i], face[(i + 1) % 3]].map(|v| welded[v as usize]);
                *net.entry([from.min(to), from.max(to)]).or_default() += if from < to { 1 } else { -1 };
            }
        }
        let mut rims: Vec<([u32; 2], i32)> = net.into_iter().filter(|(_, count)| *count != 0).collect();
        rims.sort_unstable();
        let position = |v: u32| mesh.exact_position(v);
        let mut cone = Vec::new();
        for ([low, high], count) in rims {
            // The closing triangle traverses the edge in the other direction.
            let [from, to] = if count > 0 { [high, low] } else { [low, high] };
            let triangle = [position(from), position(to), APEX];
            cone.extend(std::iter::repeat_n(triangle, count.unsigned_abs() as usize));
        }
        Self { cone }
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.cone[..])
    }
}

impl Mesh {
    /// The triangles that close the faces as they are wound, built at the first call.
    pub fn raw_closure(&self) -> &RawClosure {
        self.derived()
    }
}

impl RawClosure {
    /// Whether the cost of a point is proportional to the number of faces.
    pub fn is_costly(&self, mesh: &Mesh) -> bool {
        8 * self.cone.len() > mesh.faces().len().max(1 << 12)
    }

    /// Winding number of a local point.
    pub fn winding(&self, mesh: &Mesh, p: DVec3) -> f64 {
        if self.cone.len() > mesh.faces().len() {
            let faces = 0..mesh.faces().len() as u32;
            return turns_at(p, faces.map(|face| mesh.exact_triangle(face)));
        }
        let mut count = 0;
        let axes = Axes::X;
        let ray = RayBox::new(p, axes);
        mesh.bvh().visit(
            |node| ray.overlaps(node),
            |pack| {
                for &face in pack.faces() {
                    if ray.overlaps_triangle(mesh, mesh.faces()[face as usize]) {
                        count += crossing(p, mesh.exact_triangle(face), axes);
                    }
                }
            },
        );
        count += self.cone.iter().map(|&triangle| crossing(p, triangle, axes)).sum::<i32>();
        f64::from(count) - turns_at(p, self.cone.iter().copied())
    }
}

/// Sum of the solid angles of triangles as seen from `p`, turns.
fn turns_at(p: DVec3, triangles: impl Iterator<Item = [DVec3; 3]>) -> f64 {
    let mut angles = SolidAngles::default();
    triangles.for_each(|corners| angles.add(corners.map(|corner| corner - p)));
    angles.sum() / (4.0 * PI)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::solid_angle;
    use crate::mesh::random::{soup, uniform};

    #[test]
    fn open_closed_and_damaged_surfaces_equal_the_sum_of_solid_angles() {
        let mut next = uniform(5);
        let mut random = || next() * 1.4 - 0.7;
        let corners: Vec<[f64; 3]> =
            (0..8).map(|i| [f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2)]).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let cube: Vec<[i64; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let mut flipped = cube.clone();
        flipped[3].swap(0, 1);
        let mut repeated = cube.clone();
        repeated.push(cube[5]);
        let reversed: Vec<[i64; 3]> = cube.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let surfaces = [cube.clone(), cube[..9].to_vec(), flipped, repeated, reversed];
        let meshes = surfaces.iter().map(|faces| Mesh::new(&corners, faces).unwrap());
        for mesh in meshes.chain([soup(60, 0.4, 9)]) {
            let closure = RawClosure::derive(&mesh);
            for _ in 0..200 {
                let p = DVec3::new(random(), random(), random());
                let faces = 0..mesh.faces().len() as u32;
                let corners = |face| mesh.exact_triangle(face).map(|corner| corner - p);
                let sum: f64 = faces.map(|face| solid_angle(corners(face))).sum();
                let found = closure.winding(&mesh, p);
                assert!((found - sum / (4.0 * PI)).abs() < 1e-12, "{p} {found} {}", sum / (4.0 * PI));
            }
        }
    }
}
