//! What is known about the light at the surfaces that a camera sees: asked of the fields, on the CPU or a device, or taken
//! from neighbours.
//!
//! Light changes slowly over most of a picture, and asking for it is what costs. So a picture at half resolution asks at
//! every second pixel of every second row, and a picture of several samples a pixel asks at the pixels' centres. Whatever
//! lies between takes the mean of the four asked surfaces around it, weighed bilinearly, of those that belong to the same
//! instance, lie in its plane and face its way (joint bilateral upsampling: Kopf et al., SIGGRAPH 2007). Where too few of
//! them do, or where they disagree, as at the edge of a shadow, it is asked after all.

use super::gpu::{DeviceScene, beam};
use super::light::{AO_CONES, AO_SLOPE, Lights, Surface};
use super::primary::{GBuffer, Layer};
use super::shadow::{Casters, PARTS, Ray, Work, basis, disc_point, toward};
use super::{Asked, RenderOptions, SceneShadows};
use crate::error::{DeviceError, Error};
use crate::gpu::layout::{Answer, Beam};
use crate::progress::Progress;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// One look of the camera, and what its light is asked of.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    pub casters: &'a Casters<'a>,
    pub buffer: &'a GBuffer,
    pub lights: &'a Lights,
    pub options: &'a RenderOptions,
    /// None: the CPU.
    pub device: Option<&'a DeviceScene>,
    pub asked: &'a Asked,
    pub progress: &'a Progress,
}

/// What the fields say about the light on one layer.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// Share of the surroundings' light.
    pub open: f32,
    /// Share of each light that arrives.
    pub shares: &'a [f32],
    /// Matter of the own instance along the way to each light, scene units; only where it scatters.
    pub thickness: &'a [f32],
}

/// The same, to be written.
pub struct FoundMut<'a> {
    pub open: &'a mut f32,
    pub shares: &'a mut [f32],
    pub thickness: &'a mut [f32],
}

/// What is known about the layers of a G-buffer.
pub struct Known {
    lights: usize,
    rows: Vec<KnownRow>,
}

#[derive(Default)]
struct KnownRow {
    is_known: Vec<bool>,
    /// Of each layer: open, the shares, the thicknesses.
    values: Vec<f32>,
    steps: Vec<u32>,
}

impl Known {
    /// Nothing yet.
    pub fn new(buffer: &GBuffer, lights: usize) -> Self {
        let row = |layers: &Vec<Layer>| KnownRow {
            is_known: vec![false; layers.len()],
            values: vec![0.0; layers.len() * stride(lights)],
            steps: vec![0; layers.len()],
        };
        Self { lights, rows: buffer.rows.iter().map(row).collect() }
    }

    /// What is known of layer `i` in row `y`, and the steps that it took.
    pub fn at(&self, y: usize, i: usize) -> (Found<'_>, u32) {
        let row = &self.rows[y];
        let values = &row.values[i * stride(self.lights)..][..stride(self.lights)];
        let (shares, thickness) = values[1..].split_at(self.lights);
        (Found { open: values[0], shares, thickness }, row.steps[i])
    }
}

fn stride(lights: usize) -> usize {
    1 + 2 * lights
}

fn parts_of(values: &mut [f32], lights: usize) -> FoundMut<'_> {
    let (open, rest) = values.split_first_mut().expect("a layer has `stride` values, at least one");
    let (shares, thickness) = rest.split_at_mut(lights);
    FoundMut { open, shares, thickness }
}

/// Find the light of a pass: all of it by asking, or what lies between asked pixels from those.
pub fn find(pass: &Pass<'_>, centre: Option<(&GBuffer, &Known)>) -> Result<Known, Error> {
    let mut known = Known::new(pass.buffer, pass.lights.lights.len());
    let every = pass.options.light_scale;
    if let Some((buffer, centre)) = centre {
        gather(pass, &mut known, buffer, centre, 1)?;
    } else if every > 1 {
        ask(pass, &mut known, &|x, y| x % every == 0 && y % every == 0, 0)?;
        let mut between = Known::new(pass.buffer, known.lights);
        std::mem::swap(&mut between, &mut known);
        gather(pass, &mut known, pass.buffer, &between, every)?;
        keep(&mut known, between);
    }
    ask(pass, &mut known, &|_, _| true, 1)?;
    Ok(known)
}

