//! A level set as a closed triangle mesh with sharp features.
//!
//! # Theory
//!
//! The method is dual: one vertex for each surface patch of a cell and one quadrilateral for each crossed edge, whose
//! corners are the patches around the edge (Nielson, "Dual Marching Cubes", IEEE Visualization 2004). [`patches`]
//! divides the crossed edges of a cell among its patches by following segments over its faces. Both cells of a face
//! have the same segments, so the patches of all cells together form a closed two-manifold, and so does the mesh, its
//! dual. The one exception, two patches that share two segments, is removed in [`cells`].
//!
//! A vertex is the point of its cell that is nearest to the tangent planes at the crossings of its patch ([`qef`]; Ju,
//! Losasso, Schaefer and Warren, "Dual Contouring of Hermite Data", SIGGRAPH 2002). If the planes come from the source
//! of the field (a mesh, a shape), edges and corners of the source are reproduced. If they come from the samples, edges
//! and corners are only as sharp as the samples represent them.
//!
//! Vertices keep a small distance ([`MARGIN`]) from the faces of their cell that have crossed edges. The four corners
//! of a quadrilateral belong to the four cells around its edge. Seen along the edge, they therefore lie strictly inside
//! the four quadrants. Such a quadrilateral has a diagonal that divides it into two triangles of positive area, and
//! that diagonal is used: no face is degenerate, and none is folded over. Vertices that are equal in single precision are
//! moved apart ([`separate`]), so files without indices keep the two-manifold. They stay equal far from the origin, where
//! float32 is coarser than 1/512 of a voxel.
//!
//! # Practice
//!
//! Call [`LevelSurface::of_field`] or [`LevelSurface::of_blocks`], then [`LevelSurface::crossings`]. A source may
//! replace the planes of the crossings by its own; it then calls [`LevelSurface::probes`] and
//! [`LevelSurface::join_planes`]. [`LevelSurface::mesh`] comes last. The result does not depend on the number of
//! threads.

pub(crate) mod cells;
mod hermite;
mod links;
mod mesh;
pub(crate) mod patches;
mod probes;
pub(crate) mod qef;
mod quad;
mod separate;

pub use hermite::{planes_around_of_mesh, planes_of_mesh};
pub use mesh::SurfaceMesh;
pub use probes::{ExtraPlanes, Probes};

use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::sparse::SparseView;
use crate::volume::{FieldView, Texel, Trilinear};
use cells::{SurfaceCell, SurfaceCells};
use glam::DVec3;
use links::PatchLinks;
use rayon::prelude::*;

/// Smallest distance of a vertex from the faces of its cell, voxels.
pub const MARGIN: f64 = 1.0 / 1024.0;

/// Placement of the vertices, and treatment of the surface at the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshOptions {
    /// Whether vertices minimise the distance to the tangent planes; else they are the means of the crossings, moved
    /// onto the trilinear surface.
    pub sharp: bool,
    /// Whether a surface that leaves the box is closed by the faces of the box; else it ends there.
    pub capped: bool,
}

/// The crossed cells of a grid in world space.
#[derive(Debug)]
pub struct LevelSurface {
    lower: DVec3,
    upper: DVec3,
    spacing: DVec3,
    cells: SurfaceCells,
    links: PatchLinks,
}

/// The tangent plane of the surface where an edge crosses it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Position of the crossing, world units.
    pub on_edge: DVec3,
    /// Axis that the edge is parallel to.
    pub axis: u8,
    /// Fraction of the edge before the crossing, from 0 to 1.
    pub share: f64,
    /// A point of the plane, world units.
    pub point: DVec3,
    /// Unit normal, towards larger values.
    pub normal: DVec3,
    /// Whether the edge leaves the box: the plane is then a face of the box.
    pub on_box: bool,
}

impl LevelSurface {
    /// The surface where a stored field equals `level`; the inside is below it.
    pub fn of_field<T: Texel>(field: &FieldView<'_, T>, level: f32, progress: &Progress) -> Result<Self, Error> {
        check_level(level)?;
        check_shape(field.grid().shape)?;
        Ok(Self::new(field.grid(), SurfaceCells::of_field(field, level, progress)?))
    }

    /// The surface in blocks of samples; see [`SurfaceCells::of_blocks`].
    pub fn of_blocks(
        grid: &Grid,
        side: usize,
        origins: &[[i32; 3]],
        values: &[f32],
        level: f32,
    ) -> Result<Self, Error> {
        check_level(level)?;
        check_shape(grid.shape)?;
        let samples = (side + 1).pow(3);
        if values.len() != origins.len() * samples {
            let problem = format!("{} blocks need {samples} values each, got {}", origins.len(), values.len());
            return Err(ArgumentError::new("values", problem).into());
        }
        if values.iter().any(|value| !value.is_finite()) {
            return Err(ArgumentError::new("values", "must be finite").into());
        }
        let cells = SurfaceCells::of_blocks(grid.shape.map(|n| n as i32), side, origins, values, level);
        Ok(Self::new(grid, cells))
    }

