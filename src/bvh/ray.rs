//! The first triangle on a ray: near child first, and without a gap between two faces that share an edge.
//!
//! Boxes are tested eight at a time in float32 and enlarged by more than its rounding. Triangles are tested in float64
//! by the signed areas of their edges in a space that is sheared along the ray. Both faces of an edge compute the same
//! value with opposite signs, so a ray through the edge hits one of them (Woop, Benthin and Wald, *Watertight
//! Ray/Triangle Intersection*, JCGT 2(1), 2013).

use super::{Bvh, ChildRef, MAX_STACK, Node, WIDTH};
use crate::mesh::Mesh;
use glam::{DVec3, Vec3};

/// Intersection of a ray with a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RayHit {
    /// Length of the ray, in multiples of its direction.
    pub t: f64,
    pub face: u32,
    /// Barycentric weights of the face's second and third corner.
    pub u: f64,
    pub v: f64,
    /// Whether the ray arrives at the counter-clockwise side.
    pub is_front: bool,
}

/// Margin of the boxes, local units. Coordinates are below 1 and a ray starts within 2; float32 rounds them by 1.2e-7,
/// three times in a slab test.
const BOX_MARGIN: f32 = 1e-6;

impl Mesh {
    /// The first hit of the ray `origin + t direction`, local units, with `t` from 0 to `t_max`, that `accept` returns
    /// true for.
    pub fn first_hit(
        &self,
        origin: DVec3,
        direction: DVec3,
        t_max: f64,
        mut accept: impl FnMut(&RayHit) -> bool,
    ) -> Option<RayHit> {
        let bvh = self.bvh();
        // The search starts at the box, so that float32 represents the rest of the ray for an eye at any distance.
        let (enter, leave) = slab(origin, direction, bvh.bounds.min.as_dvec3(), bvh.bounds.max.as_dvec3());
        let t_end = t_max.min(leave);
        if enter.max(0.0) > t_end {
            return None;
        }
        let t_start = enter.max(0.0);
        let start = origin + t_start * direction;
        // The direction is scaled so that its largest component is 1.
        let size = direction.abs().max_element();
        let boxes = BoxRay::new(start.as_vec3(), (direction / size).as_vec3());
        let sheared = Sheared::new(start, direction / size);

        let mut best: Option<RayHit> = None;
        let mut limit = (t_end - t_start) * size;
        let mut stack = [(0.0f32, ChildRef::NONE); MAX_STACK];
        stack[0] = (0.0, Bvh::ROOT);
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let (near, child) = stack[top];
            if f64::from(near) > limit {
                continue;
            }
            if child.is_pack() {
                for &face in bvh.packs[child.index()].faces() {
                    let Some(found) = sheared.hit(self.triangle(face)) else { continue };
                    if found.t < 0.0 || found.t > limit {
                        continue;
                    }
                    let hit = RayHit { t: t_start + found.t / size, face, ..found };
                    if accept(&hit) {
                        limit = found.t;
                        best = Some(hit);
                    }
                }
                continue;
            }
            let node = &bvh.nodes[child.index()];
            let entered = boxes.enter(node, limit as f32);
            let bottom = top;
            for lane in 0..WIDTH {
                if entered[lane] < f32::INFINITY && !node.children[lane].is_none() {
                    let mut slot = top;
                    while slot > bottom && stack[slot - 1].0 < entered[lane] {
                        stack[slot] = stack[slot - 1];
                        slot -= 1;
                    }
                    stack[slot] = (entered[lane], node.children[lane]);
                    top += 1;
                }
            }
        }
        best
    }
}

impl Mesh {
    /// The intersection of the line `origin + t direction`, local units, with one face, bit for bit that of
    /// [`Mesh::first_hit`].
    pub fn hit_of_face(&self, face: u32, origin: DVec3, direction: DVec3) -> Option<RayHit> {
        let bounds = self.bvh().bounds;
        let (enter, _) = slab(origin, direction, bounds.min.as_dvec3(), bounds.max.as_dvec3());
        let t_start = if enter.is_finite() { enter.max(0.0) } else { 0.0 };
        let size = direction.abs().max_element();
        let found = Sheared::new(origin + t_start * direction, direction / size).hit(self.triangle(face))?;
        Some(RayHit { t: t_start + found.t / size, face, ..found })
    }
}

