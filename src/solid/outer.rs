//! Samples of a grid outside the outer surface of a mesh: a flood from the box reaches them.
//!
//! *Theory.* The flood walks from sample to sample along the axes and does not cross a triangle. Blocks of 8^3 samples
//! that no triangle comes near are one node of the walk; in all others each sample is one. A step needs a test for a
//! crossing only where the distances at its ends add up to its length or less.
//!
//! With a seal of radius r the flood first visits only samples farther than r plus half a voxel from the mesh, which
//! cannot pass an opening of radius r. The remaining samples follow in the order of their distance, largest first: each
//! takes the side of its neighbour with the largest distance, so it climbs the distance field to the space that it
//! belongs to. The two spaces meet where the distance is smallest between them, in the middle of an opening (a
//! watershed). A sample without a higher neighbour lies in a gap that is too narrow, which is inside.

use crate::bvh::rays::watertight::Ray;
use crate::error::Error;
use crate::grid::Grid;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// Samples along the side of a block.
const SIDE: usize = 8;
const SAMPLES: usize = SIDE * SIDE * SIDE;

/// Margin for the rounding of float32 distances, relative to 1 plus the largest coordinate.
const ROUNDING: f64 = 1e-6;

/// The samples of a grid that lie outside.
#[derive(Debug)]
pub struct OuterSides {
    shape: [usize; 3],
    blocks: [usize; 3],
    states: Vec<FloodBlock>,
    /// Distances of the samples of near blocks, local units, x fastest.
    distances: Vec<[f32; SAMPLES]>,
    outside: Vec<[bool; SAMPLES]>,
}

#[derive(Debug, Clone, Copy)]
enum FloodBlock {
    /// No triangle is near. The value is true once the flood has reached the block.
    Far(bool),
    /// Triangles are near. The value is its index among such blocks.
    Near(u32),
}

/// A flood in progress.
struct Flood<'a> {
    mesh: &'a Mesh,
    sides: OuterSides,
    /// Centre of voxel (0, 0, 0) and size of a voxel, local units.
    first: DVec3,
    spacing: DVec3,
    queue: Vec<[usize; 3]>,
}

impl OuterSides {
    /// Flood a grid around a mesh. Openings up to twice `radius` wide, world units, are closed.
    pub fn new(mesh: &Mesh, grid: &Grid, radius: f64, progress: &Progress) -> Result<Self, Error> {
        let shape = grid.shape;
        let blocks = shape.map(|n| n.div_ceil(SIDE));
        let first = mesh.local_from_world(grid.center(0, 0, 0));
        let spacing = grid.spacing() / mesh.scale();
        let radius = radius / mesh.scale();
        // A step of the first flood is a voxel long, so it could jump through an opening by half of that.
        let core = if radius > 0.0 { radius + 0.5 * spacing.max_element() } else { 0.0 };
        let half = 0.5 * SIDE as f64 * spacing.length();
        let reach = half + core + spacing.max_element();
        mesh.bvh();
        let is_near: Vec<bool> = (0..blocks.iter().product::<usize>())
            .into_par_iter()
            .map(|i| {
                let at = [i % blocks[0], i / blocks[0] % blocks[1], i / (blocks[0] * blocks[1])];
                let center = first + (DVec3::from(at.map(|b| (b * SIDE) as f64)) + 0.5 * (SIDE as f64 - 1.0)) * spacing;
                mesh.closest_point(center).distance <= reach * (1.0 + ROUNDING) + ROUNDING
            })
            .collect();
        let mut near = Vec::new();
        let states = is_near
            .iter()
            .enumerate()
            .map(|(i, &is_near)| {
                if is_near {
                    near.push(i);
                    FloodBlock::Near(near.len() as u32 - 1)
                } else {
                    FloodBlock::Far(false)
                }
            })
            .collect();
        progress.set_total(near.len() as u64);
        let distances = near
            .par_iter()
            .map(|&i| {
                let block = [i % blocks[0], i / blocks[0] % blocks[1], i / (blocks[0] * blocks[1])];
                let found = std::array::from_fn(|s| {
                    let at = sample(block, s);
                    mesh.closest_point(first + DVec3::from(at.map(|i| i as f64)) * spacing).distance as f32
                });
                progress.advance(1).map(|()| found)
            })
            .collect::<Result<Vec<_>, Error>>()?;
        let outside = vec![[false; SAMPLES]; distances.len()];
        let sides = Self { shape, blocks, states, distances, outside };
        let mut flood = Flood { mesh, sides, first, spacing, queue: Vec::new() };
        flood.start_at_border(core as f32);
        flood.run(core as f32, progress)?;
        if core > 0.0 {
            flood.climb(core as f32);
        }
        Ok(flood.sides)
    }

