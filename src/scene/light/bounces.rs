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
//! The samples of each pixel are even, and start at random positions, so their errors differ from pixel to pixel and
//! average out. [`Bounces::parts_on`] separates the emission that arrives directly from the rest. The emission has the
//! edges of shadows; the rest is smooth but has more noise, so a filter treats them apart
//! ([`crate::scene::lighting::denoise`]).

use super::emitters::{Cut, Emitters};
use super::light_rays::{GOLDEN_ANGLE, LightRay, LightWork, SurfacePoint, basis};
use super::lit_surface::Lights;
use super::shadow::TracedScene;
use crate::error::Error;
use crate::progress::Progress;
use crate::scene::content::options::{Ambient, BounceOptions, MAX_BOUNCES, RenderOptions, SceneShadows};
use glam::{DVec3, Vec2, Vec3};

/// Number of values of a sample for each vertex of its path: two for a point on the emitters, two for a direction.
const PER_VERTEX: usize = 4;

/// One prime number for each value of a path: value `i` of the samples is a sequence of multiples of the root of prime
/// `i` (Richtmyer 1951).
const PRIMES: [f64; PER_VERTEX * (MAX_BOUNCES as usize + 1)] = [
    2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0, 19.0, 23.0, 29.0, 31.0, 37.0, 41.0, 43.0, 47.0, 53.0, 59.0, 61.0, 67.0, 71.0,
];

/// The light of some paths that a white surface reflects, linear RGB.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PathLight {
    /// Emission that arrives directly at the surface.
    pub emitted: Vec3,
    /// Light from the surroundings, and light that other surfaces reflect.
    pub rest: Vec3,
}

/// The samples of the paths of one surface.
#[derive(Debug, Clone, Copy)]
struct Samples {
    /// Number of paths.
    count: u32,
    /// Number that differs from pixel to pixel.
    seed: u32,
    /// Turn of the points of the disc, radians, and the position of each in its ring.
    turn: f32,
    ring: f32,
}

impl Samples {
    /// Samples of a pixel, which differ with `part` and from pixel to pixel.
    fn new([x, y]: [u32; 2], part: u32, count: u32) -> Self {
        let seed = hash(hash(hash(x) ^ y) ^ part);
        let turn = unit(hash(seed ^ 1)) as f32 * std::f32::consts::TAU;
        Self { count, seed, turn, ring: unit(hash(seed ^ 2)) as f32 }
    }

    /// The point of the unit disc above which a path starts: evenly spread points (Vogel 1979).
    fn on_disc(&self, sample: u32) -> Vec2 {
        let radius = ((sample as f32 + self.ring) / self.count as f32).sqrt();
        radius * Vec2::from_angle(sample as f32 * GOLDEN_ANGLE + self.turn)
    }

    /// A value of a path from 0 to 1: even steps from a random start (Cranley and Patterson 1976).
    fn value(&self, sample: u32, prime: f64) -> f64 {
        (unit(hash(self.seed ^ (4 * prime as u32))) + f64::from(sample) * prime.sqrt()).fract()
    }
}

/// A number whose bits are a random function of the bits of another one: the finalizer of MurmurHash3 (Appleby 2011).
fn hash(mut bits: u32) -> u32 {
    bits = bits.wrapping_add(0x9e37_79b9);
    bits = (bits ^ bits >> 16).wrapping_mul(0x85eb_ca6b);
    bits = (bits ^ bits >> 13).wrapping_mul(0xc2b2_ae35);
    bits ^ bits >> 16
}

