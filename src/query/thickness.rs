//! Local thickness: the largest ball inside that touches a point of the surface.
//!
//! *Theory.* A ball that touches the surface at p with outward unit normal n has its centre at p - r n. The ball
//! through p and another point q of the surface has the radius |p - q|^2 / (2 n.(p - q)), and the thickness is twice
//! the least of these radii. The search is the method of the shrinking ball (Ma, Bae and Choi, *3D medial axis point
//! approximation using nearest neighbors and the normal field*, 2012): the point nearest to the centre gives the next,
//! smaller ball, which is a step of Newton's method.
//!
//! A facet beside p that is tilted by a few degrees would limit every ball near the common edge, however thick the body
//! is. Points at less than [`FLAT`] above the tangent plane, as seen from p, belong to the same side and are left out.
//! Where such a point is the nearest one, every triangle in the ball is searched for its least ball. The points that
//! count form a convex cone, and the points in a ball a convex set. The least ball of a triangle is therefore found by
//! Newton's method on the whole triangle or, where that leaves the cone, on the boundary of the cone.

use super::nearest::outward_normal;
use super::{check_points, evaluate_in_order, prepare};
use crate::bvh::rays::watertight::Ray;
use crate::bvh::{Bvh, Stack};
use crate::error::{ArgumentError, Error};
use crate::geometry::{closest_point_on_triangle, triangle_cross};
use crate::gpu::Place;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::SignMethod;
use crate::simd::with_vectors;
use glam::DVec3;

/// Sine of 15 degrees. Neighbouring facets that differ by less are one side of the body.
const FLAT: f64 = 0.258_819_045_102_520_74;
/// Radius of the first ball, local units. The longest side of a mesh is at most 1, so no inscribed ball is larger.
const FIRST: f64 = 2.0;
/// A ball is empty if the surface is at most this much nearer than its radius, relative: ten times the rounding of
/// float64.
const EMPTY: f64 = 1e-13;
/// Rounding of a distance between a centre and the surface, local units: coordinates are at most 1. On an edge or a
/// corner the radius falls to it.
const ROUNDING: f64 = 1e-15;
/// Height of the cone's apex below the point, local units: the rounding of the point's distance from its own face.
const APEX: f64 = 4.0 * ROUNDING;
/// Least distance of the opposite surface, local units. The ray may hit the point's own face nearer to its origin.
const OPPOSITE: f64 = 1e-12;
/// Largest number of searches for one point. Newton's method needs six from a radius a thousand times too large.
const STEPS: usize = 60;

/// Diameter of the largest ball inside that touches the surface at each point; infinite if no surface bounds it.
///
/// Points are moved to the surface first. `normals` point away from the inside; the default is the pseudonormals.
pub fn thickness(
    mesh: &Mesh,
    points: &[[f64; 3]],
    normals: Option<&[[f64; 3]]>,
    progress: &Progress,
) -> Result<Vec<f64>, Error> {
    check_points(mesh, points)?;
    check_normals(points, normals)?;
    let choice = prepare(mesh, SignMethod::Auto);
    mesh.pseudonormals();
    let ordered = evaluate_in_order(&Place::Cpu, mesh, points, progress, |walk, p, row| {
        let closest = walk.exact_closest_point(p, row);
        let normal = match normals {
            Some(normals) => DVec3::from_array(normals[row as usize]).normalize(),
            None => outward_normal(mesh, &choice.rule, &closest),
        };
        2.0 * radius(mesh, closest.on_triangle.point, normal) * mesh.scale()
    })?;
    ordered.into_rows(progress)
}

/// The largest ball that touches a point of the surface, as found so far.
#[derive(Clone, Copy)]
struct Ball {
    point: DVec3,
    normal: DVec3,
    radius: f64,
}

impl Ball {
    fn center(&self) -> DVec3 {
        self.point - self.radius * self.normal
    }

    fn contains(&self, distance_from_center: f64) -> bool {
        distance_from_center < self.radius * (1.0 - EMPTY) - ROUNDING
    }

    /// Whether a point is high enough above the tangent plane to bound the ball.
    fn is_bounded_at(&self, q: DVec3) -> bool {
        let chord = self.apex() - q;
        chord.dot(self.normal) >= FLAT * chord.length()
    }

    /// Whether no point of a triangle may bound the ball, by its first corner and its longest edges: the height above
    /// the cone changes by at most 1 + [`FLAT`] of the way.
    fn is_clear_of(&self, [a, b, c]: [DVec3; 3]) -> bool {
        let chord = self.apex() - a;
        let height = chord.dot(self.normal) - FLAT * chord.length();
        let way = (b - a).length_squared().max((c - a).length_squared()).sqrt();
        height < -(1.0 + FLAT) * way - ROUNDING
    }

