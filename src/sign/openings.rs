//! Exact generalised winding numbers of a mesh with a few openings, by closing them.
//!
//! *Theory.* Close every opening with a cone of triangles from its rim to one apex. The closed surface has an integer
//! winding number W, counted by rays (see `crossing`), and the solid angle is additive: w(mesh) = W - f, f being the
//! winding number of the cones alone. Inside means |w| > 1/2 (either direction of the faces counts as a surface), and
//! for an integer W that is simply **W != round(f)**.
//!
//! f jumps only at the cones, and elsewhere its gradient is that of the rim alone, by the Biot-Savart law: |grad f| <=
//! sum over rim edges of length / (4 pi distance^2). So one value decides whole blocks of samples away from the openings,
//! and the angles of the cones are summed only near them. The cost of that is the number of rim edges a sample, which is
//! why this is used for few of them; see [`super::winding`] for the rest.

use crate::geometry::closest_point_on_triangle;
use crate::mesh::Mesh;
use glam::DVec3;
use robust::{Coord3D, orient3d};
use std::collections::HashMap;
use std::f64::consts::PI;

/// The cones over the rims of all openings, local units. Empty for a closed mesh.
#[derive(Debug, Default)]
pub struct Openings {
    pub caps: Vec<[DVec3; 3]>,
}

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
        let caps = rim
            .iter()
            .map(|&[from, to]| {
                let (sum, count, low, high) = rims[&root(&mut opening_of, from)];
                let apex = sum / count as f64 + APEX_OFFSET * (high - low).max_element();
                // The closing face walks the edge backwards. The predicates want coordinates of few bits.
                [position(to), position(from), apex.as_vec3().as_dvec3()]
            })
            .collect();
        Self { caps }
    }

    /// Winding number of the cones alone, and its nearest integer. `None` for the integer when it is undecided.
    pub fn fraction(&self, p: DVec3) -> f64 {
        self.caps.iter().map(|cap| angle_from(p, cap)).sum::<f64>() / (4.0 * PI)
    }

    /// The integer nearest to the fraction everywhere within `radius` of `center`, if there is one.
    pub fn rounded_fraction_within(&self, center: DVec3, radius: f64) -> Option<i8> {
        let (mut fraction, mut change) = (0.0, 0.0);
        for cap in &self.caps {
            // The first edge of a cap is the rim; no jump within the radius, and the rim's field bounded.
            let reach = closest_point_on_triangle(center, *cap).point.distance(center) - radius;
            if reach <= 0.0 {
                return None;
            }
            let rim_reach = distance_to_segment(center, cap[0], cap[1]) - radius;
            change += cap[0].distance(cap[1]) / (rim_reach * rim_reach);
            fraction += angle_from(center, cap);
        }
        let (fraction, change) = (fraction / (4.0 * PI), radius * change / (4.0 * PI));
        let nearest = fraction.round();
        // The margin covers the rounding of the sum.
        ((fraction - nearest).abs() + change < 0.5 - 1e-9).then_some(nearest as i8)
    }

    /// The nearest integer of the fraction at each sample of a block; returns how many were close to undecided.
    ///
    /// `at` gives the position of a sample, `set` takes its integer. The block is `low..high` in samples.
    pub fn for_each_rounded_fraction(
        &self,
        low: [usize; 3],
        high: [usize; 3],
        at: &impl Fn([usize; 3]) -> DVec3,
        set: &mut impl FnMut([usize; 3], i8),
    ) -> usize {
        let first = at(low);
        let last = at(high.map(|i| i - 1));
        let (center, radius) = ((first + last) * 0.5, first.distance(last) * 0.5);
        let single = (0..3).all(|axis| high[axis] - low[axis] == 1);
        if single {
            let fraction = self.fraction(center);
            set(low, fraction.round() as i8);
            return usize::from((fraction - fraction.round()).abs() > 0.5 - UNDECIDED);
        }
        if let Some(rounded) = self.rounded_fraction_within(center, radius * (1.0 + 1e-9)) {
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
        let middle = low[axis].midpoint(high[axis]);
        let (mut left_high, mut right_low) = (high, low);
        left_high[axis] = middle;
        right_low[axis] = middle;
        self.for_each_rounded_fraction(low, left_high, at, set)
            + self.for_each_rounded_fraction(right_low, high, at, set)
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
