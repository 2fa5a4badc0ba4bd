//! 3D textures with hardware filtering.

use super::context::Context;
use crate::error::DeviceError;

/// Half floats. Every adapter filters them, but not every adapter filters 32-bit floats.
const FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R16Float;
/// Size of a texel, bytes.
const TEXEL: u32 = 2;

/// Alignment of the rows of a buffer that is copied to a texture, bytes.
pub(crate) const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// A 3D texture of half floats and a linear sampler, clamped at the edge.
#[derive(Debug)]
pub struct FilteredTexture {
    texture: wgpu::Texture,
    pub view: wgpu::TextureView,
    pub sampler: wgpu::Sampler,
}

/// Distance between the rows of half floats in a buffer that is copied to a texture, bytes.
pub(crate) fn row_bytes(width: u32) -> u32 {
    (width * TEXEL).next_multiple_of(ROW_ALIGNMENT)
}

impl Context {
    /// An empty texture of `shape` texels.
    pub fn filtered_texture(&self, label: &str, shape: [u32; 3]) -> Result<FilteredTexture, DeviceError> {
        let limit = self.limits.max_texture_dimension_3d;
        if let Some(&side) = shape.iter().find(|&&side| side > limit) {
            return Err(self.failed(
                label,
                format!("a side of {side} texels, the device allows {limit} in a 3D texture; use filter=\"linear\""),
            ));
        }
        let [width, height, depth_or_array_layers] = shape;
        let bytes = shape.iter().map(|&side| u64::from(side)).product::<u64>() * u64::from(TEXEL);
        self.guarded(label, bytes, || {
            let texture = self.device.create_texture(&wgpu::TextureDescriptor {
                label: Some(label),
                size: wgpu::Extent3d { width, height, depth_or_array_layers },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D3,
                format: FORMAT,
                usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
                view_formats: &[],
            });
            let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
            let sampler = self.device.create_sampler(&wgpu::SamplerDescriptor {
                label: Some(label),
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..wgpu::SamplerDescriptor::default()
            });
            FilteredTexture { texture, view, sampler }
        })
    }

    /// Copies planes of half floats, with rows of [`row_bytes`], to the texture from plane `first_plane` on.
    pub fn copy_planes(
        &self,
        label: &str,
        rows: &wgpu::Buffer,
        target: &FilteredTexture,
        first_plane: u32,
        planes: u32,
    ) -> Result<(), DeviceError> {
        let size = target.texture.size();
        self.guarded(label, 0, || {
            let mut encoder =
                self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
            encoder.copy_buffer_to_texture(
                wgpu::TexelCopyBufferInfo {
                    buffer: rows,
                    layout: wgpu::TexelCopyBufferLayout {
                        offset: 0,
                        bytes_per_row: Some(row_bytes(size.width)),
                        rows_per_image: Some(size.height),
                    },
                },
                wgpu::TexelCopyTextureInfo {
                    texture: &target.texture,
                    mip_level: 0,
                    origin: wgpu::Origin3d { x: 0, y: 0, z: first_plane },
                    aspect: wgpu::TextureAspect::All,
                },
                wgpu::Extent3d { depth_or_array_layers: planes, ..size },
            );
            self.submit(Some(encoder.finish()));
        })
    }
}
