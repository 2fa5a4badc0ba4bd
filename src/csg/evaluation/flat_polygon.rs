//! Polygons in local units, with the grid over their edges; see [`crate::csg::tree::edge_grid`].

use super::scalar::Scalar;
use crate::csg::tree::edge_grid::EDGE_VALUES;
use crate::csg::tree::region::Region;
use std::sync::Arc;

/// A polygon in local units, with the lists of its grid.
#[derive(Debug, Clone)]
pub struct FlatPolygon<F> {
    region: Arc<Region>,
    lower: [F; 2],
    inverse: F,
    pub edges: Vec<[F; EDGE_VALUES]>,
    /// All edges, for points without values.
    everywhere: Vec<u32>,
}

impl<F: Scalar> FlatPolygon<F> {
    pub fn new(region: &Arc<Region>, scale: f64) -> Self {
        let grid = &region.grid;
        let placed = |edge: &[f64; EDGE_VALUES]| -> [F; EDGE_VALUES] {
            // The ends are lengths, the pseudonormals are directions.
            std::array::from_fn(|i| F::of(if i < 4 { scale * edge[i] } else { edge[i] }))
        };
        Self {
            region: region.clone(),
            lower: (scale * grid.lower).to_array().map(F::of),
            inverse: F::of(grid.inverse / scale),
            edges: grid.edges.iter().map(placed).collect(),
            everywhere: if F::IS_SYMBOLIC { (0..grid.edges.len() as u32).collect() } else { Vec::new() },
        }
    }

    /// The edges among which the nearest to a point is.
    #[inline(always)]
    pub fn near(&self, x: F, y: F) -> &[u32] {
        if F::IS_SYMBOLIC {
            return &self.everywhere;
        }
        let grid = &self.region.grid;
        let cell = [(x - self.lower[0]) * self.inverse, (y - self.lower[1]) * self.inverse].map(Scalar::widen);
        let is_within = (0..2).all(|axis| cell[axis] >= 0.0 && cell[axis] < f64::from(grid.counts[axis]));
        let list = if is_within { 1 + cell[0] as usize + grid.counts[0] as usize * cell[1] as usize } else { 0 };
        &grid.listed[grid.starts[list] as usize..grid.starts[list + 1] as usize]
    }

    /// The tables in the order of `shaders/shared/csg/csg_leaves.wgsl`.
    pub fn numbers(&self) -> Vec<f32> {
        let grid = &self.region.grid;
        let narrow = |x: F| x.widen() as f32;
        let starts = 6;
        let lists = starts + grid.starts.len();
        let edges = lists + grid.listed.len();
        let mut out = vec![narrow(self.lower[0]), narrow(self.lower[1]), narrow(self.inverse)];
        out.extend([grid.counts[0] as f32, grid.counts[1] as f32, edges as f32]);
        out.extend(grid.starts.iter().map(|&start| (lists + start as usize) as f32));
        out.extend(grid.listed.iter().map(|&edge| edge as f32));
        out.extend(self.edges.iter().flatten().map(|&x| narrow(x)));
        out
    }

    /// Number of edges in the longest list.
    pub fn longest_list(&self) -> usize {
        self.region.grid.starts.windows(2).map(|ends| (ends[1] - ends[0]) as usize).max().unwrap_or(0)
    }
}
