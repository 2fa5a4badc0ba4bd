//! Indirect diffuse light: the light that arrives at a surface from other surfaces and from the surroundings.
//!
//! # Theory
//!
//! A diffuse surface reflects `albedo` times the mean of the light that arrives along cosine-weighted directions.
//! Each sample is a path. Its first directions are spread evenly over the hemisphere: points spread evenly over a disc,
//! lifted to the hemisphere (Malley's method). A path collects
//!
//! - the light of the surroundings, where it leaves the scene;
//! - the emission of each surface that it hits, together with one point on the emissive faces for each of its vertices
//!   ([`super::emitters`]);
//! - the light of the lights on each surface that it hits, times the albedo of the path so far.
//!
//! A path ends at the largest number of bounces. Its light has not the direct light at the visible surface, which the
//! light pass computes ([`super::shadow`]). Rays find triangles and fields ([`super::light_hits`]), so indirect light
//! agrees with the shadows.
//!
//! [`Paths::Common`] have the same points of the disc and the same further samples at all surfaces. Their error is
//! smooth across a surface, so they show where light changes, and it can be interpolated
//! ([`crate::scene::lighting::upsampling`]). [`Paths::Own`] differ from pixel to pixel: the paths of a pixel continue
//! the low-discrepancy sequence of the pixels before it in a space-filling curve (Morton order), so neighbours
//! together have the samples of a longer sequence. Their errors average out ([`crate::scene::lighting::denoise`]).

use super::emitters::Emitters;
use super::light_rays::{GOLDEN_ANGLE, LightRay, LightWork, SurfacePoint, basis};
use super::lit_surface::Lights;
use super::shadow::TracedScene;
use crate::error::Error;
use crate::progress::Progress;
use crate::scene::content::options::{Ambient, BounceOptions, MAX_BOUNCES, RenderOptions, SceneShadows};
use glam::{DVec3, Vec2, Vec3};

/// Number of values of a sample for each vertex of its path: two for a point on the emitters, two for a direction.
const PER_VERTEX: usize = 4;

/// One prime number for each value of a path: value `i` of the samples is the Richtmyer sequence of multiples of the
/// root of prime `i`.
const PRIMES: [f64; PER_VERTEX * (MAX_BOUNCES as usize + 1)] = [
    2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0, 47.0, 53.0, 59.0, 61.0, 67.0, 71.0,
];

/// Ratio of the number of own paths to the number of common ones.
const OWN_FOR_COMMON: u32 = 2;
/// Smallest number of common paths, unless there are fewer own ones.
const LEAST_COMMON: u32 = 16;

/// The paths of a surface.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Paths {
    /// The same few paths at all surfaces.
    Common,
    /// Other paths at each pixel.
    Own { x: u32, y: u32 },
}

/// The samples of the paths of one surface.
#[derive(Debug, Clone, Copy)]
struct Samples {
    /// Number of paths.
    count: u32,
    /// Number of the first path in the sequence of all pixels.
    first: f64,
    /// Turn of the points of the disc, radians, and the position of each in its ring.
    turn: f32,
    ring: f32,
}

impl Samples {
    fn new(paths: Paths, count: u32) -> Self {
        match paths {
            Paths::Common => {
                let count = (count / OWN_FOR_COMMON).max(LEAST_COMMON).min(count);
                Self { count, first: 0.0, turn: 0.0, ring: 0.5 }
            }
            Paths::Own { x, y } => {
                let pixel = f64::from(morton(x, y));
                let along = |step: f64| (pixel * step).fract() as f32;
                // Powers of the inverse of the plastic number (Roberts 2018).
                let (turn, ring) =
                    (along(0.754_877_666_246_692_8) * std::f32::consts::TAU, along(0.569_840_290_998_053_3));
                Self { count, first: pixel * f64::from(count), turn, ring }
            }
        }
    }

    /// The point of the unit disc above which a path starts: evenly spread points (Vogel 1979).
    fn on_disc(&self, sample: u32) -> Vec2 {
        let radius = ((sample as f32 + self.ring) / self.count as f32).sqrt();
        radius * Vec2::from_angle(sample as f32 * GOLDEN_ANGLE + self.turn)
    }

    /// A value of a path from 0 to 1, by the root of a prime number.
    fn value(&self, sample: u32, prime: f64) -> f64 {
        (0.5 + (self.first + f64::from(sample + 1)) * prime.sqrt()).fract()
    }
}

/// The index of a pixel in Morton order, of its lower 13 bits: the bits of the column and of the row alternate.
fn morton(x: u32, y: u32) -> u32 {
    let spread = |v: u32| (0..13).fold(0, |bits, i| bits | (v >> i & 1) << (2 * i));
    spread(x) | spread(y) << 1
}

