//! How much of a light arrives: rays and cones through the distance fields of a scene.
//!
//! # Theory
//!
//! *Hard.* A ray from the surface to the light walks the tree of instances; in each field it is the exact march of
//! [`crate::render::march`], so no epsilon and no step count decides. Translucent instances take their share.
//!
//! *Soft.* Seen from the surface a light is a disc of angular radius `w`. Matter whose edge passes the disc's centre at
//! the signed angle `x w` leaves [`visible_share`] of it, if that edge is straight over the disc: the share of a disc
//! on one side of a chord, in full light from x = 1, dark from x = -1, and one half on the hard edge. The least
//! `d / (w t)` along the ray is that x (Aaltonen, GDC 2018, after Quilez; ours takes a fraction of `d` as step where matter
//! is near, in place of his guess between two steps).
//!
//! One cone to the whole disc decides most surfaces by proof: free if it stays clear of everything, dark if a ball inside
//! matter covers it. What remains, the penumbra and the shade of thin things, is asked again by [`PARTS`] narrow cones that
//! share the disc evenly, where edges are straight enough.
//!
//! Where the axis itself is blocked, depth inside tells how far the edge is only if there is one: the middle of a thin wall is
//! as shallow as its rim. So a ray is sent just past the presumed edge, and only if it arrives does the edge count. Closed walls
//! do not leak, however thin, and in however many parts.
//!
//! *Bias.* Only the surface's own instance needs one, for its field and its triangles disagree by a part of a voxel: the ray
//! starts so many voxels off the surface. Nothing is in world units, so scale does not matter; other instances touch the
//! surface without a gap.

use super::Scene;
use super::field::{Field, FieldRay};
use super::tree::Line;
use glam::{DVec3, Vec2, Vec3};

/// A place on a surface from where light is looked for.
#[derive(Debug, Clone, Copy)]
pub struct Place {
    /// Scene space.
    pub p: DVec3,
    /// Unit, on the side that is seen.
    pub normal: Vec3,
    /// The instance that the surface belongs to.
    pub own: u32,
    /// How far its own field is kept away, in voxels.
    pub bias_voxels: f32,
}

/// A way to look: a unit direction, and how far.
#[derive(Debug, Clone, Copy)]
pub struct Ray {
    pub direction: DVec3,
    pub t_max: f64,
}

/// Cones that share a light's disc where one is not enough.
pub const PARTS: u32 = 16;

/// How far past an edge the ray goes that is to prove it, in depths.
const PAST_EDGE: f32 = 1.25;

/// Steps of one cone past one instance. Steps of half a voxel at least cross the diagonal of 128^3 in 450; few cones stay
/// so near for so long.
pub const MAX_CONE_STEPS: u32 = 512;

/// What a cone met.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cone {
    /// Signed distance of the nearest edge from the axis in radii, from -1 to 1.
    pub x: f32,
    /// The whole section of the cone was inside matter somewhere.
    pub is_covered: bool,
}

impl Cone {
    pub const FREE: Self = Self { x: 1.0, is_covered: false };
}

/// Room for the rounding of an edge's place, in radii.
const RIM_ROUNDING: f32 = 1e-5;

/// The share of a disc that is seen when an edge passes at `x` radii from its centre, negative where it is covered.
///
/// `1/2 + (asin x + x sqrt(1 - x^2)) / pi` by its series, the last term chosen so that 1 gives 1: within 0.004.
pub fn visible_share(x: f32) -> f32 {
    // An edge that rounding has put a little inside the rim is at the rim: dark is exactly 0, lit exactly 1.
    let x = ((1.0 + RIM_ROUNDING) * x).clamp(-1.0, 1.0);
    if x.abs() == 1.0 {
        return 0.5 + 0.5 * x;
    }
    let s = x * x;
    0.5 + x * (std::f32::consts::FRAC_2_PI - s * (0.106_10 + s * (0.015_92 + s * 0.014_60)))
}