    /// Whether the sample nearest to a grid position lies outside.
    pub fn is_outside(&self, at: [i64; 3]) -> bool {
        let at: [usize; 3] = std::array::from_fn(|axis| at[axis].clamp(0, self.shape[axis] as i64 - 1) as usize);
        let (block, offset) = self.place(at);
        match self.states[block] {
            FloodBlock::Far(outside) => outside,
            FloodBlock::Near(near) => self.outside[near as usize][offset],
        }
    }

    /// Number of the block of a sample, and its offset there.
    fn place(&self, at: [usize; 3]) -> (usize, usize) {
        let block = at.map(|i| i / SIDE);
        let local = at.map(|i| i % SIDE);
        (
            block[0] + self.blocks[0] * (block[1] + self.blocks[1] * block[2]),
            local[0] + SIDE * (local[1] + SIDE * local[2]),
        )
    }
}

/// The sample with the offset `s` in a block.
fn sample(block: [usize; 3], s: usize) -> [usize; 3] {
    let local = [s % SIDE, s / SIDE % SIDE, s / (SIDE * SIDE)];
    std::array::from_fn(|axis| block[axis] * SIDE + local[axis])
}

impl Flood<'_> {
    /// Start at all samples of the border of the grid.
    fn start_at_border(&mut self, core: f32) {
        let [nx, ny, nz] = self.sides.shape;
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            let shape = [nx, ny, nz];
            for end in [0, shape[axis] - 1] {
                for i in 0..shape[u] {
                    for j in 0..shape[v] {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (end, i, j);
                        self.reach(at, core);
                    }
                }
            }
        }
    }

    /// Mark a sample, or the whole block around it, if the flood may visit it.
    fn reach(&mut self, at: [usize; 3], core: f32) {
        let (block, offset) = self.sides.place(at);
        match &mut self.sides.states[block] {
            FloodBlock::Far(outside) => {
                if !std::mem::replace(outside, true) {
                    self.queue.push(at);
                }
            }
            FloodBlock::Near(near) => {
                let near = *near as usize;
                if self.sides.distances[near][offset] >= core && !self.sides.outside[near][offset] {
                    self.sides.outside[near][offset] = true;
                    self.queue.push(at);
                }
            }
        }
    }

    fn run(&mut self, core: f32, progress: &Progress) -> Result<(), Error> {
        let mut steps = 0u64;
        while let Some(at) = self.queue.pop() {
            steps += 1;
            if steps.is_multiple_of(1 << 16) {
                progress.check()?;
            }
            let (block, _) = self.sides.place(at);
            if let FloodBlock::Far(_) = self.sides.states[block] {
                self.leave_block(at.map(|i| i / SIDE), core);
                continue;
            }
            for (axis, forward) in STEPS {
                if let Some(next) = self.step(at, axis, forward)
                    && !self.sides.is_outside(next.map(|i| i as i64))
                    && !self.is_blocked(at, next)
                {
                    self.reach(next, core);
                }
            }
        }
        Ok(())
    }

    /// Go on from a far block to all samples on its faces.
    fn leave_block(&mut self, block: [usize; 3], core: f32) {
        let lower = block.map(|b| b * SIDE);
        let upper: [usize; 3] = std::array::from_fn(|axis| (lower[axis] + SIDE).min(self.sides.shape[axis]));
        for axis in 0..3 {
            let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
            for (end, forward) in [(lower[axis], false), (upper[axis] - 1, true)] {
                for i in lower[u]..upper[u] {
                    for j in lower[v]..upper[v] {
                        let mut at = [0; 3];
                        (at[axis], at[u], at[v]) = (end, i, j);
                        if let Some(next) = self.step(at, axis, forward) {
                            self.reach(next, core);
                        }
                    }
                }
            }
        }
    }

    fn step(&self, mut at: [usize; 3], axis: usize, forward: bool) -> Option<[usize; 3]> {
        at[axis] = if forward { at[axis] + 1 } else { at[axis].checked_sub(1)? };
        (at[axis] < self.sides.shape[axis]).then_some(at)
    }

    /// The distance at a sample of a near block, local units; far blocks count as infinite.
    fn distance(&self, at: [usize; 3]) -> f32 {
        let (block, offset) = self.sides.place(at);
        match self.sides.states[block] {
            FloodBlock::Far(_) => f32::INFINITY,
            FloodBlock::Near(near) => self.sides.distances[near as usize][offset],
        }
    }

    /// Whether a triangle lies across the step between two neighbours.
    fn is_blocked(&self, from: [usize; 3], to: [usize; 3]) -> bool {
        let [start, end] = [from, to].map(|at| self.first + DVec3::from(at.map(|i| i as f64)) * self.spacing);
        let sum = f64::from(self.distance(from)) + f64::from(self.distance(to));
        if sum > start.distance(end) * (1.0 + ROUNDING) + ROUNDING {
            return false;
        }
        // From the lower end, so that both directions have the same answer.
        let (start, end) = if from < to { (start, end) } else { (end, start) };
        self.mesh.is_occluded(&Ray { origin: start, direction: end - start, t_min: 0.0, t_max: 1.0 })
    }

    /// Decide the samples within the seal, from the largest distance to the smallest.
    fn climb(&mut self, core: f32) {
        let mut order: Vec<(f32, [usize; 3])> = Vec::new();
        let [bx, by, _] = self.sides.blocks;
        for (i, state) in self.sides.states.iter().enumerate() {
            let FloodBlock::Near(near) = state else { continue };
            for (s, &distance) in self.sides.distances[*near as usize].iter().enumerate() {
                let at = sample([i % bx, i / bx % by, i / (bx * by)], s);
                if distance < core && (0..3).all(|axis| at[axis] < self.sides.shape[axis]) {
                    order.push((distance, at));
                }
            }
        }
        order.par_sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        for (distance, at) in order {
            let mut highest = (distance, None);
            for (axis, forward) in STEPS {
                let Some(next) = self.step(at, axis, forward) else { continue };
                let there = self.distance(next);
                if there > highest.0 && !self.is_blocked(at, next) {
                    highest = (there, Some(next));
                }
            }
            if highest.1.is_some_and(|next| self.sides.is_outside(next.map(|i| i as i64))) {
                let (block, offset) = self.sides.place(at);
                if let FloodBlock::Near(near) = self.sides.states[block] {
                    self.sides.outside[near as usize][offset] = true;
                }
            }
        }
    }
}

