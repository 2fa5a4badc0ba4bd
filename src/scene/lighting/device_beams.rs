//! Light evaluated on a device by beams that the CPU makes.

use super::light_buffer::{LightBuffer, parts_of, stride};
use super::pass::Pass;
use crate::error::{DeviceError, Error};
use crate::gpu::layout::{Beam, BeamResult};
use crate::scene::content::options::SceneShadows;
use crate::scene::device::device_scene::{DeviceScene, beam, work_of};
use crate::scene::light::light_rays::{LightRay, LightWork, PARTS, SurfacePoint, basis, disc_point, toward};
use crate::scene::light::lit_surface::{LightSampleMut, LitSurface};
use crate::scene::light::occlusion::{NearOccluders, RAYS};
use glam::Vec3;
use rayon::prelude::*;

/// Approximate number of beams on a device at a time: 64 MiB.
const MOST_BEAMS: usize = 1 << 20;

/// Evaluates the missing light at the requested pixels on a device.
pub(crate) fn evaluate_by_beams(
    pass: &Pass<'_>,
    device: &DeviceScene,
    evaluated: &mut LightBuffer,
    is_requested: &dyn Fn(u32, u32) -> bool,
    row_progress: u64,
) -> Result<(), Error> {
    // Rows are processed in bunches that fit into the memory for beams. A beam has 64 bytes.
    let rays = if let SceneShadows::Area(count) = pass.options.shadows { count } else { PARTS } as usize;
    let open_rays = if has_open_beams(pass) { RAYS } else { 0 };
    let beams_per_layer = pass.lights.lights.len().max(1) * rays + open_rays;
    let mut bunch = Vec::new();
    for y in 0..evaluated.rows.len() {
        for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
            if !evaluated.rows[y].is_evaluated[i] && is_requested(layer.x, y as u32) {
                bunch.push((y, i, LitSurface::new(pass.traced.scene, pass.buffer, y, layer)));
            }
        }
        pass.progress.advance(row_progress)?;
        if bunch.len() * beams_per_layer < MOST_BEAMS && y + 1 < evaluated.rows.len() {
            continue;
        }
        light_bunch(pass, device, evaluated, &mut bunch)?;
    }
    Ok(())
}

