//! Cones that are asked by thin rays.
//!
//! A distance says how much of a cone a solid covers: as deep as its axis goes in, as far is the edge. A sheet has no depth,
//! and where a field is dear a ray is cheaper than its distances. Such things answer thin rays, spread evenly over the
//! cone's section: each ray keeps the product of what lets it pass, and their mean is the share. All things of a scene meet
//! the same rays, so sheets that meet in an edge let nothing through between them, and what overlaps counts once a ray.
//!
//! A whole light is asked by 16 narrow cones, so by 128 rays.

use super::shadow::{Ray, basis, disc_point, toward};
use glam::Vec3;

/// Rays of a cone.
pub const THIN_RAYS: usize = 8;

/// What is left of the rays of a cone.
#[derive(Debug, Clone, Copy)]
pub struct ThinRays {
    shares: [f32; THIN_RAYS],
    /// Something was near enough to be asked.
    pub is_asked: bool,
}

impl ThinRays {
    pub const NEW: Self = Self { shares: [1.0; THIN_RAYS], is_asked: false };

    /// Let something of an opacity stand in the way of the rays that hit it.
    pub fn block(&mut self, opacity: f32, ray: &Ray, slope: f32, mut is_hit: impl FnMut(&Ray) -> bool) {
        self.is_asked = true;
        let axes = basis(ray.direction);
        for (i, share) in self.shares.iter_mut().enumerate() {
            if *share > 0.0 && is_hit(&toward(ray, axes, slope, disc_point(i as u32, THIN_RAYS as u32, 0.0))) {
                *share *= 1.0 - opacity;
            }
        }
    }

    /// Mean of what is left.
    pub fn share(&self) -> f32 {
        self.shares.iter().sum::<f32>() / THIN_RAYS as f32
    }
}

/// Whether a cone of radius `slope t` about `origin + t direction` stays clear of a ball; `direction` is unit. On the safe
/// side behind the origin.
///
/// The ball's centre lies `z` along the axis and `r` from it, so `(r - slope z) / sqrt(1 + slope^2)` outside the cone's side.
pub fn is_clear(origin: Vec3, direction: Vec3, slope: f32, center: Vec3, radius: f32) -> bool {
    let way = center - origin;
    let along = way.dot(direction);
    let aside = (way - along * direction).length();
    aside - slope * along > radius * (1.0 + slope * slope).sqrt()
}
