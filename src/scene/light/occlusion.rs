//! Ambient occlusion: the open fraction of wide cones over the hemisphere above a surface.
//!
//! # Theory
//!
//! The triangles of meshes are traced by rays ([`super::mesh_rays`]). This file evaluates the fields of all other
//! objects. [`AO_CONES`] cones cover the hemisphere. Each is evaluated like a cone of a soft shadow
//! ([`super::shadow`]), but only up to a given distance, and without the narrow cones that refine a penumbra.
//!
//! A wide cone may intersect many instances, so the instances near a place are gathered once for all of its cones. The
//! surface of each instance lies in a ball. Seen from the place, let the ball
//! have the radius `r`, the distance `c`, and the angle `A` from the axis of a cone. Its angular radius is `B`, with
//! `sin B = r / c`. The surface in it therefore passes the axis at
//!
//! ```text
//!   x >= sin(A - B) / slope      in radii of the cone, where A - B < 90 degrees; else it stays out of the cone
//! ```
//!
//! because the balls of radius `slope x t` about the axis fill the cone of half-angle `asin(slope x)`.
//!
//! The section of a cone is much wider than a small or distant instance, whose edge is no chord of it. The ball covers
//! at most `(sin B / slope)^2` of the section, and the instance covers no more ([`covered_by_ball`]). The cones
//! overlap, and light at the rim of a cone arrives at another angle than light along its axis. So the ratio of the form
//! factor of the ball to the part of all cones that it covers weighs the instance ([`ball_weight`]). An instance whose
//! ball covers little is not evaluated: it covers its mean fraction of the ball ([`crate::scene::content::ball`]). The
//! more of the section the ball covers, the more the edge of the instance counts.
//!
//! The fractions that the instances let pass multiply, as if the instances were independent. Where one instance blocks
//! the axis and others block the section beside its edge, they are not, and the cone is darker. It is never darker than
//! if no two instances overlapped.

use super::cone::{AO_SLOPE, BallAhead, ConeSum, WideCone, clearance, visible_share};
use super::light_rays::{Hemisphere, LightCone, LightRay, LightWork, SurfacePoint, basis};
use super::near_instances::{Beside, ConeOccluder, NearInstances, side_of_ball};
use super::occluder::bias;
use super::shadow::TracedScene;
use crate::gpu::constants::scene_beams::{AO_CONES, AO_RING_COSINE, AO_RING_SINE, LEAST_BALL, MOST_WEIGHT};
use crate::scene::content::model::Scene;
use crate::scene::content::tree::Line;
use crate::simd::with_vectors;
use glam::Vec3;

/// Relative margin for the rounding of distances and bounds.
const ROUNDING: f32 = 1e-5;

impl SurfacePoint {
    /// The cones over the hemisphere with their weights. Occluders within `distance`, scene units, count.
    pub fn open_rays(&self, distance: f64) -> impl Iterator<Item = (LightRay, f32)> {
        let normal = self.normal.as_dvec3();
        let [right, up] = basis(normal);
        (0..AO_CONES).map(move |i| {
            if i == 0 {
                return (LightRay { direction: normal, t_max: distance }, 1.0);
            }
            let angle = (i - 1) as f64 * (std::f64::consts::TAU / (AO_CONES - 1) as f64);
            let aside = angle.cos() * right + angle.sin() * up;
            let direction = f64::from(AO_RING_COSINE) * normal + f64::from(AO_RING_SINE) * aside;
            (LightRay { direction, t_max: distance }, AO_RING_COSINE)
        })
    }
}

/// Neighbouring surfaces share the search for their occluders: a search finds the occluders of all surfaces within this
/// fraction of its radius.
const SHARED: f32 = 0.25;

