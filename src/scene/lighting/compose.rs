//! The light pass: the reflection of light over the G-buffer, with shadow, occlusion and scattering from the fields.
//!
//! # Theory
//!
//! ```text
//!   color = emission + ambient * open * albedo
//!         + sum over lights of  arrives * light * (max(0, n.l) * albedo + specular * max(0, n.h)^shininess)
//!         + sum over lights of  through * light * albedo * (1 - max(0, n.l))^2
//! ```
//!
//! The second term is the reflection of a surface ([`crate::picture::LitPoint`]). `ambient` is the light from
//! everywhere on the normal ([`crate::scene::content::options`]). `arrives` is the visible fraction of the light
//! ([`crate::scene::light::shadow`]), 0 on a side that faces away. `open` is the fraction of rays over the
//! hemisphere that pass all occluders ([`crate::scene::light::occlusion`]). The density of the rays is the cosine, and
//! occluders beyond a given distance do not count.
//! Indirect light ([`crate::scene::light::bounces`]) replaces `ambient * open`. `through` is the fraction of the light
//! that arrives through the instance itself ([`crate::scene::light::transmission`]). A side that faces away receives
//! all of it. On the lit side its weight falls with the cosine, so the picture is continuous where the cosine is 0, and
//! no surface emits more light than arrives.

use super::light_buffer::{LightBuffer, LightSample};
use super::pass::Pass;
use crate::error::Error;
use crate::memory::zeroed_rows;
use crate::picture::{Frame, LitPoint};
use crate::scene::content::model::Scene;
use crate::scene::content::options::RenderOptions;
use crate::scene::light::light_rays::LightWork;
use crate::scene::light::lit_surface::{Lights, LitSurface};
use crate::scene::visibility::gbuffer::{Layer, Pixels};
use glam::{Vec3, Vec4};
use rayon::prelude::*;

/// The surfaces of a pass, and the light on them.
#[derive(Clone, Copy)]
pub(crate) struct LitPass<'a> {
    pub pass: &'a Pass<'a>,
    pub direct: &'a LightBuffer,
    pub indirect: Option<&'a LightBuffer>,
}

/// A shaded layer of a pixel.
struct ShadedLayer<'a> {
    layer: &'a Layer,
    /// Fraction of each light that arrives.
    shares: &'a [f32],
    work: LightWork,
}

