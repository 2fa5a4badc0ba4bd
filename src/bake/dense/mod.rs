//! Unsigned distances of a whole grid. The octree of the grid and the tree of the mesh are traversed together, with
//! culling by convexity.
//!
//! # Theory
//!
//! Neighbouring samples have nearly the same nearest triangles, so the triangles are found for whole blocks of samples.
//! Convexity decides which triangles can be dropped. Let S be a convex set (a triangle or a box) and c the centre of a
//! block B.
//! - The distance d(p, S) is a convex function of p, so it lies above its tangent at c: d(p, S) >= d(c, S) + g.(p - c),
//!   where g is the unit vector from the nearest point of S to c (or zero if c lies in S).
//! - Let T be any triangle of the mesh. The distance to the mesh is at most d(p, T), and d(p, T) is convex too.
//! - A convex function minus a linear one has its maximum over a box at a corner. If d(p, T) < d(c, S) + g.(p - c)
//!   holds at the eight corners of B, it holds throughout B: S is nearest to no sample of the block and is dropped,
//!   exactly.
//!
//! The test drops sets behind or beside the surface nearest to the block, as well as sets far away.
//!
//! The traversal goes from blocks of 16^3 samples over 8^3 to 4^3. A block starts with the nodes that its parent kept,
//! tests their children, opens those larger than itself, and passes the rest on. T is the triangle nearest to the
//! centre. A block of 4^3 opens the remaining nodes down to single triangles and stores the tangent of each. Groups of
//! 16 samples then need no new geometry: the tangents still hold, and the smallest distances so far are the bound,
//! sample by sample, in any order; the nearest triangles come first.
//!
//! Where triangles are smaller than voxels a block has many of them, and a search for each of its samples costs less.
//! The cost of a search is predicted by the number of packs that the search at the centre of the 8^3 block measured,
//! and the cost of a list by its number of packs.
//!
//! # Rounding
//!
//! All arithmetic is float32 in local coordinates. A tangent and a distance each have an error below [`SLACK`] of the
//! largest coordinate (see `bvh::pack`: a few 1e-7), so a set is dropped only if the test holds by that margin. The
//! tangent of a triangle bounds its distance for any rounding of the gradient (see `Pack::tangents`). The stored value
//! is the float32 distance of the nearest triangle, accurate to about 3e-7 of the mesh's longest side.
//!
//! # Cost
//!
//! On a mesh of 70,000 faces at 128^3, a block of 4^3 tests about 40 nodes and 58 packs and lists 130 triangles, of
//! which groups of eight samples evaluate 32. The result does not depend on threads or instruction set.
//!
//! # Compilers
//!
//! The traversal passes the [`Slot`] of the nearest triangle from block to block, never its `TriangleFrame`. LLVM's
//! register coalescer for x86 (versions 14 to 22) can keep four floats that live across branches as a group in a 4-byte
//! spill slot, if the first of them is also used alone: the other three are restored as zero. A frame by value is such
//! a group, and builds that passed it dropped triangles. See `docs/notes/llvm-register-coalescer.md`;
//! `scripts/check_units.sh` tests builds with 1 to 256 codegen units.

mod block;
mod changes;

pub(super) use changes::Changes;

use super::LocalGrid;
use crate::bvh::nearest::closest::Slot;
use crate::bvh::pack::TriangleFrame;
use crate::bvh::{Bvh, Node, WIDTH};
use crate::error::Error;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::simd::with_vectors;
use block::{CORNERS, Linear, SampleBox, max, min, not_positive, roots, tangents_of_boxes};
use glam::Vec3;
use rayon::prelude::*;

