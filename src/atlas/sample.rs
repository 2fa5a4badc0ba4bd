//! A field read from an atlas: the same function as the volume's own.
//!
//! # Theory
//!
//! A point lies between two slices. In each of them the field is bilinear in x and y, which is what a 2D sampler returns;
//! a linear step between the two values is the trilinear function. The outer half voxel repeats the border, along z by
//! taking the same slice twice.
//!
//! The article "Packing 3D SDF to a 2D Texture" takes one tap in the slice that holds the point, so its field has a step
//! at every slice. That is [`AtlasFilter::Slice`], to compare with.
//!
//! # Practice
//!
//! Twin of `shaders/shared/atlas.wgsl`. Offsets of the slices are found once for each view.

use super::Block;
use crate::encoding::Encoding;
use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::outside::distance_bound;
use crate::volume::{batch, lerp, trilinear};
use glam::{DVec2, DVec3, IVec3};

/// How a value is made from the texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum AtlasFilter {
    /// Two bilinear taps and a step along z: the trilinear field.
    #[default]
    Linear,
    /// The texel of the voxel that holds the point.
    Nearest,
    /// The article's: one bilinear tap in the slice that holds the point.
    Slice,
}

impl AtlasFilter {
    /// The filter that the Python interface calls `name`.
    pub fn from_name(name: &str) -> Result<Self, ArgumentError> {
        match name {
            "linear" => Ok(Self::Linear),
            "nearest" => Ok(Self::Nearest),
            "slice" => Ok(Self::Slice),
            _ => Err(ArgumentError::new(
                "filter",
                format!("expected \"linear\", \"nearest\" or \"slice\", got {name:?}"),
            )),
        }
    }
}

/// A field that lies in the pages of an atlas.
pub struct AtlasField<'a> {
    grid: Grid,
    page: &'a [u8],
    row_texels: usize,
    encoding: Encoding,
    scale: f32,
    /// Texel of voxel (0, 0, z), for every slice.
    slices: Vec<usize>,
}

impl<'a> AtlasField<'a> {
    /// The block must be sound on these pages, and of the grid's shape.
    pub fn new(pages: &'a [u8], page_size: u32, encoding: Encoding, scale: f32, block: &Block, grid: Grid) -> Self {
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

    /// Field at many points of its own space; outside the box a lower bound on the distance to a surface in the box
    /// `inner`, as `FieldView::sample` has it.
    pub fn sample(
        &self,
        points: &[DVec3],
        inner: [DVec3; 2],
        filter: AtlasFilter,
        progress: &Progress,
    ) -> Result<Vec<f32>, Error> {
        // The encoding is fixed for the batch: each gets its own loop.
        match self.encoding {
            Encoding::Float32 => self.sample_as(texel::<4>, points, inner, filter, progress),
            Encoding::Float16 | Encoding::Snorm16 => self.sample_as(texel::<2>, points, inner, filter, progress),
            Encoding::Snorm8 => self.sample_as(texel::<1>, points, inner, filter, progress),
        }
    }

    fn sample_as(
        &self,
        bits: impl Fn(&[u8], usize) -> u32 + Sync,
        points: &[DVec3],
        inner: [DVec3; 2],
        filter: AtlasFilter,
        progress: &Progress,
    ) -> Result<Vec<f32>, Error> {
        let at = |texel: usize| self.encoding.decode(bits(self.page, texel), self.scale);
        batch(points, progress, |p| {
            if p.is_nan() {
                return f32::NAN;
            }
            if !self.grid.contains(p) {
                return distance_bound(&self.grid, |cell| self.corners(&at, cell), p, inner);
            }
            match filter {
                AtlasFilter::Linear => {
                    let (cell, fraction) = self.grid.locate(p);
                    trilinear(&self.corners(&at, cell), fraction)
                }
                AtlasFilter::Nearest => {
                    let [x, y, z] = self.grid.nearest_voxel(p);
                    at(self.slices[z] + y * self.row_texels + x)
                }
                AtlasFilter::Slice => {
                    let (cell, fraction) = self.grid.locate(p);
                    let [_, _, z] = self.grid.nearest_voxel(p);
                    let c = self.corners(&at, cell.with_z(z as i32));
                    lerp(lerp(c[0], c[1], fraction.x), lerp(c[2], c[3], fraction.x), fraction.y)
                }
            }
        })
    }

    /// The samples at the corners of a cell, as `FieldView::corners` has them: the four of a slice, then of the next.
    #[inline]
    fn corners(&self, at: &impl Fn(usize) -> f32, cell: IVec3) -> [f32; 8] {
        let [nx, ny, nz] = self.grid.shape;
        let clamp = |i: i32, n: usize| (i.max(0) as usize).min(n - 1);
        let (x0, x1) = (clamp(cell.x, nx), clamp(cell.x + 1, nx));
        let (y0, y1) = (clamp(cell.y, ny) * self.row_texels, clamp(cell.y + 1, ny) * self.row_texels);
        let (z0, z1) = (self.slices[clamp(cell.z, nz)], self.slices[clamp(cell.z + 1, nz)]);
        [
            at(z0 + y0 + x0),
            at(z0 + y0 + x1),
            at(z0 + y1 + x0),
            at(z0 + y1 + x1),
            at(z1 + y0 + x0),
            at(z1 + y0 + x1),
            at(z1 + y1 + x0),
            at(z1 + y1 + x1),
        ]
    }
}

/// The bits of a texel of `N` bytes.
#[inline]
fn texel<const N: usize>(page: &[u8], texel: usize) -> u32 {
    let mut word = [0; 4];
    word[..N].copy_from_slice(&page[texel * N..][..N]);
    u32::from_le_bytes(word)
}

/// Where points fall on the page, 0 to 1 across it: the article's `ConvertWorldToTexture`. Points outside the box are
/// moved to its nearest point; z chooses the slice.
pub fn texture_coordinates(block: &Block, page_size: u32, grid: &Grid, points: &[DVec3]) -> Vec<[f64; 2]> {
    let last = block.shape[2] - 1;
    points
        .iter()
        .map(|&p| {
            // Texels from the box's corner: the centre of voxel 0 lies at 0.5.
            let texture = grid.clamp_to_box(grid.grid_from_world(p)) + 0.5;
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
    use crate::volume::{FieldView, Filter};
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
            for (ours, theirs) in [(AtlasFilter::Linear, Filter::Linear), (AtlasFilter::Nearest, Filter::Nearest)] {
                prop_assert_eq!(
                    field.sample(&points, inner, ours, &Progress::new()).unwrap(),
                    view.sample(&points, inner, theirs, &Progress::new()).unwrap()
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
