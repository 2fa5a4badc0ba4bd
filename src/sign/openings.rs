//! Exact generalised winding numbers of a mesh with a few openings, by closing them.
//!
//! *Theory.* Close every opening with a cone of triangles from its rim to one apex. The closed surface has an integer
//! winding number W, counted by rays (see `crossing`). The solid angle is additive: w(mesh) = W - f, where f is the
//! winding number of the cones alone. Inside means |w| > 1/2 (either direction of the faces counts as a surface), and
//! for an integer W this is equivalent to **W != round(f)**.
//!
//! f is summed over a tree of the caps, the triangles of all cones. A part of the tree with the area A and the area
//! vector N, in a ball of the radius R around the centroid c, contributes the angle of its dipole, N.x / |x|^3 with
//! x = c - p. The field r / |r|^3 has the slope 2 / |r|^3, so the error of the dipole is at most 2 A R / (|x| - R)^3.
//! Parts whose error is too large for their share of the total are divided; leaves are summed triangle by triangle. If
//! the error leaves the nearest integer open, a finer sum follows, and a sum over all caps in float64 at last.
//!
//! f jumps only at the caps. Elsewhere its gradient is that of the rim alone, by the Biot-Savart law: |grad f| <= sum
//! over rim edges of length / (4 pi distance^2). A part of the tree also changes by at most 2 A / (4 pi distance^3).
//! One value therefore decides a whole ball of samples ([`Openings::rounded_ball`]), and only samples near an opening
//! have a cost. [`super::winding`] handles meshes that consist of openings.

use super::caps::{ANGLE_ERROR, CapPack};
use super::crossing::{Axes, ClosedSurface, crossing};
use crate::bvh::WIDTH;
use crate::geometry::triangle_cross;
use crate::mesh::Mesh;
use glam::DVec3;
use robust::{Coord3D, orient3d};
use std::collections::{BTreeMap, HashMap};
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
    /// Length of the rim edges of the caps.
    rim: f64,
    /// Index of the first node that follows the descendants of this one.
    next: usize,
    /// First cap. A leaf has the caps of one pack.
    first: usize,
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

/// Offset of the apex from the centre of its rim, in rim sizes. It points away from the planes of typical grids and
/// models, so that no sample lies on a cone by symmetry.
const APEX_OFFSET: DVec3 = DVec3::new(0.003_69, 0.005_37, 0.007_58);

/// A sample counts as undecided if its winding number is closer to 1/2 than this.
const UNDECIDED: f64 = 0.05;

/// Relative and absolute margin for float32 in a distance: a hundred times its rounding.
const ROUNDING: f64 = 1e-5;

impl Openings {
    pub fn of(mesh: &Mesh) -> Self {
        let rim = &mesh.topology().rim;
        let position = |v: u32| mesh.positions()[v as usize].as_dvec3();

        // Rim edges that share vertices belong to one opening.
        let mut opening_of: HashMap<u32, u32> = HashMap::new();
        fn root(opening_of: &mut HashMap<u32, u32>, mut v: u32) -> u32 {
            loop {
                let parent = *opening_of.entry(v).or_insert(v);
                if parent == v {
                    return v;
                }
                let grand = opening_of[&parent];
                opening_of.insert(v, grand);
                v = grand;
            }
        }
        for &[from, to] in rim {
            let (a, b) = (root(&mut opening_of, from), root(&mut opening_of, to));
            opening_of.insert(a.max(b), a.min(b));
        }

        // Every vertex of a rim is the end of as many edges as it is the start, so the mean over edge starts is the
        // mean over the rim.
        let mut rims: HashMap<u32, (DVec3, usize, DVec3, DVec3)> = HashMap::new();
        for &[from, _] in rim {
            let p = position(from);
            let entry = rims.entry(root(&mut opening_of, from)).or_insert((DVec3::ZERO, 0, p, p));
            *entry = (entry.0 + p, entry.1 + 1, entry.2.min(p), entry.3.max(p));
        }
        let mut by_opening: BTreeMap<u32, Vec<[DVec3; 3]>> = BTreeMap::new();
        for &[from, to] in rim {
            let opening = root(&mut opening_of, from);
            let (sum, count, low, high) = rims[&opening];
            let apex = sum / count as f64 + APEX_OFFSET * (high - low).max_element();
            // The closing face traverses the edge backwards. The predicates are fastest with coordinates of few bits.
            by_opening.entry(opening).or_default().push([position(to), position(from), apex.as_vec3().as_dvec3()]);
        }
        let mut openings = Self { caps: by_opening.into_values().flatten().collect(), ..Self::default() };
        if !openings.caps.is_empty() {
            openings.divide(0, openings.caps.len());
        }
        openings.packs = openings.caps.chunks(WIDTH).map(CapPack::new).collect();
        openings
    }

