//! Exact generalised winding numbers of a mesh with a few openings, by closing them.
//!
//! *Theory.* Close every opening with a cone of triangles from its rim to one apex. The closed surface has an integer
//! winding number W, counted by rays (see `crossing`). The solid angle is additive: w(mesh) = W - f, where f is the
//! winding number of the cones alone. Inside means |w| > 1/2 (either direction of the faces counts as a surface), and
//! for an integer W this is equivalent to **W != round(f)**.
//!
//! f jumps only at the cones. Elsewhere its gradient is that of the rim alone, by the Biot-Savart law: |grad f| <= sum
//! over rim edges of length / (4 pi distance^2). One value therefore decides whole blocks of samples away from the
//! openings. From far away a cone covers at most its area over the squared distance. It is omitted from the sum while
//! the omitted parts cannot change the nearest integer. Only samples near an opening have a cost, proportional to the
//! number of its rim edges. [`super::winding`] handles meshes that consist of openings.

use super::caps::{ANGLE_ERROR, CapPack};
use crate::bvh::WIDTH;
use crate::geometry::triangle_cross;
use crate::mesh::Mesh;
use glam::{DVec3, Vec3};
use robust::{Coord3D, orient3d};
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::PI;
use std::ops::Range;

/// The cones over the rims of all openings, local units. Empty for a closed mesh.
#[derive(Debug, Default)]
pub struct Openings {
    pub caps: Vec<[DVec3; 3]>,
    packs: Vec<CapPack>,
    cones: Vec<OpeningCone>,
}

/// One opening: its triangles among the packs, a ball that contains it, and its area.
#[derive(Debug, Clone)]
struct OpeningCone {
    packs: Range<usize>,
    center: DVec3,
    radius: f64,
    area: f64,
}

/// A box of samples, and the position of each sample.
pub struct SampleBlock<'a> {
    pub low: [usize; 3],
    pub high: [usize; 3],
    pub at: &'a dyn Fn([usize; 3]) -> DVec3,
}

/// Largest sum, in turns, of the cones that are omitted.
const LEFT_OUT: f64 = 0.1;

/// Offset of the apex from the centre of its rim, in rim sizes. It points away from the planes of typical grids and
/// models, so that no sample lies on a cone by symmetry.
const APEX_OFFSET: DVec3 = DVec3::new(0.003_69, 0.005_37, 0.007_58);

