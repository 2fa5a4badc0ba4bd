//! Solid angles of many triangles at once in float32 lanes, with a test that detects insufficient accuracy.

use super::closing::Cap;
use crate::bvh::WIDTH;
use crate::bvh::pack::Pack;
use crate::simd::with_vectors;
use glam::Vec3;

/// Eight triangles whose first edge is on the rim of an opening or is a chord. Empty lanes have three equal corners far
/// away, so their angle is zero.
#[derive(Debug)]
pub(super) struct CapPack {
    corners: [[[f32; WIDTH]; 3]; 3],
    /// 1 for the triangles with an edge on the rim, 0 for those with a chord.
    on_rim: [f32; WIDTH],
    /// The same triangles in the form for the closest-point search.
    distances: Pack,
}

/// Rounding error of the numerator and of the denominator of a solid angle, as a fraction of the product of the
/// lengths: about 30 roundings of 6e-8.
const PRODUCT_ERROR: f32 = 2e-6;
/// Largest error of [`arctangent`], radians.
const ARCTANGENT_ERROR: f32 = 5e-6;
/// A numerator below this fraction of the product of lengths has no certain sign in float32. The vectors from the point
/// to the corners are rounded by a fraction of 6e-8 of their lengths, and three of them are multiplied. The rounding of
/// the point itself is not included: near a small triangle it is larger than this fraction of the lengths.
const FLAT: f32 = 1e-5;
/// Corners of an empty lane.
const FAR: f32 = 1e3;

impl CapPack {
    /// `caps` must hold one to eight triangles.
    pub(super) fn new(caps: &[Cap]) -> Self {
        let mut corners = [[[FAR; WIDTH]; 3]; 3];
        let mut on_rim = [0.0; WIDTH];
        for (lane, cap) in caps.iter().enumerate() {
            for corner in 0..3 {
                for axis in 0..3 {
                    corners[corner][axis][lane] = cap.corners[corner][axis] as f32;
                }
            }
            on_rim[lane] = if cap.is_on_rim { 1.0 } else { 0.0 };
        }
        let positions: Vec<Vec3> = caps.iter().flat_map(|cap| cap.corners).map(|p| p.as_vec3()).collect();
        let faces: Vec<[u32; 3]> = (0..caps.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let members: Vec<u32> = (0..caps.len() as u32).collect();
        Self { corners, on_rim, distances: Pack::new(&positions, &faces, &members) }
    }

    /// A corner of the triangle of one lane, relative to `p`.
    #[inline(always)]
    fn corner(&self, corner: usize, lane: usize, p: Vec3) -> [f32; 3] {
        let [x, y, z] = &self.corners[corner];
        [x[lane] - p.x, y[lane] - p.y, z[lane] - p.z]
    }

    /// Sum of the solid angles as seen from `p`, steradians, and its largest error by the rounding of float32. None if
    /// `p` is so close to a triangle that float32 cannot determine the side. The caller accounts for the rounding of
    /// `p` and of the corners themselves.
    ///
    /// Uses the formula of [`crate::geometry::solid_angle`].
    pub(super) fn angles(&self, p: Vec3) -> Option<(f32, f32)> {
        with_vectors!((pack: &CapPack = self, p: Vec3 = p) -> Option<(f32, f32)> { pack.angles_by_lanes(p) })
    }

    #[inline(always)]
    fn angles_by_lanes(&self, p: Vec3) -> Option<(f32, f32)> {
        let mut sum = [0.0f32; WIDTH];
        let mut error = [0.0f32; WIDTH];
        let mut doubtful = [0.0f32; WIDTH];
        for i in 0..WIDTH {
            let (a, b, c) = (self.corner(0, i, p), self.corner(1, i, p), self.corner(2, i, p));
            let dot = |u: [f32; 3], v: [f32; 3]| u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
            let cross = [b[1] * c[2] - b[2] * c[1], b[2] * c[0] - b[0] * c[2], b[0] * c[1] - b[1] * c[0]];
            let numerator = dot(a, cross);
            let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
            let lengths = la * lb * lc;
            let denominator = lengths + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
            sum[i] = 2.0 * arctangent(numerator, denominator);
            let (n, d) = (numerator.abs(), denominator.abs());
            let largest = if n > d { n } else { d };
            error[i] = 2.0 * (PRODUCT_ERROR * lengths / largest + ARCTANGENT_ERROR);
            // The angle jumps only if the point lies in the plane of the triangle, inside its edges.
            let flat = numerator.abs() - FLAT * lengths;
            let behind = denominator - FLAT * lengths;
            doubtful[i] = if flat > behind { flat } else { behind };
        }
        let worst = doubtful.iter().fold(f32::INFINITY, |worst, &x| if x < worst { x } else { worst });
        (worst > 0.0).then(|| (sum.iter().sum(), error.iter().sum()))
    }

    /// Squared distance of `p` to the nearest triangle, and the sum over the rim edges of length / (distance -
    /// radius)^2.
    pub(super) fn reach(&self, p: Vec3, radius: f32) -> (f32, f32) {
        with_vectors!((pack: &CapPack = self, p: Vec3 = p, radius: f32 = radius) -> (f32, f32) {
            pack.reach_by_lanes(p, radius)
        })
    }

    #[inline(always)]
    fn reach_by_lanes(&self, p: Vec3, radius: f32) -> (f32, f32) {
        let nearest = self.distances.distances_squared(p).iter().fold(f32::INFINITY, |least, &x| least.min(x));
        let mut change = [0.0f32; WIDTH];
        for i in 0..WIDTH {
            let (a, b) = (self.corner(0, i, p), self.corner(1, i, p));
            let along = [b[0] - a[0], b[1] - a[1], b[2] - a[2]];
            let squared = along[0] * along[0] + along[1] * along[1] + along[2] * along[2];
            let t = -(a[0] * along[0] + a[1] * along[1] + a[2] * along[2]) / (squared + f32::MIN_POSITIVE);
            let t = t.clamp(0.0, 1.0);
            let q = [a[0] + t * along[0], a[1] + t * along[1], a[2] + t * along[2]];
            let reach = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2]).sqrt() - radius;
            change[i] = self.on_rim[i] * squared.sqrt() / (reach * reach);
        }
        (nearest, change.iter().sum())
    }
}

