//! Top-down build of the tree by the binned surface area heuristic. It is parallel, and the tree does not depend on the
//! number of threads.

use super::pack::Pack;
use super::{Bvh, ChildRef, Node, WIDTH};
use crate::geometry::Aabb;
use crate::memory::with_room;
use glam::{Vec3, Vec3A, Vec3Swizzles, Vec4};
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
    /// The fourth lane has the bits of the index plus [`FIRST_INDEX`]. Differences of two such numbers are not
    /// subnormal, so that arithmetic on all lanes is fast and the fourth one can be ignored.
    min: Vec4,
    max: Vec4,
}

/// The bits of 1. The largest index of a face, 2^30 - 1, becomes the largest float32.
const FIRST_INDEX: u32 = 0x3F80_0000;

impl Primitive {
    pub(super) fn new(bounds: Aabb, index: u32) -> Self {
        Self { min: bounds.min.extend(f32::from_bits(index.wrapping_add(FIRST_INDEX))), max: bounds.max.extend(0.0) }
    }

    fn of_face(positions: &[Vec3], corners: &[u32; 3], face: u32) -> Self {
        Self::new(Aabb::of_points(&corners.map(|v| positions[v as usize])), face)
    }

    /// The index of the triangle or the item.
    pub(super) fn index(&self) -> u32 {
        self.min.w.to_bits().wrapping_sub(FIRST_INDEX)
    }

    #[inline(always)]
    fn min(&self) -> Vec3A {
        Vec3A::from_vec4(self.min)
    }

    #[inline(always)]
    fn max(&self) -> Vec3A {
        Vec3A::from_vec4(self.max)
    }

    /// Twice the centre of the box. Only the order of centres is used.
    #[inline(always)]
    fn center(&self) -> Vec3A {
        self.min() + self.max()
    }

    /// One coordinate of [`Primitive::center`].
    #[inline(always)]
    fn center_along(&self, axis: usize) -> f32 {
        self.min.as_ref()[axis] + self.max.as_ref()[axis]
    }
}

/// The boxes around some primitives and around their centres.
#[derive(Clone, Copy)]
pub(super) struct Extent {
    pub bounds: Aabb,
    centers: Corners,
}

/// The lowest and the highest coordinates of some points.
#[derive(Clone, Copy)]
struct Corners {
    min: Vec3A,
    max: Vec3A,
}

impl Corners {
    const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    #[inline(always)]
    fn grow(&mut self, min: Vec3A, max: Vec3A) {
        self.min = self.min.min(min);
        self.max = self.max.max(max);
    }

    #[inline(always)]
    fn union(mut self, other: Self) -> Self {
        self.grow(other.min, other.max);
        self
    }

    fn bounds(&self) -> Aabb {
        Aabb { min: self.min.into(), max: self.max.into() }
    }

    /// See [`Aabb::half_area`]. The corners are not empty.
    #[inline(always)]
    fn half_area(&self) -> f32 {
        let e = self.max - self.min;
        (e * e.yzx()).element_sum()
    }
}

impl Extent {
    pub(super) fn of(primitives: &[Primitive]) -> Self {
        let sum = |part: &[Primitive]| {
            let (mut bounds, mut centers) = (Corners::EMPTY, Corners::EMPTY);
            for p in part {
                bounds.grow(p.min(), p.max());
                centers.grow(p.center(), p.center());
            }
            (bounds, centers)
        };
        let (bounds, centers) = in_chunks(primitives, sum, |a, b| (a.0.union(b.0), a.1.union(b.1)));
        Self { bounds: bounds.bounds(), centers }
    }
}

/// A finished subtree before its nodes get their positions in memory.
enum Subtree {
    Leaf { start: usize, count: usize },
    Inner(Vec<(Aabb, Subtree)>),
}

/// The tree over all faces.
pub(super) fn build(positions: &[Vec3], faces: &[[u32; 3]]) -> Bvh {
    let primitive = |(face, corners)| Primitive::of_face(positions, corners, face as u32);
    build_over(positions, faces, collected(faces.par_iter().enumerate().map(primitive)))
}

/// The tree over some of the faces.
pub(super) fn build_of(positions: &[Vec3], faces: &[[u32; 3]], members: &[u32]) -> Bvh {
    let primitive = |&face: &u32| Primitive::of_face(positions, &faces[face as usize], face);
    build_over(positions, faces, collected(members.par_iter().map(primitive)))
}

/// The items in an array with large pages.
fn collected<T: Send>(items: impl IndexedParallelIterator<Item = T>) -> Vec<T> {
    let mut array = with_room(items.len());
    items.collect_into_vec(&mut array);
    array
}

