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
//! leaves are summed exactly. The error is of order (radius/|x|)^2 of the angle of a part. On the test meshes it stays
//! below 0.01, and only the comparison with 1/2 is used.

use crate::bvh::{Bvh, ChildRef, MAX_STACK, WIDTH};
use crate::geometry::{solid_angle, triangle_cross};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::mesh::topology::direction;
use glam::{DMat3, DVec3, Vec3};
use std::f64::consts::PI;

/// Ratio of distance to radius from which a part counts as a dipole. Barill et al. use 2 with one more order of
/// moments.
const BETA: f32 = 2.5;

/// Moments of the eight children of a node, side by side.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
struct NodeMoments {
    center: [[f32; WIDTH]; 3],
    /// Squared distance from which the child counts as far.
    far_squared: [f32; WIDTH],
    area: [[f32; WIDTH]; 3],
    /// Components xx, yy, zz, xy, yz, zx of the symmetric first moment; mixed terms are doubled.
    first: [[f32; WIDTH]; 6],
}

/// Moments of every node of a mesh's tree.
#[derive(Debug)]
pub struct Moments {
    nodes: Vec<NodeMoments>,
}

/// Moments of a set of faces about its centre.
#[derive(Clone, Copy, Default)]
struct FaceCluster {
    weight: f64,
    center: DVec3,
    area: DVec3,
    first: DMat3,
}

impl FaceCluster {
    fn of_faces(mesh: &Mesh, faces: &[u32]) -> Self {
        let members = faces.iter().map(|&face| {
            let [a, b, c] = mesh.triangle(face);
            let area = triangle_cross([a, b, c]) * 0.5;
            let turned = direction(mesh.topology().orientation[face as usize]);
            Self { weight: area.length(), center: (a + b + c) / 3.0, area: area * turned, first: DMat3::ZERO }
        });
        Self::join(members.collect())
    }

    fn join(parts: Vec<Self>) -> Self {
        let weight: f64 = parts.iter().map(|part| part.weight).sum();
        let center = parts.iter().map(|part| part.center * part.weight).sum::<DVec3>() / weight;
        let mut joined = Self { weight, center, ..Self::default() };
        for part in parts {
            let d = part.center - center;
            joined.area += part.area;
            // The outer product d N^T, by columns.
            joined.first += part.first + DMat3::from_cols(d * part.area.x, d * part.area.y, d * part.area.z);
        }
        joined
    }
}

impl Derived for Moments {
    fn derive(mesh: &Mesh) -> Self {
        let bvh = mesh.built_bvh();
        let empty = NodeMoments {
            center: [[0.0; WIDTH]; 3],
            far_squared: [0.0; WIDTH],
            area: [[0.0; WIDTH]; 3],
            first: [[0.0; WIDTH]; 6],
        };
        let mut nodes = vec![empty; bvh.nodes.len()];
        let mut parts = vec![FaceCluster::default(); bvh.nodes.len()];
        // Children follow their parents in memory, so the loop runs backwards.
        for index in (0..nodes.len()).rev() {
            let node = &bvh.nodes[index];
            let mut children = Vec::with_capacity(WIDTH);
            for lane in (0..WIDTH).filter(|&lane| !node.children[lane].is_none()) {
                let child = node.children[lane];
                let part = if child.is_pack() {
                    FaceCluster::of_faces(mesh, bvh.packs[child.index()].faces())
                } else {
                    parts[child.index()]
                };
                let corner =
                    |of: &[[f32; WIDTH]; 3]| DVec3::from_array([0, 1, 2].map(|axis| f64::from(of[axis][lane])));
                // The farthest corner of the box bounds the radius of the part.
                let reach = (corner(&node.max) - part.center).abs().max((corner(&node.min) - part.center).abs());
                nodes[index].set(lane, &part, reach.length());
                children.push(part);
            }
            parts[index] = FaceCluster::join(children);
        }
        Self { nodes }
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..])
    }
}

impl Mesh {
    /// Multipole moments for the fast winding number, computed at the first call.
    pub fn moments(&self) -> &Moments {
        self.derived()
    }
}

impl Moments {
    /// Winding number of a local point.
    pub fn winding(&self, mesh: &Mesh, p: DVec3) -> f64 {
        let bvh = mesh.built_bvh();
        let p_single = p.as_vec3();
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Bvh::ROOT;
        let mut top = 1;
        let mut angle = 0.0;
        while top > 0 {
            top -= 1;
            let child = stack[top];
            if child.is_pack() {
                angle += bvh.packs[child.index()].faces().iter().map(|&face| face_angle(mesh, face, p)).sum::<f64>();
                continue;
            }
            let node = &bvh.nodes[child.index()];
            let (angles, far) = self.nodes[child.index()].far_angles(p_single);
            for lane in 0..WIDTH {
                if node.children[lane].is_none() {
                    continue;
                }
                if far[lane] {
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

/// Exact solid angle of a face in the orientation of the topology.
fn face_angle(mesh: &Mesh, face: u32, p: DVec3) -> f64 {
    let turned = direction(mesh.topology().orientation[face as usize]);
    if turned == 0.0 { 0.0 } else { turned * solid_angle(mesh.triangle(face).map(|corner| corner - p)) }
}

impl NodeMoments {
    fn set(&mut self, lane: usize, part: &FaceCluster, radius: f64) {
        let c = &part.first;
        let symmetric = [
            c.x_axis.x,
            c.y_axis.y,
            c.z_axis.z,
            c.x_axis.y + c.y_axis.x,
            c.y_axis.z + c.z_axis.y,
            c.z_axis.x + c.x_axis.z,
        ];
        for axis in 0..3 {
            self.center[axis][lane] = part.center[axis] as f32;
            self.area[axis][lane] = part.area[axis] as f32;
        }
        for (row, value) in self.first.iter_mut().zip(symmetric) {
            row[lane] = value as f32;
        }
        self.far_squared[lane] = (BETA * radius as f32).powi(2);
    }

    /// Approximate solid angle of each child, and whether it is far enough for the approximation.
    #[inline(always)]
    fn far_angles(&self, p: Vec3) -> ([f32; WIDTH], [bool; WIDTH]) {
        let mut angles = [0.0; WIDTH];
        let mut far = [false; WIDTH];
        for i in 0..WIDTH {
            let (x, y, z) = (self.center[0][i] - p.x, self.center[1][i] - p.y, self.center[2][i] - p.z);
            let squared = x * x + y * y + z * z;
            let inverse = 1.0 / squared;
            let dipole = self.area[0][i] * x + self.area[1][i] * y + self.area[2][i] * z;
            let [xx, yy, zz, xy, yz, zx] = [0, 1, 2, 3, 4, 5].map(|k| self.first[k][i]);
            let along = xx * x * x + yy * y * y + zz * z * z + xy * x * y + yz * y * z + zx * z * x;
            angles[i] = (dipole + (xx + yy + zz) - 3.0 * along * inverse) * inverse * inverse.sqrt();
            far[i] = squared > self.far_squared[i];
        }
        (angles, far)
    }
}
