//! The crossed edges that bound each patch, and the patches around each crossed edge.

use super::cells::{NeighbourSearch, SurfaceCell, SurfaceCells};
use super::patches::edge_corners;

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
        let first = |cell: &SurfaceCell| firsts[cell.first_patch as usize];
        let edges = cells.for_parts(count as usize, 0, first, |cells_of_part, edges| {
            let (mut search, mut edges) = (cells.search(), edges.iter_mut());
            cells_of_part.iter().for_each(|cell| edges_of_cell(cell, &mut search, &mut edges));
        });
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
pub(super) fn edges_of(patch: u16) -> impl Iterator<Item = usize> {
    (0..12).filter(move |edge| patch >> edge & 1 == 1)
}

/// Indices of the crossed edges of a cell, patch by patch, into the next entries of `out`.
fn edges_of_cell<'a>(
    cell: &SurfaceCell,
    search: &mut NeighbourSearch<'_>,
    out: &mut impl Iterator<Item = &'a mut u32>,
) {
    // A cell has a few owners of edges, so each is searched once. An edge starts at the lower corner of its owner.
    let mut owners: [Option<&SurfaceCell>; 8] = [None; 8];
    for (edge, out) in cell.patches().flat_map(edges_of).zip(out) {
        let low = edge_corners(edge)[0];
        let step = std::array::from_fn(|axis| (low >> axis & 1) as i32);
        owners[low] = owners[low].or_else(|| search.find(cell, step));
        // The cell that owns a crossed edge is crossed, so it is found.
        *out = owners[low].map_or(0, |owner| owner.edge(edge / 4));
    }
}
