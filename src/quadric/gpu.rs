//! Pictures of quadrics on a graphics device (`shaders/quadric/quadrics.wgsl`): geometry in a texture, as in the
//! article.
//!
//! The texture is RGBA32F. Texel `i` lies in column `i mod w`, row `i / w`. `w` is a multiple of six near the device's
//! limit, so that any number of records fits and no record spans two rows:
//!
//! ```text
//!   6 n texels      a record each: matrix (4), centre and radius of the trim sphere, reflectance and opacity
//!   2 m texels      a box of the tree each: min and first, max and count; m = 0 where all records are tried
//! ```
//!
//! Two values differ from the record of `pack_quadrics`, so that float32 is precise enough at any position in the
//! world. The matrix is in the frame of the trim sphere ([`super::local`]), and the centre is relative to the
//! centre of all quadrics. Depths then agree with the CPU's to a few float32 roundings of the distance, and of the
//! radius divided by the slope.

use super::picture::QuadricView;
use super::{LINEAR_UP_TO, Quadrics};
use crate::error::{DeviceError, Error};
use crate::gpu::Context;
use crate::gpu::constants::quadrics::{HIT, NODE_TEXELS, RECORD_TEXELS, UNFINISHED};
use crate::gpu::layout::{Light, QuadricParams, QuadricPixel};
use crate::gpu::pace::in_pieces;
use crate::picture::{DirectionalLight, Frame};
use crate::progress::Progress;
use glam::DVec3;

/// Side of a workgroup in pixels, as in the shader.
const TILE: u32 = 8;
/// Number of rows of workgroups of the first dispatch, and largest number of any.
const TILE_ROWS: (u64, u64) = (1, 1024);
/// Indices are stored as floats, which represent whole numbers exactly up to this.
const MAX_INDEX: usize = 1 << 24;
/// Boxes are enlarged by this fraction of the size of the scene, for the float32 rounding of a slab test.
const BOX_GROWTH: f64 = 2e-6;

pub(super) fn draw(context: &Context, view: &QuadricView<'_>, progress: &Progress) -> Result<Frame, Error> {
    let QuadricView { quadrics, camera, options, lights } = *view;
    let light_buffer = upload_lights(context, lights)?;
    let [width, height] = options.size;
    let pixel_count = width as usize * height as usize;
    let bounds = quadrics.bounds().unwrap_or([camera.eye; 2]);
    let start_depth = camera.depth_before(bounds);
    let start = camera.eye - start_depth * camera.back - quadrics.tree().center;
    let store = Store::new(context, quadrics, bounds)?;
    let mut params = QuadricParams {
        rays: camera.rays(1.0, options, lights.len(), start, start_depth),
        background: options.background,
        ambient: options.ambient,
        specular: options.specular,
        shininess: options.shininess,
        quadric_count: quadrics.len() as u32,
        node_count: store.nodes,
        texels_per_row: store.texels_per_row,
        ..QuadricParams::default()
    };
    let uniform = context.parameters("picture parameters", &params)?;
    let pixels = context.storage("a picture", (pixel_count * size_of::<QuadricPixel>()) as u64)?;
    let shares = context.storage("light shares", (4 * pixel_count * lights.len().max(1)) as u64)?;
    let kernel = context.kernel("quadrics", "main")?;
    let group = context.guarded("quadrics", 0, || {
        let buffer = |binding, buffer: &wgpu::Buffer| (binding, buffer.clone());
        let buffers = [buffer(0, &uniform), buffer(2, &light_buffer), buffer(3, &pixels), buffer(4, &shares)];
        let mut entries: Vec<_> = buffers
            .iter()
            .map(|(binding, buffer)| wgpu::BindGroupEntry { binding: *binding, resource: buffer.as_entire_binding() })
            .collect();
        entries.push(wgpu::BindGroupEntry { binding: 1, resource: wgpu::BindingResource::TextureView(&store.view) });
        context.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("quadrics"),
            layout: &kernel.get_bind_group_layout(0),
            entries: &entries,
        })
    })?;
    progress.set_total(u64::from(height));
    let rows = u64::from(height.div_ceil(TILE));
    in_pieces(context, "the kernel that draws quadrics", rows, TILE_ROWS.0, TILE_ROWS.1, progress, |first, count| {
        params.rays.first_row = first as u32 * TILE;
        context.write("picture parameters", &uniform, 0, &[params])?;
        progress.advance((count * u64::from(TILE)).min(u64::from(height - params.rays.first_row)))?;
        Ok(context.dispatch("quadrics", &kernel, &group, [width.div_ceil(TILE), count as u32, 1])?)
    })?;

    let mut found = vec![QuadricPixel::default(); pixel_count];
    context.read("a picture", &pixels, &mut found, progress)?;
    let mut frame = Frame::new(width as usize, height as usize, lights.len())?;
    context.read("light shares", &shares, &mut frame.shadow, progress)?;
    for (y, mut row) in frame.rows().into_iter().enumerate() {
        for (x, pixel) in found[y * width as usize..][..width as usize].iter().enumerate() {
            if pixel.state == UNFINISHED {
                row.shadow[x * row.lights..][..row.lights].fill(1.0);
                view.draw_pixel(x, y, &mut row);
                progress.check()?;
                continue;
            }
            row.color[4 * x..][..4].copy_from_slice(&pixel.color);
            row.steps[x] = pixel.steps;
            if pixel.state == HIT {
                row.depth[x] = (start_depth + f64::from(pixel.depth)) as f32;
                row.normal[3 * x..][..3].copy_from_slice(&pixel.normal);
                row.object_id[x] = quadrics.tree().order[pixel.quadric as usize] as i32;
            }
        }
    }
    Ok(frame)
}

