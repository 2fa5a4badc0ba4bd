//! The exact test of a ray against one triangle.
//!
//! *Theory.* The triangle is moved into a space that is sheared along the ray (Woop, Benthin and Wald, *Watertight
//! Ray/Triangle Intersection*, JCGT 2(1), 2013). The ray becomes the point (0, 0) of a plane, a triangle is hit where
//! its three edge functions have no two opposite signs, and both faces of an edge evaluate the same function of the
//! same two points. We add exact signs: a difference of two rounded products has the right sign or is zero, and where
//! it is zero the exact predicate of Shewchuk (crate `robust`) decides. The projected surface is therefore continuous
//! with exact answers: no ray passes between faces, and a hit lies on an edge or a vertex if and only if the
//! corresponding functions are zero.
//!
//! The weights of a hit are the edge functions divided by their sum. Where the triangle is a sliver as seen along the
//! ray, the functions are smaller than the rounding of their products, and are computed to two units in the last place
//! then: the hit point lies on a triangle of any width, to the rounding of its corners.

use crate::geometry::triangle_cross;
pub(crate) use crate::gpu::constants::cast_rays::BOX_MARGIN;
use crate::gpu::layout::CastRay;
use glam::DVec3;
use robust::{Coord, orient2d};

/// Largest magnitude of an inverse component of the direction. Its products with local coordinates are finite.
pub(crate) const PARALLEL: f64 = 1e30;

/// Margin of the ends of a ray inside the box for their rounding, relative to the distance of the origin.
pub(crate) const FAR_MARGIN: f64 = 1e-14;

/// Largest distance of a ray's origin from the box for a search on a device, in the scaled direction. The rounding of
/// `t` to float64 is then far below the margins of the search.
const DEVICE_REACH: f64 = 1e6;

/// The intersection of a ray with a face.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FaceHit {
    /// Distance in multiples of the direction.
    pub t: f64,
    pub face: u32,
    /// Weights of the face's corners: not negative, their sum is 1.
    pub weights: [f64; 3],
    /// Bit i is set if the weight of corner i is exactly zero.
    pub zeros: u8,
    /// Whether the ray comes from the counter-clockwise side.
    pub is_front: bool,
    /// Cross product of two edges of the face, local units.
    pub cross: DVec3,
}

/// The part of a line that is searched, `t` from `t_min` to `t_max` in multiples of the direction.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    /// Origin in local units.
    pub origin: DVec3,
    pub direction: DVec3,
    pub t_min: f64,
    pub t_max: f64,
}

/// The part of a ray inside the box of a mesh, prepared for exact tests of triangles.
#[derive(Debug)]
pub(crate) struct ClippedRay {
    t_min: f64,
    t_max: f64,
    /// Where the ray enters the box, and where it leaves the box or ends.
    t_start: f64,
    t_end: f64,
    /// Largest component of the direction. Divided by it, the direction has the component 1 or -1.
    size: f64,
    /// 1 / size.
    unscale: f64,
    pub sheared: Sheared,
}

/// Limits of a ray inside a box, and the scale of its direction.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct Clip {
    pub t_start: f64,
    pub t_end: f64,
    /// See [`ClippedRay`].
    pub size: f64,
    pub unscale: f64,
    /// Inverse of the scaled direction.
    pub inverse: DVec3,
    /// Axis of the largest component of the direction, the first one of equal components.
    pub axis: usize,
}

impl Clip {
    /// None if the ray misses the box, or reaches it at a `t` that float64 cannot hold.
    #[inline(always)]
    pub(crate) fn of(ray: &Ray, min: DVec3, max: DVec3) -> Option<Self> {
        let magnitude = ray.direction.abs().to_array();
        let axis = usize::from(magnitude[1] > magnitude[0]);
        let axis = if magnitude[2] > magnitude[axis] { 2 } else { axis };
        // The only divisions. The ray is scaled by its largest component.
        let reciprocal = ray.direction.recip();
        let (size, unscale) = (magnitude[axis], reciprocal.to_array()[axis].abs());
        if unscale.is_infinite() {
            return None;
        }
        let inverse = reciprocal * size;
        let (enter, leave) = slab(ray.origin, inverse, min, max);
        // The search begins at the box or at the origin also if `t_min` is larger, so that the `t` of a hit does not
        // depend on it.
        let (t_start, t_end) = (larger(enter * unscale, smaller(ray.t_min, 0.0)), smaller(leave * unscale, ray.t_max));
        // A ray that misses has enter > leave.
        if enter > leave || t_start > t_end || t_start.is_infinite() {
            return None;
        }
        Some(Self { t_start, t_end, size, unscale, inverse, axis })
    }
}

