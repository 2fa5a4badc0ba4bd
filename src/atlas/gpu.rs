//! Packing on a graphics device: fields in device memory become pages in device memory.
//!
//! A page is a storage buffer of the occupied rows, padded to 256 bytes, so that it can be copied to a layer of a
//! texture without conversion ([`DevicePages::texture`]). The bytes equal the output of [`super::texels::write`].

use super::AtlasBlock;
use crate::encoding::Encoding;
use crate::error::{DeviceError, Error};
use crate::gpu::Context;
use crate::gpu::layout::PackParams;
use crate::progress::Progress;
use crate::volume::device::DeviceField;
use std::sync::Arc;

/// Alignment of the rows of a buffer that is copied to a texture, bytes.
const ROW_ALIGNMENT: u32 = wgpu::COPY_BYTES_PER_ROW_ALIGNMENT;

/// A field on a device and its block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct DeviceItem<'a> {
    pub block: AtlasBlock,
    pub field: &'a DeviceField,
    /// Factor of stored values; see [`Encoding::scale`].
    pub scale: f32,
}

/// The pages of an atlas in device memory.
#[derive(Debug)]
pub struct DevicePages {
    context: Arc<Context>,
    page_size: u32,
    encoding: Encoding,
    pages: Vec<Page>,
}

/// The first rows of a page, down to the last row of a block. All other rows are zero and not stored.
#[derive(Debug)]
struct Page {
    rows: u32,
    buffer: wgpu::Buffer,
}

