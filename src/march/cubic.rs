//! The first root of the trilinear field along a ray inside one cell.
//!
//! Along a straight line the three linear interpolations give a cubic polynomial. Its turning points, the roots of a
//! quadratic, divide the interval into at most three monotone pieces. The first piece whose end is <= 0 contains the
//! first root, and Newton's method inside that bracket finds it. This is the analytic intersection of
//! Hansson-Söderlund, Evans and Akenine-Möller, *Ray Tracing of Signed Distance Function Grids*, JCGT 11(3), 2022,
//! <https://jcgt.org/published/0011/03/06/>. The coefficients differ: they come from the interpolations themselves, x
//! then y then z, so that the constant term equals the sampled value to the bit.

use crate::gpu::constants::cubic::{MAX_NEWTON_STEPS, SMALLEST_STEP};
use glam::Vec3;

/// The polynomial `c0 + c1 s + c2 s^2 + c3 s^3`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cubic {
    pub c0: f32,
    pub c1: f32,
    pub c2: f32,
    pub c3: f32,
}

impl Cubic {
    /// The trilinear function of `corners` along `p + s direction`, where `p` is in the cell (0 to 1 along every axis).
    #[inline]
    pub(crate) fn along_ray(corners: &[f32; 8], p: Vec3, direction: Vec3) -> Self {
        // Along x: four linear functions.
        let linear = |a: f32, b: f32| [a + (b - a) * p.x, (b - a) * direction.x];
        let x00 = linear(corners[0], corners[1]);
        let x10 = linear(corners[2], corners[3]);
        let x01 = linear(corners[4], corners[5]);
        let x11 = linear(corners[6], corners[7]);
        // Along y: two quadratic functions.
        let quadratic = |a: [f32; 2], b: [f32; 2]| {
            let (d0, d1) = (b[0] - a[0], b[1] - a[1]);
            [a[0] + d0 * p.y, a[1] + d1 * p.y + d0 * direction.y, d1 * direction.y]
        };
        let y0 = quadratic(x00, x10);
        let y1 = quadratic(x01, x11);
        // Along z: the cubic.
        let (d0, d1, d2) = (y1[0] - y0[0], y1[1] - y0[1], y1[2] - y0[2]);
        Self {
            c0: y0[0] + d0 * p.z,
            c1: y0[1] + d1 * p.z + d0 * direction.z,
            c2: y0[2] + d2 * p.z + d1 * direction.z,
            c3: d2 * direction.z,
        }
    }

    /// The cubic divided by a unit of distance.
    #[inline]
    pub(crate) fn scaled(self, factor: f32) -> Self {
        Self { c0: self.c0 * factor, c1: self.c1 * factor, c2: self.c2 * factor, c3: self.c3 * factor }
    }

    #[inline]
    pub(crate) fn value(&self, s: f32) -> f32 {
        self.c0 + s * (self.c1 + s * (self.c2 + s * self.c3))
    }

    #[inline]
    pub(crate) fn slope(&self, s: f32) -> f32 {
        self.c1 + s * (2.0 * self.c2 + s * 3.0 * self.c3)
    }

    /// The first `s` in `[0, s_end]` where the cubic is <= 0.
    #[inline]
    pub(crate) fn first_root(&self, s_end: f32) -> Option<f32> {
        if self.c0 <= 0.0 {
            return Some(0.0);
        }
        let [turn_0, turn_1] = self.turning_points(s_end);
        let mut start = 0.0;
        for end in [turn_0, turn_1, s_end] {
            if end > start {
                if self.value(end) <= 0.0 {
                    return Some(self.falling_root(start, end));
                }
                start = end;
            }
        }
        None
    }

    /// The roots of the derivative in `(0, s_end)`, in ascending order; `s_end` replaces each root outside.
    fn turning_points(&self, s_end: f32) -> [f32; 2] {
        // slope = a s^2 + 2 b s + c, solved without cancellation: q has the sign of -b.
        let (a, b, c) = (3.0 * self.c3, self.c2, self.c1);
        let discriminant = b * b - a * c;
        if discriminant <= 0.0 {
            return [s_end, s_end];
        }
        let root = discriminant.sqrt();
        let q = if b < 0.0 { root - b } else { -root - b };
        let first = quotient_below(q, a, s_end);
        let second = quotient_below(c, q, s_end);
        [first.min(second), first.max(second)]
    }

    /// The root in `[start, end]`, where the cubic falls from above zero to zero or below. Newton's method, with a
    /// bisection wherever a step leaves the bracket or shrinks too slowly.
    fn falling_root(&self, start: f32, end: f32) -> f32 {
        let (mut low, mut high) = (start, end);
        let (value_low, value_high) = (self.value(low), self.value(high));
        let mut s = low + (high - low) * (value_low / (value_low - value_high));
        let mut last_step = high - low;
        for _ in 0..MAX_NEWTON_STEPS {
            let value = self.value(s);
            if value > 0.0 {
                low = s;
            } else {
                high = s;
            }
            // value / slope is arbitrary where the slope vanishes. The comparison then selects the bisection.
            let slope = self.slope(s);
            let step = if slope < 0.0 { -value / slope } else { 2.0 * last_step };
            let newton = s + step;
            let converges = newton >= low && newton <= high && step.abs() <= 0.5 * last_step;
            let next = if converges { newton } else { 0.5 * (low + high) };
            last_step = (next - s).abs();
            s = next;
            if last_step <= SMALLEST_STEP {
                break;
            }
        }
        s
    }
}