/// The instances that may occlude a place, with the positions of their balls relative to it.
#[derive(Debug, Default)]
pub(crate) struct Occluders {
    /// Centre and radius of the last search.
    around: Option<(Vec3, f32)>,
    /// The instances that it found.
    nearby: NearInstances,
    /// Vector from the place to the centre of the ball of each nearby instance.
    toward: [Vec<f32>; 3],
    /// Its squared length `c^2`.
    squared: Vec<f32>,
    /// Radius of the ball; 0 if the place is inside it.
    radius: Vec<f32>,
    /// Length of the tangent from the place to the ball; 0 inside the ball.
    tangent: Vec<f32>,
    /// `slope c^2`. A cone may intersect a ball whose bound is at most this. Below all bounds if no cone from the place
    /// can intersect the ball.
    limit: Vec<f32>,
    /// The axes of the cones and their weights.
    cones: [(Vec3, f32); AO_CONES],
    /// Weight of the ball ([`ball_weight`]); NaN until it is computed.
    weight: Vec<f32>,
    /// The instances that the current cone may meet. The evaluated ones are at the end.
    candidates: Vec<ConeOccluder>,
    /// The meshes that the last search found, whose triangles are traced.
    meshes: NearInstances,
}

/// Where occluders of a place may be, scene units.
#[derive(Debug, Clone, Copy)]
struct Region {
    p: Vec3,
    /// Direction of the hemisphere.
    normal: Vec3,
    /// Largest distance from `p`.
    reach: f32,
    /// Largest distance below the plane through `p`.
    depth: f32,
}

/// The balls of some instances as seen from a place: see the fields of [`Occluders`].
struct BallsAround<'a> {
    toward: [&'a mut [f32]; 3],
    squared: &'a mut [f32],
    radius: &'a mut [f32],
    tangent: &'a mut [f32],
    limit: &'a mut [f32],
}

impl BallsAround<'_> {
    #[inline(always)]
    fn update(self, [x, y, z, radii]: [&[f32]; 4], region: &Region) {
        let Region { p, normal, reach, depth } = *region;
        let n = radii.len();
        let [way_x, way_y, way_z] = self.toward.map(|along| &mut along[..n]);
        let (squared, radius, tangent) = (&mut self.squared[..n], &mut self.radius[..n], &mut self.tangent[..n]);
        let (limit, x, y, z) = (&mut self.limit[..n], &x[..n], &y[..n], &z[..n]);
        for i in 0..n {
            let toward = [x[i] - p.x, y[i] - p.y, z[i] - p.z];
            let c_squared = toward[0] * toward[0] + toward[1] * toward[1] + toward[2] * toward[2];
            let height = toward[0] * normal.x + toward[1] * normal.y + toward[2] * normal.z;
            let farthest = reach + radii[i];
            let is_near = (height + radii[i] >= -depth) & (c_squared <= farthest * farthest);
            let tangent_squared = c_squared - radii[i] * radii[i];
            // Inside a ball all values are 0, and so is the bound.
            let is_outside = tangent_squared > ROUNDING * c_squared;
            (way_x[i], way_y[i], way_z[i]) = (toward[0], toward[1], toward[2]);
            squared[i] = c_squared;
            radius[i] = if is_outside { radii[i] } else { 0.0 };
            tangent[i] = if is_outside { tangent_squared.sqrt() } else { 0.0 };
            limit[i] = if is_near { AO_SLOPE * c_squared } else { f32::NEG_INFINITY };
        }
    }
}

/// Number of balls that are bounded together.
const LANES: usize = 8;

/// Balls as seen from a place, for reading: see the fields of [`Occluders`]. Their number is a multiple of [`LANES`].
struct BallBounds<'a> {
    toward: [&'a [f32]; 3],
    squared: &'a [f32],
    radius: &'a [f32],
    tangent: &'a [f32],
    limit: &'a [f32],
}

