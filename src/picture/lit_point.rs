//! The reflection of a surface: Blinn-Phong (Blinn 1977).

use glam::Vec3;

/// A point of a surface that light falls on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LitPoint {
    /// Unit normal in world space, outward.
    pub normal: Vec3,
    /// Unit direction towards the eye, world space.
    pub to_eye: Vec3,
    /// Linear RGB.
    pub color: Vec3,
    /// Strength of the highlight.
    pub specular: f32,
    /// Sharpness of the highlight, the exponent of Blinn-Phong.
    pub shininess: f32,
}

impl LitPoint {
    /// Linear RGB towards the eye under a light of colour 1 in the unit direction `to_light`, world space:
    /// `color * n.l + specular * max(0, n.h)^shininess`. A side that faces away from the light reflects none of it.
    #[inline]
    pub(crate) fn reflected(&self, to_light: Vec3) -> Vec3 {
        let cosine = self.normal.dot(to_light);
        if cosine > 0.0 {
            let half = (to_light + self.to_eye).normalize_or_zero();
            let highlight = self.specular * self.normal.dot(half).max(0.0).powf(self.shininess);
            cosine * self.color + highlight
        } else {
            Vec3::ZERO
        }
    }
}
