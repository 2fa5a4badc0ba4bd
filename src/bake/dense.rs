//! Unsigned distances of a whole grid: the grid's octree and the mesh's tree walked together, with convexity culling.
//!
//! # Theory
//!
//! Neighbouring samples have nearly the same nearest triangles, so they are found for whole blocks of samples. What
//! can be left out follows from convexity. Let S be a convex set (a triangle or a box), c the centre of a block B.
//! - The distance d(p, S) is a convex function of p, so it lies above its tangent at c: d(p, S) >= d(c, S) + g.(p - c),
//!   g being the unit vector from the nearest point of S to c (or zero, where c lies in S).
//! - Let T be any triangle of the mesh. The distance to the mesh is at most d(p, T), and d(p, T) is convex too.
//! - "Convex less linear" has its maximum over a box at a corner. So if d(p, T) < d(c, S) + g.(p - c) holds at the eight
//!   corners of B, it holds throughout B: S is nearest to no sample of the block and is dropped, exactly.
//!
//! The test drops what lies behind or beside the surface nearest to the block, not only what lies far away.
//!
//! The walk goes from blocks of 16^3 samples over 8^3 to 4^3. A block inherits the nodes that its parent kept, tests their
//! children, opens those larger than itself, and passes the rest on. T is the triangle nearest to the centre. A block of
//! 4^3 opens what is left down to single triangles and keeps the tangent of each. Groups of 16 samples then need no new
//! geometry: the tangents still hold, and the best distances so far are the bound, sample by sample, in any order; the
//! nearest come first.
//!
//! # Rounding
//!
//! Everything is float32 in local coordinates. A tangent and a distance are each off by less than [`SLACK`] of the
//! largest coordinate (see `bvh::pack`: a few 1e-7), so a set is dropped only if the test holds by that margin. What is
//! stored is the float32 distance of the winner: good to about 3e-7 of the mesh's longest side.
//!
//! # Cost
//!
//! On a mesh of 70,000 faces at 128^3, a sample costs about 25 triangle evaluations in one lane of eight, and a fraction of
//! a node test. The result does not depend on threads or instruction set.
//!
//! AVX-512 would make it 1.2 times faster, and is not used: one optimised build with rustc 1.95 left whole blocks
//! unwritten on that path alone, and right again with a print added.

use super::LocalGrid;
use crate::bvh::closest::Slot;
use crate::bvh::pack::TriangleFrame;
use crate::bvh::{Bvh, Node, WIDTH};
use crate::error::Error;
use crate::progress::Progress;
use glam::Vec3;
use rayon::prelude::*;

/// Samples along the side of the blocks that are tasks, and of those that list triangles.
const TASK: usize = 16;
const LEAF: usize = 4;
/// Samples of a group, evaluated side by side.
const GROUP: [usize; 3] = [4, 2, 2];
const LANES: usize = GROUP[0] * GROUP[1] * GROUP[2];
/// Corners of a block.
const CORNERS: usize = 8;
/// Margin of the culling test, relative to the largest coordinate: ten times the rounding of either side.
const SLACK: f32 = 4e-6;

/// Distances of every sample of a grid, times `scale`.
///
/// `limit` is the distance up to which they are wanted, local units: a block that lies wholly beyond it gets infinity.
pub(super) fn distances(
    bvh: &Bvh,
    grid: &LocalGrid,
    limit: f32,
    scale: f32,
    progress: &Progress,
    out: &mut [f32],
) -> Result<(), Error> {
    let shape = grid.axes.map(|axis| axis.count);
    let tasks = shape.map(|n| n.div_ceil(TASK));
    let rows = SharedRows { samples: out.as_mut_ptr(), shape };
    // The largest coordinate that takes part scales the rounding.
    let reach = (grid.at([0; 3]).abs().max(grid.at(shape.map(|n| n - 1)).abs()).max_element() as f32).max(1.0);
    (0..tasks.iter().product::<usize>()).into_par_iter().try_for_each_init(Scratch::default, |scratch, task| {
        let low = [task % tasks[0], task / tasks[0] % tasks[1], task / (tasks[0] * tasks[1])].map(|i| i * TASK);
        let high = [0, 1, 2].map(|axis| (low[axis] + TASK).min(shape[axis]));
        let mut tile =
            Tile { bvh, grid, slack: SLACK * reach, limit, low, samples: [f32::INFINITY; TASK * TASK * TASK] };
        tile.fill(scratch, low, high);
        // SAFETY: tasks are disjoint boxes of the grid, and each writes only rows of its own box.
        unsafe { rows.write(low, high, &tile.samples, scale) };
        progress.advance(high.iter().zip(low).map(|(h, l)| (h - l) as u64).product())
    })
}

