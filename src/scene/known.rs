//! The light at the visible surfaces of a camera: evaluated in the fields, on the CPU or a device, or interpolated from
//! neighbours.
//!
//! Light changes slowly over most of a picture, and its evaluation is the main cost. A picture at half resolution
//! therefore evaluates it at every second pixel of every second row, and a picture with several samples per pixel
//! evaluates it at the centres of the pixels. All other surfaces take the mean of the four evaluated surfaces around
//! them, weighted bilinearly, of those that belong to the same instance, lie in their plane and have a similar normal
//! (joint bilateral upsampling: Kopf et al., SIGGRAPH 2007). Where too few of them match, or where they disagree, as at
//! the edge of a shadow, the light is evaluated.

use super::device_light::light_faces;
use super::gpu::{DeviceScene, WIDE, beam};
use super::light::{Lights, LitSurface};
use super::occlusion::{AO_CONES, AO_SLOPE, Occluders};
use super::primary::{GBuffer, Layer};
use super::renderer::Asked;
use super::shadow::{Casters, LightRay, LightWork, PARTS, SurfacePoint, basis, disc_point, toward};
use super::{RenderOptions, SceneShadows};
use crate::error::{DeviceError, Error};
use crate::gpu::layout::{Answer, Beam};
use crate::progress::Progress;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// One pass of the camera, and the data for its light.
#[derive(Clone, Copy)]
pub struct Pass<'a> {
    pub casters: &'a Casters<'a>,
    pub buffer: &'a GBuffer,
    pub lights: &'a Lights,
    pub options: &'a RenderOptions,
    /// Device of the light pass; None for the CPU.
    pub device: Option<&'a DeviceScene>,
    pub asked: &'a Asked,
    pub progress: &'a Progress,
}

/// Light on one layer.
#[derive(Debug, Clone, Copy)]
pub struct Found<'a> {
    /// Fraction of the ambient light that arrives.
    pub open: f32,
    /// Fraction of each light that arrives.
    pub shares: &'a [f32],
    /// Fraction of each light, RGB, that arrives through the layer's own instance, weighted for the surface; 0 if it
    /// does not scatter.
    pub through: &'a [[f32; 3]],
}

/// [`Found`] for writing.
pub struct FoundMut<'a> {
    pub open: &'a mut f32,
    pub shares: &'a mut [f32],
    pub through: &'a mut [[f32; 3]],
}

/// The light on the layers of a G-buffer.
pub struct Known {
    lights: usize,
    pub(super) rows: Vec<KnownRow>,
}

#[derive(Default)]
pub(super) struct KnownRow {
    pub is_known: Vec<bool>,
    /// For each layer: ambient fraction, one fraction per light, three fractions per light for transmitted light.
    pub values: Vec<f32>,
    pub steps: Vec<u32>,
}

impl Known {
    /// Nothing evaluated yet.
    pub fn new(buffer: &GBuffer, lights: usize) -> Self {
        let row = |layers: &Vec<Layer>| KnownRow {
            is_known: vec![false; layers.len()],
            values: vec![0.0; layers.len() * stride(lights)],
            steps: vec![0; layers.len()],
        };
        Self { lights, rows: buffer.rows.iter().map(row).collect() }
    }

    /// Whether the light of at most one layer in [`FEW`] is missing.
    fn is_almost_complete(&self) -> bool {
        let known = self.rows.iter().flat_map(|row| &row.is_known);
        let [count, missing] = known.fold([0, 0], |[count, missing], known| [count + 1, missing + usize::from(!known)]);
        missing * FEW <= count
    }

    /// Light on layer `i` in row `y`, and the number of steps for it.
    pub fn at(&self, y: usize, i: usize) -> (Found<'_>, u32) {
        let row = &self.rows[y];
        let values = &row.values[i * stride(self.lights)..][..stride(self.lights)];
        let (shares, through) = values[1..].split_at(self.lights);
        (Found { open: values[0], shares, through: through.as_chunks().0 }, row.steps[i])
    }
}

/// See [`Known::is_almost_complete`].
const FEW: usize = 32;

pub fn stride(lights: usize) -> usize {
    1 + 4 * lights
}

pub fn parts_of(values: &mut [f32], lights: usize) -> FoundMut<'_> {
    let (open, rest) = values.split_first_mut().expect("a layer has `stride` values, at least one");
    let (shares, through) = rest.split_at_mut(lights);
    FoundMut { open, shares, through: through.as_chunks_mut().0 }
}