impl ClippedRay {
    /// None if the ray misses the box, or reaches it at a `t` that float64 cannot hold.
    #[inline(always)]
    pub(crate) fn new(ray: &Ray, min: DVec3, max: DVec3) -> Option<Self> {
        Clip::of(ray, min, max).map(|clip| Self::from_clip(ray, &clip))
    }

    #[inline(always)]
    pub(crate) fn from_clip(ray: &Ray, clip: &Clip) -> Self {
        let Clip { t_start, t_end, size, unscale, inverse, axis } = *clip;
        let mut direction = (ray.direction * unscale).to_array();
        direction[axis] = 1f64.copysign(direction[axis]);
        let sheared = Sheared::new(ray.origin + t_start * ray.direction, direction, inverse, axis);
        Self { t_min: ray.t_min, t_max: ray.t_max, t_start, t_end, size, unscale, sheared }
    }

    /// The hit of a face with these corners, if it lies within the limits of the ray.
    #[inline(always)]
    pub(crate) fn hit(&self, face: u32, corners: [DVec3; 3]) -> Option<FaceHit> {
        let hit = self.sheared.hit(corners)?;
        let t = self.t_start + hit.t * self.unscale;
        (t >= self.t_min && t <= self.t_max && t < f64::INFINITY).then_some(FaceHit { t, face, ..hit })
    }

    /// Limit of a float32 search for hits up to `t`, in the scaled direction from the start. It has slack for the
    /// rounding of the values that are compared with it.
    #[inline]
    pub(crate) fn search_limit(&self, t: f64) -> f32 {
        let length = (smaller(t, self.t_end) - self.t_start) * self.size;
        length as f32 * 1.000_001 + 2.0 * BOX_MARGIN
    }

    /// The ray for a search on a device; None if float32 does not represent its range of `t`.
    pub(crate) fn for_device(&self) -> Option<CastRay> {
        let start = larger(self.t_start, self.t_min);
        let skipped = (start - self.t_start) * self.size;
        let limit = (f64::from(self.search_limit(f64::INFINITY)) - skipped) as f32;
        let is_near = (start * self.size).abs() <= DEVICE_REACH;
        if !is_near || !limit.is_finite() {
            return None;
        }
        let Sheared { origin, inverse, axes: [x, y, z], shear } = self.sheared;
        let mut direction = DVec3::ZERO;
        direction[x] = shear[0] * shear[2];
        direction[y] = shear[1] * shear[2];
        direction[z] = shear[2];
        Some(CastRay {
            origin: (origin + skipped * direction).as_vec3().to_array(),
            limit,
            direction: direction.as_vec3().to_array(),
            axis: z as u32,
            inverse: inverse.clamp(DVec3::splat(-PARALLEL), DVec3::splat(PARALLEL)).as_vec3().to_array(),
            pad_0: 0,
        })
    }
}

/// The interval of a line inside a slightly enlarged box, in multiples of the scaled direction. The first value exceeds
/// the second if the line misses.
#[inline(always)]
fn slab(origin: DVec3, inverse: DVec3, min: DVec3, max: DVec3) -> (f64, f64) {
    let margin = 2.0 * f64::from(BOX_MARGIN);
    let (low, high) = ((min - margin - origin) * inverse, (max + margin - origin) * inverse);
    // A zero component has an infinite inverse: the ray misses, or that axis bounds nothing. A NaN is the product of
    // such an inverse and a zero, on the margin, and bounds nothing either.
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for axis in 0..3 {
        let backwards = inverse[axis] < 0.0;
        enter = larger(if backwards { high[axis] } else { low[axis] }, enter);
        leave = smaller(if backwards { low[axis] } else { high[axis] }, leave);
    }
    if enter.is_infinite() || leave.is_infinite() {
        return (f64::INFINITY, f64::NEG_INFINITY);
    }
    // For origins far away the ends are rounded by more than the margin.
    let room = FAR_MARGIN * enter.abs().max(leave.abs());
    (enter - room, leave + room)
}

/// The larger of two numbers; the second one if the first is NaN. One instruction, unlike [`f64::max`].
#[inline(always)]
fn larger(a: f64, b: f64) -> f64 {
    if a > b { a } else { b }
}

/// The smaller of two numbers; the second one if the first is NaN.
#[inline(always)]
fn smaller(a: f64, b: f64) -> f64 {
    if a < b { a } else { b }
}

