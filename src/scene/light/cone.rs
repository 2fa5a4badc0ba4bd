//! Cones past fields: the nearest edge to the axis of a cone, and the fraction of the cone's section that it leaves
//! open.
//!
//! [`super::shadow`] explains their use.

use super::near_instances::Beside;
use super::ray_bundle::RayBundle;
use crate::gpu::constants::scene_beams::{
    EDGE_COSINE, EDGE_DIRECTIONS, FULL_CLEARANCE, MAX_CONE_STEPS, PAST_EDGE, WIDE_STEP,
};
use crate::scene::content::instance::Instance;
use crate::scene::fields::field::Field;
use glam::{DVec3, Vec3};

/// Result of a cone past one instance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Cone {
    /// Signed distance of the nearest edge from the axis in radii, from -1 to 1.
    pub x: f32,
    /// Whether the whole section of the cone was inside the solid at some distance.
    pub is_covered: bool,
    /// Fraction of the section beside the instance that others leave open at its edge; 1 except for wide cones.
    pub beside: f32,
}

impl Cone {
    pub(crate) const FREE: Self = Self { x: 1.0, is_covered: false, beside: 1.0 };
    pub(crate) const COVERED: Self = Self { x: -1.0, is_covered: true, beside: 1.0 };
}

/// Lower bound of the distance between a free axis and a surface, in radii, for the estimate `x` of
/// [`ConeWalk::beside_wide`].
pub(crate) fn clearance(x: f32) -> f32 {
    if x >= 1.0 { 1.0 } else { (x.max(0.0) * x - WIDE_STEP * WIDE_STEP / 4.0).max(0.0).sqrt() }
}

/// Margin for the rounding of an edge's position, in radii.
const RIM_ROUNDING: f32 = 1e-5;

/// The visible fraction of a disc when an edge passes at `x` radii from its centre; negative `x` if the edge covers the
/// centre.
///
/// `1/2 + (asin x + x sqrt(1 - x^2)) / pi` by its series, accurate to 0.004. The last term is chosen so that the series
/// is 1 at x = 1.
pub(crate) fn visible_share(x: f32) -> f32 {
    // An edge that rounding has moved slightly inside the rim counts as on the rim. So dark is exactly 0 and lit is
    // exactly 1.
    let x = ((1.0 + RIM_ROUNDING) * x).clamp(-1.0, 1.0);
    if x.abs() == 1.0 {
        return 0.5 + 0.5 * x;
    }
    let s = x * x;
    0.5 + x * (std::f32::consts::FRAC_2_PI - s * (0.106_10 + s * (0.015_92 + s * 0.014_60)))
}

/// Result of a walk that looks for any edge in a cone.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Decision {
    /// No surface enters the cone.
    Free,
    /// The axis is free, and a surface enters the cone.
    Edge,
    /// The axis enters the object at this position.
    Blocked(f32),
}

/// Result of a cone to a light.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ConeShare {
    pub share: f32,
    pub is_proven: bool,
}

/// Accumulated results of a cone.
pub(crate) struct ConeSum {
    /// Fraction that translucent instances let pass.
    translucent: f32,
    /// Whether opaque instances cover the cone completely.
    is_proven: bool,
    /// The nearest edge of the opaque instances.
    pub opaque: Cone,
    /// Fractions of the thin rays, for instances that are tested by rays.
    pub thin: RayBundle,
}

/// Sine of half the angle of a wide cone, 30 degrees: seven such cones just cover a hemisphere. The balls of this
/// radius per distance about the axis touch the plane of the surface.
pub(crate) const AO_SLOPE: f32 = 0.5;
/// Tangent of half the angle, for rays in the cone.
pub(crate) const AO_TANGENT: f32 = 0.577_350_3;

/// A wide cone of occlusion, with bounds of the instance that it passes ([`ConeWalk::beside_wide`]).
#[derive(Clone, Copy)]
pub(crate) struct WideCone<'a> {
    /// The instances that rays past the cone's edges may meet.
    pub beside: Beside<'a>,
    /// Lower bound, in radii, of the distance between a free axis and the surface of the instance. Distances of its
    /// field may be loose bounds. A positive value proves that the axis is free.
    pub least_x: f32,
    pub ball: BallAhead,
}

