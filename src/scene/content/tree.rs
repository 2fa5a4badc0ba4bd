//! A binary tree over the boxes of instances, for rays and for cones.
//!
//! The tree is built by halving the longest axis of the centres. A scene has hundreds or thousands of instances, so the
//! build takes microseconds.

use crate::geometry::Aabb;
use crate::gpu::layout::SceneNode;
use crate::simd::with_vectors;
use glam::{Vec3, Vec3A};

/// Largest number of items in a leaf. Nodes of devices have two.
const LEAF: usize = 2;
/// Halving divides 2^32 boxes into leaves in 32 levels. The stack of a search holds at most one node per level, and the
/// root.
pub(crate) const MAX_DEPTH: usize = 34;
/// Boxes are enlarged by this fraction of the scene size, 1: more than the rounding of a float32 slab test.
const MARGIN: f32 = 2e-6;

/// A node of the tree.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    min: [f32; 3],
    max: [f32; 3],
    /// Leaf: first item. Inner node: left child; the right child follows it.
    first: u32,
    /// Number of items in a leaf; 0 for an inner node.
    count: u32,
}

/// The tree. The root is node 0.
#[derive(Debug)]
pub struct Tree {
    nodes: Vec<Node>,
    items: Vec<u32>,
}

/// A ray in scene space, prepared for tests of boxes.
#[derive(Debug, Clone, Copy)]
pub struct Line {
    origin: Vec3A,
    inverse: Vec3A,
    /// Enlargement of boxes per distance of their far corner: 0 for a ray.
    spread: f32,
    /// Slope of the cone's side.
    slope: f32,
    /// Radius of the cone at its start.
    start_radius: f32,
}

/// Inverse of a zero component.
const PARALLEL: f32 = 1e30;

impl Line {
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        Self::cone(origin, direction, 0.0)
    }

    /// A cone of radius `slope * distance` around a ray with a unit direction; the slope is below 1.
    pub fn cone(origin: Vec3, direction: Vec3, slope: f32) -> Self {
        let inverse = |d: f32| if d.abs() < 1.0 / PARALLEL { PARALLEL } else { 1.0 / d };
        let inverse = Vec3A::new(inverse(direction.x), inverse(direction.y), inverse(direction.z));
        // A point of the box in the cone lies within `far` of the origin, and its projection onto the axis within
        // `far / (1 - slope)`.
        Self { origin: origin.into(), inverse, spread: 0.0, slope: 0.0, start_radius: 0.0 }.with_slope(slope)
    }

    /// A cone with the same axis and another slope.
    pub fn with_slope(self, slope: f32) -> Self {
        Self { spread: slope / (1.0 - slope.min(0.9)), slope, ..self }
    }

    /// The truncated cone that has the same slope, and a radius at its start.
    pub fn with_start_radius(self, start_radius: f32) -> Self {
        Self { start_radius, ..self }
    }

    /// The interval of the ray inside a box, with `t` not below 0; `None` if it misses.
    #[inline(always)]
    pub fn span(&self, min: Vec3A, max: Vec3A, t_max: f32) -> Option<(f32, f32)> {
        // A cone touches the box if its axis intersects the box enlarged by the largest radius there.
        let grown = if self.spread > 0.0 {
            let far = (self.origin - min).abs().max((self.origin - max).abs()).length();
            // The cone is not wider than at its end either.
            self.start_radius + (self.spread * (far + self.start_radius)).min(self.slope * t_max)
        } else {
            self.start_radius
        };
        self.clip(min, max, grown, t_max)
    }

    /// Whether a cone or a ray may intersect a box before `t_max`.
    #[inline]
    pub fn touches(&self, bounds: &Aabb, t_max: f32) -> bool {
        self.span((bounds.min - MARGIN).into(), (bounds.max + MARGIN).into(), t_max).is_some()
    }

    /// The part of the ray in a box that is grown by a length on all sides.
    #[inline(always)]
    fn clip(&self, min: Vec3A, max: Vec3A, grown: f32, t_max: f32) -> Option<(f32, f32)> {
        let a = (min - grown - self.origin) * self.inverse;
        let b = (max + grown - self.origin) * self.inverse;
        let (near, far) = (a.min(b), a.max(b));
        let enter = near.max_element().max(0.0);
        let leave = far.min_element().min(t_max);
        (enter <= leave * 1.000_001).then_some((enter, leave))
    }
}

/// Number of rays that are tested together.
const LANES: usize = 8;

/// Rays in scene space side by side, for the test of one box against all of them.
#[derive(Debug, Default)]
pub(crate) struct Lines {
    /// Components of the origins and of the inverse directions, and the ends, for groups of [`LANES`] rays.
    groups: Vec<LineGroup>,
    count: usize,
}

/// The components of some rays, indexed by axis and ray.
#[derive(Debug, Clone, Copy)]
struct LineGroup {
    origin: [[f32; LANES]; 3],
    inverse: [[f32; LANES]; 3],
    t_max: [f32; LANES],
}

