//! Closest point on a triangle, and the solid angle it covers, in float64.
//!
//! The search compares triangles in float32 (see `bvh::pack`). The nearest one is evaluated again here in float64, so
//! that a stored distance is rounded to float32 only once and the closest *feature* (face, edge or vertex) is known.

use glam::DVec3;
use robust::{Coord, orient2d};
use std::f64::consts::TAU;

/// The feature of a triangle that contains its closest point. Edge `i` joins corner `i` and corner `(i + 1) % 3`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Feature {
    /// The interior.
    Face,
    /// The edge from this corner to the next one.
    Edge(u8),
    /// This corner.
    Vertex(u8),
}

/// The closest point of a triangle, and its feature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrianglePoint {
    /// The nearest point.
    pub point: DVec3,
    /// The part of the triangle that has the point.
    pub feature: Feature,
    /// Barycentric weights of the point: not negative, with a sum of 1.
    pub weights: [f64; 3],
}

impl TrianglePoint {
    #[inline(always)]
    fn at_vertex(i: u8, point: DVec3) -> Self {
        let mut weights = [0.0; 3];
        weights[usize::from(i)] = 1.0;
        Self { point, feature: Feature::Vertex(i), weights }
    }

    /// A point of edge `i`. `t` is the weight of the corner `to` and 1 - `t` the weight of the corner `from`.
    #[inline(always)]
    fn on_edge(i: u8, point: DVec3, [from, to]: [usize; 2], t: f64) -> Self {
        let mut weights = [0.0; 3];
        weights[from] = 1.0 - t;
        weights[to] = t;
        Self { point, feature: Feature::Edge(i), weights }
    }

    /// A point inside the triangle. `areas` are proportional to the weights.
    #[inline(always)]
    fn in_face(point: DVec3, areas: [f64; 3]) -> Self {
        // Rounding may make a weight near zero negative.
        let areas = areas.map(|area| area.max(0.0));
        let scale = 1.0 / (areas[0] + areas[1] + areas[2]);
        Self { point, feature: Feature::Face, weights: areas.map(|area| area * scale) }
    }
}

