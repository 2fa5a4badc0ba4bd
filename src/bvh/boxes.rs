//! A binary tree over boxes: of merged instances, the parts of shapes, or the bodies of an assembly.
//!
//! *Theory.* The tree is built like the tree over triangles (binned surface area heuristic, [`super::build`]), with two
//! children per node, adjacent in memory. Boxes are float32 relative to a float64 centre and rounded outwards, so they
//! contain their items far from the origin too. A node has 32 bytes.
//!
//! *Practice.* [`BoxTree::around`] visits leaves from near to far, and the visitor may lower the limit. The items of a
//! leaf are adjacent in [`BoxTree::order`]. A caller that stores its items in that order needs no further index.

use super::build::{Extent, Primitive, split, split_in_half};
use crate::geometry::Aabb;
pub(crate) use crate::gpu::constants::BOX_STACK as MAX_STACK;
use glam::{DVec3, Vec3};

/// Largest number of items in a leaf.
const LEAF: usize = 4;
/// From this level on ranges are halved by count, so that no input makes a deep tree. A walk keeps one sibling per
/// level, and 2^32 objects take 32 levels of halves.
const HALVE_FROM: usize = MAX_STACK - 32;

/// A box and its contents. Leaf: `count` items of the order from `first` on. Inner node: `count` is zero and the
/// children are the nodes `first` and `first + 1`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BoxNode {
    pub min: Vec3,
    pub max: Vec3,
    pub first: u32,
    pub count: u32,
}

/// The tree. The root is node 0. A tree without items has no nodes.
#[derive(Debug, Clone, Default)]
pub(crate) struct BoxTree {
    pub nodes: Vec<BoxNode>,
    /// Indices of the items, leaf by leaf.
    pub order: Vec<u32>,
    /// Origin of the coordinates of the boxes.
    pub center: DVec3,
}

impl BoxTree {
    /// `boxes` are pairs of a lower and an upper corner. They must be finite, and differ by less than the range of
    /// float32.
    pub(crate) fn new(boxes: &[[DVec3; 2]]) -> Self {
        let Some(bounds) = boxes.iter().copied().reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])]) else {
            return Self::default();
        };
        let center = 0.5 * bounds[0] + 0.5 * bounds[1];
        let mut primitives: Vec<Primitive> = boxes
            .iter()
            .enumerate()
            .map(|(i, [lower, upper])| {
                let bounds = Aabb { min: round_down(*lower - center), max: -round_down(center - *upper) };
                Primitive::new(bounds, i as u32)
            })
            .collect();
        let mut nodes = vec![BoxNode { min: Vec3::ZERO, max: Vec3::ZERO, first: 0, count: 0 }];
        let extent = Extent::of(&primitives);
        subdivide(&mut primitives, &extent, &mut nodes, 0, 0, 0);
        Self { nodes, order: primitives.iter().map(|primitive| primitive.index()).collect(), center }
    }

    /// Visits the items of all leaves nearer than `limit` to the box from `lower` to `upper`, near leaves first.
    /// `visit` receives the position in the order and may lower the limit. A leaf that touches the box is always
    /// visited.
    pub(crate) fn around(&self, [lower, upper]: [DVec3; 2], mut limit: f64, mut visit: impl FnMut(usize, &mut f64)) {
        if self.nodes.is_empty() {
            return;
        }
        let (lower, upper) = (lower - self.center, upper - self.center);
        let distance = |index: u32| {
            let node = &self.nodes[index as usize];
            (node.min.as_dvec3() - upper).max(lower - node.max.as_dvec3()).max(DVec3::ZERO).length()
        };
        // Among children that both touch the box, the one nearer to its centre is visited first.
        let center = 0.5 * (lower + upper);
        let from_center = |index: u32| {
            let node = &self.nodes[index as usize];
            (node.min.as_dvec3() - center).max(center - node.max.as_dvec3()).max(DVec3::ZERO).length_squared()
        };
        let mut stack = [(0.0, 0u32); MAX_STACK];
        stack[0] = (distance(0), 0);
        let mut waiting = 1;
        while waiting > 0 {
            waiting -= 1;
            let (nearest, index) = stack[waiting];
            // The slack exceeds the rounding of the corners, so no item is missed.
            if nearest > 0.0 && nearest * (1.0 - DISTANCE_SLACK) >= limit {
                continue;
            }
            let node = &self.nodes[index as usize];
            for place in node.first..node.first + node.count {
                visit(place as usize, &mut limit);
            }
            if node.count == 0 {
                let mut children = [node.first, node.first + 1];
                if from_center(children[0]) < from_center(children[1]) {
                    children.swap(0, 1);
                }
                for child in children {
                    stack[waiting] = (distance(child), child);
                    waiting += 1;
                }
            }
        }
    }
}

