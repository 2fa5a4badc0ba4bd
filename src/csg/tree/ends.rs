//! The ends and sides of extrusions.

use super::checks::not_negative;
use super::profile::Profile;
use crate::error::ShapeError;
use glam::{DVec2, DVec3};

/// Taper and chamfers of an extrusion.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Ends {
    /// Angle between the sides and z, radians. The solid becomes narrower upwards for a positive angle and downwards
    /// for a negative one, and has the profile at its wider end.
    pub taper: f64,
    /// Length that the chamfer at the lower and at the upper end takes off the side and off the end.
    pub chamfer: [f64; 2],
}

impl Ends {
    /// Checks an angle in degrees and chamfers of an extrusion.
    pub fn new(taper_deg: f64, chamfer: [f64; 2], height: f64) -> Result<Self, ShapeError> {
        if !(-89.0..=89.0).contains(&taper_deg) {
            return Err(ShapeError::argument("taper_deg", format!("must be -89 to 89 degrees, got {taper_deg}")));
        }
        let [low, high] = chamfer.map(|length| not_negative("chamfer", length));
        let chamfer = [low?, high?];
        if chamfer[0] + chamfer[1] > height {
            let problem = format!("takes {} off the height of {height}", chamfer[0] + chamfer[1]);
            return Err(ShapeError::argument("chamfer", problem));
        }
        Ok(Self { taper: taper_deg.to_radians(), chamfer })
    }

    /// Whether the sides are vertical and the ends are flat.
    pub fn is_plain(&self) -> bool {
        *self == Self::default()
    }

    /// Parameters of the distance function, with lengths times `scale`: sine and cosine of the taper, the chamfers,
    /// and one over the largest slope of a chamfer, which is the sum of two unit normals; zero for a plain extrusion.
    pub fn parameters(&self, scale: f64) -> [f64; 5] {
        let (sin, cos) = self.taper.sin_cos();
        let [low, high] = self.chamfer;
        let inverse = 1.0 / (2.0 + 2.0 * sin.abs()).sqrt();
        [sin, cos, scale * low, scale * high, if self.is_plain() { 0.0 } else { inverse }]
    }

    /// The largest `n . p` over the extrusion of a profile.
    pub fn support(&self, profile: &Profile, half_height: f64, n: DVec3) -> f64 {
        let flat = DVec2::new(n.x, n.y);
        let inset = 2.0 * half_height * self.taper.tan().abs();
        let rise = half_height * n.z;
        if inset == 0.0 {
            return profile.support(flat) + rise.abs();
        }
        // A positive taper has the whole profile at the lower end.
        let (whole, shrunk) = if self.taper > 0.0 { (-rise, rise) } else { (rise, -rise) };
        (profile.support(flat) + whole).max(profile.support_of_inset(flat, inset) + shrunk)
    }

    /// Growth of the box of a level set; slanted sides go on beyond the wider end.
    pub fn growth(&self) -> f64 {
        (1.0 + self.taper.sin().abs()) / self.taper.cos()
    }
}