/// Put what was asked over what was gathered.
fn keep(known: &mut Known, asked: Known) {
    let stride = stride(known.lights);
    for (row, asked) in known.rows.iter_mut().zip(asked.rows) {
        for i in (0..asked.is_known.len()).filter(|&i| asked.is_known[i]) {
            row.is_known[i] = true;
            row.steps[i] = asked.steps[i];
            row.values[i * stride..][..stride].copy_from_slice(&asked.values[i * stride..][..stride]);
        }
    }
}

/// Ask for what is not known yet at the pixels that are wanted; each row counts as so much progress.
fn ask(
    pass: &Pass<'_>,
    known: &mut Known,
    wanted: &(dyn Fn(u32, u32) -> bool + Sync),
    worth: u64,
) -> Result<(), Error> {
    if let Some(device) = pass.device {
        return ask_device(pass, device, known, wanted, worth);
    }
    let lights = known.lights;
    known.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut total = Work::default();
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !row.is_known[i] && wanted(layer.x, y as u32) {
                let surface = Surface::new(pass.casters.scene, pass.buffer, y, layer);
                let mut found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
                let work = surface.look(pass.casters, pass.lights, pass.options, &mut found);
                row.steps[i] = work.steps;
                total += work;
                row.is_known[i] = true;
            }
        }
        pass.asked.add(total);
        pass.progress.advance(worth)
    })
}

// ---- neighbours

/// Cosine between normals of surfaces that share their light: 18 degrees.
const SAME_NORMAL: f32 = 0.95;
/// Values that differ by less may be averaged.
const AGREE: f32 = 0.125;
/// The bilinear weights of the neighbours that fit, together at least.
const ENOUGH: f32 = 0.5;

/// Take from a buffer whose light is known, at every so many pixels, what its surfaces tell about those of the pass.
fn gather(pass: &Pass<'_>, known: &mut Known, source: &GBuffer, asked: &Known, every: u32) -> Result<(), Error> {
    let lights = known.lights;
    known.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut neighbours = Vec::with_capacity(4);
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            let surface = Surface::new(pass.casters.scene, pass.buffer, y, layer);
            neighbours.clear();
            fitting(pass, &surface, y, source, asked, every, &mut neighbours);
            let values = &mut row.values[i * stride(lights)..][..stride(lights)];
            row.is_known[i] = mean(&neighbours, values);
            for (light, share) in pass.lights.lights.iter().zip(&mut values[1..]) {
                if let Some(plain) = surface.plain_share(&light.seen_from(surface.place.p).0, pass.options) {
                    *share = plain;
                }
            }
        }
        pass.progress.check()
    })
}

/// The known surfaces around one that could share their light with it, and their bilinear weights.
fn fitting<'a>(
    pass: &Pass<'_>,
    surface: &Surface<'_>,
    y: usize,
    source: &GBuffer,
    asked: &'a Known,
    every: u32,
    neighbours: &mut Vec<(&'a [f32], f32)>,
) {
    let view = &pass.buffer.view;
    let eye = view.camera.eye;
    let p = eye + surface.layer.depth * view.direction(surface.layer.x, y as u32);
    let normal = surface.layer.normal.as_dvec3();
    // Half the distance of two asked pixels there.
    let apart = 0.5 * view.camera.pixel_size(view.size[1]) * surface.layer.depth * f64::from(every);
    let at = |pixel: u32, offset: f64| (f64::from(pixel) + offset - 0.5) / f64::from(every);
    let (u, v) = (at(surface.layer.x, view.offset[0]), at(y as u32, view.offset[1]));
    for (dx, dy) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
        let (column, line) = (u.floor() + dx, v.floor() + dy);
        let weight = ((1.0 - (u - column).abs()) * (1.0 - (v - line).abs())) as f32;
        let (x, y) = (column * f64::from(every), line * f64::from(every));
        if weight <= 0.0 || x < 0.0 || y < 0.0 || y >= f64::from(view.size[1]) {
            continue;
        }
        let (x, y) = (x as u32, y as usize);
        let layers = &source.rows[y];
        let first = layers.partition_point(|layer| layer.x < x);
        let same = layers[first..].iter().take_while(|layer| layer.x == x).position(|layer| {
            layer.instance == surface.layer.instance && layer.normal.dot(surface.layer.normal) >= SAME_NORMAL && {
                let q: DVec3 = eye + layer.depth * source.view.direction(x, y as u32);
                normal.dot(q - p).abs() <= apart
            }
        });
        if let Some(i) = same {
            neighbours
                .push((&asked.rows[y].values[(first + i) * stride(asked.lights)..][..stride(asked.lights)], weight));
        }
    }
}

