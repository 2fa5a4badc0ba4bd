//! The closest points of two triangles.

use super::closest_point_on_triangle;
use glam::DVec3;

/// The closest points of two triangles, one on each, and their distance. Triangles may be segments or points.
///
/// The distance lies between a vertex and the other triangle, or of two edges, unless an edge passes through the other
/// triangle (C. Ericson, "Real-Time Collision Detection", 2005, section 5.1).
pub fn closest_points_of_triangles(a: [DVec3; 3], b: [DVec3; 3]) -> (f64, DVec3, DVec3) {
    let mut best = (f64::INFINITY, a[0], b[0]);
    let mut offer = |p: DVec3, q: DVec3| {
        let squared = p.distance_squared(q);
        if squared < best.0 {
            best = (squared, p, q);
        }
    };
    for i in 0..3 {
        offer(a[i], closest_point_on_triangle(a[i], b).point);
        offer(closest_point_on_triangle(b[i], a).point, b[i]);
        for j in 0..3 {
            let (p, q) = closest_points_of_segments([a[i], a[(i + 1) % 3]], [b[j], b[(j + 1) % 3]]);
            offer(p, q);
        }
    }
    for i in 0..3 {
        for point in [crossing([a[i], a[(i + 1) % 3]], b), crossing([b[i], b[(i + 1) % 3]], a)].into_iter().flatten() {
            offer(point, point);
        }
    }
    (best.0.sqrt(), best.1, best.2)
}

/// The closest points of two segments, which may be points (Ericson, section 5.1.9).
fn closest_points_of_segments([a, b]: [DVec3; 2], [c, d]: [DVec3; 2]) -> (DVec3, DVec3) {
    let (u, v, r) = (b - a, d - c, a - c);
    let (uu, vv, uv) = (u.length_squared(), v.length_squared(), u.dot(v));
    let (ur, vr) = (u.dot(r), v.dot(r));
    // The quotient of zeros belongs to a segment without length, or to parallel segments.
    let clamp = |x: f64| if x > 0.0 { x.min(1.0) } else { 0.0 };
    let mut s = clamp((uv * vr - vv * ur) / (uu * vv - uv * uv));
    let mut t = (uv * s + vr) / vv;
    if !(0.0..=1.0).contains(&t) {
        t = clamp(t);
        s = clamp((uv * t - ur) / uu);
    }
    (a + u * s, c + v * t)
}

/// The point where a segment passes through a triangle.
fn crossing([p, q]: [DVec3; 2], [a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    let normal = (b - a).cross(c - a);
    let (from, to) = (normal.dot(p - a), normal.dot(q - a));
    let has_two_sides = from * to < 0.0;
    if !has_two_sides {
        return None;
    }
    let point = p + (q - p) * (from / (from - to));
    let is_inside = |u: DVec3, v: DVec3| (v - u).cross(point - u).dot(normal) >= 0.0;
    (is_inside(a, b) && is_inside(b, c) && is_inside(c, a)).then_some(point)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(state: &mut u64) -> f64 {
        *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (*state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    fn triangle(state: &mut u64, shift: f64) -> [DVec3; 3] {
        let shift = DVec3::new(random(state), random(state), random(state)) * shift;
        [0, 1, 2].map(|_| DVec3::new(random(state), random(state), random(state)) + shift)
    }

    /// The distance by alternating projections, an upper bound that converges for convex sets.
    fn truth(a: [DVec3; 3], b: [DVec3; 3]) -> f64 {
        let mut p = (a[0] + a[1] + a[2]) / 3.0;
        let mut q = p;
        for _ in 0..20_000 {
            q = closest_point_on_triangle(p, b).point;
            p = closest_point_on_triangle(q, a).point;
        }
        p.distance(q)
    }

    #[test]
    fn the_distance_is_that_of_alternating_projections() {
        let mut state = 5;
        let mut crossings = 0;
        for case in 0..400 {
            let (mut a, b) = (triangle(&mut state, 1.5), triangle(&mut state, 1.5));
            match case % 4 {
                0 => a[2] = a[1],
                1 => a = [a[0]; 3],
                _ => {}
            }
            let (distance, p, q) = closest_points_of_triangles(a, b);
            assert!((p.distance(q) - distance).abs() <= 1e-14);
            assert!(closest_point_on_triangle(p, a).point.distance(p) <= 1e-12);
            assert!(closest_point_on_triangle(q, b).point.distance(q) <= 1e-12);
            let expected = truth(a, b);
            assert!(distance <= expected + 1e-12, "{distance} {expected}");
            // Projections converge slowly where edges are nearly parallel.
            assert!(distance >= expected - 1e-4, "{distance} {expected}");
            crossings += usize::from(distance == 0.0);
        }
        assert!(crossings > 3, "{crossings}");
    }

    #[test]
    fn parallel_segments_and_points_have_finite_distances() {
        let x = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        let segment = |from: f64, to: f64, y: f64| [x(from, y), x(to, y), x(to, y)];
        assert!((closest_points_of_triangles(segment(0.0, 1.0, 0.0), segment(0.5, 2.0, 2.0)).0 - 2.0).abs() <= 1e-15);
        assert!((closest_points_of_triangles(segment(0.0, 1.0, 0.0), segment(4.0, 5.0, 4.0)).0 - 5.0).abs() <= 1e-15);
        assert!((closest_points_of_triangles([x(0.0, 0.0); 3], [x(3.0, 4.0); 3]).0 - 5.0).abs() <= 1e-15);
    }
}
