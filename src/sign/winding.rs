//! Fast generalised winding numbers of any triangles: far parts of the mesh are evaluated as dipoles.
//!
//! *Theory.* The solid angle of the surface as seen from p, over 4 pi, is 1 inside and 0 outside a closed mesh and
//! varies smoothly across openings (Jacobson, Kavan, Sorkine-Hornung, *Robust inside-outside segmentation using
//! generalized winding numbers*, 2013). From far away a set of faces acts as its area vector N at the area-weighted
//! centre, plus a first moment C (Barill, Dickson, Schmidt, Levin, Jacobson, *Fast winding numbers for soups and
//! clouds*, 2018). With x from p to that centre:
//!
//! ```text
//! 4 pi w  ~  N.x / |x|^3  +  (tr C - 3 x.C x / |x|^2) / |x|^3
//! ```
//!
//! Only the symmetric part of C contributes: six values. A part is far if |x| exceeds [`BETA`] times its radius; near
//! leaves are summed exactly. The error is of order (radius/|x|)^2 of the angle of a part. There is no proven bound of
//! the sum. It stays below 0.01 of a turn on the test meshes; 0.1 was measured close to a large smooth sheet. Only the
//! comparison with 1/2 is used.
//!
//! *Slivers.* A long thin triangle makes the radius of its node large, so that few points are far from it. Solid angles
//! are additive, so the faces may be divided without a change of the sum. If a mesh has many slivers, they are cut
//! into short pieces, and the moments come from a tree over the pieces. A mesh that would have too many pieces keeps
//! the tree over its faces, which is slower beside slivers and as accurate.

use crate::bvh::moments::{Cluster, NodeMoments};
use crate::bvh::{Bvh, ChildRef, MAX_STACK, WIDTH};
use crate::geometry::{SolidAngles, triangle_cross};
use crate::mesh::Mesh;
use crate::mesh::derived::{Derived, on_own_threads};
use crate::mesh::topology::direction;
use glam::{DMat3, DVec3, Vec3};
use std::f64::consts::PI;

/// Ratio of distance to radius from which a part counts as a dipole. Barill et al. use 2 with one more order of
/// moments.
const BETA: f32 = 2.5;

/// Moments of every node of a mesh's tree, or of the tree over its pieces.
#[derive(Debug)]
pub struct Moments {
    nodes: Vec<NodeMoments>,
    pieces: Option<Pieces>,
}

/// The faces of a mesh, of which the slivers are cut into pieces, and the tree over all of them.
#[derive(Debug)]
struct Pieces {
    bvh: Bvh,
    /// Corners in the orientation of the topology, local units.
    triangles: Vec<[DVec3; 3]>,
}

/// A face is a sliver if its longest edge is more than this many times its height.
const SLIVER: f64 = 16.0;
/// The longest edge of a sliver is divided by this. A sliver becomes twice as many pieces.
const CUTS: f64 = 8.0;
/// Slivers are cut if a point in the unit box is expected to lie near more of them. The dipoles of the others cost
/// about as much as the exact angles of so many faces.
const MOST_NEAR: f64 = 64.0;
/// Largest number of pieces, which include the faces that are not cut. A piece takes about 200 bytes, and 280 while the
/// tree is built: the limit is 0.4 GB, and 0.6 GB during the build.
const MOST_PIECES: usize = 2_000_000;