    /// The apex of the cone of points that may bound the ball. It lies below the point by its rounding, which would
    /// otherwise see its own face at any angle.
    fn apex(&self) -> DVec3 {
        self.point - APEX * self.normal
    }

    /// Radius of the ball through a point below the tangent plane.
    fn radius_through(&self, q: DVec3) -> f64 {
        let chord = self.point - q;
        chord.length_squared() / (2.0 * chord.dot(self.normal))
    }

    /// This ball, or the largest one that no point of the triangle bounds if that is smaller.
    fn beside_triangle(self, corners: [DVec3; 3]) -> Self {
        let (mut least, mut touching) = (self, None);
        for _ in 0..STEPS {
            let q = closest_point_on_triangle(least.center(), corners).point;
            if !least.contains(q.distance(least.center())) {
                break;
            }
            least.radius = self.radius_through(q);
            touching = Some(q);
        }
        match touching {
            None => self,
            Some(q) if self.is_bounded_at(q) => least,
            Some(_) => self.beside_flat_triangle(corners),
        }
    }

    /// [`Ball::beside_triangle`] for a triangle whose least ball touches it outside the cone: the constrained least
    /// ball touches it on the cone's boundary. There the radius is |p - q| / (2 [`FLAT`]), so the nearest point to the
    /// apex is sought, on the edges and on the conic section inside the triangle.
    fn beside_flat_triangle(mut self, corners: [DVec3; 3]) -> Self {
        let (apex, normal) = (self.apex(), self.normal);
        let mut consider = |q: DVec3| {
            // The roots of a line near the apex are nearly equal and have lost half of their digits.
            let (chord, radius) = (apex - q, self.radius_through(q));
            if chord.dot(normal) >= FLAT * (1.0 - 1e-9) * chord.length() && radius < self.radius {
                self.radius = radius;
            }
        };
        for (from, to) in [(0, 1), (1, 2), (2, 0)] {
            let (w, e) = (apex - corners[from], corners[to] - corners[from]);
            // (w - t e).n = FLAT |w - t e|, squared.
            let (wn, en) = (w.dot(normal), e.dot(normal));
            let a = en * en - FLAT * FLAT * e.length_squared();
            let half_b = wn * en - FLAT * FLAT * w.dot(e);
            let c = wn * wn - FLAT * FLAT * w.length_squared();
            let root = (half_b * half_b - a * c).sqrt();
            // Where the edge is parallel to the cone, a vanishes and one of the roots is c / (2 half_b).
            let larger = half_b + root.copysign(half_b);
            for t in [larger / a, c / larger] {
                // Without a root `t` is NaN, and the range does not contain it.
                if (0.0..=1.0).contains(&t) {
                    consider(corners[from] + t * e);
                }
            }
        }
        let cross = triangle_cross(corners);
        let Some(face_normal) = cross.try_normalize() else { return self };
        let level = (face_normal - face_normal.dot(normal) * normal)
            .try_normalize()
            .unwrap_or_else(|| normal.any_orthonormal_vector());
        for sign in [-1.0, 1.0] {
            let direction = -FLAT * normal + sign * (1.0 - FLAT * FLAT).sqrt() * level;
            let along = (corners[0] - apex).dot(face_normal) / direction.dot(face_normal);
            let q = apex + along * direction;
            let inside = |i: usize, j: usize| (corners[j] - corners[i]).cross(q - corners[i]).dot(cross) >= 0.0;
            if inside(0, 1) && inside(1, 2) && inside(2, 0) {
                consider(q);
            }
        }
        self
    }
}

fn radius(mesh: &Mesh, point: DVec3, normal: DVec3) -> f64 {
    let mut ball = Ball { point, normal, radius: FIRST };
    // The surface opposite to the point gives a first ball.
    let ray = Ray { origin: point, direction: -normal, t_min: OPPOSITE, t_max: 2.0 * FIRST };
    if let Some(hit) = mesh.first_hit(&ray, |_| true) {
        ball.radius = hit.t / 2.0;
    }
    for _ in 0..STEPS {
        let closest = mesh.exact_closest_point(ball.center(), ball.radius * (1.0 + 1e-9));
        if !ball.contains(closest.distance) {
            break;
        }
        if !ball.is_bounded_at(closest.on_triangle.point) {
            ball = beside_all_triangles(mesh, ball);
            break;
        }
        let smaller = ball.radius_through(closest.on_triangle.point);
        if smaller >= ball.radius {
            break;
        }
        ball.radius = smaller;
    }
    if ball.radius < FIRST { ball.radius } else { f64::INFINITY }
}