/// The ball around the surface of an instance beside the axis of a cone, scene units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct BallAhead {
    /// Position of the ball's centre along the axis, and its squared distance from the apex.
    pub along: f32,
    pub squared: f32,
    pub radius: f32,
}

impl BallAhead {
    /// An unbounded surface.
    pub(crate) const ENDLESS: Self = Self { along: 0.0, squared: 0.0, radius: f32::INFINITY };

    /// The largest depth inside this ball of points of the axis at `t` and beyond, in radii `slope t`. Infinite before
    /// the middle of the ball.
    fn depth_beyond(&self, t: f32, slope: f32) -> f32 {
        let distance = (self.squared + t * (t - 2.0 * self.along)).max(0.0).sqrt();
        if t < self.along { f32::INFINITY } else { ((1.0 + BALL_ROUNDING) * self.radius - distance) / (slope * t) }
    }

    /// Whether balls of radius `slope s` about the axis stay clear of this ball for all `s >= t`. Their distance is
    /// convex in `s`, so it suffices that it is positive and does not decrease at `t`.
    fn is_passed(&self, t: f32, slope: f32) -> bool {
        let distance = (self.squared + t * (t - 2.0 * self.along)).max(0.0).sqrt();
        t - self.along >= slope * distance && distance >= (1.0 + BALL_ROUNDING) * (self.radius + slope * t)
    }
}

/// Relative margin for the rounding of the distance between two balls.
const BALL_ROUNDING: f32 = 1e-3;

impl ConeSum {
    pub(crate) const NEW: Self = Self { translucent: 1.0, is_proven: true, opaque: Cone::FREE, thin: RayBundle::NEW };

    /// Distance from the axis, in radii, within which another instance can change the result.
    pub(crate) fn x_limit(&self, instance: &Instance) -> f32 {
        if instance.is_opaque_solid() { self.opaque.x } else { 1.0 }
    }

    /// Adds the result of one more instance.
    pub(crate) fn add(&mut self, instance: &Instance, cone: Cone) {
        if instance.shade < 1.0 {
            self.translucent *= 1.0 - instance.shade * (1.0 - visible_share(cone.x));
            self.is_proven &= cone.is_covered || cone.x >= 1.0;
        } else {
            self.opaque.x = self.opaque.x.min(cone.x);
            self.opaque.is_covered |= cone.is_covered;
        }
    }

    pub(crate) fn share(&self) -> ConeShare {
        if self.opaque.is_covered {
            return ConeShare { share: 0.0, is_proven: true };
        }
        ConeShare {
            share: self.translucent * visible_share(self.opaque.x) * self.thin.share(),
            is_proven: self.is_proven && self.opaque.x >= 1.0 && !self.thin.is_tested,
        }
    }
}

/// Fraction of a value by which a ball is free if neighbouring samples differ by at most 1 + 1/64 of their distance,
/// also along diagonals. A direction is at most 27.6 degrees from one of these, so a linear field is at most 1.0157 /
/// cos(27.6 degrees) = 1 / 0.872 times as steep as a distance.
const FREE_SHARE: f32 = 0.87;

/// Largest number of steps of a proof for a tile. Longer walks prove little.
const MAX_TILE_STEPS: u32 = 32;

/// One cone past one instance, in its field space.
pub(crate) struct ConeWalk<'a> {
    pub field: &'a dyn Field,
    pub instance: &'a Instance,
    /// Origin and direction of the axis: `t` is 0 at the origin.
    pub ray: (DVec3, DVec3),
    pub start: Vec3,
    pub direction: Vec3,
    pub enter: f32,
    pub leave: f32,
    pub slope: f32,
    /// Number of scene units that a ray may advance for one local unit of distance.
    pub pace: f32,
    /// Half a voxel, scene units.
    pub least_step: f32,
    /// Whether steps may cross the surface, so that the axis is traced from its start.
    traces_first: bool,
}