/// The output, written by many tasks at once.
struct SharedRows {
    samples: *mut f32,
    shape: [usize; 3],
}

// SAFETY: the pointer is only written through `write`, whose callers own disjoint boxes.
unsafe impl Sync for SharedRows {}

impl SharedRows {
    /// Put a tile, scaled, in its place.
    ///
    /// # Safety
    /// The box `low..high` lies in the grid, and no other thread writes to it.
    unsafe fn write(&self, low: [usize; 3], high: [usize; 3], tile: &[f32], scale: f32) {
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                let offset = low[0] + self.shape[0] * (y + self.shape[1] * z);
                let row = &tile[TASK * ((y - low[1]) + TASK * (z - low[2]))..][..high[0] - low[0]];
                // SAFETY: by the contract above, the row lies in the output and is this caller's alone.
                let target = unsafe { std::slice::from_raw_parts_mut(self.samples.add(offset), row.len()) };
                for (to, from) in target.iter_mut().zip(row) {
                    *to = from * scale;
                }
            }
        }
    }
}

/// Nodes that can matter to a block: an index and the lanes that remain.
type Candidates = Vec<(u32, u8)>;

/// Buffers that tasks of one thread reuse.
#[derive(Default)]
struct Scratch {
    levels: [Candidates; 3],
    stack: Candidates,
    tangents: Vec<Tangent>,
    triangles: Vec<(Tangent, TriangleFrame)>,
}

/// The tangent of a triangle's distance at the centre of a block.
#[derive(Clone, Copy)]
struct Tangent {
    gradient: [f32; 3],
    /// At the centre, the margin taken off.
    value: f32,
    slot: Slot,
}

/// A box of samples: centre and half size of the box around their positions.
#[derive(Clone, Copy)]
struct Block {
    center: Vec3,
    half: Vec3,
}

impl Block {
    /// The positions of its corners; bit `axis` of the index picks the upper side.
    #[inline(always)]
    fn corners(&self) -> [[f32; CORNERS]; 3] {
        let mut corners = [[0.0; CORNERS]; 3];
        for axis in 0..3 {
            for i in 0..CORNERS {
                let half = self.half[axis];
                corners[axis][i] = self.center[axis] + if i >> axis & 1 == 1 { half } else { -half };
            }
        }
        corners
    }

    /// The largest value a tangent may have at the centre without lying above every bound: max over the corners of the
    /// bound there less the tangent's rise to there.
    #[inline(always)]
    fn slackest(&self, gradient: [f32; 3], bounds: &[f32; CORNERS]) -> f32 {
        let [x, y, z] = [0, 1, 2].map(|axis| gradient[axis] * self.half[axis]);
        let (sum, difference) = (x + y, x - y);
        // The rise to the corners with both x and y up, x alone, y alone, neither; below and above.
        let rises = [sum, difference, -difference, -sum];
        let mut slackest = f32::NEG_INFINITY;
        for (corner, rise) in [3, 1, 2, 0].into_iter().zip(rises) {
            slackest = max(slackest, max(bounds[corner] - (rise - z), bounds[corner + 4] - (rise + z)));
        }
        slackest
    }
}

struct Tile<'a> {
    bvh: &'a Bvh,
    grid: &'a LocalGrid,
    slack: f32,
    limit: f32,
    low: [usize; 3],
    samples: [f32; TASK * TASK * TASK],
}