impl BallBounds<'_> {
    /// Appends the balls that a cone with this axis may meet to `candidates`.
    #[inline(always)]
    fn find_candidates(&self, axis: Vec3, candidates: &mut Vec<ConeOccluder>) {
        let Self { toward: [x, y, z], squared, radius, tangent, limit } = self;
        let [x, y, z] = [x.as_chunks::<LANES>().0, y.as_chunks().0, z.as_chunks().0];
        let [squared, radius] = [squared.as_chunks::<LANES>().0, radius.as_chunks().0];
        let [tangent, limit] = [tangent.as_chunks::<LANES>().0, limit.as_chunks().0];
        let balls = x.iter().zip(y).zip(z).zip(squared).zip(radius).zip(tangent).zip(limit);
        for (chunk, ((((((x, y), z), squared), radius), tangent), limit)) in balls.enumerate() {
            // Lower bounds of the distance between the axis and the ball, times `slope c^2`.
            let mut bounds = [0.0f32; LANES];
            let mut mask = 0u32;
            for i in 0..LANES {
                let along = x[i] * axis.x + y[i] * axis.y + z[i] * axis.z;
                let [_, sine, cosine] = side_of_ball(along, squared[i], radius[i], tangent[i]);
                let is_behind = cosine < -ROUNDING * squared[i];
                bounds[i] = if is_behind { f32::INFINITY } else { sine - ROUNDING * squared[i] };
                mask |= u32::from(bounds[i] <= limit[i]) << i;
            }
            while mask != 0 {
                let i = mask.trailing_zeros() as usize;
                mask &= mask - 1;
                // Inside a ball both are 0, and there is no bound.
                let x = if tangent[i] > 0.0 { bounds[i] / limit[i] } else { -1.0 };
                candidates.push(ConeOccluder { x, index: (LANES * chunk + i) as u32 });
            }
        }
    }
}

impl Occluders {
    /// Relates the balls of the nearby instances to a place.
    fn relate(&mut self, region: &Region) {
        let n = self.nearby.items.len();
        let Self { nearby, toward: [x, y, z], squared, radius, tangent, limit, weight, .. } = self;
        for values in [&mut *x, y, z, squared, radius, tangent] {
            values.resize(n.next_multiple_of(LANES), 0.0);
        }
        limit.clear();
        limit.resize(n.next_multiple_of(LANES), f32::NEG_INFINITY);
        weight.clear();
        weight.resize(n, f32::NAN);
        let around = BallsAround { toward: [x, y, z], squared, radius, tangent, limit };
        with_vectors!((around: BallsAround<'_> = around, balls: [&[f32]; 4] = nearby.balls(), region: &Region = region) {
            around.update(balls, region)
        })
    }

    /// The part of a cone that the ball of a nearby instance covers. `reach` is the length of the cone.
    #[inline]
    fn ball(&mut self, i: usize, direction: Vec3, reach: f32) -> CoveringBall {
        let Self { toward: [x, y, z], squared, radius, cones, weight, .. } = self;
        let (toward, squared) = (Vec3::new(x[i], y[i], z[i]), squared[i]);
        let along = toward.dot(direction);
        // Inside a ball the radius is 0, and the ball bounds nothing.
        let (covered, weight) = match radius[i] {
            0.0 => (1.0, 1.0),
            radius => {
                if weight[i].is_nan() {
                    weight[i] = ball_weight(cones, toward, radius);
                }
                (within_reach(squared, radius, reach) * covered_by_ball(along, squared, radius), weight[i])
            }
        };
        CoveringBall { along, squared, covered, weight }
    }

    /// The instances beside an occluder in a cone.
    fn beside(&self, slope: f32) -> Beside<'_> {
        Beside { nearby: &self.nearby, candidates: &self.candidates, slope }
    }

    /// Finds the instances that a cone may intersect.
    fn find_candidates(&mut self, axis: Vec3) {
        let Self { toward: [x, y, z], squared, radius, tangent, limit, candidates, .. } = self;
        candidates.clear();
        let balls = BallBounds { toward: [x, y, z], squared, radius, tangent, limit };
        with_vectors!((balls: BallBounds<'_> = balls, axis: Vec3 = axis, candidates: &mut Vec<ConeOccluder> = candidates) {
            balls.find_candidates(axis, candidates)
        })
    }
}

/// The ball around the surface of a nearby instance, beside the axis of a cone.
struct CoveringBall {
    /// Position of the centre along the axis, and its squared distance from the apex, scene units.
    along: f32,
    squared: f32,
    /// Largest fraction of the section of the cone that the ball covers within the reach of the cone.
    covered: f32,
    /// Factor of the covered fraction, see [`ball_weight`].
    weight: f32,
}

