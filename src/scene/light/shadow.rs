//! The fraction of a light that arrives: rays past the triangles of meshes and through other fields, cones through all
//! fields of a scene.
//!
//! # Theory
//!
//! *Hard.* A ray from the surface to the light searches the tree of instances. It intersects the triangles of a mesh
//! ([`super::mesh_rays`]), and in the field of any other object it is traced exactly ([`crate::march::marcher`]). So
//! neither an epsilon nor a step count decides. Translucent instances block their fraction.
//!
//! *Soft.* As seen from the surface, a light is a disc of angular radius `w`. Suppose the edge of an occluder passes
//! the centre of the disc at the signed angle `x w`, and is straight over the disc. Then the fraction
//! [`super::cone::visible_share`] of the disc is visible, which is the part of a disc on one side of a chord: fully lit
//! from x = 1, dark from x = -1, and one half on the hard edge. The smallest `d / (w t)` along the ray is that x
//! (Aaltonen, GDC 2018, after Quilez). Near a surface the step is a fraction of `d` here; Aaltonen estimates the value
//! between two steps instead.
//!
//! One cone to the whole disc decides most surfaces by proof: free if no surface enters it, dark if a ball inside an
//! occluder covers it. The remaining surfaces, in penumbrae and in the shade of thin objects, are evaluated by
//! [`PARTS`] narrow cones that divide the disc evenly, in which edges are straight enough.
//!
//! Steps of the stored distance also prove that the axis is free. Only where they become shorter than half a voxel, or
//! an edge ends the walk, is the rest of the axis traced exactly. A field whose values [may exceed the
//! distance](crate::scene::fields::field::Field::may_exceed_distance) has its axes traced from their start. Tiles of
//! pixels ([`crate::scene::lighting::tile`]) skip a field by its values only if those change no faster than a distance.
//! So shadows end at the surface of any values.
//!
//! If the axis itself is blocked, the depth inside gives the distance of the edge only if there is an edge: the middle
//! of a thin wall is as shallow as its rim. Rays just beyond the presumed edge are therefore evaluated, in
//! [`EDGE_DIRECTIONS`](crate::gpu::constants::scene_beams::EDGE_DIRECTIONS) around the axis. The edge counts in
//! proportion to the largest clearance of these rays from this occluder and from all opaque ones.
//! So the result changes continuously where an edge comes close to other parts, and where the axis passes the middle of
//! a rod. Closed walls do not leak light, at any thickness and in any number of parts.
//!
//! *Horizon.* A surface sees the part of a light above its tangent plane only. This part limits the fraction, because
//! fields, triangles and rays that start off the surface decide it with an error of a fraction of a voxel
//! ([`super::lit_surface::LitSurface::above_horizon`]).
//!
//! *Bias.* Only the surface's own instance needs a bias, because its field and its triangles differ by a fraction of a
//! voxel: the ray starts a number of voxels off the surface. No constant is in world units, so the scale of the scene
//! has no effect. Other instances touch the surface without a gap.

use super::cone::{Cone, ConeShare, ConeSum, ConeWalk, Decision, RayPast};
use super::far_field::{Far, FarLevel, Split};
use super::light_rays::{LightCone, LightRay, LightWork, PARTS, SurfacePoint, basis, disc_point, toward};
use super::occluder::{NearList, Occluder, ray_in_field};
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::tree::Line;
use crate::scene::fields::field::FieldHit;

/// A scene as the rays and cones of light trace it: its instances and, past a distance, one far field for all of them
/// ([`super::far_field`]).
#[derive(Clone, Copy)]
pub(crate) struct TracedScene<'a> {
    pub scene: &'a Scene,
    pub far: Option<&'a Far>,
    /// The instances that may block the light that is evaluated; `None` if all may.
    pub near: Option<&'a NearList>,
}

/// The objects that a search along a ray tests.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Blocking {
    All,
    /// The triangles of meshes.
    Faces,
    /// The fields of all objects but meshes.
    Fields,
}

impl Blocking {
    /// Whether the rays of a search test an instance.
    pub(crate) fn includes(self, instance: &Instance) -> bool {
        match self {
            Self::All => Self::Faces.includes(instance) || Self::Fields.includes(instance),
            Self::Faces => instance.casting_triangles().is_some(),
            Self::Fields => instance.casts_by_field(),
        }
    }
}

impl<'a> TracedScene<'a> {
    /// Fraction of a thin ray that passes the triangles of meshes, and the fields of all other objects.
    pub(crate) fn ray_share(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        let (share, is_far) = self.pass_ray(place, ray, Blocking::All, work);
        work.count(is_far);
        share
    }

