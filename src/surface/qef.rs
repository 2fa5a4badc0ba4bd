//! The point nearest to a set of planes, within a box.
//!
//! The vertex of a patch minimises a quadratic error function: the sum of squared distances to the tangent planes at
//! the crossings (Garland and Heckbert, as used by Ju, Losasso, Schaefer and Warren, "Dual Contouring of Hermite Data",
//! 2002). If the planes leave a direction undetermined (a flat surface, a straight edge), a small pull towards the mean
//! of the crossings determines it. The pull also displaces the vertex of an obtuse edge or corner, whose planes
//! determine its place weakly. The minimisation is therefore repeated with a pull towards its last result (iterated
//! Tikhonov regularisation), which multiplies the displacement by the same small factor each time and leaves
//! undetermined directions as they are. The minimum is taken over the cell, not over all space: a vertex outside its
//! cell could fold the surface.

use glam::{DMat3, DVec3};

/// Weight of the pull, relative to one plane. At the corner of a cube the first pull moves the vertex by a thousandth
/// of its distance from the mean.
const PULL: f64 = 1e-3;

/// Number of further minimisations. The displacement of a ridge whose faces enclose 160 degrees is 3 % of the distance
/// from the mean after the first one, and 3e-5 after two more.
const REFINEMENTS: usize = 2;

/// The sum of squared distances to planes as `v' A v - 2 b' v + const`.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Planes {
    matrix: DMat3,
    vector: DVec3,
    /// Sum of the squared distances of the planes from the origin.
    constant: f64,
    mean: DVec3,
    count: f64,
}

/// The minimum of [`Planes`] over a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Minimum {
    pub point: DVec3,
    /// Whether the minimum over all space lies outside the box.
    pub clamped: bool,
}

impl Planes {
    pub(crate) fn new() -> Self {
        Self { matrix: DMat3::ZERO, ..Self::default() }
    }

    /// Adds the plane with the unit normal `normal` at the distance `height` from `crossing`, which contributes to the
    /// mean.
    pub(crate) fn add(&mut self, crossing: DVec3, normal: DVec3, height: f64) {
        self.add_normal(normal, normal.dot(crossing) + height);
        self.mean += crossing;
        self.count += 1.0;
    }

    /// Adds the plane through `point` with the unit normal `normal`, which no edge crosses.
    pub(crate) fn add_plane(&mut self, point: DVec3, normal: DVec3) {
        self.add_normal(normal, normal.dot(point));
    }

    /// Adds the plane of the points `p` with `normal . p = distance`.
    fn add_normal(&mut self, normal: DVec3, distance: f64) {
        self.matrix += DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        self.vector += normal * distance;
        self.constant += distance * distance;
    }

    /// Adds a plane as [`Self::add_plane`] does. It adds to the weight of the pull, and has no crossing.
    pub(crate) fn add_near(&mut self, point: DVec3, normal: DVec3) {
        self.add_plane(point, normal);
        self.count += 1.0;
    }

    /// The sum of the squared distances of a point from the planes.
    pub(crate) fn error(&self, point: DVec3) -> f64 {
        point.dot(self.matrix * point) - 2.0 * self.vector.dot(point) + self.constant
    }

    /// The mean of the crossings.
    pub(crate) fn mean(&self) -> DVec3 {
        self.mean / self.count
    }

    /// The matrix and the vector with a pull towards `center`.
    fn pulled(&self, center: DVec3) -> (DMat3, DVec3) {
        // The matrix is positive definite: its smallest eigenvalue is at least `pull`.
        let pull = PULL * self.count;
        (self.matrix + DMat3::from_diagonal(DVec3::splat(pull)), self.vector + center * pull)
    }

    /// The minimum over the box from `lower` to `upper`, with a pull towards the mean.
    pub(crate) fn minimum(&self, lower: DVec3, upper: DVec3) -> Minimum {
        let (matrix, vector) = self.pulled(self.mean());
        let free = matrix.inverse() * vector;
        if is_within(free, [lower, upper]) {
            return Minimum { point: free, clamped: false };
        }
        Minimum { point: constrained(matrix, vector, lower, upper), clamped: true }
    }

    /// The minimum with a pull towards `point`, a previous minimum, repeated while it lies in the box from `lower` to
    /// `upper`.
    pub(crate) fn refined(&self, mut point: DVec3, lower: DVec3, upper: DVec3) -> DVec3 {
        let inverse = self.pulled(point).0.inverse();
        for _ in 0..REFINEMENTS {
            let next = inverse * self.pulled(point).1;
            if !is_within(next, [lower, upper]) {
                break;
            }
            point = next;
        }
        point
    }

    /// As [`Self::refined`], or the best point of the box if the first minimum lies outside.
    pub(crate) fn moved(&self, point: DVec3, lower: DVec3, upper: DVec3) -> DVec3 {
        let (matrix, vector) = self.pulled(point);
        if is_within(matrix.inverse() * vector, [lower, upper]) {
            return self.refined(point, lower, upper);
        }
        constrained(matrix, vector, lower, upper)
    }
}

/// Whether a point lies in the box from a lower to an upper corner.
pub(crate) fn is_within(point: DVec3, [lower, upper]: [DVec3; 2]) -> bool {
    point.cmpge(lower).all() && point.cmple(upper).all()
}

