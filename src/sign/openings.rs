//! Exact generalised winding numbers of a mesh with few or long openings, by closing them.
//!
//! *Theory.* Close every opening with cones of triangles (see `closing`). The closed surface has an integer winding
//! number W, counted by rays (see `crossing`). The solid angle is additive: w(mesh) = W - f, where f is the winding
//! number of the cones alone. Inside means |w| > 1/2 (either direction of the faces counts as a surface), and
//! for an integer W this is equivalent to **W != round(f)**.
//!
//! f is summed over a tree of the caps, the triangles of all cones. A part of the tree with the area A, the area vector
//! N and the first moment C, in a ball of the radius R around the centroid c, contributes N.x / |x|^3 +
//! (tr C - 3 x.C x / |x|^2) / |x|^3 with x = c - p: the Taylor polynomial of the field r / |r|^3 at c. The second
//! derivative of this field, which is the third one of 1 / |r|, is at most 6 / |r|^4, so the error is at most
//! 3 A R^2 / (|x| - R)^4. Parts whose error is too large for their share of the total are divided; leaves are summed
//! triangle by triangle. If the error leaves the nearest integer open, a finer sum follows, and a sum over all caps in
//! float64 at last.
//!
//! f jumps only at the caps. Elsewhere its gradient is the gradient of the rim alone, by the Biot-Savart law: |grad f|
//! <= sum over rim edges of length / (4 pi distance^2). A part of the tree with all caps of its rims also changes by at
//! most 2 A / (4 pi distance^3). One value therefore decides a whole ball of samples ([`Openings::rounded_ball`]), and
//! only samples near an opening have a cost. [`super::winding`] handles meshes that consist of openings.

use super::caps::CapPack;
use super::closing::{self, Cap};
use super::crossing::{Axes, ClosedSurface, crossing};
use crate::bvh::WIDTH;
use crate::error::Error;
use crate::geometry::{SolidAngles, triangle_cross};
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::{DMat3, DVec3};
use robust::{Coord3D, orient3d};
use std::f64::consts::PI;

/// The caps over the rims of all openings, local units. Empty for a closed mesh.
#[derive(Debug, Default)]
pub struct Openings {
    /// Triangles in the order of the leaves of the tree.
    pub caps: Vec<[DVec3; 3]>,
    packs: Vec<CapPack>,
    /// Nodes in preorder: the children of a node follow it.
    nodes: Vec<CapNode>,
}

/// A node of the tree: caps that lie close together.
#[derive(Debug)]
struct CapNode {
    /// Ball that contains the caps. Its centre is the centroid of their areas.
    center: DVec3,
    radius: f64,
    /// Sum of the area vectors, and of the areas.
    vector: DVec3,
    area: f64,
    /// First moment: the sum of the outer products of offset from the centre and area vector.
    moment: DMat3,
    /// Length of the rim edges of the caps.
    rim: f64,
    /// Index of the first node that follows the descendants of this one.
    next: usize,
    /// Whether the node has all caps of each of its walks.
    is_whole: bool,
    /// First cap, and number of caps.
    first: usize,
    count: usize,
    /// Pack of a leaf.
    pack: usize,
    is_leaf: bool,
}

/// A box of samples, and the position of each sample.
pub struct SampleBlock<'a> {
    pub low: [usize; 3],
    pub high: [usize; 3],
    pub at: &'a dyn Fn([usize; 3]) -> DVec3,
}

/// The solid angle of all caps at a point.
struct CapAngle {
    /// Sum and its largest error, steradians.
    sum: f64,
    error: f64,
    /// No cap is nearer than this, local units.
    clear: f64,
    /// Bound of the gradient of the sum within the radius of the evaluation.
    slope: f64,
}

/// Largest error of the first sum over the tree, steradians: a tenth of a turn. The nearest integer changes after half
/// a turn.
const COARSE: f64 = 0.1 * 4.0 * PI;
/// Largest error of the finer sum, steradians, where the first one leaves the nearest integer open.
const FINE: f64 = 1e-3 * 4.0 * PI;

