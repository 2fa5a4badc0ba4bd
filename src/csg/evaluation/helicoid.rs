//! The distance to a screw thread.
//!
//! # Theory
//!
//! A thread is the image of a curve in the half plane of an axial section under the screw motions about z with the
//! lead `2 pi h`. By these motions the point to evaluate is `(R, 0, Z)`. The point of the surface at the angle `a`
//! from the curve's point `(r, z)` is `(r cos a, r sin a, z + h a)`, so the squared distance is
//!
//! ```text
//! min over a of  (R sin a)^2 + D(R cos a, Z - h a)^2,    D: distance to the curve in its plane
//! ```
//!
//! The minimum for a flank is found by alternation: its point that is nearest at one angle, then one step of Newton's
//! method to the angle that is nearest for this point. No step raises the distance but by rounding, and each step
//! divides the error of the angle by about `R^2 / h^2`, which is 300 for M10.
//!
//! *Bound.* The first value is `D(R, Z)`, the distance in the plane of the point. As a function in space its slope is
//! at most `L = sqrt(1 + h^2 / R^2)`, so it is at most `L` times the distance, and so are all later values. Values of
//! points nearer to the axis than `core` are the value at `core`, less the way there, but at least the distance to
//! the inscribed cylinder `minor`. Since `core` is half of `minor` and the distance is at least `minor - core` there,
//! the value is at most `2 L - 1` times the distance with `L` at `core`. A nearest point is never beyond the core:
//! the way would be longer than `sqrt(3)/2 minor`, and a root is nearer because the pitch is at most `minor`.

use super::scalar::{Scalar, length2, length3};
use crate::csg::tree::primitive::PARAMETERS;
use crate::gpu::constants::csg_field::{THREAD_CORE, THREAD_SEARCHES};
use std::f64::consts::PI;

/// The nearest crest to a position `u` along the axis, and the way from it to `u`.
#[inline(always)]
fn folded<F: Scalar>(u: F, pitch: F) -> (F, F) {
    let crest = (u / pitch + F::of(0.5)).floor() * pitch;
    (crest, u - crest)
}

/// Signed distance to a thread, negative inside.
#[inline(always)]
pub(crate) fn thread<F: Scalar>([x, y, z]: [F; 3], p: &[F; PARAMETERS]) -> F {
    let (zero, one) = (F::default(), F::of(1.0));
    let [pitch, minor, major, crest, root, offset] = *p;
    let rise = pitch * F::of(0.5 / PI);
    let r = length2(x, y);
    let core = minor * F::of(THREAD_CORE);
    let outer = r.most(core);
    let height = z - rise * y.atan2(x);
    let flank = [minor - major, root - crest];
    let inverse = one / (flank[0] * flank[0] + flank[1] * flank[1]);

    let from_crest = folded(height, pitch).1.abs();
    let limit = major + ((from_crest - crest) / flank[1]).between(zero, one) * flank[0];

    // Crests and roots are parts of cylinders, whose nearest point lies in the half plane of the point.
    let far = F::of(f64::from(f32::MAX));
    let to_crest = F::select_less(crest, from_crest, far, (outer - major).abs());
    let to_root = F::select_less(from_crest, root, far, (outer - minor).abs());
    let mut nearest = to_crest.least(to_root);
    let mut turn = zero;
    for _ in 0..THREAD_SEARCHES {
        let (cos, sin) = (turn.cos(), turn.sin());
        let (at_r, at_u) = (outer * cos, height - rise * turn);
        let (place, from) = folded(at_u, pitch);
        let v = from.abs();
        let share = ((at_r - major) * flank[0] + (v - crest) * flank[1]) * inverse;
        let share = share.between(zero, one);
        let on_flank = [major + share * flank[0], crest + share * flank[1]];
        nearest = nearest.least(length3([at_r - on_flank[0], v - on_flank[1], outer * sin]));
        let along = F::select_less(from, zero, place - on_flank[1], place + on_flank[1]);
        turn = rise * (height - along) / (outer * on_flank[0] + rise * rise);
    }
    let inner = (minor - r).most(nearest - (core - r));
    let distance = F::select_less(r, core, inner, nearest);
    F::select_less(outer, limit, -distance, distance) - offset
}