/// Computes the light on the surfaces of a bunch on a device: directly, then through their own instances.
fn light_bunch(
    pass: &Pass<'_>,
    device: &DeviceScene,
    evaluated: &mut LightBuffer,
    bunch: &mut Vec<(usize, usize, LitSurface<'_>)>,
) -> Result<(), Error> {
    let lights = evaluated.lights;
    let mut beam_results = DeviceResults::evaluate(pass, device, bunch)?;
    // `behind` has the beams from behind; `owners` has the row and the layer of each.
    let (mut behind, mut owners) = (Vec::new(), Vec::new());
    for (y, i, surface) in bunch.drain(..) {
        let row = &mut evaluated.rows[y];
        let mut found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
        let work = beam_results.next(pass, &surface, &mut found, &mut behind).ok_or_else(|| too_few(device))?;
        owners.resize(behind.len(), (y, i));
        row.work[i] = work;
        pass.counters.add(work);
        row.is_evaluated[i] = true;
    }
    let beams = behind.iter().map(|behind| beam(&behind.place, &behind.ray, behind.slope)).collect();
    let (past_faces, works) = past_faces(pass, &behind, |Behind { place, ray, slope, .. }, _| {
        let mut work = LightWork::default();
        let shares = pass.traced.light_past_faces(place, ray, *slope, &mut work);
        (shares, work)
    })?;
    let mut shares = Batch::run(pass, device, beams, past_faces)?;
    let mut works = works.into_iter();
    for (Behind { light, transmitted, .. }, (y, i)) in behind.into_iter().zip(owners) {
        let mut work = works.next().unwrap_or_default();
        let visible = shares.next(&mut work).ok_or_else(|| too_few(device))?;
        let row = &mut evaluated.rows[y];
        let found = parts_of(&mut row.values[i * stride(lights)..][..stride(lights)], lights);
        let through = &mut found.through[light];
        *through = (Vec3::from_array(*through) + visible * transmitted).to_array();
        row.work[i] += work;
        pass.counters.add(work);
    }
    Ok(())
}

fn too_few(device: &DeviceScene) -> DeviceError {
    let reason = "it returned fewer results than it received rays".into();
    DeviceError::Failed { device: device.context().label(), what: "the scene's light".into(), reason }
}

/// Beams, and the device's results along them, in order.
struct Batch {
    beams: std::iter::Zip<std::vec::IntoIter<Beam>, std::vec::IntoIter<BeamResult>>,
    /// The narrow cones of discs for which one cone was not sufficient.
    parts: std::vec::IntoIter<BeamResult>,
    /// Fractions past triangles, which the CPU traces: one for each ray, and one for each part of a disc. Empty if no
    /// triangles block the light.
    past_faces: std::vec::IntoIter<f32>,
}

impl Batch {
    fn run(pass: &Pass<'_>, device: &DeviceScene, beams: Vec<Beam>, past_faces: Vec<f32>) -> Result<Self, Error> {
        let first = device.shares(pass.traced, &beams, pass.progress)?;
        let undecided = beams.iter().zip(&first).filter(|(beam, beam_result)| is_undecided(beam, beam_result));
        let parts: Vec<Beam> = undecided.flat_map(|(beam, _)| parts_of_disc(beam)).collect();
        let second = device.shares(pass.traced, &parts, pass.progress)?;
        Ok(Self { beams: beams.into_iter().zip(first), parts: second.into_iter(), past_faces: past_faces.into_iter() })
    }

    /// The fraction of the next beam, and its work; `None` if there are no more results.
    fn next(&mut self, work: &mut LightWork) -> Option<f32> {
        let (beam, beam_result) = self.beams.next()?;
        let count = if is_disc(&beam) { PARTS as usize } else { 1 };
        let mut past_faces = [1.0; PARTS as usize];
        for (share, found) in past_faces[..count].iter_mut().zip(self.past_faces.by_ref()) {
            *share = found;
        }
        let own_work = work_of(&beam_result);
        // Triangles block the light before the far field.
        let is_blocked = past_faces[..count].iter().all(|share| *share <= 0.0);
        *work += LightWork { far_rays: if is_blocked { 0 } else { own_work.far_rays }, ..own_work };
        if !is_undecided(&beam, &beam_result) {
            return Some(beam_result.value * past_faces[..count].iter().sum::<f32>() / count as f32);
        }
        let mut sum = 0.0;
        for past_faces in past_faces {
            let part = self.parts.next()?;
            *work += work_of(&part);
            sum += part.value * past_faces;
        }
        Some(sum / PARTS as f32)
    }
}

/// The device's results for the surfaces of a bunch.
struct DeviceResults {
    direct: Batch,
    /// Lengths inside the own instance.
    lengths: std::vec::IntoIter<BeamResult>,
    /// The work of the CPU for each surface. Empty if no triangles block the light.
    works: std::vec::IntoIter<LightWork>,
}

impl DeviceResults {
    fn evaluate(
        pass: &Pass<'_>,
        device: &DeviceScene,
        bunch: &[(usize, usize, LitSurface<'_>)],
    ) -> Result<Self, Error> {
        let (mut beams, mut inside) = (Vec::new(), Vec::new());
        for (_, _, surface) in bunch {
            first_beams(pass, surface, &mut beams, &mut inside);
        }
        let lengths = device.thicknesses(&inside, pass.progress)?;
        let (past_faces, works) = past_faces(pass, bunch, |(_, _, surface), near| {
            pass.traced.faces_at(surface, pass.lights, pass.options, near)
        })?;
        let direct = Batch::run(pass, device, beams, past_faces)?;
        Ok(Self { direct, lengths: lengths.into_iter(), works: works.into_iter() })
    }

    /// Stores the results for the next surface in `found` and returns their work; `None` if there are no more results.
    /// A beam to each light whose visibility behind the surface's own instance is unknown is appended to `behind`.
    fn next(
        &mut self,
        pass: &Pass<'_>,
        surface: &LitSurface<'_>,
        found: &mut LightSampleMut<'_>,
        behind: &mut Vec<Behind>,
    ) -> Option<LightWork> {
        let mut work = self.works.next().unwrap_or_default();
        let scene = pass.traced.scene;
        *found.open = 1.0;
        if pass.options.occlusion.is_some() {
            let (mut sum, has_beams) = (0.0, has_open_beams(pass));
            for _ in 0..RAYS {
                sum += if has_beams {
                    self.direct.next(&mut work)?
                } else {
                    work.count(false);
                    self.direct.past_faces.next().unwrap_or(1.0)
                };
            }
            *found.open = sum / RAYS as f32;
        }
        for (i, light) in pass.lights.lights.iter().enumerate() {
            let (ray, slope, _) = light.seen_from(surface.place.p);
            found.shares[i] = match surface.plain_share(&ray, pass.options) {
                Some(share) => share,
                None => match pass.options.shadows {
                    SceneShadows::Area(_) if slope > 0.0 => {
                        let paths = surface.paths(&ray, slope, pass.options.shadows);
                        let mut sum = 0.0;
                        for (path, _) in &paths {
                            let share = self.direct.next(&mut work)?;
                            sum += if surface.place.is_above_horizon(path) { share } else { 0.0 };
                        }
                        sum / paths.len() as f32
                    }
                    _ => surface.above_horizon(self.direct.next(&mut work)?, &ray, slope, pass.options),
                },
            };
            let mut sum = Vec3::ZERO;
            if surface.scatters(scene) {
                let paths = surface.paths(&ray, slope, pass.options.shadows);
                let share = 1.0 / paths.len() as f32;
                for (path, slope) in paths {
                    let length = match pass.traced.chord(&surface.place, &path) {
                        Some(chord) => chord,
                        None => self.lengths.next()?.value,
                    };
                    let transmitted = share * surface.transmitted(scene, &path, length);
                    match surface.plain_visibility(found.shares[i], transmitted, pass.options) {
                        Some(visible) => sum += visible * transmitted,
                        None => {
                            let slope = if pass.options.shadows == SceneShadows::Soft { slope } else { 0.0 };
                            behind.push(Behind {
                                light: i,
                                transmitted,
                                place: surface.place_behind(),
                                ray: path,
                                slope,
                            });
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
    transmitted: Vec3,
    place: SurfacePoint,
    ray: LightRay,
    slope: f32,
}

/// Fractions of all beams of some surfaces past triangles, in order, and the work for each surface.
fn past_faces<T: Sync>(
    pass: &Pass<'_>,
    items: &[T],
    shares: impl Fn(&T, &mut NearOccluders) -> (Vec<f32>, LightWork) + Sync,
) -> Result<(Vec<f32>, Vec<LightWork>), Error> {
    if !pass.traced.needs_faces(pass.lights, pass.options) {
        return Ok(Default::default());
    }
    let found = items
        .par_iter()
        .map_init(NearOccluders::default, |near, item| {
            pass.progress.check()?;
            Ok(shares(item, near))
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let (found, works): (Vec<_>, Vec<_>) = found.into_iter().unzip();
    Ok((found.concat(), works))
}

/// Whether the device traces rays of occlusion: fields may block them. The CPU traces the triangles.
fn has_open_beams(pass: &Pass<'_>) -> bool {
    pass.options.occlusion.is_some() && (pass.traced.scene.has_fields || pass.traced.far.is_some())
}

/// Appends the beams of a surface: first the rays of occlusion, then for each light one beam, or all rays of an area
/// light. The rays whose length inside the own instance is needed are appended to `inside`.
fn first_beams(pass: &Pass<'_>, surface: &LitSurface<'_>, beams: &mut Vec<Beam>, inside: &mut Vec<Beam>) {
    if let Some(distance) = pass.options.occlusion.filter(|_| has_open_beams(pass)) {
        let hemisphere = surface.hemisphere(distance / pass.traced.scene.scale);
        beams.extend(hemisphere.rays().map(|ray| beam(&hemisphere.place, &ray, 0.0)));
    }
    for light in &pass.lights.lights {
        let (ray, slope, _) = light.seen_from(surface.place.p);
        if surface.needs_rays(&ray, pass.options) {
            let is_soft = pass.options.shadows == SceneShadows::Soft;
            let paths = surface.paths(&ray, slope, pass.options.shadows);
            beams.extend(
                paths.iter().map(|(path, slope)| beam(&surface.place, path, if is_soft { *slope } else { 0.0 })),
            );
        }
        if surface.scatters(pass.traced.scene) {
            let paths = surface.paths(&ray, slope, pass.options.shadows);
            let marched = paths.iter().filter(|(path, _)| pass.traced.chord(&surface.place, path).is_none());
            inside.extend(marched.map(|(path, _)| beam(&surface.place, path, 0.0)));
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

/// Whether the cone to a light's disc must be divided.
fn is_undecided(beam: &Beam, beam_result: &BeamResult) -> bool {
    is_disc(beam) && beam_result.is_proven == 0
}

/// Whether a beam is a cone to the whole disc of a light.
fn is_disc(beam: &Beam) -> bool {
    beam.slope > 0.0 && beam.is_coarse == 0
}