/// Largest number of rim edges of any openings, such as scattered holes. Samples near an opening cost a sum over the
/// tree of its caps.
const FEW_EDGES: usize = 2048;
/// Mean number of edges of the openings from which more edges are closed. Only the samples near the rim have a cost
/// then.
const LONG_RIM: usize = 64;
/// Largest number of rim edges of long openings. An edge takes 480 bytes while the caps are divided: 0.5 GB at the
/// limit. Each plane of samples is compared with each cap.
const MOST_EDGES: usize = 1 << 20;

/// A sample counts as undecided if its winding number is closer to 1/2 than this.
const UNDECIDED: f64 = 0.05;

/// Relative and absolute margin for float32 in a distance: a hundred times its rounding.
const ROUNDING: f64 = 1e-5;
/// Squared distance up to which the caps of a leaf are summed in float64: a distance of 3e-4.
const CLOSE_SQUARED: f32 = 1e-7;
/// Rounding to float32 moves a point and the corners of the caps by up to 3e-8 along each axis. By the law of Biot and
/// Savart it changes the angle of a leaf at the distance d by at most about this length / d.
const MOVED: f64 = 2e-7;

impl Openings {
    pub fn of(mesh: &Mesh) -> Self {
        let mut parts = closing::caps(mesh);
        let mut openings = Self::default();
        if !parts.is_empty() {
            openings.divide(0, true, &mut parts);
        }
        openings.caps = parts.iter().map(|cap| cap.corners).collect();
        openings
    }

    /// Whether the openings of a mesh are closed by caps: there are few of them, or they are long.
    pub fn suit(mesh: &Mesh) -> bool {
        let (rim, faces) = (&mesh.topology().rim, mesh.faces().len());
        if rim.len() <= FEW_EDGES && rim.len() * 8 <= faces.max(64) {
            return true;
        }
        rim.len() <= MOST_EDGES.min(2 * faces) && closing::rims(rim).len() * LONG_RIM <= rim.len()
    }

    /// Adds the node of a range of caps, of which the first has the index `first`, and its descendants. Sorts the
    /// range. Walks are kept together as long as a node has several.
    fn divide(&mut self, first: usize, is_whole: bool, caps: &mut [Cap]) {
        let index = self.nodes.len();
        let is_leaf = caps.len() <= WIDTH;
        let pack = self.packs.len();
        self.nodes.push(CapNode { is_leaf, is_whole, pack, ..CapNode::new(first, caps) });
        if is_leaf {
            self.packs.push(CapPack::new(caps));
        } else {
            let has_one_walk = caps.iter().all(|cap| cap.walk == caps[0].walk);
            let centroid = |cap: &Cap| (cap.corners[0] + cap.corners[1] + cap.corners[2]) / 3.0;
            let center = |cap: &Cap| if has_one_walk { centroid(cap) } else { cap.center };
            let (low, high) = caps
                .iter()
                .map(center)
                .fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
            let axis = (high - low).max_position();
            caps.sort_by(|a, b| center(a)[axis].total_cmp(&center(b)[axis]).then(a.walk.cmp(&b.walk)));
            let half = caps.len() / 2;
            let middle = if has_one_walk {
                half.next_multiple_of(WIDTH)
            } else {
                // The end of the walk in the middle, or its start if it is the last one.
                let walk = caps[half].walk;
                let end = caps.iter().rposition(|cap| cap.walk == walk).map_or(half, |last| last + 1);
                let start = caps.iter().position(|cap| cap.walk == walk).unwrap_or(half);
                if end < caps.len() { end } else { start }
            };
            let (left, right) = caps.split_at_mut(middle);
            self.divide(first, is_whole && !has_one_walk, left);
            self.divide(first + left.len(), is_whole && !has_one_walk, right);
        }
        self.nodes[index].next = self.nodes.len();
    }

    /// Winding number of the caps alone, with the rounding of float64.
    pub fn fraction(&self, p: DVec3) -> f64 {
        turns_at(p, &self.caps)
    }