/// Largest fraction of a cone's section that a ball covers: its own disc, as far as it lies within the rim of the cone,
/// which is nearly straight there. The chord at the ball's edge bounds a large ball. `along` is the position of the
/// centre along the axis, `squared` its squared distance, and the apex is outside the ball.
fn covered_by_ball(along: f32, squared: f32, radius: f32) -> f32 {
    let tangent = (squared - radius * radius).max(0.0).sqrt();
    let [from_axis, sine, cosine] = side_of_ball(along, squared, radius, tangent);
    if cosine < 0.0 {
        return 0.0;
    }
    let x = sine / (AO_SLOPE * squared);
    let aside = if along > 0.0 { from_axis } else { squared.sqrt() };
    let within = visible_share((AO_SLOPE * squared.sqrt() - aside) / radius);
    let disc = radius * radius / (AO_SLOPE * AO_SLOPE * squared);
    (disc * within).min(1.0 - visible_share(x))
}

/// Fraction of the front of a ball that is within a distance of the apex. The front spans about a radius.
fn within_reach(squared: f32, radius: f32, reach: f32) -> f32 {
    ((reach + radius - squared.sqrt()) / radius).clamp(0.0, 1.0)
}

/// Fraction of the light from a uniform hemisphere that a ball blocks: its form factor. `height` is the cosine of the
/// angle between the normal and the centre of the ball, `size` the sine of the ball's angular radius. The part below
/// the horizon blocks nothing (Snyder, *Area light sources for real-time graphics*, Microsoft Research 1996).
fn form_factor(height: f32, size: f32) -> f32 {
    let squared = size * size;
    let above = squared - height * height;
    if above <= 0.0 || squared >= 1.0 {
        return height.max(0.0) * squared;
    }
    let (cosine, cut) = ((1.0 - squared).sqrt(), above.sqrt());
    let rim = (-height * cosine / (size * (1.0 - height * height).sqrt())).clamp(-1.0, 1.0).acos();
    ((squared * height * rim - cut * cosine + (cut / cosine).atan()) / std::f32::consts::PI).max(0.0)
}

/// Ratio of the form factor of a ball to the weighted fraction that it covers of the cones from a place. Cones that
/// overlap, and light at their rims that arrives at another angle than on their axes, make it differ from 1. `toward`
/// is the vector to the centre of the ball, and the place is outside of it.
fn ball_weight(cones: &[(Vec3, f32); AO_CONES], toward: Vec3, radius: f32) -> f32 {
    let squared = toward.length_squared();
    let (mut covered, mut weights) = (0.0, 0.0);
    for &(axis, weight) in cones {
        covered += weight * covered_by_ball(toward.dot(axis), squared, radius);
        weights += weight;
    }
    let (distance, normal) = (squared.sqrt(), cones[0].0);
    let factor = form_factor(toward.dot(normal) / distance, radius / distance);
    if factor * weights < MOST_WEIGHT * covered { factor * weights / covered } else { MOST_WEIGHT }
}

