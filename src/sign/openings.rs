//! Exact generalised winding numbers of a mesh with a few openings, by closing them.
//!
//! *Theory.* Close every opening with a cone of triangles from its rim to one apex. The closed surface has an integer
//! winding number W, counted by rays (see `crossing`), and the solid angle is additive: w(mesh) = W - f, f being the
//! winding number of the cones alone. Inside means |w| > 1/2 (either direction of the faces counts as a surface), and
//! for an integer W that is simply **W != round(f)**.
//!
//! f jumps only at the cones, and elsewhere its gradient is that of the rim alone, by the Biot-Savart law: |grad f| <=
//! sum over rim edges of length / (4 pi distance^2). So one value decides whole blocks of samples away from the openings.
//! From afar a cone covers at most its area over the squared distance; it is left out of the sum while what is left out
//! cannot change the nearest integer. So only samples near an opening pay, by the number of its rim edges; see
//! [`super::winding`] for meshes that are all openings.

use crate::geometry::{closest_point_on_triangle, triangle_cross};
use crate::mesh::Mesh;
use glam::DVec3;
use robust::{Coord3D, orient3d};
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::PI;
use std::ops::Range;

/// The cones over the rims of all openings, local units. Empty for a closed mesh.
#[derive(Debug, Default)]
pub struct Openings {
    pub caps: Vec<[DVec3; 3]>,
    cones: Vec<Cone>,
}

/// One opening: its triangles among the caps, and what is seen of it from afar: a ball that holds it, and its area.
#[derive(Debug, Clone)]
struct Cone {
    caps: Range<usize>,
    center: DVec3,
    radius: f64,
    area: f64,
}

/// A box of samples, and where each of them is.
pub struct SampleBlock<'a> {
    pub low: [usize; 3],
    pub high: [usize; 3],
    pub at: &'a dyn Fn([usize; 3]) -> DVec3,
}

/// Share of a turn that cones left out of a sum may add up to.
const LEFT_OUT: f64 = 0.1;

/// Where the apex sits off the centre of its rim, in rim sizes: away from the planes that grids and models favour, so
/// that no sample lies on a cone by symmetry.
const APEX_OFFSET: DVec3 = DVec3::new(0.003_69, 0.005_37, 0.007_58);

