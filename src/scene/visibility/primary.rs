//! The primary pass: the visible surfaces of each pixel.
//!
//! Rays intersect triangles through the mesh's own tree, without gaps and at pixel centres. A rasteriser
//! ([`super::rasterizer`]) selects the visible face of most pixels without a search. Fields are traced exactly. A
//! search tests only instances whose box the ray enters and uses the nearest hit: mixed scenes are combined by depth.
//!
//! A pixel has a list of layers: the first opaque surface, and the translucent surfaces in front of it.

use super::gbuffer::{GBuffer, Layer, Pixels, View};
use super::pixel_ray::draw_row;
use super::rasterizer::{BAND_ROWS, Rasterizer};
use crate::error::Error;
use crate::picture::Camera;
use crate::progress::Progress;
use crate::scene::content::model::Scene;
use crate::scene::content::options::RenderOptions;
use rayon::prelude::*;

/// Finds the visible surfaces of each pixel, or of the `chosen` ones alone, through the point `offset` of the pixel;
/// (1/2, 1/2) is its centre.
pub(crate) fn draw(
    scene: &Scene,
    camera: &Camera,
    options: &RenderOptions,
    offset: [f64; 2],
    chosen: Option<&Pixels>,
    progress: &Progress,
) -> Result<GBuffer, Error> {
    let view = View { camera: *camera, size: options.size, offset };
    if let Some(chosen) = chosen {
        return trace(scene, options, view, chosen, progress);
    }
    let rasterizer = Rasterizer::new(scene, options, &view, progress)?;
    let [width, height] = options.size;
    let bands = (0..height.div_ceil(BAND_ROWS)).into_par_iter();
    let pairs: Vec<Vec<(Vec<Layer>, Vec<u32>)>> = bands
        .map(|band| {
            let rows = band * BAND_ROWS..((band + 1) * BAND_ROWS).min(height);
            let visible = rasterizer.band(rows.clone());
            rows.zip(visible.chunks_exact(width as usize))
                .map(|(y, visible)| {
                    let searched = rasterizer.searched(y);
                    let row = draw_row(scene, options, &view, y, |ray, layers| {
                        let x = ray.x as usize;
                        rasterizer.resolve(ray, &visible[x], searched[x], layers);
                    });
                    progress.advance(1)?;
                    Ok(row)
                })
                .collect()
        })
        .collect::<Result<_, Error>>()?;
    let (rows, steps) = pairs.into_iter().flatten().unzip();
    Ok(GBuffer { rows, steps, view, visible: None })
}

/// Finds the visible surfaces of some pixels by rays alone.
fn trace(
    scene: &Scene,
    options: &RenderOptions,
    view: View,
    chosen: &Pixels,
    progress: &Progress,
) -> Result<GBuffer, Error> {
    let pairs: Vec<(Vec<Layer>, Vec<u32>)> = (0..view.size[1])
        .into_par_iter()
        .map(|y| {
            let row = draw_row(scene, options, &view, y, |ray, layers| {
                if chosen.contains(ray.x, y) {
                    ray.trace(layers, None);
                }
            });
            progress.advance(1)?;
            Ok(row)
        })
        .collect::<Result<_, Error>>()?;
    let (rows, steps) = pairs.into_iter().unzip();
    Ok(GBuffer { rows, steps, view, visible: None })
}
