//! The distance of two sets of triangles.
//!
//! *Theory.* A binary tree over the triangles of each set is traversed at once, pairs of nodes with the smallest
//! distance of their boxes first (E. Larsen, S. Gottschalk, M. Lin and D. Manocha, "Fast Distance Queries with
//! Rectangular Swept Sphere Volumes", ICRA 2000, with boxes). Boxes of the second set are enclosed by boxes in the
//! frame of the first one. Pairs of triangles are compared in float64.

use super::Similarity;
use super::solid::Solid;
use crate::bvh::boxes::{BoxNode, BoxTree};
use crate::geometry::{closest_point_on_triangle, closest_points_of_triangles};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use glam::{DMat3, DVec3};
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Largest number of projections onto one triangle.
const MAX_PROJECTIONS: usize = 200;
/// Share of the accepted gap that covers the rounding of tangents.
const ROUNDING: f64 = 1e-3;

/// Triangles with a tree, in coordinates of their geometry.
#[derive(Debug)]
pub(super) struct TriangleSet {
    /// In the order of the leaves.
    triangles: Vec<[DVec3; 3]>,
    tree: BoxTree,
    /// One vertex of each component.
    pub(super) starts: Vec<DVec3>,
}

impl TriangleSet {
    /// Triangles that form one component.
    pub(super) fn new(triangles: &[[DVec3; 3]]) -> Self {
        let boxes: Vec<_> = triangles.iter().map(|&[a, b, c]| [a.min(b).min(c), a.max(b).max(c)]).collect();
        let tree = BoxTree::new(&boxes);
        let ordered = tree.order.iter().map(|&i| triangles[i as usize]).collect();
        Self { triangles: ordered, tree, starts: triangles.first().map(|triangle| triangle[0]).into_iter().collect() }
    }
}

impl Derived for TriangleSet {
    fn derive(mesh: &Mesh) -> Self {
        let world = mesh.world_positions();
        let corners = |face: &[u32; 3]| face.map(|vertex| DVec3::from_array(world[vertex as usize]));
        let triangles: Vec<_> = mesh.faces().iter().map(corners).collect();
        // Components through shared vertices, by union-find.
        let mut parents: Vec<u32> = (0..world.len() as u32).collect();
        let root = |parents: &mut Vec<u32>, mut i: u32| {
            while parents[i as usize] != i {
                parents[i as usize] = parents[parents[i as usize] as usize];
                i = parents[i as usize];
            }
            i
        };
        for &[a, b, c] in mesh.faces() {
            for other in [b, c] {
                let (first, second) = (root(&mut parents, a), root(&mut parents, other));
                parents[first.max(second) as usize] = first.min(second);
            }
        }
        let mut used = vec![false; world.len()];
        mesh.faces().iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
        let is_start = |&i: &usize| used[i] && parents[i] == i as u32;
        let starts = (0..world.len()).filter(is_start).map(|i| DVec3::from_array(world[i])).collect();
        Self { starts, ..Self::new(&triangles) }
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.triangles[..]) + size_of_val(&self.tree.nodes[..]) + size_of_val(&self.tree.order[..])
    }
}

/// A pair of nodes, and a lower bound of the distance of their triangles.
struct Pair {
    bound: f64,
    nodes: [u32; 2],
}

// The pair with the smallest bound is the largest.
impl Ord for Pair {
    fn cmp(&self, other: &Self) -> Ordering {
        other.bound.total_cmp(&self.bound).then(other.nodes.cmp(&self.nodes))
    }
}