fn build_over(positions: &[Vec3], faces: &[[u32; 3]], mut primitives: Vec<Primitive>) -> Bvh {
    let extent = Extent::of(&primitives);
    let bounds = extent.bounds;
    let root = subdivide(&mut primitives, extent, 0, 0);
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
            *member = primitive.index();
        }
        Pack::new(positions, faces, &members[..count])
    }));
    let built_cost = Bvh::cost(&nodes);
    let has_equal_boxes = Bvh::has_equal_boxes(&nodes);
    Bvh { nodes, packs, bounds, built_cost, is_refitted: false, has_equal_boxes }
}

/// Splits the range with the largest box until there are eight ranges, then subdivides each.
fn subdivide(primitives: &mut [Primitive], extent: Extent, start: usize, depth: usize) -> Subtree {
    if primitives.len() <= WIDTH {
        return Subtree::Leaf { start, count: primitives.len() };
    }
    let mut ranges = Vec::with_capacity(WIDTH);
    ranges.push((extent, 0..primitives.len()));
    let halve = depth >= HALVE_FROM;
    let weight = |(extent, range): &(Extent, Range<usize>)| {
        if halve { range.len() as f32 } else { extent.bounds.half_area() }
    };
    while ranges.len() < WIDTH {
        let largest = (0..ranges.len())
            .filter(|&i| ranges[i].1.len() > WIDTH)
            .max_by(|&i, &j| weight(&ranges[i]).total_cmp(&weight(&ranges[j])).then(j.cmp(&i)));
        let Some(largest) = largest else { break };
        let (extent, range) = ranges[largest].clone();
        let part = &mut primitives[range.clone()];
        let (middle, left, right) = if halve { split_in_half(part, &extent.bounds) } else { split(part, &extent) };
        ranges[largest] = (left, range.start..range.start + middle);
        ranges.insert(largest + 1, (right, range.start + middle..range.end));
    }

    let parallel = primitives.len() > PARALLEL_ABOVE;
    let mut rest = primitives;
    let mut parts = Vec::with_capacity(ranges.len());
    let mut offset = start;
    for (extent, range) in ranges {
        let (part, tail) = rest.split_at_mut(range.len());
        parts.push((extent, part, offset));
        offset += range.len();
        rest = tail;
    }
    let below = |(extent, part, start): (Extent, &mut [Primitive], usize)| {
        (extent.bounds, subdivide(part, extent, start, depth + 1))
    };
    Subtree::Inner(if parallel {
        parts.into_par_iter().map(below).collect()
    } else {
        parts.into_iter().map(below).collect()
    })
}

/// Boxes and counts of the primitives whose centres lie in the same sixteenth of the range, for each axis.
#[derive(Clone, Copy)]
struct Bins {
    boxes: [[Corners; BINS]; 3],
    counts: [[u32; BINS]; 3],
}

/// Maps a centre to its bin.
#[derive(Clone, Copy)]
struct Binning {
    origin: Vec3A,
    scale: Vec3A,
}

/// 1.5 x 2^23: the sum of this and a float32 from -1/2 to 2^22 has the nearest whole number in its low bits.
const ROUNDING_SHIFT: f32 = 12_582_912.0;

impl Binning {
    fn of(centers: &Corners) -> Self {
        let extent = centers.max - centers.min;
        let scale = extent.to_array().map(|e| if e > 0.0 { BINS as f32 * (1.0 - 1e-6) / e } else { 0.0 });
        Self { origin: centers.min, scale: scale.into() }
    }

    #[inline(always)]
    fn bins(&self, center: Vec3A) -> [usize; 3] {
        let place = (center - self.origin) * self.scale - Vec3A::splat(0.5) + Vec3A::splat(ROUNDING_SHIFT);
        place.to_array().map(bin_of)
    }

    /// One coordinate of [`Binning::bins`].
    #[inline(always)]
    fn bin_along(&self, axis: usize, center: f32) -> usize {
        bin_of((center - self.origin[axis]) * self.scale[axis] - 0.5 + ROUNDING_SHIFT)
    }
}

#[inline(always)]
fn bin_of(shifted: f32) -> usize {
    shifted.to_bits() as usize % BINS
}

impl Bins {
    const EMPTY: Self = Self { boxes: [[Corners::EMPTY; BINS]; 3], counts: [[0; BINS]; 3] };

