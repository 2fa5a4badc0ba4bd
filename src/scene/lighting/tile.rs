//! Occluders shared by neighbouring pixels.
//!
//! The surfaces of one instance in a tile of the picture lie in a ball of radius `r`. Let a light have the slope `s`
//! from the centre of the ball. A point of a cone from the ball to the light, at the distance `t` along its axis, then
//! lies within `r + s t` of the axis from the centre. Axes to a point light come together, and those to a directional
//! light are parallel. Each tile is searched once with this truncated cone. An instance is left out if its box stays
//! out of the truncated cone, or if its distances along the axis prove that its surface does. The surfaces of the tile
//! test the remaining instances only. A ray first tests the instance that blocked the last ray of the tile. The rays of
//! hard shadows are nearly parallel, so all rays of a tile test an instance together.

use super::pass::Pass;
use crate::geometry::clip;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::content::options::SceneShadows;
use crate::scene::content::tree::Line;
use crate::scene::light::cone::ConeWalk;
use crate::scene::light::light_rays::{LightRay, LightWork};
use crate::scene::light::lit_surface::{LitSurface, SceneLight};
use crate::scene::light::mesh_rays::PlacedRay;
use crate::scene::light::occluder::NearList;
use crate::scene::lighting::light_buffer::{LightRow, parts_of};
use crate::scene::visibility::gbuffer::Layer;
use glam::DVec3;
use rustc_hash::FxHashMap;

/// Side of a tile, pixels.
pub(crate) const TILE: usize = 8;

/// Smallest number of evaluated surfaces in a tile for which a list is made.
const LEAST_PIXELS: usize = 8;

/// Margin for the rounding of the radius, scene units.
const ROUNDING: f64 = 1e-6;

/// The tiles of [`TILE`] rows of a picture.
pub(crate) struct Tiles<'a> {
    pass: &'a Pass<'a>,
    rows: [u32; 2],
    tiles: Vec<Tile>,
    /// The place of each tile in the list.
    by_key: FxHashMap<(u32, u32), usize>,
    /// The tile of the last surface, which is most often the tile of the next one.
    last: Option<usize>,
}

/// The surfaces of one instance in a tile.
struct Tile {
    /// Column of the tile, and the instance.
    key: (u32, u32),
    /// Range of depths, world units.
    depth: [f64; 2],
    /// The surfaces whose light must be evaluated: the row, counted from the first one, and the index in the row.
    surfaces: Vec<[usize; 2]>,
    /// For each light the instances that may block it; empty until a surface needs them.
    occluders: Vec<NearList>,
}

impl<'a> Tiles<'a> {
    /// Tiles for the rows `rows[0]` to `rows[1]`, inclusive.
    pub(crate) fn new(pass: &'a Pass<'a>, rows: [u32; 2]) -> Self {
        Self { pass, rows, tiles: Vec::new(), by_key: FxHashMap::default(), last: None }
    }

    /// Whether the light of a pass is evaluated by rays and cones to lights, which may share occluders.
    pub(crate) fn are_useful(pass: &Pass<'_>) -> bool {
        let has_rays = matches!(pass.options.shadows, SceneShadows::Hard | SceneShadows::Soft | SceneShadows::Area(_));
        pass.bounces.is_none() && pass.traced.far.is_none() && has_rays && !pass.lights.lights.is_empty()
    }

    /// Adds a surface whose light must be evaluated: its row, counted from the first one, and its index in the row.
    pub(crate) fn add(&mut self, surface: [usize; 2], layer: &Layer) {
        let (key, tiles) = (key(layer), &mut self.tiles);
        let last = self.last.filter(|&last| tiles[last].key == key);
        let place = last.unwrap_or_else(|| {
            *self.by_key.entry(key).or_insert_with(|| {
                let surfaces = Vec::with_capacity(TILE * TILE);
                tiles.push(Tile { key, depth: [f64::INFINITY, f64::NEG_INFINITY], surfaces, occluders: Vec::new() });
                tiles.len() - 1
            })
        });
        self.last = Some(place);
        let tile = &mut self.tiles[place];
        tile.depth = [tile.depth[0].min(layer.depth), tile.depth[1].max(layer.depth)];
        tile.surfaces.push(surface);
    }

    /// Evaluates hard shadows on the surfaces of tiles with lists of occluders. Surfaces that scatter light are left
    /// out. `lights` is the number of lights, and `stride` the number of values of a surface.
    pub(crate) fn evaluate_hard(&self, light: &mut [LightRow], [lights, stride]: [usize; 2]) {
        let Self { pass, rows, tiles, .. } = self;
        let scene = pass.traced.scene;
        let mut total = LightWork::default();
        for tile in tiles.iter().filter(|tile| tile.surfaces.len() >= LEAST_PIXELS) {
            let near = tile.find_occluders(pass, *rows);
            let lit = tile.surfaces.iter().map(|&[row, i]| {
                let y = rows[0] as usize + row;
                ([row, i], LitSurface::new(scene, pass.buffer, y, &pass.buffer.rows[y][i]))
            });
            let lit: Vec<_> = lit.filter(|(_, surface)| !surface.scatters(scene)).collect();
            for &([row, i], _) in &lit {
                *parts_of(&mut light[row].values[i * stride..][..stride], lights).open = 1.0;
                light[row].is_evaluated[i] = true;
            }
            let (mut surfaces, mut traced) = (Vec::with_capacity(lit.len()), Vec::with_capacity(lit.len()));
            for (number, source) in pass.lights.lights.iter().enumerate() {
                for (surface, LitSurface { place, .. }) in &lit {
                    let ray = source.seen_from(place.p).0;
                    if place.is_above_horizon(&ray) {
                        surfaces.push(surface);
                        traced.push(PlacedRay::new(pass.traced, place, ray));
                    }
                }
                pass.traced.pass_rays(&near[number], &mut traced);
                for (&[row, i], ray) in surfaces.drain(..).zip(traced.drain(..)) {
                    parts_of(&mut light[row].values[i * stride..][..stride], lights).shares[number] = ray.share;
                    light[row].work[i] += ray.work;
                    total += ray.work;
                }
            }
        }
        pass.counters.add(total);
    }

    /// For each light the instances that may block it from a surface; `None` if a list is not worth its cost.
    pub(crate) fn occluders(&mut self, layer: &Layer) -> Option<&[NearList]> {
        let place = *self.by_key.get(&key(layer))?;
        let tile = Some(&mut self.tiles[place]).filter(|tile| tile.surfaces.len() >= LEAST_PIXELS)?;
        if tile.occluders.is_empty() {
            tile.occluders = tile.find_occluders(self.pass, self.rows);
        }
        Some(&tile.occluders)
    }
}

impl Tile {
    /// For each light the instances that may block it.
    fn find_occluders(&self, pass: &Pass<'_>, rows: [u32; 2]) -> Vec<NearList> {
        let (column, instance) = self.key;
        let (center, radius) = ball_of(pass, rows, column, self.depth);
        pass.lights.lights.iter().map(|light| occluders_of(pass, center, radius, instance, light)).collect()
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
