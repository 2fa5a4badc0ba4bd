//! Ambient occlusion: the fraction of the hemisphere above a surface that no occluder blocks.
//!
//! # Theory
//!
//! [`RAYS`] thin rays, whose density is the cosine of the angle from the normal, end at a given distance. They pass
//! triangles and fields as the rays of hard shadows do ([`super::shadow`]), so all kinds of objects occlude alike.
//!
//! The hemisphere has seven parts: the directions within 30 degrees of the normal, and six sectors around them. The
//! rays of a part are the points of Hammersley's set, permuted in [`PATTERNS`] ways for different pixels (Kollig and
//! Keller, *Efficient Multidimensional Sampling*, 2002).
//!
//! # Practice
//!
//! The instances near a place are gathered once for all of its rays. Those that the rays of a part may hit are tested
//! by all of these together ([`super::mesh_rays`]). For pictures of a device the CPU traces the triangles, and the
//! device traces the fields.

use super::light_rays::{Hemisphere, LightRay, LightWork, basis};
use super::mesh_rays::PlacedRay;
use super::near_instances::NearInstances;
use super::occluder::NearList;
use super::shadow::{Blocking, TracedScene};
use crate::scene::content::model::Scene;
use glam::{Vec2, Vec3};
use std::sync::LazyLock;

/// Number of patterns of directions over the hemisphere.
pub(crate) const PATTERNS: usize = 64;

/// Number of parts of the hemisphere.
const PARTS: usize = 7;
/// Numbers of rays in the part around the normal, and in each sector around it. Both are powers of two.
const MIDDLE_RAYS: usize = 32;
const SECTOR_RAYS: usize = 16;
/// Number of rays over a hemisphere.
pub(crate) const RAYS: usize = MIDDLE_RAYS + (PARTS - 1) * SECTOR_RAYS;

/// Fraction of the rays in the middle part.
const MIDDLE_SHARE: f32 = MIDDLE_RAYS as f32 / RAYS as f32;

/// Cosine of the largest angle between a direction in a part and the axis of the part: 30 degrees in the middle, and in
/// a sector the angle between its axis and the horizon at its border.
const MIDDLE_COSINE: f32 = 0.866_025_4;
const SECTOR_COSINE: f32 = 0.75;
/// Cosine and sine of the angle between the axis of a sector and the normal, 60 degrees.
const AXIS_COSINE: f32 = 0.5;
const AXIS_SINE: f32 = 0.866_025_4;

/// Neighbouring surfaces share the search for their occluders: a search finds the occluders of all surfaces within this
/// fraction of its radius.
const SHARED: f32 = 0.25;

/// Relative margin for the rounding of distances.
const ROUNDING: f32 = 1e-5;

/// Part of a hemisphere about the z axis.
struct Part {
    axis: Vec3,
    /// Least cosine of the angle between the axis and a ray of the part.
    least_cosine: f32,
    /// Directions of its rays.
    rays: Vec<Vec3>,
}

/// The patterns of rays, made when they are first used.
static PATTERN_PARTS: LazyLock<Vec<[Part; PARTS]>> =
    LazyLock::new(|| (0..PATTERNS).map(|pattern| std::array::from_fn(|part| Part::new(part, pattern))).collect());

/// The real root of x^5 = x + 1. The multiples of its powers below 1 fill the unit cube of four dimensions evenly
/// (Roberts, *The unreasonable effectiveness of quasirandom sequences*, 2018).
const ROOT: f64 = 1.167_303_978_261_418_7;

impl Part {
    /// A part by its number: first the middle, then the sectors.
    fn new(part: usize, pattern: usize) -> Self {
        let rays = directions(part, PARTS * pattern + part);
        if part == 0 {
            return Self { axis: Vec3::Z, least_cosine: MIDDLE_COSINE, rays };
        }
        let angle = (part - 1) as f32 * SECTOR_ANGLE;
        let axis = (AXIS_SINE * Vec2::from_angle(angle)).extend(AXIS_COSINE);
        Self { axis, least_cosine: SECTOR_COSINE, rays }
    }
}

/// Angle of a sector about the normal, radians.
const SECTOR_ANGLE: f32 = std::f32::consts::TAU / (PARTS - 1) as f32;

