//! The search for the surfaces of one pixel.

use super::appearance::{FaceAppearance, field_color, field_emission};
use super::gbuffer::{Layer, View};
use super::searched::SearchedInstances;
use crate::bvh::rays::watertight::{FaceHit, Ray};
use crate::geometry::clip;
use crate::march::tiles::Tiles;
use crate::scene::content::instance::Instance;
use crate::scene::content::material::{Alpha, Material};
use crate::scene::content::model::Scene;
use crate::scene::content::options::{Primary, RenderOptions};
use crate::scene::content::tree::Line;
use crate::scene::content::triangles::Triangles;
use crate::scene::fields::field::{FieldHit, FieldRay};
use glam::{DVec3, Vec3, Vec4};

/// Largest number of translucent surfaces of one pixel. Between these and an opaque surface others are left out.
const MAX_LAYERS: usize = 256;
/// Surfaces behind translucent ones that pass less than this fraction are left out.
const LEAST_PASSES: f32 = 1e-4;

/// Relative tolerance between the depth found by a device and the depth of the same surface on the ray of the pixel.
/// Devices compute in float32, in units of the object; a hit slightly in front is the same surface.
const NEARNESS: f64 = 1e-3;
/// Smallest distance of a hit of a view ray with a mesh, local units: more than the rounding of a position in float64.
/// A face is not visible from an eye in its plane.
const NEAR: f64 = 1e-12;

/// Draws the pixels of a row by `trace`: the layers of all pixels, and the number of steps of each.
pub(crate) fn draw_row<'a>(
    scene: &'a Scene,
    options: &'a RenderOptions,
    view: &'a View,
    y: u32,
    mut trace: impl FnMut(&mut PixelRay<'a>, &mut Vec<Layer>),
) -> (Vec<Layer>, Vec<u32>) {
    let width = view.size[0] as usize;
    let (mut layers, mut steps) = (Vec::with_capacity(width), Vec::with_capacity(width));
    for x in 0..view.size[0] {
        let mut ray = PixelRay {
            scene,
            options,
            view,
            x,
            y,
            searched: None,
            tiles: None,
            only: None,
            skips_opaque: false,
            steps: 0,
        };
        trace(&mut ray, &mut layers);
        steps.push(ray.steps);
    }
    (layers, steps)
}

/// The search of a ray for the nearest surface.
struct Search<'a> {
    /// Start of the ray in scene space.
    eye: DVec3,
    /// World direction; multiples of it are depths.
    direction: DVec3,
    /// Depth at which the search starts.
    from: f64,
    /// Depth of the nearest surface so far, or the depth at which the search ends.
    nearest: f64,
    /// The surfaces of the pixel that were found before.
    before: &'a [Layer],
    /// The nearest surface so far, and its instance.
    best: Option<(u32, SurfaceHit)>,
}

impl Search<'_> {
    /// Whether a surface of an instance at a depth or behind it was found before.
    fn was_found(&self, item: u32, depth: f64) -> bool {
        self.before.iter().any(|layer| layer.instance == item && layer.depth >= depth)
    }
}

/// The hit of a ray with an instance.
#[derive(Clone, Copy)]
enum SurfaceHit {
    Face(FaceHit),
    /// A point in field space. `is_cut`: the hit is on a face of the grid.
    Field {
        p: Vec3,
        hit: FieldHit,
        is_cut: bool,
    },
}

/// The hit of a ray with the field of an instance between two depths, and its depth. The ray of the pixel starts at
/// `from`.
fn field_hit(
    scene: &Scene,
    item: u32,
    eye: DVec3,
    direction: DVec3,
    [near, far]: [f64; 2],
    from: f64,
    steps: &mut u32,
) -> Option<(f64, SurfaceHit)> {
    let instance = &scene.instances[item as usize];
    let field = instance.field.as_deref()?;
    let origin = instance.field_from_scene.transform_point3(eye);
    let along = instance.field_from_scene.matrix3 * (direction / scene.scale);
    let [lower, upper] = field.surface_bounds();
    let (enter, leave) = clip(origin, along, lower, upper, near, far)?;
    let ray = FieldRay { origin: (origin + enter * along).as_vec3(), direction: along.as_vec3() };
    let (hit, taken) = field.first_hit(&ray, (leave - enter) as f32);
    *steps += taken;
    let hit = hit?;
    let p = ray.origin + hit.t * ray.direction;
    Some((enter + f64::from(hit.t), SurfaceHit::Field { p, hit, is_cut: hit.at_start && enter > from }))
}

