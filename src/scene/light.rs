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

use super::gpu::{DeviceScene, beam};
use super::primary::{GBuffer, Layer};
use super::shadow::{Casters, PARTS, Place, Ray, Work, basis, disc_point, toward};
use super::{Asked, Light, RenderOptions, Scene, SceneShadows};
use crate::error::Error;
use crate::gpu::layout::{Answer, Beam};
use crate::progress::Progress;
use crate::render::Frame;
use glam::{DVec3, Vec3, Vec4};
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
    pub fn new(scene: &Scene, options: &RenderOptions) -> Self {
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

/// What the fields say about the light on one layer.
#[derive(Debug, Clone, Default)]
struct Found {
    /// Share of each light that arrives.
    shares: Vec<f32>,
    /// Share of the surroundings' light.
    open: f32,
    /// Matter of the own instance along the way to each light, scene units; only where it scatters.
    thickness: Vec<f32>,
}

/// Light every layer and lay the layers over the background.
pub fn shade(
    casters: &Casters<'_>,
    buffer: &GBuffer,
    lights: &Lights,
    options: &RenderOptions,
    asked: &Asked,
    progress: &Progress,
) -> Result<Frame, Error> {
    let ask = |surface: &Surface<'_>, x: usize, y: usize, found: &mut Found| {
        surface.look(casters, lights, options, pixel_turn(x, y), found)
    };
    compose(casters.scene, buffer, lights, options, asked, progress, ask)
}

/// The same with rays and cones on a graphics device.
pub fn shade_on_device(
    casters: &Casters<'_>,
    device: &DeviceScene,
    buffer: &GBuffer,
    lights: &Lights,
    options: &RenderOptions,
    asked: &Asked,
    progress: &Progress,
) -> Result<Frame, Error> {
    // A bunch of rows at a time: beams take 64 bytes each.
    let beams_per_layer = lights.lights.len().max(1)
        * if let SceneShadows::Area(count) = options.shadows { count as usize } else { PARTS as usize }
        + AO_CONES;
    let mut found: Vec<Vec<(Found, Work)>> = Vec::with_capacity(buffer.rows.len());
    let mut first = 0;
    while first < buffer.rows.len() {
        let mut layers = 0;
        let mut end = first;
        while end < buffer.rows.len() && (end == first || layers * beams_per_layer < MOST_BEAMS) {
            layers += buffer.rows[end].len();
            end += 1;
        }
        found.extend(look_on_device(casters, device, buffer, lights, options, first..end, progress)?);
        first = end;
    }
    let ask = |surface: &Surface<'_>, _: usize, y: usize, wanted: &mut Found| {
        let (answer, work) = &found[y][surface.index];
        wanted.clone_from(answer);
        *work
    };
    compose(casters.scene, buffer, lights, options, asked, progress, ask)
}

/// Beams that go to a device at a time, about: 64 MiB.
const MOST_BEAMS: usize = 1 << 20;