impl Pieces {
    /// The pieces of a mesh with many slivers; None for other meshes, and if there would be more than `most` pieces.
    fn of(mesh: &Mesh, most: usize) -> Option<Self> {
        let faces = 0..mesh.faces().len() as u32;
        let length = |face: u32| {
            let corners = mesh.triangle(face);
            let (longest, cross) = (longest_edge(corners).1, triangle_cross(corners).length());
            (cross > 0.0 && longest > SLIVER * cross).then_some(longest.sqrt())
        };
        // A sliver is near in a ball of BETA times half its length. The volume of that ball is 8 times its length
        // cubed.
        let near: f64 = faces.clone().filter_map(length).map(|length| (8.0 * length.powi(3)).min(1.0)).sum();
        if near <= MOST_NEAR {
            return None;
        }
        let mut triangles = Vec::with_capacity(most.min(2 * mesh.faces().len()));
        for face in faces {
            if let Some(corners) = mesh.topology().oriented_face(mesh, face) {
                let corners = corners.map(|v| mesh.positions()[v as usize].as_dvec3());
                cut(corners, length(face).map_or(f64::INFINITY, |length| length / CUTS), &mut triangles);
                if triangles.len() > most {
                    return None;
                }
            }
        }
        if triangles.is_empty() {
            return None;
        }
        let positions: Vec<Vec3> = triangles.as_flattened().iter().map(|corner| corner.as_vec3()).collect();
        let faces: Vec<[u32; 3]> = (0..triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        // A piece may have no area after rounding to float32. Its frame in the packs is then undefined, but only the
        // boxes and the members of this tree are read, which are defined for every piece. Angles and moments are
        // computed from the float64 corners, so such a piece counts like any other.
        Some(Self { bvh: on_own_threads(|| Bvh::build(&positions, &faces)), triangles })
    }
}

/// The longest edge of a triangle, from corner i to the next one: i and the squared length.
fn longest_edge([a, b, c]: [DVec3; 3]) -> (usize, f64) {
    let squared = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    (1..3).fold((0, squared[0]), |longest, i| if squared[i] > longest.1 { (i, squared[i]) } else { longest })
}

/// Divides a triangle until no edge is longer than `most`: halves the longest edge.
fn cut(triangle: [DVec3; 3], most: f64, pieces: &mut Vec<[DVec3; 3]>) {
    let (i, squared) = longest_edge(triangle);
    if squared <= most * most {
        pieces.push(triangle);
        return;
    }
    let [from, to, apex] = [0, 1, 2].map(|k| triangle[(i + k) % 3]);
    let middle = (from + to) * 0.5;
    cut([from, middle, apex], most, pieces);
    cut([middle, to, apex], most, pieces);
}

/// The cluster of triangles, each with the factor of its area vector.
fn cluster_of(triangles: impl Iterator<Item = ([DVec3; 3], f64)>) -> Cluster {
    let members = triangles.map(|([a, b, c], turned)| {
        let area = triangle_cross([a, b, c]) * 0.5;
        // A piece may have no area. With a small weight the centre is defined.
        let weight = area.length().max(f64::MIN_POSITIVE);
        Cluster { weight, center: (a + b + c) / 3.0, area: area * turned, first: DMat3::ZERO }
    });
    Cluster::join(&members.collect::<Vec<_>>())
}

impl Derived for Moments {
    fn derive(mesh: &Mesh) -> Self {
        let pieces = Pieces::of(mesh, MOST_PIECES);
        let bvh = tree(mesh, pieces.as_ref());
        let mut nodes = vec![NodeMoments::EMPTY; bvh.nodes.len()];
        let mut parts = vec![Cluster::default(); bvh.nodes.len()];
        // Children follow their parents in memory, so the loop runs backwards.
        for index in (0..nodes.len()).rev() {
            let node = &bvh.nodes[index];
            let mut children = Vec::with_capacity(WIDTH);
            for lane in (0..WIDTH).filter(|&lane| !node.children[lane].is_none()) {
                let child = node.children[lane];
                let part = if child.is_pack() {
                    let members = bvh.packs[child.index()].faces();
                    cluster_of(members.iter().map(|&member| triangle(mesh, pieces.as_ref(), member)))
                } else {
                    parts[child.index()]
                };
                let corner =
                    |of: &[[f32; WIDTH]; 3]| DVec3::from_array([0, 1, 2].map(|axis| f64::from(of[axis][lane])));
                // The farthest corner of the box bounds the radius of the part.
                let reach = (corner(&node.max) - part.center).abs().max((corner(&node.min) - part.center).abs());
                nodes[index].set(lane, &part, BETA * reach.length() as f32);
                children.push(part);
            }
            parts[index] = Cluster::join(&children);
        }
        Self { nodes, pieces }
    }