/// Number of samples along the side of a block that is one task.
const TASK: usize = 16;
/// Number of samples along the side of a block that lists its triangles.
const LEAF: usize = 4;
/// Number of leaves along the side of a task.
const LEAVES: usize = TASK / LEAF;
/// The leaves of the first octant of a task, one bit each.
const LEAVES_OF_OCTANT: u64 = 0x33_0033;
/// Number of samples of a group along each axis. A group is evaluated side by side.
const GROUP: [usize; 3] = [4, 2, 2];
const LANES: usize = GROUP[0] * GROUP[1] * GROUP[2];
/// Cost of a search for one sample that measures no pack, in visits of a node.
const SEARCH_COST: u32 = 8;
/// Cost of a pack in a search: its measurement and about one node above it.
const SEARCHED_PACK_COST: u32 = 3;
/// Cost of a pack in the list of a block: tangents, culling, sorting, and the evaluation at all samples. Of 6, 10, 16,
/// 26, 40 and 60, the last two were slower on meshes whose triangles are about as large as voxels, and the first three
/// on meshes with much smaller triangles.
const LISTED_PACK_COST: u32 = 26;
/// Margin of the culling test, relative to the largest coordinate: ten times the rounding error of either side.
const SLACK: f32 = 4e-6;

/// Distances of every sample of a grid, times `scale`.
///
/// `limit` is the largest distance that is needed, local units. Samples of a block that lies completely beyond it are
/// infinite.
pub(super) fn distances(
    mesh: &Mesh,
    grid: &LocalGrid,
    limit: f32,
    scale: f32,
    progress: &Progress,
    out: &mut [f32],
) -> Result<(), Error> {
    fill_tiles(mesh, grid, limit, None, progress, out, |to, from| *to = from * scale)
}

/// Computes the distances again in the blocks of a grid where `changes` may have changed them. `put` receives the
/// stored sample and the distance, local units.
pub(super) fn update(
    mesh: &Mesh,
    grid: &LocalGrid,
    changes: &Changes<'_>,
    progress: &Progress,
    out: &mut [f32],
    put: impl Fn(&mut f32, f32) + Sync,
) -> Result<(), Error> {
    fill_tiles(mesh, grid, f32::INFINITY, Some(changes), progress, out, |to, from| {
        if from != KEPT {
            put(to, from);
        }
    })
}

/// Distance of a sample that is not computed again.
const KEPT: f32 = -1.0;

/// Fills a grid in parallel, a tile at a time, and passes each sample of the output and its distance, local units, to
/// `put`.
fn fill_tiles(
    mesh: &Mesh,
    grid: &LocalGrid,
    limit: f32,
    changes: Option<&Changes<'_>>,
    progress: &Progress,
    out: &mut [f32],
    put: impl Fn(&mut f32, f32) + Sync,
) -> Result<(), Error> {
    let shape = grid.shape();
    let tasks = shape.map(|n| n.div_ceil(TASK));
    let rows = SharedRows { samples: out.as_mut_ptr(), grid };
    let reach = reach(grid);
    let bvh = mesh.distance_bvh(reach);
    let slack = SLACK * (reach as f32).max(1.0);
    let empty = if changes.is_some() { KEPT } else { f32::INFINITY };
    (0..tasks.iter().product::<usize>()).into_par_iter().try_for_each_init(BlockScratch::default, |scratch, task| {
        let low = [task % tasks[0], task / tasks[0] % tasks[1], task / (tasks[0] * tasks[1])].map(|i| i * TASK);
        let high = [0, 1, 2].map(|axis| (low[axis] + TASK).min(shape[axis]));
        let BlockScratch { levels: [of_tile, of_octant, _], stack, .. } = scratch;
        let leaves = changes.map_or(u64::MAX, |changes| changes.leaves([of_tile, of_octant, stack], grid, low, high));
        if leaves != 0 {
            let mut tile = Tile { bvh, grid, slack, limit, leaves, low, samples: [empty; TASK * TASK * TASK] };
            tile.fill(scratch, low, high);
            // SAFETY: tasks are disjoint boxes of the grid, and each writes only rows of its own box.
            unsafe { rows.write(low, high, &tile.samples, &put) };
        }
        progress.advance(high.iter().zip(low).map(|(h, l)| (h - l) as u64).product())
    })
}

/// The largest local coordinate of the samples of a grid. Rounding errors are proportional to it.
pub(super) fn reach(grid: &LocalGrid) -> f64 {
    grid.at([0; 3]).abs().max(grid.at(grid.shape().map(|n| n - 1)).abs()).max_element()
}

