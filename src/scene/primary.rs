//! The primary pass: what each pixel sees.
//!
//! Triangles are met by rays through the mesh's own tree, without gaps and at pixel centres, which gives the picture that a
//! rasteriser gives; fields by the exact march. Either way an instance's box is entered only where a ray meets it, and the
//! nearest hit is the union: mixed scenes compose by depth.
//!
//! A pixel has a list of layers: the first opaque surface, and in front of it what lets light through.

use super::texture::Texture;
use super::tree::Line;
use super::{Alpha, Instance, Material, Primary, RenderOptions, Scene};
use crate::bvh::ray::RayHit;
use crate::error::Error;
use crate::progress::Progress;
use crate::render::Camera;
use glam::{DVec3, Vec3, Vec4};
use rayon::prelude::*;

/// Surfaces of one pixel at most: behind so many translucent ones the last counts as opaque.
pub const MAX_LAYERS: usize = 16;

/// A surface seen by a pixel.
#[derive(Debug, Clone, Copy)]
pub struct Layer {
    pub x: u32,
    pub instance: u32,
    pub material: u32,
    /// Along the viewing axis, in world units.
    pub depth: f64,
    /// World space, unit, on the side that is seen.
    pub normal: Vec3,
    /// Linear RGB, and opacity.
    pub color: Vec4,
    /// Hit as a triangle, not as a field.
    pub is_triangle: bool,
}

/// What the camera saw: rows from the top; in a row the layers by pixel, those of a pixel from front to back.
#[derive(Debug)]
pub struct GBuffer {
    pub rows: Vec<Vec<Layer>>,
    /// Work of each pixel.
    pub steps: Vec<Vec<u32>>,
    pub view: View,
}

/// The camera in float64, with the place in a pixel that its rays go through.
#[derive(Debug, Clone, Copy)]
pub struct View {
    pub camera: Camera,
    pub size: [u32; 2],
    pub offset: [f64; 2],
}

impl View {
    /// World direction of a pixel's ray; multiples of it are depths.
    pub fn direction(&self, x: u32, y: u32) -> DVec3 {
        let aside = self.camera.pixel_size(self.size[1]);
        self.camera.pixel_direction(x, y, self.size)
            + aside * ((self.offset[0] - 0.5) * self.camera.right - (self.offset[1] - 0.5) * self.camera.up)
    }
}

/// Find what each pixel sees, through the point `offset` of the pixel: (1/2, 1/2) is its centre.
pub fn draw(
    scene: &Scene,
    camera: &Camera,
    options: &RenderOptions,
    offset: [f64; 2],
    progress: &Progress,
) -> Result<GBuffer, Error> {
    let view = View { camera: *camera, size: options.size, offset };
    let [width, height] = options.size;
    let pairs: Vec<(Vec<Layer>, Vec<u32>)> = (0..height)
        .into_par_iter()
        .map(|y| {
            let mut layers = Vec::new();
            let mut steps = Vec::with_capacity(width as usize);
            for x in 0..width {
                let mut eye = Eye { scene, options, view: &view, x, y, steps: 0 };
                eye.look(&mut layers);
                steps.push(eye.steps);
            }
            progress.advance(1)?;
            Ok((layers, steps))
        })
        .collect::<Result<_, Error>>()?;
    let (rows, steps) = pairs.into_iter().unzip();
    Ok(GBuffer { rows, steps, view })
}

/// One pixel's ray.
struct Eye<'a> {
    scene: &'a Scene,
    options: &'a RenderOptions,
    view: &'a View,
    x: u32,
    y: u32,
    steps: u32,
}