/// Two unit vectors at right angles to a unit vector and to each other (Duff et al., *Building an orthonormal basis,
/// revisited*, JCGT 6(1), 2017).
pub fn basis(n: DVec3) -> [DVec3; 2] {
    let sign = if n.z >= 0.0 { 1.0 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    [DVec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x), DVec3::new(b, sign + n.y * n.y * a, -n.y)]
}

/// Point `i` of `count` spread evenly over the unit disc (Vogel 1979), the whole turned by `turn`.
pub fn disc_point(i: u32, count: u32, turn: f32) -> Vec2 {
    /// 2 pi (1 - 1 / golden ratio).
    const GOLDEN_ANGLE: f32 = 2.399_963_2;
    let radius = ((i as f32 + 0.5) / count as f32).sqrt();
    let angle = i as f32 * GOLDEN_ANGLE + turn;
    radius * Vec2::new(angle.cos(), angle.sin())
}

impl Scene {
    /// Share of a thin ray that passes, and the steps it took.
    pub fn ray_share(&self, place: &Place, ray: &Ray, steps: &mut u32) -> f32 {
        let mut share = 1.0;
        let line = Line::new(place.p.as_vec3(), ray.direction.as_vec3());
        self.tree.walk(&line, ray.t_max as f32, |item, limit| {
            let instance = &self.instances[item as usize];
            let Some(field) = instance.field.as_deref().filter(|_| instance.casts_shadow) else { return limit };
            *steps += 1;
            if share * instance.opacity == 0.0 {
                return limit;
            }
            if self.hit_of(item, field, place, ray, steps).is_some() {
                share *= 1.0 - instance.opacity;
            }
            if share > 0.0 { limit } else { -1.0 }
        });
        share
    }

    /// Where a ray enters an instance's matter, in scene units.
    fn hit_of(&self, item: u32, field: &dyn Field, place: &Place, ray: &Ray, steps: &mut u32) -> Option<f32> {
        let (origin, direction) = self.ray_in_field(item, place, ray);
        let [lower, upper] = field.surface_bounds();
        let (enter, leave) = clip(origin, direction, lower, upper, 0.0, ray.t_max)?;
        let start = FieldRay { origin: (origin + enter * direction).as_vec3(), direction: direction.as_vec3() };
        let (hit, taken) = field.first_hit(&start, (leave - enter) as f32);
        *steps += taken;
        hit.map(|hit| hit.t + enter as f32)
    }

    /// A ray in an instance's field space, its start moved off the surface if that is the instance's own.
    fn ray_in_field(&self, item: u32, place: &Place, ray: &Ray) -> (DVec3, DVec3) {
        let instance = &self.instances[item as usize];
        let mut p = place.p;
        if item == place.own {
            let voxel = (instance.field_normal_from_scene * place.normal).length();
            p += (place.bias_voxels * voxel * place.normal).as_dvec3();
        }
        (instance.field_from_scene.transform_point3(p), instance.field_from_scene.matrix3 * ray.direction)
    }

    /// Look along a cone of radius `slope t` past one instance; only what comes closer than `x_known` matters.
    fn cone_past(
        &self,
        item: u32,
        field: &dyn Field,
        place: &Place,
        ray: &Ray,
        slope: f32,
        x_known: f32,
        steps: &mut u32,
    ) -> Cone {
        let instance = &self.instances[item as usize];
        let (origin, direction) = self.ray_in_field(item, place, ray);
        let [lower, upper] = field.surface_bounds();
        // The box grown by the cone's radius at its far side; see `Line::cone`.
        let speed = direction.length();
        let bounds = &self.boxes[item as usize];
        let p = place.p.as_vec3();
        let far = (p - bounds.min).abs().max((p - bounds.max).abs()).length();
        let needed = slope * x_known.max(0.0);
        let radius = f64::from(needed / (1.0 - needed.min(0.9)) * far).min(f64::from(needed) * ray.t_max);
        let grown = instance.field_extent * radius as f32;
        let Some((enter, leave)) = clip(origin, direction, lower - grown, upper + grown, 0.0, ray.t_max) else {
            return Cone::FREE;
        };
        let walk = ConeWalk {
            field,
            instance,
            // From the entrance on, float32 will do.
            start: (origin + enter * direction).as_vec3(),
            direction: direction.as_vec3(),
            ray_scene: ray.direction.as_vec3(),
            enter: enter as f32,
            leave: leave as f32,
            slope,
            pace: 1.0 / (instance.local_from_scene * ray.direction.as_vec3()).length(),
            least_step: 0.5 / speed as f32,
        };
        match self.hit_of(item, field, place, ray, steps) {
            Some(t) => {
                let (cone, edge) = walk.inside(t, steps);
                // It is an edge only if a ray past it is free.
                let is_edge = edge.is_some_and(|edge| {
                    let direction = ray.direction + edge.as_dvec3();
                    let length = direction.length();
                    let past = Ray { direction: direction / length, t_max: ray.t_max * length };
                    self.ray_share(place, &past, steps) > 0.0
                });
                if cone.is_covered || is_edge { cone } else { Cone { x: -1.0, is_covered: false } }
            }
            None if x_known <= 0.0 => Cone::FREE,
            None => Cone { x: walk.beside(x_known, steps), is_covered: false },
        }
    }

