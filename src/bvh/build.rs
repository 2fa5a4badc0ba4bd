//! Top-down build of the tree by the binned surface area heuristic. It is parallel, and the tree does not depend on the
//! number of threads.

use super::pack::Pack;
use super::{Bvh, ChildRef, Node, WIDTH};
use crate::geometry::Aabb;
use crate::memory::with_room;
use glam::{Vec3, Vec3A};
use rayon::prelude::*;
use std::ops::Range;

const BINS: usize = 16;
/// A subtree with fewer triangles is built by the current thread.
const PARALLEL_ABOVE: usize = 4096;
/// A range of several of these chunks is processed by several threads.
const CHUNK: usize = 1 << 15;
/// From this level on ranges are halved by count, which limits the depth for every input, such as boxes in geometric
/// progression.
const HALVE_FROM: usize = 16;
/// Eight equal parts per level divide 2^30 triangles into leaves in ten more levels. Halving rounds up, so one level is
/// added.
pub(super) const MAX_DEPTH: usize = HALVE_FROM + 11;

/// The box of a triangle during the build.
#[derive(Clone, Copy)]
pub(super) struct Primitive {
    pub bounds: Aabb,
    pub face: u32,
}

impl Primitive {
    fn new(positions: &[Vec3], corners: &[u32; 3], face: u32) -> Self {
        Self { bounds: Aabb::of_points(&corners.map(|v| positions[v as usize])), face }
    }

    /// Twice the centre of the box. Only the order of centres is used.
    #[inline(always)]
    fn center(&self) -> Vec3A {
        Vec3A::from(self.bounds.min) + Vec3A::from(self.bounds.max)
    }
}

/// A finished subtree before its nodes get their positions in memory.
enum Subtree {
    Leaf { start: usize, count: usize },
    Inner(Vec<(Aabb, Subtree)>),
}

/// The tree over all faces.
pub(super) fn build(positions: &[Vec3], faces: &[[u32; 3]]) -> Bvh {
    let primitive = |(face, corners)| Primitive::new(positions, corners, face as u32);
    build_over(positions, faces, collected(faces.par_iter().enumerate().map(primitive)))
}

/// The tree over some of the faces.
pub(super) fn build_of(positions: &[Vec3], faces: &[[u32; 3]], members: &[u32]) -> Bvh {
    let primitive = |&face: &u32| Primitive::new(positions, &faces[face as usize], face);
    build_over(positions, faces, collected(members.par_iter().map(primitive)))
}

/// The items in an array with large pages.
fn collected<T: Send>(items: impl IndexedParallelIterator<Item = T>) -> Vec<T> {
    let mut array = with_room(items.len());
    items.collect_into_vec(&mut array);
    array
}

fn build_over(positions: &[Vec3], faces: &[[u32; 3]], mut primitives: Vec<Primitive>) -> Bvh {
    let bounds = bounds_of(&primitives);
    let root = subdivide(&mut primitives, 0, 0);
    // The root is always an inner node, even over a single leaf.
    let children = match root {
        Subtree::Inner(children) => children,
        leaf => vec![(bounds, leaf)],
    };

    let mut nodes = Vec::new();
    let mut leaves = Vec::new();
    flatten(children, &mut nodes, &mut leaves);
    let packs = collected(leaves.par_iter().map(|&(start, count)| {
        let mut members = [0; WIDTH];
        for (member, primitive) in members.iter_mut().zip(&primitives[start..start + count]) {
            *member = primitive.face;
        }
        Pack::new(positions, faces, &members[..count])
    }));
    let built_cost = Bvh::cost(&nodes);
    let has_equal_boxes = Bvh::has_equal_boxes(&nodes);
    Bvh { nodes, packs, bounds, built_cost, is_refitted: false, has_equal_boxes }
}

pub(super) fn bounds_of(primitives: &[Primitive]) -> Aabb {
    primitives.iter().fold(Aabb::EMPTY, |bounds, p| bounds.union(p.bounds))
}