/// Occlusion is evaluated at one of this many pixels along each side. Between these pixels it is interpolated on finer
/// and finer lattices. A pixel is also evaluated if its neighbours on the coarser lattice lie on other surfaces or
/// disagree.
const OCCLUSION_SCALE: u32 = 4;

/// Progress of one call of [`find`], per row of the picture. It is divisible by each possible number of lattices, 1 to
/// 3.
pub const FIND_WORTH: u64 = 6;

/// Whether the occlusion of a first pass is computed separately from the lights, at its own scale.
pub fn shares_occlusion(options: &RenderOptions) -> bool {
    options.occlusion.is_some()
}

/// Find the occlusion of a pass at its scale, then the lights.
fn find_apart(pass: &Pass<'_>) -> Result<Known, Error> {
    let no_lights = Lights { lights: Vec::new() };
    let open = find_at(&Pass { lights: &no_lights, ..*pass }, OCCLUSION_SCALE)?;
    let options = RenderOptions { occlusion: None, ..pass.options.clone() };
    let mut known = find_at(&Pass { options: &options, ..*pass }, options.light_scale)?;
    let stride = stride(known.lights);
    for (row, open) in known.rows.iter_mut().zip(&open.rows) {
        for (i, (&value, steps)) in open.values.iter().zip(&open.steps).enumerate() {
            row.values[i * stride] = value;
            row.steps[i] += steps;
        }
    }
    Ok(known)
}

/// Computes the light of a pass. If a G-buffer with light is given, the light is interpolated from it wherever its
/// values agree.
pub fn find(pass: &Pass<'_>, centre: Option<(&GBuffer, &Known)>) -> Result<Known, Error> {
    let Some((buffer, centre)) = centre else {
        return if shares_occlusion(pass.options) { find_apart(pass) } else { find_at(pass, pass.options.light_scale) };
    };
    let mut known = Known::new(pass.buffer, pass.lights.lights.len());
    gather(pass, &mut known, buffer, centre, [1, 1])?;
    ask(pass, &mut known, &|_, _| true, FIND_WORTH)?;
    Ok(known)
}

/// Evaluates every pixel of a lattice whose pixels are `every` apart. Then the lattice is halved until it is the
/// picture: each step interpolates from the coarser lattice, and evaluates the pixels whose neighbours disagree.
fn find_at(pass: &Pass<'_>, every: u32) -> Result<Known, Error> {
    let mut known = Known::new(pass.buffer, pass.lights.lights.len());
    let worth = FIND_WORTH / u64::from(every.ilog2() + 1);
    let mut every = every;
    if every == 1
        && let Some(device) = pass.device
        && light_faces(pass, device, &mut known)?
        && known.is_almost_complete()
    {
        // Beams for so few surfaces are not worth an upload.
        ask(&Pass { device: None, ..*pass }, &mut known, &|_, _| true, worth)?;
        return Ok(known);
    }
    loop {
        ask(pass, &mut known, &|x, y| x % every == 0 && y % every == 0, worth)?;
        if every == 1 {
            return Ok(known);
        }
        let coarse = std::mem::replace(&mut known, Known::new(pass.buffer, pass.lights.lights.len()));
        gather(pass, &mut known, pass.buffer, &coarse, [every, every / 2])?;
        keep(&mut known, coarse);
        every /= 2;
    }
}

/// Replaces interpolated values by evaluated ones.
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

/// Evaluates the missing light at the requested pixels. Each row counts as the same amount of progress.
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
        let (mut total, mut occluders) = (LightWork::default(), Occluders::default());
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !row.is_known[i] && wanted(layer.x, y as u32) {
                let surface = LitSurface::new(pass.casters.scene, pass.buffer, y, layer);
                let mut found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
                let work = surface.look(pass.casters, pass.lights, pass.options, &mut occluders, &mut found);
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

/// Smallest cosine between normals of surfaces that share their light: 18 degrees.
const SAME_NORMAL: f32 = 0.95;
/// Values that differ by less may be averaged, if they are at most two pixels apart. For four pixels the limit is half
/// as large.
const AGREE: f32 = 0.125;
/// Smallest sum of the bilinear weights of matching neighbours.
const ENOUGH: f32 = 0.5;

/// Interpolates light for the surfaces of the pass from a buffer that has light at every `every`-th pixel. Values are
/// interpolated at every `finer`-th pixel.
fn gather(
    pass: &Pass<'_>,
    known: &mut Known,
    source: &GBuffer,
    asked: &Known,
    [every, finer]: [u32; 2],
) -> Result<(), Error> {
    let lights = known.lights;
    let agree = AGREE * (2.0 / every as f32).min(1.0);
    known.rows.par_iter_mut().enumerate().try_for_each(|(y, row)| {
        let mut neighbours = Vec::with_capacity(4);
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !layer.x.is_multiple_of(finer) || !(y as u32).is_multiple_of(finer) {
                continue;
            }
            let surface = LitSurface::new(pass.casters.scene, pass.buffer, y, layer);
            neighbours.clear();
            fitting(pass, &surface, y, source, asked, every, &mut neighbours);
            let values = &mut row.values[i * stride(lights)..][..stride(lights)];
            row.is_known[i] = mean(&neighbours, agree, values);
            for (light, share) in pass.lights.lights.iter().zip(&mut values[1..]) {
                if let Some(plain) = surface.plain_share(&light.seen_from(surface.place.p).0, pass.options) {
                    *share = plain;
                }
            }
        }
        pass.progress.check()
    })
}