/// Relative slack for the rounding of a distance between boxes in float64.
pub(crate) const DISTANCE_SLACK: f64 = 1e-12;

/// Fills node `index` with a range of items; `start` is the position of the range in the order.
fn subdivide(
    primitives: &mut [Primitive],
    extent: &Extent,
    nodes: &mut Vec<BoxNode>,
    index: usize,
    start: usize,
    depth: usize,
) {
    let Aabb { min, max } = extent.bounds;
    let node = |first: usize, count: usize| BoxNode { min, max, first: first as u32, count: count as u32 };
    if primitives.len() <= LEAF {
        nodes[index] = node(start, primitives.len());
        return;
    }
    let (middle, of_left, of_right) =
        if depth < HALVE_FROM { split(primitives, extent) } else { split_in_half(primitives, &extent.bounds) };
    let first = nodes.len();
    nodes[index] = node(first, 0);
    nodes.extend([node(0, 0); 2]);
    let (left, right) = primitives.split_at_mut(middle);
    subdivide(left, &of_left, nodes, first, start, depth + 1);
    subdivide(right, &of_right, nodes, first + 1, start + middle, depth + 1);
}

/// The largest f32 that does not exceed each coordinate.
pub(crate) fn round_down(p: DVec3) -> Vec3 {
    Vec3::from_array(p.to_array().map(|x| {
        let rounded = x as f32;
        if f64::from(rounded) > x { rounded.next_down() } else { rounded }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn a_box() -> impl Strategy<Value = [DVec3; 2]> {
        (prop::array::uniform3(-10.0..10.0f64), prop::array::uniform3(0.0..1.0f64)).prop_map(|(lower, size)| {
            let lower = DVec3::from(lower) + 1e6;
            [lower, lower + DVec3::from(size)]
        })
    }

    proptest! {
        #[test]
        fn walks_find_every_near_box(
            boxes in prop::collection::vec(a_box(), 0..200),
            origin in prop::array::uniform3(-20.0..20.0f64),
            limit in 0.0..5.0f64,
        ) {
            let tree = BoxTree::new(&boxes);
            let mut order = tree.order.clone();
            order.sort_unstable();
            prop_assert_eq!(order, (0..boxes.len() as u32).collect::<Vec<_>>());

            let origin = DVec3::from(origin) + 1e6;
            let around = [origin, origin + 0.5];
            let mut found = Vec::new();
            tree.around(around, limit, |place, _| found.push(tree.order[place] as usize));
            for (i, b) in boxes.iter().enumerate() {
                let distance = (b[0] - around[1]).max(around[0] - b[1]).max(DVec3::ZERO).length();
                prop_assert!(distance > limit || found.contains(&i));
            }
        }
    }

    #[test]
    fn equal_boxes_do_not_make_a_deep_tree() {
        let tree = BoxTree::new(&vec![[DVec3::ZERO, DVec3::ONE]; 5000]);
        let mut deepest = 0;
        let mut stack = vec![(0u32, 1)];
        while let Some((index, depth)) = stack.pop() {
            deepest = deepest.max(depth);
            let node = &tree.nodes[index as usize];
            if node.count == 0 {
                stack.extend([(node.first, depth + 1), (node.first + 1, depth + 1)]);
            }
        }
        assert!(deepest <= MAX_STACK);
    }
}