    /// Adds the node of a range of caps and its descendants. Ranges begin at multiples of the caps of a pack.
    fn divide(&mut self, first: usize, end: usize) {
        let index = self.nodes.len();
        let is_leaf = end - first <= WIDTH;
        self.nodes.push(CapNode { is_leaf, ..CapNode::new(first, &self.caps[first..end]) });
        if !is_leaf {
            let centroid = |cap: &[DVec3; 3]| (cap[0] + cap[1] + cap[2]) / 3.0;
            let centroids = self.caps[first..end].iter().map(centroid);
            let (low, high) =
                centroids.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
            let axis = (high - low).max_position();
            self.caps[first..end].sort_by(|a, b| centroid(a)[axis].total_cmp(&centroid(b)[axis]));
            let middle = first + ((end - first) / 2).next_multiple_of(WIDTH);
            self.divide(first, middle);
            self.divide(middle, end);
        }
        self.nodes[index].next = self.nodes.len();
    }

    /// Winding number of the caps alone, with the rounding of float64.
    pub fn fraction(&self, p: DVec3) -> f64 {
        self.caps.iter().map(|cap| angle_from(p, cap)).sum::<f64>() / (4.0 * PI)
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

    /// The integer nearest to the fraction at a point, and the radius of a ball in which it is the same and that
    /// contains no cap. The radius is 0 where the fraction is close to the middle between two integers.
    pub fn rounded_ball(&self, p: DVec3) -> (i8, f64) {
        if self.caps.is_empty() {
            return (0, f64::INFINITY);
        }
        let angle = self.sum(p, 0.0, COARSE, false);
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
    fn round(&self, p: DVec3) -> (i8, bool) {
        if let Some((rounded, margin)) = self.sum(p, 0.0, COARSE, false).rounded()
            && margin > UNDECIDED
        {
            return (rounded, true);
        }
        if let Some((rounded, margin)) = self.sum(p, 0.0, FINE, true).rounded() {
            return (rounded, margin >= UNDECIDED);
        }
        let fraction = self.fraction(p);
        (fraction.round() as i8, (fraction - fraction.round()).abs() <= 0.5 - UNDECIDED)
    }

    /// Computes the nearest integer of the fraction at each sample of a block and passes it to `set`. Returns the
    /// number of samples that were close to undecided.
    pub fn for_each_rounded_fraction(&self, block: &SampleBlock<'_>, set: &mut impl FnMut([usize; 3], i8)) -> usize {
        let &SampleBlock { low, high, at } = block;
        let (first, last) = (at(low), at(high.map(|i| i - 1)));
        let center = (first + last) * 0.5;
        let radius = first.distance(last) * 0.5 * (1.0 + 1e-9);
        if (0..3).all(|axis| high[axis] - low[axis] == 1) {
            let (rounded, decided) = self.round(center);
            set(low, rounded);
            return usize::from(!decided);
        }
        if let Some(rounded) = self.rounded_within(center, radius) {
            for z in low[2]..high[2] {
                for y in low[1]..high[1] {
                    for x in low[0]..high[0] {
                        set([x, y, z], rounded);
                    }
                }
            }
            return 0;
        }
        // Halves the longest side.
        let axis = (0..3).max_by_key(|&axis| high[axis] - low[axis]).unwrap_or(0);
        let (mut left_high, mut right_low) = (high, low);
        left_high[axis] = low[axis].midpoint(high[axis]);
        right_low[axis] = left_high[axis];
        let left = SampleBlock { low, high: left_high, at };
        let right = SampleBlock { low: right_low, high, at };
        self.for_each_rounded_fraction(&left, set) + self.for_each_rounded_fraction(&right, set)
    }

    /// The integer nearest to the fraction everywhere within `radius` of `center`; None if a single value is not
    /// sufficient.
    fn rounded_within(&self, center: DVec3, radius: f64) -> Option<i8> {
        let angle = self.sum(center, radius, COARSE, false);
        let is_clear = angle.clear > radius * (1.0 + ROUNDING) + ROUNDING;
        let (rounded, margin) = angle.rounded().filter(|_| is_clear)?;
        (margin * 4.0 * PI > radius * angle.slope * (1.0 + ROUNDING)).then_some(rounded)
    }

    /// The solid angle of all caps at a point, with an error of at most `error` steradians and the rounding of the
    /// leaves. The slope holds within `radius`; the sum ends at the first cap within that radius. With `exact` the
    /// leaves are summed in float64.
    fn sum(&self, p: DVec3, radius: f64, error: f64, exact: bool) -> CapAngle {
        let mut found = CapAngle { sum: 0.0, error: 0.0, clear: f64::INFINITY, slope: 0.0 };
        let share = error / self.nodes.first().map_or(1.0, |root| root.area.max(f64::MIN_POSITIVE));
        let mut i = 0;
        while let Some(node) = self.nodes.get(i) {
            let to = node.center - p;
            let distance = to.length();
            let reach = distance - node.radius;
            if reach > radius && 2.0 * node.radius <= share * reach * reach * reach {
                let left = reach - radius;
                found.sum += node.vector.dot(to) / (distance * distance * distance);
                found.error += 2.0 * node.area * node.radius / (reach * reach * reach);
                found.clear = found.clear.min(reach);
                found.slope += (node.rim / (left * left)).min(2.0 * node.area / (left * left * left));
                i = node.next;
                continue;
            }
            if node.is_leaf {
                let pack = &self.packs[node.first / WIDTH];
                let (nearest, slope) = pack.reach(p.as_vec3(), radius as f32);
                found.clear = found.clear.min(f64::from(nearest.sqrt()) * (1.0 - ROUNDING) - ROUNDING);
                found.slope += f64::from(slope);
                if radius > 0.0 && found.clear <= radius {
                    return found;
                }
                match pack.angles(p.as_vec3()).filter(|_| !exact) {
                    Some(sum) => {
                        found.sum += f64::from(sum);
                        found.error += ANGLE_ERROR * WIDTH as f64;
                    }
                    None => found.sum += self.caps_of(node).iter().map(|cap| angle_from(p, cap)).sum::<f64>(),
                }
            }
            i += 1;
        }
        found
    }

    fn caps_of(&self, leaf: &CapNode) -> &[[DVec3; 3]] {
        &self.caps[leaf.first..(leaf.first + WIDTH).min(self.caps.len())]
    }
}

impl CapAngle {
    /// The nearest number of whole turns, and the distance of the fraction from the middle between two numbers less its
    /// error. None if the error leaves the number open.
    fn rounded(&self) -> Option<(i8, f64)> {
        let fraction = self.sum / (4.0 * PI);
        let rounded = fraction.round();
        let margin = 0.5 - (fraction - rounded).abs() - self.error / (4.0 * PI) - EXACT_ERROR;
        (margin > 0.0).then_some((rounded as i8, margin))
    }
}

/// Rounding error of a sum of float64 angles, turns.
const EXACT_ERROR: f64 = 1e-9;

impl CapNode {
    fn new(first: usize, caps: &[[DVec3; 3]]) -> Self {
        let (mut vector, mut area, mut rim, mut moment) = (DVec3::ZERO, 0.0, 0.0, DVec3::ZERO);
        for &cap in caps {
            let cross = 0.5 * triangle_cross(cap);
            // A cap without area has a small weight, so that the centroid is defined.
            let weight = cross.length().max(1e-30);
            vector += cross;
            area += weight;
            moment += (cap[0] + cap[1] + cap[2]) / 3.0 * weight;
            rim += cap[0].distance(cap[1]);
        }
        let center = moment / area;
        let radius = caps.iter().flatten().map(|p| p.distance(center)).fold(0.0, f64::max) * (1.0 + 1e-9) + 1e-12;
        Self { center, radius, vector, area, rim, next: 0, first, is_leaf: true }
    }
}

/// Solid angle of a triangle as seen from `p`. The side of `p` comes from the exact predicate that also decides the
/// crossings, so that the jump of the angle and that of the count lie on the same side of the cone.
fn angle_from(p: DVec3, corners: &[DVec3; 3]) -> f64 {
    let at = |q: DVec3| Coord3D { x: q.x, y: q.y, z: q.z };
    let numerator = orient3d(at(corners[0]), at(corners[1]), at(corners[2]), at(p));
    let [a, b, c] = corners.map(|corner| corner - p);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * numerator.atan2(denominator)
}
