//! Pictures of quadrics on the CPU, in f64.
//!
//! The nearest sheet on the ray of each pixel is drawn; its normal faces the eye. Shading is the same as in every
//! picture ([`crate::render::shade`]) with the reflectance of the quadric as its colour. A light behind the visible
//! side of a sheet does not light it. The ray to a light starts on the sheet itself, without a bias: the crossing at
//! its start is excluded explicitly.

use super::Quadrics;
use crate::picture::{Camera, DirectionalLight, RaymarchOptions, Row};
use crate::render::shade::lit;
use glam::DVec3;

/// Data shared by all pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct QuadricView<'a> {
    pub quadrics: &'a Quadrics,
    pub camera: &'a Camera,
    pub options: &'a RaymarchOptions,
    /// Lights with unit directions.
    pub lights: &'a [DirectionalLight],
}

impl QuadricView<'_> {
    /// Fills pixel `x` of row `y`. The row is initialised to "no hit".
    pub(super) fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);
        // Multiples of `direction` are depths.
        let start = self.camera.pixel_start(x as u32, y as u32, self.options.size);
        let direction = self.camera.pixel_direction(x as u32, y as u32, self.options.size);
        let (hit, tried) = self.quadrics.first_hit(start, direction, [0.0, f64::INFINITY]);
        row.steps[x] = tried;
        let Some(hit) = hit else { return };

        let p = start + hit.t * direction;
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let to_eye = -direction.normalize().as_vec3();
        let normal = hit.normal.as_vec3();
        let point = self.options.lit_point(normal, to_eye, self.quadrics.reflectance(hit.quadric));
        let color = lit(&point, self.options, self.lights, shadow, |to_light| {
            self.share_that_arrives(p, hit.normal, hit.quadric, to_light.as_dvec3())
        });

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = hit.t as f32;
        row.normal[3 * x..][..3].copy_from_slice(&normal.to_array());
        row.object_id[x] = hit.quadric as i32;
    }

    fn share_that_arrives(&self, p: DVec3, normal: DVec3, quadric: u32, to_light: DVec3) -> f32 {
        if normal.dot(to_light) <= 0.0 {
            return 0.0;
        }
        self.quadrics.transmittance(p, to_light, f64::INFINITY, Some(quadric))
    }
}