/// What the fields say about the layers of some rows, and what it took.
fn look_on_device(
    casters: &Casters<'_>,
    device: &DeviceScene,
    buffer: &GBuffer,
    lights: &Lights,
    options: &RenderOptions,
    rows: std::ops::Range<usize>,
    progress: &Progress,
) -> Result<Vec<Vec<(Found, Work)>>, Error> {
    let scene = casters.scene;
    let mut surfaces = Vec::new();
    for y in rows.clone() {
        for (index, layer) in buffer.rows[y].iter().enumerate() {
            let direction = buffer.view.direction(layer.x, y as u32);
            surfaces.push((y, Surface::new(scene, layer, index, buffer.view.camera.eye, direction)));
        }
    }
    // First round: one beam a light, all of an area light, the cones of occlusion.
    let (mut beams, mut through) = (Vec::new(), Vec::new());
    for (y, surface) in &surfaces {
        if let Some(distance) = options.occlusion {
            beams.extend(
                surface
                    .open_rays(distance / scene.scale)
                    .map(|(ray, _)| Beam { is_coarse: 1, ..beam(&surface.place, &ray, AO_SLOPE) }),
            );
        }
        for light in &lights.lights {
            let (ray, slope, _) = light.seen_from(surface.place.p);
            if surface.asks_for(&ray, options) {
                match options.shadows {
                    SceneShadows::Soft => beams.push(beam(&surface.place, &ray, slope)),
                    SceneShadows::Area(count) if slope > 0.0 => {
                        let (axes, turn) = (basis(ray.direction), pixel_turn(surface.layer.x as usize, *y));
                        beams.extend((0..count).map(|i| {
                            beam(&surface.place, &toward(&ray, axes, slope, disc_point(i, count, turn)), 0.0)
                        }));
                    }
                    _ => beams.push(beam(&surface.place, &ray, 0.0)),
                }
            }
            if surface.scatters(scene) {
                through.push(beam(&surface.place, &ray, 0.0));
            }
        }
    }
    let first = device.shares(casters, &beams, progress)?;
    let thick = device.thicknesses(&through, progress)?;

    // Second round: discs that one cone did not decide.
    let mut parts = Vec::new();
    if options.shadows == SceneShadows::Soft {
        for (beam_of_disc, _) in beams.iter().zip(&first).filter(|(beam, answer)| is_undecided(beam, answer)) {
            let ray = Ray {
                direction: Vec3::from_array(beam_of_disc.direction).as_dvec3(),
                t_max: f64::from(beam_of_disc.t_max),
            };
            let axes = basis(ray.direction);
            parts.extend((0..PARTS).map(|i| {
                let part = toward(&ray, axes, beam_of_disc.slope, disc_point(i, PARTS, 0.0));
                Beam {
                    direction: part.direction.as_vec3().to_array(),
                    t_max: part.t_max as f32,
                    slope: beam_of_disc.slope / (PARTS as f32).sqrt(),
                    is_coarse: 1,
                    ..*beam_of_disc
                }
            }));
        }
    }
    let second = device.shares(casters, &parts, progress)?;
    let mut discs = second.chunks_exact(PARTS as usize);

    let mut answers = beams.iter().zip(&first);
    let mut thick = thick.iter();
    let mut result: Vec<Vec<(Found, Work)>> = rows.clone().map(|_| Vec::new()).collect();
    for (y, surface) in &surfaces {
        let (mut found, mut work) = (Found { open: 1.0, ..Found::default() }, Work::default());
        if let Some(distance) = options.occlusion {
            let (mut sum, mut weights) = (0.0, 0.0);
            for (_, weight) in surface.open_rays(distance / scene.scale) {
                let (_, answer) = answers.next().expect("one answer a cone");
                sum += weight * answer.value;
                weights += weight;
                work += took(answer);
            }
            found.open = sum / weights;
        }
        for light in &lights.lights {
            let (ray, slope, _) = light.seen_from(surface.place.p);
            let share = if !surface.asks_for(&ray, options) {
                if options.shadows == SceneShadows::None { 1.0 } else { 0.0 }
            } else {
                let count = match options.shadows {
                    SceneShadows::Area(count) if slope > 0.0 => count,
                    _ => 1,
                };
                let mut sum = 0.0;
                for _ in 0..count {
                    let (beam, answer) = answers.next().expect("one answer a ray");
                    work += took(answer);
                    sum += answer.value;
                    if options.shadows == SceneShadows::Soft && is_undecided(beam, answer) {
                        let parts = discs.next().expect("the parts of each disc");
                        parts.iter().for_each(|part| work += took(part));
                        sum = parts.iter().map(|part| part.value).sum::<f32>() / PARTS as f32;
                    }
                }
                sum / count as f32
            };
            found.shares.push(share);
            let is_thick = surface.scatters(scene);
            found.thickness.push(if is_thick { thick.next().expect("one answer a light").value } else { 0.0 });
        }
        result[y - rows.start].push((found, work));
    }
    Ok(result)
}