impl Lines {
    /// Adds a ray. The ray ends at `t_max`.
    pub(crate) fn push(&mut self, line: &Line, t_max: f32) {
        let lane = self.count % LANES;
        if lane == 0 {
            let [origin, inverse] = [[[0.0; LANES]; 3]; 2];
            self.groups.push(LineGroup { origin, inverse, t_max: [f32::NEG_INFINITY; LANES] });
        }
        self.count += 1;
        let group = &mut self.groups[(self.count - 1) / LANES];
        for axis in 0..3 {
            group.origin[axis][lane] = line.origin[axis];
            group.inverse[axis][lane] = line.inverse[axis];
        }
        group.t_max[lane] = t_max;
    }

    /// Removes a ray from further tests.
    pub(crate) fn remove(&mut self, i: usize) {
        self.groups[i / LANES].t_max[i % LANES] = f32::NEG_INFINITY;
    }

    /// Appends the rays that may intersect a box, by the test of [`Line::touches`], to `found`.
    pub(crate) fn touching(&self, bounds: &Aabb, found: &mut Vec<usize>) {
        let (min, max) = ((bounds.min - MARGIN).to_array(), (bounds.max + MARGIN).to_array());
        let groups = &self.groups[..];
        with_vectors!((
            groups: &[LineGroup] = groups,
            min: [f32; 3] = min,
            max: [f32; 3] = max,
            found: &mut Vec<usize> = found,
        ) {
            for (i, group) in groups.iter().enumerate() {
                let mut mask = group.touching(min, max);
                while mask != 0 {
                    found.push(LANES * i + mask.trailing_zeros() as usize);
                    mask &= mask - 1;
                }
            }
        })
    }
}

impl LineGroup {
    /// Mask of the rays that may intersect a box.
    #[inline(always)]
    fn touching(&self, min: [f32; 3], max: [f32; 3]) -> u32 {
        let mut mask = 0;
        let (mut enter, mut leave) = ([0.0f32; LANES], self.t_max);
        for axis in 0..3 {
            let (origin, inverse) = (&self.origin[axis], &self.inverse[axis]);
            for lane in 0..LANES {
                let a = (min[axis] - origin[lane]) * inverse[lane];
                let b = (max[axis] - origin[lane]) * inverse[lane];
                let (near, far) = if a < b { (a, b) } else { (b, a) };
                enter[lane] = if near > enter[lane] { near } else { enter[lane] };
                leave[lane] = if far < leave[lane] { far } else { leave[lane] };
            }
        }
        for lane in 0..LANES {
            mask |= u32::from(enter[lane] <= leave[lane] * 1.000_001) << lane;
        }
        mask
    }
}

impl Tree {
    /// `boxes` are in scene space.
    pub fn new(boxes: &[Aabb]) -> Self {
        let mut items: Vec<u32> = (0..boxes.len() as u32).collect();
        let mut nodes = vec![Node::default()];
        let mut waiting = vec![(0usize, 0usize, boxes.len())];
        while let Some((node, first, end)) = waiting.pop() {
            let part = &mut items[first..end];
            let bounds = part.iter().fold(Aabb::EMPTY, |bounds, &item| bounds.union(boxes[item as usize]));
            nodes[node].min = (bounds.min - MARGIN).to_array();
            nodes[node].max = (bounds.max + MARGIN).to_array();
            if part.len() <= LEAF {
                nodes[node].first = first as u32;
                nodes[node].count = part.len() as u32;
                continue;
            }
            let center = |item: u32| boxes[item as usize].min + boxes[item as usize].max;
            let spread = part.iter().fold(Aabb::EMPTY, |bounds, &item| bounds.grown(center(item))).extent();
            let axis = (1..3).fold(0, |longest, axis| if spread[axis] > spread[longest] { axis } else { longest });
            let middle = part.len() / 2;
            part.select_nth_unstable_by(middle, |&a, &b| center(a)[axis].total_cmp(&center(b)[axis]).then(a.cmp(&b)));
            let child = nodes.len();
            nodes[node].first = child as u32;
            nodes[node].count = 0;
            nodes.extend([Node::default(); 2]);
            waiting.push((child, first, first + middle));
            waiting.push((child + 1, first + middle, end));
        }
        Self { nodes, items }
    }

    /// The nodes in the form of devices, which need no list of items.
    pub(crate) fn device_nodes(&self) -> Vec<SceneNode> {
        let node = |&Node { min, max, first, count }: &Node| {
            let [first, second] = match count {
                0 => [first, 0],
                _ => [first, first + count - 1].map(|item| self.items[item as usize]),
            };
            SceneNode { min, first, max, second: if count == 0 { 0 } else { 1 + second } }
        };
        self.nodes.iter().map(node).collect()
    }