/// A sample counts as undecided when its winding number is closer to 1/2 than this.
const UNDECIDED: f64 = 0.05;

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

        // Every vertex of a rim is entered as often as left, so the mean over edge starts is the mean over the rim.
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
            // The closing face walks the edge backwards. The predicates want coordinates of few bits.
            by_opening.entry(opening).or_default().push([position(to), position(from), apex.as_vec3().as_dvec3()]);
        }
        let mut openings = Self::default();
        for caps in by_opening.into_values() {
            let center = caps[0][2];
            let first = openings.caps.len();
            openings.cones.push(Cone {
                caps: first..first + caps.len(),
                center,
                radius: caps.iter().flatten().map(|p| p.distance(center)).fold(0.0, f64::max),
                area: caps.iter().map(|&cap| 0.5 * triangle_cross(cap).length()).sum(),
            });
            openings.caps.extend(caps);
        }
        openings
    }

    /// Winding number of the cones alone.
    pub fn fraction(&self, p: DVec3) -> f64 {
        self.caps.iter().map(|cap| angle_from(p, cap)).sum::<f64>() / (4.0 * PI)
    }

    /// The nearest integer of the fraction at a point.
    pub fn rounded_fraction(&self, p: DVec3) -> i8 {
        let mut left_out = 0.0;
        let near: Vec<Cone> = self.cones.iter().filter(|cone| cone.matters(p, 0.0, &mut left_out)).cloned().collect();
        self.round(p, &near, left_out).0
    }

    /// The nearest integer of the fraction at a point, and whether it is clear; the cones not in `near` add less than
    /// `left_out`.
    fn round(&self, p: DVec3, near: &[Cone], left_out: f64) -> (i8, bool) {
        let caps = near.iter().flat_map(|cone| &self.caps[cone.caps.clone()]);
        let mut fraction = caps.map(|cap| angle_from(p, cap)).sum::<f64>() / (4.0 * PI);
        if (fraction - fraction.round()).abs() + left_out >= 0.5 - UNDECIDED {
            fraction = self.fraction(p);
        }
        (fraction.round() as i8, (fraction - fraction.round()).abs() <= 0.5 - UNDECIDED)
    }

    /// The nearest integer of the fraction at each sample of a block, given to `set`; returns how many samples were close
    /// to undecided.
    pub fn for_each_rounded_fraction(&self, block: &SampleBlock<'_>, set: &mut impl FnMut([usize; 3], i8)) -> usize {
        self.decide(block, &self.cones, 0.0, set)
    }

    /// `near` are the cones that matter to the block; the others add less than `left_out` anywhere in it.
    fn decide(
        &self,
        block: &SampleBlock<'_>,
        near: &[Cone],
        mut left_out: f64,
        set: &mut impl FnMut([usize; 3], i8),
    ) -> usize {
        let &SampleBlock { low, high, at } = block;
        let (first, last) = (at(low), at(high.map(|i| i - 1)));
        let center = (first + last) * 0.5;
        let radius = first.distance(last) * 0.5 * (1.0 + 1e-9);
        let mut nearer = near.to_vec();
        nearer.retain(|cone| cone.matters(center, radius, &mut left_out));

        if (0..3).all(|axis| high[axis] - low[axis] == 1) {
            let (rounded, decided) = self.round(center, &nearer, left_out);
            set(low, rounded);
            return usize::from(!decided);
        }
        if let Some(rounded) = self.rounded_within(center, radius, &nearer, left_out) {
            for z in low[2]..high[2] {
                for y in low[1]..high[1] {
                    for x in low[0]..high[0] {
                        set([x, y, z], rounded);
                    }
                }
            }
            return 0;
        }
        // Halve the longest side.
        let axis = (0..3).max_by_key(|&axis| high[axis] - low[axis]).unwrap_or(0);
        let (mut left_high, mut right_low) = (high, low);
        left_high[axis] = low[axis].midpoint(high[axis]);
        right_low[axis] = left_high[axis];
        let left = SampleBlock { low, high: left_high, at };
        let right = SampleBlock { low: right_low, high, at };
        self.decide(&left, &nearer, left_out, set) + self.decide(&right, &nearer, left_out, set)
    }

    /// The integer nearest to the fraction everywhere within `radius` of `center`, if one value can tell.
    fn rounded_within(&self, center: DVec3, radius: f64, near: &[Cone], left_out: f64) -> Option<i8> {
        let (mut fraction, mut change) = (0.0, 0.0);
        for cap in near.iter().flat_map(|cone| &self.caps[cone.caps.clone()]) {
            // No jump within the radius, and the field of the rim bounded. The first edge of a cap is the rim.
            if closest_point_on_triangle(center, *cap).point.distance(center) <= radius {
                return None;
            }
            let rim_reach = distance_to_segment(center, cap[0], cap[1]) - radius;
            change += cap[0].distance(cap[1]) / (rim_reach * rim_reach);
            fraction += angle_from(center, cap);
        }
        let (fraction, change) = (fraction / (4.0 * PI), radius * change / (4.0 * PI));
        let nearest = fraction.round();
        // The margin covers the rounding of the sum.
        ((fraction - nearest).abs() + change + left_out < 0.5 - 1e-9).then_some(nearest as i8)
    }
}

impl Cone {
    /// Whether the cone is needed within `radius` of `center`; if not, what it can add there joins `left_out`.
    fn matters(&self, center: DVec3, radius: f64, left_out: &mut f64) -> bool {
        let reach = (self.center.distance(center) - self.radius - radius).max(0.0);
        let largest = self.area / (4.0 * PI * reach * reach);
        let matters = *left_out + largest > LEFT_OUT;
        *left_out += if matters { 0.0 } else { largest };
        matters
    }
}

/// Solid angle of a triangle from `p`. Which side `p` is on comes from the same exact predicate that decides the
/// crossings, so that the jump of the angle and that of the count fall on the same side of the cone.
fn angle_from(p: DVec3, corners: &[DVec3; 3]) -> f64 {
    let at = |q: DVec3| Coord3D { x: q.x, y: q.y, z: q.z };
    let numerator = orient3d(at(corners[0]), at(corners[1]), at(corners[2]), at(p));
    let [a, b, c] = corners.map(|corner| corner - p);
    let (la, lb, lc) = (a.length(), b.length(), c.length());
    let denominator = la * lb * lc + a.dot(b) * lc + b.dot(c) * la + c.dot(a) * lb;
    2.0 * numerator.atan2(denominator)
}

fn distance_to_segment(p: DVec3, a: DVec3, b: DVec3) -> f64 {
    let ab = b - a;
    let t = ((p - a).dot(ab) / ab.length_squared()).clamp(0.0, 1.0);
    p.distance(a + ab * t)
}