/// Splits the range with the largest box until there are eight ranges, then subdivides each.
fn subdivide(primitives: &mut [Primitive], start: usize, depth: usize) -> Subtree {
    if primitives.len() <= WIDTH {
        return Subtree::Leaf { start, count: primitives.len() };
    }
    let mut ranges = vec![(bounds_of(primitives), 0..primitives.len())];
    let halve = depth >= HALVE_FROM;
    let weight = |(bounds, range): &(Aabb, Range<usize>)| if halve { range.len() as f32 } else { bounds.half_area() };
    while ranges.len() < WIDTH {
        let largest = (0..ranges.len())
            .filter(|&i| ranges[i].1.len() > WIDTH)
            .max_by(|&i, &j| weight(&ranges[i]).total_cmp(&weight(&ranges[j])).then(j.cmp(&i)));
        let Some(largest) = largest else { break };
        let range = ranges[largest].1.clone();
        let part = &mut primitives[range.clone()];
        let (middle, left, right) = if halve { split_in_half(part) } else { split(part) };
        ranges[largest] = (left, range.start..range.start + middle);
        ranges.insert(largest + 1, (right, range.start + middle..range.end));
    }

    let parallel = primitives.len() > PARALLEL_ABOVE;
    let mut rest = primitives;
    let mut parts = Vec::with_capacity(ranges.len());
    let mut offset = start;
    for (bounds, range) in ranges {
        let (part, tail) = rest.split_at_mut(range.len());
        parts.push((bounds, part, offset));
        offset += range.len();
        rest = tail;
    }
    let below = |(bounds, part, start): (Aabb, &mut [Primitive], usize)| (bounds, subdivide(part, start, depth + 1));
    Subtree::Inner(if parallel {
        parts.into_par_iter().map(below).collect()
    } else {
        parts.into_iter().map(below).collect()
    })
}

/// Boxes and counts of the primitives whose centres lie in the same sixteenth of the range, for each axis.
struct Bins([[Bin; BINS]; 3]);

/// A box in registers of four lanes, and the number of primitives it contains.
#[derive(Clone, Copy)]
struct Bin {
    min: Vec3A,
    max: Vec3A,
    count: usize,
}

impl Bin {
    const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY, count: 0 };

    #[inline(always)]
    fn add(&mut self, min: Vec3A, max: Vec3A) {
        self.min = self.min.min(min);
        self.max = self.max.max(max);
        self.count += 1;
    }

    #[inline(always)]
    fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max), count: self.count + other.count }
    }

    fn bounds(&self) -> Aabb {
        Aabb { min: self.min.into(), max: self.max.into() }
    }

    /// Expected number of packs to test: their number times the surface area.
    fn cost(&self) -> f32 {
        self.bounds().half_area() * self.count.div_ceil(WIDTH) as f32
    }
}

/// Maps a centre to its bin.
#[derive(Clone, Copy)]
struct Binning {
    origin: Vec3A,
    scale: Vec3A,
}

impl Binning {
    fn of(primitives: &[Primitive]) -> Self {
        let grow = |(min, max): (Vec3A, Vec3A), p: &Primitive| {
            let center = p.center();
            (min.min(center), max.max(center))
        };
        let join = |a: (Vec3A, Vec3A), b: (Vec3A, Vec3A)| (a.0.min(b.0), a.1.max(b.1));
        let nothing = (Vec3A::INFINITY, Vec3A::NEG_INFINITY);
        let (min, max) = in_chunks(primitives, |part| part.iter().fold(nothing, grow), join);
        let scale = (max - min).to_array().map(|e| if e > 0.0 { BINS as f32 * (1.0 - 1e-6) / e } else { 0.0 });
        Self { origin: min, scale: scale.into() }
    }

    #[inline(always)]
    fn bin(&self, p: &Primitive) -> [usize; 3] {
        let place = ((p.center() - self.origin) * self.scale).to_array();
        place.map(|x| (x as usize).min(BINS - 1))
    }
}

impl Bins {
    fn of(primitives: &[Primitive], binning: Binning) -> Self {
        let fill = |part: &[Primitive]| {
            let mut bins = [[Bin::EMPTY; BINS]; 3];
            for primitive in part {
                let [x, y, z] = binning.bin(primitive);
                let (min, max) = (primitive.bounds.min.into(), primitive.bounds.max.into());
                bins[0][x].add(min, max);
                bins[1][y].add(min, max);
                bins[2][z].add(min, max);
            }
            bins
        };
        let join = |a: [[Bin; BINS]; 3], b: [[Bin; BINS]; 3]| {
            [0, 1, 2].map(|axis| std::array::from_fn(|i| a[axis][i].union(b[axis][i])))
        };
        Self(in_chunks(primitives, fill, join))
    }