    /// Fraction of a thin ray that passes the fields of all objects but meshes.
    pub(crate) fn field_share(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        let (share, is_far) = self.pass_ray(place, ray, Blocking::Fields, work);
        work.count(is_far);
        share
    }

    /// Fraction of a thin ray that passes the triangles of meshes.
    pub(crate) fn face_share(&self, place: &SurfacePoint, ray: &LightRay, work: &mut LightWork) -> f32 {
        self.pass_ray(place, ray, Blocking::Faces, work).0
    }

    /// Decides whether a cone is completely lit or dark. Only then the result is proven, and its fraction is exact.
    /// `in_cone` becomes the list of instances in the cone.
    pub(crate) fn whole_cone(&self, cone: LightCone<'_>, in_cone: &mut Vec<u32>, work: &mut LightWork) -> ConeShare {
        let LightCone { place, ray, slope } = cone;
        in_cone.clear();
        let split = self.split(place, ray, slope);
        let mut sum = ConeSum::NEW;
        self.walk(cone, &split, |item, limit| {
            let mut x = 1.0f32;
            for occluder in self.occluders(item, place, ray, &split) {
                x = x.min(self.decide_cone(&occluder, cone, &mut sum, work).x);
            }
            if x < 1.0 {
                in_cone.push(item);
            }
            if sum.opaque.is_covered { -1.0 } else { limit }
        });
        let is_far = split.far.is_some() && !sum.opaque.is_covered;
        if is_far {
            for far in self.far_occluders(&split, place, ray) {
                self.decide_cone(&far, cone, &mut sum, work);
                if sum.opaque.is_covered {
                    break;
                }
            }
        }
        work.count(is_far);
        sum.share()
    }

    /// Calls `visit` with the instances whose boxes a cone touches, near ones first, as
    /// [`crate::scene::content::tree::Tree::walk`] does.
    fn walk(&self, cone: LightCone<'_>, split: &Split, mut visit: impl FnMut(u32, f32) -> f32) {
        let line = Line::cone(cone.place.p.as_vec3(), cone.ray.direction.as_vec3(), cone.slope);
        let mut pass = |item: u32, limit: f32| {
            if line.touches(&self.scene.boxes[item as usize], limit) { visit(item, limit) } else { limit }
        };
        let reach = self.reach(split, cone.ray);
        match self.near {
            None => self.scene.tree.walk(&line, reach, pass),
            Some(near) => {
                let visit = |limit, item| Some(pass(item, limit)).filter(|limit| *limit >= 0.0);
                if cone.slope == 0.0 {
                    near.for_ray().try_fold(reach, visit);
                } else {
                    near.for_cone().try_fold(reach, visit);
                }
            }
        }
    }

    /// Adds the far field to the results of a cone. Returns whether the far field was evaluated.
    fn add_far(&self, split: &Split, cone: LightCone<'_>, sum: &mut ConeSum, work: &mut LightWork) -> bool {
        let is_far = split.far.is_some() && sum.opaque.x > -1.0;
        if is_far {
            for far in self.far_occluders(split, cone.place, cone.ray) {
                let x_limit = sum.opaque.x;
                self.add_cone(&far, cone, x_limit, sum, work);
                if sum.opaque.x <= -1.0 {
                    break;
                }
            }
        }
        is_far
    }

    /// Adds one occluder to the results of a cone.
    fn add_cone(
        &self,
        occluder: &Occluder<'_>,
        cone: LightCone<'_>,
        x_limit: f32,
        sum: &mut ConeSum,
        work: &mut LightWork,
    ) {
        if self.add_thin(occluder, cone, sum, work).is_none() {
            let found = self.cone_past(occluder, cone, x_limit, work);
            sum.add(occluder.instance, found);
        }
    }

    /// Adds an occluder that is tested by thin rays. `None` for all others.
    fn add_thin(
        &self,
        occluder: &Occluder<'_>,
        LightCone { place, ray, slope }: LightCone<'_>,
        sum: &mut ConeSum,
        work: &mut LightWork,
    ) -> Option<Cone> {
        work.steps += 1;
        if !occluder.field.prefers_rays() {
            return None;
        }
        if !occluder.may_intersect(place, ray, slope) {
            return Some(Cone::FREE);
        }
        sum.thin.block(occluder.instance.shade, ray, slope, |thin| self.hit_of(occluder, place, thin, work).is_some());
        Some(Cone { x: 0.0, is_covered: false })
    }

