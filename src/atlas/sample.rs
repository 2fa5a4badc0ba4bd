//! Sampling of a field in an atlas, equal to sampling of the volume.
//!
//! # Theory
//!
//! A point lies between two slices. In each of them the field is bilinear in x and y, as a 2D sampler returns it.
//! Linear interpolation between the two values is the trilinear function. The outer half voxel repeats the border;
//! along z the same slice is read twice.
//!
//! The article "Packing 3D SDF to a 2D Texture" takes one tap in the slice that contains the point, so its field has a
//! step at every slice.
//!
//! # Practice
//!
//! Twin of `shaders/atlas/sampling.wgsl`. Offsets of the slices are computed once per view.

use super::AtlasBlock;
use crate::encoding::Encoding;
use crate::grid::Grid;
use crate::volume::outside::bound_outside;
use crate::volume::{Cell, Trilinear};
use glam::{DVec2, DVec3, IVec3};

/// A field that lies in the pages of an atlas.
pub(crate) struct AtlasField<'a> {
    grid: Grid,
    page: &'a [u8],
    row_texels: usize,
    encoding: Encoding,
    scale: f32,
    /// Texel of voxel (0, 0, z), for every slice.
    slices: Vec<usize>,
}

impl<'a> AtlasField<'a> {
    /// The block must be sound on these pages, and have the shape of the grid.
    pub(crate) fn new(
        pages: &'a [u8],
        page_size: u32,
        encoding: Encoding,
        scale: f32,
        block: &AtlasBlock,
        grid: Grid,
    ) -> Self {
        let row_texels = page_size as usize;
        let page_bytes = row_texels * row_texels * encoding.bytes();
        let slices = (0..block.shape[2])
            .map(|z| {
                let [x, y] = block.slice(z);
                y as usize * row_texels + x as usize
            })
            .collect();
        let page = &pages[block.page as usize * page_bytes..][..page_bytes];
        Self { grid, page, row_texels, encoding, scale, slices }
    }

    /// The samples at the corners of a cell, for texels of `N` bytes: four of a slice, then four of the next.
    #[inline]
    fn corners<const N: usize>(&self, index: IVec3) -> [f32; 8] {
        let [nx, ny, nz] = self.grid.shape;
        let clamp = |i: i32, n: usize| (i.max(0) as usize).min(n - 1);
        let (x0, x1) = (clamp(index.x, nx), clamp(index.x + 1, nx));
        let (y0, y1) = (clamp(index.y, ny) * self.row_texels, clamp(index.y + 1, ny) * self.row_texels);
        let (z0, z1) = (self.slices[clamp(index.z, nz)], self.slices[clamp(index.z + 1, nz)]);
        [z0 + y0 + x0, z0 + y0 + x1, z0 + y1 + x0, z0 + y1 + x1, z1 + y0 + x0, z1 + y0 + x1, z1 + y1 + x0, z1 + y1 + x1]
            .map(|texel| self.encoding.decode(bits::<N>(self.page, texel), self.scale))
    }
}

impl Trilinear for AtlasField<'_> {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    #[inline]
    fn cell(&self, index: IVec3) -> Cell {
        let corners = match self.encoding {
            Encoding::Float32 => self.corners::<4>(index),
            Encoding::Float16 | Encoding::Snorm16 => self.corners::<2>(index),
            Encoding::Snorm8 => self.corners::<1>(index),
        };
        Cell { corners, first: index, size: 1 }
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        bound_outside(self, p, inner)
    }
}

/// The bits of a texel of `N` bytes.
#[inline]
fn bits<const N: usize>(page: &[u8], texel: usize) -> u32 {
    let mut word = [0; 4];
    word[..N].copy_from_slice(&page[texel * N..][..N]);
    u32::from_le_bytes(word)
}

/// Texture coordinates of points on the page, 0 to 1: `ConvertWorldToTexture` of the article. Points outside the box
/// are moved to its nearest point; z selects the slice.
pub(crate) fn texture_coordinates(block: &AtlasBlock, page_size: u32, grid: &Grid, points: &[DVec3]) -> Vec<[f64; 2]> {
    let last = block.shape[2] - 1;
    let shape = DVec3::from_array(block.shape.map(f64::from));
    points
        .iter()
        .map(|&p| {
            // Texels counted from the corner of the box: the centre of voxel 0 is at 0.5.
            let texture = ((p - grid.lower) / grid.spacing()).max(DVec3::ZERO).min(shape);
            let slice = block.slice((texture.z as u32).min(last)).map(f64::from);
            ((DVec2::from_array(slice) + texture.truncate()) / f64::from(page_size)).to_array()
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::super::Layout;
    use super::super::plan::plan;
    use super::super::texels::{Item, write};
    use super::*;
    use crate::progress::Progress;
    use crate::volume::{FieldView, SampleFilter};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn an_atlas_and_its_volume_are_the_same_function(
            shape in prop::array::uniform3(1..7usize),
            gutter in 0..3u32,
            seed in 0..1000u32,
            points in prop::collection::vec((-1.2..1.2f64, -1.2..1.2f64, -1.2..1.2f64), 1..20),
        ) {
            let grid = Grid::new(DVec3::new(-1.0, -0.5, -0.8), DVec3::new(1.0, 0.75, 1.0), shape).unwrap();
            let distances: Vec<f32> =
                (0..grid.len() as u32).map(|i| ((i * 7919 + seed * 31) % 2003) as f32 / 1001.0 - 1.0).collect();
            let view = FieldView::new(grid, &distances).unwrap();
            let mut points: Vec<DVec3> = points.into_iter().map(DVec3::from).collect();
            points.extend([grid.lower, grid.upper, grid.center(0, 0, 0), DVec3::new(1.0, 0.0, 0.0)]);
            let inner = [DVec3::splat(-0.3), DVec3::splat(0.3)];
            let block = plan(Layout::Shelves { gutter }, 32, 1, &[], &[shape.map(|n| n as u32)]).unwrap()[0];

            let mut pages = vec![0f32; 32 * 32];
            let item = Item { block, distances: &distances, scale: 1.0 };
            write(bytemuck::cast_slice_mut(&mut pages), 32, Encoding::Float32, &[item], &Progress::new()).unwrap();
            let field = AtlasField::new(bytemuck::cast_slice(&pages), 32, Encoding::Float32, 1.0, &block, grid);
            for filter in [SampleFilter::Linear, SampleFilter::Nearest] {
                prop_assert_eq!(
                    field.sample(&points, inner, filter, &Progress::new()).unwrap(),
                    view.sample(&points, inner, filter, &Progress::new()).unwrap()
                );
            }
        }
    }

    #[test]
    fn texture_coordinates_are_the_articles() {
        let n = 8.0;
        let grid = Grid::new(DVec3::new(-1.0, 2.0, 5.0), DVec3::new(1.0, 3.0, 9.0), [8; 3]).unwrap();
        let block = plan(Layout::Strips, 128, 1, &[], &[[8; 3]; 4]).unwrap()[3];
        for p in [DVec3::new(-0.3, 2.2, 8.1), DVec3::new(0.9, 2.9, 5.05), DVec3::new(0.0, 2.5, 7.0)] {
            let texture = (p - grid.lower) / ((grid.upper - grid.lower) / n);
            let expected = [texture.x / 128.0 + texture.z.floor() * n / 128.0, texture.y / 128.0 + 3.0 * n / 128.0];
            let found = texture_coordinates(&block, 128, &grid, &[p])[0];
            assert!((found[0] - expected[0]).abs() < 1e-12 && (found[1] - expected[1]).abs() < 1e-12);
        }
    }
}
