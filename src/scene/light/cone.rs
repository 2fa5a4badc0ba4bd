//! Cones past fields: the nearest edge to the axis of a cone, and the fraction of the cone's section that it leaves
//! open.
//!
//! [`super::shadow`] explains their use.

use super::ray_bundle::RayBundle;
use crate::gpu::constants::scene_beams::{EDGE_COSINE, EDGE_DIRECTIONS, FULL_CLEARANCE, MAX_CONE_STEPS, PAST_EDGE};
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
}

impl Cone {
    pub(crate) const FREE: Self = Self { x: 1.0, is_covered: false };
    pub(crate) const COVERED: Self = Self { x: -1.0, is_covered: true };
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

    /// The axis enters the solid at `t_hit`. Returns the signed distance of the nearest edge in radii, at most 0, and
    /// the position of the deepest point, to which that distance belongs. At -1 or below the solid covers the whole
    /// section, and the walk ends there.
    pub(crate) fn inside(&self, t_hit: f32, steps: &mut u32) -> (f32, f32) {
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
            if t >= self.leave {
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