/// The interval of a line inside a slightly enlarged box; leave is below enter if it misses.
fn slab(origin: DVec3, direction: DVec3, min: DVec3, max: DVec3) -> (f64, f64) {
    let margin = f64::from(BOX_MARGIN);
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let (low, high) = (min[axis] - margin - origin[axis], max[axis] + margin - origin[axis]);
        if direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return (f64::INFINITY, f64::NEG_INFINITY);
            }
            continue;
        }
        let (a, b) = (low / direction[axis], high / direction[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter, leave)
}

/// A ray for tests of boxes.
struct BoxRay {
    origin: [f32; 3],
    inverse: [f32; 3],
}

/// Inverse of a zero component. It is large, and its products with local coordinates do not overflow.
const PARALLEL: f32 = 1e30;

impl BoxRay {
    fn new(origin: Vec3, direction: Vec3) -> Self {
        let inverse = direction.to_array().map(|d| if d.abs() < 1.0 / PARALLEL { PARALLEL } else { 1.0 / d });
        Self { origin: origin.to_array(), inverse }
    }

    /// The t at which the ray enters each child's box; infinite if it misses or enters beyond `limit`.
    #[inline]
    fn enter(&self, node: &Node, limit: f32) -> [f32; WIDTH] {
        let mut result = [f32::INFINITY; WIDTH];
        for lane in 0..WIDTH {
            let (mut enter, mut leave) = (0.0f32, limit * 1.000_001 + BOX_MARGIN);
            for axis in 0..3 {
                let a = (node.min[axis][lane] - BOX_MARGIN - self.origin[axis]) * self.inverse[axis];
                let b = (node.max[axis][lane] + BOX_MARGIN - self.origin[axis]) * self.inverse[axis];
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter = if near > enter { near } else { enter };
                leave = if far < leave { far } else { leave };
            }
            // A relative margin of 1e-6 covers the rounding of the products.
            if enter <= leave * 1.000_001 {
                result[lane] = enter * 0.999_999;
            }
        }
        result
    }
}

/// A ray in coordinates whose z axis is the ray.
struct Sheared {
    origin: DVec3,
    axes: [usize; 3],
    shear: [f64; 3],
}

impl Sheared {
    fn new(origin: DVec3, direction: DVec3) -> Self {
        let magnitude = direction.abs();
        let z = (1..3).fold(0, |best, axis| if magnitude[axis] > magnitude[best] { axis } else { best });
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        // Exchanging two axes for a negative direction keeps the winding.
        let (x, y) = if direction[z] < 0.0 { (y, x) } else { (x, y) };
        let shear = [direction[x] / direction[z], direction[y] / direction[z], 1.0 / direction[z]];
        Self { origin, axes: [x, y, z], shear }
    }