    /// The axis, the last bin of the left side, and the boxes of both sides of the cheapest cut. None if no cut
    /// separates the centres.
    fn cheapest_cut(&self, scale: Vec3A) -> Option<(usize, usize, Aabb, Aabb)> {
        let mut best: Option<(f32, usize, usize, Aabb, Aabb)> = None;
        for axis in (0..3).filter(|&axis| scale[axis] > 0.0) {
            let bins = &self.0[axis];
            let mut right = [Bin::EMPTY; BINS];
            for i in (1..BINS).rev() {
                right[i - 1] = if i == BINS - 1 { bins[i] } else { right[i].union(bins[i]) };
            }
            let mut left = Bin::EMPTY;
            for i in 0..BINS - 1 {
                // An empty bin gives the same cut as the bin before it.
                if bins[i].count == 0 {
                    continue;
                }
                left = left.union(bins[i]);
                if right[i].count == 0 {
                    break;
                }
                let cost = left.cost() + right[i].cost();
                if best.as_ref().is_none_or(|b| cost < b.0) {
                    best = Some((cost, axis, i, left.bounds(), right[i].bounds()));
                }
            }
        }
        best.map(|(_, axis, cut, left, right)| (axis, cut, left, right))
    }
}

/// Reduces over all primitives, with several threads for many of them. `join` must be commutative and associative.
fn in_chunks<T: Send>(
    primitives: &[Primitive],
    sum: impl Fn(&[Primitive]) -> T + Sync,
    join: impl Fn(T, T) -> T + Sync + Send,
) -> T {
    if primitives.len() < 2 * CHUNK {
        return sum(primitives);
    }
    primitives.par_chunks(CHUNK).map(&sum).reduce_with(join).expect("there are several chunks")
}

/// Reorders a range so that the cost of its two sides is smallest by the surface area heuristic. Returns the start of
/// the right side, and the box of each side.
pub(super) fn split(primitives: &mut [Primitive]) -> (usize, Aabb, Aabb) {
    let binning = Binning::of(primitives);
    // Without a cut all centres coincide, and any split has the same cost.
    let Some((axis, cut, left, right)) = Bins::of(primitives, binning).cheapest_cut(binning.scale) else {
        return split_in_half(primitives);
    };
    let (origin, scale) = (binning.origin[axis], binning.scale[axis]);
    let last = cut as f32 + 1.0;
    (partition(primitives, |p| (p.center()[axis] - origin) * scale < last), left, right)
}

/// Two halves by count along the longest axis of the box.
pub(super) fn split_in_half(primitives: &mut [Primitive]) -> (usize, Aabb, Aabb) {
    let extent = bounds_of(primitives).extent();
    let axis = (1..3).fold(0, |longest, axis| if extent[axis] > extent[longest] { axis } else { longest });
    let middle = primitives.len() / 2;
    let key = |p: &Primitive| p.center()[axis];
    primitives.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.face.cmp(&b.face)));
    (middle, bounds_of(&primitives[..middle]), bounds_of(&primitives[middle..]))
}

/// Moves the members for which `holds` is true to the front and returns their number. The order depends on the input
/// only.
fn partition(primitives: &mut [Primitive], holds: impl Fn(&Primitive) -> bool) -> usize {
    let (mut low, mut high) = (0, primitives.len());
    while low < high {
        if holds(&primitives[low]) {
            low += 1;
        } else {
            high -= 1;
            primitives.swap(low, high);
        }
    }
    low
}

/// Stores nodes depth first, parents before children.
fn flatten(children: Vec<(Aabb, Subtree)>, nodes: &mut Vec<Node>, leaves: &mut Vec<(usize, usize)>) -> usize {
    let index = nodes.len();
    nodes.push(Node::empty());
    for (lane, (bounds, subtree)) in children.into_iter().enumerate() {
        let child = match subtree {
            Subtree::Leaf { start, count } => {
                leaves.push((start, count));
                ChildRef::pack(leaves.len() - 1)
            }
            Subtree::Inner(children) => ChildRef::node(flatten(children, nodes, leaves)),
        };
        nodes[index].set(lane, bounds, child);
    }
    index
}