    /// Share of a cone's section that passes, if edges in it are straight.
    pub fn cone_share(&self, place: &Place, ray: &Ray, slope: f32, steps: &mut u32) -> f32 {
        let mut sum = ConeSum::NEW;
        let line = Line::cone(place.p.as_vec3(), ray.direction.as_vec3(), slope);
        self.tree.walk(&line, ray.t_max as f32, |item, limit| {
            // What is further from the axis than something known already cannot change the result.
            let bounds = &self.boxes[item as usize];
            let x_known = sum.x_known(&self.instances[item as usize]);
            if line.with_slope(slope * x_known.max(0.0)).span(bounds.min, bounds.max, limit).is_some() {
                self.add_cone(item, place, ray, slope, x_known, &mut sum, steps);
            }
            if sum.opaque.x <= -1.0 { -1.0 } else { limit }
        });
        sum.share().share
    }

    /// Share of a cone's section that passes, and whether that is proven: all lit or all dark. `met` becomes the instances
    /// that stand in the cone.
    pub fn whole_cone(&self, place: &Place, ray: &Ray, slope: f32, met: &mut Vec<u32>, steps: &mut u32) -> ConeShare {
        met.clear();
        let mut sum = ConeSum::NEW;
        let line = Line::cone(place.p.as_vec3(), ray.direction.as_vec3(), slope);
        self.tree.walk(&line, ray.t_max as f32, |item, limit| {
            if self.add_cone(item, place, ray, slope, 1.0, &mut sum, steps).x < 1.0 {
                met.push(item);
            }
            if sum.opaque.is_covered { -1.0 } else { limit }
        });
        sum.share()
    }

    /// Take one instance into the sum of a cone.
    fn add_cone(
        &self,
        item: u32,
        place: &Place,
        ray: &Ray,
        slope: f32,
        x_known: f32,
        sum: &mut ConeSum,
        steps: &mut u32,
    ) -> Cone {
        let instance = &self.instances[item as usize];
        let takes_light = instance.casts_shadow && instance.opacity > 0.0;
        let Some(field) = instance.field.as_deref().filter(|_| takes_light) else { return Cone::FREE };
        *steps += 1;
        let cone = self.cone_past(item, field, place, ray, slope, x_known, steps);
        if instance.opacity < 1.0 {
            sum.translucent *= 1.0 - instance.opacity * (1.0 - visible_share(cone.x));
            sum.is_proven &= cone.is_covered || cone.x >= 1.0;
        } else {
            sum.opaque.x = sum.opaque.x.min(cone.x);
            sum.opaque.is_covered |= cone.is_covered;
        }
        cone
    }

