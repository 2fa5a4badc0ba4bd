//! The light pass: Blinn-Phong (Blinn 1977) over the G-buffer, with shadow, occlusion and scattering from the fields.
//!
//! # Theory
//!
//! ```text
//!   color = ambient * open * albedo
//!         + sum over lights of  arrives * light * (max(0, n.l) * albedo + specular * max(0, n.h)^shininess)
//!         + sum over lights of  light * through * albedo
//! ```
//!
//! `arrives` is the light's share ([`super::shadow`]), none on a side that is turned away. `open` is the mean of
//! [`AO_CONES`] cones over the hemisphere, each weighed by its cosine; what is further than a given distance does not count.
//! `through` is light that entered on the other side: with the thickness `s` of the instance along the light and the
//! material's length of scattering, `exp(-s / length)`; it is strongest against the light (the translucency of
//! Barre-Brisebois and Bouchard, GDC 2011) and takes no more than the cosine leaves, so no surface sends out more than
//! arrives.

use super::primary::{GBuffer, Layer};
use super::shadow::{Place, Ray, basis};
use super::{Light, RenderOptions, Scene, SceneShadows};
use crate::error::Error;
use crate::progress::Progress;
use crate::render::{Camera, Frame};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Cones of ambient occlusion: one along the normal and a ring of six.
pub const AO_CONES: usize = 7;
/// Tangent of half a cone's angle, 30 degrees: seven such cones just cover a hemisphere.
pub const AO_SLOPE: f32 = 0.577_350_3;
/// Angle of the ring from the normal: 60 degrees.
const AO_RING: (f64, f64) = (0.5, 0.866_025_403_784_438_6);

/// Start above the surface in voxels. A field's own surface departs from a smooth one by less than an eighth of a voxel, and
/// half a voxel clears it; a triangle and the field baked from it differ by up to a third more.
const BIAS_FIELD: f32 = 0.5;
const BIAS_TRIANGLE: f32 = 1.0;

/// The lights of a picture in scene space.
#[derive(Debug)]
pub struct Lights {
    pub lights: Vec<SceneLight>,
}

/// A light in scene space.
#[derive(Debug, Clone, Copy)]
pub enum SceneLight {
    /// Unit direction to the light.
    Directional {
        to_light: DVec3,
        color: Vec3,
        slope: f32,
    },
    Point {
        position: DVec3,
        color: Vec3,
        radius: f64,
    },
}

impl Lights {
    pub fn new(scene: &Scene, _camera: &Camera, options: &RenderOptions) -> Self {
        let in_scene = |light: &Light| match *light {
            Light::Directional { direction, color, slope } => {
                SceneLight::Directional { to_light: -direction.normalize(), color, slope }
            }
            Light::Point { position, color, radius } => {
                SceneLight::Point { position: scene.scene_from_world(position), color, radius: radius / scene.scale }
            }
        };
        Self { lights: options.lights.iter().map(in_scene).collect() }
    }
}

impl SceneLight {
    /// The way to the light from a scene point, its angular radius as a slope, and its colour.
    pub fn seen_from(&self, p: DVec3) -> (Ray, f32, Vec3) {
        match *self {
            Self::Directional { to_light, color, slope } => {
                (Ray { direction: to_light, t_max: f64::INFINITY }, slope, color)
            }
            Self::Point { position, color, radius } => {
                let way = position - p;
                let distance = way.length().max(1e-12);
                (Ray { direction: way / distance, t_max: distance }, (radius / distance) as f32, color)
            }
        }
    }
}

/// Light every layer and lay the layers over the background.
pub fn shade(
    scene: &Scene,
    buffer: &GBuffer,
    lights: &Lights,
    options: &RenderOptions,
    progress: &Progress,
) -> Result<Frame, Error> {
    let [width, height] = options.size.map(|n| n as usize);
    let mut frame = Frame::new(width, height, lights.lights.len());
    frame.rows().into_par_iter().enumerate().try_for_each(|(y, row)| {
        row.steps.copy_from_slice(&buffer.steps[y]);
        let layers = &buffer.rows[y];
        let mut rest = layers.as_slice();
        let mut shares = vec![0.0f32; lights.lights.len()];
        for x in 0..width {
            let count = rest.iter().take_while(|layer| layer.x as usize == x).count();
            let (own, after) = rest.split_at(count);
            rest = after;
            let mut color = glam::Vec4::ZERO;
            let mut passes = 1.0;
            let mut is_first = true;
            for layer in own {
                let direction = buffer.view.direction(x as u32, y as u32);
                let surface = Surface::new(scene, layer, buffer.view.camera.eye, direction);
                let light = surface.shade(scene, lights, options, &mut shares, &mut row.steps[x], pixel_turn(x, y));
                color += passes * layer.color.w * light.extend(1.0);
                passes *= 1.0 - layer.color.w;
                // The pixel belongs to the first surface that hides half or more of what is behind it.
                if is_first && layer.color.w >= 0.5 {
                    is_first = false;
                    row.depth[x] = layer.depth as f32;
                    row.normal[3 * x..][..3].copy_from_slice(&layer.normal.to_array());
                    row.object_id[x] = layer.instance as i32;
                    row.shadow[x * row.lights..][..row.lights].copy_from_slice(&shares);
                }
            }
            let behind = glam::Vec4::from_array(options.background);
            let rgb = (color.truncate() + passes * behind.truncate()) * options.exposure;
            let pixel = [rgb.x, rgb.y, rgb.z, color.w + passes * behind.w];
            row.color[4 * x..][..4].copy_from_slice(&pixel);
        }
        progress.advance(1)
    })?;
    Ok(frame)
}

