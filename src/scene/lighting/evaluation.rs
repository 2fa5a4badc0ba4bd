//! The light at the visible surfaces of a camera: evaluated in the fields, on the CPU or a device, or interpolated from
//! neighbours.
//!
//! Light changes slowly over most of a picture, and its evaluation is the main cost. A picture at half resolution
//! therefore evaluates it at every second pixel of every second row, and a picture with several samples per pixel
//! evaluates it at the centres of the pixels. Every other surface has the bilinearly weighted mean of the light on the
//! four evaluated surfaces around it that belong to the same instance, lie in its plane and have a similar normal
//! (joint bilateral upsampling: Kopf et al., SIGGRAPH 2007). Where too few of them match, or where they disagree, as at
//! the edge of a shadow, the light is evaluated. Occlusion is smoother than shadows, so it is evaluated on a coarser
//! lattice, and its interpolation regards normals and curvature ([`super::upsampling`]). Indirect light is evaluated at
//! all pixels with few paths, and filtered ([`super::denoise`]).

use super::denoise;
use super::device_beams::evaluate_by_beams;
use super::device_light::light_faces;
use super::light_buffer::{LightBuffer, LightRow, parts_of};
use super::pass::Pass;
use super::tile::{TILE, Tiles};
use super::upsampling::gather;
use crate::error::Error;
use crate::memory::require_for;
use crate::scene::content::options::{RenderOptions, SceneShadows};
use crate::scene::light::bounces::Bounces;
use crate::scene::light::light_rays::LightWork;
use crate::scene::light::lit_surface::{Lights, LitSurface};
use crate::scene::light::occlusion::NearOccluders;
use crate::scene::visibility::gbuffer::GBuffer;
use rayon::prelude::*;

/// Occlusion is evaluated at one of this many pixels along each side. Between these pixels it is interpolated on
/// lattices that are twice as fine from one to the next. A pixel is also evaluated if its neighbours on the coarser
/// lattice lie on other surfaces or disagree, or if another surface is visible near it.
const SMOOTH_SCALE: u32 = 8;

/// Smallest number of evaluated pixels along the shorter side of a picture with occlusion. A wider lattice would miss
/// the occlusion beside an object of a twelfth of a small picture.
const LEAST_OPEN: u32 = 24;

/// Number of pixels along the shorter side of a picture in which each pixel has all paths, if light is filtered. In a
/// larger picture more pixels share their paths.
const ALL_PATHS: u32 = 36;
/// Smallest part of the paths that a pixel has, as its inverse.
const LEAST_PATHS: u32 = 8;

/// Number of paths in each half of the paths of a pixel of a picture with filtered light.
fn half_of_paths(samples: u32, [width, height]: [u32; 2]) -> u32 {
    let side = u64::from(width.min(height).clamp(ALL_PATHS, LEAST_PATHS * ALL_PATHS));
    (u64::from(samples) * u64::from(ALL_PATHS)).div_ceil(2 * side) as u32
}

/// Distance of the evaluated pixels of a picture with occlusion.
fn smooth_scale([width, height]: [u32; 2]) -> u32 {
    let mut every = SMOOTH_SCALE;
    while every > 1 && every * LEAST_OPEN > width.min(height) {
        every /= 2;
    }
    every
}

/// Units of progress that one call of [`find`] counts per row of the picture. The number is divisible by each possible
/// number of lattices, 1 to 4.
pub(crate) const ROW_PROGRESS: u64 = 12;

/// Number of calls of [`find`] and [`find_bounces`], by which a picture of this number of passes counts its progress.
/// `is_lit` tells that [`find`] is not called, because the results of the last picture are reused.
pub(crate) fn find_count(options: &RenderOptions, passes: u32, is_lit: bool) -> u64 {
    // The occlusion of a first pass is computed separately from the lights, at its own scale.
    let direct = if is_lit { 0 } else { u64::from(passes) + u64::from(options.occlusion.is_some()) };
    direct + if options.bounces.is_some() { u64::from(passes) } else { 0 }
}

