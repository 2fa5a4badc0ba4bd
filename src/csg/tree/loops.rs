//! Closed polygons.

use glam::DVec2;

/// A closed polygon.
pub(crate) type Loop = Vec<DVec2>;

/// Lower and upper corner of the box around loops.
pub(crate) fn bounds(loops: &[Loop]) -> [DVec2; 2] {
    let start = [DVec2::INFINITY, DVec2::NEG_INFINITY];
    loops.iter().flatten().fold(start, |[lower, upper], &p| [lower.min(p), upper.max(p)])
}

/// Twice the signed area of a loop, positive if it is counter-clockwise. Corners count from the first one, so that a
/// loop far from the origin loses no digits.
pub(crate) fn area(corners: &[DVec2]) -> f64 {
    let Some(&first) = corners.first() else { return 0.0 };
    let pairs = corners.iter().zip(corners.iter().cycle().skip(1));
    pairs.map(|(&a, &b)| (a - first).perp_dot(b - first)).sum()
}