/// The ray of one pixel.
pub(crate) struct PixelRay<'a> {
    scene: &'a Scene,
    options: &'a RenderOptions,
    view: &'a View,
    pub x: u32,
    y: u32,
    /// For each instance, whether the search tests it; None if it tests all.
    pub searched: Option<&'a [bool]>,
    /// For each instance, the depths between which its surface lies on the rays of each tile; `None` if they were not
    /// computed.
    tiles: Option<&'a [Option<Tiles>]>,
    /// The instance that the search tests, if it is only one: boxes are not tested then.
    only: Option<u32>,
    /// Whether the opaque faces of all instances are drawn already.
    pub skips_opaque: bool,
    pub steps: u32,
}

impl<'a> PixelRay<'a> {
    /// Limits the tested instances to the searched ones; `None` tests all.
    pub(crate) fn limit_to(&mut self, searched: Option<&'a SearchedInstances>) {
        self.searched = searched.map(|searched| &searched.is_searched[..]);
        self.tiles = searched.map(|searched| &searched.tiles[..]);
        self.only = searched.and_then(SearchedInstances::only);
    }
}

impl PixelRay<'_> {
    /// Appends the layers of the pixel, up to the opaque surface `behind` if it is known.
    pub(crate) fn trace(&mut self, layers: &mut Vec<Layer>, behind: Option<Layer>) {
        let direction = self.view.direction(self.x, self.y);
        let first = layers.len();
        let limit = behind.map_or(f64::INFINITY, |layer| layer.depth);
        let (mut from, mut passes) = (0.0, 1.0);
        while layers.len() - first < MAX_LAYERS
            && let Some(layer) = self.next_surface(direction, from, limit, &layers[first..])
        {
            layers.push(layer);
            passes *= 1.0 - layer.color.w;
            if passes < LEAST_PASSES {
                return;
            }
            from = layer.depth;
        }
        layers.extend(behind);
    }

    /// The nearest surface from depth `from` to `limit` that is not among the given ones.
    fn next_surface(&mut self, direction: DVec3, from: f64, limit: f64, before: &[Layer]) -> Option<Layer> {
        let eye = self.scene.scene_from_world(self.start());
        let mut search = Search { eye, direction, from, nearest: limit, before, best: None };
        match self.only {
            Some(item) => {
                self.test(item, &mut search);
            }
            None => self.walk(&mut search),
        }
        let Search { best, nearest, .. } = search;
        match best? {
            (item, SurfaceHit::Face(hit)) => Some(self.mesh_ray(item, eye, direction)?.layer(self.x, item, &hit)),
            (item, SurfaceHit::Field { p, hit, is_cut }) => self.field_layer(item, direction, nearest, p, &hit, is_cut),
        }
    }

    /// Tests the instances whose boxes the ray enters, near ones first.
    fn walk(&mut self, search: &mut Search<'_>) {
        let scene = self.scene;
        let direction = search.direction / scene.scale;
        // Boxes are tested in float32, on a ray that starts just before the box of the scene.
        let start = (self.depth_of_scene(search.direction)).max(search.from);
        let line = Line::new((search.eye + start * direction).as_vec3(), direction.as_vec3());
        // The limit lies slightly beyond a hit, because boxes are rounded to float32.
        let reach =
            |depth: f64| ((depth - start) * 1.000_01 + 1e-6 / direction.length()).min(f64::from(f32::MAX)) as f32;
        scene.tree.walk(&line, reach(search.nearest), |item, limit| {
            if self.test(item, search) { reach(search.nearest) } else { limit }
        });
    }

    /// Whether an instance has the nearest surface so far, which is then stored.
    fn test(&mut self, item: u32, search: &mut Search<'_>) -> bool {
        let instance = &self.scene.instances[item as usize];
        if !instance.visible || self.searched.is_some_and(|searched| !searched[item as usize]) {
            return false;
        }
        self.steps += 1;
        if as_triangles(instance, self.options.primary) {
            self.test_triangles(item, search)
        } else {
            self.test_field(item, search)
        }
    }

    /// World position at which the ray starts.
    fn start(&self) -> DVec3 {
        self.view.start(self.x, self.y)
    }

    /// Depth at which the ray approaches the scene's box.
    fn depth_of_scene(&self, direction: DVec3) -> f64 {
        let [lower, upper] = self.scene.bounds();
        let center = (lower + upper) * 0.5;
        let reach = (upper - lower).length();
        let to_center = (center - self.start()).dot(direction) / direction.length_squared();
        (to_center - reach / direction.length()).max(0.0)
    }

    /// Whether an instance is drawn as triangles.
    pub(crate) fn is_triangles(&self, item: u32) -> bool {
        as_triangles(&self.scene.instances[item as usize], self.options.primary)
    }

    /// Whether the hit of a field that a device found must be computed again by the ray of the pixel.
    pub(crate) fn is_traced_again(&self, item: u32) -> bool {
        self.scene.instances[item as usize].field.as_ref().is_some_and(|field| field.is_traced_again())
    }

    fn test_triangles(&self, item: u32, search: &mut Search<'_>) -> bool {
        let Some(ray) = self.mesh_ray(item, search.eye, search.direction) else { return false };
        let found = ray.triangles.mesh.first_hit(&Ray { t_max: search.nearest, ..ray.in_tree }, |hit| {
            let is_drawn = || self.skips_opaque && is_opaque(ray.instance, ray.material(hit));
            hit.t >= search.from && !search.was_found(item, hit.t) && !is_drawn() && ray.is_visible(hit)
        });
        if let Some(hit) = found {
            search.nearest = hit.t;
            search.best = Some((item, SurfaceHit::Face(hit)));
        }
        found.is_some()
    }

    /// The layer of a face that a device found in the pixel; None if the exact ray misses the face or the mask cuts it
    /// out there.
    pub(crate) fn face(&self, item: u32, face: u32) -> Option<Layer> {
        let eye = self.scene.scene_from_world(self.start());
        let ray = self.mesh_ray(item, eye, self.view.direction(self.x, self.y))?;
        let hit = ray.triangles.mesh.hit_of_face(face, &ray.in_tree)?;
        ray.is_visible(&hit).then(|| ray.layer(self.x, item, &hit))
    }

    fn mesh_ray(&self, item: u32, eye: DVec3, direction: DVec3) -> Option<MeshRay<'_>> {
        let instance = &self.scene.instances[item as usize];
        let to_tree = instance.tree_from_scene;
        let along = to_tree.matrix3 * (direction / self.scene.scale);
        Some(MeshRay {
            scene: self.scene,
            instance,
            triangles: instance.triangles.as_deref()?,
            in_tree: Ray {
                origin: to_tree.transform_point3(eye),
                direction: along,
                t_min: NEAR / along.length(),
                t_max: f64::INFINITY,
            },
            direction,
            view: self.view,
        })
    }

    fn test_field(&mut self, item: u32, search: &mut Search<'_>) -> bool {
        let tiles = self.tiles.and_then(|tiles| tiles[item as usize].as_ref());
        let depths = match tiles {
            None => Some([search.from, search.nearest]),
            Some(tiles) => tiles
                .depths(self.x as usize, self.y as usize)
                .map(|[near, far]| [search.from.max(near), search.nearest.min(far)]),
        };
        // A solid is one layer: the surfaces behind its front are inside it.
        let Some(depths) = depths.filter(|_| !search.was_found(item, f64::NEG_INFINITY)) else { return false };
        let (scene, from) = (self.scene, search.from);
        match field_hit(scene, item, search.eye, search.direction, depths, from, &mut self.steps) {
            Some((depth, hit)) if depth <= search.nearest => {
                search.nearest = depth;
                search.best = Some((item, hit));
                true
            }
            _ => false,
        }
    }

    /// The layer of a field that a device found near a depth, scene units, at the exact hit of the ray of the pixel.
    pub(crate) fn field_near(&self, item: u32, depth: f64) -> Option<Layer> {
        let depth = depth * self.scene.scale;
        let eye = self.scene.scene_from_world(self.start());
        let direction = self.view.direction(self.x, self.y);
        let (from, to) = ((1.0 - NEARNESS) * depth, (1.0 + NEARNESS) * depth);
        let (depth, found) = field_hit(self.scene, item, eye, direction, [from, to], from, &mut 0)?;
        let SurfaceHit::Field { p, hit, is_cut } = found else { return None };
        if depth <= to { self.field_layer(item, direction, depth, p, &hit, is_cut) } else { None }
    }

    /// The layer of a field that a device found at a depth, scene units.
    pub(crate) fn field_at(&self, item: u32, depth: f64, at_start: bool) -> Option<Layer> {
        let direction = self.view.direction(self.x, self.y);
        let to_field = self.scene.instances[item as usize].field_from_scene;
        let eye = to_field.transform_point3(self.scene.scene_from_world(self.start()));
        let [lower, upper] = self.scene.instances[item as usize].field.as_deref()?.surface_bounds();
        let is_outside = eye.cmplt(lower.as_dvec3()).any() || eye.cmpgt(upper.as_dvec3()).any();
        // The device moves a surface at the eye to its near plane.
        let depth = if at_start && !is_outside { 0.0 } else { depth * self.scene.scale };
        let p = eye + to_field.matrix3 * (depth / self.scene.scale * direction);
        let hit = FieldHit { t: depth as f32, at_start, part: 0 };
        self.field_layer(item, direction, depth, p.as_vec3(), &hit, at_start && is_outside)
    }

    /// The layer of a hit with a field at a depth; see [`SurfaceHit::Field`].
    fn field_layer(
        &self,
        item: u32,
        direction: DVec3,
        depth: f64,
        p: Vec3,
        hit: &FieldHit,
        is_cut: bool,
    ) -> Option<Layer> {
        let instance = &self.scene.instances[item as usize];
        let field = instance.field.as_deref()?;
        let to_eye = -direction.normalize().as_vec3();
        let appearance = field.appearance(p, hit, (instance.field_from_scene.matrix3 * direction).as_vec3());
        let normal = if is_cut {
            // The face through which the ray entered.
            let [lower, upper] = field.surface_bounds();
            let from_face = ((p - lower) / (upper - lower) - 0.5).abs();
            let axis = (1..3).fold(0, |best, axis| if from_face[axis] > from_face[best] { axis } else { best });
            let mut face = Vec3::ZERO;
            face[axis] = -(instance.field_from_scene.matrix3 * direction).as_vec3()[axis].signum();
            (instance.field_from_scene.matrix3.transpose().as_mat3() * face).normalize_or_zero()
        } else if hit.at_start {
            to_eye
        } else {
            (instance.scene_from_normal * appearance.normal).normalize_or(to_eye)
        };
        let material = &self.scene.materials[instance.first_material as usize];
        let mut color = field_color(instance, material, &appearance).extend(material.color[3]);
        if material.alpha != Alpha::Blend {
            color.w = 1.0;
        }
        color.w *= instance.opacity;
        Some(Layer {
            x: self.x,
            instance: item,
            material: instance.first_material,
            depth,
            normal,
            color,
            emission: field_emission(material),
            to_smooth: Vec3::ZERO,
            is_triangle: false,
            is_from_device: false,
        })
    }
}