/// Closest point to `p` on triangle `abc`, by Voronoi regions.
///
/// Ericson, *Real-Time Collision Detection*, 2005, section 5.1.5. The plane projection divides by the sum of the three
/// barycentrics, which the region tests have shown to be positive. On slivers the products of those tests cancel, so
/// slivers are decided by the projection onto the plane and by the edges.
pub fn closest_point_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> TrianglePoint {
    let (ab, ac) = (b - a, c - a);
    let longest = ab.length_squared().max(ac.length_squared()).max((c - b).length_squared());
    if ab.cross(ac).length_squared() <= SLIVER * longest * longest {
        return closest_point_on_sliver(p, [a, b, c]);
    }

    let ap = p - a;
    let (d1, d2) = (ab.dot(ap), ac.dot(ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return TrianglePoint::at_vertex(0, a);
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(bp), ac.dot(bp));
    if d3 >= 0.0 && d4 <= d3 {
        return TrianglePoint::at_vertex(1, b);
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let t = d1 / (d1 - d3);
        return TrianglePoint::on_edge(0, a + ab * t, [0, 1], t);
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(cp), ac.dot(cp));
    if d6 >= 0.0 && d5 <= d6 {
        return TrianglePoint::at_vertex(2, c);
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let t = d2 / (d2 - d6);
        return TrianglePoint::on_edge(2, a + ac * t, [0, 2], t);
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 - d3 >= 0.0 && d5 - d6 >= 0.0 {
        let t = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return TrianglePoint::on_edge(1, b + (c - b) * t, [1, 2], t);
    }
    let scale = 1.0 / (va + vb + vc);
    TrianglePoint::in_face(a + ab * (vb * scale) + ac * (vc * scale), [va, vb, vc])
}

/// Squared sine of an angle below which float64 does not determine the plane of a triangle to 1e-6. Only its edges are
/// used then.
const NEEDLE: f64 = 1e-20;

/// Squared ratio of width to length below which the products of the region tests cancel.
const SLIVER: f64 = 1e-6;

/// The projection onto the plane if it lies inside, else the nearest of the edges. Slower, but without cancellation.
fn closest_point_on_sliver(p: DVec3, corners: [DVec3; 3]) -> TrianglePoint {
    let [a, b, c] = corners;
    let normal = (b - a).cross(c - a);
    let inside = |u: DVec3, v: DVec3| (v - u).cross(p - u).dot(normal) >= 0.0;
    if is_needle(corners) || !inside(a, b) || !inside(b, c) || !inside(c, a) {
        return closest_point_on_edges(p, corners);
    }
    // The areas of the three parts cancel. The weight of the corner opposite of the longest edge is rounded by much
    // too, but then moves the point across the sliver only; the position along the longest edge fixes the other two.
    let length = |i: usize| corners[i].distance_squared(corners[(i + 1) % 3]);
    let longest = if length(1) > length(0) { 1 } else { 0 };
    let i = if length(2) > length(longest) { 2 } else { longest };
    let (j, k) = ((i + 1) % 3, (i + 2) % 3);
    let edge = corners[j] - corners[i];
    let along = |q: DVec3| (q - corners[i]).dot(edge) / edge.length_squared();
    let apex = (edge.cross(p - corners[i]).dot(normal) / normal.length_squared()).clamp(0.0, 1.0);
    let far = (along(p) - apex * along(corners[k])).clamp(0.0, 1.0 - apex);
    let mut weights = [0.0; 3];
    (weights[i], weights[j], weights[k]) = (1.0 - apex - far, far, apex);
    let point = corners[i] + edge * far + (corners[k] - corners[i]) * apex;
    TrianglePoint { point, feature: Feature::Face, weights }
}

/// Whether float64 does not determine the plane of a triangle: its sine is below [`NEEDLE`], or its corners lie on a
/// line or coincide.
pub(crate) fn is_needle([a, b, c]: [DVec3; 3]) -> bool {
    let (ab, ac, bc) = (b - a, c - a, c - b);
    // The two longest edges enclose the smallest angle.
    let [x, y, z] = [ab.length_squared(), ac.length_squared(), bc.length_squared()];
    let longest_two = (x * y).max(y * z).max(z * x);
    ab.cross(ac).length_squared() <= NEEDLE * longest_two
}

/// Whether three positions lie on one line, exactly.
pub(crate) fn is_on_a_line([a, b, c]: [DVec3; 3]) -> bool {
    // Each product of the cross product is rounded by less than 4 units in the last place.
    let (ab, ac) = (b - a, c - a);
    let rounding = 8.0 * f64::EPSILON * ab.abs().max_element() * ac.abs().max_element();
    if ab.cross(ac).abs().max_element() > rounding {
        return false;
    }
    let is_flat = |[x, y]: [usize; 2]| {
        let at = |p: DVec3| Coord { x: p[x], y: p[y] };
        orient2d(at(a), at(b), at(c)) == 0.0
    };
    [[0, 1], [1, 2], [2, 0]].into_iter().all(is_flat)
}

fn closest_point_on_edges(p: DVec3, corners: [DVec3; 3]) -> TrianglePoint {
    let on_edge = |i: u8| {
        let next = (i + 1) % 3;
        let (a, b) = (corners[usize::from(i)], corners[usize::from(next)]);
        let t = (p - a).dot(b - a) / (b - a).length_squared();
        if t >= 1.0 {
            TrianglePoint::at_vertex(next, b)
        } else if t > 0.0 {
            TrianglePoint::on_edge(i, a + (b - a) * t, [usize::from(i), usize::from(next)], t)
        } else {
            // NaN is the quotient of an edge without length.
            TrianglePoint::at_vertex(i, a)
        }
    };
    let nearer = |x: TrianglePoint, y: TrianglePoint| {
        if y.point.distance_squared(p) < x.point.distance_squared(p) { y } else { x }
    };
    nearer(nearer(on_edge(0), on_edge(1)), on_edge(2))
}

/// Cross product of two edges: normal direction, and twice the area in its length.
pub fn triangle_cross([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Signed solid angle of triangle `abc` as seen from the origin, in steradians. It is positive if the triangle is seen
/// from behind (its counter-clockwise side faces away), so that a closed mesh that faces outwards gives +4 pi inside.
///
/// Van Oosterom and Strackee, *The solid angle of a plane triangle*, IEEE Trans. Biomed. Eng. 30(2), 1983.
pub fn solid_angle(corners: [DVec3; 3]) -> f64 {
    let (numerator, denominator) = tangent_of_half(corners);
    2.0 * numerator.atan2(denominator)
}

/// Numerator and denominator of the tangent of half the solid angle.
#[inline(always)]
fn tangent_of_half([a, b, c]: [DVec3; 3]) -> (f64, f64) {
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let numerator = a.dot(b.cross(c));
    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    (numerator, denominator)
}

/// A sum of solid angles with one arc tangent.
///
/// Half a solid angle is the argument of the complex number denominator + i numerator. Arguments add up when complex
/// numbers are multiplied, except for whole turns, which are counted.
#[derive(Debug, Clone, Copy)]
pub struct SolidAngles {
    /// Real and imaginary part of the product of all factors so far. The larger of them lies in [`RANGE`].
    product: (f64, f64),
    /// Turns that the argument of the product lacks.
    turns: i32,
}

/// Size of factors and products without overflow or underflow of their product.
const RANGE: std::ops::Range<f64> = 1e-100..1e100;

impl Default for SolidAngles {
    fn default() -> Self {
        Self { product: (1.0, 0.0), turns: 0 }
    }
}

impl SolidAngles {
    /// Adds [`solid_angle`] of a triangle.
    #[inline(always)]
    pub fn add(&mut self, corners: [DVec3; 3]) {
        let (numerator, denominator) = tangent_of_half(corners);
        self.multiply(numerator, denominator);
    }

    /// [`SolidAngles::add`] of a triangle with the sign of `side`, which is computed only if rounding may change the
    /// sign.
    #[inline(always)]
    pub fn add_sided(&mut self, corners: [DVec3; 3], side: impl FnOnce() -> f64) {
        let (mut numerator, denominator) = tangent_of_half(corners);
        // A triple product is rounded by less than 20 ulps of the product of the lengths, also for rounded corners.
        let [a, b, c] = corners.map(DVec3::length_squared);
        if numerator * numerator <= 1e-28 * a * b * c {
            numerator = side();
        }
        self.multiply(numerator, denominator);
    }

    #[inline(always)]
    fn multiply(&mut self, mut y: f64, mut x: f64) {
        let size = x.abs().max(y.abs());
        if !RANGE.contains(&size) {
            // At a corner of the triangle both are zero, and so is the angle.
            if size == 0.0 {
                return;
            }
            (x, y) = (x / size, y / size);
        }
        let (a, b) = self.product;
        // Arguments on the same side of the real axis add up to at most one turn. Beyond half a turn the argument of
        // the product is one turn less (or more, below the axis). Both factors are left of the imaginary axis then, or
        // the product is on the other side of the real axis. Adding zero makes a negative zero positive.
        let (real, imaginary) = (a * x - b * y, a * y + b * x + 0.0);
        let is_above = b >= 0.0;
        if is_above == (y >= 0.0) && ((a < 0.0 && x < 0.0) || is_above != (imaginary >= 0.0)) {
            self.turns += if is_above { 1 } else { -1 };
        }
        self.product = (real, imaginary);
        let size = real.abs().max(imaginary.abs());
        if !RANGE.contains(&size) {
            self.product = (real / size, imaginary / size);
        }
    }

    /// The sum, steradians.
    pub fn sum(&self) -> f64 {
        2.0 * (self.product.1.atan2(self.product.0) + f64::from(self.turns) * TAU)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn vector() -> impl Strategy<Value = DVec3> {
        (-1.0..1.0f64, -1.0..1.0f64, -1.0..1.0f64).prop_map(|(x, y, z)| DVec3::new(x, y, z))
    }

    proptest! {
        /// No point of a fine barycentric lattice is closer, and the point found lies on the triangle.
        #[test]
        fn closest_point_beats_a_lattice(p in vector(), a in vector(), b in vector(), c in vector()) {
            let TrianglePoint { point: found, weights: [u, v, w], .. } = closest_point_on_triangle(p, [a, b, c]);
            prop_assert!(u.min(v).min(w) >= 0.0 && (u + v + w - 1.0).abs() <= 1e-15);
            // A triangle of width 1e-3 amplifies eight roundings of 2^-53 by 1e3.
            prop_assert!((a * u + b * v + c * w).distance(found) <= 1e-12);
            let best = found.distance(p);
            let n = 24;
            let mut nearest_lattice = f64::INFINITY;
            for i in 0..=n {
                for j in 0..=(n - i) {
                    let (u, v) = (i as f64 / n as f64, j as f64 / n as f64);
                    let q = a + (b - a) * u + (c - a) * v;
                    prop_assert!(best <= q.distance(p) + 1e-12);
                    nearest_lattice = nearest_lattice.min(q.distance(found));
                }
            }
            // Any point of the triangle is at most one cell away from a lattice point.
            let cell = (b - a).length().max((c - a).length()).max((c - b).length()) / n as f64;
            prop_assert!(nearest_lattice <= cell);
        }
    }

    /// The weights of a point of a sliver state the point, and the point is as near as one of exact weights.
    #[test]
    fn a_sliver_has_the_point_of_its_weights() {
        for width in [1e-4, 1e-6, 1e-8, 1e-9] {
            let corners = [DVec3::new(0.3, 0.1, 0.2), DVec3::new(-0.5, 0.4, 0.1), DVec3::new(-0.1, 0.25, 0.15)];
            let across = (corners[1] - corners[0]).cross(DVec3::Y).normalize();
            let corners = [corners[0], corners[1], corners[2] + across * width];
            for apex in [0.1, 0.5, 0.9] {
                let inside = corners[0] * (0.7 * (1.0 - apex)) + corners[1] * (0.3 * (1.0 - apex)) + corners[2] * apex;
                let p = inside + triangle_cross(corners).normalize() * 0.25;
                let found = closest_point_on_triangle(p, corners);
                let [u, v, w] = found.weights;
                assert!(u.min(v).min(w) >= 0.0 && (u + v + w - 1.0).abs() <= 1e-15);
                let stated = corners[0] * u + corners[1] * v + corners[2] * w;
                assert!(stated.distance(found.point) <= 1e-15, "{width} {stated} {}", found.point);
                // The normal of a sliver is rounded by 1e-16 of its width, and the point lies 0.25 from it.
                assert!(found.point.distance(inside) <= 1e-15 + 1e-16 / width, "{width} {}", found.point - inside);
            }
        }
    }

    /// Corners that coincide leave an edge or a vertex.
    #[test]
    fn triangles_without_area_are_segments() {
        let (a, b) = (DVec3::new(0.0, 1.0, 0.0), DVec3::new(2.0, 1.0, 0.0));
        for (corners, nearest) in [([a, b, b], 1.5), ([b, a, a], 1.5), ([a, b, a], 1.5), ([a, a, a], 0.0)] {
            let found = closest_point_on_triangle(DVec3::new(1.5, 0.0, 1.0), corners);
            assert_eq!(found.point, DVec3::new(nearest, 1.0, 0.0), "{corners:?}");
        }
    }

    #[test]
    fn corners_on_a_line_are_recognised_exactly() {
        let third = 1.0 / 3.0;
        let line = [DVec3::new(third, 0.1, 7.0), DVec3::new(3.0 * third, 0.3, 7.0), DVec3::new(2.0 * third, 0.2, 7.0)];
        // 0.1, 0.2 and 0.3 are rounded, so that these corners are not on a line; with 0.125 they are.
        assert!(!is_on_a_line(line));
        let line =
            [DVec3::new(third, 0.125, 7.0), DVec3::new(4.0 * third, 0.5, 7.0), DVec3::new(2.0 * third, 0.25, 7.0)];
        assert!(is_on_a_line(line));
        assert!(!is_on_a_line([line[0], line[1], line[2] + DVec3::new(0.0, 0.0, 1e-15)]));
    }

    /// A sliver of float32 corners, thinner than float64 can resolve relative to its length, is treated as its edges.
    #[test]
    fn a_needle_is_as_near_as_its_edges() {
        let corners = [DVec3::Z, DVec3::new(0.1, 0.0, 0.9), DVec3::new(1e-17, 3e-18, 1.0)];
        let p = DVec3::new(0.05, 0.3, 0.95);
        let TrianglePoint { point: found, weights, .. } = closest_point_on_triangle(p, corners);
        assert!((found - DVec3::new(0.05, 0.0, 0.95)).length() < 1e-15, "{found}");
        let [u, v, w] = weights;
        assert!((corners[0] * u + corners[1] * v + corners[2] * w - found).length() < 1e-15, "{weights:?}");
    }

    #[test]
    fn features_are_named() {
        let t = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let feature = |x: f64, y: f64| closest_point_on_triangle(DVec3::new(x, y, 1.0), t).feature;
        assert_eq!(feature(0.25, 0.25), Feature::Face);
        assert_eq!(feature(0.5, -1.0), Feature::Edge(0));
        assert_eq!(feature(1.0, 1.0), Feature::Edge(1));
        assert_eq!(feature(-1.0, 0.5), Feature::Edge(2));
        assert_eq!(feature(-1.0, -1.0), Feature::Vertex(0));
        assert_eq!(feature(2.0, 0.0), Feature::Vertex(1));
        assert_eq!(feature(0.0, 2.0), Feature::Vertex(2));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(500))]
        /// One arc tangent gives the sum of many, seen from far away, from close by, and through whole turns.
        #[test]
        fn angles_add_up(
            triangles in proptest::collection::vec([vector(), vector(), vector()], 0..40), repeated in 1usize..8,
            scale in prop::sample::select(vec![1e-9, 1e-3, 1.0, 1e9])
        ) {
            let mut sum = SolidAngles::default();
            let mut expected = 0.0;
            for corners in triangles.iter().map(|corners| corners.map(|corner| corner * scale)) {
                // Repetitions of a triangle near the origin add up to several turns on one side.
                for _ in 0..repeated {
                    sum.add_sided(corners, || tangent_of_half(corners).0);
                    expected += solid_angle(corners);
                }
            }
            prop_assert!((sum.sum() - expected).abs() <= 1e-12, "{} {expected}", sum.sum());
        }
    }

    #[test]
    fn half_spaces_add_up_to_whole_turns() {
        // The origin lies in the triangle, so each has the angle of a half space, on the side of its positive zero.
        let around = [DVec3::X, DVec3::new(-1.0, 1.0, 0.0), DVec3::new(-1.0, -1.0, 0.0)];
        let beside = [DVec3::X, DVec3::Y, DVec3::ZERO];
        for count in 1..5 {
            let mut sum = SolidAngles::default();
            for _ in 0..count {
                sum.add(around);
                sum.add(beside);
            }
            assert!((sum.sum() - f64::from(count) * solid_angle(around)).abs() <= 1e-14, "{count} {}", sum.sum());
        }
    }

    #[test]
    fn octant_covers_an_eighth_of_the_sphere() {
        let octant = solid_angle([DVec3::X, DVec3::Y, DVec3::Z]);
        assert!((octant - 4.0 * PI / 8.0).abs() < 1e-14);
        assert!((solid_angle([DVec3::Y, DVec3::X, DVec3::Z]) + octant).abs() < 1e-14);
    }
}