    fn of(primitives: &[Primitive], binning: Binning) -> Self {
        let mut bins = Self::EMPTY;
        if primitives.len() < 2 * CHUNK {
            bins.fill(primitives, binning);
            return bins;
        }
        let of_chunk = |part| {
            let mut bins = Self::EMPTY;
            bins.fill(part, binning);
            bins
        };
        let join = |mut a: Self, b: Self| {
            for axis in 0..3 {
                for i in 0..BINS {
                    a.boxes[axis][i] = a.boxes[axis][i].union(b.boxes[axis][i]);
                    a.counts[axis][i] += b.counts[axis][i];
                }
            }
            a
        };
        primitives.par_chunks(CHUNK).map(of_chunk).reduce(|| Self::EMPTY, join)
    }

    #[inline(always)]
    fn fill(&mut self, primitives: &[Primitive], binning: Binning) {
        for primitive in primitives {
            let (min, max) = (primitive.min(), primitive.max());
            let places = binning.bins(min + max);
            for axis in 0..3 {
                self.boxes[axis][places[axis]].grow(min, max);
                self.counts[axis][places[axis]] += 1;
            }
        }
    }

    /// The axis, the last bin of the left side, and the boxes of both sides of the cheapest cut. None if no cut
    /// separates the centres.
    ///
    /// The cost of a side is the expected number of packs to test: their number times the surface area. The first and
    /// the last bin of an axis have centres, so no side is empty; an empty bin gives the same cut as the bin before it.
    fn cheapest_cut(&self, scale: Vec3A) -> Option<(usize, usize, Aabb, Aabb)> {
        let cost = |corners: &Corners, count: u32| corners.half_area() * count.div_ceil(WIDTH as u32) as f32;
        let mut best = (f32::INFINITY, 0, 0);
        for axis in (0..3).filter(|&axis| scale[axis] > 0.0) {
            let (boxes, counts) = (&self.boxes[axis], &self.counts[axis]);
            let mut right_costs = [0.0; BINS];
            let (mut side, mut count) = (Corners::EMPTY, 0);
            for i in (1..BINS).rev() {
                side = side.union(boxes[i]);
                count += counts[i];
                right_costs[i - 1] = cost(&side, count);
            }
            let (mut side, mut count) = (Corners::EMPTY, 0);
            for i in 0..BINS - 1 {
                side = side.union(boxes[i]);
                count += counts[i];
                let both = cost(&side, count) + right_costs[i];
                if both < best.0 {
                    best = (both, axis, i);
                }
            }
        }
        let (cost, axis, cut) = best;
        let join = |boxes: &[Corners]| boxes.iter().fold(Corners::EMPTY, |a, &b| a.union(b)).bounds();
        let (left, right) = self.boxes[axis].split_at(cut + 1);
        (cost < f32::INFINITY).then(|| (axis, cut, join(left), join(right)))
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
/// the right side, and the extent of each side.
pub(super) fn split(primitives: &mut [Primitive], extent: &Extent) -> (usize, Extent, Extent) {
    let binning = Binning::of(&extent.centers);
    // Without a cut all centres coincide, and any split has the same cost.
    let Some((axis, cut, left, right)) = Bins::of(primitives, binning).cheapest_cut(binning.scale) else {
        return split_in_half(primitives, &extent.bounds);
    };
    // Moves the members of the left side to the front, without a branch on the side. The order depends on the input
    // only.
    let mut middle = 0;
    for i in 0..primitives.len() {
        let is_left = binning.bin_along(axis, primitives[i].center_along(axis)) <= cut;
        primitives.swap(i, middle);
        middle += usize::from(is_left);
    }
    let centers = |part: &[Primitive]| {
        let mut corners = Corners::EMPTY;
        for primitive in part {
            corners.grow(primitive.center(), primitive.center());
        }
        corners
    };
    let (of_left, of_right) = (centers(&primitives[..middle]), centers(&primitives[middle..]));
    (middle, Extent { bounds: left, centers: of_left }, Extent { bounds: right, centers: of_right })
}

/// Two halves by count along the longest axis of the box.
pub(super) fn split_in_half(primitives: &mut [Primitive], bounds: &Aabb) -> (usize, Extent, Extent) {
    let extent = bounds.extent();
    let axis = (1..3).fold(0, |longest, axis| if extent[axis] > extent[longest] { axis } else { longest });
    let middle = primitives.len() / 2;
    let key = |p: &Primitive| p.center_along(axis);
    primitives.select_nth_unstable_by(middle, |a, b| key(a).total_cmp(&key(b)).then(a.index().cmp(&b.index())));
    (middle, Extent::of(&primitives[..middle]), Extent::of(&primitives[middle..]))
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