/// A float64 ray in coordinates whose z axis is the ray.
#[derive(Debug)]
pub(crate) struct Sheared {
    pub origin: DVec3,
    /// Inverse of the direction, whose largest component is 1 or -1. A zero has an infinite inverse of its sign.
    pub inverse: DVec3,
    pub axes: [usize; 3],
    pub shear: [f64; 3],
}

impl Sheared {
    /// Axis `z` has the largest component of `direction`, which must be 1 or -1.
    #[inline(always)]
    fn new(origin: DVec3, direction: [f64; 3], inverse: DVec3, z: usize) -> Self {
        let (x, y) = ((z + 1) % 3, (z + 2) % 3);
        let ahead = direction[z];
        // Two axes are exchanged for a negative direction, which keeps the winding.
        let (x, y) = if ahead < 0.0 { (y, x) } else { (x, y) };
        // Products with 1 or -1 are exact, as are quotients.
        Self { origin, inverse, axes: [x, y, z], shear: [direction[x] * ahead, direction[y] * ahead, ahead] }
    }

    /// The hit of a triangle; `t` is in the scaled direction, and the face is not set yet.
    #[inline(always)]
    fn hit(&self, corners: [DVec3; 3]) -> Option<FaceHit> {
        let a = self.corner(corners[0]);
        let b = self.corner(corners[1]);
        let c = self.corner(corners[2]);
        let mut edges = [edge_function(c, b), edge_function(a, c), edge_function(b, a)];
        let (mut positive, mut negative, mut zeros) = (false, false, 0u8);
        for (i, &edge) in edges.iter().enumerate() {
            positive |= edge > 0.0;
            negative |= edge < 0.0;
            zeros |= u8::from(edge == 0.0) << i;
        }
        if positive && negative {
            return None;
        }
        let mut sum = edges[0] + edges[1] + edges[2];
        let magnitude = size_of_products(c, b) + size_of_products(a, c) + size_of_products(b, a);
        if sum.abs() <= CANCELLED * magnitude {
            edges = [accurate_edge_function(c, b), accurate_edge_function(a, c), accurate_edge_function(b, a)];
            sum = edges[0] + edges[1] + edges[2];
            // A triangle parallel to the ray has no inside. Its neighbours are hit at the common edges.
            if sum == 0.0 {
                return None;
            }
        }
        let weights = [edges[0] / sum, edges[1] / sum, edges[2] / sum];
        let t = self.shear[2] * (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]);
        Some(FaceHit { t, face: 0, weights, zeros, is_front: sum > 0.0, cross: triangle_cross(corners) })
    }

    /// A point in the sheared space.
    #[inline(always)]
    fn corner(&self, p: DVec3) -> [f64; 3] {
        let [x, y, z] = self.axes;
        let p = (p - self.origin).to_array();
        [p[x] - self.shear[0] * p[z], p[y] - self.shear[1] * p[z], p[z]]
    }
}

/// Twice the signed area of the triangle (0, 0), p, q; zero only where it is exactly zero.
#[inline(always)]
fn edge_function(p: [f64; 3], q: [f64; 3]) -> f64 {
    let difference = p[0] * q[1] - p[1] * q[0];
    if difference != 0.0 { difference } else { exact_edge_function(p, q) }
}

#[cold]
fn exact_edge_function(p: [f64; 3], q: [f64; 3]) -> f64 {
    let at = |p: [f64; 3]| Coord { x: p[0], y: p[1] };
    orient2d(at(p), at(q), Coord { x: 0.0, y: 0.0 })
}

/// Ratio of the sum of the edge functions to their products below which the functions are computed accurately. Above
/// it, the weights are rounded by at most 1e-12.
const CANCELLED: f64 = 1e-3;

/// Sum of the magnitudes of the products of an edge function.
#[inline(always)]
fn size_of_products(p: [f64; 3], q: [f64; 3]) -> f64 {
    (p[0] * q[1]).abs() + (p[1] * q[0]).abs()
}

/// The edge function to two units in the last place, unless it underflows: Kahan's difference of products, of which
/// Jeannerod, Louvet and Muller prove the bound (*Further analysis of Kahan's algorithm for the accurate computation of
/// 2 x 2 determinants*, 2013).
#[cold]
fn accurate_edge_function(p: [f64; 3], q: [f64; 3]) -> f64 {
    let product = p[1] * q[0];
    let rounding = (-p[1]).mul_add(q[0], product);
    p[0].mul_add(q[1], -product) + rounding
}
