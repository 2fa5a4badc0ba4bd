//! The side of the surface by angle-weighted pseudonormals.
//!
//! The sign is the sign of (p - q).n, where q is the closest point and n the normal of its feature: the face normal,
//! the sum of the two face normals at an edge, or the angle-weighted sum at a vertex. The sign is right for closed,
//! consistently wound surfaces without self-intersections: Baerentzen and Aanaes, *Signed distance computation using
//! the angle weighted pseudonormal*, IEEE TVCG 11(3), 2005. Faces are oriented as the topology decided.

use crate::bvh::nearest::closest::ClosestPoint;
use crate::geometry::{Feature, is_needle, triangle_cross};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::mesh::topology::{Orientation, direction};
use glam::DVec3;
use std::collections::HashMap;

/// Normals by feature. Only their direction is used.
#[derive(Debug)]
pub struct Pseudonormals {
    face: Vec<DVec3>,
    /// Normals of vertices, by welded vertex.
    vertex: Vec<DVec3>,
    /// Normals of edges, by the welded vertices of the edge, the lower index first.
    edge: HashMap<[u32; 2], DVec3>,
}

impl Derived for Pseudonormals {
    fn derive(mesh: &Mesh) -> Self {
        let topology = mesh.topology();
        let mut face = Vec::with_capacity(mesh.faces().len());
        let mut vertex = vec![DVec3::ZERO; mesh.positions().len()];
        let mut edge: HashMap<[u32; 2], DVec3> = HashMap::with_capacity(mesh.faces().len() * 3 / 2);
        for f in 0..mesh.faces().len() {
            let corners = mesh.exact_triangle(f as u32);
            let normal = normal_of(corners) * direction(topology.orientation[f]);
            face.push(normal);
            for i in 0..3 {
                let (here, next, previous) = (corners[i], corners[(i + 1) % 3], corners[(i + 2) % 3]);
                let angle = (next - here).angle_between(previous - here);
                vertex[topology.welded[mesh.faces()[f][i] as usize] as usize] += normal * angle;
                *edge.entry(edge_key(mesh, f as u32, i)).or_default() += normal;
            }
        }
        let mut normals = Self { face, vertex, edge };
        // A repeated face has the normal of its first occurrence. Both share their edges, so the sum keeps its
        // direction.
        for f in 0..mesh.faces().len() {
            if topology.orientation[f] == Orientation::Skipped {
                let own = normal_of(mesh.exact_triangle(f as u32));
                let around: f64 = (0..3).map(|i| normals.edge[&edge_key(mesh, f as u32, i)].dot(own)).sum();
                normals.face[f] = if around < 0.0 { -own } else { own };
            }
        }
        normals
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.face[..])
            + size_of_val(&self.vertex[..])
            + self.edge.capacity() * size_of::<([u32; 2], DVec3)>()
    }
}

impl Mesh {
    /// Angle-weighted normals of vertices and edges, computed at the first call.
    pub fn pseudonormals(&self) -> &Pseudonormals {
        self.derived()
    }
}

impl Pseudonormals {
    /// The normal of a feature of a face. Its length is arbitrary, and zero if the faces cancel.
    pub fn at(&self, mesh: &Mesh, face: u32, feature: Feature) -> DVec3 {
        match feature {
            Feature::Face => self.face[face as usize],
            Feature::Edge(i) => self.edge[&edge_key(mesh, face, usize::from(i))],
            Feature::Vertex(i) => {
                let v = mesh.faces()[face as usize][usize::from(i)];
                self.vertex[mesh.topology().welded[v as usize] as usize]
            }
        }
    }

    /// Whether a local point lies behind the surface at its closest point.
    pub fn is_inside(&self, mesh: &Mesh, p: DVec3, closest: &ClosestPoint) -> bool {
        let normal = self.at(mesh, closest.face, closest.on_triangle.feature);
        (p - closest.on_triangle.point).dot(normal) < 0.0
    }
}

/// Unit normal of a triangle, zero for a needle. The normals of its edges are then the normals of its neighbours.
fn normal_of(corners: [DVec3; 3]) -> DVec3 {
    if is_needle(corners) { DVec3::ZERO } else { triangle_cross(corners).normalize_or_zero() }
}

fn edge_key(mesh: &Mesh, face: u32, i: usize) -> [u32; 2] {
    let corners = mesh.faces()[face as usize];
    let [a, b] = [corners[i], corners[(i + 1) % 3]].map(|v| mesh.topology().welded[v as usize]);
    [a.min(b), a.max(b)]
}