/// The directions of a part, eight neighbours after each other. `number` selects a permutation.
fn directions(part: usize, number: usize) -> Vec<Vec3> {
    let count = if part == 0 { MIDDLE_RAYS } else { SECTOR_RAYS } as u32;
    let bits = count.ilog2();
    let random: [f64; 4] = std::array::from_fn(|axis| (number as f64 * ROOT.powi(-1 - axis as i32)).fract());
    let [flip, reversed_flip] = [0, 1].map(|i| (random[i] * f64::from(count)) as u32);
    let [offset, reversed_offset] = [2, 3].map(|i| random[i] as f32);
    let direction = |i: u32| {
        let along = ((i ^ flip) as f32 + offset) / count as f32;
        let around = ((i.reverse_bits() >> (32 - bits) ^ reversed_flip) as f32 + reversed_offset) / count as f32;
        let (spread, turn) = match part {
            0 => (MIDDLE_SHARE * along, std::f32::consts::TAU * around),
            _ => (MIDDLE_SHARE + (1.0 - MIDDLE_SHARE) * along, SECTOR_ANGLE * ((part - 1) as f32 + around - 0.5)),
        };
        (spread.sqrt() * Vec2::from_angle(turn)).extend((1.0 - spread).sqrt())
    };
    // The index modulo a power of two selects a piece of the turn, and the upper bits a piece of the spread.
    let pieces = count / 8;
    let columns = 1 << (pieces.ilog2() / 2);
    let mut order: Vec<u32> = (0..count).collect();
    order.sort_by_key(|i| (i % columns, i / (count * columns / pieces)));
    order.into_iter().map(direction).collect()
}

impl Hemisphere {
    /// The axis of each part, the least cosine of the angle between it and a ray, and the rays.
    fn parts(&self) -> impl Iterator<Item = (Vec3, f32, impl Iterator<Item = LightRay>)> {
        let normal = self.place.normal.as_dvec3();
        let [right, up] = basis(normal);
        let in_scene = move |v: Vec3| f64::from(v.x) * right + f64::from(v.y) * up + f64::from(v.z) * normal;
        let t_max = self.distance;
        PATTERN_PARTS[self.pattern % PATTERNS].iter().map(move |part| {
            let rays = part.rays.iter().map(move |&v| LightRay { direction: in_scene(v), t_max });
            (in_scene(part.axis).as_vec3(), part.least_cosine, rays)
        })
    }

    /// The rays over the hemisphere.
    pub(crate) fn rays(&self) -> impl Iterator<Item = LightRay> {
        self.parts().flat_map(|(_, _, rays)| rays)
    }
}

/// The instances that may occlude neighbouring places.
#[derive(Debug, Default)]
pub(crate) struct NearOccluders {
    /// Centre and radius of the last search.
    around: Option<(Vec3, f32)>,
    /// The instances that it found.
    found: NearInstances,
}

impl NearOccluders {
    /// Gathers the instances that rays over a hemisphere may hit.
    fn gather(&mut self, scene: &Scene, hemisphere: &Hemisphere, blocking: Blocking) {
        let (p, reach) = (hemisphere.place.p.as_vec3(), hemisphere.distance as f32 * (1.0 + ROUNDING));
        if self.around.is_some_and(|(center, radius)| radius == reach && center.distance(p) <= SHARED * reach) {
            return;
        }
        self.around = Some((p, reach));
        self.found.clear();
        scene.tree.near(p, (1.0 + SHARED + ROUNDING) * reach, |item| {
            if blocking.includes(&scene.instances[item as usize]) {
                let bounds = &scene.boxes[item as usize];
                self.found.push(item, 0.5 * (bounds.min + bounds.max), 0.5 * bounds.extent().length());
            }
        });
    }
}

