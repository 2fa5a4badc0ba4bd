//! Writes fields into pages, and reads them back bit for bit.
//!
//! Pages are bytes, so that the same code serves every encoding: `pages` x `page_size` x `page_size` texels, row 0
//! first.

use super::AtlasBlock;
use crate::encoding::Encoding;
use crate::error::Error;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use rayon::prelude::*;

/// Number of rows of a page that one thread fills at a time. The rows of a slice are adjacent in its field.
const BAND_ROWS: usize = 16;

/// A field and its block.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Item<'a> {
    pub block: AtlasBlock,
    /// Samples, x fastest in memory.
    pub distances: &'a [f32],
    /// Factor of stored values; see [`Encoding::scale`].
    pub scale: f32,
}

/// Writes fields into pages, gutters included. Blocks must be sound and disjoint.
pub(crate) fn write(
    pages: &mut [u8],
    page_size: u32,
    encoding: Encoding,
    items: &[Item<'_>],
    progress: &Progress,
) -> Result<(), Error> {
    let size = page_size as usize;
    let row_bytes = size * encoding.bytes();
    let bands = size.div_ceil(BAND_ROWS);
    progress.set_total((pages.len() / (row_bytes * size) * size) as u64);
    // A band never extends into the next page.
    pages.par_chunks_mut(row_bytes * size).enumerate().try_for_each(|(page, texels)| {
        let here: Vec<&Item<'_>> = items.iter().filter(|item| item.block.page as usize == page).collect();
        texels.par_chunks_mut(row_bytes * BAND_ROWS).with_max_len(1.max(bands / 64)).enumerate().try_for_each(
            |(band, rows)| {
                for item in &here {
                    write_band(rows, band * BAND_ROWS, row_bytes, encoding, item);
                }
                progress.advance((rows.len() / row_bytes) as u64)
            },
        )
    })
}

/// Writes the part of a field that lies in the rows from `first_row` on.
fn write_band(rows: &mut [u8], first_row: usize, row_bytes: usize, encoding: Encoding, item: &Item<'_>) {
    let block = &item.block;
    let bytes = encoding.bytes();
    let [nx, ny, nz] = block.shape.map(|n| n as usize);
    let [columns, gutter] = [block.columns, block.gutter].map(|n| n as usize);
    let [tile_width, tile_height] = block.tile.map(|n| n as usize);
    let [left, top] = block.corner.map(|n| n as usize);
    let start = first_row.max(top);
    let end = (first_row + rows.len() / row_bytes).min(top + block.rows() as usize * tile_height);
    let mut row = start;
    while row < end {
        // The rows of this band that belong to the same row of tiles.
        let tile_row = (row - top) / tile_height;
        let tile_top = top + tile_row * tile_height;
        let tile_end = end.min(tile_top + tile_height);
        for column in 0..columns.min(nz - tile_row * columns) {
            let slice = &item.distances[nx * ny * (tile_row * columns + column)..][..nx * ny];
            let x = (left + column * tile_width + gutter) * bytes;
            for row in row..tile_end {
                // A gutter row repeats the nearest row of the slice.
                let y = (row - tile_top).saturating_sub(gutter).min(ny - 1);
                let line = &mut rows[(row - first_row) * row_bytes..][..row_bytes];
                encoding.encode_slice(&slice[nx * y..][..nx], item.scale, &mut line[x..x + nx * bytes]);
                let last = x + (nx - 1) * bytes;
                for i in 1..=gutter {
                    // The loop is written out, since a call to copy a few bytes takes longer than the copy.
                    for byte in 0..bytes {
                        line[x - i * bytes + byte] = line[x + byte];
                        line[last + i * bytes + byte] = line[last + byte];
                    }
                }
            }
        }
        row = tile_end;
    }
}

/// Sets the texels of a block to zero.
pub(crate) fn clear(pages: &mut [u8], page_size: u32, encoding: Encoding, block: &AtlasBlock) {
    let row_bytes = page_size as usize * encoding.bytes();
    let room = block.rectangle();
    let first = (block.page as usize * page_size as usize + room.y as usize) * row_bytes;
    let (x, width) = (room.x as usize * encoding.bytes(), room.width as usize * encoding.bytes());
    for row in pages[first..].chunks_mut(row_bytes).take(room.height as usize) {
        row[x..x + width].fill(0);
    }
}

/// The stored values of a field, x fastest.
pub(crate) fn read(
    pages: &[u8],
    page_size: u32,
    encoding: Encoding,
    block: &AtlasBlock,
    scale: f32,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    let row_bytes = page_size as usize * encoding.bytes();
    let page = &pages[block.page as usize * page_size as usize * row_bytes..][..page_size as usize * row_bytes];
    let [nx, ny, nz] = block.shape.map(|n| n as usize);
    let mut distances = allocate_samples(&format!("a field of {nx} x {ny} x {nz} samples"), nx * ny * nz, 0)?;
    progress.set_total(nz as u64);
    distances.par_chunks_mut(nx * ny).enumerate().try_for_each(|(z, slice)| {
        let [x, y] = block.slice(z as u32).map(|n| n as usize);
        for (line, row) in slice.chunks_mut(nx).zip(page[y * row_bytes..].chunks(row_bytes)) {
            encoding.decode_slice(&row[x * encoding.bytes()..][..nx * encoding.bytes()], scale, line);
        }
        progress.advance(1)
    })?;
    Ok(distances)
}

#[cfg(test)]
mod tests {
    use super::super::Layout;
    use super::super::plan::plan;
    use super::*;

    fn field(shape: [u32; 3], seed: u32) -> Vec<f32> {
        let count = shape.iter().product::<u32>();
        (0..count).map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0).collect()
    }

    #[test]
    fn texels_are_where_the_definition_says_and_gutters_repeat_the_border() {
        let shapes = [[5, 4, 7], [3, 9, 2], [1, 1, 1], [6, 2, 3]];
        for gutter in [0, 1, 2] {
            let blocks = plan(Layout::Shelves { gutter }, 40, 1, &[], &shapes).unwrap();
            let fields: Vec<_> = shapes.iter().enumerate().map(|(i, &shape)| field(shape, i as u32)).collect();
            let items: Vec<_> =
                blocks.iter().zip(&fields).map(|(&block, distances)| Item { block, distances, scale: 1.0 }).collect();
            let pages = 1 + blocks.iter().map(|block| block.page as usize).max().unwrap();
            let mut texels = vec![0f32; pages * 40 * 40];
            write(bytemuck::cast_slice_mut(&mut texels), 40, Encoding::Float32, &items, &Progress::new()).unwrap();
            for (block, distances) in blocks.iter().zip(&fields) {
                let [nx, ny, nz] = block.shape.map(|n| n as i64);
                let g = i64::from(gutter);
                for z in 0..nz {
                    let [x0, y0] = block.slice(z as u32).map(i64::from);
                    for y in -g..ny + g {
                        for x in -g..nx + g {
                            let voxel = x.clamp(0, nx - 1) + nx * (y.clamp(0, ny - 1) + ny * z);
                            let texel = (i64::from(block.page) * 40 + y0 + y) * 40 + x0 + x;
                            assert_eq!(texels[texel as usize], distances[voxel as usize]);
                        }
                    }
                }
            }
            for (block, distances) in blocks.iter().zip(&fields) {
                let bytes = bytemuck::cast_slice(&texels);
                let back = read(bytes, 40, Encoding::Float32, block, 1.0, &Progress::new()).unwrap();
                assert_eq!(back, *distances);
            }
            for block in &blocks {
                clear(bytemuck::cast_slice_mut(&mut texels), 40, Encoding::Float32, block);
            }
            assert!(texels.iter().all(|&texel| texel == 0.0));
        }
    }

    #[test]
    fn every_encoding_is_written_as_it_is_defined() {
        let shape = [5, 4, 7];
        let block = plan(Layout::Shelves { gutter: 1 }, 40, 4, &[], &[shape]).unwrap()[0];
        let distances = field(shape, 1);
        for encoding in Encoding::ALL {
            let mut words = vec![0u32; 40 * 40];
            let pages = &mut bytemuck::cast_slice_mut(&mut words)[..40 * 40 * encoding.bytes()];
            let item = Item { block, distances: &distances, scale: 0.5 };
            write(pages, 40, encoding, &[item], &Progress::new()).unwrap();
            let back = read(pages, 40, encoding, &block, 0.5, &Progress::new()).unwrap();
            for (value, stored) in distances.iter().zip(back) {
                assert_eq!(stored, encoding.decode(encoding.encode(*value, 0.5), 0.5));
            }
        }
    }
}
