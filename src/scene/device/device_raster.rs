//! The primary pass on a graphics device: triangles and the boxes of fields are rasterised into one depth buffer.
//!
//! The device decides only *which* surface each pixel shows: the instance, and its face or the depth of its field. The
//! code of the CPU's pass ([`crate::scene::visibility::primary`]) computes position, normal and colour from it in
//! float64, so both passes give the same picture where they find the same surface. The rasteriser snaps corners to
//! 1/256 of a pixel. If the exact ray of a pixel misses the chosen face, the CPU draws the pixel.
//!
//! A device draws opaque surfaces of the kinds that it supports. The CPU searches for translucent surfaces in front of
//! them; both are combined by depth.

use super::device_scene::DeviceScene;
use crate::error::Error;
use crate::geometry::Aabb;
use crate::gpu::layout::RasterInstance;
use crate::gpu::pipeline::{AnyPipeline, whole};
use crate::gpu::raster::Draw;
use crate::picture::Camera;
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::material::Material;
use crate::scene::content::model::Scene;
use crate::scene::content::options::{Primary, RenderOptions};
use crate::scene::visibility::gbuffer::{DeviceVisibility, GBuffer, Layer, Pixels, View};
use crate::scene::visibility::pixel_ray::{PixelRay, as_triangles, draw_row, is_opaque};
use glam::{DAffine3, DMat3, DVec3};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::PoisonError;

/// For each instance, whether the CPU must still draw it or some of its faces; None if the device draws all visible
/// ones.
pub(crate) fn drawn_on_cpu(scene: &Scene, device: &DeviceScene, options: &RenderOptions) -> Option<Vec<bool>> {
    let needs_cpu = |(i, instance): (usize, &Instance)| {
        instance.visible
            && (!is_drawn(instance, device.has_field(i), &scene.materials, options.primary)
                || as_triangles(instance, options.primary)
                    && instance.own_materials(&scene.materials).iter().any(|m| !is_opaque(instance, m)))
    };
    let on_cpu: Vec<bool> = scene.instances.iter().enumerate().map(needs_cpu).collect();
    on_cpu.contains(&true).then_some(on_cpu)
}

/// Whether a device draws an instance, or at least its opaque faces.
fn is_drawn(instance: &Instance, is_evaluated: bool, materials: &[Material], primary: Primary) -> bool {
    if as_triangles(instance, primary) {
        instance.opacity >= 1.0 && !instance.has_colored_mask
    } else {
        is_evaluated && instance.field.is_some() && is_opaque(instance, &materials[instance.first_material as usize])
    }
}

/// Number of pixels that are drawn at a time, as whole rows: 64 MiB.
const BAND_PIXELS: u32 = 1 << 22;

/// The counterpart of [`crate::scene::visibility::primary::draw`] on a device.
pub(crate) fn draw(
    scene: &Scene,
    device: &DeviceScene,
    camera: &Camera,
    options: &RenderOptions,
    offset: [f64; 2],
    chosen: Option<&Pixels>,
    progress: &Progress,
) -> Result<GBuffer, Error> {
    let view = View { camera: *camera, size: options.size, offset };
    let on_cpu = drawn_on_cpu(scene, device, options);
    let [width, height] = options.size;
    let band = (BAND_PIXELS / width).clamp(1, height);
    let mut buffer = GBuffer { rows: Vec::new(), steps: Vec::new(), view, visible: None };
    for first in (0..height).step_by(band as usize) {
        let count = band.min(height - first);
        let (visible, on_device) = visible_on_device(scene, device, &view, options, first, count, progress)?;
        buffer.visible = Some(on_device).filter(|_| band == height);
        let rows: Vec<_> = visible
            .par_chunks_exact(width as usize)
            .enumerate()
            .map(|(i, pixels)| {
                let y = first + i as u32;
                let row = draw_row(scene, options, &view, y, |ray, layers| {
                    if chosen.is_none_or(|chosen| chosen.contains(ray.x, y)) {
                        resolve(ray, pixels[ray.x as usize], on_cpu.as_deref(), layers);
                    }
                });
                progress.advance(1)?;
                Ok(row)
            })
            .collect::<Result<_, Error>>()?;
        for (layers, steps) in rows {
            buffer.rows.push(layers);
            buffer.steps.push(steps);
        }
    }
    Ok(buffer)
}

/// Flags of a field's hit, as in the shader.
const AT_START: u32 = 1;
const RAN_OUT: u32 = 2;
/// Mark of a pixel that shows a face, as in the shader.
const IS_TRIANGLE: u32 = u32::MAX;

