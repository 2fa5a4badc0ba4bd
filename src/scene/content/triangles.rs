//! A mesh for the primary pass: smooth normals, texture coordinates, and the material of each face.
//!
//! Files rarely contain normals that fit their faces, so they are computed here: at each corner the mean of the faces
//! around the vertex, weighted by their angles there, of those within [`CREASE_DEG`] of the corner's own face. Scans
//! are therefore smooth, and boxes keep their edges.

use crate::error::{Error, SceneError};
use crate::geometry::triangle_cross;
use crate::mesh::Mesh;
use glam::{DVec3, Vec2, Vec3, Vec4};
use std::collections::BTreeSet;
use std::sync::{Arc, OnceLock};

/// Largest angle between faces that share a smooth normal.
const CREASE_DEG: f64 = 45.0;

/// A mesh prepared for drawing.
#[derive(Debug)]
pub struct Triangles {
    pub mesh: Arc<Mesh>,
    /// Texture coordinates, one row per vertex; empty without any.
    pub uv: Vec<Vec2>,
    /// Index of the material of each face among the materials of the mesh.
    pub material: Vec<u32>,
    /// Unit normals of the corners of each face, in the mesh's axes.
    pub normals: Vec<[Vec3; 3]>,
    /// Linear RGBA of each vertex, a factor of the material's colour; empty without any.
    vertex_colors: Vec<Vec4>,
    /// Linear RGBA of each face, another factor; empty without any.
    face_colors: Vec<Vec4>,
    /// Indices in `material`, each once, in ascending order.
    used_materials: Vec<u32>,
    has_opacity: OnceLock<bool>,
    is_flat: OnceLock<bool>,
}

impl Triangles {
    pub fn new(mesh: Arc<Mesh>, uv: Vec<Vec2>, material: Vec<u32>) -> Result<Self, Error> {
        let (vertices, faces) = (mesh.positions().len(), mesh.faces().len());
        if !(uv.is_empty() || uv.len() == vertices) {
            return Err(SceneError::new("uv", format!("{} rows for {vertices} vertices", uv.len())).into());
        }
        if material.len() != faces {
            return Err(SceneError::new("material", format!("{} rows for {faces} faces", material.len())).into());
        }
        let normals = corner_normals(&mesh);
        let used_materials = material.iter().copied().collect::<BTreeSet<_>>().into_iter().collect();
        Ok(Self {
            mesh,
            uv,
            material,
            normals,
            vertex_colors: Vec::new(),
            face_colors: Vec::new(),
            used_materials,
            has_opacity: OnceLock::new(),
            is_flat: OnceLock::new(),
        })
    }

    /// Adds colours of the vertices and faces; an empty list is white.
    pub fn with_colors(mut self, vertices: Vec<Vec4>, faces: Vec<Vec4>) -> Result<Self, Error> {
        let counts = [self.mesh.positions().len(), self.mesh.faces().len()];
        for (what, colors, count) in [("vertex_colors", &vertices, counts[0]), ("face_colors", &faces, counts[1])] {
            if !(colors.is_empty() || colors.len() == count) {
                return Err(SceneError::new(what, format!("{} rows for {count}", colors.len())).into());
            }
        }
        (self.vertex_colors, self.face_colors) = (vertices, faces);
        Ok(self)
    }

    /// Linear RGBA of the vertices, interpolated with the barycentric weights of the corners, times the RGBA of the
    /// face.
    pub fn color_at(&self, face: u32, weights: [f32; 3]) -> Vec4 {
        let mut color = self.face_colors.get(face as usize).copied().unwrap_or(Vec4::ONE);
        if !self.vertex_colors.is_empty() {
            let [a, b, c] = self.mesh.faces()[face as usize].map(|vertex| self.vertex_colors[vertex as usize]);
            color *= a * weights[0] + b * weights[1] + c * weights[2];
        }
        color
    }

    /// Whether a colour of a vertex or face is not opaque.
    pub fn has_opacity(&self) -> bool {
        *self.has_opacity.get_or_init(|| self.vertex_colors.iter().chain(&self.face_colors).any(|color| color.w != 1.0))
    }