/// A turn for each pixel's samples of an area light, from 0 to 2 pi: interleaved gradient noise (Jimenez, 2014).
fn pixel_turn(x: usize, y: usize) -> f32 {
    let value = 52.982_918 * (0.067_110_56 * x as f32 + 0.005_837_15 * y as f32).fract();
    value.fract() * std::f32::consts::TAU
}

/// A layer in scene space.
struct Surface<'a> {
    layer: &'a Layer,
    place: Place,
    to_eye: Vec3,
}

impl<'a> Surface<'a> {
    fn new(scene: &Scene, layer: &'a Layer, eye: DVec3, direction: DVec3) -> Self {
        let place = Place {
            p: scene.scene_from_world(eye + layer.depth * direction),
            normal: layer.normal,
            own: layer.instance,
            bias_voxels: if layer.is_triangle { BIAS_TRIANGLE } else { BIAS_FIELD },
        };
        Self { layer, place, to_eye: -direction.normalize().as_vec3() }
    }

    /// Linear RGB; writes the share of each light that arrives.
    fn shade(
        &self,
        scene: &Scene,
        lights: &Lights,
        options: &RenderOptions,
        shares: &mut [f32],
        steps: &mut u32,
        turn: f32,
    ) -> Vec3 {
        let material = &scene.materials[self.layer.material as usize];
        let albedo = self.layer.color.truncate();
        let open = match options.occlusion {
            Some(distance) => self.openness(scene, distance / scene.scale, steps),
            None => 1.0,
        };
        let mut color = options.ambient * open * albedo;
        for (light, share) in lights.lights.iter().zip(shares) {
            let (ray, slope, light_color) = light.seen_from(self.place.p);
            let cosine = self.layer.normal.dot(ray.direction.as_vec3());
            *share = if options.shadows == SceneShadows::None {
                1.0
            } else if cosine <= 0.0 {
                0.0
            } else {
                match options.shadows {
                    SceneShadows::None => 1.0,
                    SceneShadows::Hard => scene.ray_share(&self.place, &ray, steps),
                    SceneShadows::Soft => scene.disc_share(&self.place, &ray, slope, steps),
                    SceneShadows::Area(count) => scene.area_share(&self.place, &ray, slope, count, turn, steps),
                    SceneShadows::Article => scene.article_share(&self.place, &ray, steps),
                }
            };
            if *share > 0.0 && cosine > 0.0 {
                let half = (ray.direction.as_vec3() + self.to_eye).normalize_or_zero();
                let highlight = material.specular * self.layer.normal.dot(half).max(0.0).powf(material.shininess);
                color += *share * light_color * (cosine * albedo + highlight);
            }
            if material.scattering != [0.0; 3] {
                color += light_color * albedo * self.through(scene, &ray, cosine, steps);
            }
        }
        color
    }

    /// Share of the surroundings' light that is not held back by matter within `distance`, scene units.
    fn openness(&self, scene: &Scene, distance: f64, steps: &mut u32) -> f32 {
        let normal = self.place.normal.as_dvec3();
        let [right, up] = basis(normal);
        let (mut sum, mut weights) = (0.0, 0.0);
        for i in 0..AO_CONES {
            let (direction, weight) = if i == 0 {
                (normal, 1.0)
            } else {
                let angle = (i - 1) as f64 * (std::f64::consts::TAU / (AO_CONES - 1) as f64);
                let aside = angle.cos() * right + angle.sin() * up;
                (AO_RING.0 * normal + AO_RING.1 * aside, AO_RING.0 as f32)
            };
            let ray = Ray { direction, t_max: distance };
            sum += weight * scene.cone_share(&self.place, &ray, AO_SLOPE, steps).share;
            weights += weight;
        }
        sum / weights
    }

    /// Light that comes through the instance from its far side, for each of RGB.
    fn through(&self, scene: &Scene, ray: &Ray, cosine: f32, steps: &mut u32) -> Vec3 {
        /// How much the normal bends the light on its way out, and how narrow the glow against the light is.
        const BEND: f32 = 0.3;
        const GLOW: i32 = 4;
        let to_light = ray.direction.as_vec3();
        let thickness = scene.thickness(&self.place, ray.direction, steps) * scene.scale as f32;
        let scattering = Vec3::from_array(scene.materials[self.layer.material as usize].scattering);
        let left = scattering.to_array().map(|length| if length > 0.0 { (-thickness / length).exp() } else { 0.0 });
        let out = -(to_light + BEND * self.layer.normal).normalize_or_zero();
        let glow = out.dot(self.to_eye).max(0.0).powi(GLOW);
        // What the cosine term leaves of the light that falls on the surface.
        let room = 1.0 - cosine.max(0.0);
        Vec3::from_array(left) * (room * (0.5 + 0.5 * glow))
    }
}