    /// Winding number of a mesh whose openings are closed by the caps.
    pub fn winding(&self, mesh: &Mesh, p: DVec3) -> i32 {
        let axes = Axes::X;
        let mut winding = ClosedSurface::new(mesh, &[]).winding(p, axes);
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            let to = node.center - p;
            let beside = to[axes.column].abs().max(to[axes.row].abs());
            if beside > node.radius || to[axes.ray] < -node.radius {
                i = node.next;
                continue;
            }
            if node.is_leaf {
                winding += self.caps_of(node).iter().map(|&cap| crossing(p, cap, axes)).sum::<i32>();
            }
            i += 1;
        }
        winding
    }

    /// [`Openings::winding`] by one ray to the nearest side of the box of the mesh. None if the ray comes close to a
    /// cap, or passes through an edge or a vertex. Reads the tables of rays.
    pub fn winding_by_ray(&self, mesh: &Mesh, p: DVec3) -> Option<i32> {
        let bounds = mesh.bvh().bounds;
        let to_sides = [(p - bounds.min.as_dvec3(), -1.0), (bounds.max.as_dvec3() - p, 1.0)];
        let (mut axis, mut towards, mut shortest) = (0, 1.0, f64::INFINITY);
        for i in 0..3 {
            for (to_side, sign) in to_sides {
                if to_side[i] < shortest {
                    (axis, towards, shortest) = (i, sign, to_side[i]);
                }
            }
        }
        if self.come_close(p, axis, towards) {
            return None;
        }
        let mut direction = DVec3::ZERO;
        direction[axis] = towards;
        mesh.winding_by_ray(p, direction)
    }

    /// Whether a ray along an axis, in its positive or negative direction, meets the ball of a leaf of the caps.
    fn come_close(&self, p: DVec3, axis: usize, towards: f64) -> bool {
        let (column, row) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            let to = node.center - p;
            if to[column].abs().max(to[row].abs()) > node.radius || to[axis] * towards < -node.radius {
                i = node.next;
            } else if node.is_leaf {
                return true;
            } else {
                i += 1;
            }
        }
        false
    }

    /// The integer nearest to the fraction at a point, and the radius of a ball in which it is the same and that
    /// contains no cap. The radius is 0 where the fraction is close to the middle between two integers.
    pub fn rounded_ball(&self, p: DVec3) -> (i32, f64) {
        if self.caps.is_empty() {
            return (0, f64::INFINITY);
        }
        let angle = self.sum(p, Some(0.0), COARSE, false);
        let Some((rounded, margin)) = angle.rounded().filter(|&(_, margin)| margin > UNDECIDED) else {
            return (self.round(p).0, 0.0);
        };
        // No summand of the slope is larger than C / (D - r)^3 at the distance r, if it is C / D^3 here and D is at
        // least `clear`. For a fraction x of `clear` the change is then at most x clear slope / (1 - x)^3, and
        // x / (1 - x)^3 <= q holds for x = q / (1 + 3 q).
        let clear = angle.clear.max(0.0);
        let q = margin * 4.0 * PI / (clear * angle.slope * (1.0 + ROUNDING));
        let share = if q.is_finite() { q / (1.0 + 3.0 * q) } else { 1.0 / 3.0 };
        (rounded, clear * share)
    }

    /// Whether no cap comes within `radius` of a point and the fraction has one nearest integer there. The result may
    /// also be false where both hold but one evaluation does not prove it.
    pub fn is_uniform_within(&self, p: DVec3, radius: f64) -> bool {
        self.caps.is_empty() || self.rounded_within(p, radius).is_some()
    }

    /// The nearest integer of the fraction at a point, and whether it is certain.
    fn round(&self, p: DVec3) -> (i32, bool) {
        if let Some((rounded, margin)) = self.sum(p, None, COARSE, false).rounded()
            && margin > UNDECIDED
        {
            return (rounded, true);
        }
        for exact in [false, true] {
            let angle = self.sum(p, None, FINE, exact);
            if let Some((rounded, margin)) = angle.rounded()
                && (exact || margin >= UNDECIDED || margin + angle.error / (2.0 * PI) < UNDECIDED)
            {
                return (rounded, margin >= UNDECIDED);
            }
        }
        let fraction = self.fraction(p);
        (fraction.round() as i32, (fraction - fraction.round()).abs() <= 0.5 - UNDECIDED)
    }

    /// Computes the nearest integer of the fraction at each sample of a block and passes it to `set`. Returns the
    /// number of samples that were close to undecided. Fails once the job of `progress` is cancelled.
    pub fn for_each_rounded_fraction(
        &self,
        block: &SampleBlock<'_>,
        progress: &Progress,
        set: &mut impl FnMut([usize; 3], i32),
    ) -> Result<usize, Error> {
        progress.check()?;
        let &SampleBlock { low, high, at } = block;
        let (first, last) = (at(low), at(high.map(|i| i - 1)));
        let center = (first + last) * 0.5;
        let radius = first.distance(last) * 0.5 * (1.0 + 1e-9);
        if (0..3).all(|axis| high[axis] - low[axis] == 1) {
            let (rounded, decided) = self.round(center);
            set(low, rounded);
            return Ok(usize::from(!decided));
        }
        if let Some(rounded) = self.rounded_within(center, radius) {
            for z in low[2]..high[2] {
                for y in low[1]..high[1] {
                    for x in low[0]..high[0] {
                        set([x, y, z], rounded);
                    }
                }
            }
            return Ok(0);
        }
        // Halves the longest side.
        let axis = (0..3).max_by_key(|&axis| high[axis] - low[axis]).unwrap_or(0);
        let (mut left_high, mut right_low) = (high, low);
        left_high[axis] = low[axis].midpoint(high[axis]);
        right_low[axis] = left_high[axis];
        let left = SampleBlock { low, high: left_high, at };
        let right = SampleBlock { low: right_low, high, at };
        let undecided = self.for_each_rounded_fraction(&left, progress, set)?;
        Ok(undecided + self.for_each_rounded_fraction(&right, progress, set)?)
    }

    /// The integer nearest to the fraction everywhere within `radius` of `center`; None if a single value is not
    /// sufficient.
    fn rounded_within(&self, center: DVec3, radius: f64) -> Option<i32> {
        let angle = self.sum(center, Some(radius), COARSE, false);
        let is_clear = angle.clear > radius * (1.0 + ROUNDING) + ROUNDING;
        let (rounded, margin) = angle.rounded().filter(|_| is_clear)?;
        (margin * 4.0 * PI > radius * angle.slope * (1.0 + ROUNDING)).then_some(rounded)
    }

    /// The solid angle of all caps at a point, with an error of at most `error` steradians and the rounding of the
    /// leaves. The slope holds within `radius`; the sum ends at the first cap within that radius. Without a radius,
    /// there is no slope. With `exact` all leaves are summed in float64, otherwise only those close to the point.
    fn sum(&self, p: DVec3, radius: Option<f64>, error: f64, exact: bool) -> CapAngle {
        let (has_slope, radius) = (radius.is_some(), radius.unwrap_or(0.0));
        let mut found = CapAngle { sum: 0.0, error: 0.0, clear: f64::INFINITY, slope: 0.0 };
        let share = error / self.nodes.first().map_or(1.0, |root| root.area.max(f64::MIN_POSITIVE));
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            let to = node.center - p;
            let distance = to.length();
            let reach = distance - node.radius;
            let (fourth, square) = (reach.powi(4), node.radius * node.radius);
            if reach > radius && 3.0 * square <= share * fourth {
                let gap = reach - radius;
                let trace = node.moment.x_axis.x + node.moment.y_axis.y + node.moment.z_axis.z;
                let along = to.dot(node.moment * to) / (distance * distance);
                found.sum += (node.vector.dot(to) + trace - 3.0 * along) / (distance * distance * distance);
                found.error += 3.0 * node.area * square / fourth;
                found.clear = found.clear.min(reach);
                let by_rim = node.rim / (gap * gap);
                found.slope += if node.is_whole { by_rim.min(2.0 * node.area / (gap * gap * gap)) } else { by_rim };
                i = node.next;
                continue;
            }
            if node.is_leaf {
                let pack = &self.packs[node.pack];
                // Without a slope, the ball of the caps suffices for their distance.
                let (nearest, slope) = if has_slope || reach < 2.0 * f64::from(CLOSE_SQUARED).sqrt() {
                    pack.reach(p.as_vec3(), radius as f32)
                } else {
                    ((reach * reach) as f32, 0.0)
                };
                found.clear = found.clear.min(f64::from(nearest.sqrt()) * (1.0 - ROUNDING) - ROUNDING);
                found.slope += f64::from(slope);
                if radius > 0.0 && found.clear <= radius {
                    return found;
                }
                let is_single = !exact && nearest > CLOSE_SQUARED;
                match is_single.then(|| pack.angles(p.as_vec3())).flatten() {
                    Some((sum, error)) => {
                        found.sum += f64::from(sum);
                        found.error += f64::from(error) + MOVED / f64::from(nearest.sqrt());
                    }
                    None => found.sum += turns_at(p, self.caps_of(node)) * (4.0 * PI),
                }
            }
            i += 1;
        }
        found
    }

    fn caps_of(&self, leaf: &CapNode) -> &[[DVec3; 3]] {
        &self.caps[leaf.first..leaf.first + leaf.count]
    }
}