/// The evaluated surfaces around a surface that can share their light with it, and their bilinear weights.
fn fitting<'a>(
    pass: &Pass<'_>,
    surface: &LitSurface<'_>,
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
    // Half the distance between two evaluated pixels on the surface.
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

/// The weighted mean of values; false if there are too few or they differ by more than `agree`.
fn mean(neighbours: &[(&[f32], f32)], agree: f32, values: &mut [f32]) -> bool {
    let total: f32 = neighbours.iter().map(|(_, weight)| weight).sum();
    if total < ENOUGH {
        return false;
    }
    for (i, value) in values.iter_mut().enumerate() {
        let of = |neighbour: &(&[f32], f32)| neighbour.0[i];
        let low = neighbours.iter().map(of).fold(f32::INFINITY, f32::min);
        let high = neighbours.iter().map(of).fold(0.0, f32::max);
        if high - low > agree {
            return false;
        }
        *value = neighbours.iter().map(|(values, weight)| values[i] * weight).sum::<f32>() / total;
    }
    true
}

// ---- devices

/// Approximate number of beams on a device at a time: 64 MiB.
const MOST_BEAMS: usize = 1 << 20;

fn ask_device(
    pass: &Pass<'_>,
    device: &DeviceScene,
    known: &mut Known,
    wanted: &dyn Fn(u32, u32) -> bool,
    worth: u64,
) -> Result<(), Error> {
    // Rows are processed in bunches, since a beam has 64 bytes.
    let rays = if let SceneShadows::Area(count) = pass.options.shadows { count } else { PARTS } as usize;
    let beams_per_layer = pass.lights.lights.len().max(1) * rays + AO_CONES;
    let mut bunch = Vec::new();
    for y in 0..known.rows.len() {
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !known.rows[y].is_known[i] && wanted(layer.x, y as u32) {
                bunch.push((y, i, LitSurface::new(pass.casters.scene, pass.buffer, y, layer)));
            }
        }
        pass.progress.advance(worth)?;
        if bunch.len() * beams_per_layer < MOST_BEAMS && y + 1 < known.rows.len() {
            continue;
        }
        light_bunch(pass, device, known, &mut bunch)?;
    }
    Ok(())
}

