//! Vertices with equal positions in single precision.
//!
//! Files such as STL have no indices, and their readers join vertices at the same float32 position. If two sheets of
//! the surface touch there, the joined vertex has two fans of faces, and an edge may get four faces. Vertices inside
//! different cells are two margins apart ([`MARGIN`]), so equal positions occur for two patches of one cell, and for
//! vertices outside their cells, as at the tip of a corner. Patches of one cell are moved apart within the cell, which
//! folds no quadrilateral. Vertices outside their cells are moved towards their own cell.

use super::{LevelSurface, MARGIN};
use glam::DVec3;
use rayon::prelude::*;

/// Length of one step apart, voxels. The patches of a cell are at most four, so they stay within a margin.
const STEP: f64 = MARGIN / 4.0;

/// Longest step apart, voxels. Far from the origin, float32 is too coarse for shorter ones.
const FARTHEST: f64 = 1.0 / 256.0;

/// Number of passes. A moved vertex may get the position of another one, which the next pass moves.
const PASSES: usize = 8;

impl LevelSurface {
    /// Moves vertices until no two of them are equal in single precision. Returns the patches of those that have moved.
    /// Positions remain equal far from the origin, where that would move them by more than [`FARTHEST`].
    pub(super) fn separate(&self, vertices: &mut [DVec3]) -> Vec<u32> {
        // The distance between neighbouring float32 numbers is at most this.
        let rounding = self.lower.abs().max(self.upper.abs()) * f64::from(f32::EPSILON);
        let step = (self.spacing * STEP).max(2.0 * rounding);
        if step.cmpgt(FARTHEST * self.spacing).any() {
            return Vec::new();
        }
        let mut moved = Vec::new();
        for _ in 0..PASSES {
            let equal = equal_positions(vertices);
            if equal.is_empty() {
                break;
            }
            for (count, id) in equal {
                moved.push(id);
                let cell = self.cells.of_patch(id);
                let corner = self.world(cell.index, DVec3::ZERO);
                let [lower, upper] = self.region(cell, 0);
                let place = vertices[id as usize] - corner;
                let nearest = place.clamp(lower, upper);
                let step = step * f64::from(count);
                let at = |place: DVec3| self.in_box(corner + place);
                if (place - nearest).abs().cmple(step).all() {
                    // Towards the farther corner of the cell, so that the vertex stays in it.
                    let towards = DVec3::select(nearest.cmpgt(0.5 * (lower + upper)), DVec3::NEG_ONE, DVec3::ONE);
                    vertices[id as usize] = at((nearest + towards * step).clamp(lower, upper));
                } else {
                    vertices[id as usize] = at(place + (nearest - place).clamp(-step, step));
                    if self.folds_around(id, vertices) {
                        vertices[id as usize] = at(nearest);
                    }
                }
            }
        }
        moved
    }
}

/// The vertices at the float32 position of another one, except the first at each position: their number among those at
/// the position, from 1, and their index.
fn equal_positions(vertices: &[DVec3]) -> Vec<(u32, u32)> {
    // The sum with zero turns -0 into 0.
    let key = |id: usize| {
        let [x, y, z] = vertices[id].as_vec3().to_array().map(|x| (x + 0.0).to_bits());
        (u64::from(x) << 32 | u64::from(y), z, id as u32)
    };
    let mut keys: Vec<(u64, u32, u32)> = (0..vertices.len()).into_par_iter().map(key).collect();
    keys.par_sort_unstable();
    let groups = keys.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).filter(|group| group.len() > 1);
    groups.flat_map(|group| group.iter().enumerate().skip(1).map(|(count, &(.., id))| (count as u32, id))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{ExtraPlanes, MeshOptions};
    use super::*;
    use crate::grid::Grid;
    use crate::progress::Progress;
    use crate::volume::FieldView;

    #[test]
    fn equal_positions_are_found_once_each() {
        let vertices = [DVec3::ONE, DVec3::ZERO, DVec3::ONE + 1e-9, -DVec3::ZERO, DVec3::ONE, DVec3::ONE + 1e-6];
        let mut found = equal_positions(&vertices);
        found.sort_unstable();
        assert_eq!(found, [(1, 2), (1, 3), (2, 4)]);
    }

    #[test]
    fn vertices_at_one_position_are_moved_apart_within_their_cells() {
        // Inside at opposite corners of one cell: two patches, whose vertices are put at the same place.
        let grid = Grid::new(DVec3::splat(100.0), DVec3::splat(102.0), [2, 2, 2]).unwrap();
        let distances = [-0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, -0.5];
        let field = FieldView::new(grid, &distances).unwrap();
        let surface = LevelSurface::of_field(&field, 0.0, &Progress::new()).unwrap();
        let options = MeshOptions { sharp: true, capped: true };
        let mut vertices = surface.vertices(&surface.crossings(), &ExtraPlanes::default(), options, false).places;
        let middle = surface.cells.cells().iter().find(|cell| cell.index == [0; 3]).unwrap();
        let ids: Vec<u32> = (middle.first_patch..).zip(middle.patches()).map(|(id, _)| id).collect();
        assert_eq!(ids.len(), 2);
        for place in [DVec3::splat(101.0), DVec3::splat(100.5 + MARGIN)] {
            ids.iter().for_each(|&id| vertices[id as usize] = place);
            assert_eq!(surface.separate(&mut vertices), [ids[1]]);
            assert!(equal_positions(&vertices).is_empty());
            assert_eq!(vertices[ids[0] as usize], place);
            let moved = vertices[ids[1] as usize];
            assert!(moved.cmpge(DVec3::splat(100.5)).all() && moved.cmple(DVec3::splat(101.5)).all());
            assert!(surface.separate(&mut vertices).is_empty());
        }
    }
}