    /// Adds one occluder to the results of a cone to the whole light. The edge is known only as -1, 0 or 1 radii: the
    /// occluder covers the cone, leaves it free, or neither.
    fn decide_cone(
        &self,
        occluder: &Occluder<'_>,
        cone: LightCone<'_>,
        sum: &mut ConeSum,
        work: &mut LightWork,
    ) -> Cone {
        if let Some(found) = self.add_thin(occluder, cone, sum, work) {
            return found;
        }
        let Some(walk) = occluder.cone_walk(cone, 1.0) else { return Cone::FREE };
        let mut steps = 0;
        let found = match walk.decide(&mut steps, |from| self.walk_hit(occluder, &walk, from, work)) {
            Decision::Free => Cone::FREE,
            Decision::Blocked(t) if walk.inside(t, &mut steps).0 <= -1.0 => Cone::COVERED,
            _ => Cone { x: 0.0, is_covered: false },
        };
        work.steps += steps;
        sum.add(occluder.instance, found);
        found
    }

    /// Fraction of a disc of light that passes fields and sheets: angular radius `slope`, `ray` to its centre.
    pub(crate) fn disc_share(&self, place: &SurfacePoint, ray: &LightRay, slope: f32, work: &mut LightWork) -> f32 {
        if slope <= 0.0 {
            return self.ray_share(place, ray, work);
        }
        let past_sheets = self.scene.disc_past_sheets(place, ray, slope, work);
        let sheets_share = past_sheets.iter().sum::<f32>() / PARTS as f32;
        if sheets_share == 0.0 {
            return 0.0;
        }
        let mut in_cone = Vec::new();
        let whole = self.whole_cone(LightCone { place, ray, slope }, &mut in_cone, work);
        if whole.is_proven {
            return whole.share * sheets_share;
        }
        // An instance outside the whole cone is outside its parts.
        let part = slope / (PARTS as f32).sqrt();
        let axes = basis(ray.direction);
        let mut total = 0.0;
        for (i, sheets_part) in (0..PARTS).zip(past_sheets) {
            let to_part = toward(ray, axes, slope, disc_point(i, PARTS, 0.0));
            let cone = LightCone { place, ray: &to_part, slope: part };
            total += self.cone_share(cone, &in_cone, work) * sheets_part;
        }
        total / PARTS as f32
    }

    /// The instances whose boxes a cone touches.
    pub(crate) fn instances_in(&self, cone: LightCone<'_>) -> Vec<u32> {
        let mut in_cone = Vec::new();
        self.walk(cone, &self.split(cone.place, cone.ray, cone.slope), |item, limit| {
            in_cone.push(item);
            limit
        });
        in_cone
    }

    /// Fraction of a narrow cone's section that passes some instances and the far field.
    pub(crate) fn cone_share(&self, cone: LightCone<'_>, in_cone: &[u32], work: &mut LightWork) -> f32 {
        let split = self.split(cone.place, cone.ray, cone.slope);
        let mut sum = ConeSum::NEW;
        for &item in in_cone {
            let x_limit = sum.x_limit(&self.scene.instances[item as usize]);
            for occluder in self.occluders(item, cone.place, cone.ray, &split) {
                self.add_cone(&occluder, cone, x_limit, &mut sum, work);
            }
            if sum.opaque.x <= -1.0 {
                break;
            }
        }
        let is_far = self.add_far(&split, cone, &mut sum, work);
        work.count(is_far);
        sum.share().share
    }

    /// [`Self::disc_share`] by `count` thin rays.
    pub(crate) fn area_share(
        &self,
        place: &SurfacePoint,
        ray: &LightRay,
        slope: f32,
        count: u32,
        turn: f32,
        work: &mut LightWork,
    ) -> f32 {
        if slope <= 0.0 {
            return self.ray_share(place, ray, work);
        }
        let axes = basis(ray.direction);
        let rays = (0..count).map(|i| toward(ray, axes, slope, disc_point(i, count, turn)));
        let rays = rays.filter(|ray| place.is_above_horizon(ray));
        let Some(near) = self.near.filter(|_| self.far.is_none()) else {
            return rays.map(|ray| self.ray_share(place, &ray, work)).sum::<f32>() / count as f32;
        };
        self.sum_of_rays(near, place, rays, work) / count as f32
    }