impl TracedScene<'_> {
    /// Fraction of a hemisphere that no occluder covers.
    pub(crate) fn open_share(
        &self,
        hemisphere: &Hemisphere<'_>,
        occluders: &mut Occluders,
        work: &mut LightWork,
    ) -> f32 {
        let past_faces = self.open_past_faces(hemisphere, occluders, work);
        let &Hemisphere { place, distance, .. } = hemisphere;
        let (mut sum, mut weights) = (0.0, 0.0);
        for ((ray, weight), past_faces) in place.open_rays(distance).zip(past_faces) {
            if past_faces > 0.0 {
                sum += weight * past_faces * self.wide_share(place, &ray, occluders, work);
            }
            weights += weight;
        }
        sum / weights
    }

    /// Fraction of each part of a hemisphere that passes the triangles of meshes. Gathers the occluders of its place.
    pub(crate) fn open_past_faces(
        &self,
        hemisphere: &Hemisphere<'_>,
        occluders: &mut Occluders,
        work: &mut LightWork,
    ) -> [f32; AO_CONES] {
        self.gather(hemisphere.place, hemisphere.distance, occluders);
        self.hemisphere_past(&occluders.meshes, hemisphere, work)
    }

    /// Gathers the instances that cones over the hemisphere above a place may meet.
    ///
    /// A cone ends at `distance` with the radius `slope distance`. So it intersects no surface beyond
    /// `distance (1 + slope)`, and no surface below the lowest point of the balls about the axes of the ring.
    pub(crate) fn gather(&self, place: &SurfacePoint, distance: f64, occluders: &mut Occluders) {
        let Scene { tree, instances, .. } = self.scene;
        let p = place.p.as_vec3();
        let reach = distance as f32 * (1.0 + AO_SLOPE) * (1.0 + ROUNDING);
        let depth = distance as f32 * (AO_SLOPE - AO_RING_COSINE) + ROUNDING * reach;
        let balls = self.scene.balls();
        if !occluders.around.is_some_and(|(center, radius)| radius == reach && center.distance(p) <= SHARED * reach) {
            occluders.around = Some((p, reach));
            occluders.nearby.clear();
            occluders.meshes.clear();
            tree.near(p, (1.0 + SHARED + ROUNDING) * reach, |item| {
                let instance = &instances[item as usize];
                if instance.casting_triangles().is_some() {
                    // The field of a mesh lacks its thin parts, and its ball may be too small.
                    let bounds = &self.scene.boxes[item as usize];
                    occluders.meshes.push(item, 0.5 * (bounds.min + bounds.max), 0.5 * bounds.extent().length());
                } else if instance.casting_field().is_some() {
                    let ball = &balls[item as usize];
                    occluders.nearby.push(item, ball.center, ball.radius);
                }
            });
        }
        for (cone, (ray, weight)) in occluders.cones.iter_mut().zip(place.open_rays(distance)) {
            *cone = (ray.direction.as_vec3(), weight);
        }
        occluders.relate(&Region { p, normal: place.normal, reach, depth });
    }

    /// Fraction of the section of a cone of slope [`AO_SLOPE`] that passes the occluders of its place, if edges in it
    /// are straight.
    pub(crate) fn wide_share(
        &self,
        place: &SurfacePoint,
        ray: &LightRay,
        occluders: &mut Occluders,
        work: &mut LightWork,
    ) -> f32 {
        let slope = AO_SLOPE;
        let cone = LightCone { place, ray, slope };
        let direction = ray.direction.as_vec3();
        let split = self.split(place, ray, slope);
        let reach = self.reach(&split, ray);
        let line = Line::cone(place.p.as_vec3(), direction, slope);
        occluders.find_candidates(direction);
        let mut sum = ConeSum::NEW;
        // The fraction that all instances without thin rays let pass, each beside the others, and the sum of the
        // fractions that they block.
        let (mut passes, mut blocked) = (1.0f32, 0.0f32);
        for row in 0..occluders.candidates.len() {
            let nearest = occluders.candidates[row];
            let item = occluders.nearby.items[nearest.index as usize];
            let instance = &self.scene.instances[item as usize];
            let bounds = &self.scene.boxes[item as usize];
            if nearest.x >= 1.0 || line.span(bounds.min, bounds.max, reach).is_none() {
                continue;
            }
            let CoveringBall { along, squared, covered, weight } =
                occluders.ball(nearest.index as usize, direction, ray.t_max as f32);
            let prefers_rays = instance.field.as_ref().is_some_and(|field| field.prefers_rays());
            let fill = self.scene.balls()[item as usize].fill;
            let block = |covered: f32| instance.shade * (weight * covered).min(1.0);
            if covered <= LEAST_BALL && !prefers_rays {
                let own = block(fill * covered);
                passes *= 1.0 - own;
                blocked += own;
                continue;
            }
            // The own field is evaluated from a point that is moved off the surface.
            let moved = if item == place.own { bias(instance, place) } else { 0.0 };
            let ball = BallAhead { along, squared, radius: self.scene.balls()[item as usize].radius + moved };
            let wide = WideCone { beside: occluders.beside(slope), least_x: nearest.x, ball };
            // The sum has the thin rays of all instances, and nothing of the others.
            let (mut found, mut beside, mut own) = (1.0f32, 1.0f32, ConeSum::NEW);
            for occluder in self.occluders(item, place, ray, &split) {
                let into = if prefers_rays { &mut sum } else { &mut own };
                let past = self.add_cone(&occluder, cone, 1.0, Some(&wide), into, work);
                (found, beside) = (found.min(past.x), beside.min(past.beside));
            }
            if !prefers_rays {
                let hidden = 1.0 - visible_share(found);
                // A ball that covers little has no straight edge in the cone.
                let by_edge = (covered - LEAST_BALL) / (1.0 - LEAST_BALL);
                let mean = fill * covered;
                let own = block(mean + by_edge * (hidden.min(covered) - mean));
                passes *= (1.0 - own) * (1.0 - instance.shade * (1.0 - beside));
                blocked += own;
                if passes <= 0.0 && blocked >= 1.0 {
                    break;
                }
            }
            // Behind the start of a far field a cone and a ray in it end at different positions.
            if self.far.is_none() {
                occluders.candidates[row].x = nearest.x.max(clearance(found));
            }
        }
        let wide = WideCone { beside: occluders.beside(slope), least_x: -1.0, ball: BallAhead::ENDLESS };
        let is_far = self.add_far(&split, cone, Some(&wide), &mut sum, work);
        work.count(is_far);
        passes.max(1.0 - blocked) * sum.share().share
    }
}