/// Uploads lights in the layout of the kernel. `lights` must have unit directions.
fn upload_lights(context: &Context, lights: &[DirectionalLight]) -> Result<wgpu::Buffer, DeviceError> {
    let row = |light: &DirectionalLight| Light {
        direction: light.direction.to_array(),
        color: light.color.to_array(),
        ..Light::default()
    };
    context.upload("lights", &lights.iter().map(row).collect::<Vec<_>>())
}

/// The texture that holds records and boxes.
struct Store {
    view: wgpu::TextureView,
    texels_per_row: u32,
    nodes: u32,
}

impl Store {
    fn new(context: &Context, quadrics: &Quadrics, bounds: [DVec3; 2]) -> Result<Self, Error> {
        let limit = context.limits.max_texture_dimension_2d as usize;
        let center = quadrics.tree().center;
        let has_tree = quadrics.len() > LINEAR_UP_TO;
        let nodes = if has_tree { quadrics.tree().nodes.as_slice() } else { &[] };

        let mut texels: Vec<[f32; 4]> = Vec::with_capacity(RECORD_TEXELS * quadrics.len() + NODE_TEXELS * nodes.len());
        for (record, local) in quadrics.records().iter().zip(quadrics.locals()) {
            texels.extend(local.matrix().to_cols_array_2d().map(|column| column.map(|entry| entry as f32)));
            texels.push((local.center - center).as_vec3().extend(local.radius as f32).to_array());
            texels.push(record.reflectance.extend(record.opacity).to_array());
        }
        let growth = (BOX_GROWTH * (bounds[1] - bounds[0]).length()) as f32;
        for node in nodes {
            texels.push((node.min - growth).extend(node.first as f32).to_array());
            texels.push((node.max + growth).extend(node.count as f32).to_array());
        }

        let needed = texels.len().max(1).next_multiple_of(RECORD_TEXELS);
        let width = needed.min(limit / RECORD_TEXELS * RECORD_TEXELS);
        let height = needed.div_ceil(width);
        if height > limit || quadrics.len().max(nodes.len()) > MAX_INDEX {
            let most = (limit / (RECORD_TEXELS + NODE_TEXELS) * limit).min(MAX_INDEX);
            return Err(DeviceError::TooLarge {
                device: context.label(),
                what: format!("a texture of {} quadrics", quadrics.len()),
                needed: (texels.len() * size_of::<[f32; 4]>()) as u64,
                limit: (most * RECORD_TEXELS * size_of::<[f32; 4]>()) as u64,
                advice: "draw fewer at once, or use device=\"cpu\"",
            }
            .into());
        }
        texels.resize(width * height, [0.0; 4]);
        let size = wgpu::Extent3d { width: width as u32, height: height as u32, depth_or_array_layers: 1 };
        let view = context.guarded("a texture of quadrics", (texels.len() * 16) as u64, || {
            let texture = context.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("quadrics"),
                size,
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: wgpu::TextureFormat::Rgba32Float,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            });
            let layout = wgpu::TexelCopyBufferLayout {
                offset: 0,
                bytes_per_row: Some(16 * size.width),
                rows_per_image: Some(size.height),
            };
            context.queue.write_texture(texture.as_image_copy(), bytemuck::cast_slice(&texels), layout, size);
            texture.create_view(&wgpu::TextureViewDescriptor::default())
        })?;
        Ok(Self { view, texels_per_row: size.width, nodes: nodes.len() as u32 })
    }
}
