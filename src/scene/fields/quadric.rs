//! A quadric in a scene.
//!
//! # Theory
//!
//! Field space is the frame of the trim sphere ([`crate::quadric::local`]) in units of 1/[`UNITS`] of its radius. Rays
//! intersect the surface at its stable roots, without steps or epsilons. The roots are computed in float64 for a ray
//! whose start on the box is rounded to float32, so a hit has an error of about 1e-7 of the radius.
//!
//! A quadric is a sheet: it has no inside, both sides are visible, and however often a ray crosses it, it counts once.
//! Its distance is never negative, and cones are tested by thin rays ([`crate::scene::light::ray_bundle`]). `distance`
//! is the proven lower bound `|M| s^2 + |grad f| s = |f|` of [`Local::distance_bound`], extended outside the trim
//! sphere as `sqrt(a^2 + s^2)`.

use super::device_fields::DeviceFields;
use super::field::{Field, FieldHit, FieldRay, SurfaceAppearance};
use crate::error::DeviceError;
use crate::quadric::Quadric;
use crate::quadric::local::{Local, LocalRay};
use glam::{DAffine3, DVec3, Vec3};

/// Number of field units in the radius of the trim sphere. Rays that leave the surface start half a unit off it.
pub(crate) const UNITS: f64 = 1024.0;

/// A quadric prepared for the rays of a scene.
#[derive(Debug, Clone)]
pub(crate) struct QuadricField {
    /// The form in field space: about the origin, with a radius of `UNITS`.
    local: Local,
    field_from_local: DAffine3,
    reflectance: Vec3,
    opacity: f32,
}

impl QuadricField {
    /// `quadric` must pass [`crate::quadric::check`].
    pub(crate) fn new(quadric: &Quadric) -> Self {
        let placed = Local::new(quadric);
        let per_unit = UNITS / placed.radius;
        Self {
            local: Local { center: DVec3::ZERO, radius: UNITS, ..placed },
            field_from_local: DAffine3::from_scale(DVec3::splat(per_unit)) * DAffine3::from_translation(-placed.center),
            reflectance: quadric.reflectance,
            opacity: quadric.opacity,
        }
    }
}

impl Field for QuadricField {
    fn field_from_local(&self) -> DAffine3 {
        self.field_from_local
    }

    fn bounds(&self) -> [Vec3; 2] {
        self.surface_bounds()
    }

    fn surface_bounds(&self) -> [Vec3; 2] {
        [Vec3::splat(-UNITS as f32), Vec3::splat(UNITS as f32)]
    }

    fn voxel(&self) -> f64 {
        1.0 / self.field_from_local.matrix3.x_axis.x
    }

    fn first_hit(&self, ray: &FieldRay, t_max: f32) -> (Option<FieldHit>, u32) {
        let hit = LocalRay::new(&self.local, ray.origin.as_dvec3(), ray.direction.as_dvec3()).and_then(|line| {
            let mut ahead = line.roots().into_iter().flatten().map(|root| line.t(root) as f32);
            ahead.find(|t| (0.0..=t_max).contains(t))
        });
        (hit.map(|t| FieldHit { t, at_start: false, part: 0 }), 1)
    }

    fn distance(&self, p: Vec3) -> f32 {
        // The value is rounded down, because it is a lower bound.
        (self.local.distance_bound(p.as_dvec3()) * self.voxel()) as f32 * (1.0 - f32::EPSILON)
    }

    fn distance_guess(&self, _: Vec3, distance: f32) -> f32 {
        distance
    }

    fn gradient(&self, p: Vec3) -> Vec3 {
        // The gradient points away from the sheet, on the side of the point.
        let slope = self.local.m * (p.as_dvec3() / UNITS) + self.local.v;
        let side = if self.local.value(p.as_dvec3() / UNITS) < 0.0 { -1.0 } else { 1.0 };
        (side * slope).normalize_or_zero().as_vec3()
    }

    fn appearance(&self, p: Vec3, _: &FieldHit, direction: Vec3) -> SurfaceAppearance {
        let normal = self.local.normal(p.as_dvec3(), direction.as_dvec3());
        SurfaceAppearance { normal: normal.as_vec3(), color: Some(self.reflectance.to_array()) }
    }

    fn opacity(&self) -> f32 {
        self.opacity
    }

    fn prefers_rays(&self) -> bool {
        true
    }

    fn chord(&self, ray: &FieldRay, enters: bool) -> Option<f32> {
        let line = LocalRay::new(&self.local, ray.origin.as_dvec3(), ray.direction.as_dvec3());
        Some(line.map_or(0.0, |line| line.chord(enters) as f32))
    }

    fn surface_radius(&self) -> f32 {
        UNITS as f32
    }

    fn append_to(&self, tables: &mut DeviceFields<'_>) -> Result<bool, DeviceError> {
        tables.add_quadric(&self.local)?;
        Ok(true)
    }

    fn is_traced_again(&self) -> bool {
        true
    }
}