impl Tile<'_> {
    fn fill(&mut self, scratch: &mut Scratch, low: [usize; 3], high: [usize; 3]) {
        #[cfg(target_arch = "x86_64")]
        {
            if std::arch::is_x86_feature_detected!("avx2") {
                // SAFETY: the processor has these instructions. No fused operation is enabled into the arithmetic, so
                // every path gives the same bits.
                return unsafe { self.fill_avx2(scratch, low, high) };
            }
        }
        self.fill_portable(scratch, low, high);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn fill_avx2(&mut self, scratch: &mut Scratch, low: [usize; 3], high: [usize; 3]) {
        self.fill_portable(scratch, low, high);
    }

    #[inline(always)]
    fn fill_portable(&mut self, scratch: &mut Scratch, low: [usize; 3], high: [usize; 3]) {
        let Scratch { levels: [root, middle, packs], stack, tangents, triangles } = scratch;
        let block = self.block(low, high);
        let Some(nearest) = self.bvh.nearest(block.center, f32::INFINITY) else { return };
        if self.is_beyond(&block, nearest.distance_squared) {
            return;
        }
        let first = self.bvh.frame(nearest.slot);
        stack.clear();
        stack.push((0, u8::MAX));
        self.cull_nodes(&block, &first, stack, root);

        for sub in blocks(low, high, [TASK / 2; 3]) {
            let block = self.block(sub.0, sub.1);
            let bound = first.distance_squared(block.center) * (1.0 + 1e-5) + 1e-12;
            let found = self.bvh.nearest(block.center, bound);
            let (frame, squared) = found.map_or((first, bound), |n| (self.bvh.frame(n.slot), n.distance_squared));
            if self.is_beyond(&block, squared) {
                continue;
            }
            stack.clear();
            stack.extend_from_slice(root);
            self.cull_nodes(&block, &frame, stack, middle);

            // The best triangle of the block before may be nearer than that of the parent.
            let mut previous = frame;
            for sub in blocks(sub.0, sub.1, [LEAF; 3]) {
                let block = self.block(sub.0, sub.1);
                let of_previous = previous.distance_squared(block.center);
                let mut near = if of_previous < frame.distance_squared(block.center) { previous } else { frame };
                // With a limit most blocks are beyond it, and a search at the centre is cheaper than a list.
                if self.limit.is_finite() {
                    let bound = near.distance_squared(block.center) * (1.0 + 1e-5) + 1e-12;
                    let found = self.bvh.nearest(block.center, bound);
                    near = found.map_or(near, |nearest| self.bvh.frame(nearest.slot));
                    if self.is_beyond(&block, near.distance_squared(block.center)) {
                        continue;
                    }
                }
                stack.clear();
                stack.extend_from_slice(middle);
                previous = self.list_triangles(&block, &near, stack, packs, tangents, triangles);
                self.evaluate(&block, sub.0, sub.1, triangles);
            }
        }
    }

    fn block(&self, low: [usize; 3], high: [usize; 3]) -> Block {
        let (first, last) = (self.grid.at(low), self.grid.at(high.map(|i| i - 1)));
        Block { center: ((first + last) * 0.5).as_vec3(), half: ((last - first) * 0.5).as_vec3() }
    }

    /// Whether no sample of the block is within the limit.
    fn is_beyond(&self, block: &Block, center_squared: f32) -> bool {
        center_squared.sqrt() > (self.limit + block.half.length()) * (1.0 + 1e-5) + self.slack
    }

    /// Move the nodes of `stack` that can matter to `kept`, opening those larger than the block.
    #[inline(always)]
    fn cull_nodes(&self, block: &Block, nearest: &TriangleFrame, stack: &mut Candidates, kept: &mut Candidates) {
        kept.clear();
        let bounds = roots(nearest.distances_squared(block.corners()));
        let size = 2.0 * block.half.max_element();
        while let Some((index, mask)) = stack.pop() {
            let node = &self.bvh.nodes[index as usize];
            let mut rest = self.survivors(node, block, &bounds) & mask;
            let mut keep = rest;
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let child = node.children[lane];
                if !child.is_pack() && node.size(lane) > size {
                    stack.push((child.index() as u32, u8::MAX));
                    keep &= !(1 << lane);
                }
            }
            if keep != 0 {
                kept.push((index, keep));
            }
        }
    }

    /// Which children of a node pass the culling test.
    #[inline(always)]
    fn survivors(&self, node: &Node, block: &Block, bounds: &[f32; CORNERS]) -> u8 {
        let mut excess = [0.0f32; WIDTH];
        for i in 0..WIDTH {
            // From the nearest point of the box to the centre.
            let mut g = [0.0f32; 3];
            for axis in 0..3 {
                let above_min = block.center[axis] - node.min[axis][i];
                let above_max = block.center[axis] - node.max[axis][i];
                g[axis] = max(above_max, min(above_min, 0.0));
            }
            let value = (g[0] * g[0] + g[1] * g[1] + g[2] * g[2]).sqrt();
            let inverse = if value > 0.0 { 1.0 / value } else { 0.0 };
            // An absent child is infinitely far and its gradient NaN, which no comparison lets through.
            excess[i] = value - self.slack - block.slackest(g.map(|x| x * inverse), bounds);
        }
        not_positive(&excess)
    }

    /// The triangles that can matter to the samples of a block, nearest first; returns the nearest to its centre.
    #[inline(always)]
    fn list_triangles(
        &self,
        block: &Block,
        near: &TriangleFrame,
        stack: &mut Candidates,
        packs: &mut Candidates,
        tangents: &mut Vec<Tangent>,
        triangles: &mut Vec<(Tangent, TriangleFrame)>,
    ) -> TriangleFrame {
        let corners = block.corners();
        let bounds = roots(near.distances_squared(corners));
        packs.clear();
        while let Some((index, mask)) = stack.pop() {
            let node = &self.bvh.nodes[index as usize];
            let mut rest = self.survivors(node, block, &bounds) & mask;
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let child = node.children[lane];
                let list = if child.is_pack() { &mut *packs } else { &mut *stack };
                list.push((child.index() as u32, u8::MAX));
            }
        }

        // The tangents first: the nearest triangle gives the sharpest bound for all.
        tangents.clear();
        let mut nearest: Option<Tangent> = None;
        for &(index, _) in packs.iter() {
            let pack = &self.bvh.packs[index as usize];
            let (value, gradient) = pack.tangents(block.center);
            let mut excess = [0.0f32; WIDTH];
            for i in 0..WIDTH {
                let slackest = block.slackest([gradient[0][i], gradient[1][i], gradient[2][i]], &bounds);
                excess[i] = value[i] - self.slack - slackest;
            }
            let mut rest = not_positive(&excess) & pack.mask();
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                let tangent = Tangent {
                    gradient: [0, 1, 2].map(|axis| gradient[axis][lane]),
                    value: value[lane] - self.slack,
                    slot: Slot { pack: index, lane: lane as u8 },
                };
                if nearest.is_none_or(|nearest| tangent.value < nearest.value) {
                    nearest = Some(tangent);
                }
                tangents.push(tangent);
            }
        }
        let frame = nearest.map_or(*near, |nearest| self.bvh.frame(nearest.slot));
        let bounds = roots(frame.distances_squared(corners));
        tangents.retain(|tangent| tangent.value <= block.slackest(tangent.gradient, &bounds));
        tangents.sort_unstable_by(|a, b| a.value.total_cmp(&b.value));
        triangles.clear();
        triangles.extend(tangents.iter().map(|tangent| (*tangent, self.bvh.frame(tangent.slot))));
        frame
    }

    /// Distances of the samples of a block, a group at a time.
    #[inline(always)]
    fn evaluate(&mut self, block: &Block, low: [usize; 3], high: [usize; 3], triangles: &[(Tangent, TriangleFrame)]) {
        for (low, high) in blocks(low, high, GROUP) {
            // The samples of the group; past the edge of the grid the last one is repeated.
            let mut p = [[0.0f32; LANES]; 3];
            let mut offset = [[0.0f32; LANES]; 3];
            for i in 0..LANES {
                let voxel = sample_of_group(low, high, i);
                for axis in 0..3 {
                    p[axis][i] = self.grid.axes[axis].at(voxel[axis]) as f32;
                    offset[axis][i] = p[axis][i] - block.center[axis];
                }
            }
            let mut best = [f32::INFINITY; LANES];
            for (tangent, frame) in triangles {
                let [gx, gy, gz] = tangent.gradient;
                let mut matters = false;
                for i in 0..LANES {
                    let bound = tangent.value + gx * offset[0][i] + gy * offset[1][i] + gz * offset[2][i];
                    matters |= bound <= best[i];
                }
                if matters {
                    let found = roots(frame.distances_squared(p));
                    for i in 0..LANES {
                        best[i] = min(found[i], best[i]);
                    }
                }
            }
            for i in 0..LANES {
                let voxel = sample_of_group(low, high, i);
                let [x, y, z] = [0, 1, 2].map(|axis| voxel[axis] - self.low[axis]);
                self.samples[x + TASK * (y + TASK * z)] = best[i];
            }
        }
    }
}