    fn bytes(&self) -> usize {
        let pieces = self.pieces.as_ref().map_or(0, |pieces| pieces.bvh.bytes() + size_of_val(&pieces.triangles[..]));
        size_of_val(&self.nodes[..]) + pieces
    }
}

/// The tree of the moments.
fn tree<'a>(mesh: &'a Mesh, pieces: Option<&'a Pieces>) -> &'a Bvh {
    pieces.map_or_else(|| mesh.built_bvh(), |pieces| &pieces.bvh)
}

/// A triangle of that tree, and the factor of its area vector in the orientation of the topology.
fn triangle(mesh: &Mesh, pieces: Option<&Pieces>, member: u32) -> ([DVec3; 3], f64) {
    match pieces {
        Some(pieces) => (pieces.triangles[member as usize], 1.0),
        None => (mesh.triangle(member), direction(mesh.topology().orientation[member as usize])),
    }
}

impl Mesh {
    /// Multipole moments for the fast winding number, computed at the first call.
    pub fn moments(&self) -> &Moments {
        self.derived()
    }
}

impl Moments {
    /// Whether the mesh has slivers that were cut.
    #[cfg(test)]
    pub fn has_pieces(&self) -> bool {
        self.pieces.is_some()
    }

    /// Winding number of a local point.
    pub fn winding(&self, mesh: &Mesh, p: DVec3) -> f64 {
        let pieces = self.pieces.as_ref();
        let bvh = tree(mesh, pieces);
        let p_single = p.as_vec3();
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Bvh::ROOT;
        let mut top = 1;
        let mut angle = 0.0;
        while top > 0 {
            top -= 1;
            let child = stack[top];
            if child.is_pack() {
                let mut angles = SolidAngles::default();
                for &member in bvh.packs[child.index()].faces() {
                    let ([a, b, c], turned) = triangle(mesh, pieces, member);
                    if turned != 0.0 {
                        let [b, c] = if turned > 0.0 { [b, c] } else { [c, b] };
                        angles.add([a - p, b - p, c - p]);
                    }
                }
                angle += angles.sum();
                continue;
            }
            let node = &bvh.nodes[child.index()];
            let moments = &self.nodes[child.index()];
            let (angles, squares) = moments.angles(p_single, Vec3::ZERO);
            for lane in 0..WIDTH {
                if node.children[lane].is_none() {
                    continue;
                }
                if squares[lane] > moments.far_squared[lane] {
                    angle += f64::from(angles[lane]);
                } else {
                    stack[top] = node.children[lane];
                    top += 1;
                }
            }
        }
        angle / (4.0 * PI)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::uniform;
    use crate::sign::tests::slivers;

    #[test]
    fn the_number_of_pieces_is_limited() {
        let mesh = slivers(1500, 1e-3, &mut uniform(3));
        let count = Pieces::of(&mesh, MOST_PIECES).unwrap().triangles.len();
        assert!(count > mesh.faces().len());
        assert!(Pieces::of(&mesh, count).is_some());
        assert!(Pieces::of(&mesh, count - 1).is_none());
    }

    /// Triangles whose corners coincide, alone and beside a triangle with an area.
    #[test]
    fn pieces_without_area_leave_the_moments_defined() {
        let flat = [DVec3::splat(0.25), DVec3::splat(0.25), DVec3::splat(0.25)];
        let cluster = cluster_of([(flat, 1.0), (flat, 1.0)].into_iter());
        assert!(cluster.center.distance(flat[0]) < 1e-12, "{}", cluster.center);
        let corners = [flat[0], flat[0] + DVec3::X, flat[0] + DVec3::Y];
        let joined = Cluster::join(&[cluster, cluster_of([(corners, 1.0)].into_iter())]);
        assert_eq!(joined.center, (corners[0] + corners[1] + corners[2]) / 3.0);
    }
}