/// Computes the light on the surfaces of a bunch on a device: directly, then through their own instances.
fn light_bunch(
    pass: &Pass<'_>,
    device: &DeviceScene,
    known: &mut Known,
    bunch: &mut Vec<(usize, usize, LitSurface<'_>)>,
) -> Result<(), Error> {
    let lights = known.lights;
    let mut answers = DeviceResults::ask(pass, device, bunch)?;
    // Row and layer of each beam from behind.
    let (mut behind, mut owners) = (Vec::new(), Vec::new());
    for (y, i, surface) in bunch.drain(..) {
        let row = &mut known.rows[y];
        let mut found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
        let work = answers.next(pass, &surface, &mut found, &mut behind).ok_or_else(|| too_few(device))?;
        owners.resize(behind.len(), (y, i));
        row.steps[i] = work.steps;
        pass.asked.add(work);
        row.is_known[i] = true;
    }
    let beams = behind.iter().map(|behind| beam(&behind.place, &behind.ray, behind.slope)).collect();
    let past_sheets = past_sheets(pass, &behind, |Behind { place, ray, slope, .. }| {
        let mut work = LightWork::default();
        let shares = pass.casters.scene.light_past_sheets(place, ray, *slope, &mut work);
        (shares, work)
    })?;
    let mut shares = Batch::run(pass, device, beams, past_sheets)?;
    for (Behind { light, left, .. }, (y, i)) in behind.into_iter().zip(owners) {
        let mut work = LightWork::default();
        let visible = shares.next(&mut work).ok_or_else(|| too_few(device))?;
        let row = &mut known.rows[y];
        let found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
        let through = &mut found.through[light];
        *through = (Vec3::from_array(*through) + visible * left).to_array();
        row.steps[i] += work.steps;
        pass.asked.add(work);
    }
    Ok(())
}

fn too_few(device: &DeviceScene) -> DeviceError {
    let reason = "it gave fewer answers than it was asked".into();
    DeviceError::Failed { device: device.context().label(), what: "the scene's light".into(), reason }
}

/// Beams, and the device's results along them, in order.
struct Batch {
    beams: std::iter::Zip<std::vec::IntoIter<Beam>, std::vec::IntoIter<Answer>>,
    /// The narrow cones of discs for which one cone was not sufficient.
    parts: std::vec::IntoIter<Answer>,
    /// Fractions past the sheets, which the CPU evaluates: one for each ray and cone of occlusion, and one for each
    /// part of a disc. Empty in scenes without sheets.
    past_sheets: std::vec::IntoIter<f32>,
}

impl Batch {
    fn run(pass: &Pass<'_>, device: &DeviceScene, beams: Vec<Beam>, past_sheets: Vec<f32>) -> Result<Self, Error> {
        let first = device.shares(pass.casters, &beams, pass.progress)?;
        let undecided = beams.iter().zip(&first).filter(|(beam, answer)| is_undecided(beam, answer));
        let parts: Vec<Beam> = undecided.flat_map(|(beam, _)| parts_of_disc(beam)).collect();
        let second = device.shares(pass.casters, &parts, pass.progress)?;
        Ok(Self {
            beams: beams.into_iter().zip(first),
            parts: second.into_iter(),
            past_sheets: past_sheets.into_iter(),
        })
    }

    /// The fraction of the next beam, and its work; `None` if there are no more results.
    fn next(&mut self, work: &mut LightWork) -> Option<f32> {
        let (beam, answer) = self.beams.next()?;
        *work += took(&answer);
        let count = if is_disc(&beam) { PARTS as usize } else { 1 };
        let mut past_sheets = [1.0; PARTS as usize];
        for (share, found) in past_sheets[..count].iter_mut().zip(self.past_sheets.by_ref()) {
            *share = found;
        }
        if !is_undecided(&beam, &answer) {
            return Some(answer.value * past_sheets[..count].iter().sum::<f32>() / count as f32);
        }
        let mut sum = 0.0;
        for past_sheets in past_sheets {
            let part = self.parts.next()?;
            *work += took(&part);
            sum += part.value * past_sheets;
        }
        Some(sum / PARTS as f32)
    }

    fn mean(&mut self, count: usize, work: &mut LightWork) -> Option<f32> {
        let mut sum = 0.0;
        for _ in 0..count {
            sum += self.next(work)?;
        }
        Some(sum / count as f32)
    }
}

/// The device's results for the surfaces of a bunch.
struct DeviceResults {
    direct: Batch,
    /// Lengths inside the own instance.
    lengths: std::vec::IntoIter<Answer>,
}

impl DeviceResults {
    fn ask(pass: &Pass<'_>, device: &DeviceScene, bunch: &[(usize, usize, LitSurface<'_>)]) -> Result<Self, Error> {
        let (mut beams, mut inside) = (Vec::new(), Vec::new());
        for (_, _, surface) in bunch {
            first_beams(pass, surface, &mut beams, &mut inside);
        }
        let lengths = device.thicknesses(&inside, pass.progress)?;
        let past_sheets = past_sheets(pass, bunch, |(_, _, surface)| {
            pass.casters.scene.sheets_at(surface, pass.lights, pass.options)
        })?;
        Ok(Self { direct: Batch::run(pass, device, beams, past_sheets)?, lengths: lengths.into_iter() })
    }

    /// Results for the next surface, and the work; `None` if there are no more results. Light from behind is the
    /// fraction that remains inside the surface's instance. A ray to each light whose visibility from there is unknown
    /// is appended to `behind`.
    fn next(
        &mut self,
        pass: &Pass<'_>,
        surface: &LitSurface<'_>,
        found: &mut FoundMut<'_>,
        behind: &mut Vec<Behind>,
    ) -> Option<LightWork> {
        let mut work = LightWork::default();
        let scene = pass.casters.scene;
        *found.open = 1.0;
        if let Some(distance) = pass.options.occlusion {
            let (mut sum, mut weights) = (0.0, 0.0);
            for (_, weight) in surface.place.open_rays(distance / scene.scale) {
                sum += weight * self.direct.next(&mut work)?;
                weights += weight;
            }
            *found.open = sum / weights;
        }
        for (i, light) in pass.lights.lights.iter().enumerate() {
            let (ray, slope, _) = light.seen_from(surface.place.p);
            found.shares[i] = match surface.plain_share(&ray, pass.options) {
                Some(share) => share,
                None => match pass.options.shadows {
                    SceneShadows::Area(count) if slope > 0.0 => self.direct.mean(count as usize, &mut work)?,
                    _ => self.direct.next(&mut work)?,
                },
            };
            let mut sum = Vec3::ZERO;
            if surface.scatters(scene) {
                let ways = surface.ways(&ray, slope, pass.options.shadows);
                let share = 1.0 / ways.len() as f32;
                for (way, slope) in ways {
                    let length = match pass.casters.chord(&surface.place, &way) {
                        Some(chord) => chord,
                        None => self.lengths.next()?.value,
                    };
                    let left = share * surface.left(scene, &way, length);
                    match surface.plain_visibility(found.shares[i], left, pass.options) {
                        Some(visible) => sum += visible * left,
                        None => {
                            let slope = if pass.options.shadows == SceneShadows::Soft { slope } else { 0.0 };
                            behind.push(Behind { light: i, left, place: surface.place_behind(), ray: way, slope });
                        }
                    }
                }
            }
            found.through[i] = sum.to_array();
        }
        Some(work)
    }
}