#[cfg(test)]
mod tests {
    use super::super::light_rays::GOLDEN_ANGLE;
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vec3> {
        (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    /// Small balls, balls cut by the horizon, and a ball that fills nearly half of the space, beside a sum over a
    /// spiral of directions whose density is the cosine.
    #[test]
    fn form_factors_are_those_of_rays() {
        for (height, size) in [(0.9, 0.1), (0.3, 0.5), (-0.2, 0.6), (0.0, 0.3), (0.5, 0.9), (0.95, 0.99), (-0.7, 0.6)] {
            let center = Vec3::new((1.0f32 - height * height).sqrt(), 0.0, height);
            let is_hit = |i: u32| {
                let spread = (i as f32 + 0.5) / 40_000.0;
                let aside = spread.sqrt() * Vec3::from((glam::Vec2::from_angle(GOLDEN_ANGLE * i as f32), 0.0));
                (aside + Vec3::Z * (1.0 - spread).sqrt()).dot(center) >= (1.0f32 - size * size).sqrt()
            };
            let share = (0..40_000).filter(|&i| is_hit(i)).count() as f32 / 40_000.0;
            let factor = form_factor(height, size);
            assert!((factor - share).abs() <= 0.003, "{height} {size}: {factor} {share}");
        }
    }

    proptest! {
        /// The distance of a ball from the axis of a cone is never less than its bound, and all balls that a cone meets
        /// are found.
        #[test]
        fn bounds_hold(centers in prop::collection::vec((vector(), 0.01..0.8f32), 1..20), p in vector(), toward in vector()) {
            prop_assume!(toward.length() > 0.01);
            let direction = toward.normalize();
            let mut occluders = Occluders::default();
            for (i, &(center, radius)) in centers.iter().enumerate() {
                occluders.nearby.push(i as u32, center, radius);
            }
            let everywhere = Region { p, normal: Vec3::Z, reach: 1e3, depth: 1e3 };
            occluders.relate(&everywhere);
            occluders.find_candidates(direction);
            for (i, &(center, radius)) in centers.iter().enumerate() {
                let x_at = |t: f32| ((center - p - t * direction).length() - radius) / (AO_SLOPE * t);
                let nearest = (1..2000).map(|i| x_at(i as f32 * 0.003)).fold(f32::INFINITY, f32::min);
                match occluders.candidates.iter().find(|candidate| candidate.index as usize == i) {
                    Some(candidate) => prop_assert!(candidate.x <= nearest.max(-1.0) + 1e-4, "{candidate:?} {nearest}"),
                    None => prop_assert!(nearest >= 1.0 - 1e-4, "{nearest}"),
                }
            }
            // `Beside::along` visits every ball that a narrow cone off the axis intersects.
            let offset = 0.9 * AO_SLOPE;
            let past = (direction + offset * direction.any_orthonormal_vector()).normalize();
            let mut visited = Vec::new();
            let beside = Beside { nearby: &occluders.nearby, candidates: &occluders.candidates, slope: AO_SLOPE };
            beside.along(p, past, offset, 0.1, |item| { visited.push(item as usize); true });
            for (i, &(center, radius)) in centers.iter().enumerate() {
                let t = (center - p).dot(past).max(0.0);
                let width = 0.1 * t / (1.0 + offset * offset).sqrt();
                prop_assert!(visited.contains(&i) || (center - p - t * past).length() >= (radius + width) * (1.0 - 1e-3));
            }
        }
    }
}
