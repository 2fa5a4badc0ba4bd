//! A line clipped to a box.

use glam::{DVec3, Vec3};

/// The interval of `origin + t direction` inside a box, with `t` from `t_min` to `t_max`.
pub(crate) fn clip(
    origin: DVec3,
    direction: DVec3,
    lower: Vec3,
    upper: Vec3,
    t_min: f64,
    t_max: f64,
) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (t_min, t_max);
    for axis in 0..3 {
        let (low, high) = (f64::from(lower[axis]) - origin[axis], f64::from(upper[axis]) - origin[axis]);
        if direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / direction[axis], high / direction[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some((enter, leave))
}