/// The ray of a pixel through an instance with triangles.
struct MeshRay<'a> {
    scene: &'a Scene,
    instance: &'a Instance,
    triangles: &'a Triangles,
    /// The ray in the space of the mesh's tree.
    in_tree: Ray,
    /// World direction; multiples of it are depths.
    direction: DVec3,
    view: &'a View,
}

impl MeshRay<'_> {
    fn appearance(&self, hit: &FaceHit) -> FaceAppearance<'_> {
        FaceAppearance::new(self.scene, self.instance, self.triangles, hit.face, hit.weights)
    }

    fn material(&self, hit: &FaceHit) -> &Material {
        self.appearance(hit).material()
    }

    /// Whether a face is visible from this side, and not cut out by its mask.
    fn is_visible(&self, hit: &FaceHit) -> bool {
        let material = self.material(hit);
        // The visible side is the same in any space, mirrored or not.
        if !material.two_sided && !hit.is_front {
            return false;
        }
        match material.alpha {
            Alpha::Opaque => true,
            Alpha::Mask(cutoff) => self.color(hit).w >= cutoff,
            Alpha::Blend => self.color(hit).w > 0.0,
        }
    }

    fn color(&self, hit: &FaceHit) -> Vec4 {
        self.appearance(hit).color(|| self.pixel(hit))
    }

    /// Side of the pixel on the surface, in units of the tree; larger on slanted surfaces.
    fn pixel(&self, hit: &FaceHit) -> f64 {
        let [a, b, c] = self.triangles.mesh.triangle(hit.face);
        let normal = (b - a).cross(c - a);
        let slant =
            (normal.dot(self.in_tree.direction) / (normal.length() * self.in_tree.direction.length())).abs().max(0.05);
        let pixel = self.view.pixel_size_at(hit.t) * self.in_tree.direction.length() / self.direction.length();
        pixel / slant.sqrt()
    }

    fn layer(&self, x: u32, item: u32, hit: &FaceHit) -> Layer {
        let mut color = self.color(hit);
        if self.material(hit).alpha != Alpha::Blend {
            color.w = 1.0;
        }
        color.w *= self.instance.opacity;
        let appearance = self.appearance(hit);
        Layer {
            x,
            instance: item,
            material: appearance.material_index(),
            depth: hit.t,
            normal: appearance.normal_toward(self.direction.as_vec3(), hit.is_front),
            color,
            emission: appearance.emission(|| self.pixel(hit)),
            to_smooth: self.triangles.to_smooth_surface(hit.face, hit.weights, hit.is_front),
            is_triangle: true,
            is_from_device: false,
        }
    }
}

/// Whether a device finds everything that occludes surfaces behind it, for an instance with this material.
pub(crate) fn is_opaque(instance: &Instance, material: &Material) -> bool {
    instance.opacity >= 1.0 && material.alpha != Alpha::Blend && !instance.has_colored_mask
}

/// Whether the primary pass draws the triangles of an instance.
pub(crate) fn as_triangles(instance: &Instance, primary: Primary) -> bool {
    instance.triangles.is_some() && primary != Primary::Raymarch
}