fn took(answer: &Answer) -> Work {
    Work { steps: answer.steps, rays: 1, far_rays: answer.is_far }
}

/// Whether a cone to a light's disc needs a closer look. The cones of occlusion do not.
fn is_undecided(beam: &Beam, answer: &Answer) -> bool {
    beam.slope > 0.0 && beam.is_coarse == 0 && answer.is_proven == 0
}

/// Shade the layers by what `ask` finds, which returns what it took, and lay them over the background.
fn compose(
    scene: &Scene,
    buffer: &GBuffer,
    lights: &Lights,
    options: &RenderOptions,
    asked: &Asked,
    progress: &Progress,
    ask: impl Fn(&Surface<'_>, usize, usize, &mut Found) -> Work + Sync,
) -> Result<Frame, Error> {
    let [width, height] = options.size.map(|n| n as usize);
    let mut frame = Frame::new(width, height, lights.lights.len());
    frame.rows().into_par_iter().enumerate().try_for_each(|(y, row)| {
        row.steps.copy_from_slice(&buffer.steps[y]);
        let layers = &buffer.rows[y];
        let mut next = 0;
        let (mut found, mut total) = (Found::default(), Work::default());
        for x in 0..width {
            let mut color = Vec4::ZERO;
            let mut passes = 1.0;
            let mut is_first = true;
            while let Some(layer) = layers.get(next).filter(|layer| layer.x as usize == x) {
                let direction = buffer.view.direction(x as u32, y as u32);
                let surface = Surface::new(scene, layer, next, buffer.view.camera.eye, direction);
                let work = ask(&surface, x, y, &mut found);
                row.steps[x] += work.steps;
                total += work;
                let light = surface.shade(scene, lights, options, &found);
                color += passes * layer.color.w * light.extend(1.0);
                passes *= 1.0 - layer.color.w;
                // The pixel belongs to the first surface that hides half or more of what is behind it.
                if is_first && layer.color.w >= 0.5 {
                    is_first = false;
                    row.depth[x] = layer.depth as f32;
                    row.normal[3 * x..][..3].copy_from_slice(&layer.normal.to_array());
                    row.object_id[x] = scene.instances[layer.instance as usize].object as i32;
                    row.shadow[x * row.lights..][..row.lights].copy_from_slice(&found.shares);
                }
                next += 1;
            }
            let behind = Vec4::from_array(options.background);
            let rgb = (color.truncate() + passes * behind.truncate()) * options.exposure;
            let pixel = [rgb.x, rgb.y, rgb.z, color.w + passes * behind.w];
            row.color[4 * x..][..4].copy_from_slice(&pixel);
        }
        asked.add(total);
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
    /// Place of the layer in its row.
    index: usize,
    place: Place,
    to_eye: Vec3,
}

impl<'a> Surface<'a> {
    fn new(scene: &Scene, layer: &'a Layer, index: usize, eye: DVec3, direction: DVec3) -> Self {
        let place = Place {
            p: scene.scene_from_world(eye + layer.depth * direction),
            normal: layer.normal,
            own: layer.instance,
            bias_voxels: if layer.is_triangle { BIAS_TRIANGLE } else { BIAS_FIELD },
        };
        Self { layer, index, place, to_eye: -direction.normalize().as_vec3() }
    }

    fn cosine(&self, ray: &Ray) -> f32 {
        self.layer.normal.dot(ray.direction.as_vec3())
    }

    /// Whether a light's share is a question: a side that is turned away gets none.
    fn asks_for(&self, ray: &Ray, options: &RenderOptions) -> bool {
        options.shadows != SceneShadows::None && self.cosine(ray) > 0.0
    }

    fn scatters(&self, scene: &Scene) -> bool {
        scene.materials[self.layer.material as usize].scattering != [0.0; 3]
    }

    /// Ask the fields about each light and the surroundings; returns what that took.
    fn look(
        &self,
        casters: &Casters<'_>,
        lights: &Lights,
        options: &RenderOptions,
        turn: f32,
        found: &mut Found,
    ) -> Work {
        let (scene, mut work) = (casters.scene, Work::default());
        found.open = match options.occlusion {
            None => 1.0,
            Some(distance) => {
                let (mut sum, mut weights) = (0.0, 0.0);
                for (ray, weight) in self.open_rays(distance / scene.scale) {
                    sum += weight * casters.cone_share(&self.place, &ray, AO_SLOPE, &mut work);
                    weights += weight;
                }
                sum / weights
            }
        };
        found.shares.clear();
        found.thickness.clear();
        for light in &lights.lights {
            let (ray, slope, _) = light.seen_from(self.place.p);
            let place = &self.place;
            found.shares.push(match options.shadows {
                SceneShadows::None => 1.0,
                _ if !self.asks_for(&ray, options) => 0.0,
                SceneShadows::Hard => casters.ray_share(place, &ray, &mut work),
                SceneShadows::Soft => casters.disc_share(place, &ray, slope, &mut work),
                SceneShadows::Area(count) => casters.area_share(place, &ray, slope, count, turn, &mut work),
                SceneShadows::Article => scene.article_share(place, &ray, &mut work),
            });
            let is_thick = self.scatters(scene);
            found.thickness.push(if is_thick { casters.thickness(place, ray.direction, &mut work) } else { 0.0 });
        }
        work
    }

    /// The cones over the hemisphere with their weights; matter within `distance`, scene units, counts.
    fn open_rays(&self, distance: f64) -> impl Iterator<Item = (Ray, f32)> {
        let normal = self.place.normal.as_dvec3();
        let [right, up] = basis(normal);
        (0..AO_CONES).map(move |i| {
            if i == 0 {
                return (Ray { direction: normal, t_max: distance }, 1.0);
            }
            let angle = (i - 1) as f64 * (std::f64::consts::TAU / (AO_CONES - 1) as f64);
            let aside = angle.cos() * right + angle.sin() * up;
            (Ray { direction: AO_RING.0 * normal + AO_RING.1 * aside, t_max: distance }, AO_RING.0 as f32)
        })
    }

    /// Linear RGB.
    fn shade(&self, scene: &Scene, lights: &Lights, options: &RenderOptions, found: &Found) -> Vec3 {
        let material = &scene.materials[self.layer.material as usize];
        let albedo = self.layer.color.truncate();
        let mut color = options.ambient * found.open * albedo;
        for ((light, &share), &thickness) in lights.lights.iter().zip(&found.shares).zip(&found.thickness) {
            let (ray, _, light_color) = light.seen_from(self.place.p);
            let cosine = self.cosine(&ray);
            if share > 0.0 && cosine > 0.0 {
                let half = (ray.direction.as_vec3() + self.to_eye).normalize_or_zero();
                let highlight = material.specular * self.layer.normal.dot(half).max(0.0).powf(material.shininess);
                color += share * light_color * (cosine * albedo + highlight);
            }
            if self.scatters(scene) {
                let through = self.through(&material.scattering, &ray, cosine, thickness * scene.scale as f32);
                color += light_color * albedo * through;
            }
        }
        color
    }

    /// Light that comes through so much of the instance, world units, from its far side, for each of RGB.
    fn through(&self, scattering: &[f32; 3], ray: &Ray, cosine: f32, thickness: f32) -> Vec3 {
        /// How much the normal bends the light on its way out, and how narrow the glow against the light is.
        const BEND: f32 = 0.3;
        const GLOW: i32 = 4;
        let to_light = ray.direction.as_vec3();
        let left = scattering.map(|length| if length > 0.0 { (-thickness / length).exp() } else { 0.0 });
        let out = -(to_light + BEND * self.layer.normal).normalize_or_zero();
        let glow = out.dot(self.to_eye).max(0.0).powi(GLOW);
        // What the cosine term leaves of the light that falls on the surface.
        let room = 1.0 - cosine.max(0.0);
        Vec3::from_array(left) * (room * (0.5 + 0.5 * glow))
    }
}