/// The largest ball that no triangle bounds. `ball` contains all triangles that may bound a smaller one.
///
/// The nearest triangles are searched first. The balls become smaller, each inside the one before, so a triangle
/// outside the least ball so far bounds none. In the centre of a round body all triangles are in the first ball, and
/// few in the least one.
fn beside_all_triangles(mesh: &Mesh, ball: Ball) -> Ball {
    with_vectors!((mesh: &Mesh = mesh, ball: Ball = ball) -> Ball {
        let (mut least, center) = (ball, ball.center());
        let reach = center.abs().max(ball.point.abs()).max_element();
        let (bvh, slack) = (mesh.bvh_within(reach), Bvh::nearest_slack(reach));
        let limit = |ball: &Ball| (ball.radius as f32 + slack).powi(2);
        let mut stack = Stack::of_root();
        while let Some(index) = bvh.next_pack(&mut stack, center.as_vec3(), limit(&ball)) {
            let pack = &bvh.packs[index];
            let found = pack.distances_squared(least.center().as_vec3());
            for lane in pack.lanes_within(&found, limit(&least)) {
                let corners = mesh.exact_triangle(pack.face(lane));
                if ball.is_clear_of(corners) {
                    continue;
                }
                let nearest = closest_point_on_triangle(least.center(), corners).point;
                if nearest.distance(least.center()) <= least.radius * (1.0 + 1e-9) {
                    // Each triangle is searched from the same ball, so that their order does not change the result.
                    least.radius = least.radius.min(ball.beside_triangle(corners).radius);
                }
            }
        }
        least
    })
}

fn check_normals(points: &[[f64; 3]], normals: Option<&[[f64; 3]]>) -> Result<(), ArgumentError> {
    let Some(normals) = normals else { return Ok(()) };
    if normals.len() != points.len() {
        let problem = format!("one per point ({}) expected, got {}", points.len(), normals.len());
        return Err(ArgumentError::new("normals", problem));
    }
    let usable = |n: &[f64; 3]| n.iter().all(|x| x.is_finite()) && *n != [0.0; 3];
    match normals.iter().position(|n| !usable(n)) {
        Some(row) => {
            let problem = format!("normals[{row}] = {:?} is zero or not finite", normals[row]);
            Err(ArgumentError::new("normals", problem))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Lattice steps along each edge of a triangle.
    const SIDE: usize = 400;

    const AT_ORIGIN: Ball = Ball { point: DVec3::ZERO, normal: DVec3::Z, radius: FIRST };

    /// The least radius of balls through the points of a lattice on a triangle. Points outside the cone count if their
    /// height above it is at most `slack` too small.
    fn least_of_lattice([a, b, c]: [DVec3; 3], slack: f64) -> f64 {
        let mut least = FIRST;
        for i in 0..=SIDE {
            for j in 0..=SIDE - i {
                let [u, v] = [i, j].map(|k| k as f64 / SIDE as f64);
                let q = a + u * (b - a) + v * (c - a);
                let chord = AT_ORIGIN.apex() - q;
                if chord.dot(AT_ORIGIN.normal) >= FLAT * chord.length() - slack {
                    least = least.min(AT_ORIGIN.radius_through(q));
                }
            }
        }
        least
    }

    proptest! {
        /// No point of a lattice has a smaller ball, and one of a lattice near the cone has a ball of nearly that size.
        #[test]
        fn the_least_ball_of_a_triangle_is_that_of_a_lattice(
            corners in prop::array::uniform3((-0.5..0.5f64, -0.5..0.5f64, -0.4..0.05f64))
        ) {
            let corners = corners.map(|(x, y, z)| DVec3::new(x, y, z));
            let least = least_of_lattice(corners, 0.0);
            let found = AT_ORIGIN.beside_triangle(corners).radius;
            prop_assert!(found <= least * (1.0 + 1e-9), "{found} {least}");
            // A point of the lattice lies within one step of the point that bounds the ball. Its height above the cone
            // is less by two steps at most, and its radius larger by 24 at most if the ball is larger than 40.
            let [a, b, c] = corners;
            let step = a.distance(b).max(b.distance(c)).max(c.distance(a)) / SIDE as f64;
            let nearly = least_of_lattice(corners, 2.0 * step);
            prop_assert!(found <= 40.0 * step || nearly <= found + 24.0 * step, "{found} {nearly}");
        }
    }

    /// Edges at 15 degrees have one crossing with the cone, and their quadratic equations have almost no square term.
    #[test]
    fn edges_parallel_to_the_cone_are_crossed() {
        let along = 0.3 * DVec3::new((1.0 - FLAT * FLAT).sqrt(), 0.0, -FLAT);
        for k in 0..40 {
            let a = DVec3::new(0.1, 0.2 + 0.001 * f64::from(k), -0.05);
            let corners = [a, a + along, DVec3::new(0.1, 0.5, -0.05)];
            let least = least_of_lattice(corners, 0.0);
            let found = AT_ORIGIN.beside_triangle(corners).radius;
            assert!(found <= least * (1.0 + 1e-9) && least <= 1.01 * found, "{k}: {found} {least}");
        }
    }
}