/// The output, written by several tasks at once.
struct SharedRows<'a> {
    samples: *mut f32,
    grid: &'a LocalGrid,
}

// SAFETY: the pointer is only written through `write`, whose callers own disjoint boxes.
unsafe impl Sync for SharedRows<'_> {}

impl SharedRows<'_> {
    /// Passes the samples at the position of a tile, and the samples of the tile, to `put`.
    ///
    /// # Safety
    /// The box `low..high` lies in the grid, and no other thread writes to it.
    unsafe fn write(&self, low: [usize; 3], high: [usize; 3], tile: &[f32], put: &impl Fn(&mut f32, f32)) {
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                let offset = self.grid.index([low[0], y, z]);
                let row = &tile[TASK * ((y - low[1]) + TASK * (z - low[2]))..][..high[0] - low[0]];
                // SAFETY: by the contract above, the row lies in the output and no other thread writes to it.
                let target = unsafe { std::slice::from_raw_parts_mut(self.samples.add(offset), row.len()) };
                for (to, &from) in target.iter_mut().zip(row) {
                    put(to, from);
                }
            }
        }
    }
}

/// Nodes that passed the culling test of a block: an index and the mask of the remaining lanes.
type Candidates = Vec<(u32, u8)>;

/// Buffers that tasks of one thread reuse.
#[derive(Default)]
struct BlockScratch {
    levels: [Candidates; 3],
    stack: Candidates,
    tangents: Tangents,
    list: List,
}

/// Tangents of triangles at the centre of a block, one array per component, so that lanes can process them.
#[derive(Default)]
struct Tangents {
    /// Value at the centre, minus the margin.
    value: Vec<f32>,
    gradient: [Vec<f32>; 3],
    slot: Vec<Slot>,
}

impl Tangents {
    fn clear(&mut self) {
        self.value.clear();
        self.gradient.iter_mut().for_each(Vec::clear);
        self.slot.clear();
    }

    #[inline(always)]
    fn push(&mut self, value: f32, gradient: [f32; 3], slot: Slot) {
        self.value.push(value);
        for axis in 0..3 {
            self.gradient[axis].push(gradient[axis]);
        }
        self.slot.push(slot);
    }
}

/// The triangles of a block, nearest to its centre first.
#[derive(Default)]
struct List {
    /// Value at the centre and row in `Tangents`, packed into one integer that sorts by the value.
    keys: Vec<u64>,
    tangents: Vec<Linear>,
    frames: Vec<TriangleFrame>,
}

struct Tile<'a> {
    bvh: &'a Bvh,
    grid: &'a LocalGrid,
    slack: f32,
    limit: f32,
    /// The blocks of [`LEAF`]^3 samples to compute, one bit each, x fastest. An update computes some of them only.
    leaves: u64,
    low: [usize; 3],
    samples: [f32; TASK * TASK * TASK],
}

