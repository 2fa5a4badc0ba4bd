//! The appearance of surfaces.

/// Appearance of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Linear RGB and opacity; a factor of the texture.
    pub color: [f32; 4],
    /// Index of a texture of the scene.
    pub texture: Option<u32>,
    /// Linear RGB that the surface emits; a factor of its texture.
    pub emission: [f32; 3],
    /// Index of a texture of the scene.
    pub emission_texture: Option<u32>,
    /// Whether the colour is shown unchanged, without lighting.
    pub unlit: bool,
    /// Strength of the highlight.
    pub specular: f32,
    /// Sharpness of the highlight, the exponent of Blinn-Phong.
    pub shininess: f32,
    /// Use of the opacity of the colour.
    pub alpha: Alpha,
    /// Whether the back of faces is visible too.
    pub two_sided: bool,
    /// Length inside the object after which 1/e of the light remains, world units, for each of RGB; 0 if light does not
    /// enter.
    pub scattering: [f32; 3],
}

#[cfg(test)]
impl Material {
    /// A half transparent colour alone, for tests.
    pub(crate) fn plain(two_sided: bool, alpha: Alpha) -> Self {
        Self {
            color: [0.5, 0.6, 0.7, 0.5],
            texture: None,
            emission: [0.0; 3],
            emission_texture: None,
            unlit: false,
            specular: 0.0,
            shininess: 1.0,
            alpha,
            two_sided,
            scattering: [0.0; 3],
        }
    }
}

/// Use of opacity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alpha {
    /// Opacity is ignored.
    Opaque,
    /// Cut out where the opacity is below this.
    Mask(f32),
    /// Opacity is the fraction of the background that the surface hides.
    Blend,
}