impl<'a> ConeWalk<'a> {
    /// A walk along the ray `axis` in field space, whose part from `enter` to `leave` passes the object; `direction` is
    /// its unit direction in the scene. All positions are in scene units.
    pub(crate) fn new(
        field: &'a dyn Field,
        instance: &'a Instance,
        axis: (DVec3, DVec3),
        [enter, leave]: [f64; 2],
        direction: DVec3,
        slope: f32,
    ) -> Self {
        Self {
            field,
            instance,
            ray: axis,
            // From the entry on, float32 is sufficient.
            start: (axis.0 + enter * axis.1).as_vec3(),
            direction: axis.1.as_vec3(),
            enter: enter as f32,
            leave: leave as f32,
            slope,
            pace: 1.0 / (instance.local_from_scene * direction.as_vec3()).length(),
            least_step: 0.5 / axis.1.length() as f32,
            traces_first: field.may_exceed_distance(),
        }
    }
}

impl ConeWalk<'_> {
    /// Whether distances prove that no surface comes within `radius + slope t` of the axis. The field must be
    /// [`Field::is_lipschitz`]: a ball around a point of the axis is free up to [`FREE_SHARE`] of the distance there,
    /// less half a voxel.
    pub(crate) fn is_free_of(&self, radius: f32) -> bool {
        let mut t = self.enter;
        for _ in 0..MAX_TILE_STEPS {
            let clear = self.field.distance(self.at(t)) * self.instance.stretch[0];
            let step = (FREE_SHARE * clear - radius - self.slope * t) / (1.0 + self.slope) - self.least_step;
            if step < self.least_step || step.is_nan() {
                return false;
            }
            t += step;
            if t >= self.leave {
                return true;
            }
        }
        false
    }

    fn at(&self, t: f32) -> Vec3 {
        self.start + (t - self.enter) * self.direction
    }

    /// Scene distance across the ray for a local distance at a point.
    fn across(&self, distance: f32, p: Vec3) -> f32 {
        if self.instance.is_uniform() {
            return distance * self.instance.stretch[0];
        }
        // The plane through the nearest point: its scene normal is L^T times the local one.
        let normal = self.instance.local_from_scene.transpose() * self.field.gradient(p);
        let length = normal.length();
        if length > 0.0 { distance / length } else { distance * self.instance.stretch[0] }
    }

    /// The step from a point from which the ray may advance by `free`, where the cone has this radius. Near a surface,
    /// half steps find the closest approach to 3 %.
    fn step(&self, free: f32, radius: f32) -> f32 {
        let share = if free < 2.0 * radius { 0.5 } else { 1.0 };
        (share * free).max(self.least_step)
    }

    /// The smallest clearance of the axis in radii, at most `x_limit`. If the axis enters the object, returns the
    /// position of the entry as an error.
    ///
    /// Steps of the whole distance or less cannot cross the surface. The shortest step, half a voxel, may cross a thin
    /// wall. Before the first step that is longer than the distance, `hit_from` traces the axis from the previous step;
    /// where values may exceed the distance, it does so from the start.
    pub(crate) fn beside(
        &self,
        x_limit: f32,
        steps: &mut u32,
        mut hit_from: impl FnMut(f32) -> Option<f32>,
    ) -> Result<f32, f32> {
        let (mut x, mut is_free) = (x_limit, false);
        let (mut t, mut step) = (self.enter, 0.0f32);
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let radius = self.slope * t;
            let distance = self.field.distance(p);
            let free = distance * self.pace;
            if (free < self.least_step || self.traces_first) && !is_free {
                if let Some(t_hit) = hit_from(t - step) {
                    return Err(t_hit);
                }
                is_free = true;
            }
            if distance * self.instance.stretch[0] < x * radius {
                let clear = self.across(self.field.distance_guess(p, distance).max(0.0), p);
                x = x.min(clear / radius);
                if x <= 0.0 {
                    break;
                }
            }
            step = self.step(free, radius);
            t += step;
            if t >= self.leave {
                return Ok(x);
            }
        }
        let found = if is_free { None } else { hit_from(t - step) };
        found.map_or(Ok(x), Err)
    }

    /// Whether the cone stays free of the object ([`Decision::Free`]), as [`Self::beside`] would find with `x_limit` 1.
    /// The walk ends at the first edge in the cone. `hit_from` traces the axis, as there.
    pub(crate) fn decide(&self, steps: &mut u32, mut hit_from: impl FnMut(f32) -> Option<f32>) -> Decision {
        let mut is_free = false;
        let (mut t, mut step) = (self.enter, 0.0f32);
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let radius = self.slope * t;
            let distance = self.field.distance(p);
            let free = distance * self.pace;
            let has_edge = distance * self.instance.stretch[0] < radius
                && self.across(self.field.distance_guess(p, distance).max(0.0), p) / radius < 1.0;
            if (has_edge || free < self.least_step || self.traces_first) && !is_free {
                if let Some(t_hit) = hit_from(t - step) {
                    return Decision::Blocked(t_hit);
                }
                is_free = true;
            }
            if has_edge {
                return Decision::Edge;
            }
            step = self.step(free, radius);
            t += step;
            if t >= self.leave {
                return Decision::Free;
            }
        }
        let found = if is_free { None } else { hit_from(t - step) };
        found.map_or(Decision::Free, Decision::Blocked)
    }

    /// The smallest clearance of a wide cone of occlusion in radii, at most 1. If the axis enters the object, returns
    /// the position of the entry as an error.
    ///
    /// A step is the whole distance. The balls around the two ends of such a step are free of the surface and touch it.
    /// They intersect in a circle of radius `c` about the axis, and `c` is taken as the closest approach between them
    /// (Aaltonen, GDC 2018). It is exact for a point or an edge, and at most 13 % too low for a plane. Near the
    /// surface, steps are at least two fifths of a radius. There an approach to the fraction `x` of the radius may be
    /// estimated as `sqrt(x^2 + 1/25)`.
    ///
    /// Steps of the whole distance cannot cross the surface. Before the first longer step, `hit_from` traces the axis
    /// from the previous step. An axis that is known to be free is not traced. The walk ends where the rest of the cone
    /// cannot come closer to the surface, nor closer than the known edge at `x_limit`.
    pub(crate) fn beside_wide(
        &self,
        wide: &WideCone<'_>,
        x_limit: f32,
        steps: &mut u32,
        mut hit_from: impl FnMut(f32) -> Option<f32>,
    ) -> Result<f32, f32> {
        let mut x = 1.0f32;
        let mut t = self.enter;
        let mut is_free = wide.least_x > 0.0;
        // The step that led to `t`, and the clearance before it.
        let (mut step, mut before) = (0.0f32, 0.0f32);
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let radius = self.slope * t;
            let distance = self.field.distance(p);
            let free = distance * self.pace;
            let next = free.max(WIDE_STEP * radius).max(self.least_step);
            if next > free && !is_free && t < self.leave {
                if let Some(t_hit) = hit_from(t - step) {
                    return Err(t_hit);
                }
                is_free = true;
            }
            let mut clear = distance * self.instance.stretch[0];
            if clear < x * radius {
                clear = self.across(self.field.distance_guess(p, distance).max(0.0), p);
                x = x.min(clear / radius);
            }
            let along = (before * before - clear * clear + step * step) / (2.0 * step);
            if step > 0.0 && step <= before && along > 0.0 && along < step {
                let closest = (before * before - along * along).max(0.0).sqrt();
                x = x.min(closest / (self.slope * (t - step + along)));
            }
            if t >= self.leave {
                break;
            }
            before = clear;
            // The last evaluation is at the end, so that an approach there enters the result without a jump.
            (step, t) = if t + next < self.leave { (next, t + next) } else { (self.leave - t, self.leave) };
            if wide.ball.is_passed(t, self.slope * x.min(x_limit).max(0.0)) {
                break;
            }
        }
        Ok(x)
    }

    /// The axis enters the solid at `t_hit`. Returns the signed distance of the nearest edge in radii, at most 0, and
    /// the position of the deepest point, to which that distance belongs. At -1 or below the solid covers the whole
    /// section, and the walk ends there. `ball` contains the surface, if such a ball is known.
    pub(crate) fn inside(&self, t_hit: f32, ball: Option<&BallAhead>, steps: &mut u32) -> (f32, f32) {
        // Under a non-uniform scale the depth is an estimate, which the ball does not bound.
        let ball = ball.filter(|_| self.instance.is_uniform());
        let mut deepest = (0.0f32, t_hit);
        // Immediately behind the surface, where the field is below zero.
        let mut t = t_hit + 0.5 * self.least_step;
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let distance = self.field.distance(p);
            if distance >= 0.0 {
                break;
            }
            let x = self.across(distance, p) / (self.slope * t);
            if x < deepest.0 {
                deepest = (x, t);
            }
            if x <= -1.0 {
                break;
            }
            t += (-0.5 * distance * self.pace).max(self.least_step);
            if t >= self.leave || ball.is_some_and(|ball| ball.depth_beyond(t, self.slope) <= -deepest.0) {
                break;
            }
        }
        deepest
    }

    /// Rays from the apex beyond the nearest edge of a solid, and their number. At its deepest point `t` the axis has
    /// the signed distance `x` from the edge in radii, which is negative. `right` and `up` are unit vectors across the
    /// axis. The clearance of each ray is known at `t` only, so it is an upper bound. The largest bound comes first.
    pub(crate) fn rays_past(
        &self,
        (x, t): (f32, f32),
        [right, up]: [Vec3; 2],
        steps: &mut u32,
    ) -> ([RayPast; EDGE_DIRECTIONS], usize) {
        let half_voxel = self.least_step * self.instance.stretch[1] / self.instance.stretch[0];
        let depth = -x * self.slope * t;
        let beyond = PAST_EDGE * depth + half_voxel;
        let slope = FULL_CLEARANCE * (beyond * EDGE_COSINE - depth) / t;
        let mut rays = [RayPast { offset: Vec3::ZERO, slope, most: 0.0 }; EDGE_DIRECTIONS];
        let mut count = 0;
        // A ray so far outside the cone does not bound the visible fraction of its section.
        if beyond > 2.0 * self.slope * t {
            return (rays, 0);
        }
        let step = self.instance.field_from_scene.matrix3.as_mat3();
        for i in 0..EDGE_DIRECTIONS {
            let (sine, cosine) = (i as f32 * (std::f32::consts::TAU / EDGE_DIRECTIONS as f32)).sin_cos();
            let aside = cosine * right + sine * up;
            *steps += 1;
            let p = self.at(t) + step * (beyond * aside);
            let clear = self.across(self.field.distance(p), p);
            if clear > 0.0 {
                rays[count] = RayPast { offset: beyond / t * aside, slope, most: (clear / (slope * t)).min(1.0) };
                count += 1;
            }
        }
        rays[..count].sort_by(|a, b| b.most.total_cmp(&a.most));
        (rays, count)
    }
}