/// `numerator / denominator` if the quotient lies in `(0, limit)`, else `limit`. The division is skipped where it could
/// overflow.
#[inline]
fn quotient_below(numerator: f32, denominator: f32, limit: f32) -> f32 {
    let same_sign = (numerator > 0.0 && denominator > 0.0) || (numerator < 0.0 && denominator < 0.0);
    if same_sign && numerator.abs() < limit * denominator.abs() { numerator / denominator } else { limit }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::trilinear;
    use proptest::prelude::*;

    /// A ray crosses at most the diagonal of a cell.
    const DIAGONAL: f32 = 1.732_050_8;

    /// Sums of eight corners of magnitude 1 in about twelve operations, with direction components up to 1.
    const ROUNDING: f64 = 64.0 * f32::EPSILON as f64;

    fn exact(cubic: &Cubic, s: f64) -> f64 {
        cubic.c0 as f64 + s * (cubic.c1 as f64 + s * (cubic.c2 as f64 + s * cubic.c3 as f64))
    }

    /// Compares with dense sampling in f64: no root is missed or invented, and no earlier root is skipped.
    fn check_first_root(cubic: &Cubic, s_end: f32) {
        const SAMPLES: usize = 4096;
        let size = (cubic.c0.abs() + cubic.c1.abs() + cubic.c2.abs() + cubic.c3.abs()) as f64;
        let rounding = 16.0 * f32::EPSILON as f64 * size.max(1e-30) * (s_end as f64).powi(3).max(1.0);
        let found = cubic.first_root(s_end);
        if let Some(s) = found {
            assert!((0.0..=s_end).contains(&s));
            let value = exact(cubic, s as f64);
            // A root moves by at most one ulp of s; the cubic's slope is at most 3 * size * s_end^2.
            assert!(value <= 4.0 * rounding && (s == 0.0 || value >= -4.0 * rounding), "{cubic:?} {s} {value}");
        }
        if found == Some(0.0) {
            return assert!(cubic.c0 <= 0.0);
        }
        let last = found.unwrap_or(s_end) as f64;
        for i in 0..SAMPLES {
            let s = last * i as f64 / SAMPLES as f64;
            assert!(exact(cubic, s) > -rounding, "{cubic:?} on {s_end}: below zero at {s}, found {found:?}");
        }
    }

    fn corners() -> impl Strategy<Value = [f32; 8]> {
        prop::array::uniform8(-1.0..1.0f32)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn along_ray_is_the_trilinear_field(
            corners in corners(),
            p in prop::array::uniform3(0.0..1.0f32),
            direction in prop::array::uniform3(-1.0..1.0f32),
            s in 0.0..1.0f32,
        ) {
            let (p, direction) = (Vec3::from(p), Vec3::from(direction));
            let cubic = Cubic::along_ray(&corners, p, direction);
            prop_assert_eq!(cubic.c0, trilinear(&corners, p));
            // The point leaves the cell by up to one voxel, which increases each of the eight terms by a factor of up
            // to eight.
            let difference = cubic.value(s) as f64 - trilinear(&corners, p + s * direction) as f64;
            prop_assert!(difference.abs() < 8.0 * ROUNDING);
        }

        #[test]
        fn first_root_of_a_cell(
            corners in corners(),
            p in prop::array::uniform3(0.0..1.0f32),
            direction in prop::array::uniform3(-1.0..1.0f32),
        ) {
            let direction = Vec3::from(direction).normalize_or(Vec3::X);
            check_first_root(&Cubic::along_ray(&corners, Vec3::from(p), direction), DIAGONAL);
        }

        #[test]
        fn first_root_of_three_given_roots(roots in prop::array::uniform3(-0.5..2.0f32), flip in any::<bool>()) {
            // (r0 - s)(r1 - s)(r2 - s) and its mirror image.
            let [a, b, c] = roots;
            let sign = if flip { -1.0 } else { 1.0 };
            let cubic = Cubic { c0: sign * a * b * c, c1: -sign * (a * b + b * c + c * a), c2: sign * (a + b + c), c3: -sign };
            check_first_root(&cubic, DIAGONAL);
        }

        #[test]
        fn first_root_of_a_double_root(root in 0.1..1.5f32, other in -3.0..3.0f32, lift in -1e-6..1e-6f32) {
            // (s - root)^2 (other - s) + lift touches zero, or just misses it.
            let cubic = Cubic {
                c0: root * root * other + lift,
                c1: -root * root - 2.0 * root * other,
                c2: 2.0 * root + other,
                c3: -1.0,
            };
            check_first_root(&cubic, DIAGONAL);
        }
    }

    #[test]
    fn lower_degrees_and_constants() {
        let line = Cubic { c0: 1.0, c1: -2.0, c2: 0.0, c3: 0.0 };
        assert_eq!(line.first_root(1.0), Some(0.5));
        assert_eq!(line.first_root(0.4), None);
        let parabola = Cubic { c0: 0.1875, c1: -1.0, c2: 1.0, c3: 0.0 };
        assert!((parabola.first_root(1.0).unwrap() - 0.25).abs() <= f32::EPSILON);
        assert_eq!(Cubic { c0: 1.0, c1: 0.0, c2: 0.0, c3: 0.0 }.first_root(1.0), None);
        assert_eq!(Cubic { c0: 0.0, c1: 1.0, c2: 0.0, c3: 0.0 }.first_root(1.0), Some(0.0));
        assert_eq!(Cubic { c0: -1.0, c1: 0.0, c2: 0.0, c3: 0.0 }.first_root(0.0), Some(0.0));
    }

    #[test]
    fn a_triple_root_converges() {
        let cubic = Cubic { c0: 0.125, c1: -0.75, c2: 1.5, c3: -1.0 };
        // The resolution of a double root is the cube root of the rounding of 1.
        assert!((cubic.first_root(1.0).unwrap() - 0.5).abs() < f32::EPSILON.cbrt());
    }
}