/// Finds the occlusion of a pass at its scale, then the light that arrives from the lights.
fn find_apart(pass: &Pass<'_>) -> Result<LightBuffer, Error> {
    let no_lights = Lights { lights: Vec::new() };
    let open = find_at(&Pass { lights: &no_lights, ..*pass }, smooth_scale(pass.options.size))?;
    let options = RenderOptions { occlusion: None, ..pass.options.clone() };
    let mut evaluated = find_at(&Pass { options: &options, ..*pass }, options.light_scale)?;
    let stride = evaluated.stride;
    for (row, open) in evaluated.rows.iter_mut().zip(&open.rows) {
        for (i, (&value, &work)) in open.values.iter().zip(&open.work).enumerate() {
            row.values[i * stride] = value;
            row.work[i] += work;
        }
    }
    Ok(evaluated)
}

/// Computes the light of a pass. If a G-buffer with light is given, the light is interpolated from it wherever its
/// values agree.
pub(crate) fn find(pass: &Pass<'_>, centre: Option<(&GBuffer, &LightBuffer)>) -> Result<LightBuffer, Error> {
    match centre {
        Some((buffer, centre)) => find_between(pass, buffer, centre),
        None if pass.options.occlusion.is_some() => find_apart(pass),
        None => find_at(pass, pass.options.light_scale),
    }
}

/// Computes the indirect light of a pass, as [`find`] does for the lights.
pub(crate) fn find_bounces(
    pass: &Pass<'_>,
    bounces: &Bounces<'_>,
    centre: Option<(&GBuffer, &LightBuffer)>,
) -> Result<LightBuffer, Error> {
    let no_lights = Lights { lights: Vec::new() };
    let pass = Pass { lights: &no_lights, bounces: Some(bounces), device: None, ..*pass };
    if let Some((buffer, centre)) = centre {
        return find_between(&pass, buffer, centre);
    }
    let mut light = unevaluated(&pass);
    if !pass.options.denoise {
        evaluate(&pass, &mut light, &|_, _| true, ROW_PROGRESS)?;
        return Ok(light);
    }
    let layers: usize = pass.buffer.rows.iter().map(Vec::len).sum();
    let bytes = (layers * denoise::LAYER_BYTES) as u64;
    require_for("the filter of sampled light", bytes, bytes, "draw fewer pixels, or use denoise=False")?;
    let paths = half_of_paths(bounces.samples(), pass.options.size);
    let halves = light.rows.par_iter_mut().enumerate().map(|(y, row)| {
        let mut total = LightWork::default();
        let layers = pass.buffer.rows[y].iter().zip(&mut row.work);
        let halves = layers.map(|(layer, work)| {
            pass.progress.check()?;
            let surface = LitSurface::new(pass.traced.scene, pass.buffer, y, layer);
            let halves = bounces.parts_on(&surface.place, [layer.x, y as u32], paths, work);
            total += *work;
            Ok(halves)
        });
        let halves = halves.collect::<Result<Vec<_>, Error>>()?;
        pass.counters.add(total);
        pass.progress.advance(ROW_PROGRESS)?;
        Ok(halves)
    });
    let filtered = denoise::filter(pass.buffer, halves.collect::<Result<Vec<_>, Error>>()?, pass.progress)?;
    for (row, filtered) in light.rows.iter_mut().zip(filtered) {
        row.values = filtered.into_iter().flat_map(|value| value.to_array()).collect();
        row.is_evaluated.fill(true);
    }
    Ok(light)
}

/// Interpolates light from a G-buffer at the centres of the pixels, and evaluates the rest.
fn find_between(pass: &Pass<'_>, buffer: &GBuffer, centre: &LightBuffer) -> Result<LightBuffer, Error> {
    let mut evaluated = unevaluated(pass);
    gather(pass, &mut evaluated, buffer, centre, [1, 1])?;
    evaluate(pass, &mut evaluated, &|_, _| true, ROW_PROGRESS)?;
    Ok(evaluated)
}

/// A buffer for the light of a pass.
fn unevaluated(pass: &Pass<'_>) -> LightBuffer {
    LightBuffer::new(pass.buffer, pass.bounces.is_none().then_some(pass.lights.lights.len()))
}