/// Factor of the light of a path below which it ends.
const NEGLIGIBLE: f32 = 1e-3;

/// The data for indirect light in a picture.
pub(crate) struct Bounces<'a> {
    traced: TracedScene<'a>,
    lights: &'a Lights,
    ambient: &'a Ambient,
    emitters: Emitters,
    has_shadows: bool,
    /// Whether the surroundings or any surface emit light.
    has_glow: bool,
    options: BounceOptions,
}

impl<'a> Bounces<'a> {
    /// None if the picture has no indirect light.
    pub(crate) fn new(
        traced: &TracedScene<'a>,
        lights: &'a Lights,
        options: &'a RenderOptions,
        progress: &Progress,
    ) -> Result<Option<Self>, Error> {
        let Some(bounces) = options.bounces else { return Ok(None) };
        let scene = traced.scene;
        let emits = scene.materials.iter().any(|material| material.unlit || material.emission != [0.0; 3]);
        Ok(Some(Self {
            // A far field has no colours.
            traced: TracedScene { far: None, ..*traced },
            lights,
            ambient: &options.ambient,
            emitters: Emitters::new(scene, progress)?,
            has_shadows: options.shadows != SceneShadows::None,
            has_glow: emits || !options.ambient.is_dark(),
            options: bounces,
        }))
    }

    /// Linear RGB of the indirect light that a white surface reflects.
    pub(crate) fn light_on(&self, place: &SurfacePoint, paths: Paths, work: &mut LightWork) -> Vec3 {
        let samples = Samples::new(paths, self.options.samples);
        let sum: Vec3 = (0..samples.count).map(|i| self.along_path(place, i, &samples, work)).sum();
        // The light of the surroundings is a quadratic form, which may be negative in some directions.
        (sum / samples.count as f32).max(Vec3::ZERO)
    }

    /// The light along one path.
    fn along_path(&self, place: &SurfacePoint, sample: u32, samples: &Samples, work: &mut LightWork) -> Vec3 {
        let scene = self.traced.scene;
        let mut at = *place;
        let mut direction = lifted(&at, samples.on_disc(sample));
        let (mut weight, mut sum) = (Vec3::ONE, Vec3::ZERO);
        for (bounce, primes) in (0..=self.options.count).zip(PRIMES.as_chunks::<PER_VERTEX>().0) {
            let value = |i: usize| samples.value(sample, primes[i]);
            if !self.emitters.is_empty() {
                // At the visible surface each path has a part of the emitters. Even steps would resonate with meshes
                // whose faces are in a regular order.
                let along =
                    if bounce == 0 { (f64::from(sample) + value(0)) / f64::from(samples.count) } else { value(0) };
                sum += weight * self.emitters.light(&self.traced, &at, [along, value(1)], work);
            }
            let is_last = bounce == self.options.count;
            if is_last && !self.has_glow {
                break;
            }
            if bounce > 0 {
                let angle = (std::f64::consts::TAU * value(3)) as f32;
                direction = lifted(&at, value(2).sqrt() as f32 * Vec2::from_angle(angle));
            }
            let ray = LightRay { direction, t_max: f64::INFINITY };
            let Some(hit) = self.traced.first_surface(&at, &ray, work) else {
                sum += weight * self.ambient.from(direction.as_vec3());
                break;
            };
            if hit.emission != Vec3::ZERO {
                sum += weight * hit.emission * self.emitters.share_of_direction(scene, &at, &ray, &hit);
            }
            weight *= hit.albedo;
            if is_last || weight.max_element() < NEGLIGIBLE {
                break;
            }
            at = hit.place;
            sum += weight * self.direct_light(&at, work);
        }
        sum
    }

    /// The direct light that a white surface reflects.
    fn direct_light(&self, place: &SurfacePoint, work: &mut LightWork) -> Vec3 {
        let mut sum = Vec3::ZERO;
        for light in &self.lights.lights {
            let (ray, _, color) = light.seen_from(place.p);
            let cosine = place.normal.dot(ray.direction.as_vec3());
            if cosine > 0.0 && color != Vec3::ZERO {
                let share = if self.has_shadows { self.traced.ray_share(place, &ray, work) } else { 1.0 };
                sum += share * cosine * color;
            }
        }
        sum
    }
}

/// The unit direction above a point of the unit disc in the plane of a surface.
fn lifted(place: &SurfacePoint, on_disc: Vec2) -> DVec3 {
    let normal = place.normal.as_dvec3();
    let [right, up] = basis(normal);
    let [x, y] = on_disc.as_dvec2().to_array();
    x * right + y * up + (1.0 - x * x - y * y).max(0.0).sqrt() * normal
}
