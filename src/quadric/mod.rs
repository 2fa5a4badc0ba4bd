//! Quadric surfaces: every point `x = (p, 1)` with `x^T A x = 0` that lies in a trim sphere.
//!
//! # Theory
//!
//! O. Lawlor, *Storing raytraced geometry in textures* (CS 481, University of Alaska Fairbanks, 2010): a symmetric 4x4
//! matrix represents a sphere, an ellipsoid, a cylinder, a cone, a paraboloid, a hyperboloid or a pair of planes. A
//! trim sphere limits it to a finite size. A record has six texels: four for the matrix, one for the centre and radius
//! of the trim sphere, one for the reflectance and opacity.
//!
//! Two changes are made here. First, the arithmetic is done in the frame of the trim sphere, where the trim sphere is
//! the unit ball and the largest entry of the matrix is 1 ([`local`]). About the world's origin the entries for a small
//! sphere far away cancel; in its own frame they do not, at any offset and scale. Second, shadows multiply: light that
//! crosses several quadrics of opacity `k` arrives with the product of their `1 - k`, where the article uses the
//! largest `k`.
//!
//! A quadric is a sheet without an inside. Each counts once per shadow ray, however often the ray crosses it. The
//! picture shows the nearest sheet; opacity applies to shadows only.
//!
//! Scenes draw each quadric as a field ([`crate::scene::fields::quadric`]).

pub(crate) mod local;

use crate::error::{ArgumentError, Error};
use glam::{DMat4, DVec3, Vec3};

/// A quadric surface in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quadric {
    /// Symmetric matrix of any scale.
    pub matrix: DMat4,
    /// Centre of the trim sphere.
    pub center: DVec3,
    /// Radius of the trim sphere, world units.
    pub radius: f64,
    /// Linear RGB.
    pub reflectance: Vec3,
    /// Fraction of the light that one crossing blocks, 0 to 1.
    pub opacity: f32,
}

/// Fails for a quadric that is not finite, whose matrix is zero, or whose trim sphere has no radius.
pub fn check(quadrics: &[Quadric]) -> Result<(), Error> {
    for (i, quadric) in quadrics.iter().enumerate() {
        if let Err(problem) = quadric.check() {
            return Err(ArgumentError::new("quadrics", format!("[{i}]: {problem}")).into());
        }
    }
    Ok(())
}

impl Quadric {
    fn check(&self) -> Result<(), String> {
        if !self.matrix.is_finite() || self.matrix == DMat4::ZERO {
            return Err(format!("matrix must be finite and not zero, got {}", self.matrix));
        }
        if !(self.center.is_finite() && self.radius.is_finite() && self.radius > 0.0) {
            return Err(format!(
                "center and radius must be finite, the radius above 0, got {}, {}",
                self.center, self.radius
            ));
        }
        if !(self.reflectance.is_finite() && (0.0..=1.0).contains(&self.opacity)) {
            let problem = format!(
                "reflectance must be finite, the opacity from 0 to 1, got {}, {}",
                self.reflectance, self.opacity
            );
            return Err(problem);
        }
        Ok(())
    }
}