/// The minimum of `v' A v - 2 b' v` over a box, A positive definite: the best among the stationary points on the faces,
/// edges and corners. An axis is free (0), at its lower end (1) or at its upper end (2).
fn constrained(matrix: DMat3, vector: DVec3, lower: DVec3, upper: DVec3) -> DVec3 {
    let value = |v: DVec3| v.dot(matrix * v) - 2.0 * vector.dot(v);
    let mut best = (f64::INFINITY, 0.5 * (lower + upper));
    for choice in 1..27 {
        let ends = [choice % 3, choice / 3 % 3, choice / 9];
        let mut point = DVec3::from_array([0, 1, 2].map(|axis| [0.0, lower[axis], upper[axis]][ends[axis]]));
        // The gradient is zero along the free axes.
        let right = vector - matrix * point;
        let mut free = (0..3).filter(|&axis| ends[axis] == 0);
        match (free.next(), free.next()) {
            (Some(i), Some(j)) => {
                let (a, b, d) = (matrix.col(i)[i], matrix.col(i)[j], matrix.col(j)[j]);
                let inverse = 1.0 / (a * d - b * b);
                point[i] = (d * right[i] - b * right[j]) * inverse;
                point[j] = (a * right[j] - b * right[i]) * inverse;
            }
            (Some(i), None) => point[i] = right[i] / matrix.col(i)[i],
            _ => {}
        }
        if is_within(point, [lower, upper]) && value(point) < best.0 {
            best = (value(point), point);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes(list: &[(DVec3, DVec3)]) -> Planes {
        let mut planes = Planes::new();
        for &(point, normal) in list {
            planes.add(point, normal, 0.0);
        }
        planes
    }

    #[test]
    fn three_planes_meet_in_a_corner() {
        let corner = DVec3::new(0.3, 0.6, 0.2);
        let planes = planes(&[
            (corner + DVec3::new(0.0, 0.2, 0.1), DVec3::X),
            (corner + DVec3::new(0.3, 0.0, 0.1), DVec3::Y),
            (corner + DVec3::new(0.3, 0.2, 0.0), DVec3::Z),
        ]);
        let found = planes.minimum(DVec3::ZERO, DVec3::ONE);
        assert!(!found.clamped);
        // The pull is a thousandth of three planes, the distance from the mean is below 0.3.
        assert!((found.point - corner).length() <= 3.0 * PULL * 0.3);
    }

    #[test]
    fn an_obtuse_corner_is_found() {
        // Three faces of a pyramid that are inclined by 10 degrees; the mean of the crossings is half a voxel away.
        let corner = DVec3::new(0.7, 0.6, 0.5);
        let (sine, cosine) = 10f64.to_radians().sin_cos();
        let mut planes = Planes::new();
        for turn in [0.0, 120.0, 240.0f64] {
            let (y, x) = turn.to_radians().sin_cos();
            let normal = DVec3::new(x * sine, y * sine, cosine);
            let crossing = corner - DVec3::new(0.3, 0.4, 0.0);
            planes.add(crossing, normal, normal.dot(corner - crossing));
        }
        let found = planes.minimum(DVec3::ZERO, DVec3::ONE);
        assert!(!found.clamped);
        // Across the axis the eigenvalue of the planes is 3/2 sine^2, and each minimisation keeps the share
        // pull / (pull + eigenvalue) of half a voxel.
        let pull = 3.0 * PULL;
        let share = pull / (pull + 1.5 * sine * sine);
        assert!((found.point - corner).length() <= 0.5 * share + 1e-12);
        let refined = planes.refined(found.point, DVec3::ZERO, DVec3::ONE);
        assert!((refined - corner).length() <= 0.5 * share.powi(1 + REFINEMENTS as i32) + 1e-12);
        assert_eq!(planes.refined(found.point, DVec3::ZERO, DVec3::splat(0.5)), found.point);
    }

    #[test]
    fn equal_planes_leave_the_mean_in_the_plane() {
        let planes = planes(&[
            (DVec3::new(0.0, 0.0, 0.5), DVec3::Z),
            (DVec3::new(1.0, 0.0, 0.5), DVec3::Z),
            (DVec3::new(0.0, 1.0, 0.5), DVec3::Z),
        ]);
        let found = planes.minimum(DVec3::ZERO, DVec3::ONE);
        assert!((found.point - DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.5)).length() <= 1e-12);
    }

    #[test]
    fn a_minimum_outside_the_box_is_the_best_point_of_the_box() {
        // Two planes that meet along x = 2, z = 0.5 + 0.1; brute force over the box as the truth.
        let normal = DVec3::new(0.05, 0.0, 1.0).normalize();
        let planes = planes(&[
            (DVec3::new(2.0, 0.4, 0.6), normal),
            (DVec3::new(2.0, 0.6, 0.6), DVec3::new(-0.05, 0.0, 1.0).normalize()),
            (DVec3::new(0.3, 0.3, 0.4), DVec3::new(1.0, 1.0, 1.0).normalize()),
        ]);
        let found = planes.minimum(DVec3::ZERO, DVec3::ONE);
        assert!(found.clamped);
        let pull = PULL * planes.count;
        let matrix = planes.matrix + DMat3::from_diagonal(DVec3::splat(pull));
        let vector = planes.vector + planes.mean() * pull;
        let value = |v: DVec3| v.dot(matrix * v) - 2.0 * vector.dot(v);
        let least = value(found.point);
        for i in 0..=40 {
            for j in 0..=40 {
                for k in 0..=40 {
                    let p = DVec3::new(i as f64, j as f64, k as f64) / 40.0;
                    assert!(least <= value(p) + 1e-12);
                }
            }
        }
    }
}