/// The layers of a pixel, from the values that the device returned.
fn resolve<'a>(ray: &mut PixelRay<'a>, visible: [u32; 4], on_cpu: Option<&'a [bool]>, layers: &mut Vec<Layer>) {
    let [item, word, depth, steps] = visible;
    let behind = match item.checked_sub(1) {
        None => None,
        Some(item) => {
            let layer = if ray.is_triangles(item) {
                ray.face(item, word).map(|layer| Layer { is_from_device: true, ..layer })
            } else if word & RAN_OUT != 0 {
                None
            } else if ray.is_traced_again(item) {
                if word & AT_START != 0 {
                    return ray.trace(layers, None);
                }
                ray.field_near(item, f64::from(f32::from_bits(depth)))
            } else {
                ray.field_at(item, f64::from(f32::from_bits(depth)), word & AT_START != 0)
            };
            if layer.is_none() {
                return ray.trace(layers, None);
            }
            layer
        }
    };
    ray.steps += if steps == IS_TRIANGLE { 1 } else { steps.max(1) };
    if on_cpu.is_some() {
        ray.searched = on_cpu;
        // The device drew opaque surfaces.
        ray.skips_opaque = true;
        ray.trace(layers, behind);
    } else {
        layers.extend(behind);
    }
}

/// The device's values for the pixels of some rows. All four words are zero without a hit.
///
/// ```text
/// word   face                          field
/// 0      index of the instance + 1     index of the instance + 1
/// 1      face of its mesh              flags
/// 2      row of the draw               depth in scene units, bits of a float32
/// 3      IS_TRIANGLE                   number of steps
/// ```
fn visible_on_device(
    scene: &Scene,
    device: &DeviceScene,
    view: &View,
    options: &RenderOptions,
    first_row: u32,
    row_count: u32,
    progress: &Progress,
) -> Result<(Vec<[u32; 4]>, DeviceVisibility), Error> {
    let context = device.context();
    let band = RowBand::new(scene, view, first_row, row_count);
    let meshes = device.meshes();
    // Instances of one mesh are adjacent, so that one call draws them; fields come last.
    let mut drawn: Vec<(Option<Range<u32>>, usize)> = scene
        .instances
        .iter()
        .enumerate()
        .filter(|(i, instance)| {
            instance.visible && is_drawn(instance, device.has_field(*i), &scene.materials, options.primary)
        })
        .map(|(i, instance)| {
            let triangles = instance.triangles.as_ref().filter(|_| as_triangles(instance, options.primary));
            (triangles.map(|triangles| meshes.span(triangles)), i)
        })
        .collect();
    drawn.sort_by_key(|(span, i)| (span.as_ref().map_or(u32::MAX, |span| span.start), *i));
    let rows: Vec<_> = drawn.iter().map(|(span, i)| band.row(*i, span.as_ref())).collect();

    let mut memory = device.raster.lock().unwrap_or_else(PoisonError::into_inner);
    let rows_buffer = memory.set_rows(context, rows)?;
    let triangles = context.raster_pipeline("scene_triangles", "triangle_corner", "triangle_seen", &[])?;
    let fields = context.raster_pipeline("scene_fields", "box_corner", "field_seen", &device.texts())?;
    let mut bindings = vec![(0, &rows_buffer)];
    bindings.extend((1..).zip(meshes.buffers()));
    let group = |name: &'static str, pipeline: &wgpu::RenderPipeline, bindings: &[(u32, &wgpu::Buffer)]| {
        let bindings: Vec<_> = bindings.iter().copied().map(whole).collect();
        device.groups.get(context, name, AnyPipeline::Raster(pipeline.clone()), &bindings)
    };
    let triangles_group = group("scene_triangles", &triangles, &bindings)?;
    bindings.truncate(1);
    bindings.extend(device.field_bindings());
    let fields_group = group("scene_fields", &fields, &bindings)?;

    let mut draws = Vec::new();
    let mut first = 0;
    for part in drawn.chunk_by(|a, b| a.0 == b.0) {
        let instances = first..first + part.len() as u32;
        first = instances.end;
        draws.push(match &part[0].0 {
            Some(span) => Draw { pipeline: &triangles, group: &triangles_group, vertices: span.clone(), instances },
            None => Draw { pipeline: &fields, group: &fields_group, vertices: 0..36, instances },
        });
    }
    let size = [view.size[0], row_count];
    let target = match memory.target.take().filter(|target| target.size == size) {
        Some(target) => target,
        None => context.raster_target("primary", size)?,
    };
    let visible = context.raster("primary", &target, &draws, device.timer.as_ref(), progress)?;
    let (pixels, stride) = target.pixels();
    memory.target = Some(target);
    Ok((visible, DeviceVisibility { pixels, stride, rows: rows_buffer, rays: band.ray }))
}

/// Depth before and behind the scene that the depth buffer of parallel rays includes, scene units. It is more than the
/// margin of the boxes that the shader draws.
const DEPTH_MARGIN: f64 = 0.01;

