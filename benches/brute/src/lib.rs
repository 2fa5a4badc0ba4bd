//! Distances by brute force in float64, for `exactness.py`: every point visits every triangle.

use rayon::prelude::*;
use std::slice;

type Point = [f64; 3];

/// A triangle and a ball that holds it, so that most of them cost one comparison.
struct Triangle {
    corners: [Point; 3],
    center: Point,
    radius: f64,
}

/// Unsigned distances of points to the nearest of all triangles, on all cores.
///
/// # Safety
/// `corners` points to `triangle_count` times nine doubles, `points` to `count` times three, `out` to `count`.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn brute_distances(
    corners: *const f64,
    triangle_count: usize,
    points: *const f64,
    count: usize,
    out: *mut f64,
) {
    // SAFETY: by the contract above.
    let (corners, points, out) = unsafe {
        (
            slice::from_raw_parts(corners, 9 * triangle_count),
            slice::from_raw_parts(points, 3 * count),
            slice::from_raw_parts_mut(out, count),
        )
    };
    let triangles: Vec<Triangle> = corners.chunks_exact(9).map(Triangle::new).collect();
    out.par_iter_mut().zip(points.par_chunks_exact(3)).for_each(|(distance, p)| {
        let p = [p[0], p[1], p[2]];
        let mut least = f64::INFINITY;
        for triangle in &triangles {
            let offset = minus(p, triangle.center);
            // Nothing in the ball is nearer than its near side; a share of 1e-12 covers the rounding.
            let reach = (least + triangle.radius) * (1.0 + 1e-12);
            if dot(offset, offset) <= reach * reach {
                least = least.min(triangle.distance(p));
            }
        }
        *distance = least;
    });
}

impl Triangle {
    fn new(numbers: &[f64]) -> Self {
        let corners = [0, 3, 6].map(|i| [numbers[i], numbers[i + 1], numbers[i + 2]]);
        let center = [0, 1, 2].map(|axis| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0);
        let radius = corners.iter().map(|&corner| length(minus(corner, center))).fold(0.0, f64::max);
        Self { corners, center, radius }
    }

    /// The least of the three edges' distances, and the distance of the plane where the foot lies inside.
    fn distance(&self, p: Point) -> f64 {
        let [a, b, c] = self.corners;
        let edges = [(a, b), (b, c), (c, a)];
        let nearest = edges.iter().map(|&(from, to)| segment_distance(p, from, to)).fold(f64::INFINITY, f64::min);
        let normal = cross(minus(b, a), minus(c, a));
        let inside = edges.iter().all(|&(from, to)| dot(cross(minus(to, from), minus(p, from)), normal) >= 0.0);
        let size = length(normal);
        if inside && size > 0.0 { nearest.min(dot(normal, minus(p, a)).abs() / size) } else { nearest }
    }
}

fn segment_distance(p: Point, from: Point, to: Point) -> f64 {
    let (along, offset) = (minus(to, from), minus(p, from));
    let squared = dot(along, along);
    let t = if squared > 0.0 { (dot(along, offset) / squared).clamp(0.0, 1.0) } else { 0.0 };
    length([0, 1, 2].map(|axis| offset[axis] - t * along[axis]))
}

fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn cross(a: Point, b: Point) -> Point {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(a: Point) -> f64 {
    dot(a, a).sqrt()
}