impl TracedScene<'_> {
    /// Fraction of the rays over a hemisphere that pass all objects.
    pub(crate) fn open_share(&self, hemisphere: &Hemisphere, near: &mut NearOccluders, work: &mut LightWork) -> f32 {
        let mut sum = 0.0;
        self.pass_hemisphere(hemisphere, Blocking::All, near, |rays| {
            self.pass_far(rays);
            rays.iter().for_each(|ray| *work += ray.work);
            sum += rays.iter().map(|ray| ray.share).sum::<f32>();
        });
        sum / RAYS as f32
    }

    /// Fraction of each ray over a hemisphere that passes the triangles of meshes.
    pub(crate) fn open_past_faces(
        &self,
        hemisphere: &Hemisphere,
        near: &mut NearOccluders,
        work: &mut LightWork,
    ) -> [f32; RAYS] {
        let (mut past, mut first) = ([1.0; RAYS], 0);
        self.pass_hemisphere(hemisphere, Blocking::Faces, near, |rays| {
            for (past, ray) in past[first..].iter_mut().zip(rays.iter()) {
                *past = ray.share;
                work.steps += ray.work.steps;
            }
            first += rays.len();
        });
        past
    }

    /// Finds the fractions of the rays of each part of a hemisphere that pass the instances, and calls `visit` with
    /// them.
    fn pass_hemisphere(
        &self,
        hemisphere: &Hemisphere,
        blocking: Blocking,
        near: &mut NearOccluders,
        mut visit: impl FnMut(&mut [PlacedRay<'_>]),
    ) {
        let place = &hemisphere.place;
        near.gather(self.scene, hemisphere, blocking);
        let balls = near.found.above(place.p.as_vec3(), place.normal, hemisphere.distance as f32);
        for (axis, least_cosine, rays) in hemisphere.parts() {
            let balls = balls.iter().filter(|ball| ball.may_intersect(axis, least_cosine));
            let near = NearList::new(balls.map(|ball| ball.item).collect());
            let mut rays: Vec<PlacedRay<'_>> = rays.map(|ray| PlacedRay::new(self, place, ray)).collect();
            self.pass_rays(&near, &mut rays);
            visit(&mut rays);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::light_rays::SurfacePoint;
    use super::*;
    use glam::DVec3;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vec3> {
        (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    fn place(p: Vec3, normal: Vec3) -> SurfacePoint {
        let (p, lift) = (p.as_dvec3(), Vec3::ZERO);
        SurfacePoint { p, normal, own: 0, bias_voxels: 0.0, lift, skips_own: false }
    }

    #[test]
    fn the_density_of_rays_is_the_cosine() {
        let place = place(Vec3::ZERO, Vec3::Z);
        for pattern in 0..PATTERNS {
            let hemisphere = Hemisphere { place, distance: 1.0, pattern };
            let mean = hemisphere.rays().map(|ray| ray.direction).sum::<DVec3>() / RAYS as f64;
            // The mean direction is 2/3 of the normal; a stratum of the middle part has the width 1/32.
            assert!((mean - DVec3::new(0.0, 0.0, 2.0 / 3.0)).length() <= 1.0 / 32.0, "{pattern}: {mean}");
            assert_eq!(hemisphere.rays().count(), RAYS);
        }
    }

    proptest! {
        /// Every ball that a ray hits within the distance is tested by the rays of its part.
        #[test]
        fn no_ball_on_a_ray_is_left_out(
            centers in prop::collection::vec((vector(), 0.01..0.8f32), 1..20), p in vector(), toward in vector(),
            distance in 0.2..3.0f64, pattern in 0..PATTERNS
        ) {
            prop_assume!(toward.length() > 0.01);
            let place = place(p, toward.normalize());
            let hemisphere = Hemisphere { place, distance, pattern };
            let mut near = NearInstances::default();
            centers.iter().enumerate().for_each(|(i, &(center, radius))| near.push(i as u32, center, radius));
            let balls = near.above(p, place.normal, distance as f32);
            for (axis, least_cosine, rays) in hemisphere.parts() {
                let tested: Vec<u32> =
                    balls.iter().filter(|ball| ball.may_intersect(axis, least_cosine)).map(|ball| ball.item).collect();
                for ray in rays {
                    prop_assert!(ray.direction.dot(axis.as_dvec3()) >= f64::from(least_cosine) - 1e-6);
                    for (i, &(center, radius)) in centers.iter().enumerate() {
                        let to_center = center.as_dvec3() - place.p;
                        let along = to_center.dot(ray.direction).clamp(0.0, distance);
                        let is_hit = (to_center - along * ray.direction).length() <= f64::from(radius);
                        prop_assert!(!is_hit || tested.contains(&(i as u32)), "ball {i}");
                    }
                }
            }
        }
    }
}