    /// Fraction of a thin ray, and whether it entered the far field.
    fn pass_ray(&self, place: &SurfacePoint, ray: &LightRay, blocking: Blocking, work: &mut LightWork) -> (f32, bool) {
        let split = self.split(place, ray, 0.0);
        let mut share = 1.0;
        self.walk(LightCone { place, ray, slope: 0.0 }, &split, |item, limit| {
            let is_tested = blocking.includes(&self.scene.instances[item as usize]);
            let passes = if is_tested { self.past_instance(item, place, ray, &split, work) } else { 1.0 };
            share *= passes;
            if let Some(near) = self.near.filter(|_| passes <= 0.0) {
                near.set_last(item);
            }
            if share > 0.0 { limit } else { -1.0 }
        });
        let is_far = split.far.is_some() && share > 0.0 && blocking != Blocking::Faces;
        if is_far && self.far_occluders(&split, place, ray).any(|far| self.hit_of(&far, place, ray, work).is_some()) {
            share = 0.0;
        }
        (share, is_far)
    }

    /// Fraction of a thin ray that passes an instance: its triangles, or its field if it has none.
    pub(crate) fn past_instance(
        &self,
        item: u32,
        place: &SurfacePoint,
        ray: &LightRay,
        split: &Split,
        work: &mut LightWork,
    ) -> f32 {
        match self.scene.instances[item as usize].casting_triangles() {
            Some(triangles) => self.past_faces(item, triangles, place, ray, split, work),
            None => self.past_field(item, place, ray, split, work),
        }
    }

    /// Fraction of a thin ray that passes the field of an instance.
    fn past_field(&self, item: u32, place: &SurfacePoint, ray: &LightRay, split: &Split, work: &mut LightWork) -> f32 {
        for occluder in self.occluders(item, place, ray, split) {
            work.steps += 1;
            if self.hit_of(&occluder, place, ray, work).is_some() {
                return 1.0 - occluder.instance.shade;
            }
        }
        1.0
    }

    /// The intervals of a ray or cone for the instances and for the far field.
    pub(crate) fn split(&self, place: &SurfacePoint, ray: &LightRay, slope: f32) -> Split {
        let far = self.far.filter(|_| !place.skips_own);
        far.map_or(Split::near(ray.t_max), |far| far.split(place, ray, slope))
    }

    /// Length of the search through the instances.
    pub(crate) fn reach(&self, split: &Split, ray: &LightRay) -> f32 {
        let is_near = split.rest.is_none() && self.far.is_none_or(|far| far.holds_all);
        (if is_near { split.near } else { ray.t_max }) as f32
    }

