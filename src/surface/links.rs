//! The crossed edges that bound each patch, and the patches around each crossed edge.

use super::cells::{SurfaceCell, SurfaceCells, owner_of};
use rayon::prelude::*;

/// The incidence of patches and crossed edges, by their indices.
#[derive(Debug)]
pub(super) struct PatchLinks {
    /// First entry in `edges` of each patch, and the number of entries at the end.
    firsts: Vec<u32>,
    edges: Vec<u32>,
    around: Vec<[u32; 4]>,
}

impl PatchLinks {
    pub(super) fn new(cells: &SurfaceCells) -> Self {
        let mut firsts = Vec::with_capacity(cells.patch_count() + 1);
        firsts.push(0);
        let mut count = 0;
        for patch in cells.cells().iter().flat_map(SurfaceCell::patches) {
            count += patch.count_ones();
            firsts.push(count);
        }
        let edges: Vec<u32> = cells.cells().par_iter().flat_map_iter(|cell| edges_of_cell(cells, cell)).collect();
        let mut around = vec![[0; 4]; cells.edge_count()];
        let mut entries = edges.iter();
        for cell in cells.cells() {
            for (id, patch) in (cell.first_patch..).zip(cell.patches()) {
                for (edge, &number) in edges_of(patch).zip(&mut entries) {
                    // An edge on the upper side of a cell along u or v has this cell on its lower side. The order is
                    // counter-clockwise seen from the far end of the edge.
                    around[number as usize][[0, 1, 3, 2][edge % 4]] = id;
                }
            }
        }
        Self { firsts, edges, around }
    }

    /// The crossed edges of a patch.
    pub(super) fn edges_of(&self, patch: u32) -> &[u32] {
        &self.edges[self.firsts[patch as usize] as usize..self.firsts[patch as usize + 1] as usize]
    }

    /// The patches around a crossed edge, counter-clockwise seen from its far end.
    pub(super) fn patches_around(&self, edge: u32) -> [u32; 4] {
        self.around[edge as usize]
    }
}

/// Edges of a cell in a set of edges.
fn edges_of(patch: u16) -> impl Iterator<Item = usize> {
    (0..12).filter(move |edge| patch >> edge & 1 == 1)
}

/// Indices of the crossed edges of a cell, patch by patch.
fn edges_of_cell(cells: &SurfaceCells, cell: &SurfaceCell) -> impl Iterator<Item = u32> {
    // A cell has a few owners of edges, so each is searched once.
    let mut owners: [Option<&SurfaceCell>; 8] = [None; 8];
    cell.patches().flat_map(edges_of).map(move |edge| {
        let (index, axis) = owner_of(cell, edge);
        let offset: usize = (0..3).map(|axis| ((index[axis] - cell.index[axis]) as usize) << axis).sum();
        let owner = owners[offset].or_else(|| cells.find(index));
        owners[offset] = owner;
        // The cell that owns a crossed edge is crossed, so it is found.
        owner.map_or(0, |owner| owner.edge(axis))
    })
}