    /// Calls `visit` with each item whose leaf comes within `radius` of a point.
    pub fn near(&self, p: Vec3, radius: f32, mut visit: impl FnMut(u32)) {
        let mut stack = [0u32; MAX_DEPTH];
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let node = &self.nodes[stack[top] as usize];
            let (min, max) = (Vec3::from_array(node.min), Vec3::from_array(node.max));
            if p.distance_squared(p.clamp(min, max)) > radius * radius {
                continue;
            }
            if node.count > 0 {
                self.items[node.first as usize..][..node.count as usize].iter().for_each(|&item| visit(item));
            } else {
                stack[top] = node.first;
                stack[top + 1] = node.first + 1;
                top += 2;
            }
        }
    }

    /// Calls `visit` with each item whose leaf the line intersects before `t_max`, near leaves first. `visit` returns
    /// the new limit; a negative limit ends the search.
    pub fn walk(&self, line: &Line, t_max: f32, mut visit: impl FnMut(u32, f32) -> f32) {
        let mut limit = t_max;
        let mut stack = [(0u32, 0.0f32); MAX_DEPTH];
        let mut top = 0;
        let span = |node: u32, limit: f32| {
            let node = &self.nodes[node as usize];
            line.span(Vec3A::from_array(node.min), Vec3A::from_array(node.max), limit)
        };
        if let Some((enter, _)) = span(0, limit) {
            stack[0] = (0, enter);
            top = 1;
        }
        while top > 0 {
            top -= 1;
            let (index, enter) = stack[top];
            if enter > limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            if node.count > 0 {
                for &item in &self.items[node.first as usize..][..node.count as usize] {
                    limit = visit(item, limit);
                    if limit < 0.0 {
                        return;
                    }
                }
                continue;
            }
            // Pushes the far child first.
            let left = (node.first, span(node.first, limit));
            let right = (node.first + 1, span(node.first + 1, limit));
            let is_left_near = matches!((left.1, right.1), (Some((a, _)), Some((b, _))) if a < b);
            for (child, found) in if is_left_near { [right, left] } else { [left, right] } {
                if let Some((enter, _)) = found {
                    stack[top] = (child, enter);
                    top += 1;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn vector() -> impl Strategy<Value = Vec3> {
        (-1.0..1.0f32, -1.0..1.0f32, -1.0..1.0f32).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        /// Every box that a cone touches is visited, at any number of boxes.
        #[test]
        fn no_box_is_missed(
            corners in prop::collection::vec((vector(), vector()), 1..60),
            origin in vector(), direction in vector(), slope in 0.0..0.5f32, start in 0.0..0.3f32
        ) {
            prop_assume!(direction.length() > 0.01);
            let direction = direction.normalize();
            let boxes: Vec<Aabb> = corners.iter().map(|&(p, size)| Aabb { min: p, max: p + 0.2 * size.abs() }).collect();
            let tree = Tree::new(&boxes);
            let mut is_found = vec![false; boxes.len()];
            tree.walk(&Line::cone(origin, direction, slope).with_start_radius(start), 10.0, |item, limit| {
                is_found[item as usize] = true;
                limit
            });
            for (bounds, is_found) in boxes.iter().zip(is_found) {
                // Brute force: points along the axis compared with the box.
                let is_hit = (0..2000).any(|i| {
                    let t = i as f32 * 0.005;
                    let p = origin + t * direction;
                    let nearest = p.clamp(bounds.min, bounds.max);
                    nearest.distance(p) <= start + slope * t
                });
                prop_assert!(is_found || !is_hit);
            }
        }
    }

    proptest! {
        /// Rays side by side find the boxes that single rays find, along axes too, until they are removed.
        #[test]
        fn lines_have_the_results_of_single_rays(
            rays in prop::collection::vec((vector(), vector(), 0.0..3.0f32, prop::bool::ANY), 1..20),
            (corner, size) in (vector(), vector()), removed in 0..20usize
        ) {
            let bounds = Aabb { min: corner, max: corner + size.abs() };
            let (mut lines, mut expected) = (Lines::default(), Vec::new());
            for (i, &(origin, direction, t_max, is_along_axis)) in rays.iter().enumerate() {
                let line = Line::new(origin, if is_along_axis { Vec3::Y } else { direction.normalize_or(Vec3::Z) });
                lines.push(&line, t_max);
                if i != removed && line.touches(&bounds, t_max) {
                    expected.push(i);
                }
            }
            if removed < rays.len() {
                lines.remove(removed);
            }
            let mut found = Vec::new();
            lines.touching(&bounds, &mut found);
            prop_assert_eq!(found, expected);
        }
    }

    #[test]
    fn near_leaves_come_first_and_the_limit_ends_the_walk() {
        let boxes: Vec<Aabb> = (0..40)
            .map(|i| Aabb { min: Vec3::new(i as f32, -1.0, -1.0), max: Vec3::new(i as f32 + 0.5, 1.0, 1.0) })
            .collect();
        let tree = Tree::new(&boxes);
        let mut order = Vec::new();
        tree.walk(&Line::new(Vec3::new(-1.0, 0.0, 0.0), Vec3::X), 100.0, |item, limit| {
            order.push(item);
            if order.len() == 10 { -1.0 } else { limit }
        });
        assert_eq!(order.len(), 10);
        // Leaves hold at most two items, in any order.
        assert!(order.iter().enumerate().all(|(i, &item)| (item as usize).abs_diff(i) <= 2), "{order:?}");
    }
}
