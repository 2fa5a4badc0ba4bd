//! Cones that are estimated by thin rays.
//!
//! A distance determines the covered part of a cone for a solid: the depth of the axis inside equals the distance of
//! the edge. A sheet has no depth, and where a field is expensive a ray costs less than its distances. Such objects are
//! tested by thin rays, spread evenly over the cone's section: each ray keeps the product of the transmitted fractions,
//! and their mean is the fraction of the cone. All objects of a scene use the same rays, so sheets that share an edge
//! let no light through between them, and overlapping objects count once per ray.
//!
//! A whole light has 16 narrow cones, so 128 rays.

use super::light_rays::{LightRay, basis, disc_point, toward};
use glam::Vec3;

/// Number of rays of a cone.
pub(crate) const THIN_RAYS: usize = 8;

/// Transmitted fractions of the rays of a cone.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RayBundle {
    shares: [f32; THIN_RAYS],
    /// Whether an object was near enough to be tested.
    pub is_tested: bool,
}

impl RayBundle {
    pub(crate) const NEW: Self = Self { shares: [1.0; THIN_RAYS], is_tested: false };

    /// Multiplies the rays that hit an object of an opacity by its transmitted fraction.
    pub(crate) fn block(
        &mut self,
        opacity: f32,
        ray: &LightRay,
        slope: f32,
        mut is_hit: impl FnMut(&LightRay) -> bool,
    ) {
        self.is_tested = true;
        let axes = basis(ray.direction);
        for (i, share) in self.shares.iter_mut().enumerate() {
            if *share > 0.0 && is_hit(&toward(ray, axes, slope, disc_point(i as u32, THIN_RAYS as u32, 0.0))) {
                *share *= 1.0 - opacity;
            }
        }
    }

    /// Mean of the transmitted fractions.
    pub(crate) fn share(&self) -> f32 {
        self.shares.iter().sum::<f32>() / THIN_RAYS as f32
    }
}

/// Whether a cone of radius `slope t` about `origin + t direction` does not touch a ball. `direction` must have unit
/// length. The test is conservative behind the origin.
///
/// The centre of the ball lies `z` along the axis and `r` from it, so it is `(r - slope z) / sqrt(1 + slope^2)` outside
/// the side of the cone.
pub(crate) fn is_clear(origin: Vec3, direction: Vec3, slope: f32, center: Vec3, radius: f32) -> bool {
    let to_center = center - origin;
    let along = to_center.dot(direction);
    let aside = (to_center - along * direction).length();
    aside - slope * along > radius * (1.0 + slope * slope).sqrt()
}
