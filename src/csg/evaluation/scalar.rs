//! The arithmetic of evaluation, for float32 (pictures, grids) and float64 (queries, gradients).

use crate::csg::tree::volume_leaf::VolumeLeaf;
use std::fmt::Debug;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};
use std::sync::Arc;

/// A floating-point number.
pub trait Scalar:
    Copy
    + Debug
    + Default
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + 'static
{
    /// Whether the numbers have no values but make a graph; see [`crate::csg::text::graph`].
    const IS_SYMBOLIC: bool = false;

    fn of(value: f64) -> Self;
    fn widen(self) -> f64;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn sin(self) -> Self;
    fn cos(self) -> Self;
    fn floor(self) -> Self;
    /// The angle of the vector `(x, self)` from the x axis, radians, -pi to pi.
    fn atan2(self, x: Self) -> Self;

    /// Plain comparisons. The standard `min` and `max` handle NaN, which cannot occur here.
    #[inline(always)]
    fn least(self, other: Self) -> Self {
        if self < other { self } else { other }
    }
    #[inline(always)]
    fn most(self, other: Self) -> Self {
        if self > other { self } else { other }
    }
    /// `then` if `a` is less than `b`, else `otherwise`. Fields have no other branch that depends on the point.
    #[inline(always)]
    fn select_less(a: Self, b: Self, then: Self, otherwise: Self) -> Self {
        if a < b { then } else { otherwise }
    }
    /// The sample of a volume at a position in voxels, for symbols; numbers are interpolated.
    #[inline(always)]
    fn image_sample(_volume: &Arc<VolumeLeaf>, _at: [Self; 3]) -> Option<Self> {
        None
    }
    /// As [`Scalar::select_less`] for several numbers, of which only the selected ones are computed.
    #[inline(always)]
    fn branch_less<const N: usize>(
        a: Self,
        b: Self,
        then: impl FnOnce() -> [Self; N],
        otherwise: impl FnOnce() -> [Self; N],
    ) -> [Self; N] {
        if a < b { then() } else { otherwise() }
    }
    #[inline(always)]
    fn between(self, low: Self, high: Self) -> Self {
        self.most(low).least(high)
    }
}

macro_rules! real {
    ($float:ty) => {
        impl Scalar for $float {
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $float
            }
            #[inline(always)]
            fn widen(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn floor(self) -> Self {
                self.floor()
            }
            #[inline(always)]
            fn atan2(self, x: Self) -> Self {
                self.atan2(x)
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn sin(self) -> Self {
                self.sin()
            }
            #[inline(always)]
            fn cos(self) -> Self {
                self.cos()
            }
        }
    };
}
real!(f32);
real!(f64);

/// Length of a vector in the plane.
#[inline(always)]
pub(crate) fn length2<F: Scalar>(x: F, y: F) -> F {
    (x * x + y * y).sqrt()
}

/// Length of a vector in space.
#[inline(always)]
pub(crate) fn length3<F: Scalar>([x, y, z]: [F; 3]) -> F {
    (x * x + y * y + z * z).sqrt()
}