impl CapAngle {
    /// The nearest number of whole turns, and the distance of the fraction from the middle between two numbers less its
    /// error. None if the error leaves the number open.
    fn rounded(&self) -> Option<(i32, f64)> {
        let fraction = self.sum / (4.0 * PI);
        let rounded = fraction.round();
        let margin = 0.5 - (fraction - rounded).abs() - self.error / (4.0 * PI) - EXACT_ERROR;
        (margin > 0.0).then_some((rounded as i32, margin))
    }
}

/// Rounding error of a sum of float64 angles, turns.
const EXACT_ERROR: f64 = 1e-9;

impl CapNode {
    fn new(first: usize, caps: &[Cap]) -> Self {
        let (mut vector, mut area, mut rim, mut moment) = (DVec3::ZERO, 0.0, 0.0, DVec3::ZERO);
        for &Cap { corners: cap, is_on_rim, .. } in caps {
            let cross = 0.5 * triangle_cross(cap);
            // A cap without area has a small weight, so that the centroid is defined.
            let weight = cross.length().max(1e-30);
            vector += cross;
            area += weight;
            moment += (cap[0] + cap[1] + cap[2]) / 3.0 * weight;
            rim += if is_on_rim { cap[0].distance(cap[1]) } else { 0.0 };
        }
        let center = moment / area;
        let outer = |cap: &Cap| {
            let [a, b, c] = cap.corners;
            let (d, vector) = ((a + b + c) / 3.0 - center, 0.5 * triangle_cross(cap.corners));
            DMat3::from_cols(d * vector.x, d * vector.y, d * vector.z)
        };
        let first_moment = caps.iter().map(outer).fold(DMat3::ZERO, |sum, outer| sum + outer);
        let radius = caps.iter().flat_map(|cap| cap.corners).map(|p| p.distance(center)).fold(0.0, f64::max)
            * (1.0 + 1e-9)
            + 1e-12;
        Self {
            center,
            radius,
            vector,
            area,
            moment: first_moment,
            rim,
            next: 0,
            is_whole: true,
            first,
            count: caps.len(),
            pack: 0,
            is_leaf: true,
        }
    }
}

/// Sum of the solid angles of caps as seen from `p`, turns. The side of `p` comes from the exact predicate that also
/// decides the crossings, so that the jumps of the angle and of the count lie on the same side of the cone.
fn turns_at(p: DVec3, caps: &[[DVec3; 3]]) -> f64 {
    let at = |q: DVec3| Coord3D { x: q.x, y: q.y, z: q.z };
    let mut angles = SolidAngles::default();
    for cap in caps {
        angles.add_sided(cap.map(|corner| corner - p), || orient3d(at(cap[0]), at(cap[1]), at(cap[2]), at(p)));
    }
    angles.sum() / (4.0 * PI)
}