    /// Share of a disc of light that arrives: angular radius `slope`, `ray` to its centre.
    pub fn disc_share(&self, place: &Place, ray: &Ray, slope: f32, steps: &mut u32) -> f32 {
        if slope <= 0.0 {
            return self.ray_share(place, ray, steps);
        }
        let mut met = Vec::new();
        let whole = self.whole_cone(place, ray, slope, &mut met, steps);
        if whole.is_proven {
            return whole.share;
        }
        // What keeps clear of the whole cone keeps clear of its parts.
        let part = slope / (PARTS as f32).sqrt();
        let axes = basis(ray.direction);
        let mut total = 0.0;
        for i in 0..PARTS {
            let to_part = toward(ray, axes, slope, disc_point(i, PARTS, 0.0));
            let mut sum = ConeSum::NEW;
            for &item in &met {
                let x_known = sum.x_known(&self.instances[item as usize]);
                self.add_cone(item, place, &to_part, part, x_known, &mut sum, steps);
                if sum.opaque.x <= -1.0 {
                    break;
                }
            }
            total += sum.share().share;
        }
        total / PARTS as f32
    }

    /// The same by `count` thin rays.
    pub fn area_share(&self, place: &Place, ray: &Ray, slope: f32, count: u32, turn: f32, steps: &mut u32) -> f32 {
        if slope <= 0.0 {
            return self.ray_share(place, ray, steps);
        }
        let axes = basis(ray.direction);
        let mut sum = 0.0;
        for i in 0..count {
            sum += self.ray_share(place, &toward(ray, axes, slope, disc_point(i, count, turn)), steps);
        }
        sum / count as f32
    }

    /// How far a ray goes through the instance's own matter before it leaves it, scene units; 0 where there is no field.
    pub fn thickness(&self, place: &Place, direction: DVec3, steps: &mut u32) -> f32 {
        let instance = &self.instances[place.own as usize];
        let Some(field) = instance.field.as_deref() else { return 0.0 };
        // Start inside: the bias the other way round.
        let inside = Place { bias_voxels: -place.bias_voxels, ..*place };
        let ray = Ray { direction, t_max: f64::INFINITY };
        let (origin, step) = self.ray_in_field(place.own, &inside, &ray);
        let [lower, upper] = field.surface_bounds();
        let Some((enter, leave)) = clip(origin, step, lower, upper, 0.0, f64::INFINITY) else { return 0.0 };
        let (start, step) = ((origin + enter * step).as_vec3(), step.as_vec3());
        let pace = 1.0 / (instance.local_from_scene * direction.as_vec3()).length();
        let least = 0.5 / step.length();
        let end = (leave - enter) as f32;
        let (mut t, mut thickness) = (0.0, 0.0);
        for _ in 0..MAX_CONE_STEPS {
            let distance = field.distance(start + t * step);
            *steps += 1;
            let next = (t + (distance.abs() * pace).max(least)).min(end);
            if distance < 0.0 {
                thickness += next - t;
            }
            t = next;
            if t >= end {
                break;
            }
        }
        thickness
    }
}

/// What a cone to a light found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ConeShare {
    pub share: f32,
    pub is_proven: bool,
}

/// What a cone met so far.
struct ConeSum {
    /// Share that translucent instances leave.
    translucent: f32,
    /// They leave nothing open.
    is_proven: bool,
    /// The nearest edge of the opaque ones.
    opaque: Cone,
}

impl ConeSum {
    const NEW: Self = Self { translucent: 1.0, is_proven: true, opaque: Cone::FREE };

    /// How close to the axis another instance must come, in radii, to change the sum.
    fn x_known(&self, instance: &super::Instance) -> f32 {
        if instance.opacity >= 1.0 { self.opaque.x } else { 1.0 }
    }

    fn share(&self) -> ConeShare {
        if self.opaque.is_covered {
            return ConeShare { share: 0.0, is_proven: true };
        }
        ConeShare {
            share: self.translucent * visible_share(self.opaque.x),
            is_proven: self.is_proven && self.opaque.x >= 1.0,
        }
    }
}

/// The ray to another point of the disc; `offset` in radii.
pub fn toward(ray: &Ray, [right, up]: [DVec3; 2], slope: f32, offset: Vec2) -> Ray {
    let aside = f64::from(slope * offset.x) * right + f64::from(slope * offset.y) * up;
    let direction = ray.direction + aside;
    let length = direction.length();
    Ray { direction: direction / length, t_max: ray.t_max * length }
}