/// A sample counts as undecided if its winding number is closer to 1/2 than this.
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
        let mut openings = Self::default();
        for caps in by_opening.into_values() {
            let center = caps[0][2];
            let first = openings.packs.len();
            openings.packs.extend(caps.chunks(WIDTH).map(CapPack::new));
            openings.cones.push(OpeningCone {
                packs: first..openings.packs.len(),
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

    /// The integer nearest to the fraction at a point.
    pub fn rounded_fraction(&self, p: DVec3) -> i8 {
        if self.clearance(p) >= 0.0 {
            return 0;
        }
        let mut left_out = 0.0;
        let near: Vec<OpeningCone> =
            self.cones.iter().filter(|cone| cone.matters(p, 0.0, &mut left_out)).cloned().collect();
        self.round(p, &near, left_out).0
    }

    /// Distance by which a point may move without crossing a cone, and without changing the nearest integer of the
    /// fraction from 0. Negative near an opening.
    pub fn clearance(&self, p: DVec3) -> f64 {
        // Each cone gets an equal share of just under a half turn.
        let share = 4.0 * PI * (0.5 - UNDECIDED) / self.cones.len() as f64;
        let reach = |cone: &OpeningCone| p.distance(cone.center) - cone.radius - (cone.area / share).sqrt();
        self.cones.iter().map(reach).fold(f64::INFINITY, f64::min)
    }

    /// Whether no cone comes within `radius` of a point and the fraction has one nearest integer there. False also
    /// where one value cannot tell.
    pub fn is_uniform_within(&self, p: DVec3, radius: f64) -> bool {
        let mut left_out = 0.0;
        let matters = |cone: &&OpeningCone| cone.matters(p, radius, &mut left_out);
        let near: Vec<OpeningCone> = self.cones.iter().filter(matters).cloned().collect();
        self.rounded_within(p, radius, &near, left_out).is_some()
    }

    /// The nearest integer of the fraction at a point, and whether it is certain. The cones that are not in `near` add
    /// less than `left_out`.
    fn round(&self, p: DVec3, near: &[OpeningCone], left_out: f64) -> (i8, bool) {
        let fast = self
            .fast_fraction(p, near)
            .filter(|(fraction, error)| (fraction - fraction.round()).abs() + left_out + error < 0.5 - UNDECIDED);
        let fraction = fast.map_or_else(|| self.fraction(p), |(fraction, _)| fraction);
        (fraction.round() as i8, (fraction - fraction.round()).abs() <= 0.5 - UNDECIDED)
    }

    /// The contribution of some cones to the fraction by lanes, and its error; None if the point is too close to one of
    /// them.
    fn fast_fraction(&self, p: DVec3, near: &[OpeningCone]) -> Option<(f64, f64)> {
        let packs = near.iter().flat_map(|cone| &self.packs[cone.packs.clone()]);
        let sum = sum_angles(packs.clone(), p.as_vec3())?;
        let error = ANGLE_ERROR * (packs.count() * WIDTH) as f64;
        Some((f64::from(sum) / (4.0 * PI), error / (4.0 * PI)))
    }

    /// Computes the nearest integer of the fraction at each sample of a block and passes it to `set`. Returns the
    /// number of samples that were close to undecided.
    pub fn for_each_rounded_fraction(&self, block: &SampleBlock<'_>, set: &mut impl FnMut([usize; 3], i8)) -> usize {
        self.decide(block, &self.cones, 0.0, set)
    }

    /// `near` are the cones that are evaluated in the block. The others add less than `left_out` anywhere in it.
    fn decide(
        &self,
        block: &SampleBlock<'_>,
        near: &[OpeningCone],
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
        // Halves the longest side.
        let axis = (0..3).max_by_key(|&axis| high[axis] - low[axis]).unwrap_or(0);
        let (mut left_high, mut right_low) = (high, low);
        left_high[axis] = low[axis].midpoint(high[axis]);
        right_low[axis] = left_high[axis];
        let left = SampleBlock { low, high: left_high, at };
        let right = SampleBlock { low: right_low, high, at };
        self.decide(&left, &nearer, left_out, set) + self.decide(&right, &nearer, left_out, set)
    }

    /// The integer nearest to the fraction everywhere within `radius` of `center`; None if a single value is not
    /// sufficient.
    fn rounded_within(&self, center: DVec3, radius: f64, near: &[OpeningCone], left_out: f64) -> Option<i8> {
        // No cone lies within the radius, and the gradient of the rim is bounded.
        let packs = near.iter().flat_map(|cone| &self.packs[cone.packs.clone()]);
        let (nearest, change) = least_reach(packs, center.as_vec3(), radius as f32);
        if f64::from(nearest.sqrt()) <= radius * (1.0 + ROUNDING) + ROUNDING {
            return None;
        }
        let change = radius * f64::from(change) * (1.0 + ROUNDING) / (4.0 * PI);
        let (fraction, error) = self.fast_fraction(center, near)?;
        let rounded = fraction.round();
        ((fraction - rounded).abs() + change + error + left_out < 0.5).then_some(rounded as i8)
    }
}

/// Relative and absolute margin for float32 in a distance: a hundred times its rounding.
const ROUNDING: f64 = 1e-5;

/// Sum of the solid angles of packs, with the widest registers of the processor.
fn sum_angles<'a>(packs: impl Iterator<Item = &'a CapPack>, p: Vec3) -> Option<f32> {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide<'a>(mut packs: impl Iterator<Item = &'a CapPack>, p: Vec3) -> Option<f32> {
            packs.try_fold(0.0, |sum, pack| Some(sum + pack.angles(p)?))
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { wide(packs, p) };
        }
    }
    let mut packs = packs;
    packs.try_fold(0.0, |sum, pack| Some(sum + pack.angles(p)?))
}

/// Smallest squared distance to packs, and the sum of the gradients of their rims.
fn least_reach<'a>(packs: impl Iterator<Item = &'a CapPack>, p: Vec3, radius: f32) -> (f32, f32) {
    #[inline(always)]
    fn fold<'a>(packs: impl Iterator<Item = &'a CapPack>, p: Vec3, radius: f32) -> (f32, f32) {
        packs.fold((f32::INFINITY, 0.0), |(least, sum), pack| {
            let (nearest, change) = pack.reach(p, radius);
            (least.min(nearest), sum + change)
        })
    }
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx2")]
        fn wide<'a>(packs: impl Iterator<Item = &'a CapPack>, p: Vec3, radius: f32) -> (f32, f32) {
            fold(packs, p, radius)
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has AVX2.
            return unsafe { wide(packs, p, radius) };
        }
    }
    fold(packs, p, radius)
}

impl OpeningCone {
    /// Whether the cone must be evaluated within `radius` of `center`. If not, its largest contribution there is added
    /// to `left_out`.
    fn matters(&self, center: DVec3, radius: f64, left_out: &mut f64) -> bool {
        let reach = (self.center.distance(center) - self.radius - radius).max(0.0);
        let largest = self.area / (4.0 * PI * reach * reach);
        let matters = *left_out + largest > LEFT_OUT;
        *left_out += if matters { 0.0 } else { largest };
        matters
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