impl DevicePages {
    /// Fills `pages` pages. Blocks must be sound, disjoint, and aligned to whole words.
    pub(crate) fn pack(
        context: &Arc<Context>,
        page_size: u32,
        pages: u32,
        encoding: Encoding,
        items: &[DeviceItem<'_>],
        progress: &Progress,
    ) -> Result<Self, Error> {
        let row_bytes = Self::row_bytes(page_size, encoding);
        let mut rows = vec![0; pages as usize];
        for block in items.iter().map(|item| &item.block) {
            let (taken, rectangle) = (&mut rows[block.page as usize], block.rectangle());
            *taken = (*taken).max(rectangle.y + rectangle.height);
        }
        let page = |rows: u32| {
            let what = format!("{rows} rows of a page of {page_size} x {page_size} texels");
            let bytes = u64::from(row_bytes) * u64::from(rows.max(1));
            Ok(Page { rows, buffer: context.storage(&what, bytes)? })
        };
        let pages = rows.into_iter().map(page).collect::<Result<Vec<_>, DeviceError>>()?;
        let atlas = Self { context: context.clone(), page_size, encoding, pages };
        progress.set_total(items.len() as u64);
        for item in items {
            atlas.write(item, row_bytes, progress)?;
            progress.advance(1)?;
        }
        Ok(atlas)
    }

    fn row_bytes(page_size: u32, encoding: Encoding) -> u32 {
        (page_size * encoding.bytes() as u32).next_multiple_of(ROW_ALIGNMENT)
    }

    fn write(&self, item: &DeviceItem<'_>, row_bytes: u32, progress: &Progress) -> Result<(), Error> {
        let (context, block) = (&self.context, &item.block);
        let steps = match self.encoding {
            Encoding::Float32 | Encoding::Float16 => 0,
            Encoding::Snorm16 => i16::MAX as u32,
            Encoding::Snorm8 => i8::MAX as u32,
        };
        let levels: Vec<f32> = (0..=steps).map(|stored| self.encoding.decode(stored, item.scale)).collect();
        let levels = context.upload("levels", &levels)?;
        let kernel = context.kernel("atlas_pack", "main")?;
        let mut last = None;
        for slab in item.field.slabs() {
            let params = PackParams {
                corner: block.corner,
                tile: block.tile,
                shape: block.shape,
                gutter: block.gutter,
                columns: block.columns,
                first_plane: slab.first_plane as u32,
                planes: slab.planes as u32,
                row_words: row_bytes / size_of::<u32>() as u32,
                word_texels: (size_of::<u32>() / self.encoding.bytes()) as u32,
                steps,
                scale: item.scale,
                scale_exponent: (item.scale.to_bits() >> 23) as i32 - 127,
            };
            let parameters = context.parameters("pack parameters", &params)?;
            let page = &self.pages[block.page as usize].buffer;
            let buffers = [(0, &parameters), (1, &slab.buffer), (2, page), (3, &levels)];
            let group = context.bind("pack", &kernel, &buffers)?;
            let workgroups = [block.tile[0].div_ceil(64), block.tile[1], slab.planes as u32];
            last = Some(context.dispatch("pack", &kernel, &group, workgroups)?);
        }
        // One field at a time is in flight, so that a cancelled job stops soon.
        last.map_or(Ok(()), |submission| context.wait("pack", &submission, progress))
    }

    pub(crate) fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Copies all pages to the host as bytes, without the padding of rows.
    pub(crate) fn read(&self, progress: &Progress) -> Result<Vec<u8>, Error> {
        let row = self.page_size as usize * self.encoding.bytes();
        let padded = Self::row_bytes(self.page_size, self.encoding) as usize;
        let page_bytes = row * self.page_size as usize;
        let mut bytes = vec![0; page_bytes * self.pages.len()];
        for (page, out) in self.pages.iter().zip(bytes.chunks_exact_mut(page_bytes)) {
            let mut taken = vec![0u8; padded * page.rows as usize];
            self.context.read("read back a page", &page.buffer, &mut taken, progress)?;
            for (line, out) in taken.chunks_exact(padded).zip(out.chunks_exact_mut(row)) {
                out.copy_from_slice(&line[..row]);
            }
        }
        Ok(bytes)
    }

    /// The pages as the layers of a 2D texture, copied on the device. 16-bit normalised textures need an optional
    /// device feature; without it this is an error.
    pub fn texture(&self) -> Result<wgpu::Texture, DeviceError> {
        let size = wgpu::Extent3d {
            width: self.page_size,
            height: self.page_size,
            depth_or_array_layers: self.pages.len() as u32,
        };
        let format = match self.encoding {
            Encoding::Float32 => wgpu::TextureFormat::R32Float,
            Encoding::Float16 => wgpu::TextureFormat::R16Float,
            Encoding::Snorm16 => wgpu::TextureFormat::R16Snorm,
            Encoding::Snorm8 => wgpu::TextureFormat::R8Snorm,
        };
        let row_bytes = Self::row_bytes(self.page_size, self.encoding);
        self.context.guarded("an atlas texture", u64::from(row_bytes) * u64::from(self.page_size), || {
            let texture = self.context.device.create_texture(&wgpu::TextureDescriptor {
                label: Some("atlas"),
                size,
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format,
                usage: wgpu::TextureUsages::TEXTURE_BINDING
                    | wgpu::TextureUsages::COPY_DST
                    | wgpu::TextureUsages::COPY_SRC,
                view_formats: &[],
            });
            let mut encoder = self
                .context
                .device
                .create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some("pages into a texture") });
            for (layer, page) in self.pages.iter().enumerate() {
                encoder.copy_buffer_to_texture(
                    wgpu::TexelCopyBufferInfo {
                        buffer: &page.buffer,
                        layout: wgpu::TexelCopyBufferLayout {
                            offset: 0,
                            bytes_per_row: Some(row_bytes),
                            rows_per_image: Some(page.rows),
                        },
                    },
                    wgpu::TexelCopyTextureInfo {
                        texture: &texture,
                        mip_level: 0,
                        origin: wgpu::Origin3d { x: 0, y: 0, z: layer as u32 },
                        aspect: wgpu::TextureAspect::All,
                    },
                    wgpu::Extent3d { height: page.rows, depth_or_array_layers: 1, ..size },
                );
            }
            self.context.queue.submit([encoder.finish()]);
            texture
        })
    }
}