/// The weighed mean of values, or false where too few are there or they disagree.
fn mean(neighbours: &[(&[f32], f32)], values: &mut [f32]) -> bool {
    let total: f32 = neighbours.iter().map(|(_, weight)| weight).sum();
    if total < ENOUGH {
        return false;
    }
    for (i, value) in values.iter_mut().enumerate() {
        let of = |neighbour: &(&[f32], f32)| neighbour.0[i];
        let low = neighbours.iter().map(of).fold(f32::INFINITY, f32::min);
        let high = neighbours.iter().map(of).fold(0.0, f32::max);
        // Shares are parts of 1; thicknesses are compared with themselves.
        if high - low > AGREE * high.min(1.0).max(f32::from(u8::from(i <= neighbours[0].0.len() / 2))) {
            return false;
        }
        *value = neighbours.iter().map(|(values, weight)| values[i] * weight).sum::<f32>() / total;
    }
    true
}

// ---- devices

/// Beams that go to a device at a time, about: 64 MiB.
const MOST_BEAMS: usize = 1 << 20;

fn ask_device(
    pass: &Pass<'_>,
    device: &DeviceScene,
    known: &mut Known,
    wanted: &dyn Fn(u32, u32) -> bool,
    worth: u64,
) -> Result<(), Error> {
    // A bunch of rows at a time: beams take 64 bytes each.
    let rays = if let SceneShadows::Area(count) = pass.options.shadows { count } else { PARTS } as usize;
    let beams_per_layer = pass.lights.lights.len().max(1) * rays + AO_CONES;
    let lights = known.lights;
    let mut bunch = Vec::new();
    for y in 0..known.rows.len() {
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !known.rows[y].is_known[i] && wanted(layer.x, y as u32) {
                bunch.push((y, i, Surface::new(pass.casters.scene, pass.buffer, y, layer)));
            }
        }
        pass.progress.advance(worth)?;
        if bunch.len() * beams_per_layer < MOST_BEAMS && y + 1 < known.rows.len() {
            continue;
        }
        let mut answers = Answers::ask(pass, device, &bunch)?;
        for (y, i, surface) in bunch.drain(..) {
            let row = &mut known.rows[y];
            let mut found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
            let work = answers.next(pass, &surface, &mut found).ok_or_else(|| too_few(device))?;
            row.steps[i] = work.steps;
            pass.asked.add(work);
            row.is_known[i] = true;
        }
    }
    Ok(())
}

fn too_few(device: &DeviceScene) -> DeviceError {
    let reason = "it gave fewer answers than it was asked".into();
    DeviceError::Failed { device: device.context().label(), what: "the scene's light".into(), reason }
}

/// Answers of a device, in the order in which they were asked.
struct Answers {
    beams: std::iter::Zip<std::vec::IntoIter<Beam>, std::vec::IntoIter<Answer>>,
    /// The parts of discs that one cone did not decide.
    parts: std::vec::IntoIter<Answer>,
    thick: std::vec::IntoIter<Answer>,
}