/// The range of depths of a scene in front of the eye, scene units; `depth` is a linear function and its value at 0.
fn depths(scene: &Scene, (axis, at_zero): (DVec3, f64)) -> [f64; 2] {
    let all = scene.boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
    let (lower, upper) = (all.min.as_dvec3(), all.max.as_dvec3());
    let middle = axis.dot(0.5 * (lower + upper)) + at_zero;
    let reach = axis.abs().dot(0.5 * (upper - lower)) + DEPTH_MARGIN;
    let near = (middle - reach).max(0.0);
    [near, (middle + reach).max(near + DEPTH_MARGIN)]
}

/// Rows of a picture as a separate render target.
struct RowBand<'a> {
    scene: &'a Scene,
    /// Clip space from scene space: x, y and w; if the rays are parallel, z in place of w, which is 1.
    clip_from_scene: [(DVec3, f64); 3],
    is_parallel: bool,
    /// Start of the ray through fragment (0, 0) in scene space.
    start: DVec3,
    /// Scene direction of the ray through fragment (0, 0), one unit of depth long; and the changes of the direction to
    /// the right and down, or of the start if the rays are parallel.
    ray: [DVec3; 3],
    middle: [f64; 2],
    pixel: f64,
    is_mirrored: bool,
}

impl<'a> RowBand<'a> {
    fn new(scene: &'a Scene, view: &View, first_row: u32, row_count: u32) -> Self {
        let Camera { right, up, back, .. } = view.camera;
        let [width, height] = view.size.map(f64::from);
        let is_parallel = view.camera.is_parallel();
        let unit = if is_parallel { scene.scale } else { 1.0 };
        let (rows, pixel) = (f64::from(row_count), view.camera.pixel_size(view.size[1]) / unit);
        let eye = scene.scene_from_world(view.camera.eye);
        // The viewing axis in fragments of the band; the rays pass through `offset` of each.
        let middle = [0.5 * width + 0.5 - view.offset[0], 0.5 * height + 0.5 - view.offset[1] - f64::from(first_row)];
        let linear = |axis: DVec3| (axis, -axis.dot(eye));
        let sum = |a: (DVec3, f64), s: f64, b: (DVec3, f64), t: f64| (s * a.0 + t * b.0, s * a.1 + t * b.1);
        let depth = linear(-back);
        // The third row of the map, and w.
        let (clip_depth, w) = if is_parallel {
            let [near, far] = depths(scene, depth);
            let one = (DVec3::ZERO, 1.0);
            (sum(depth, -1.0 / (far - near), one, far / (far - near)), one)
        } else {
            (depth, depth)
        };
        let first = pixel * (middle[1] * up - middle[0] * right);
        let (to_start, to_ray) = if is_parallel { (first, DVec3::ZERO) } else { (DVec3::ZERO, first) };
        Self {
            scene,
            clip_from_scene: [
                sum(linear(right), 2.0 / (width * pixel), w, 2.0 * middle[0] / width - 1.0),
                sum(linear(up), 2.0 / (rows * pixel), w, 1.0 - 2.0 * middle[1] / rows),
                clip_depth,
            ],
            is_parallel,
            start: eye + to_start,
            ray: [to_ray - back, pixel * right, -pixel * up],
            middle,
            pixel,
            is_mirrored: right.cross(up).dot(back) < 0.0,
        }
    }

    /// The shader's record of an instance, drawn as the triangles of `span` or as its field.
    fn row(&self, index: usize, span: Option<&Range<u32>>) -> RasterInstance {
        let instance = &self.scene.instances[index];
        let own_from_scene = if span.is_some() { instance.tree_from_scene } else { instance.field_from_scene };
        let scene_from_own: DAffine3 = own_from_scene.inverse();
        let [clip_x, clip_y, clip_depth] = self.clip_from_scene.map(|(axis, offset)| {
            let along = scene_from_own.matrix3.transpose() * axis;
            [along.x, along.y, along.z, axis.dot(scene_from_own.translation) + offset].map(|value| value as f32)
        });
        let turned = |m: DMat3, d: DVec3| (m * d).as_vec3().to_array();
        let [ray, ray_x, ray_y] = self.ray.map(|d| turned(own_from_scene.matrix3, d));
        RasterInstance {
            clip_x,
            clip_y,
            clip_depth,
            start: own_from_scene.transform_point3(self.start).as_vec3().to_array(),
            index: index as u32,
            ray,
            first_face: span.map_or(0, |span| span.start / 3),
            ray_x,
            first_material: instance.first_material,
            ray_y,
            is_mirrored: u32::from((own_from_scene.matrix3.determinant() < 0.0) != self.is_mirrored),
            middle: self.middle.map(|value| value as f32),
            pixel: self.pixel as f32,
            is_parallel: u32::from(self.is_parallel),
        }
    }
}