/// atan2 to 2e-6, without a branch: a minimax polynomial for the arc tangent on 0 to 1 (Hastings, *Approximations for
/// digital computers*, 1955, sheet 13), reflected into the other octants.
#[inline(always)]
fn arctangent(y: f32, x: f32) -> f32 {
    let (ax, ay) = (x.abs(), y.abs());
    let (low, high) = if ax < ay { (ax, ay) } else { (ay, ax) };
    let t = low / (high + f32::MIN_POSITIVE);
    let s = t * t;
    let polynomial = -0.013_480_47 * s + 0.057_477_314;
    let polynomial = polynomial * s - 0.121_239_07;
    let polynomial = polynomial * s + 0.195_635_93;
    let polynomial = polynomial * s - 0.332_994_6;
    let polynomial = polynomial * s + 0.999_995_6;
    let octant = polynomial * t;
    let quadrant = if ax < ay { std::f32::consts::FRAC_PI_2 - octant } else { octant };
    let half = if x < 0.0 { std::f32::consts::PI - quadrant } else { quadrant };
    if y < 0.0 { -half } else { half }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::solid_angle;
    use glam::DVec3;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = DVec3> {
        (-0.5..0.5f32, -0.5..0.5f32, -0.5..0.5f32).prop_map(|(x, y, z)| Vec3::new(x, y, z).as_dvec3())
    }

    fn pack(caps: &[[DVec3; 3]]) -> CapPack {
        let caps: Vec<Cap> =
            caps.iter().map(|&corners| Cap { corners, is_on_rim: true, walk: 0, center: DVec3::ZERO }).collect();
        CapPack::new(&caps)
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(3000))]
        #[test]
        fn lanes_match_float64(p in vector(), caps in proptest::collection::vec([vector(), vector(), vector()], 1..8)) {
            if let Some((found, error)) = pack(&caps).angles(p.as_vec3()) {
                let exact: f64 = caps.iter().map(|cap| solid_angle(cap.map(|corner| corner - p))).sum();
                prop_assert!((f64::from(found) - exact).abs() <= f64::from(error), "{found} {exact} {error}");
            }
        }

        #[test]
        fn lanes_match_float64_beside_edges(
            [a, b, c] in [vector(), vector(), vector()],
            t in 0.0..1.0f64,
            offset in vector(),
            exponent in 0.0..6.0f64,
        ) {
            let p = (a.lerp(b, t) + offset * 0.1f64.powf(exponent)).as_vec3();
            if let Some((found, error)) = pack(&[[a, b, c]]).angles(p) {
                let exact = solid_angle([a, b, c].map(|corner| corner - p.as_dvec3()));
                prop_assert!((f64::from(found) - exact).abs() <= f64::from(error), "{found} {exact} {error}");
            }
        }

        #[test]
        fn the_arc_tangent_is_good_to_a_few_millionths(y in -1.0..1.0f32, x in -1.0..1.0f32) {
            prop_assert!((arctangent(y, x) - y.atan2(x)).abs() <= ARCTANGENT_ERROR);
        }
    }

    #[test]
    fn a_point_on_a_face_is_left_to_exact_arithmetic() {
        let cap = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(pack(&[cap]).angles(Vec3::new(0.25, 0.25, 0.0)), None);
        assert!(pack(&[cap]).angles(Vec3::new(1.25, 0.25, 0.0)).is_some());
    }
}
