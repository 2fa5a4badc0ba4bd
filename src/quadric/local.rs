//! A quadric in the frame of its trim sphere, and a ray in that frame.
//!
//! # Theory
//!
//! With `p = c + r q` the trim sphere is the unit ball of `q`. A matrix `A` becomes `T^T A T`, scaled so that its
//! largest entry is 1: as a form `q^T M q + 2 v.q + w`.
//!
//! A ray is given by its point `q` nearest to the centre and its unit direction `u`. The surface outside the ball is
//! trimmed, so only parameters `|s| <= h`, `h^2 = 1 - |q|^2`, are relevant, and the magnitude of every value below is
//! at most about 10:
//!
//! ```text
//!   a s^2 + 2 b s + c = 0,   a = u^T M u,   b = u.(M q + v),   c = q^T M q + 2 v.q + w
//!   k = -(b + sign(b) sqrt(b^2 - a c)),   s = k / a  and  s = c / k
//! ```
//!
//! Neither quotient cancels (Numerical Recipes, 5.6). A quotient is computed only if it is at most `h`, compared as
//! `|k| <= h |a|`, so `a` may have any value down to zero. Then the surface is nearly linear along the ray, the first
//! root is beyond the ball, and the second is `-c / 2b`.
//!
//! Rounding. Each of `a, b, c` has an error of at most `EPS`, 16 machine epsilons, for 9 products of values up to 1. A
//! discriminant within `2 EPS (|b| + |a| + |c|) + EPS^2` of zero is not certainly negative and counts as zero: a
//! tangent ray is a hit, and a doubled plane is visible. A root moves by `EPS (s^2 + 2 |s| + 1) / |2 (a s + b)|`, where
//! the denominator is the slope along the ray: `4 EPS / slope` radii in f64, below 1e-13 where the slope is above 0.05.
//!
//! The trim sphere of a ball is often the ball itself, so rounding must not trim points at random. The sphere is
//! widened by [`Local::slack`]: the largest displacement of the surface by the rounding of the matrix about the world's
//! origin, in a record to float32.

use super::Quadric;
use glam::{DMat3, DMat4, DVec3};

/// Error of a coefficient of the quadratic; see the module.
const EPS: f64 = 16.0 * f64::EPSILON;

/// A quadric in the frame of its trim sphere: the form `q^T M q + 2 v.q + w` with the largest entry 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Local {
    pub center: DVec3,
    /// Radius of the widened trim sphere.
    pub radius: f64,
    pub m: DMat3,
    pub v: DVec3,
    pub w: f64,
}

impl Local {
    /// Relative widening of the trim sphere.
    ///
    /// An entry `c^T M c` is rounded by one epsilon, which moves a surface of radius `r` by about
    /// `epsilon (|c| / r)^2 r / 2`. The epsilon of float32 is used if all entries are float32 values, since they may
    /// come from a record.
    fn slack(quadric: &Quadric) -> f64 {
        let offset = quadric.center.length() / quadric.radius;
        let is_record = quadric.matrix.to_cols_array().iter().all(|&entry| f64::from(entry as f32) == entry);
        let epsilon = if is_record { f64::from(f32::EPSILON) } else { f64::EPSILON };
        (BASE_SLACK + epsilon * offset * offset).min(LARGEST_SLACK)
    }

    pub fn new(quadric: &Quadric) -> Self {
        let (center, radius) = (quadric.center, quadric.radius * (1.0 + Self::slack(quadric)));
        // Dividing by the largest entry first keeps products in range.
        let scale = |a: DMat4| a * (1.0 / largest(&a));
        let a = scale(quadric.matrix);
        let world_from_local =
            DMat4::from_scale_rotation_translation(DVec3::splat(radius), glam::DQuat::IDENTITY, center);
        let form = scale(world_from_local.transpose() * a * world_from_local);
        let v = 0.5 * (form.w_axis.truncate() + form.transpose().w_axis.truncate());
        let m = DMat3::from_mat4(form);
        Self { center, radius, m: 0.5 * (m + m.transpose()), v, w: form.w_axis.w }
    }

    /// The matrix of the form.
    pub fn matrix(&self) -> DMat4 {
        let column = |m: DVec3, v: f64| m.extend(v);
        DMat4::from_cols(
            column(self.m.x_axis, self.v.x),
            column(self.m.y_axis, self.v.y),
            column(self.m.z_axis, self.v.z),
            column(self.v, self.w),
        )
    }