/// A number from 0 to 1, less than 1.
fn unit(bits: u32) -> f64 {
    f64::from(bits) / 4_294_967_296.0
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
    /// Whether only emitters emit light to which directions are drawn.
    has_drawn_glow: bool,
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
        let emitters = Emitters::new(scene, progress)?;
        let emits = scene.materials.iter().any(|material| material.unlit || material.emission != [0.0; 3]);
        Ok(Some(Self {
            // A far field has no colours.
            traced: TracedScene { far: None, ..*traced },
            lights,
            ambient: &options.ambient,
            has_shadows: options.shadows != SceneShadows::None,
            has_glow: emits || !options.ambient.is_dark(),
            has_drawn_glow: options.ambient.is_dark() && emitters.are_all(scene),
            emitters,
            options: bounces,
        }))
    }

    /// Linear RGB of the indirect light that a white surface reflects, by all paths of a pixel.
    pub(crate) fn light_on(&self, place: &SurfacePoint, pixel: [u32; 2], work: &mut LightWork) -> Vec3 {
        let samples = Samples::new(pixel, 0, self.options.samples);
        let cut = self.emitters.cut(place, samples.count);
        let PathLight { emitted, rest } = self.light_of(place, cut.as_ref(), &samples, work);
        emitted + rest
    }

    /// Number of paths of a pixel.
    pub(crate) fn samples(&self) -> u32 {
        self.options.samples
    }

    /// The light by two halves of the paths of a pixel, `count` each.
    pub(crate) fn parts_on(
        &self,
        place: &SurfacePoint,
        pixel: [u32; 2],
        count: u32,
        work: &mut LightWork,
    ) -> [PathLight; 2] {
        let cut = self.emitters.cut(place, 2 * count);
        [0, 1].map(|half| self.light_of(place, cut.as_ref(), &Samples::new(pixel, half, count), work))
    }

    fn light_of(&self, place: &SurfacePoint, cut: Option<&Cut>, samples: &Samples, work: &mut LightWork) -> PathLight {
        let mut sum = PathLight::default();
        for sample in 0..samples.count {
            self.follow(place, cut, (sample, samples), &mut sum, work);
        }
        // The light of the surroundings is a quadratic form, which may be negative in some directions.
        let mean = |sum: Vec3| (sum / samples.count as f32).max(Vec3::ZERO);
        PathLight { emitted: mean(sum.emitted), rest: mean(sum.rest) }
    }

    /// Adds the light along one path.
    fn follow(
        &self,
        place: &SurfacePoint,
        cut: Option<&Cut>,
        (sample, samples): (u32, &Samples),
        sum: &mut PathLight,
        work: &mut LightWork,
    ) {
        let scene = self.traced.scene;
        let mut at = *place;
        let mut direction = lifted(&at, samples.on_disc(sample));
        let mut weight = Vec3::ONE;
        for (bounce, primes) in (0..=self.options.count).zip(PRIMES.as_chunks::<PER_VERTEX>().0) {
            let cut = cut.filter(|_| bounce == 0);
            let value = |i: usize| samples.value(sample, primes[i]);
            let mut emitted = Vec3::ZERO;
            if !self.emitters.is_empty() {
                // At the visible surface each path has a part of the emitters. Even steps would resonate with meshes
                // whose faces are in a regular order.
                let along =
                    if bounce == 0 { (f64::from(sample) + value(0)) / f64::from(samples.count) } else { value(0) };
                emitted = self.emitters.light(&self.traced, &at, cut, [along, value(1)], work);
            }
            let is_last = bounce == self.options.count;
            if bounce > 0 {
                let angle = (std::f64::consts::TAU * value(3)) as f32;
                direction = lifted(&at, value(2).sqrt() as f32 * Vec2::from_angle(angle));
            }
            // The last ray finds emission only.
            let is_dark =
                is_last && (!self.has_glow || (self.has_drawn_glow && !self.emitters.may_be_hit(&at, direction)));
            let hit = if is_dark {
                None
            } else {
                let ray = LightRay { direction, t_max: f64::INFINITY };
                let hit = self.traced.first_surface(&at, &ray, work);
                match &hit {
                    None => sum.rest += weight * self.ambient.from(direction.as_vec3()),
                    Some(hit) if hit.emission != Vec3::ZERO => {
                        emitted += hit.emission * self.emitters.share_of_direction(scene, &at, cut, &ray, hit);
                    }
                    Some(_) => {}
                }
                hit
            };
            let part = if bounce == 0 { &mut sum.emitted } else { &mut sum.rest };
            *part += weight * emitted;
            let Some(hit) = hit else { break };
            weight *= hit.albedo;
            if is_last || weight.max_element() < NEGLIGIBLE {
                break;
            }
            at = hit.place;
            sum.rest += weight * self.direct_light(&at, work);
        }
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
