//! Eight triangles side by side, and the squared distance of a point to all of them.
//!
//! Each triangle carries its own frame: `a` a corner, `u` along the longest edge, `n` its unit normal, `v = n x u`. In
//! that frame the triangle is flat: corners (0, 0), (length, 0) and an apex. The distance is the height over the plane,
//! joined to the 2D distance in it: zero inside, else the least of three clamped edges. No branch, no division.
//!
//! *Precision.* Frames are found in float64 and rounded once, so even a needle's normal is good to 6e-8 and the
//! distance of `p` is good to a few 1e-7 of |p - a|, also when it is small against that. This decides only which
//! triangle wins; its distance is then found in float64.

use super::WIDTH;
use glam::{DVec3, Vec3};

/// Up to eight triangles; empty lanes repeat the first.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
pub struct Pack {
    /// Frame origin and axes, one row per coordinate.
    a: [[f32; WIDTH]; 3],
    u: [[f32; WIDTH]; 3],
    v: [[f32; WIDTH]; 3],
    n: [[f32; WIDTH]; 3],
    /// Length of the edge along `u`, and of the edges from its two ends to the apex, with their unit directions.
    length: [f32; WIDTH],
    left: [[f32; WIDTH]; 2],
    left_length: [f32; WIDTH],
    right: [[f32; WIDTH]; 2],
    right_length: [f32; WIDTH],
    faces: [u32; WIDTH],
    count: u32,
}

impl Pack {
    pub fn new(positions: &[Vec3], faces: &[[u32; 3]], members: &[u32]) -> Self {
        let mut pack = Self {
            a: [[0.0; WIDTH]; 3],
            u: [[0.0; WIDTH]; 3],
            v: [[0.0; WIDTH]; 3],
            n: [[0.0; WIDTH]; 3],
            length: [0.0; WIDTH],
            left: [[0.0; WIDTH]; 2],
            left_length: [0.0; WIDTH],
            right: [[0.0; WIDTH]; 2],
            right_length: [0.0; WIDTH],
            faces: [0; WIDTH],
            count: members.len() as u32,
        };
        for lane in 0..WIDTH {
            let face = members[if lane < members.len() { lane } else { 0 }];
            pack.set(lane, face, faces[face as usize].map(|v| positions[v as usize].as_dvec3()));
        }
        pack
    }

    fn set(&mut self, lane: usize, face: u32, corners: [DVec3; 3]) {
        // Start at the longest edge: its direction is the best known one.
        let squared = |i: usize| corners[i].distance_squared(corners[(i + 1) % 3]);
        let first = (1..3).fold(0, |best, i| if squared(i) > squared(best) { i } else { best });
        let [a, b, c] = [0, 1, 2].map(|i| corners[(first + i) % 3]);

        let u = (b - a).normalize();
        let n = (b - a).cross(c - a).normalize();
        let v = n.cross(u);
        let length = (b - a).length();
        let apex = glam::DVec2::new((c - a).dot(u), (c - a).dot(v));
        let left = apex.normalize();
        let base = apex - glam::DVec2::new(length, 0.0);
        let right = base.normalize();
        for axis in 0..3 {
            self.a[axis][lane] = a[axis] as f32;
            self.u[axis][lane] = u[axis] as f32;
            self.v[axis][lane] = v[axis] as f32;
            self.n[axis][lane] = n[axis] as f32;
        }
        self.length[lane] = length as f32;
        for axis in 0..2 {
            self.left[axis][lane] = left[axis] as f32;
            self.right[axis][lane] = right[axis] as f32;
        }
        self.left_length[lane] = apex.length() as f32;
        self.right_length[lane] = base.length() as f32;
        self.faces[lane] = face;
    }

    /// The faces in this pack.
    pub fn faces(&self) -> &[u32] {
        &self.faces[..self.count as usize]
    }

    /// Face of a lane; an empty lane names the first face.
    pub fn face(&self, lane: usize) -> u32 {
        self.faces[lane]
    }

    /// Squared distance of `p` to each triangle.
    #[inline(always)]
    pub fn distances_squared(&self, p: Vec3) -> [f32; WIDTH] {
        let mut result = [0.0; WIDTH];
        for i in 0..WIDTH {
            let (px, py, pz) = (p.x - self.a[0][i], p.y - self.a[1][i], p.z - self.a[2][i]);
            let x = px * self.u[0][i] + py * self.u[1][i] + pz * self.u[2][i];
            let y = px * self.v[0][i] + py * self.v[1][i] + pz * self.v[2][i];
            let height = px * self.n[0][i] + py * self.n[1][i] + pz * self.n[2][i];

            // The edge along u.
            let dx = x - clamp(x, self.length[i]);
            let base = dx * dx + y * y;
            // The edge from the origin to the apex: along it, and to its left.
            let (ex, ey) = (self.left[0][i], self.left[1][i]);
            let (along, beside) = (x * ex + y * ey, ex * y - ey * x);
            let d = along - clamp(along, self.left_length[i]);
            let left = d * d + beside * beside;
            // The edge from the far end to the apex.
            let (ex, ey, x) = (self.right[0][i], self.right[1][i], x - self.length[i]);
            let (along, aside) = (x * ex + y * ey, ex * y - ey * x);
            let d = along - clamp(along, self.right_length[i]);
            let right = d * d + aside * aside;

            let inside = (y >= 0.0) & (beside <= 0.0) & (aside >= 0.0);
            let flat = if inside { 0.0 } else { min(base, min(left, right)) };
            result[i] = height * height + flat;
        }
        result
    }
}

/// `x` brought into `0..=length`, in the form that compiles to one minimum and one maximum.
#[inline(always)]
fn clamp(x: f32, length: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    min(x, length)
}

#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::closest_point_on_triangle;
    use proptest::prelude::*;

    fn vector(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// Against float64 Voronoi regions, for triangles from fat to needle.
        #[test]
        fn distances_match_float64(
            p in vector(-1.0..1.0), a in vector(-0.5..0.5), b in vector(-0.5..0.5), c in vector(-0.5..0.5), thin in 0.0..1.0f32
        ) {
            let thin = thin.powi(12).max(1e-6);
            let c = a + (b - a) * 0.3 + (c - a) * thin;
            let positions = [a, b, c];
            let corners = positions.map(Vec3::as_dvec3);
            prop_assume!(crate::geometry::triangle_cross(corners) != DVec3::ZERO);
            let pack = Pack::new(&positions, &[[0, 1, 2]], &[0]);
            let exact = closest_point_on_triangle(p.as_dvec3(), corners).point.distance(p.as_dvec3());
            let found = f64::from(pack.distances_squared(p)[0].sqrt());
            // Each axis of the frame is rounded to 6e-8, |p - a| is below 4, and three terms add up.
            prop_assert!((found - exact).abs() < 1e-6, "{found} {exact}");
        }
    }
}
