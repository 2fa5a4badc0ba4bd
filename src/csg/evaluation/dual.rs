//! Numbers with their derivatives by the position: a field and its gradient in one evaluation.
//!
//! A [`Dual`] is a value and the three partial derivatives of the value. Arithmetic follows the rules of calculus
//! (forward-mode automatic differentiation; R. Wengert, "A simple automatic derivative evaluation program", 1964), so
//! the gradient is exact up to rounding. A comparison compares the values alone. Where two operands of a minimum meet
//! in a crease, the result is therefore the gradient of one side, never a mean of both. The value has the bits of the
//! same evaluation in float64.

use super::scalar::Scalar;
use glam::DVec3;
use std::cmp::Ordering;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

/// The direction, of length about 1, in which a point beside one without a gradient lies. No face and no plane of
/// symmetry is likely to contain it.
pub(crate) const ASIDE: DVec3 = DVec3::new(0.43, 0.57, 0.71);

/// A value and its gradient.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Dual {
    pub(crate) value: f64,
    pub(crate) slope: [f64; 3],
}

impl Dual {
    /// The three coordinates of a point, each with its own derivative.
    pub(crate) fn position(p: DVec3) -> [Self; 3] {
        let along = |axis: usize| {
            let mut slope = [0.0; 3];
            slope[axis] = 1.0;
            Self { value: p[axis], slope }
        };
        [along(0), along(1), along(2)]
    }

    /// `value`, a function of `self` with the derivative `rate`.
    #[inline(always)]
    fn chain(self, value: f64, rate: f64) -> Self {
        self.zip(self, value, |slope, _| rate * slope)
    }

    #[inline(always)]
    fn is_steeper(self, other: Self) -> bool {
        let square = |[x, y, z]: [f64; 3]| x * x + y * y + z * z;
        square(self.slope) > square(other.slope)
    }

    #[inline(always)]
    fn zip(self, other: Self, value: f64, slope: impl Fn(f64, f64) -> f64) -> Self {
        // Written out, because `map` of an array is not always inlined.
        let ([a, b, c], [d, e, f]) = (self.slope, other.slope);
        Self { value, slope: [slope(a, d), slope(b, e), slope(c, f)] }
    }
}

impl PartialEq for Dual {
    #[inline(always)]
    fn eq(&self, other: &Self) -> bool {
        self.value == other.value
    }
}

impl PartialOrd for Dual {
    #[inline(always)]
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.value.partial_cmp(&other.value)
    }

    #[inline(always)]
    fn lt(&self, other: &Self) -> bool {
        self.value < other.value
    }

    #[inline(always)]
    fn gt(&self, other: &Self) -> bool {
        self.value > other.value
    }
}

impl Add for Dual {
    type Output = Self;
    #[inline(always)]
    fn add(self, other: Self) -> Self {
        self.zip(other, self.value + other.value, |a, b| a + b)
    }
}

impl AddAssign for Dual {
    #[inline(always)]
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Dual {
    type Output = Self;
    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        self.zip(other, self.value - other.value, |a, b| a - b)
    }
}

impl Mul for Dual {
    type Output = Self;
    #[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule is a sum")]
    #[inline(always)]
    fn mul(self, other: Self) -> Self {
        self.zip(other, self.value * other.value, |a, b| a * other.value + self.value * b)
    }
}

impl Div for Dual {
    type Output = Self;
    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let (value, inverse) = (self.value / other.value, 1.0 / other.value);
        self.zip(other, value, |a, b| (a - value * b) * inverse)
    }
}

impl Neg for Dual {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.chain(-self.value, -1.0)
    }
}

impl Scalar for Dual {
    #[inline(always)]
    fn of(value: f64) -> Self {
        Self { value, slope: [0.0; 3] }
    }

    #[inline(always)]
    fn widen(self) -> f64 {
        self.value
    }

    /// The derivative at zero counts as zero: lengths of vectors that are zero around a point have none.
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, if root > 0.0 { 0.5 / root } else { 0.0 })
    }

    #[inline(always)]
    fn abs(self) -> Self {
        if self.value < 0.0 { -self } else { self }
    }

    #[inline(always)]
    fn sin(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(sin, cos)
    }

    #[inline(always)]
    fn cos(self) -> Self {
        let (sin, cos) = self.value.sin_cos();
        self.chain(cos, -sin)
    }

    #[inline(always)]
    fn floor(self) -> Self {
        Self::of(self.value.floor())
    }

    /// The derivative on the axis counts as zero.
    #[inline(always)]
    fn atan2(self, x: Self) -> Self {
        let squared = x.value * x.value + self.value * self.value;
        let inverse = if squared > 0.0 { 1.0 / squared } else { 0.0 };
        self.zip(x, self.value.atan2(x.value), |dy, dx| (x.value * dy - self.value * dx) * inverse)
    }

    /// The smaller value. The steeper one of two equal values, so that a coordinate at its limit still changes.
    #[inline(always)]
    fn least(self, other: Self) -> Self {
        if self.value < other.value || (self.value == other.value && self.is_steeper(other)) { self } else { other }
    }

    #[inline(always)]
    fn most(self, other: Self) -> Self {
        if self.value > other.value || (self.value == other.value && self.is_steeper(other)) { self } else { other }
    }
}
