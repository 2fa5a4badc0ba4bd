//! Options of a picture of one field.

use super::light::{DirectionalLight, Light, MAX_LIGHTS};
use super::lit_point::LitPoint;
use crate::error::{ArgumentError, Error, choice};
#[cfg(test)]
use glam::DVec3;
use glam::Vec3;

/// Kind of shadows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Shadows {
    /// No shadows: every light reaches every surface.
    None,
    /// Hard shadows: a light reaches a point completely or not at all.
    #[default]
    Hard,
}

impl Shadows {
    /// Converts the public name of a kind of shadows.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("shadows", name, &[("none", Self::None), ("hard", Self::Hard)])
    }
}

/// Interpolation between the samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Filter {
    /// Trilinear interpolation in float32; a hit is its root.
    #[default]
    Linear,
    /// The sample of the voxel that contains a point: the solid is a union of voxels.
    Nearest,
}

/// Distance of the start of a shadow ray from a trilinear surface, voxels. The surface departs from a smooth one by
/// h^2 / (8 R), less than an eighth of a voxel for a radius of a voxel or more. A grazing ray rises by the same amount
/// again over the next voxels.
const SHADOW_BIAS_VOXELS: f32 = 0.5;

/// [`SHADOW_BIAS_VOXELS`] for faces of voxels, which are flat: more than the rounding of a position among 2^12 voxels.
const FACE_BIAS_VOXELS: f32 = 1e-3;

impl Filter {
    /// Converts the public name of a filter.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        choice("filter", name, &[("linear", Self::Linear), ("nearest", Self::Nearest)])
    }

    /// Distance of the start of a shadow ray from the surface, voxels.
    pub(crate) fn bias_voxels(self) -> f32 {
        if self == Self::Nearest { FACE_BIAS_VOXELS } else { SHADOW_BIAS_VOXELS }
    }
}

/// Options of a picture. The names come from the Python interface, which defines the defaults.
#[derive(Debug, Clone, PartialEq)]
pub struct RaymarchOptions {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Directional lights, at most [`MAX_LIGHTS`]; an empty list leaves ambient light only. Their sizes have no effect.
    pub lights: Vec<Light>,
    /// Ambient light, equal from all directions, as a fraction of a light of colour 1.
    pub ambient: f32,
    /// Linear RGB of the surface.
    pub color: Vec3,
    /// Strength of the highlight.
    pub specular: f32,
    /// Sharpness of the highlight, the exponent of Blinn-Phong.
    pub shininess: f32,
    /// Linear RGBA of pixels without a hit.
    pub background: [f32; 4],
    /// Kind of shadows.
    pub shadows: Shadows,
    /// Interpolation between the samples.
    pub filter: Filter,
}

#[cfg(test)]
impl Default for RaymarchOptions {
    /// Simple options for tests.
    fn default() -> Self {
        Self {
            size: [512, 512],
            lights: vec![Light::sun(DVec3::new(0.3, -0.7, -0.6), Vec3::ONE)],
            ambient: 0.2,
            color: Vec3::splat(0.8),
            specular: 0.25,
            shininess: 32.0,
            background: [1.0; 4],
            shadows: Shadows::Hard,
            filter: Filter::Linear,
        }
    }
}

/// Largest number of pixels of a picture: 16384 x 16384, about 12 GiB of arrays.
const MAX_PIXELS: u64 = 1 << 28;

impl RaymarchOptions {
    pub(crate) fn check(&self) -> Result<(), Error> {
        let error = |argument, problem: String| Err(ArgumentError::new(argument, problem).into());
        let [width, height] = self.size;
        if width == 0 || height == 0 || width as u64 * height as u64 > MAX_PIXELS {
            return error("size", format!("expected 1 to {MAX_PIXELS} pixels, got {width} x {height}"));
        }
        if self.lights.len() > MAX_LIGHTS {
            return error("lights", format!("at most {MAX_LIGHTS}, got {}", self.lights.len()));
        }
        if !(self.ambient.is_finite() && self.ambient >= 0.0) {
            return error("ambient", format!("must be finite and at least 0, got {}", self.ambient));
        }
        if !self.color.is_finite() {
            return error("color", format!("must be finite, got {}", self.color));
        }
        if !self.specular.is_finite() {
            return error("specular", format!("must be finite, got {}", self.specular));
        }
        if !(self.shininess.is_finite() && self.shininess >= 0.0) {
            return error("shininess", format!("must be finite and at least 0, got {}", self.shininess));
        }
        Ok(())
    }

    /// A point with the highlight of these options. Both directions have unit length.
    pub(crate) fn lit_point(&self, normal: Vec3, to_eye: Vec3, color: Vec3) -> LitPoint {
        LitPoint { normal, to_eye, color, specular: self.specular, shininess: self.shininess }
    }

    /// The lights, which must be directional.
    pub(crate) fn directional_lights(&self) -> Result<Vec<DirectionalLight>, Error> {
        let checked = |(i, light): (usize, &Light)| {
            let error = |problem: String| Err(ArgumentError::new("lights", format!("[{i}] {problem}")).into());
            let Light::Directional { direction, color, .. } = *light else {
                return error("is at a position, expected a directional light".into());
            };
            let unit = direction.normalize_or_zero().as_vec3();
            if unit == Vec3::ZERO {
                return error(format!("has the direction {direction}, expected a finite one that is not zero"));
            }
            if !color.is_finite() {
                return error(format!("has the colour {color}, expected finite numbers"));
            }
            Ok(DirectionalLight { direction: unit, color })
        };
        self.lights.iter().enumerate().map(checked).collect()
    }
}