/// Voxel of a lane of the group `low..high`.
#[inline(always)]
fn sample_of_group(low: [usize; 3], high: [usize; 3], lane: usize) -> [usize; 3] {
    let step = [lane % GROUP[0], lane / GROUP[0] % GROUP[1], lane / (GROUP[0] * GROUP[1])];
    [0, 1, 2].map(|axis| (low[axis] + step[axis]).min(high[axis] - 1))
}

#[inline(always)]
fn roots<const N: usize>(mut squares: [f32; N]) -> [f32; N] {
    for i in 0..N {
        squares[i] = squares[i].sqrt();
    }
    squares
}

#[inline(always)]
fn max(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

#[inline(always)]
fn min(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Cut a box of samples into blocks of at most `side` samples, x fastest.
fn blocks(low: [usize; 3], high: [usize; 3], side: [usize; 3]) -> impl Iterator<Item = ([usize; 3], [usize; 3])> {
    let steps = [0, 1, 2].map(|axis| (high[axis] - low[axis]).div_ceil(side[axis]));
    (0..steps.iter().product()).map(move |i: usize| {
        let step = [i % steps[0], i / steps[0] % steps[1], i / (steps[0] * steps[1])];
        let from = [0, 1, 2].map(|axis| low[axis] + step[axis] * side[axis]);
        (from, [0, 1, 2].map(|axis| (from[axis] + side[axis]).min(high[axis])))
    })
}

/// Bit i set where lane i is zero or less.
#[inline(always)]
fn not_positive(lanes: &[f32; WIDTH]) -> u8 {
    let mut bits = 0;
    for i in 0..WIDTH {
        bits |= u8::from(lanes[i] <= 0.0) << i;
    }
    bits
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::mesh::Mesh;
    use glam::DVec3;
    use proptest::prelude::*;

    /// Every sample of the grid against the closest point of the single-point search, whose own test is brute force.
    fn assert_exact(mesh: &Mesh, lower: DVec3, upper: DVec3, shape: [usize; 3]) {
        let grid = Grid::new(lower, upper, shape).unwrap();
        let local = LocalGrid::new(&grid, mesh);
        let mut out = vec![f32::NAN; grid.len()];
        distances(mesh.bvh(), &local, f32::INFINITY, 1.0, &Progress::new(), &mut out).unwrap();
        // The promise of the module: 1e-6 of the box that holds mesh and grid, in practice a tenth of it.
        let reach = local.at([0; 3]).abs().max(local.at(shape.map(|n| n - 1)).abs()).max_element().max(1.0);
        for z in 0..shape[2] {
            for y in 0..shape[1] {
                for x in 0..shape[0] {
                    let exact = mesh.closest_point(local.at([x, y, z])).distance;
                    let found = f64::from(out[grid.offset(x, y, z)]);
                    assert!((found - exact).abs() <= 1e-6 * reach, "{:?}: {found} is not {exact}", [x, y, z]);
                }
            }
        }
    }

    /// A soup of `count` triangles of about `size` within the unit cube.
    fn soup(count: usize, size: f64, seed: u64) -> Mesh {
        let mut state = seed | 1;
        let mut next = || {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (state >> 33) as f64 / (1u64 << 31) as f64 - 0.5
        };
        let vertices: Vec<[f64; 3]> = (0..count)
            .flat_map(|_| {
                let center = [next(), next(), next()];
                [0; 3].map(|_| center.map(|x| x + size * next()))
            })
            .collect();
        Mesh::new(&vertices, &(0..count as i64).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect::<Vec<_>>()).unwrap()
    }

    /// A sphere of latitude rings, all its triangles nearly equally far from the centre.
    fn sphere(rings: usize, radius: f64) -> Mesh {
        let sectors = 2 * rings;
        let vertices: Vec<[f64; 3]> = (0..=rings)
            .flat_map(|ring| {
                let theta = std::f64::consts::PI * ring as f64 / rings as f64;
                (0..sectors).map(move |sector| {
                    let phi = std::f64::consts::TAU * sector as f64 / sectors as f64;
                    [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()].map(|x| radius * x)
                })
            })
            .collect();
        let at = |ring: usize, sector: usize| (ring * sectors + sector % sectors) as i64;
        let faces: Vec<[i64; 3]> = (0..rings)
            .flat_map(|ring| {
                (0..sectors).flat_map(move |sector| {
                    let (a, b) = (at(ring, sector), at(ring, sector + 1));
                    let (c, d) = (at(ring + 1, sector), at(ring + 1, sector + 1));
                    [[a, c, d], [a, d, b]]
                })
            })
            .collect();
        Mesh::new(&vertices, &faces).unwrap()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]
        /// Random soups, from dust to triangles larger than the grid, on oblong grids of any size.
        #[test]
        fn soups_are_exact(
            count in 1usize..600, log_size in -3.0..1.0f64, seed in any::<u64>(),
            nx in 1usize..40, ny in 1usize..40, nz in 1usize..40, stretch in 0.3..3.0f64
        ) {
            let mesh = soup(count, 10f64.powf(log_size), seed);
            assert_exact(&mesh, DVec3::new(-0.6, -0.6 * stretch, -0.7), DVec3::new(0.6, 0.6, 0.7), [nx, ny, nz]);
        }
    }

    #[test]
    fn a_sphere_seen_from_its_centre_is_exact() {
        let mesh = sphere(40, 1.0);
        assert_exact(&mesh, DVec3::splat(-1.1), DVec3::splat(1.1), [33; 3]);
        assert_exact(&mesh, DVec3::splat(-1e-3), DVec3::splat(1e-3), [9; 3]);
    }

    #[test]
    fn a_needle_fan_is_exact() {
        // Hundreds of needles from one tip: every box overlaps every other near it.
        let n = 300;
        let tip = [[0.0, 0.0, 0.0]];
        let rim = (0..=n).map(|i| {
            let angle = 0.3 * f64::from(i) / f64::from(n);
            [angle.cos(), angle.sin(), 0.02 * (9.0 * angle).sin()]
        });
        let vertices: Vec<[f64; 3]> = tip.into_iter().chain(rim).collect();
        let faces: Vec<[i64; 3]> = (1..=i64::from(n)).map(|i| [0, i, i + 1]).collect();
        assert_exact(&Mesh::new(&vertices, &faces).unwrap(), DVec3::splat(-0.2), DVec3::splat(1.1), [31, 29, 30]);
    }

    #[test]
    fn doubled_faces_and_extreme_sizes_are_exact() {
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        for size in [1.0, 1.0, 1e-6] {
            let first = vertices.len() as i64;
            vertices.extend([[0.1, 0.2, 0.3], [0.1 + size, 0.2, 0.3], [0.1, 0.2 + size, 0.3 + 0.5 * size]]);
            faces.push([first, first + 1, first + 2]);
        }
        assert_exact(&Mesh::new(&vertices, &faces).unwrap(), DVec3::splat(-0.5), DVec3::splat(1.5), [20; 3]);
    }

    #[test]
    fn far_and_tiny_grids_are_exact() {
        let mesh = soup(500, 0.1, 3);
        assert_exact(&mesh, DVec3::splat(50.0), DVec3::splat(51.0), [17; 3]);
        assert_exact(&mesh, DVec3::splat(0.1), DVec3::splat(0.1 + 1e-5), [12; 3]);
        // Inside one triangle, far from its edges.
        let one = Mesh::new(&[[0.0, 0.0, 0.0], [1.0, 0.0, 0.1], [0.0, 1.0, 0.2]], &[[0, 1, 2]]).unwrap();
        assert_exact(&one, DVec3::splat(0.2), DVec3::splat(0.3), [16; 3]);
        assert_exact(&one, DVec3::splat(-1.0), DVec3::splat(1.0), [1; 3]);
    }

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let mesh = soup(800, 0.2, 11);
        let grid = Grid::new(DVec3::splat(-0.6), DVec3::splat(0.6), [TASK; 3]).unwrap();
        let local = LocalGrid::new(&grid, &mesh);
        let tile = |portable: bool| {
            let mut tile = Tile {
                bvh: mesh.bvh(),
                grid: &local,
                slack: SLACK,
                limit: f32::INFINITY,
                low: [0; 3],
                samples: [0.0; TASK * TASK * TASK],
            };
            if portable {
                tile.fill_portable(&mut Scratch::default(), [0; 3], [TASK; 3]);
            } else {
                tile.fill(&mut Scratch::default(), [0; 3], [TASK; 3]);
            }
            tile.samples.map(f32::to_bits)
        };
        assert_eq!(tile(true), tile(false));
    }

    #[test]
    fn cancelling_stops_the_work() {
        let mesh = soup(100, 0.2, 5);
        let grid = Grid::new(DVec3::splat(-0.6), DVec3::splat(0.6), [40; 3]).unwrap();
        let progress = Progress::new();
        progress.cancel();
        let result =
            distances(mesh.bvh(), &LocalGrid::new(&grid, &mesh), f32::INFINITY, 1.0, &progress, &mut [0.0; 64000]);
        assert_eq!(result, Err(Error::Cancelled));
    }
}
