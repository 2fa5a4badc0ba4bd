//! Render passes into one target of four words per pixel, with a depth buffer.
//!
//! Depth is 1 near the eye and falls to 0 far away, in 32-bit floats. Their precision near 0 compensates for the
//! hyperbola, so the relative precision of depth is the same everywhere. The larger value passes the depth test.

use super::buffer::ReadBack;
use super::context::Context;
use super::shader::{Instead, source_instead};
use super::timer::Timer;
use crate::error::{DeviceError, Error};
use crate::progress::Progress;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

const VISIBLE: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
const DEPTH: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// Size of a pixel of [`VISIBLE`], bytes.
const PIXEL_BYTES: u32 = 16;

/// Pipelines by kernel and overrides of imported files.
#[derive(Debug, Default)]
pub(crate) struct RasterPipelines(Mutex<HashMap<(&'static str, Vec<Instead>), wgpu::RenderPipeline>>);

/// The target of a pass, and memory for its pixels on the host.
#[derive(Debug)]
pub struct RasterTarget {
    visible: wgpu::Texture,
    visible_view: wgpu::TextureView,
    depth_view: wgpu::TextureView,
    /// Size in pixels.
    pub size: [u32; 2],
    /// Number of pixels from the start of a row in memory to the start of the next.
    stride: u32,
    rows: wgpu::Buffer,
    result: ReadBack,
}

/// One draw call of a pass.
#[derive(Debug)]
pub(crate) struct Draw<'a> {
    pub pipeline: &'a wgpu::RenderPipeline,
    pub group: &'a wgpu::BindGroup,
    pub vertices: Range<u32>,
    pub instances: Range<u32>,
}

impl RasterTarget {
    /// The pixels of the last pass in device memory, and their number per row.
    pub fn pixels(&self) -> (wgpu::Buffer, u32) {
        (self.rows.clone(), self.stride)
    }
}

impl Context {
    /// The pipeline of a kernel's vertex and fragment entry points, compiled at the first use. Both sides of faces are
    /// drawn. The bind group layout is derived from the text.
    pub fn raster_pipeline(
        &self,
        name: &'static str,
        vertex: &'static str,
        fragment: &'static str,
        instead: &[Instead],
    ) -> Result<wgpu::RenderPipeline, DeviceError> {
        let mut pipelines = self.raster_pipelines.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(pipeline) = pipelines.get(&(name, instead.to_vec())) {
            return Ok(pipeline.clone());
        }
        let text = source_instead(name, instead).map_err(|reason| self.refused(name, reason))?;
        let pipeline = self.guarded(name, 0, || {
            let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(name),
                source: wgpu::ShaderSource::Wgsl(text.into()),
            });
            self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
                label: Some(name),
                layout: None,
                vertex: wgpu::VertexState {
                    module: &module,
                    entry_point: Some(vertex),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    buffers: &[],
                },
                primitive: wgpu::PrimitiveState::default(),
                depth_stencil: Some(wgpu::DepthStencilState {
                    format: DEPTH,
                    depth_write_enabled: Some(true),
                    depth_compare: Some(wgpu::CompareFunction::Greater),
                    stencil: wgpu::StencilState::default(),
                    bias: wgpu::DepthBiasState::default(),
                }),
                multisample: wgpu::MultisampleState::default(),
                fragment: Some(wgpu::FragmentState {
                    module: &module,
                    entry_point: Some(fragment),
                    compilation_options: wgpu::PipelineCompilationOptions::default(),
                    targets: &[Some(VISIBLE.into())],
                }),
                multiview_mask: None,
                cache: None,
            })
        });
        let pipeline = pipeline.map_err(|error| match error {
            DeviceError::Failed { reason, .. } => self.refused(name, reason),
            other => other,
        })?;
        pipelines.insert((name, instead.to_vec()), pipeline.clone());
        Ok(pipeline)
    }

    /// A target of the given size in pixels.
    pub fn raster_target(&self, label: &str, [width, height]: [u32; 2]) -> Result<RasterTarget, DeviceError> {
        // Rows of a copy are aligned to 256 bytes.
        let stride = width.next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT / PIXEL_BYTES);
        let limit = self.limits.max_texture_dimension_2d;
        if stride.max(height) > limit {
            let reason = format!("{width} x {height} pixels, the device allows {limit} a side; use device=\"cpu\"");
            return Err(self.failed(label, reason));
        }
        let bytes = u64::from(stride) * u64::from(height) * u64::from(PIXEL_BYTES);
        let texture = |format: wgpu::TextureFormat, usage: wgpu::TextureUsages| {
            self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width: stride, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | usage,
                view_formats: &[],
            })
        };
        let rows = self.storage(label, bytes)?;
        let result = self.read_back(label, bytes)?;
        let view = |texture: &wgpu::Texture| texture.create_view(&wgpu::TextureViewDescriptor::default());
        self.guarded(label, 2 * bytes, || {
            let visible = texture(VISIBLE, wgpu::TextureUsages::COPY_SRC);
            let visible_view = view(&visible);
            let depth_view = view(&texture(DEPTH, wgpu::TextureUsages::empty()));
            RasterTarget { visible, visible_view, depth_view, size: [width, height], stride, rows, result }
        })
    }

    /// Clears the target, draws, and reads back four words per pixel, zero where no fragment was drawn. After an error
    /// the target cannot be used again.
    pub(crate) fn raster(
        &self,
        label: &'static str,
        target: &RasterTarget,
        draws: &[Draw<'_>],
        timer: Option<&Timer>,
        progress: &Progress,
    ) -> Result<Vec<[u32; 4]>, Error> {
        let [width, height] = target.size;
        let submission = self.guarded(label, 0, || {
            let first = timer.map_or(0, Timer::count);
            let stamps = timer.and_then(|timer| timer.add(label));
            let mut encoder =
                self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
            {
                let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                    label: Some(label),
                    color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                        view: &target.visible_view,
                        depth_slice: None,
                        resolve_target: None,
                        ops: wgpu::Operations {
                            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
                            store: wgpu::StoreOp::Store,
                        },
                    })],
                    depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                        view: &target.depth_view,
                        depth_ops: Some(wgpu::Operations {
                            load: wgpu::LoadOp::Clear(0.0),
                            store: wgpu::StoreOp::Discard,
                        }),
                        stencil_ops: None,
                    }),
                    timestamp_writes: stamps.map(|(query_set, [start, end])| wgpu::RenderPassTimestampWrites {
                        query_set,
                        beginning_of_pass_write_index: start,
                        end_of_pass_write_index: end,
                    }),
                    occlusion_query_set: None,
                    multiview_mask: None,
                });
                pass.set_viewport(0.0, 0.0, width as f32, height as f32, 0.0, 1.0);
                for draw in draws {
                    pass.set_pipeline(draw.pipeline);
                    pass.set_bind_group(0, draw.group, &[]);
                    pass.draw(draw.vertices.clone(), draw.instances.clone());
                }
            }
            encoder.copy_texture_to_buffer(
                target.visible.as_image_copy(),
                wgpu::TexelCopyBufferInfo {
                    buffer: &target.rows,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(target.stride * PIXEL_BYTES),
                        rows_per_image: Some(height),
                    },
                },
                target.visible.size(),
            );
            target.result.record(&mut encoder, &target.rows, 0, 0, target.rows.size());
            if let Some(timer) = timer {
                timer.record(&mut encoder, first);
            }
            let submission = self.submit(Some(encoder.finish()));
            target.result.map(target.rows.size());
            submission
        })?;
        self.wait(label, &submission, progress)?;
        let mut pixels = vec![[0u32; 4]; target.stride as usize * height as usize];
        self.finish(label, &target.result, &mut pixels)?;
        let rows = pixels.chunks_exact(target.stride as usize);
        Ok(rows.flat_map(|row| &row[..width as usize]).copied().collect())
    }
}
