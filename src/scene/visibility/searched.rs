//! The instances that the rays of a picture search, and the pixels and depths at which their surfaces may be visible.

use super::gbuffer::View;
use crate::error::Error;
use crate::march::tiles::{GridCamera, Tiles};
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use std::ops::Range;

/// Half-open ranges of columns and rows.
pub(crate) type PixelRectangle = [Range<u32>; 2];

/// Tiles are computed for a field whose box covers at least 1 / LARGE of the pixels, because tiles always cover the
/// whole picture.
const LARGE: usize = 16;

/// Largest number of fields with tiles in a picture. The tiles of a field take one byte for each pixel.
const MOST_TILED: usize = 32;

/// The instances that the rays of a picture search.
pub(crate) struct SearchedInstances {
    /// For each instance, whether rays search it.
    pub is_searched: Vec<bool>,
    /// For each instance, the depths between which its surface lies on the rays of each tile; `None` if they were not
    /// computed.
    pub tiles: Vec<Option<Tiles>>,
    /// Number of instances with tiles.
    tiled: usize,
    /// The searched instances, each with the rectangle of its box on the screen.
    rectangles: Vec<(usize, PixelRectangle)>,
}

impl SearchedInstances {
    /// A list of `count` instances, none of which is searched.
    pub(crate) fn new(count: usize) -> Self {
        let tiles = std::iter::repeat_with(|| None).take(count).collect();
        Self { is_searched: vec![false; count], tiles, tiled: 0, rectangles: Vec::new() }
    }

    /// Adds an instance whose box covers a rectangle of the screen.
    pub(crate) fn add(&mut self, item: usize, rectangle: PixelRectangle, tiles: Option<Tiles>) {
        self.is_searched[item] = true;
        self.tiled += usize::from(tiles.is_some());
        self.tiles[item] = tiles;
        self.rectangles.push((item, rectangle));
    }

    /// Whether another field may have tiles.
    pub(crate) fn may_have_more_tiles(&self) -> bool {
        self.tiled < MOST_TILED
    }

    /// The only searched instance; `None` if there are several, or none.
    pub(crate) fn only(&self) -> Option<u32> {
        if let [(item, _)] = self.rectangles[..] { Some(item as u32) } else { None }
    }

    /// Marks the pixels of row `y` in which the surface of an instance may be visible.
    pub(crate) fn mark_row(&self, y: u32, columns: &mut [bool]) {
        for (item, [across, rows]) in &self.rectangles {
            if !rows.contains(&y) {
                continue;
            }
            let covered = &mut columns[across.start as usize..across.end as usize];
            match &self.tiles[*item] {
                None => covered.fill(true),
                Some(tiles) => covered.iter_mut().zip(across.clone()).for_each(|(is_covered, x)| {
                    *is_covered |= tiles.depths(x as usize, y as usize).is_some();
                }),
            }
        }
    }
}