/// A beam from a surface to light behind its own instance.
struct Behind {
    light: usize,
    /// Fraction of the light that remains inside the instance.
    left: Vec3,
    place: SurfacePoint,
    ray: LightRay,
    slope: f32,
}

/// Fractions of all beams of some surfaces past the sheets, in order.
fn past_sheets<T: Sync>(
    pass: &Pass<'_>,
    items: &[T],
    shares: impl Fn(&T) -> (Vec<f32>, LightWork) + Sync,
) -> Result<Vec<f32>, Error> {
    if pass.casters.scene.sheets.is_empty() {
        return Ok(Vec::new());
    }
    let found = items
        .par_iter()
        .map(|item| {
            pass.progress.check()?;
            let (shares, work) = shares(item);
            pass.asked.add(work);
            Ok(shares)
        })
        .collect::<Result<Vec<_>, Error>>()?;
    Ok(found.concat())
}

/// Appends the beams of a surface: first those of occlusion, then for each light one, or all of an area light. The rays
/// whose length inside the own instance is needed are appended to `inside`.
fn first_beams(pass: &Pass<'_>, surface: &LitSurface<'_>, beams: &mut Vec<Beam>, inside: &mut Vec<Beam>) {
    if let Some(distance) = pass.options.occlusion {
        let cones = surface.place.open_rays(distance / pass.casters.scene.scale);
        beams.extend(cones.map(|(ray, _)| Beam { is_coarse: WIDE, ..beam(&surface.place, &ray, AO_SLOPE) }));
    }
    for light in &pass.lights.lights {
        let (ray, slope, _) = light.seen_from(surface.place.p);
        if surface.asks_for(&ray, pass.options) {
            let is_soft = pass.options.shadows == SceneShadows::Soft;
            let ways = surface.ways(&ray, slope, pass.options.shadows);
            beams.extend(ways.iter().map(|(way, slope)| beam(&surface.place, way, if is_soft { *slope } else { 0.0 })));
        }
        if surface.scatters(pass.casters.scene) {
            let ways = surface.ways(&ray, slope, pass.options.shadows);
            let marched = ways.iter().filter(|(way, _)| pass.casters.chord(&surface.place, way).is_none());
            inside.extend(marched.map(|(way, _)| beam(&surface.place, way, 0.0)));
        }
    }
}

/// The narrow cones that divide a light's disc.
fn parts_of_disc(disc: &Beam) -> impl Iterator<Item = Beam> {
    let direction = Vec3::from_array(disc.direction).as_dvec3();
    let ray = LightRay { direction, t_max: f64::from(disc.t_max) };
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

pub fn took(answer: &Answer) -> LightWork {
    LightWork { steps: answer.steps, rays: 1, far_rays: answer.is_far }
}

/// Whether the cone to a light's disc must be divided. The cones of occlusion are never divided.
fn is_undecided(beam: &Beam, answer: &Answer) -> bool {
    is_disc(beam) && answer.is_proven == 0
}

/// Whether a beam is a cone to the whole disc of a light.
fn is_disc(beam: &Beam) -> bool {
    beam.slope > 0.0 && beam.is_coarse == 0
}