/// Evaluates every pixel of a lattice whose pixels are `every` apart. Then the lattice is halved until it is the
/// picture: each step interpolates from the coarser lattice, and evaluates the pixels whose neighbours disagree.
fn find_at(pass: &Pass<'_>, every: u32) -> Result<LightBuffer, Error> {
    let mut evaluated = unevaluated(pass);
    let row_progress = ROW_PROGRESS / u64::from(every.ilog2() + 1);
    let mut every = every;
    if every == 1
        && let Some(device) = pass.device
        && light_faces(pass, device, &mut evaluated)?
        && evaluated.is_almost_complete()
    {
        // For so few surfaces the upload of the beams costs more than their evaluation on the CPU.
        evaluate(&Pass { device: None, ..*pass }, &mut evaluated, &|_, _| true, row_progress)?;
        return Ok(evaluated);
    }
    loop {
        evaluate(pass, &mut evaluated, &|x, y| x % every == 0 && y % every == 0, row_progress)?;
        if every == 1 {
            return Ok(evaluated);
        }
        let coarse = std::mem::replace(&mut evaluated, unevaluated(pass));
        gather(pass, &mut evaluated, pass.buffer, &coarse, [every, every / 2])?;
        evaluated.keep(coarse);
        every /= 2;
    }
}

/// Evaluates the missing light at the requested pixels. Each row counts as the same amount of progress.
fn evaluate(
    pass: &Pass<'_>,
    evaluated: &mut LightBuffer,
    is_requested: &(dyn Fn(u32, u32) -> bool + Sync),
    row_progress: u64,
) -> Result<(), Error> {
    if let Some(device) = pass.device {
        return evaluate_by_beams(pass, device, evaluated, is_requested, row_progress);
    }
    let (lights, stride) = (evaluated.lights, evaluated.stride);
    let is_shared = Tiles::are_useful(pass);
    evaluated.rows.par_chunks_mut(TILE).enumerate().try_for_each(|(band, rows)| {
        let first = band * TILE;
        let mut tiles = Tiles::new(pass, [first as u32, (first + rows.len() - 1) as u32]);
        let lines = || first..first + TILE;
        if is_shared {
            for (y, row) in lines().zip(&*rows) {
                let layers = pass.buffer.rows[y].iter().zip(&row.is_evaluated).enumerate();
                layers
                    .filter(|(_, (layer, evaluated))| !**evaluated && is_requested(layer.x, y as u32))
                    .for_each(|(i, (layer, _))| tiles.add([y - first, i], layer));
            }
            if pass.options.shadows == SceneShadows::Hard && pass.options.occlusion.is_none() {
                tiles.evaluate_hard(rows, [lights, stride]);
            }
        }
        for (y, row) in lines().zip(rows) {
            evaluate_row(pass, &mut tiles, (y, row), is_requested, [lights, stride])?;
            pass.progress.advance(row_progress)?;
        }
        Ok(())
    })
}

/// Evaluates the missing light at the requested pixels of row `y`.
fn evaluate_row(
    pass: &Pass<'_>,
    tiles: &mut Tiles<'_>,
    (y, row): (usize, &mut LightRow),
    is_requested: &(dyn Fn(u32, u32) -> bool + Sync),
    [lights, stride]: [usize; 2],
) -> Result<(), Error> {
    let (mut total, mut occluders) = (LightWork::default(), NearOccluders::default());
    for (i, layer) in pass.buffer.rows[y].iter().enumerate() {
        if !row.is_evaluated[i] && is_requested(layer.x, y as u32) {
            let surface = LitSurface::new(pass.traced.scene, pass.buffer, y, layer);
            let values = &mut row.values[i * stride..][..stride];
            let work = match pass.bounces {
                Some(bounces) => {
                    let mut work = LightWork::default();
                    // Neighbours with another material interpolate the light of surfaces without lighting too.
                    let found = bounces.light_on(&surface.place, [layer.x, y as u32], &mut work);
                    values.copy_from_slice(&found.to_array());
                    pass.progress.check()?;
                    work
                }
                None => {
                    let (mut found, near) = (parts_of(values, lights), tiles.occluders(layer));
                    surface.evaluate(pass.traced, near, pass.lights, pass.options, &mut occluders, &mut found)
                }
            };
            row.work[i] = work;
            total += work;
            row.is_evaluated[i] = true;
        }
    }
    pass.counters.add(total);
    Ok(())
}