    /// Indices of the materials that faces have, each once, in ascending order.
    pub fn used_materials(&self) -> &[u32] {
        &self.used_materials
    }

    /// Number of materials that the mesh needs: the largest index plus one.
    pub fn material_count(&self) -> usize {
        self.used_materials.last().map_or(1, |&last| last as usize + 1)
    }

    /// Whether all vertices lie within `tolerance` of the plane of the largest face, local units. The result is kept,
    /// so all callers pass the same tolerance.
    pub fn is_flat(&self, tolerance: f64) -> bool {
        *self.is_flat.get_or_init(|| {
            let faces = 0..self.mesh.faces().len() as u32;
            let largest = |face: u32| (triangle_cross(self.mesh.triangle(face)), self.mesh.triangle(face)[0]);
            let area = |(cross, _): &(DVec3, DVec3)| cross.length_squared();
            let Some((cross, a)) = faces.clone().map(largest).max_by(|x, y| area(x).total_cmp(&area(y))) else {
                return false;
            };
            let normal = cross.normalize_or_zero();
            let is_near = |p: &DVec3| (*p - a).dot(normal).abs() <= tolerance;
            faces.clone().all(|face| self.mesh.triangle(face).iter().all(is_near))
        })
    }

    /// Texture coordinates at barycentric weights of the corners; zero if the mesh has none.
    pub fn uv_at(&self, face: u32, weights: [f32; 3]) -> Vec2 {
        if self.uv.is_empty() {
            return Vec2::ZERO;
        }
        let [a, b, c] = self.mesh.faces()[face as usize].map(|vertex| self.uv[vertex as usize]);
        a * weights[0] + b * weights[1] + c * weights[2]
    }

    /// Smooth normal at barycentric weights of the corners, in the mesh's axes, not of unit length.
    pub fn normal_at(&self, face: u32, weights: [f32; 3]) -> Vec3 {
        let [a, b, c] = self.normals[face as usize];
        a * weights[0] + b * weights[1] + c * weights[2]
    }

    /// Offset from a point of a face to the smooth surface above it, local units: the mean of the offsets to the planes
    /// at the corners that are above the point, by the weights of the corners (Hanika, *Hacking the shadow terminator*,
    /// Ray Tracing Gems II, 2021). It is zero where the normals equal the normal of the face, and where the surface is
    /// hollow.
    pub fn to_smooth_surface(&self, face: u32, weights: [f64; 3], is_front: bool) -> Vec3 {
        let corners = self.mesh.triangle(face);
        let p: DVec3 = corners.iter().zip(weights).map(|(&corner, weight)| weight * corner).sum();
        let above = |((corner, normal), weight): ((&DVec3, &Vec3), f64)| {
            let normal = if is_front { normal.as_dvec3() } else { -normal.as_dvec3() };
            weight * (*corner - p).dot(normal).max(0.0) * normal
        };
        corners.iter().zip(&self.normals[face as usize]).zip(weights).map(above).sum::<DVec3>().as_vec3()
    }

    /// Texture widths per local unit on a face: the square root of the ratio of areas.
    pub fn uv_density(&self, face: u32) -> f32 {
        if self.uv.is_empty() {
            return 0.0;
        }
        let [a, b, c] = self.mesh.faces()[face as usize].map(|vertex| self.uv[vertex as usize]);
        let (ab, ac) = (b - a, c - a);
        let [p, q, r] = self.mesh.triangle(face);
        let area = (q - p).cross(r - p).length() as f32;
        (ab.perp_dot(ac).abs() / area.max(f32::MIN_POSITIVE)).sqrt()
    }

    pub fn bytes(&self) -> usize {
        let colors = size_of_val(&self.vertex_colors[..]) + size_of_val(&self.face_colors[..]);
        let rows = size_of_val(&self.uv[..]) + size_of_val(&self.material[..]) + size_of_val(&self.normals[..]);
        self.mesh.bytes() + rows + colors
    }
}

