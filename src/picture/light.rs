//! The lights of pictures.

use crate::gpu::constants;
use glam::{DVec3, Vec3};

/// Largest number of lights of a picture.
pub const MAX_LIGHTS: usize = constants::MAX_LIGHTS;

/// A light in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// A light so far away that its disc has the same direction from every point.
    Directional {
        /// Direction in which the light travels, any length.
        direction: DVec3,
        /// Linear RGB.
        color: Vec3,
        /// Tangent of half the angle of the light's disc.
        slope: f32,
    },
    /// A light at a position.
    Point {
        /// Position, world units.
        position: DVec3,
        /// Linear RGB.
        color: Vec3,
        /// Radius of the ball that emits the light, world units.
        radius: f64,
        /// Distance at which the light ends, world units; None without falloff.
        range: Option<f64>,
        /// Cone that the light shines into; None for all directions.
        spot: Option<Spot>,
    },
}

#[cfg(test)]
impl Light {
    /// A directional light without a size.
    pub(crate) fn sun(direction: DVec3, color: Vec3) -> Self {
        Self::Directional { direction, color, slope: 0.0 }
    }
}

/// The cone of a spot light. Angles are those between a direction and the axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spot {
    /// Unit direction of the axis, in which the light travels.
    pub axis: DVec3,
    /// Cosines of the angle at which the intensity begins to decrease, and of the angle at which it is zero.
    pub cosines: [f64; 2],
}

/// A light of a picture of one object, at infinite distance and without a size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct DirectionalLight {
    /// Unit direction in which the light travels, world space.
    pub direction: Vec3,
    /// Linear RGB. A white light of value 1 lights a surface that faces it to the surface's own colour.
    pub color: Vec3,
}
