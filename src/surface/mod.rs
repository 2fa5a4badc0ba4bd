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
//! of the field (a mesh, a shape), edges and corners of the source are reproduced, and vertices within their cells are
//! corrected by the planes of the source close to them ([`probes`]). If the planes come from the samples, edges and
//! corners are only as sharp as the samples represent them.
//!
//! Vertices keep a small distance ([`MARGIN`]) from the faces of their cell that have crossed edges. The four corners
//! of a quadrilateral belong to the four cells around its edge. Seen along the edge, they therefore lie strictly inside
//! the four quadrants. Such a quadrilateral has a diagonal that divides it into two triangles of positive area, and
//! that diagonal is used: no face is degenerate, and none is folded over. Vertices that are equal in single precision
//! are moved apart ([`separate`]), so files without indices keep the two-manifold. They stay equal far from the origin,
//! where float32 is coarser than 1/512 of a voxel.
//!
//! Faces of different quadrilaterals may still pass through each other, in thin walls and beside vertices outside
//! their cells. [`untangle`] finds them by exact predicates, and [`division`] divides their quadrilaterals so that
//! their faces stay in the cells. The mesh therefore never crosses itself. On a curved source, [`refine`] then divides
//! faces that are far from it, as long as none crosses another one.
//!
//! # Practice
//!
//! Call [`LevelSurface::of_field`] or [`SurfaceBlocks::surface`], then [`LevelSurface::crossings`]. A source may
//! replace the planes of the crossings by its own; it then calls [`LevelSurface::probes`] and
//! [`LevelSurface::join_planes`]. [`LevelSurface::into_mesh`] comes last. The result does not depend on the number of
//! threads.

mod blocks;
pub(crate) mod cells;
mod division;
mod hermite;
mod links;
mod mesh;
pub(crate) mod patches;
pub(crate) mod probes;
pub(crate) mod qef;
mod quad;
mod refine;
mod separate;
mod settle;
mod untangle;

pub use blocks::SurfaceBlocks;
pub use hermite::{planes_around_of_mesh, planes_around_of_offset, planes_of_mesh};
pub use mesh::SurfaceMesh;
pub use probes::{ExtraPlanes, Probes};

use crate::error::{ArgumentError, Error};
use crate::grid::Grid;
use crate::progress::Progress;
use crate::volume::sparse::SparseView;
use crate::volume::{FieldView, Texel, Trilinear};
use cells::{NeighbourSearch, SurfaceCell, SurfaceCells, edges_from};
use glam::DVec3;
use links::PatchLinks;

/// Smallest distance of a vertex from the faces of its cell, voxels.
pub const MARGIN: f64 = 1.0 / 1024.0;

/// Placement of the vertices, and treatment of the surface at the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MeshOptions {
    /// Whether vertices minimise the distance to the tangent planes; else they are the means of the crossings, moved
    /// onto the surface.
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
    /// Lower and upper corner of the box of the vertices: the box of the grid, or the part of it around the solid.
    within: [DVec3; 2],
    /// Whether the crossings and their planes come from the source of the field, and not from its samples.
    is_exact: bool,
    cells: SurfaceCells,
    links: PatchLinks,
}

/// The tangent plane of the surface where an edge crosses it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Crossing {
    /// Unit normal of the plane, towards larger values.
    pub normal: DVec3,
    /// Distance from the crossing to the plane along the normal, world units.
    pub height: f64,
    /// Fraction of the edge before the crossing, from 0 to 1.
    pub share: f32,
    /// Whether the edge leaves the box: the plane is then a face of the box.
    pub on_box: bool,
}

impl Crossing {
    /// Replaces the plane by one through `point`. `on_edge` is the crossing, and the normal of the plane may face
    /// either side.
    pub(crate) fn set_plane(&mut self, on_edge: DVec3, point: DVec3, normal: DVec3) {
        // The plane faces the larger values of the samples.
        self.normal = if normal.dot(self.normal) < 0.0 { -normal } else { normal };
        self.height = (point - on_edge).dot(self.normal);
    }
}

/// A crossed edge of the grid.
#[derive(Debug, Clone, Copy)]
pub struct CrossedEdge {
    /// The voxel centre where it starts, world units.
    pub start: DVec3,
    /// From its start to its end, world units.
    pub along: DVec3,
}

impl CrossedEdge {
    /// The point at a fraction of the edge.
    pub fn at(&self, share: f32) -> DVec3 {
        self.start + self.along * f64::from(share)
    }
}

