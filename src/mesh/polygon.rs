//! Division of polygons into triangles.

use glam::{DVec2, DVec3};

/// Divides a polygon into triangles of its corners, as rows of `corners`. A convex polygon is a fan from its first
/// corner. From any other one ears are cut off, triangles of three consecutive corners that contain no other corner
/// (G. Meisters, "Polygons have ears", 1975). A polygon that is not flat is projected along its area vector, and one
/// that crosses itself may end as a fan.
pub(crate) fn triangulate(corners: &[DVec3]) -> Vec<[usize; 3]> {
    let rest: Vec<usize> = (0..corners.len()).collect();
    // Most polygons are quadrilaterals whose two triangles have one orientation.
    if let [a, b, c, d] = *corners
        && (b - a).cross(c - a).dot((c - a).cross(d - a)) > 0.0
    {
        return fan(&rest);
    }
    let flat = projected_along_normal(corners);
    let turns = |a: usize, b: usize, c: usize| (flat[b] - flat[a]).perp_dot(flat[c] - flat[b]);
    let n = corners.len();
    if (0..n).all(|i| turns((i + n - 1) % n, i, (i + 1) % n) >= 0.0) {
        return fan(&rest);
    }
    let contains =
        |[a, b, c]: [usize; 3], p: usize| turns(a, b, p) >= 0.0 && turns(b, c, p) >= 0.0 && turns(c, a, p) >= 0.0;
    let is_same = |p: usize, triangle: [usize; 3]| triangle.iter().any(|&corner| corners[corner] == corners[p]);
    let (mut rest, mut triangles) = (rest, Vec::with_capacity(n - 2));
    while rest.len() > 3 {
        let n = rest.len();
        let triangle = |i: usize| [rest[(i + n - 1) % n], rest[i], rest[(i + 1) % n]];
        let is_ear = |i: &usize| {
            let [a, b, c] = triangle(*i);
            turns(a, b, c) > 0.0 && rest.iter().all(|&p| is_same(p, [a, b, c]) || !contains([a, b, c], p))
        };
        // A corner on a straight edge has no area, and is cut off if there is no ear.
        let is_straight = |i: &usize| {
            let [a, b, c] = triangle(*i);
            turns(a, b, c) == 0.0
        };
        let Some(i) = (0..n).find(is_ear).or_else(|| (0..n).find(is_straight)) else { break };
        triangles.push(triangle(i));
        rest.remove(i);
    }
    triangles.extend(fan(&rest));
    triangles
}

fn fan(corners: &[usize]) -> Vec<[usize; 3]> {
    corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]).collect()
}

/// The corners in the plane of the polygon, in which it is counter-clockwise.
fn projected_along_normal(corners: &[DVec3]) -> Vec<DVec2> {
    let origin = corners.first().copied().unwrap_or_default();
    let pairs = corners.windows(2);
    let normal = pairs.map(|pair| (pair[0] - origin).cross(pair[1] - origin)).sum::<DVec3>();
    let Some(normal) = normal.try_normalize() else { return vec![DVec2::ZERO; corners.len()] };
    let right = normal.any_orthonormal_vector();
    let up = normal.cross(right);
    corners.iter().map(|&p| DVec2::new((p - origin).dot(right), (p - origin).dot(up))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn area(corners: &[DVec3], [a, b, c]: [usize; 3]) -> DVec3 {
        0.5 * (corners[b] - corners[a]).cross(corners[c] - corners[a])
    }

    #[test]
    fn an_l_is_divided_within_itself_from_every_corner() {
        let l = [[0, 0], [2, 0], [2, 1], [1, 1], [1, 2], [0, 2]];
        for first in 0..6 {
            let corners: Vec<DVec3> =
                (0..6).map(|i| l[(first + i) % 6]).map(|[x, y]| DVec3::new(x.into(), 7.0, y.into())).collect();
            let triangles = triangulate(&corners);
            assert_eq!(triangles.len(), 4);
            let areas: Vec<f64> = triangles.iter().map(|&triangle| area(&corners, triangle).y).collect();
            assert!(
                areas.iter().all(|&area| area <= 0.0) && (areas.iter().sum::<f64>() + 3.0).abs() <= 1e-12,
                "{areas:?}"
            );
        }
    }

    proptest! {
        /// Stars have the sum of the areas of their triangles, none of which is turned over.
        #[test]
        fn stars_are_covered_once(radii in prop::collection::vec(0.1..3.0f64, 4..14), turn in 0.0..6.0f64, tilt in 0.0..3.0f64) {
            let n = radii.len() as f64;
            let corners: Vec<DVec3> = radii.iter().enumerate().map(|(i, radius)| {
                let angle = turn + std::f64::consts::TAU * i as f64 / n;
                let (x, y) = (radius * angle.cos(), radius * angle.sin());
                DVec3::new(x, y * tilt.cos(), y * tilt.sin())
            }).collect();
            let normal = DVec3::new(0.0, -tilt.sin(), tilt.cos());
            let triangles = triangulate(&corners);
            prop_assert_eq!(triangles.len(), radii.len() - 2);
            let whole: f64 = (0..radii.len()).map(|i| {
                0.5 * radii[i] * radii[(i + 1) % radii.len()] * (std::f64::consts::TAU / n).sin()
            }).sum();
            let areas: Vec<f64> = triangles.iter().map(|&t| area(&corners, t).dot(normal)).collect();
            prop_assert!(areas.iter().all(|&area| area >= -1e-12));
            prop_assert!((areas.iter().sum::<f64>() - whole).abs() <= 1e-9);
        }
    }
}
