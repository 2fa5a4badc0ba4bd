//! Occluders shared by neighbouring pixels.
//!
//! The surfaces of one instance in a tile of the picture lie in a ball of radius `r`. Let a light have the slope `s`
//! from the centre of the ball. A point of a cone from the ball to the light, at the distance `t` along its axis, then
//! lies within `r + s t` of the axis from the centre. Axes to a point light come together, and those to a directional
//! light are parallel. Each tile is searched once with this truncated cone. An instance is left out if its box stays
//! out of the truncated cone, or if its distances along the axis prove that its surface does. The surfaces of the tile
//! test the remaining instances only. A ray first tests the instance that blocked the last ray of the tile.

use super::pass::Pass;
use crate::geometry::clip;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::options::SceneShadows;
use crate::scene::content::tree::Line;
use crate::scene::light::cone::ConeWalk;
use crate::scene::light::light_rays::LightRay;
use crate::scene::light::lit_surface::SceneLight;
use crate::scene::light::occluder::NearList;
use crate::scene::visibility::gbuffer::Layer;
use glam::DVec3;
use rustc_hash::FxHashMap;

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 8;

/// Smallest number of evaluated surfaces in a tile for which a list is made.
const LEAST_PIXELS: u32 = 8;

/// Margin for the rounding of the radius, scene units.
const ROUNDING: f64 = 1e-6;

/// The tiles of [`TILE`] rows of a picture, by column and instance.
pub(crate) struct Tiles<'a> {
    pass: &'a Pass<'a>,
    rows: [u32; 2],
    tiles: FxHashMap<(u32, u32), Tile>,
}

/// The surfaces of one instance in a tile.
struct Tile {
    /// Range of depths, world units.
    depth: [f64; 2],
    /// Number of surfaces whose light must be evaluated.
    count: u32,
    /// For each light the instances that may block it; empty until a surface needs them.
    occluders: Vec<NearList>,
}

impl<'a> Tiles<'a> {
    /// Tiles for the rows `rows[0]` to `rows[1]`, inclusive.
    pub(crate) fn new(pass: &'a Pass<'a>, rows: [u32; 2]) -> Self {
        Self { pass, rows, tiles: FxHashMap::default() }
    }

    /// Whether the light of a pass is evaluated by rays and cones to lights, which may share occluders.
    pub(crate) fn are_useful(pass: &Pass<'_>) -> bool {
        let has_rays = matches!(pass.options.shadows, SceneShadows::Hard | SceneShadows::Soft | SceneShadows::Area(_));
        pass.bounces.is_none() && pass.traced.far.is_none() && has_rays && !pass.lights.lights.is_empty()
    }

    /// Adds a surface whose light must be evaluated.
    pub(crate) fn add(&mut self, layer: &Layer) {
        let tile = self.tiles.entry(key(layer)).or_insert(Tile {
            depth: [f64::INFINITY, f64::NEG_INFINITY],
            count: 0,
            occluders: Vec::new(),
        });
        tile.depth = [tile.depth[0].min(layer.depth), tile.depth[1].max(layer.depth)];
        tile.count += 1;
    }

    /// For each light the instances that may block it from a surface; `None` if a list is not worth its cost.
    pub(crate) fn occluders(&mut self, layer: &Layer) -> Option<&[NearList]> {
        let Self { pass, rows, tiles } = self;
        let tile = tiles.get_mut(&key(layer)).filter(|tile| tile.count >= LEAST_PIXELS)?;
        if tile.occluders.is_empty() {
            let (center, radius) = ball_of(pass, *rows, key(layer).0, tile.depth);
            let lights = pass.lights.lights.iter();
            tile.occluders = lights.map(|light| occluders_of(pass, center, radius, layer.instance, light)).collect();
        }
        Some(&tile.occluders)
    }
}

/// Column of the tile and instance of a surface.
fn key(layer: &Layer) -> (u32, u32) {
    (layer.x / TILE as u32, layer.instance)
}

/// A ball around the surfaces of a tile, scene units. They lie in the hull of eight points: the directions of the
/// pixels are linear in the columns and rows.
fn ball_of(pass: &Pass<'_>, rows: [u32; 2], column: u32, depth: [f64; 2]) -> (DVec3, f64) {
    let (scene, view) = (pass.traced.scene, &pass.buffer.view);
    let first = column * TILE as u32;
    let columns = [first, (first + TILE as u32 - 1).min(view.size[0] - 1)];
    let corners: [DVec3; 8] =
        std::array::from_fn(|i| scene.scene_from_world(view.position(columns[i & 1], rows[i >> 1 & 1], depth[i >> 2])));
    let center = corners.iter().sum::<DVec3>() / 8.0;
    let radius = corners.iter().map(|corner| corner.distance(center)).fold(0.0, f64::max);
    (center, radius + ROUNDING)
}

/// The instances that may block a light from the surfaces of instance `own` in a ball, near ones first.
fn occluders_of(pass: &Pass<'_>, center: DVec3, radius: f64, own: u32, light: &SceneLight) -> NearList {
    let scene = pass.traced.scene;
    let (ray, slope, _) = light.seen_from(center);
    let slope = if pass.options.shadows == SceneShadows::Hard { 0.0 } else { slope };
    let line = Line::cone(center.as_vec3(), ray.direction.as_vec3(), slope).with_start_radius(radius as f32);
    let mut found = Vec::new();
    scene.tree.walk(&line, ray.t_max as f32, |item, limit| {
        let touches = line.touches(&scene.boxes[item as usize], limit);
        if touches && (item == own || !is_free(scene, item, center, &ray, radius as f32, slope)) {
            found.push(item);
        }
        limit
    });
    NearList::new(found)
}

/// Whether distances prove that a truncated cone does not touch the surface of an instance.
fn is_free(scene: &Scene, item: u32, center: DVec3, ray: &LightRay, radius: f32, slope: f32) -> bool {
    let instance: &Instance = &scene.instances[item as usize];
    let field = instance.field.as_deref().filter(|field| !instance.is_sheet && field.is_lipschitz());
    let Some(field) = field else { return false };
    let origin = instance.field_from_scene.transform_point3(center);
    let direction = instance.field_from_scene.matrix3 * ray.direction;
    let [lower, upper] = field.surface_bounds();
    let bounds = &scene.boxes[item as usize];
    let far = (center.as_vec3() - bounds.min).abs().max((center.as_vec3() - bounds.max).abs()).length() + radius;
    let grown = instance.field_extent * (radius + slope / (1.0 - slope.min(0.9)) * far);
    let Some((enter, leave)) = clip(origin, direction, lower - grown, upper + grown, 0.0, ray.t_max) else {
        return true;
    };
    ConeWalk::new(field, instance, (origin, direction), [enter, leave], ray.direction, slope).is_free_of(radius)
}