impl Answers {
    fn ask(pass: &Pass<'_>, device: &DeviceScene, bunch: &[(usize, usize, Surface<'_>)]) -> Result<Self, Error> {
        let (mut beams, mut through) = (Vec::new(), Vec::new());
        for (_, _, surface) in bunch {
            first_beams(pass, surface, &mut beams, &mut through);
        }
        let first = device.shares(pass.casters, &beams, pass.progress)?;
        let thick = device.thicknesses(&through, pass.progress)?;
        let mut parts = Vec::new();
        if pass.options.shadows == SceneShadows::Soft {
            for (beam, _) in beams.iter().zip(&first).filter(|(beam, answer)| is_undecided(beam, answer)) {
                parts.extend(parts_of_disc(beam));
            }
        }
        let second = device.shares(pass.casters, &parts, pass.progress)?;
        Ok(Self { beams: beams.into_iter().zip(first), parts: second.into_iter(), thick: thick.into_iter() })
    }

    /// What was found about the next surface, and the steps it took; `None` if the answers have run out.
    fn next(&mut self, pass: &Pass<'_>, surface: &Surface<'_>, found: &mut FoundMut<'_>) -> Option<Work> {
        let mut work = Work::default();
        *found.open = 1.0;
        if let Some(distance) = pass.options.occlusion {
            let (mut sum, mut weights) = (0.0, 0.0);
            for (_, weight) in surface.open_rays(distance / pass.casters.scene.scale) {
                let (_, answer) = self.beams.next()?;
                sum += weight * answer.value;
                weights += weight;
                work += took(&answer);
            }
            *found.open = sum / weights;
        }
        for (i, light) in pass.lights.lights.iter().enumerate() {
            let (ray, slope, _) = light.seen_from(surface.place.p);
            found.shares[i] = match surface.plain_share(&ray, pass.options) {
                Some(share) => share,
                None => self.share(pass.options, slope, &mut work)?,
            };
            let is_thick = surface.scatters(pass.casters.scene);
            found.thickness[i] = if is_thick { self.thick.next()?.value } else { 0.0 };
        }
        Some(work)
    }

    fn share(&mut self, options: &RenderOptions, slope: f32, work: &mut Work) -> Option<f32> {
        let count = match options.shadows {
            SceneShadows::Area(count) if slope > 0.0 => count,
            _ => 1,
        };
        let mut sum = 0.0;
        for _ in 0..count {
            let (beam, answer) = self.beams.next()?;
            *work += took(&answer);
            sum += answer.value;
            if options.shadows == SceneShadows::Soft && is_undecided(&beam, &answer) {
                sum = 0.0;
                for part in self.parts.by_ref().take(PARTS as usize) {
                    *work += took(&part);
                    sum += part.value;
                }
                sum /= PARTS as f32;
            }
        }
        Some(sum / count as f32)
    }
}

/// One beam a light, all of an area light, the cones of occlusion; the ways through matter apart.
fn first_beams(pass: &Pass<'_>, surface: &Surface<'_>, beams: &mut Vec<Beam>, through: &mut Vec<Beam>) {
    if let Some(distance) = pass.options.occlusion {
        let cones = surface.open_rays(distance / pass.casters.scene.scale);
        beams.extend(cones.map(|(ray, _)| Beam { is_coarse: 1, ..beam(&surface.place, &ray, AO_SLOPE) }));
    }
    for light in &pass.lights.lights {
        let (ray, slope, _) = light.seen_from(surface.place.p);
        if surface.asks_for(&ray, pass.options) {
            match pass.options.shadows {
                SceneShadows::Soft => beams.push(beam(&surface.place, &ray, slope)),
                SceneShadows::Area(count) if slope > 0.0 => {
                    let axes = basis(ray.direction);
                    beams.extend((0..count).map(|i| {
                        let point = disc_point(i, count, surface.turn);
                        beam(&surface.place, &toward(&ray, axes, slope, point), 0.0)
                    }));
                }
                _ => beams.push(beam(&surface.place, &ray, 0.0)),
            }
        }
        if surface.scatters(pass.casters.scene) {
            through.push(beam(&surface.place, &ray, 0.0));
        }
    }
}

/// The narrow cones that share a light's disc.
fn parts_of_disc(disc: &Beam) -> impl Iterator<Item = Beam> {
    let direction = Vec3::from_array(disc.direction).as_dvec3();
    let ray = Ray { direction, t_max: f64::from(disc.t_max) };
    let axes = basis(ray.direction);
    (0..PARTS).map(move |i| {
        let part = toward(&ray, axes, disc.slope, disc_point(i, PARTS, 0.0));
        Beam {
            direction: part.direction.as_vec3().to_array(),
            t_max: part.t_max as f32,
            slope: disc.slope / (PARTS as f32).sqrt(),
            is_coarse: 1,
            ..*disc
        }
    })
}

fn took(answer: &Answer) -> Work {
    Work { steps: answer.steps, rays: 1, far_rays: answer.is_far }
}

/// Whether a cone to a light's disc needs a closer look. The cones of occlusion do not.
fn is_undecided(beam: &Beam, answer: &Answer) -> bool {
    beam.slope > 0.0 && beam.is_coarse == 0 && answer.is_proven == 0
}