/// The steps to the six neighbours: an axis and whether it is followed forwards.
const STEPS: [(usize, bool); 6] = [(0, false), (0, true), (1, false), (1, true), (2, false), (2, true)];

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube from -1 to 1 with a square hole of half the side `hole` in its top.
    fn holed_cube(hole: f64) -> Mesh {
        let mut vertices: Vec<[f64; 3]> = Vec::new();
        for z in [-1.0, 1.0] {
            vertices.extend([[-1.0, -1.0, z], [1.0, -1.0, z], [1.0, 1.0, z], [-1.0, 1.0, z]]);
        }
        vertices.extend([[-hole, -hole, 1.0], [hole, -hole, 1.0], [hole, hole, 1.0], [-hole, hole, 1.0]]);
        let mut quads = vec![[0, 3, 2, 1]];
        quads.extend((0..4).map(|i| [i, (i + 1) % 4, (i + 1) % 4 + 4, i + 4]));
        quads.extend((0..4).map(|i| [i + 4, (i + 1) % 4 + 4, (i + 1) % 4 + 8, i + 8]));
        let faces: Vec<[i64; 3]> = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        Mesh::new(&vertices, &faces).unwrap()
    }

    #[test]
    fn a_hole_lets_the_outside_in_unless_it_is_sealed() {
        let grid = Grid::new(DVec3::splat(-1.6), DVec3::splat(1.6), [32, 32, 32]).unwrap();
        let mesh = holed_cube(0.25);
        let inside = |radius: f64| {
            let sides = OuterSides::new(&mesh, &grid, radius, &Progress::new()).unwrap();
            let mut count = 0;
            for i in 0..32i64.pow(3) {
                count += usize::from(!sides.is_outside([i % 32, i / 32 % 32, i / 1024]));
            }
            (count, sides.is_outside([16, 16, 16]))
        };
        let (leaked, is_outside) = inside(0.0);
        assert!(is_outside && leaked == 0, "{leaked}");
        let (sealed, is_outside) = inside(0.26);
        // 20^3 samples lie in the cube; the sealed hole may differ from its plane by a voxel.
        assert!(!is_outside && (sealed as i64 - 8000).abs() <= 25, "{sealed}");
        // The seal is too small for the hole.
        assert!(inside(0.1).1);
    }
}