impl LevelSurface {
    /// The surface where a stored field equals `level`; the inside is below it.
    pub fn of_field<T: Texel>(field: &FieldView<'_, T>, level: f32, progress: &Progress) -> Result<Self, Error> {
        check_level(level)?;
        check_shape(field.grid().shape)?;
        Ok(Self::new(field.grid(), SurfaceCells::of_field(field, level, progress)?))
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
        let within = [grid.lower, grid.upper];
        Self { lower: grid.lower, upper: grid.upper, spacing: grid.spacing(), within, is_exact: false, cells, links }
    }

    /// States that the crossings are roots of the source of the field, with its tangent planes.
    pub fn set_exact(&mut self) {
        self.is_exact = true;
    }

    /// Keeps all vertices in a box around the solid, world units.
    pub fn keep_within(&mut self, [lower, upper]: [DVec3; 2]) {
        let [low, high] = self.within;
        self.within = [low.max(lower).min(high), high.min(upper).max(low)];
    }

    /// The nearest point of the box of the vertices.
    fn in_box(&self, place: DVec3) -> DVec3 {
        place.max(self.within[0]).min(self.within[1])
    }

    /// Number of crossed edges.
    pub fn edge_count(&self) -> usize {
        self.cells.edge_count()
    }

    /// Number of crossed cells.
    pub fn cell_count(&self) -> usize {
        self.cells.cells().len()
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
        let empty = Crossing { normal: DVec3::ZERO, height: 0.0, share: 0.0, on_box: false };
        self.cells.for_edges(empty, |cells, crossings| {
            let mut search = self.cells.search();
            for ((cell, axis), crossing) in edges_from(cells).zip(crossings) {
                *crossing = self.crossing(cell, axis, &mut search);
            }
        })
    }

    fn crossing(&self, cell: &SurfaceCell, axis: usize, search: &mut NeighbourSearch<'_>) -> Crossing {
        let far = 1 << axis;
        let [start, end] = [cell.values[0], cell.values[far]].map(f64::from);
        let share = start / (start - end);
        let mut gradient = DVec3::ZERO;
        gradient[axis] = end - start;
        let on_box = self.is_padding(cell.index[axis], axis) || self.is_padding(cell.index[axis] + 1, axis);
        if !on_box {
            for other in (0..3).filter(|&other| other != axis) {
                gradient[other] = self.slope(cell, [0, far], share, other, search);
            }
        }
        let gradient = gradient / self.spacing;
        let mut normal = gradient.normalize_or_zero();
        if normal == DVec3::ZERO {
            normal[axis] = (end - start).signum();
        }
        Crossing { normal, height: 0.0, share: share as f32, on_box }
    }

    /// Difference of the field along the axis `other`, per voxel, at a fraction of the way from one corner of the cell
    /// to the next: the mean of the differences on both sides, or the one that does not use the padding.
    fn slope(
        &self,
        cell: &SurfaceCell,
        corners: [usize; 2],
        share: f64,
        other: usize,
        search: &mut NeighbourSearch<'_>,
    ) -> f64 {
        let step = 1 << other;
        let between = |cell: &SurfaceCell, offset: usize| {
            let [start, end] = corners.map(|corner| f64::from(cell.values[corner | offset]));
            start + (end - start) * share
        };
        let mut before = [0; 3];
        before[other] = -1;
        let upper = (!self.is_padding(cell.index[other] + 1, other)).then(|| between(cell, step) - between(cell, 0));
        let lower = (!self.is_padding(cell.index[other] - 1, other))
            .then(|| search.find(cell, before))
            .flatten()
            .map(|cell| between(cell, step) - between(cell, 0));
        match (lower, upper) {
            (Some(lower), Some(upper)) => 0.5 * (lower + upper),
            (Some(one), None) | (None, Some(one)) => one,
            (None, None) => 0.0,
        }
    }

    /// The crossed edge with an index among all crossed edges.
    pub fn edge(&self, edge: usize) -> CrossedEdge {
        let (cell, axis) = self.cells.of_edge(edge as u32);
        let mut along = DVec3::ZERO;
        along[axis] = self.spacing[axis];
        CrossedEdge { start: self.world(cell.index, DVec3::ZERO), along }
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

/// Number of voxels along an axis from which a grid is too large. A block of cells may begin in the grid and be longer
/// than it, and its end must fit in 32 bits.
const MOST_VOXELS: usize = 1 << 30;

/// Indices of cells and vertices are 32 bits.
fn check_shape(shape: [usize; 3]) -> Result<(), Error> {
    if shape.iter().all(|&n| n < MOST_VOXELS) && shape[1].saturating_mul(shape[2]) < u32::MAX as usize {
        return Ok(());
    }
    Err(ArgumentError::new("distances", format!("{shape:?} voxels are too many for one mesh")).into())
}

#[cfg(test)]
mod tests;