    /// The surface where a sparse field equals `level`. Bricks are stored within the band alone, so a level beyond what
    /// every stored brick covers is an error.
    pub fn of_sparse<T: Texel>(field: &SparseView<'_, T>, level: f32, progress: &Progress) -> Result<Self, Error> {
        check_level(level)?;
        check_shape(field.grid().shape)?;
        if f64::from(level.abs()) > field.floor() {
            let problem = format!("{level} is beyond the band, samples are stored up to {} only", field.floor());
            return Err(ArgumentError::new("level", problem).into());
        }
        Ok(Self::new(field.grid(), SurfaceCells::of_sparse(field, level, progress)?))
    }

    fn new(grid: &Grid, cells: SurfaceCells) -> Self {
        let links = PatchLinks::new(&cells);
        Self { lower: grid.lower, upper: grid.upper, spacing: grid.spacing(), cells, links }
    }

    /// Number of crossed edges.
    pub fn edge_count(&self) -> usize {
        self.cells.edge_count()
    }

    /// Voxel size, world units.
    pub fn spacing(&self) -> DVec3 {
        self.spacing
    }

    /// World position of a voxel centre plus a fraction of a voxel.
    fn world(&self, index: [i32; 3], fraction: DVec3) -> DVec3 {
        self.lower + (DVec3::from_array(index.map(f64::from)) + 0.5 + fraction) * self.spacing
    }

    /// The crossings of all crossed edges, in order of their cells, from the samples alone: the root of the linear
    /// function along the edge, and the gradient of the samples there by central differences.
    pub fn crossings(&self) -> Vec<Crossing> {
        self.cells
            .cells()
            .par_iter()
            .flat_map_iter(|cell| (0..3).filter(|&axis| cell.owns(axis)).map(|axis| self.crossing(cell, axis)))
            .collect()
    }

    fn crossing(&self, cell: &SurfaceCell, axis: usize) -> Crossing {
        let far = 1 << axis;
        let [start, end] = [cell.values[0], cell.values[far]].map(f64::from);
        let share = start / (start - end);
        let mut fraction = DVec3::ZERO;
        fraction[axis] = share;
        let on_edge = self.world(cell.index, fraction);
        let mut gradient = DVec3::ZERO;
        gradient[axis] = end - start;
        let on_box = self.is_padding(cell.index[axis], axis) || self.is_padding(cell.index[axis] + 1, axis);
        if !on_box {
            for other in (0..3).filter(|&other| other != axis) {
                gradient[other] = self.slope(cell, [0, far], share, other);
            }
        }
        let gradient = gradient / self.spacing;
        let mut normal = gradient.normalize_or_zero();
        if normal == DVec3::ZERO {
            normal[axis] = (end - start).signum();
        }
        Crossing { on_edge, axis: axis as u8, share, point: on_edge, normal, on_box }
    }

    /// Difference of the field along the axis `other`, per voxel, at a fraction of the way from one corner of the cell
    /// to the next: the mean of the differences on both sides, or the one that does not use the padding.
    fn slope(&self, cell: &SurfaceCell, corners: [usize; 2], share: f64, other: usize) -> f64 {
        let step = 1 << other;
        let between = |cell: &SurfaceCell, offset: usize| {
            let [start, end] = corners.map(|corner| f64::from(cell.values[corner | offset]));
            start + (end - start) * share
        };
        let mut before = cell.index;
        before[other] -= 1;
        let upper = (!self.is_padding(cell.index[other] + 1, other)).then(|| between(cell, step) - between(cell, 0));
        let lower = (!self.is_padding(before[other], other))
            .then(|| self.cells.find(before))
            .flatten()
            .map(|cell| between(cell, step) - between(cell, 0));
        match (lower, upper) {
            (Some(lower), Some(upper)) => 0.5 * (lower + upper),
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => 0.0,
        }
    }

    /// The voxel centres that a crossed edge joins, world units.
    pub fn ends(&self, crossing: &Crossing) -> [DVec3; 2] {
        let mut step = DVec3::ZERO;
        step[usize::from(crossing.axis)] = self.spacing[usize::from(crossing.axis)];
        let start = crossing.on_edge - step * crossing.share;
        [start, start + step]
    }

    /// Whether a voxel index along an axis lies outside the grid.
    fn is_padding(&self, index: i32, axis: usize) -> bool {
        index < 0 || index >= self.cells.shape()[axis]
    }
}

fn check_level(level: f32) -> Result<(), Error> {
    if level.is_finite() {
        return Ok(());
    }
    Err(ArgumentError::new("level", format!("must be finite, got {level}")).into())
}

/// Indices of cells and vertices are 32 bits.
fn check_shape(shape: [usize; 3]) -> Result<(), Error> {
    if shape.iter().all(|&n| n < i32::MAX as usize) && shape[1].saturating_mul(shape[2]) < u32::MAX as usize {
        return Ok(());
    }
    Err(ArgumentError::new("distances", format!("{shape:?} voxels are too many for one mesh")).into())
}

#[cfg(test)]
mod tests;