    #[inline]
    fn hit(&self, corners: [DVec3; 3]) -> Option<RayHit> {
        let [x, y, z] = self.axes;
        let [a, b, c] = corners.map(|corner| {
            let p = corner - self.origin;
            (p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], p[z])
        });
        let u = c.0 * b.1 - c.1 * b.0;
        let v = a.0 * c.1 - a.1 * c.0;
        let w = b.0 * a.1 - b.1 * a.0;
        if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) {
            return None;
        }
        let sum = u + v + w;
        if sum == 0.0 {
            return None;
        }
        let t = self.shear[2] * (u * a.2 + v * b.2 + w * c.2) / sum;
        Some(RayHit { t, face: 0, u: v / sum, v: w / sum, is_front: sum > 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A closed, bumpy sphere of latitudes and longitudes.
    fn ball(rings: usize, segments: usize) -> Mesh {
        let mut vertices = Vec::new();
        for i in 0..=rings {
            for j in 0..segments {
                let (polar, around) = (
                    std::f64::consts::PI * i as f64 / rings as f64,
                    std::f64::consts::TAU * j as f64 / segments as f64,
                );
                let radius = 1.0 + 0.2 * (5.0 * polar).sin() * (3.0 * around).cos();
                // Exactly zero at both poles, so that the surface is closed there.
                let aside = if i % rings == 0 { 0.0 } else { radius * polar.sin() };
                vertices.push([aside * around.cos(), radius * polar.cos(), -aside * around.sin()]);
            }
        }
        let mut faces = Vec::new();
        for i in 0..rings {
            for j in 0..segments {
                let at = |i: usize, j: usize| (i * segments + j % segments) as i64;
                faces.push([at(i, j), at(i + 1, j), at(i + 1, j + 1)]);
                faces.push([at(i, j), at(i + 1, j + 1), at(i, j + 1)]);
            }
        }
        // The poles are many vertices at one point. Their slivers have no area and are dropped.
        Mesh::new(&vertices, &faces).unwrap()
    }

    /// The first hit over all triangles by Cramer's rule.
    fn brute_force(mesh: &Mesh, origin: DVec3, direction: DVec3) -> Option<f64> {
        let mut best: Option<f64> = None;
        for face in 0..mesh.faces().len() as u32 {
            let [a, b, c] = mesh.triangle(face);
            let (e1, e2) = (b - a, c - a);
            let p = direction.cross(e2);
            let det = e1.dot(p);
            let s = origin - a;
            let u = s.dot(p) / det;
            let q = s.cross(e1);
            let v = direction.dot(q) / det;
            let t = e2.dot(q) / det;
            if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0 && best.is_none_or(|b| t < b) {
                best = Some(t);
            }
        }
        best
    }

    fn vector() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        #[test]
        fn the_first_hit_is_that_of_brute_force(origin in vector(), target in vector(), far in 0.0..3.0f64, scale in -3.0..3.0f64) {
            let mesh = ball(12, 16);
            let direction = (target * 0.4 - origin * (1.0 + far)) * 10f64.powf(scale);
            prop_assume!(direction.length() > 1e-6);
            let origin = origin * (1.0 + far);
            let found = mesh.first_hit(origin, direction, f64::INFINITY, |_| true);
            let truth = brute_force(&mesh, origin, direction);
            match (found, truth) {
                (Some(hit), Some(t)) => {
                    prop_assert_eq!(mesh.hit_of_face(hit.face, origin, direction), Some(hit));
                    prop_assert!((hit.t - t).abs() * direction.length() < 1e-9);
                    let [a, b, c] = mesh.triangle(hit.face);
                    let p = a + (b - a) * hit.u + (c - a) * hit.v;
                    prop_assert!(p.distance(origin + hit.t * direction) < 1e-9);
                    let normal = (b - a).cross(c - a);
                    prop_assert_eq!(hit.is_front, normal.dot(direction) < 0.0);
                }
                (None, None) => {}
                other => prop_assert!(false, "{other:?}"),
            }
        }
    }

    /// Rays from the inside through every vertex and every midpoint of an edge: a gap would let a ray escape.
    #[test]
    fn no_ray_slips_between_faces() {
        let mesh = ball(16, 24);
        for face in 0..mesh.faces().len() as u32 {
            let [a, b, c] = mesh.triangle(face);
            for target in [a, b, c, (a + b) * 0.5, (b + c) * 0.5, (a + c) * 0.5] {
                let origin = DVec3::new(0.01, 0.02, -0.015);
                let hit = mesh.first_hit(origin, target - origin, f64::INFINITY, |_| true).expect("a hit");
                // A face parallel to the ray may be hit anywhere along it.
                assert!(hit.t > 0.0 && hit.t < 1.2, "{hit:?}");
            }
        }
    }

    #[test]
    fn limits_and_refusals_are_kept() {
        let mesh = ball(8, 12);
        let hit = |t_max: f64, accept: fn(&RayHit) -> bool| {
            mesh.first_hit(DVec3::new(0.0, 0.1, 1e9), DVec3::NEG_Z, t_max, accept)
        };
        let first = hit(f64::INFINITY, |_| true).unwrap();
        assert!(first.is_front);
        assert!(hit(first.t - 0.01, |_| true).is_none());
        let back = hit(f64::INFINITY, |hit| !hit.is_front).unwrap();
        assert!(back.t > first.t);
    }
}