impl LitPass<'_> {
    /// Shades the layers with the light on them, and composes them over the background. Returns the picture, whose
    /// colours are multiplied by their opacity, and the number of rays and cones of the light in each pixel.
    pub(crate) fn compose(&self) -> Result<(Frame, Vec<u32>), Error> {
        let &Pass { traced, buffer, lights, options, progress, .. } = self.pass;
        let scene = traced.scene;
        let [width, height] = options.size.map(|n| n as usize);
        let mut frame = Frame::new(width, height, lights.lights.len())?;
        let mut rays = zeroed_rows("pixels", width * height)?;
        frame.rows().into_par_iter().zip(rays.par_chunks_mut(width)).enumerate().try_for_each(|(y, (row, rays))| {
            row.steps.copy_from_slice(&buffer.steps[y]);
            let mut next = 0;
            for x in 0..width {
                let mut is_first = true;
                let color = self.color(x, y, &mut next, |shaded| {
                    row.steps[x] += shaded.work.steps;
                    rays[x] += shaded.work.rays;
                    // The pixel belongs to the first surface that covers at least half of the background.
                    let layer = shaded.layer;
                    if is_first && layer.color.w >= 0.5 {
                        is_first = false;
                        row.depth[x] = layer.depth as f32;
                        row.normal[3 * x..][..3].copy_from_slice(&layer.normal.to_array());
                        row.object_id[x] = scene.instances[layer.instance as usize].object as i32;
                        row.shadow[x * row.lights..][..row.lights].copy_from_slice(shaded.shares);
                    }
                });
                row.color[4 * x..][..4].copy_from_slice(&color.to_array());
            }
            progress.advance(1)
        })?;
        Ok((frame, rays))
    }

    /// The colours of some pixels, as [`Self::compose`] has them, by rows from the top.
    pub(crate) fn colors(&self, chosen: &Pixels) -> Result<Vec<Vec4>, Error> {
        let &Pass { options, progress, .. } = self.pass;
        let rows = (0..options.size[1]).into_par_iter().map(|y| {
            let mut next = 0;
            let columns = (0..options.size[0]).filter(|&x| chosen.contains(x, y));
            let colors: Vec<Vec4> = columns.map(|x| self.color(x as usize, y as usize, &mut next, |_| {})).collect();
            progress.advance(1)?;
            Ok(colors)
        });
        Ok(rows.collect::<Result<Vec<_>, Error>>()?.concat())
    }

    /// The colour of a pixel, linear RGB times opacity and opacity. Its layers begin at `next` of the row, and `shaded`
    /// receives each of them.
    fn color(&self, x: usize, y: usize, next: &mut usize, mut shaded: impl FnMut(ShadedLayer<'_>)) -> Vec4 {
        let &Pass { traced, buffer, lights, options, .. } = self.pass;
        let scene = traced.scene;
        let mut color = Vec4::ZERO;
        let mut passes = 1.0;
        while let Some(layer) = buffer.rows[y].get(*next).filter(|layer| layer.x as usize == x) {
            let surface = LitSurface::new(scene, buffer, y, layer);
            let (found, mut work) = self.direct.at(y, *next);
            let arrives = match self.indirect.map(|indirect| indirect.values_at(y, *next)) {
                Some((values, indirect)) => {
                    work += indirect;
                    Vec3::from_slice(values)
                }
                None => options.ambient.on(layer.normal) * found.open,
            };
            let light = surface.shade(scene, lights, arrives, &found);
            color += passes * layer.color.w * light.extend(1.0);
            passes *= 1.0 - layer.color.w;
            shaded(ShadedLayer { layer, shares: found.shares, work });
            *next += 1;
        }
        let background = Vec4::from_array(options.background);
        color += passes * background.w * background.truncate().extend(1.0);
        (color.truncate() * options.exposure).extend(color.w)
    }
}

/// Divides the colours of pixels by their opacity. Transparent pixels have the colour of the background.
pub(crate) fn divide_by_opacity(colors: &mut [f32], options: &RenderOptions) {
    let background = Vec4::from_array(options.background).truncate() * options.exposure;
    for pixel in colors.as_chunks_mut::<4>().0 {
        let [r, g, b, opacity] = *pixel;
        let rgb = if opacity > 0.0 { Vec3::new(r, g, b) / opacity } else { background };
        *pixel = rgb.extend(opacity).to_array();
    }
}

impl LitSurface<'_> {
    /// Linear RGB of the lit surface. `ambient` is the reflection, by a white surface, of all light that does not come
    /// from the lights.
    fn shade(&self, scene: &Scene, lights: &Lights, ambient: Vec3, found: &LightSample<'_>) -> Vec3 {
        let material = &scene.materials[self.layer.material as usize];
        let albedo = self.layer.color.truncate();
        if material.unlit {
            return self.layer.emission + albedo;
        }
        let mut color = self.layer.emission + ambient * albedo;
        let point = LitPoint {
            normal: self.layer.normal,
            to_eye: self.to_eye(),
            color: albedo,
            specular: material.specular,
            shininess: material.shininess,
        };
        for ((light, &share), &through) in lights.lights.iter().zip(found.shares).zip(found.through) {
            let (ray, _, light_color) = light.seen_from(self.place.p);
            if share > 0.0 {
                color += share * light_color * point.reflected(ray.direction.as_vec3());
            }
            color += light_color * albedo * Vec3::from_array(through);
        }
        color
    }
}
