//! The options of a picture of a scene.

use crate::picture::Light;
use crate::scene::fields::field::Field;
use glam::{Mat3, Mat4, Vec3};
use std::fmt;
use std::sync::Arc;

/// Light from everywhere.
#[derive(Debug, Clone, PartialEq)]
pub enum Ambient {
    /// The same light from all directions, as a fraction of a light of colour 1.
    Constant(f32),
    /// For red, green and blue, the symmetric matrix `M` of the light that a white surface with the unit normal `n`
    /// reflects, `(n, 1)^T M (n, 1)`.
    Surroundings(Box<[Mat4; 3]>),
}

impl Ambient {
    /// Linear RGB of a white surface with a unit normal, world space.
    pub fn on(&self, normal: Vec3) -> Vec3 {
        match self {
            Self::Constant(share) => Vec3::splat(*share),
            Self::Surroundings(forms) => {
                let n = normal.extend(1.0);
                // Below zero is an error of the quadratic form.
                Vec3::from_array([0, 1, 2].map(|channel| n.dot(forms[channel] * n).max(0.0)))
            }
        }
    }

    /// Linear RGB of the light from a unit direction, world space. Its reflection by a white surface is [`Self::on`].
    ///
    /// With the mean `a` of the light and its moments `b` and `C`, the reflection is `15/8 n.Cn + 2 n.b + 3/8 a` and
    /// the light of the same spherical harmonics `15/2 n.Cn + 3 n.b - 3/2 a`.
    pub fn from(&self, direction: Vec3) -> Vec3 {
        match self {
            Self::Constant(share) => Vec3::splat(*share),
            Self::Surroundings(forms) => Vec3::from_array([0, 1, 2].map(|channel| {
                let form = &forms[channel];
                let first = direction.dot(form.w_axis.truncate());
                let second = direction.dot(Mat3::from_mat4(*form) * direction);
                4.0 * second + 3.0 * first - 4.0 * form.w_axis.w
            })),
        }
    }

    /// Whether no light comes from anywhere.
    pub fn is_dark(&self) -> bool {
        match self {
            Self::Constant(share) => *share == 0.0,
            Self::Surroundings(forms) => forms.iter().all(|form| *form == Mat4::ZERO),
        }
    }
}

/// Method for the first surface of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Primary {
    /// Triangles if there are any, else the field.
    #[default]
    Auto,
    /// Triangles only where there are any, by a rasteriser.
    Raster,
    /// The field of every object.
    Raymarch,
}

/// Kind of shadows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SceneShadows {
    /// Every light reaches every surface that faces it.
    None,
    /// A light reaches a point completely or not at all.
    Hard,
    /// The visible fraction of the light's disc, by cones.
    #[default]
    Soft,
    /// This number of rays to each light: the reference for soft shadows.
    Area(u32),
}

/// Number of bounces and of paths for each surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BounceOptions {
    /// Largest number of diffuse reflections before the visible surface, 1 to [`MAX_BOUNCES`].
    pub count: u32,
    /// Number of paths.
    pub samples: u32,
}

/// Largest number of bounces.
pub const MAX_BOUNCES: u32 = 4;

/// Fields in world space, finest first, and the distance from which they are evaluated.
#[derive(Clone)]
pub struct FarField {
    /// One field, or several nested ones ([`crate::scene::fields::nested`]).
    pub levels: Vec<Arc<dyn Field>>,
    /// World units. The default is [`FAR_VOXELS`] voxels of the level in which a ray starts.
    pub distance: Option<f64>,
}

/// Far fields are equal if they have the same fields, not copies of them, and the same distance.
impl PartialEq for FarField {
    fn eq(&self, other: &Self) -> bool {
        let [own, others] = [self, other].map(|far| far.levels.iter().map(|level| Arc::as_ptr(level).addr()));
        own.eq(others) && self.distance == other.distance
    }
}

impl fmt::Debug for FarField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "FarField of {} levels from {:?}", self.levels.len(), self.distance)
    }
}

/// Default start of the far part of a ray, voxels of the level in which the ray starts. The surface of a far field is
/// up to about one voxel off, so the edge of a shadow is accurate to an eighth of the length of the ray.
pub(crate) const FAR_VOXELS: f64 = 8.0;

/// Options of a picture.
#[derive(Debug, Clone)]
pub struct RenderOptions {
    /// Width and height, pixels.
    pub size: [u32; 2],
    /// Method for the first surface of a pixel.
    pub primary: Primary,
    /// Kind of shadows.
    pub shadows: SceneShadows,
    /// The lights, at most [`crate::picture::MAX_LIGHTS`].
    pub lights: Vec<Light>,
    /// Ambient light.
    pub ambient: Ambient,
    /// Range of occlusion of the ambient light, world units; None without occlusion.
    pub occlusion: Option<f64>,
    /// Indirect diffuse light in place of the ambient light and its occlusion; None without.
    pub bounces: Option<BounceOptions>,
    /// Whether the noise of sampled light is removed; see [`crate::scene::lighting::denoise`].
    pub denoise: bool,
    /// Far field for rays beyond a distance; without it the instances are evaluated everywhere.
    pub far: Option<FarField>,
    /// Linear RGBA of pixels without a hit.
    pub background: [f32; 4],
    /// Factor of all colours.
    pub exposure: f32,
    /// Number of rays per pixel for its colour; 1, or a square number.
    pub samples: u32,
    /// Light is evaluated at every `light_scale`-th pixel along each side: 1 or 2; see
    /// [`crate::scene::lighting::evaluation`].
    pub light_scale: u32,
}

#[cfg(test)]
impl Default for RenderOptions {
    /// Simple options for tests.
    fn default() -> Self {
        Self {
            size: [64, 49],
            primary: Primary::Auto,
            shadows: SceneShadows::None,
            lights: Vec::new(),
            ambient: Ambient::Constant(1.0),
            occlusion: None,
            bounces: None,
            denoise: true,
            far: None,
            background: [0.0; 4],
            exposure: 1.0,
            samples: 1,
            light_scale: 1,
        }
    }
}