    /// An instance on the intervals of a ray in which it is evaluated.
    pub(crate) fn occluders(
        &self,
        item: u32,
        place: &SurfacePoint,
        ray: &LightRay,
        split: &Split,
    ) -> impl Iterator<Item = Occluder<'a>> {
        let instance = &self.scene.instances[item as usize];
        let field = instance.casting_field();
        let bounds = &self.scene.boxes[item as usize];
        let is_own = item == place.own;
        let field = field.filter(|_| !(is_own && place.skips_own));
        let parts = split.parts(instance, ray.t_max);
        parts.filter_map(move |part| Some(Occluder { instance, field: field?, bounds, part, is_own, skip: 0.0 }))
    }

    /// The levels of the far field on their pieces of a ray.
    pub(crate) fn far_occluders(
        &self,
        split: &Split,
        place: &'a SurfacePoint,
        ray: &'a LightRay,
    ) -> impl Iterator<Item = Occluder<'a>> {
        let start = split.far.map_or(0.0, |far| far[0]);
        let pieces = self.far.zip(split.far).into_iter().flat_map(move |(far, part)| far.pieces(part, place, ray));
        pieces.filter_map(move |(level, part)| {
            let FarLevel { instance, bounds, voxel } = level;
            let skip = if part[0] == start { *voxel } else { 0.0 };
            Some(Occluder { instance, field: instance.field.as_deref()?, bounds, part, is_own: false, skip })
        })
    }

    /// The position at which a ray enters an occluder, scene units.
    pub(crate) fn hit_of(
        &self,
        occluder: &Occluder<'_>,
        place: &SurfacePoint,
        ray: &LightRay,
        work: &mut LightWork,
    ) -> Option<f32> {
        self.hit_from(occluder, place, ray, occluder.part[0], work).map(|hit| hit.t)
    }

    /// The first hit of a ray with an occluder at `from` or later, scene units.
    pub(crate) fn hit_from(
        &self,
        occluder: &Occluder<'_>,
        place: &SurfacePoint,
        ray: &LightRay,
        from: f64,
        work: &mut LightWork,
    ) -> Option<FieldHit> {
        let in_field = ray_in_field(occluder.instance, occluder.is_own, place, ray);
        occluder.hit_in_field(in_field, from, work)
    }

    /// The position at which the axis of a cone enters an occluder at `from` or later, where the walk has found no
    /// surface before.
    fn walk_hit(&self, occluder: &Occluder<'_>, walk: &ConeWalk<'_>, from: f32, work: &mut LightWork) -> Option<f32> {
        // If an occluder is entered at its first point, the length to skip is measured from there.
        let from = if occluder.skip > 0.0 { occluder.part[0] } else { f64::from(from) };
        occluder.hit_in_field(walk.ray, from, work).map(|hit| hit.t)
    }

    /// Evaluates a cone of radius `slope t` past one occluder. Only edges closer to the axis than `x_limit` are
    /// relevant.
    fn cone_past(&self, occluder: &Occluder<'_>, cone: LightCone<'_>, x_limit: f32, work: &mut LightWork) -> Cone {
        let Some(walk) = occluder.cone_walk(cone, x_limit) else { return Cone::FREE };
        let mut steps = 0;
        let found = walk.beside(x_limit, &mut steps, |from| self.walk_hit(occluder, &walk, from, work));
        work.steps += steps;
        match found {
            Ok(x) => Cone { x, is_covered: false },
            Err(t) => self.blocked_cone(occluder, &walk, t, cone, work),
        }
    }

    /// Evaluates a cone whose axis enters an occluder at `t_hit`.
    fn blocked_cone(
        &self,
        occluder: &Occluder<'_>,
        walk: &ConeWalk<'_>,
        t_hit: f32,
        cone: LightCone<'_>,
        work: &mut LightWork,
    ) -> Cone {
        let ray = cone.ray;
        let deepest = walk.inside(t_hit, &mut work.steps);
        if deepest.0 <= -1.0 {
            return Cone::COVERED;
        }
        let axes = basis(ray.direction).map(|axis| axis.as_vec3());
        let (rays, count) = walk.rays_past(deepest, axes, &mut work.steps);
        let mut most = 0.0f32;
        for past in &rays[..count] {
            if past.most <= most {
                break;
            }
            most = most.max(self.clearance_past(occluder, past, cone, most, work));
        }
        Cone { x: most * (1.0 + deepest.0) - 1.0, is_covered: false }
    }

    /// The least clearance of a ray past an edge of an occluder, beside that occluder and all other opaque ones: radii
    /// of the ray's narrow cone, from 0 to 1. The search ends if it is at most `least`.
    fn clearance_past(
        &self,
        occluder: &Occluder<'_>,
        past: &RayPast,
        LightCone { place, ray, .. }: LightCone<'_>,
        least: f32,
        work: &mut LightWork,
    ) -> f32 {
        let direction = ray.direction + past.offset.as_dvec3();
        let length = direction.length();
        let ray = LightRay { direction: direction / length, t_max: ray.t_max * length };
        let cone = LightCone { place, ray: &ray, slope: past.slope };
        let split = self.split(place, &ray, past.slope);
        // The occluder itself is the likeliest to be near.
        let mut clearance = past.most.min(self.clearance_beside(occluder, cone, past.most, work));
        let pass = |item: u32, limit: f32| {
            for other in self.occluders(item, place, &ray, &split) {
                // `occluder` is all of its instance, unless a far field divides the ray.
                let is_same = std::ptr::eq(other.instance, occluder.instance);
                let counts = if is_same { self.far.is_some() } else { other.instance.shade >= 1.0 };
                if counts && clearance > least {
                    clearance = clearance.min(self.clearance_beside(&other, cone, clearance, work));
                }
            }
            if clearance > least { limit } else { -1.0 }
        };
        let line = Line::cone(place.p.as_vec3(), ray.direction.as_vec3(), past.slope);
        let reach = self.reach(&split, &ray);
        self.scene.tree.walk(&line, reach, pass);
        if split.far.is_some() && clearance > least {
            for far in self.far_occluders(&split, place, &ray) {
                clearance = clearance.min(self.clearance_beside(&far, cone, clearance, work));
            }
        }
        clearance
    }

    /// The clearance of the axis of a narrow cone beside one occluder in radii, from 0 to 1. A clearance above
    /// `x_limit` need not be exact.
    fn clearance_beside(
        &self,
        occluder: &Occluder<'_>,
        cone: LightCone<'_>,
        x_limit: f32,
        work: &mut LightWork,
    ) -> f32 {
        work.steps += 1;
        if occluder.field.prefers_rays() {
            return if self.hit_of(occluder, cone.place, cone.ray, work).is_some() { 0.0 } else { 1.0 };
        }
        let Some(walk) = occluder.cone_walk(cone, x_limit) else { return 1.0 };
        let mut steps = 0;
        let found = walk.beside(x_limit, &mut steps, |from| self.walk_hit(occluder, &walk, from, work));
        work.steps += steps;
        found.unwrap_or(0.0)
    }
}
