//! Pictures of dense, encoded and sparse fields.

use super::shade::{PixelHit, Shader};
use crate::error::Error;
use crate::march::blocks::Blocks;
use crate::march::marcher::{Marcher, clip_to_box};
use crate::march::tiles::{GridCamera, Tiles};
use crate::picture::{Camera, Frame, RaymarchOptions, Row};
use crate::progress::Progress;
use glam::{DMat3, DVec3, Vec3};

/// Draws the zero level set of a field.
pub fn raymarch<F: Blocks>(
    field: F,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    options.check()?;
    let lights = options.directional_lights()?;
    let marcher = Marcher::new(field, progress)?;
    let shader = Shader::new(&marcher, options, &lights);
    let spacing = marcher.field.grid().spacing();
    let eye = marcher.field.grid_from_world(camera.eye);
    let camera_in_grid = GridCamera::new(camera, DMat3::from_diagonal(spacing), eye, options.size);
    let view = RaymarchView {
        camera,
        spacing,
        tiles: Tiles::new(&marcher, &camera_in_grid, progress)?,
        shape: marcher.field.shape(),
        marcher: &marcher,
        shader,
        options,
    };

    Frame::by_pixels(options.size, lights.len(), progress, |x, y, row| view.draw_pixel(x, y, row))
}

/// Data shared by all pixels.
struct RaymarchView<'a, F: Blocks> {
    camera: &'a Camera,
    spacing: DVec3,
    tiles: Tiles,
    shape: DVec3,
    marcher: &'a Marcher<F>,
    shader: Shader<'a, F>,
    options: &'a RaymarchOptions,
}

impl<F: Blocks> RaymarchView<'_, F> {
    /// Fills pixel `x` of row `y`. The row is initialised to "no hit".
    fn draw_pixel(&self, x: usize, y: usize, row: &mut Row<'_>) {
        row.color[4 * x..][..4].copy_from_slice(&self.options.background);

        let Some(depths) = self.tiles.depths(x, y) else { return };
        // Multiples of `direction` are depths, in world and in grid space.
        let start = self.camera.pixel_start(x as u32, y as u32, self.options.size);
        let direction = self.camera.pixel_direction(x as u32, y as u32, self.options.size);
        let start_grid = self.marcher.field.grid_from_world(start);
        let direction_grid = direction / self.spacing;
        let Some(clipped) = clip_to_box(start_grid, direction_grid, self.shape) else { return };
        let voxels_per_depth = direction_grid.length();
        let Some(ray) = clipped.between(depths, voxels_per_depth) else { return };
        let march = self.marcher.trace(&ray, self.options.filter);
        row.steps[x] = march.steps;
        let Some(hit) = march.hit else { return };

        let p_grid = ray.origin + hit.t * ray.direction;
        let to_eye = -direction.normalize().as_vec3();
        // The hit lies on a face of the box, which cuts the solid, or on a face of a voxel.
        let face = if hit.at_start { clipped.enter_axis } else { hit.face };
        let normal = match face {
            Some(axis) => {
                let mut normal = Vec3::ZERO;
                normal[axis] = to_eye[axis].signum();
                normal
            }
            // The eye is inside the solid.
            None if hit.at_start => to_eye,
            None => self.shader.normal(p_grid, to_eye),
        };
        let shadow = &mut row.shadow[x * row.lights..][..row.lights];
        let color = self.shader.shade(&PixelHit { p_grid, normal, to_eye }, shadow);

        row.color[4 * x..][..4].copy_from_slice(&[color.x, color.y, color.z, 1.0]);
        row.depth[x] = (clipped.t_enter + hit.t as f64 / voxels_per_depth) as f32;
        row.normal[3 * x..][..3].copy_from_slice(&normal.to_array());
        row.object_id[x] = 0;
    }
}
