//! The winding number of oriented points, with a proven bound.
//!
//! *Theory.* `w(q) = sum a n.(p - q) / (4 pi |p - q|^3)` over all points, without a clamp. Let the points of a cluster
//! lie within r of its centre c, let R = |q - c|, t = r / R < 1, and S the sum of their areas. Two terms of the
//! expansion about c are kept, the area vector and the first moment ([`NodeMoments`]). The rest of w is at most
//!
//! ```text
//! E = S t^2 (3 - 2 t) / ((1 - t)^2 R^2) / (4 pi)
//! ```
//!
//! *Proof.* The potential of a point x seen from y is 1/|x - y| = sum over l of |x|^l P_l(cos) / |y|^(l+1), and a
//! dipole is its derivative by x along n. The gradient of |x|^l P_l has length at most l |x|^(l-1): its radial part is
//! l |x|^(l-1) P_l, its tangential one |x|^(l-1) times the derivative of the trigonometric polynomial P_l(cos) of
//! degree l, and both are bounded together by Bernstein's inequality, f'^2 + l^2 f^2 <= l^2 for |f| <= 1. The sum of l
//! t^(l-1) over l > 2 is t^2 (3 - 2 t) / (1 - t)^2.
//!
//! *Rounding.* The terms are evaluated in float32. With u = 2^-24, the vector to the centre has the error 2 u, its
//! squared length 7 u, `1 / |x|^3` 14 u, and the three sums have 6 u, 3 u and 22 u more. Together that is at most
//! S / R^2 (22 + 132 t) u / (4 pi), which is added to E. The centre of a cluster is a float32 position, so it has no
//! rounding.
//!
//! *Use.* A pass takes clusters with t below a limit. If the sum of all bounds is too large, the next pass has a
//! smaller limit: the sum is nearly proportional to the square of the limit, and the number of clusters to its inverse.
//! Where a pass would take longer than the sum over all points in float64, that sum is taken. The same limit for all
//! clusters needs the fewest of them: their number is the integral of 1 / (pi r^2) over the surface, the bound is the
//! integral of 3 r^2 / (4 pi R^4), and with a fixed bound the number is least for r proportional to R.