/// The depths between which the surface of a field lies on the rays through the centres of pixels. The box of the field
/// covers about `pixels` of them.
pub(crate) fn tiles_of(
    scene: &Scene,
    instance: &Instance,
    view: &View,
    pixels: usize,
    progress: &Progress,
) -> Result<Option<Tiles>, Error> {
    let is_large = pixels * LARGE >= view.size[0] as usize * view.size[1] as usize;
    let Some(field) = instance.field.as_deref().filter(|_| is_large && view.offset == [0.5; 2]) else {
        return Ok(None);
    };
    let eye = instance.field_from_scene.transform_point3(scene.scene_from_world(view.camera.eye));
    let world_from_field = instance.field_from_scene.matrix3.inverse() * scene.scale;
    field.tiles(&GridCamera::new(&view.camera, world_from_field, eye, view.size), pixels, progress)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::picture::Camera;
    use crate::picture::camera::tests::look_at;
    use crate::scene::content::instance::InstanceInput;
    use crate::scene::content::material::{Alpha, Material};
    use crate::scene::content::options::{Primary, RenderOptions};
    use crate::scene::fields::field::{DenseField, SampledField};
    use crate::scene::visibility::pixel_ray::draw_row;
    use crate::scene::visibility::primary::draw;
    use glam::{DAffine3, DMat3, DVec3};
    use std::sync::Arc;

    const SIZE: [u32; 2] = [61, 47];
    const SIDE: usize = 40;

    /// A bumpy ball, whose box cuts it if `radius` is above 1.
    fn ball(radius: f64) -> SampledField<DenseField> {
        let grid = Grid::new(DVec3::splat(-1.0), DVec3::splat(1.0), [SIDE; 3]).unwrap();
        let value = |i: usize| {
            let p = grid.center(i % SIDE, i / SIDE % SIDE, i / (SIDE * SIDE));
            (p.length() - radius + 0.1 * (9.0 * p.x).sin() * (7.0 * p.y).sin()) as f32
        };
        let field = DenseField::new(grid, (0..grid.len()).map(value).collect()).unwrap();
        SampledField::new(field, [grid.lower, grid.upper], &Progress::new()).unwrap()
    }

    /// A large ball, or a translucent one with a small ball in front of it and one behind it.
    fn scene(radius: f64, linear: DMat3, shift: f64, has_small: bool) -> Scene {
        let field = Arc::new(ball(radius));
        let large = InstanceInput {
            triangles: None,
            field: Some(field.clone()),
            world_from_local: DAffine3::from_mat3_translation(linear, DVec3::splat(shift)),
            first_material: 0,
            own_colors: false,
            opacity: if has_small { 0.5 } else { 1.0 },
            casts_shadow: true,
            visible: true,
            object: 0,
            is_sheet: false,
            is_solid: false,
        };
        let small = [1.2, -1.2].map(|away| {
            let place = large.world_from_local.transform_point3(away * DVec3::new(0.5, 0.6, 0.6));
            let linear = 0.15 * linear;
            InstanceInput {
                world_from_local: DAffine3::from_mat3_translation(linear, place),
                opacity: 1.0,
                ..large.clone()
            }
        });
        let inputs = [large].into_iter().chain(small).take(if has_small { 3 } else { 1 }).collect();
        Scene::new(inputs, vec![Material::plain(false, Alpha::Opaque)], vec![]).unwrap()
    }

    #[test]
    fn tiles_leave_the_picture_as_it_is() {
        let turned = DMat3::from_rotation_y(0.6) * DMat3::from_rotation_x(0.3);
        let sheared =
            DMat3::from_cols(DVec3::new(1.0, 0.3, 0.0), DVec3::new(-0.4, 0.8, 0.2), DVec3::new(0.1, 0.0, 1.5));
        let mirrored = turned * DMat3::from_diagonal(DVec3::new(-1e-3, 2e-3, 1e-3));
        for (radius, linear, shift) in [(0.7, turned, 0.0), (1.3, sheared, 0.0), (0.7, mirrored, 1e3)] {
            let [unit, center] = [linear.determinant().abs().cbrt(), shift];
            for (away, is_parallel) in [(4.0, false), (4.0, true), (400.0, false), (0.2, false)] {
                let pose = look_at(center + away * unit * DVec3::new(0.5, 0.6, 0.6), DVec3::splat(center));
                let camera = match is_parallel {
                    true => Camera::orthographic(&pose, 3.0 * unit),
                    false => Camera::from_pose(&pose, if away > 10.0 { 0.5 } else { 50.0 }),
                };
                let camera = camera.unwrap();
                for has_small in [false, true] {
                    compare(&scene(radius, linear, shift, has_small), &camera, unit, away < 1.0);
                }
            }
        }
    }

    /// Compares the layers of a picture with the layers of searches without tiles. Rays begin at an eye that `is_near`.
    fn compare(scene: &Scene, camera: &Camera, unit: f64, is_near: bool) {
        let options = RenderOptions { size: SIZE, primary: Primary::Raymarch, ..RenderOptions::default() };
        let drawn = draw(scene, camera, &options, [0.5; 2], None, &Progress::new()).unwrap();
        let view = View { camera: *camera, size: SIZE, offset: [0.5; 2] };
        let tiles = tiles_of(scene, &scene.instances[0], &view, 2000, &Progress::new()).unwrap().unwrap();
        let is_shortened = |x, y| tiles.depths(x, y).is_none_or(|[near, _]| near > 0.0);
        let [width, height] = SIZE.map(|n| n as usize);
        assert!(is_near || (0..height).any(|y| (0..width).any(|x| is_shortened(x, y))));
        let mut count = 0;
        for y in 0..SIZE[1] {
            let (searched, _) = draw_row(scene, &options, &view, y, |ray, layers| ray.trace(layers, None));
            let row = &drawn.rows[y as usize];
            assert!(row.iter().map(|layer| layer.x).eq(searched.iter().map(|layer| layer.x)), "row {y}");
            count += row.len();
            for (a, b) in row.iter().zip(&searched) {
                // The rounding of positions and roots in cells of 1/20 unit.
                assert!((a.depth - b.depth).abs() <= 1e-5 * unit, "{} and {}", a.depth, b.depth);
                assert!((a.normal - b.normal).length() <= 1e-2);
            }
        }
        assert!(count > 200, "{count} layers");
    }
}