impl PartialOrd for Pair {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Pair {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Pair {}

/// The smallest distance of two sets, with the closest points in the frame of the first; none if it is at least
/// `limit`. `place` is the pose of the second set in the frame of the first.
pub(super) fn distance(sets: [&TriangleSet; 2], place: &Similarity, limit: f64) -> Option<(f64, DVec3, DVec3)> {
    let [a, b] = sets;
    let spread =
        DMat3::from_cols(place.rotation.x_axis.abs(), place.rotation.y_axis.abs(), place.rotation.z_axis.abs());
    let bound = |first: &BoxNode, second: &BoxNode| {
        let (center, half) = middle(first, a.tree.center);
        let (other, other_half) = middle(second, b.tree.center);
        let away = (place.point(other) - center).abs() - half - spread * other_half;
        away.max(DVec3::ZERO).length() * (1.0 - 1e-12)
    };
    let mut best = (limit, DVec3::NAN, DVec3::NAN);
    let mut heap = BinaryHeap::new();
    if let (Some(first), Some(second)) = (a.tree.nodes.first(), b.tree.nodes.first()) {
        heap.push(Pair { bound: bound(first, second), nodes: [0, 0] });
    }
    while let Some(pair) = heap.pop().filter(|pair| pair.bound < best.0) {
        let [first, second] = [&a.tree.nodes[pair.nodes[0] as usize], &b.tree.nodes[pair.nodes[1] as usize]];
        if first.count > 0 && second.count > 0 {
            for j in second.first..second.first + second.count {
                let other = b.triangles[j as usize].map(|corner| place.point(corner));
                for i in first.first..first.first + first.count {
                    let found = closest_points_of_triangles(a.triangles[i as usize], other);
                    if found.0 < best.0 {
                        best = found;
                    }
                }
            }
            if best.0 == 0.0 {
                break;
            }
            continue;
        }
        // The larger box is divided.
        let size = |node: &BoxNode| if node.count > 0 { -1.0 } else { (node.max - node.min).max_element() };
        let divided = usize::from(size(second) > size(first));
        let children = [first, second][divided].first;
        for child in [children, children + 1] {
            let mut nodes = pair.nodes;
            nodes[divided] = child;
            let bound = bound(&a.tree.nodes[nodes[0] as usize], &b.tree.nodes[nodes[1] as usize]).max(pair.bound);
            if bound < best.0 {
                heap.push(Pair { bound, nodes });
            }
        }
    }
    (best.0 < limit).then_some(best)
}

/// The distance of a set from a convex closed form, with the closest points of the set and of the form, and a proven
/// lower bound; none if they have a common point. `place` is the pose of the set in the frame of the form.
///
/// The distance from a convex solid is a convex function, so its tangents bound it from below: on the box of a node,
/// and on a triangle, whose nearest point alternating projections find.
pub(super) fn distance_from_convex(
    set: &TriangleSet,
    place: &Similarity,
    solid: &mut Solid<'_>,
    gap: f64,
) -> Option<(f64, [DVec3; 2], f64)> {
    let bound = |node: &BoxNode, solid: &mut Solid<'_>| {
        let (center, half) = middle(node, set.tree.center);
        let value = solid.value(place.point(center));
        value.distance - (place.rotation.transpose() * value.gradient).abs().dot(half) - gap * ROUNDING
    };
    let (mut best, mut lower) = ((f64::INFINITY, [DVec3::NAN; 2]), f64::INFINITY);
    let mut heap = BinaryHeap::new();
    if let Some(root) = set.tree.nodes.first() {
        heap.push(Pair { bound: bound(root, solid), nodes: [0, 0] });
    }
    while let Some(pair) = heap.pop() {
        if pair.bound >= best.0 - gap {
            lower = lower.min(pair.bound);
            break;
        }
        let node = &set.tree.nodes[pair.nodes[0] as usize];
        for i in node.first..node.first + node.count {
            let corners = set.triangles[i as usize].map(|corner| place.point(corner));
            let mut point = (corners[0] + corners[1] + corners[2]) / 3.0;
            let mut value = solid.value(point);
            for _ in 0..MAX_PROJECTIONS {
                if value.distance <= 0.0 {
                    return None;
                }
                let next = closest_point_on_triangle(point - value.distance * value.gradient, corners).point;
                let found = solid.value(next);
                let is_nearer = found.distance < value.distance;
                if is_nearer {
                    (point, value) = (next, found);
                }
                // The tangent at the nearest point is smallest there.
                let tangent = |x: &DVec3| value.distance + value.gradient.dot(*x - point);
                let least = corners.iter().map(tangent).fold(f64::INFINITY, f64::min);
                if !is_nearer || least >= value.distance - 0.5 * gap || least >= best.0 {
                    break;
                }
            }
            let tangent = |x: &DVec3| value.distance + value.gradient.dot(*x - point);
            lower = lower.min(corners.iter().map(tangent).fold(f64::INFINITY, f64::min).max(pair.bound));
            if value.distance < best.0 {
                best = (value.distance, [point, point - value.distance * value.gradient]);
            }
        }
        if node.count == 0 {
            for child in [node.first, node.first + 1] {
                let bound = bound(&set.tree.nodes[child as usize], solid).max(pair.bound);
                heap.push(Pair { bound, nodes: [child, 0] });
            }
        }
    }
    Some((best.0, best.1, lower.min(best.0)))
}

/// Centre and half sides of the box of a node.
fn middle(node: &BoxNode, center: DVec3) -> (DVec3, DVec3) {
    let (min, max) = (node.min.as_dvec3(), node.max.as_dvec3());
    (center + 0.5 * (min + max), 0.5 * (max - min))
}
