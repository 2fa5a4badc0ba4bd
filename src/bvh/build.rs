//! Top-down build: binned surface area heuristic, in parallel, the same tree for any number of threads.

use super::pack::Pack;
use super::{Bvh, ChildRef, Node, WIDTH};
use crate::geometry::Aabb;
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;

const BINS: usize = 16;
/// Below this many triangles a subtree is built on the thread that has it.
const PARALLEL_ABOVE: usize = 4096;
/// From this level on ranges are halved by count, so that no input (boxes in geometric progression) makes a deep tree.
const HALVE_FROM: usize = 16;
/// Eight equal parts a level bring 2^30 triangles down to a leaf in ten more levels; halving rounds, hence one to spare.
pub(super) const MAX_DEPTH: usize = HALVE_FROM + 11;

/// A triangle as the build sees it.
#[derive(Clone, Copy)]
pub(super) struct Primitive {
    pub bounds: Aabb,
    pub face: u32,
}

impl Primitive {
    /// Twice the centre of the box: the order is all that matters.
    fn center(&self) -> Vec3 {
        self.bounds.min + self.bounds.max
    }
}

/// A finished subtree before it gets its place in memory.
enum Subtree {
    Leaf { start: usize, count: usize },
    Inner(Vec<(Aabb, Subtree)>),
}

pub(super) fn build(positions: &[Vec3], faces: &[[u32; 3]]) -> Bvh {
    let mut primitives: Vec<Primitive> = faces
        .par_iter()
        .enumerate()
        .map(|(face, corners)| Primitive {
            bounds: Aabb::of_points(&corners.map(|v| positions[v as usize])),
            face: face as u32,
        })
        .collect();
    let bounds = bounds_of(&primitives);
    let root = subdivide(&mut primitives, 0, 0);
    // The root is always a node, also over a single leaf.
    let children = match root {
        Subtree::Inner(children) => children,
        leaf => vec![(bounds, leaf)],
    };

    let mut nodes = Vec::new();
    let mut leaves = Vec::new();
    flatten(children, &mut nodes, &mut leaves);
    let packs = leaves
        .par_iter()
        .map(|&(start, count)| {
            let mut members = [0; WIDTH];
            for (member, primitive) in members.iter_mut().zip(&primitives[start..start + count]) {
                *member = primitive.face;
            }
            Pack::new(positions, faces, &members[..count])
        })
        .collect();
    Bvh { nodes, packs, bounds }
}

pub(super) fn bounds_of(primitives: &[Primitive]) -> Aabb {
    primitives.iter().fold(Aabb::EMPTY, |bounds, p| bounds.union(p.bounds))
}

/// Split the range with the largest box until there are eight ranges, then go on inside each.
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

/// Reorder a range so that its two sides cost least by the surface area heuristic; returns where the right one begins,
/// and the box of each.
pub(super) fn split(primitives: &mut [Primitive]) -> (usize, Aabb, Aabb) {
    let centers = primitives.iter().fold(Aabb::EMPTY, |bounds, p| bounds.grown(p.center()));
    let extent = centers.extent();
    let scale = Vec3::from_array(extent.to_array().map(|e| if e > 0.0 { BINS as f32 * (1.0 - 1e-6) / e } else { 0.0 }));
    let bin_of =
        |p: &Primitive| ((p.center() - centers.min) * scale).as_uvec3().min(glam::UVec3::splat(BINS as u32 - 1));

    let mut bins = [[(Aabb::EMPTY, 0usize); BINS]; 3];
    for primitive in primitives.iter() {
        let bin = bin_of(primitive);
        for axis in 0..3 {
            let (bounds, count) = &mut bins[axis][bin[axis] as usize];
            *bounds = bounds.union(primitive.bounds);
            *count += 1;
        }
    }

    // Cost of a cut after each bin: packs touched on either side, weighed by the chance to touch them.
    let packs = |count: usize| count.div_ceil(WIDTH) as f32;
    let mut best: Option<(f32, usize, usize, Aabb, Aabb)> = None;
    for axis in (0..3).filter(|&axis| extent[axis] > 0.0) {
        let mut right = [(Aabb::EMPTY, 0usize); BINS];
        let mut running = (Aabb::EMPTY, 0);
        for i in (1..BINS).rev() {
            running = (running.0.union(bins[axis][i].0), running.1 + bins[axis][i].1);
            right[i] = running;
        }
        let mut left = (Aabb::EMPTY, 0);
        for i in 0..BINS - 1 {
            left = (left.0.union(bins[axis][i].0), left.1 + bins[axis][i].1);
            let (right_bounds, right_count) = right[i + 1];
            if left.1 == 0 || right_count == 0 {
                continue;
            }
            let cost = left.0.half_area() * packs(left.1) + right_bounds.half_area() * packs(right_count);
            if best.as_ref().is_none_or(|b| cost < b.0) {
                best = Some((cost, axis, i, left.0, right_bounds));
            }
        }
    }

    // Without a cut all centres coincide, and any halves are as good.
    let Some((_, axis, cut, left, right)) = best else { return split_in_half(primitives) };
    (partition(primitives, |p| bin_of(p)[axis] as usize <= cut), left, right)
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

/// Move the members that hold to the front, returns their number. The order depends on the input alone.
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

/// Lay nodes out depth first, parents before children.
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