impl Eye<'_> {
    /// Append the layers of the pixel.
    fn look(&mut self, layers: &mut Vec<Layer>) {
        let direction = self.view.direction(self.x, self.y);
        let first = layers.len();
        let mut from = 0.0;
        while let Some(layer) = self.next_surface(direction, from, &layers[first..]) {
            let is_last = layers.len() - first + 1 == MAX_LAYERS;
            layers.push(layer);
            if layer.color.w >= 1.0 || is_last {
                break;
            }
            from = layer.depth;
        }
    }

    /// The nearest surface from depth `from` on that is not among those seen before.
    fn next_surface(&mut self, direction: DVec3, from: f64, before: &[Layer]) -> Option<Layer> {
        let scene = self.scene;
        let eye = scene.scene_from_world(self.view.camera.eye);
        let direction_scene = direction / scene.scale;
        // Boxes are looked at in float32, from beside the scene.
        let start = (self.depth_of_scene(direction)).max(from);
        let line = Line::new((eye + start * direction_scene).as_vec3(), direction_scene.as_vec3());
        let mut best: Option<Layer> = None;
        let mut nearest = f64::INFINITY;
        let mut steps = self.steps;
        scene.tree.walk(&line, f32::INFINITY, |item, limit| {
            let instance = &scene.instances[item as usize];
            if !instance.visible {
                return limit;
            }
            steps += 1;
            let seen = |depth: f64| before.iter().any(|layer| layer.instance == item && layer.depth >= depth);
            let found = if as_triangles(instance, self.options.primary) {
                self.triangle(item, instance, eye, direction, from, nearest, &seen)
            } else {
                self.field(item, instance, eye, direction, from, nearest, &seen, &mut steps)
            };
            if let Some(layer) = found {
                nearest = layer.depth;
                best = Some(layer);
                // A little further than the hit: boxes are float32.
                return ((nearest - start) * 1.000_01 + 1e-6 / direction_scene.length()) as f32;
            }
            limit
        });
        self.steps = steps;
        best
    }

    /// Depth at which the ray comes near the scene's box.
    fn depth_of_scene(&self, direction: DVec3) -> f64 {
        let [lower, upper] = self.scene.bounds();
        let center = (lower + upper) * 0.5;
        let reach = (upper - lower).length();
        let to_center = (center - self.view.camera.eye).dot(direction) / direction.length_squared();
        (to_center - reach / direction.length()).max(0.0)
    }

    fn triangle(
        &self,
        item: u32,
        instance: &Instance,
        eye: DVec3,
        direction: DVec3,
        from: f64,
        nearest: f64,
        seen: &dyn Fn(f64) -> bool,
    ) -> Option<Layer> {
        let triangles = instance.triangles.as_ref()?;
        let scene = self.scene;
        let to_tree = instance.tree_from_scene;
        let origin = to_tree.transform_point3(eye);
        let along = to_tree.matrix3 * (direction / scene.scale);
        let material_of = |hit: &RayHit| instance.first_material + triangles.material[hit.face as usize];
        let color_of = |hit: &RayHit| {
            let material = &scene.materials[material_of(hit) as usize];
            let [a, b, c] = triangles.mesh.triangle(hit.face);
            let normal = (b - a).cross(c - a);
            // The pixel's side on the surface, in units of the tree, longer where the surface is seen at an angle.
            let slant = (normal.dot(along) / (normal.length() * along.length())).abs().max(0.05);
            let pixel = self.view.camera.pixel_size(self.view.size[1]) * hit.t * along.length() / direction.length();
            let footprint = (pixel / slant.sqrt()) as f32 * triangles.uv_density(hit.face);
            color(material, &scene.textures, triangles.uv_at(hit.face, hit.u as f32, hit.v as f32), footprint)
        };
        let hit = triangles.mesh.first_hit(origin, along, nearest, |hit| {
            if hit.t < from || seen(hit.t) {
                return false;
            }
            let material = &scene.materials[material_of(hit) as usize];
            // Which side is seen is the same in any space, mirrored or not.
            if !material.two_sided && !hit.is_front {
                return false;
            }
            match material.alpha {
                Alpha::Opaque => true,
                Alpha::Mask(cutoff) => color_of(hit).w >= cutoff,
                Alpha::Blend => color_of(hit).w > 0.0,
            }
        })?;
        let material = &scene.materials[material_of(&hit) as usize];
        let mut color = color_of(&hit);
        if material.alpha != Alpha::Blend {
            color.w = 1.0;
        }
        color.w *= instance.opacity;
        let smooth = triangles.normal_at(hit.face, hit.u as f32, hit.v as f32);
        let normal = (instance.scene_from_normal * smooth).normalize_or_zero();
        Some(Layer {
            x: self.x,
            instance: item,
            material: material_of(&hit),
            depth: hit.t,
            normal: toward_eye(
                normal,
                direction,
                || {
                    let [a, b, c] = triangles.mesh.triangle(hit.face);
                    instance.scene_from_normal * (b - a).cross(c - a).normalize_or_zero().as_vec3()
                },
                hit.is_front,
            ),
            color,
            is_triangle: true,
        })
    }

    fn field(
        &self,
        item: u32,
        instance: &Instance,
        eye: DVec3,
        direction: DVec3,
        from: f64,
        nearest: f64,
        seen: &dyn Fn(f64) -> bool,
        steps: &mut u32,
    ) -> Option<Layer> {
        let field = instance.field.as_deref()?;
        let scene = self.scene;
        // A solid is one layer: what lies behind its surface is inside it.
        if seen(f64::NEG_INFINITY) {
            return None;
        }
        let origin = instance.field_from_scene.transform_point3(eye);
        let along = instance.field_from_scene.matrix3 * (direction / scene.scale);
        let [lower, upper] = field.surface_bounds();
        let (enter, leave) = super::shadow::clip(origin, along, lower, upper, from, nearest)?;
        let ray = super::field::FieldRay { origin: (origin + enter * along).as_vec3(), direction: along.as_vec3() };
        let (hit, taken) = field.first_hit(&ray, (leave - enter) as f32);
        *steps += taken;
        let hit = hit?;
        let depth = enter + f64::from(hit.t);
        if depth > nearest {
            return None;
        }
        let to_eye = -direction.normalize().as_vec3();
        let p = ray.origin + hit.t * ray.direction;
        let normal = if hit.at_start && enter > from {
            // The cut on a face of the data: the face through which the ray came.
            let from_face = ((p - lower) / (upper - lower) - 0.5).abs();
            let axis = (1..3).fold(0, |best, axis| if from_face[axis] > from_face[best] { axis } else { best });
            let mut face = Vec3::ZERO;
            face[axis] = -ray.direction[axis].signum();
            (instance.field_from_scene.matrix3.transpose().as_mat3() * face).normalize_or_zero()
        } else if hit.at_start {
            to_eye
        } else {
            (instance.local_from_scene.transpose() * field.gradient(p)).normalize_or(to_eye)
        };
        let material = &scene.materials[instance.first_material as usize];
        let mut color = Vec4::from_array(material.color);
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
            is_triangle: false,
        })
    }
}

/// Whether the primary pass sees an instance's triangles.
pub fn as_triangles(instance: &Instance, primary: Primary) -> bool {
    instance.triangles.is_some() && primary != Primary::Raymarch
}

/// Colour and opacity of a material at a place of its texture.
fn color(material: &Material, textures: &[std::sync::Arc<Texture>], uv: glam::Vec2, footprint: f32) -> Vec4 {
    let factor = Vec4::from_array(material.color);
    match material.texture {
        Some(texture) => factor * textures[texture as usize].sample(uv, footprint),
        None => factor,
    }
}

/// A smooth normal on the side of the face that is seen. At a silhouette it may lean away from the eye; then the face's own
/// normal is the better one.
fn toward_eye(normal: Vec3, direction: DVec3, of_face: impl Fn() -> Vec3, is_front: bool) -> Vec3 {
    let normal = if is_front { normal } else { -normal };
    if normal.dot(direction.as_vec3()) < 0.0 {
        return normal;
    }
    let face = of_face().normalize_or_zero();
    if is_front { face } else { -face }
}