fn corner_normals(mesh: &Mesh) -> Vec<[Vec3; 3]> {
    let welded = &mesh.topology().welded;
    let unit: Vec<DVec3> = (0..mesh.faces().len() as u32)
        .map(|face| {
            let [a, b, c] = mesh.triangle(face);
            (b - a).cross(c - a).normalize_or_zero()
        })
        .collect();
    // The corners at each position: face and angle, sorted by position.
    let mut around: Vec<(u32, u32, f64)> = Vec::with_capacity(3 * mesh.faces().len());
    for (face, corners) in mesh.faces().iter().enumerate() {
        let p = mesh.triangle(face as u32);
        for i in 0..3 {
            let (to_next, to_last) = (p[(i + 1) % 3] - p[i], p[(i + 2) % 3] - p[i]);
            around.push((welded[corners[i] as usize], face as u32, to_next.angle_between(to_last)));
        }
    }
    around.sort_by_key(|&(place, face, _)| (place, face));
    let mut first = vec![0usize; mesh.positions().len() + 1];
    for &(place, ..) in &around {
        first[place as usize + 1] += 1;
    }
    for i in 1..first.len() {
        first[i] += first[i - 1];
    }

    let crease = CREASE_DEG.to_radians().cos();
    let normal_of = |face: usize, vertex: u32| {
        let own = unit[face];
        let place = welded[vertex as usize] as usize;
        let sum: DVec3 = around[first[place]..first[place + 1]]
            .iter()
            .filter(|(_, other, _)| unit[*other as usize].dot(own) >= crease)
            .map(|(_, other, angle)| unit[*other as usize] * *angle)
            .sum();
        sum.try_normalize().unwrap_or(own).as_vec3()
    };
    mesh.faces().iter().enumerate().map(|(face, corners)| corners.map(|vertex| normal_of(face, vertex))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn triangles(vertices: &[[f64; 3]], faces: &[[i64; 3]]) -> Triangles {
        Triangles::new(Arc::new(Mesh::new(vertices, faces).unwrap()), vec![], vec![0; faces.len()]).unwrap()
    }

    #[test]
    fn a_right_angle_is_an_edge_and_a_gentle_one_is_smooth() {
        // Two quads that share the y axis; the second rises by `angle`.
        let folded = |angle: f64| {
            let (x, z) = (angle.cos(), angle.sin());
            let vertices = [
                [-1.0, 0.0, 0.0],
                [0.0, 0.0, 0.0],
                [0.0, 1.0, 0.0],
                [-1.0, 1.0, 0.0],
                // The shared edge again: equal positions count as one.
                [0.0, 0.0, 0.0],
                [x, 0.0, z],
                [x, 1.0, z],
                [0.0, 1.0, 0.0],
            ];
            triangles(&vertices, &[[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
        };
        let sharp = folded(1.2);
        assert!(sharp.normal_at(0, [0.0, 1.0, 0.0]).distance(Vec3::Z) < 1e-6);
        let smooth = folded(0.4);
        let at_edge = smooth.normal_at(0, [0.0, 1.0, 0.0]).normalize();
        assert!(at_edge.x < -0.05 && at_edge.z > 0.9);
        assert!(smooth.normal_at(0, [1.0, 0.0, 0.0]).distance(Vec3::Z) < 1e-6);
    }

    #[test]
    fn rows_must_match() {
        let mesh = Arc::new(Mesh::new(&[[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], &[[0, 1, 2]]).unwrap());
        assert!(Triangles::new(mesh.clone(), vec![Vec2::ZERO; 2], vec![0]).is_err());
        assert!(Triangles::new(mesh.clone(), vec![], vec![]).is_err());
        let plain = || Triangles::new(mesh.clone(), vec![], vec![0]).unwrap();
        assert!(plain().with_colors(vec![Vec4::ONE; 2], vec![]).is_err());
        assert!(plain().with_colors(vec![], vec![Vec4::ONE; 3]).is_err());
        let colored = plain().with_colors(vec![Vec4::X, Vec4::Y, Vec4::Z], vec![Vec4::splat(0.5)]).unwrap();
        assert_eq!(colored.color_at(0, [0.25, 0.25, 0.5]), Vec4::new(0.125, 0.125, 0.25, 0.0));
        assert!(colored.has_opacity() && !plain().has_opacity());
    }
}