    fn local_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.radius
    }

    /// Unit normal at a point of the surface, turned against `direction`.
    ///
    /// The gradient vanishes on a doubled plane and at the tip of a cone. Its change along the ray replaces it there.
    pub fn normal(&self, p: DVec3, direction: DVec3) -> DVec3 {
        let unit = direction.normalize();
        let gradient = self.m * self.local_from_world(p) + self.v;
        let gradient = if gradient.length() > SINGULAR { gradient } else { self.m * unit };
        let normal = gradient.normalize_or(-unit);
        if normal.dot(unit) > 0.0 { -normal } else { normal }
    }

    /// Lower bound on the distance from a world point to the trimmed surface.
    ///
    /// For `f(q) = q^T M q + 2 v.q + w` and a step `d` with `|d| = s`: `|f(q + d) - f(q)| <= |grad f| s + |M| s^2`. On
    /// the surface `f` is zero, so no point of it is nearer than the root `s` of `|M| s^2 + |grad f| s = |f|`. Outside
    /// the ball, which is convex and contains the surface, the bound is `sqrt(a^2 + s^2)` as for a box (see
    /// `volume::outside`).
    pub fn distance_bound(&self, p: DVec3) -> f64 {
        let q = self.local_from_world(p);
        let length = q.length();
        let (nearest, outside) = if length > 1.0 { (q / length, length - 1.0) } else { (q, 0.0) };
        // Both values are rounded to the safe side; the gradient of `f` is twice the slope.
        let f = (self.value(nearest).abs() - EPS).max(0.0);
        let half_slope = (self.m * nearest + self.v).length() + EPS;
        let root = f / (half_slope + (half_slope * half_slope + self.norm() * f).sqrt());
        self.radius * (outside * outside + root * root).sqrt() * (1.0 - BOUND_SLACK)
    }

    /// Upper bound of the spectral norm of `M`: the Frobenius norm.
    fn norm(&self) -> f64 {
        let columns = [self.m.x_axis, self.m.y_axis, self.m.z_axis];
        columns.iter().map(|column| column.length_squared()).sum::<f64>().sqrt()
    }

    /// The form at a point of the frame.
    pub fn value(&self, q: DVec3) -> f64 {
        q.dot(self.m * q) + 2.0 * self.v.dot(q) + self.w
    }
}

/// Smallest relative widening of a trim sphere: a few float32 roundings of the device.
const BASE_SLACK: f64 = 1e-5;
/// Largest relative widening. A record so far from the origin has no precision left.
const LARGEST_SLACK: f64 = 1e-2;
/// A gradient shorter than this, in the local frame, has no usable direction.
const SINGULAR: f64 = 1e-7;
/// Relative slack for the rounding of the following operations of a lower bound.
const BOUND_SLACK: f64 = 1e-13;

/// Largest magnitude of an entry.
fn largest(a: &DMat4) -> f64 {
    a.to_cols_array().iter().fold(f64::MIN_POSITIVE, |largest, entry| largest.max(entry.abs()))
}

/// A ray that intersects the trim sphere, in its frame.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalRay<'a> {
    local: &'a Local,
    /// The point of the ray nearest to the centre.
    nearest: DVec3,
    unit: DVec3,
    /// Parameter of the ray's origin.
    start: f64,
    /// Length of a unit of the parameter, in multiples of the ray's direction.
    t_per_s: f64,
    /// Half the chord in the ball.
    half_chord: f64,
}

impl<'a> LocalRay<'a> {
    pub(crate) fn new(local: &'a Local, origin: DVec3, direction: DVec3) -> Option<Self> {
        let length = direction.length();
        let unit = direction / length;
        let from_center = local.local_from_world(origin);
        // The nearest point to the centre is computed in two rounds: from a thousand radii away, the first subtraction
        // alone is rounded by too much.
        let about = from_center.dot(unit);
        let almost = from_center - about * unit;
        let rest = almost.dot(unit);
        let (start, nearest) = (about + rest, almost - rest * unit);
        let half_chord_squared = 1.0 - nearest.length_squared();
        (half_chord_squared >= 0.0).then(|| Self {
            local,
            nearest,
            unit,
            start,
            t_per_s: local.radius / length,
            half_chord: half_chord_squared.sqrt(),
        })
    }

    /// The parameters at which the ray crosses the surface inside the trim sphere, in ascending order.
    pub(crate) fn roots(&self) -> [Option<f64>; 2] {
        let Local { m, v, .. } = self.local;
        let slope = *m * self.nearest + *v;
        let a = self.unit.dot(*m * self.unit);
        let b = self.unit.dot(slope);
        let c = self.local.value(self.nearest);
        let discriminant = b * b - a * c;
        let unsure = 2.0 * EPS * (b.abs() + a.abs() + c.abs()) + EPS * EPS;
        if discriminant < -unsure {
            return [None; 2];
        }
        let k = -(b + discriminant.max(0.0).sqrt().copysign(b));
        let quotient = |p: f64, q: f64| (q != 0.0 && p.abs() <= self.half_chord * q.abs()).then(|| p / q);
        match [quotient(k, a), quotient(c, k)] {
            [Some(s), Some(t)] if t < s => [Some(t), Some(s)],
            [None, only] => [only, None],
            roots => roots,
        }
    }

    /// Drops the root at which the ray starts: the one nearest to the origin.
    pub(crate) fn forget_start(&self, roots: &mut [Option<f64>; 2]) {
        let from_start = |root: Option<f64>| root.map_or(f64::INFINITY, |s| (s - self.start).abs());
        let own = usize::from(from_start(roots[1]) < from_start(roots[0]));
        roots[own] = None;
    }

    /// Length from the root at the ray's origin to the next one ahead, in multiples of the direction. Without a next
    /// root the ray leaves through the trim sphere if it `enters` the solid at the origin. Otherwise it is outside, and
    /// the length is 0.
    pub(crate) fn chord(&self, enters: bool) -> f64 {
        let mut roots = self.roots();
        self.forget_start(&mut roots);
        let ahead = roots.into_iter().flatten().find(|&root| root > self.start);
        let end = ahead.or(enters.then_some(self.half_chord));
        end.map_or(0.0, |end| self.t(end).max(0.0))
    }

    /// A root in multiples of the ray's direction.
    pub(crate) fn t(&self, root: f64) -> f64 {
        (root - self.start) * self.t_per_s
    }
}