impl Tile<'_> {
    /// Computes the samples of the box `low..high`.
    fn fill(&mut self, scratch: &mut BlockScratch, low: [usize; 3], high: [usize; 3]) {
        with_vectors!(
            (tile: &mut Tile<'_> = self, scratch: &mut BlockScratch = scratch,
             low: [usize; 3] = low, high: [usize; 3] = high)
            { tile.fill_portable(scratch, low, high) }
        )
    }

    #[inline(always)]
    fn fill_portable(&mut self, scratch: &mut BlockScratch, low: [usize; 3], high: [usize; 3]) {
        let BlockScratch { levels: [root, middle, packs], stack, tangents, list } = scratch;
        let block = SampleBox::new(self.grid, low, high);
        let Some(nearest) = self.bvh.nearest(block.center, f32::INFINITY) else { return };
        if self.is_beyond(&block, nearest.distance_squared) {
            return;
        }
        let first = nearest.slot;
        stack.clear();
        stack.push((0, u8::MAX));
        self.cull_nodes(&block, first, stack, root);

        for sub in blocks(low, high, [TASK / 2; 3]) {
            if self.leaves >> leaf_of_tile(low, sub.0) & LEAVES_OF_OCTANT == 0 {
                continue;
            }
            let block = SampleBox::new(self.grid, sub.0, sub.1);
            let bound = self.just_beyond(first, block.center);
            let found = self.bvh.nearest(block.center, bound);
            let (of_parent, squared) = found.map_or((first, bound), |nearest| (nearest.slot, nearest.distance_squared));
            let searched = found.map_or(1, |nearest| nearest.packs);
            if self.is_beyond(&block, squared) {
                continue;
            }
            stack.clear();
            stack.extend_from_slice(root);
            self.cull_nodes(&block, of_parent, stack, middle);

            // The nearest triangle of the previous block may be nearer than the nearest triangle of the parent.
            let mut previous = of_parent;
            for sub in blocks(sub.0, sub.1, [LEAF; 3]) {
                if self.leaves >> leaf_of_tile(low, sub.0) & 1 == 0 {
                    continue;
                }
                let block = SampleBox::new(self.grid, sub.0, sub.1);
                let distance_squared = |slot: Slot| self.bvh.frame(slot).distance_squared(block.center);
                let mut near =
                    if distance_squared(previous) < distance_squared(of_parent) { previous } else { of_parent };
                // With a limit most blocks lie beyond it, and a search at the centre is cheaper than a list.
                if self.limit.is_finite() {
                    let found = self.bvh.nearest(block.center, self.just_beyond(near, block.center));
                    near = found.map_or(near, |nearest| nearest.slot);
                    if self.is_beyond(&block, distance_squared(near)) {
                        continue;
                    }
                }
                stack.clear();
                stack.extend_from_slice(middle);
                let count = sub.1.iter().zip(sub.0).map(|(high, low)| high - low).product::<usize>();
                let most = most_packs(count, searched);
                self.list_packs(&block, near, most, stack, packs);
                if packs.len() > most {
                    previous = self.search(near, sub.0, sub.1);
                } else {
                    previous = self.list_triangles(&block, near, packs, tangents, list);
                    self.evaluate(&block, sub.0, sub.1, list);
                }
            }
        }
    }

    /// Squared distance of `p` to a triangle, plus the rounding of the search that it bounds.
    fn just_beyond(&self, slot: Slot, p: Vec3) -> f32 {
        self.bvh.frame(slot).distance_squared(p) * (1.0 + 1e-5) + 1e-12
    }

    /// Whether no sample of the block is within the limit.
    fn is_beyond(&self, block: &SampleBox, center_squared: f32) -> bool {
        center_squared.sqrt() > (self.limit + block.half.length()) * (1.0 + 1e-5) + self.slack
    }

    /// Moves the nodes of `stack` that pass the culling test to `kept`, opening those larger than the block.
    #[inline(always)]
    fn cull_nodes(&self, block: &SampleBox, near: Slot, stack: &mut Candidates, kept: &mut Candidates) {
        kept.clear();
        let bounds = roots(self.bvh.frame(near).distances_squared(block.corners()));
        let size = 2.0 * block.half.max_element();
        while let Some((index, mask)) = stack.pop() {
            let node = &self.bvh.nodes[index as usize];
            let lanes = self.survivors(node, block, &bounds) & mask;
            let rest = open_large(node, lanes, size, stack);
            if rest != 0 {
                kept.push((index, rest));
            }
        }
    }

    /// Mask of the children of a node that pass the culling test.
    #[inline(always)]
    fn survivors(&self, node: &Node, block: &SampleBox, bounds: &[f32; CORNERS]) -> u8 {
        let (value, gradient) = tangents_of_boxes(node, block.center);
        let mut excess = [0.0f32; WIDTH];
        for i in 0..WIDTH {
            let slackest = block.slackest([gradient[0][i], gradient[1][i], gradient[2][i]], bounds);
            excess[i] = value[i] - self.slack - slackest;
        }
        not_positive(&excess)
    }

    /// The packs that pass the culling test of a block. Stops once there are more than `most`.
    #[inline(always)]
    fn list_packs(&self, block: &SampleBox, near: Slot, most: usize, stack: &mut Candidates, packs: &mut Candidates) {
        let bounds = roots(self.bvh.frame(near).distances_squared(block.corners()));
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
            if packs.len() > most {
                return;
            }
        }
    }

    /// Distances of the samples of a block by one search each. Returns the triangle nearest to the last sample.
    #[inline(always)]
    fn search(&mut self, mut near: Slot, low: [usize; 3], high: [usize; 3]) -> Slot {
        for z in low[2]..high[2] {
            for y in low[1]..high[1] {
                for x in low[0]..high[0] {
                    let p = self.grid.at([x, y, z]).as_vec3();
                    let found = self.bvh.nearest(p, self.just_beyond(near, p));
                    let squared = match found {
                        Some(nearest) => nearest.distance_squared,
                        None => self.bvh.frame(near).distance_squared(p),
                    };
                    near = found.map_or(near, |nearest| nearest.slot);
                    let [i, j, k] = [x - self.low[0], y - self.low[1], z - self.low[2]];
                    self.samples[i + TASK * (j + TASK * k)] = squared.sqrt();
                }
            }
        }
        near
    }

    /// The triangles that pass the culling test of a block, nearest first. Returns the one with the least tangent at
    /// the centre, which is the nearest one but for rounding.
    #[inline(always)]
    fn list_triangles(
        &self,
        block: &SampleBox,
        near: Slot,
        packs: &Candidates,
        tangents: &mut Tangents,
        list: &mut List,
    ) -> Slot {
        let corners = block.corners();
        let bounds = roots(self.bvh.frame(near).distances_squared(corners));
        // The tangents come first: the nearest triangle gives the tightest bound for all.
        tangents.clear();
        let mut nearest = (f32::INFINITY, near);
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
                let slot = Slot { pack: index, lane: lane as u8 };
                tangents.push(value[lane] - self.slack, [0, 1, 2].map(|axis| gradient[axis][lane]), slot);
                if value[lane] < nearest.0 {
                    nearest = (value[lane], slot);
                }
            }
        }
        let bounds = roots(self.bvh.frame(nearest.1).distances_squared(corners));

        // Culls again by that bound, a row of lanes at a time. Padding of the last row is infinitely far.
        let count = tangents.slot.len();
        let padded = count.next_multiple_of(WIDTH);
        tangents.value.resize(padded, f32::INFINITY);
        tangents.gradient.iter_mut().for_each(|row| row.resize(padded, 0.0));
        list.keys.clear();
        for start in (0..padded).step_by(WIDTH) {
            let row = |values: &[f32]| -> [f32; WIDTH] { std::array::from_fn(|i| values[start + i]) };
            let (value, gradient) = (row(&tangents.value), [0, 1, 2].map(|axis| row(&tangents.gradient[axis])));
            let mut excess = [0.0f32; WIDTH];
            for i in 0..WIDTH {
                excess[i] = value[i] - block.slackest([gradient[0][i], gradient[1][i], gradient[2][i]], &bounds);
            }
            let mut rest = not_positive(&excess);
            while rest != 0 {
                let lane = rest.trailing_zeros() as usize;
                rest &= rest - 1;
                // The bits of non-negative floats sort in the order of the floats.
                list.keys.push(u64::from(max(value[lane], 0.0).to_bits()) << 32 | (start + lane) as u64);
            }
        }
        list.keys.sort_unstable();
        list.tangents.clear();
        list.frames.clear();
        for &key in &list.keys {
            let row = key as u32 as usize;
            let gradient = [0, 1, 2].map(|axis| tangents.gradient[axis][row]);
            list.tangents.push(Linear { value: tangents.value[row], gradient });
            list.frames.push(self.bvh.frame(tangents.slot[row]));
        }
        nearest.1
    }

    /// Distances of the samples of a block, a group at a time.
    #[inline(always)]
    fn evaluate(&mut self, block: &SampleBox, low: [usize; 3], high: [usize; 3], list: &List) {
        for (low, high) in blocks(low, high, GROUP) {
            // Positions of the group; beyond the edge of the grid the last sample is repeated.
            let mut p = [[0.0f32; LANES]; 3];
            let mut offset = [[0.0f32; LANES]; 3];
            let mut reach = 0.0f32;
            for i in 0..LANES {
                let voxel = sample_of_group(low, high, i);
                for axis in 0..3 {
                    p[axis][i] = self.grid.axes[axis].at(voxel[axis]) as f32;
                    offset[axis][i] = p[axis][i] - block.center[axis];
                }
                let [x, y, z] = [0, 1, 2].map(|axis| offset[axis][i]);
                reach = max(reach, x * x + y * y + z * z);
            }
            // A tangent falls by at most the distance to a sample. The margin covers the rounding of its gradient.
            let reach = reach.sqrt() * (1.0 + 1e-5);
            let mut best = [f32::INFINITY; LANES];
            let mut farthest = f32::INFINITY;
            for (tangent, frame) in list.tangents.iter().zip(&list.frames) {
                if tangent.value - reach > farthest {
                    break;
                }
                let [gx, gy, gz] = tangent.gradient;
                let mut matters = false;
                for i in 0..LANES {
                    let bound = tangent.value + gx * offset[0][i] + gy * offset[1][i] + gz * offset[2][i];
                    matters |= bound <= best[i];
                }
                if matters {
                    let found = roots(frame.distances_squared(p));
                    farthest = 0.0;
                    for i in 0..LANES {
                        best[i] = min(found[i], best[i]);
                        farthest = max(farthest, best[i]);
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

/// The largest number of packs in the list of a block of `samples` samples. With more of them, searches of `searched`
/// packs each, one for each sample, cost less.
fn most_packs(samples: usize, searched: u32) -> usize {
    samples * (SEARCH_COST + SEARCHED_PACK_COST * searched) as usize / LISTED_PACK_COST as usize
}

/// Pushes those children of a node in `lanes` that are nodes larger than `size` to `stack`. Returns the other lanes.
#[inline(always)]
fn open_large(node: &Node, lanes: u8, size: f32, stack: &mut Candidates) -> u8 {
    let (mut rest, mut small) = (lanes, lanes);
    while rest != 0 {
        let lane = rest.trailing_zeros() as usize;
        rest &= rest - 1;
        let child = node.children[lane];
        if !child.is_pack() && node.size(lane) > size {
            stack.push((child.index() as u32, u8::MAX));
            small &= !(1 << lane);
        }
    }
    small
}

/// Index of the leaf that begins at the sample `from` in the tile that begins at `low`, x fastest.
fn leaf_of_tile(low: [usize; 3], from: [usize; 3]) -> usize {
    let [x, y, z] = [0, 1, 2].map(|axis| (from[axis] - low[axis]) / LEAF);
    x + LEAVES * (y + LEAVES * z)
}

/// Divides a box of samples into blocks of at most `side` samples, x fastest.
fn blocks(low: [usize; 3], high: [usize; 3], side: [usize; 3]) -> impl Iterator<Item = ([usize; 3], [usize; 3])> {
    let steps = [0, 1, 2].map(|axis| (high[axis] - low[axis]).div_ceil(side[axis]));
    (0..steps.iter().product()).map(move |i: usize| {
        let step = [i % steps[0], i / steps[0] % steps[1], i / (steps[0] * steps[1])];
        let from = [0, 1, 2].map(|axis| low[axis] + step[axis] * side[axis]);
        (from, [0, 1, 2].map(|axis| (from[axis] + side[axis]).min(high[axis])))
    })
}

/// Voxel of a lane of the group `low..high`.
#[inline(always)]
fn sample_of_group(low: [usize; 3], high: [usize; 3], lane: usize) -> [usize; 3] {
    let step = [lane % GROUP[0], lane / GROUP[0] % GROUP[1], lane / (GROUP[0] * GROUP[1])];
    [0, 1, 2].map(|axis| (low[axis] + step[axis]).min(high[axis] - 1))
}

#[cfg(test)]
mod tests;