/// A ray beyond the nearest edge of a solid that blocks the axis of a cone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RayPast {
    /// Its offset from the unit direction of the axis.
    pub offset: Vec3,
    /// The edge counts completely if the ray is the axis of a free cone of this slope.
    pub slope: f32,
    /// Upper bound of its clearance, in radii of that cone.
    pub most: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Behind the point at which a ball is passed, no point of the axis is closer to it than the known edge.
        #[test]
        fn no_passed_ball_comes_closer(
            along in -2.0..2.0f32, aside in 0.0..2.0f32, radius in 0.0..1.0f32, t in 0.0..4.0f32, x in 0.0..1.0f32
        ) {
            const SLOPE: f32 = 0.577_350_3;
            let ball = BallAhead { along, squared: along * along + aside * aside, radius };
            prop_assume!(ball.is_passed(t, x * SLOPE));
            for i in 0..400 {
                let s = t + 0.02 * i as f32;
                let distance = (aside * aside + (s - along) * (s - along)).sqrt() - radius;
                prop_assert!(distance >= x * SLOPE * s, "{s}: {distance}");
            }
        }
    }

    proptest! {
        /// No point of the axis behind a position is deeper inside a ball than the bound there.
        #[test]
        fn no_point_beyond_is_deeper(
            along in -2.0..2.0f32, aside in 0.0..1.0f32, radius in 0.0..1.0f32, t in 0.01..4.0f32
        ) {
            const SLOPE: f32 = 0.577_350_3;
            let ball = BallAhead { along, squared: along * along + aside * aside, radius };
            let most = ball.depth_beyond(t, SLOPE);
            for i in 0..400 {
                let s = t + 0.02 * i as f32;
                let depth = radius - (aside * aside + (s - along) * (s - along)).sqrt();
                prop_assert!(depth <= most * SLOPE * s || depth <= 0.0, "{s}: {depth}");
            }
        }
    }

    #[test]
    fn an_endless_surface_is_never_passed() {
        assert!(!BallAhead::ENDLESS.is_passed(1e6, 0.0));
    }
}