use super::{Disks, PointCloud};
use crate::bvh::moments::{Cluster, NodeMoments};
use crate::bvh::{Bvh, ChildRef, MAX_STACK, WIDTH};
use crate::error::Error;
use crate::progress::Progress;
use crate::simd::with_vectors;
use glam::{DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;

/// Limit of t in the first pass.
const FIRST_LIMIT: f64 = 0.3;
/// A limit is at most this share of the limit of the pass before.
const MOST_KEPT: f64 = 0.7;
/// The next limit, as a share of the one whose expected error is the largest one allowed.
const LIMIT_MARGIN: f64 = 0.85;
/// A pass takes as long as the sum over this many points for each unit of 1 / limit^2.
const POINTS_OF_PASS: f64 = 50.0;
/// Rounding of the float32 terms, relative to S / R^2: a constant, and a multiple of t. 22 and 132 times 2^-24.
const ROUNDING: [f32; 2] = [1.32e-6, 7.9e-6];
/// Factor of the bound for its own rounding to float32.
const BOUND_ROUNDING: f64 = 1.0 + 1e-5;
/// A winding number nearer to 1/2 than this is a guess if the position is far from all points of the cloud.
const UNDECIDED: f64 = 0.15;
/// A position is far from the cloud beyond this many spacings.
const FAR_SPACINGS: f64 = 2.0;
/// Smallest squared distance, local units, for which 1 / |x|^3 fits in float32.
const LEAST_SQUARED: f32 = 1e-24;

/// The moments of the eight children of a node, and the sums of their areas without the factor pi.
#[derive(Debug, Clone)]
pub(super) struct CloudMoments {
    /// `far_squared` is the squared radius.
    children: NodeMoments,
    total: [f32; WIDTH],
}

/// The moments of all nodes.
pub(super) fn moments(bvh: &Bvh, disks: &[Disks], progress: &Progress) -> Result<Vec<CloudMoments>, Error> {
    let packs = packs_below(bvh);
    let of_node = |node: &crate::bvh::Node| {
        let mut moments = CloudMoments { children: NodeMoments::EMPTY, total: [0.0; WIDTH] };
        for (lane, &child) in node.children.iter().enumerate().filter(|(_, child)| !child.is_none()) {
            let below = if child.is_pack() { child.index()..child.index() + 1 } else { packs[child.index()].clone() };
            let (cluster, radius, total) = cluster_of(&disks[below]);
            moments.children.set(lane, &cluster, radius);
            moments.total[lane] = total;
        }
        progress.check().map(|()| moments)
    };
    bvh.nodes.par_iter().map(of_node).collect()
}

/// The packs below each node. They follow each other in memory, as the nodes do.
fn packs_below(bvh: &Bvh) -> Vec<Range<usize>> {
    let mut packs = vec![0..0; bvh.nodes.len()];
    for (index, node) in bvh.nodes.iter().enumerate().rev() {
        let below = node.children.iter().filter(|child| !child.is_none()).map(|&child| {
            if child.is_pack() { child.index()..child.index() + 1 } else { packs[child.index()].clone() }
        });
        let joined = below.reduce(|a, b| a.start.min(b.start)..a.end.max(b.end));
        packs[index] = joined.unwrap_or(0..0);
    }
    packs
}

/// Moments of the disks of some packs, the radius around their centre, and the sum of their squared radii.
fn cluster_of(packs: &[Disks]) -> (Cluster, f32, f32) {
    let members = || packs.iter().flat_map(|disks| (0..WIDTH).map(move |lane| (disks, lane)));
    let (mut weight, mut sum, mut total) = (0.0, DVec3::ZERO, 0.0);
    for (disks, lane) in members() {
        let square = disks.radius[lane] * disks.radius[lane];
        // With a small weight the centre is defined without areas too.
        let share = square.max(f64::MIN_POSITIVE);
        total += square;
        weight += share;
        sum += disks.center(lane) * share;
    }
    let center = (sum / weight).as_vec3().as_dvec3();
    let mut cluster = Cluster { weight, center, area: DVec3::ZERO, first: DMat3::ZERO };
    let mut reach = 0.0f64;
    for (disks, lane) in members() {
        let area = disks.normal(lane) * (disks.radius[lane] * disks.radius[lane]);
        let member = Cluster { center: disks.center(lane), area, ..Cluster::default() }.about(center);
        cluster.area += area;
        cluster.first += member.first;
        reach = reach.max(disks.center(lane).distance_squared(center));
    }
    // Rounded up.
    let up = |x: f64| (x * (1.0 + 1e-6)) as f32;
    (cluster, up(reach.sqrt()), up(total))
}

impl Disks {
    /// The sum `r^2 n.(p - q) / |p - q|^3` over the disks, by lanes. A disk at q itself adds nothing.
    #[inline(always)]
    fn add_angles(&self, q: DVec3, sums: &mut [f64; WIDTH]) {
        let [qx, qy, qz] = q.to_array();
        let ([cx, cy, cz], [nx, ny, nz], radius) = (&self.center, &self.normal, &self.radius);
        for i in 0..WIDTH {
            let (x, y, z) = (cx[i] - qx, cy[i] - qy, cz[i] - qz);
            let along = nx[i] * x + ny[i] * y + nz[i] * z;
            let squared = x * x + y * y + z * z;
            let angle = radius[i] * radius[i] * along / (squared * squared.sqrt());
            sums[i] += if squared > 0.0 { angle } else { 0.0 };
        }
    }
}

impl PointCloud {
    /// The winding number at a local point. `most(w)` is the largest error that a value may have.
    pub fn winding(&self, p: DVec3, most: impl Fn(f64) -> f64) -> f64 {
        let mut limit = FIRST_LIMIT;
        while POINTS_OF_PASS < limit * limit * (WIDTH * self.disks.len()) as f64 {
            let (w, error) = self.pass(p, limit as f32);
            let allowed = most(w);
            if error <= allowed {
                return w;
            }
            limit *= (LIMIT_MARGIN * (allowed / error).sqrt()).min(MOST_KEPT);
        }
        self.exact_winding(p)
    }

    /// Whether a local point is inside: its winding number, turned outwards, exceeds 1/2.
    pub fn is_inside(&self, p: DVec3) -> bool {
        self.excess(p, f64::abs) > 0.0
    }

    /// Whether a local point at a distance from the disks, world units, is inside, and whether that is a guess across a
    /// hole: its winding number is near 1/2, far from all points.
    pub fn side(&self, p: DVec3, distance: f64) -> (bool, bool) {
        if distance <= FAR_SPACINGS * self.spacing {
            return (self.is_inside(p), false);
        }
        // Both the sign of the excess and its comparison with the limit must be certain.
        let excess = self.excess(p, |excess| excess.abs().min((excess.abs() - UNDECIDED).abs()));
        (excess > 0.0, excess.abs() < UNDECIDED)
    }

    /// How far the winding number, turned outwards, exceeds 1/2. Its error is below `most(excess)`.
    fn excess(&self, p: DVec3, most: impl Fn(f64) -> f64) -> f64 {
        let turned = if self.inside_out { -1.0 } else { 1.0 };
        turned * self.winding(p, |w| most(turned * w - 0.5).next_down()) - 0.5
    }

    /// The winding number in float64, over all points.
    fn exact_winding(&self, p: DVec3) -> f64 {
        with_vectors!((cloud: &PointCloud = self, p: DVec3 = p) -> f64 { cloud.exact_portable(p) })
    }

    #[inline(always)]
    fn exact_portable(&self, p: DVec3) -> f64 {
        let mut sums = [0.0; WIDTH];
        self.disks.iter().for_each(|disks| disks.add_angles(p, &mut sums));
        // Areas are pi r^2.
        sums.iter().sum::<f64>() / 4.0
    }

    /// The winding number by the clusters with t below `limit`, and the bound of its error.
    fn pass(&self, p: DVec3, limit: f32) -> (f64, f64) {
        with_vectors!((cloud: &PointCloud = self, p: DVec3 = p, limit: f32 = limit) -> (f64, f64) {
            cloud.pass_portable(p, limit)
        })
    }

    #[inline(always)]
    fn pass_portable(&self, p: DVec3, limit: f32) -> (f64, f64) {
        let single = p.as_vec3();
        let rest: Vec3 = (p - single.as_dvec3()).as_vec3();
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Bvh::ROOT;
        let mut top = 1;
        let (mut angle, mut error) = (0.0f64, 0.0f64);
        let mut near = [0.0; WIDTH];
        while top > 0 {
            top -= 1;
            let child = stack[top];
            if child.is_pack() {
                self.disks[child.index()].add_angles(p, &mut near);
                continue;
            }
            let node = &self.bvh.nodes[child.index()];
            let moments = &self.moments[child.index()];
            let (angles, squares) = moments.children.angles(single, rest);
            let mut errors = [0.0f32; WIDTH];
            let mut far = [false; WIDTH];
            for i in 0..WIDTH {
                let inverse = 1.0 / squares[i];
                let square = moments.children.far_squared[i] * inverse;
                let t = square.sqrt();
                let gap = 1.0 - t;
                let rest = square * (3.0 - (t + t)) / (gap * gap);
                errors[i] = moments.total[i] * inverse * (rest + ROUNDING[0] + ROUNDING[1] * t);
                far[i] = (t < limit) & (squares[i] > LEAST_SQUARED);
            }
            for lane in 0..WIDTH {
                if node.children[lane].is_none() {
                    continue;
                }
                if far[lane] {
                    angle += f64::from(angles[lane]);
                    error += f64::from(errors[lane]);
                } else {
                    stack[top] = node.children[lane];
                    top += 1;
                }
            }
        }
        ((angle + near.iter().sum::<f64>()) / 4.0, error * BOUND_ROUNDING / 4.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cloud::PointCloud;
    use crate::mesh::random::uniform;

    /// Random disks, in clusters of very different sizes: the bound holds for every limit, far and near.
    #[test]
    fn the_sum_differs_from_the_exact_one_by_less_than_the_bound() {
        let mut next = uniform(11);
        let mut random = |size: f64| DVec3::from_array([0; 3].map(|_| (next() - 0.5) * size));
        let mut points = Vec::new();
        let mut normals = Vec::new();
        let mut areas = Vec::new();
        for i in 0..3000 {
            let size = [1.0, 1e-2, 1e-5][i % 3];
            points.push((random(size) + DVec3::splat(0.3 * (i % 3) as f64)).to_array());
            normals.push(random(1.0).normalize_or(DVec3::X).to_array());
            areas.push(1e-3 * size * size * (1.0 + (i % 7) as f64));
        }
        let cloud = PointCloud::new(&points, Some(&normals), Some(&areas), &Progress::new()).unwrap();
        let mut largest = 0.0f64;
        for i in 0..600 {
            let size = [4.0, 1.0, 1e-2, 1e-5][i % 4];
            let p = cloud.local_from_world((random(size) + DVec3::splat(0.3 * (i % 3) as f64)).to_array());
            let exact = cloud.exact_winding(p);
            for limit in [0.7, 0.3, 0.18, 0.1, 0.03] {
                let (w, error) = cloud.pass(p, limit);
                assert!((w - exact).abs() <= error + 1e-12 * exact.abs().max(1.0), "{p} {limit}: {w} {exact} {error}");
                largest = largest.max((w - exact).abs() / error.max(1e-9));
            }
        }
        // The bound is not vacuous.
        assert!(largest > 1e-3, "{largest}");
    }
}
