//! The tree as a graphics device walks it: two children a node, at most four triangles a leaf.
//!
//! A device has no eight lanes to share among the children of one point, so each eight-wide node becomes three levels of
//! two-wide ones. The children of a node come in the order of the splits that made them, so halving that list gives
//! compact boxes. Siblings lie side by side; a node is 32 bytes, a triangle 80.

use super::pack::TriangleFrame;
use super::{Bvh, ChildRef, WIDTH};
use crate::geometry::Aabb;
use crate::gpu::layout::{Node, Triangle};
use glam::Vec3;

/// Triangles of a leaf; the shader tests them without a loop.
pub const LEAF: usize = 4;
/// Nodes that a search can have waiting: one a level. An eight-wide level gives three, a pack one.
pub const MAX_DEPTH: usize = 96;
const _: () = assert!(super::build::MAX_DEPTH * 3 + 2 <= MAX_DEPTH);

/// Nodes and triangles, ready to upload. The root is node 0.
#[derive(Debug)]
pub struct BinaryTree {
    pub nodes: Vec<Node>,
    pub triangles: Vec<Triangle>,
}

/// What becomes a node: a part of an eight-wide node's children, or of a pack's triangles.
enum Part {
    Children(Vec<(Aabb, ChildRef)>),
    Triangles(Vec<(Aabb, u32, TriangleFrame)>),
}

impl BinaryTree {
    /// `positions` and `faces` are those that the tree was built from.
    pub fn new(bvh: &Bvh, positions: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let mut tree = Self { nodes: vec![Node::default()], triangles: Vec::with_capacity(faces.len()) };
        let box_of = |face: u32| Aabb::of_points(&faces[face as usize].map(|v| positions[v as usize]));
        let expand = |child: ChildRef| -> Part {
            if child.is_pack() {
                let pack = &bvh.packs[child.index()];
                let lanes = pack.faces().iter().enumerate();
                Part::Triangles(lanes.map(|(lane, &face)| (box_of(face), face, pack.frame(lane))).collect())
            } else {
                let node = &bvh.nodes[child.index()];
                let corner = |of: &[[f32; WIDTH]; 3], i: usize| Vec3::new(of[0][i], of[1][i], of[2][i]);
                let lanes = (0..WIDTH).filter(|&i| !node.children[i].is_none());
                Part::Children(
                    lanes
                        .map(|i| (Aabb { min: corner(&node.min, i), max: corner(&node.max, i) }, node.children[i]))
                        .collect(),
                )
            }
        };
        let mut waiting = vec![(0usize, expand(Bvh::ROOT))];
        while let Some((place, part)) = waiting.pop() {
            // A single child stands for itself.
            let part = match part {
                Part::Children(children) if children.len() == 1 => expand(children[0].1),
                other => other,
            };
            let (bounds, halves) = match part {
                Part::Children(mut left) => {
                    let bounds = left.iter().fold(Aabb::EMPTY, |bounds, child| bounds.union(child.0));
                    if left.len() < 2 {
                        // A node over one node: look again, one level down.
                        waiting.push((place, Part::Children(left)));
                        continue;
                    }
                    let right = left.split_off(left.len() / 2);
                    (bounds, [Part::Children(left), Part::Children(right)])
                }
                Part::Triangles(mut left) => {
                    let bounds = left.iter().fold(Aabb::EMPTY, |bounds, triangle| bounds.union(triangle.0));
                    if left.len() <= LEAF {
                        let first = tree.triangles.len() as u32;
                        tree.nodes[place] = node(bounds, first, left.len() as u32);
                        tree.triangles.extend(left.iter().map(|(_, face, frame)| frame.for_device(*face)));
                        continue;
                    }
                    let extent = bounds.extent();
                    let axis = (1..3).fold(0, |longest, i| if extent[i] > extent[longest] { i } else { longest });
                    let key = |bounds: &Aabb| bounds.min[axis] + bounds.max[axis];
                    left.sort_by(|a, b| key(&a.0).total_cmp(&key(&b.0)).then(a.1.cmp(&b.1)));
                    let right = left.split_off(left.len() / 2);
                    (bounds, [Part::Triangles(left), Part::Triangles(right)])
                }
            };
            let children = tree.nodes.len();
            tree.nodes[place] = node(bounds, children as u32, 0);
            tree.nodes.resize(children + 2, Node::default());
            let [left, right] = halves;
            waiting.push((children + 1, right));
            waiting.push((children, left));
        }
        tree
    }
}

fn node(bounds: Aabb, first: u32, count: u32) -> Node {
    Node { min: bounds.min.to_array(), first, max: bounds.max.to_array(), count }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::Mesh;

    /// The search of `shaders/shared/bvh.wgsl`, with the deepest stack it needed.
    fn nearest(tree: &BinaryTree, frames: &[TriangleFrame], p: Vec3) -> (f32, usize) {
        let distance = |node: &Node| {
            let outside = (Vec3::from(node.min) - p).max(p - Vec3::from(node.max)).max(Vec3::ZERO);
            outside.dot(outside)
        };
        let (mut best, mut deepest, mut stack) = (f32::INFINITY, 0, vec![0u32]);
        while let Some(index) = stack.pop() {
            let node = &tree.nodes[index as usize];
            if distance(node) >= best {
                continue;
            }
            if node.count > 0 {
                for slot in node.first..node.first + node.count {
                    best = best.min(frames[tree.triangles[slot as usize].face as usize].distance_squared(p));
                }
                continue;
            }
            let [left, right] = [0, 1].map(|i| distance(&tree.nodes[(node.first + i) as usize]));
            let near = u32::from(right < left);
            stack.extend([node.first + 1 - near, node.first + near]);
            deepest = deepest.max(stack.len());
        }
        (best, deepest)
    }

    #[test]
    fn it_holds_every_face_once_and_finds_the_same_distances() {
        for faces in [1usize, 3, 9, 200, 5000] {
            let mut state = faces as u64;
            let mut next = || {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                (state >> 33) as f64 / (1u64 << 31) as f64
            };
            let vertices: Vec<[f64; 3]> = (0..faces)
                .flat_map(|_| {
                    let center = [next(), next(), next()];
                    [0; 3].map(|_| center.map(|x| x + 0.1 * next()))
                })
                .collect();
            let corners: Vec<[i64; 3]> = (0..faces as i64).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
            let mesh = Mesh::new(&vertices, &corners).unwrap();
            let tree = BinaryTree::new(mesh.bvh(), mesh.positions(), mesh.faces());

            let mut named: Vec<u32> = tree.triangles.iter().map(|triangle| triangle.face).collect();
            named.sort_unstable();
            assert_eq!(named, (0..mesh.faces().len() as u32).collect::<Vec<_>>());
            let frames: Vec<_> =
                (0..mesh.faces().len() as u32).map(|face| TriangleFrame::new(mesh.triangle(face))).collect();
            for _ in 0..50 {
                let p = Vec3::new(next() as f32, next() as f32, next() as f32) - 0.5;
                let (squared, deepest) = nearest(&tree, &frames, p);
                assert_eq!(squared, mesh.bvh().nearest(p, f32::INFINITY).unwrap().distance_squared);
                assert!(deepest <= MAX_DEPTH);
            }
        }
    }
}