/// One cone past one instance, in its field space.
struct ConeWalk<'a> {
    field: &'a dyn Field,
    instance: &'a super::Instance,
    start: Vec3,
    direction: Vec3,
    ray_scene: Vec3,
    enter: f32,
    leave: f32,
    slope: f32,
    /// Scene units that a ray may go for one local unit of distance.
    pace: f32,
    /// Half a voxel, scene units.
    least_step: f32,
}

impl ConeWalk<'_> {
    fn at(&self, t: f32) -> Vec3 {
        self.start + (t - self.enter) * self.direction
    }

    /// Scene distance across of a local distance at a point.
    fn across(&self, distance: f32, p: Vec3) -> f32 {
        if self.instance.is_uniform() {
            return distance * self.instance.stretch[0];
        }
        // The plane through the nearest point: its scene normal is L^T of the local one.
        let normal = self.instance.local_from_scene.transpose() * self.field.gradient(p);
        let length = normal.length();
        if length > 0.0 { distance / length } else { distance * self.instance.stretch[0] }
    }

    /// The axis is free: the least clearance in radii, at most `x_known`.
    fn beside(&self, x_known: f32, steps: &mut u32) -> f32 {
        let mut x = x_known;
        let mut t = self.enter;
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let radius = self.slope * t;
            let distance = self.field.distance(p);
            if distance * self.instance.stretch[0] < x * radius {
                let clear = self.across(self.field.distance_guess(p).max(0.0), p);
                x = x.min(clear / radius);
            }
            // Where matter is near, half steps find the closest approach to 3 %.
            let step = distance * self.pace;
            let step = if step < 2.0 * radius { 0.5 * step } else { step };
            t += step.max(self.least_step);
            if t >= self.leave {
                break;
            }
        }
        x
    }

    /// The axis enters matter at `t_hit`: how deep it gets, in radii, and the offset of a unit direction that would pass the
    /// nearest edge, if that is near enough.
    fn inside(&self, t_hit: f32, steps: &mut u32) -> (Cone, Option<Vec3>) {
        let dark = Cone { x: -1.0, is_covered: false };
        let mut deepest = (0.0f32, t_hit);
        // Just past the surface, where the field is below zero.
        let mut t = t_hit + 0.5 * self.least_step;
        for _ in 0..MAX_CONE_STEPS {
            *steps += 1;
            let p = self.at(t);
            let distance = self.field.distance(p);
            if distance >= 0.0 {
                break;
            }
            let x = self.across(distance, p) / (self.slope * t);
            if x <= -1.0 {
                return (Cone { x: -1.0, is_covered: true }, None);
            }
            if x < deepest.0 {
                deepest = (x, t);
            }
            t += (-0.5 * distance * self.pace).max(self.least_step);
            if t >= self.leave {
                break;
            }
        }
        // The nearest surface across the ray, and a ray just past it.
        let (x, t) = deepest;
        let p = self.at(t);
        let normal = self.instance.local_from_scene.transpose() * self.field.gradient(p);
        let across = normal - normal.dot(self.ray_scene) * self.ray_scene;
        let Some(across) = across.try_normalize() else { return (dark, None) };
        let past =
            PAST_EDGE * -x * self.slope + self.least_step * self.instance.stretch[1] / self.instance.stretch[0] / t;
        let edge = (past <= 2.0 * self.slope).then_some(past * across);
        (Cone { x, is_covered: false }, edge)
    }
}

/// The part of `origin + t direction` in a box, with `t` from `t_min` to `t_max`.
pub fn clip(origin: DVec3, direction: DVec3, lower: Vec3, upper: Vec3, t_min: f64, t_max: f64) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (t_min, t_max);
    for axis in 0..3 {
        let (low, high) = (f64::from(lower[axis]) - origin[axis], f64::from(upper[axis]) - origin[axis]);
        if direction[axis] == 0.0 {
            if low > 0.0 || high < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (low / direction[axis], high / direction[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter <= leave).then_some((enter, leave))
}
