//! The tree in the form for graphics devices: two children per node, at most four triangles per leaf.
//!
//! A device does not evaluate eight children of one point at once, so each eight-wide node becomes three levels of
//! two-wide nodes. The children of a node are in the order of the splits that made them, so halving that list gives
//! compact boxes. A node holds the boxes of its two children and has 64 bytes. The triangles are tables beside the
//! tree, in the order of its leaves: frames of 80 bytes for distances, corners of 48 bytes for rays.

use super::pack::TriangleFrame;
use super::{Bvh, ChildRef, WIDTH};
use crate::geometry::Aabb;
use crate::gpu::constants::tree::{LEAF as LEAF_FLAG, LEAF_ONE, MAX_STACK, NOTHING};
use crate::gpu::layout::{Corners, Node, Triangle};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use glam::Vec3;
use rayon::prelude::*;

/// Largest number of triangles of a leaf.
pub(crate) const LEAF: usize = 4;
const _: () = assert!(super::build::MAX_DEPTH * 3 + 2 <= MAX_STACK);

/// The box of an absent child is a point at this distance. It is never the nearest, and its square is a valid float32.
const FAR_AWAY: f32 = 1e18;

/// Nodes, ready to upload, and the face of each triangle of the leaves. The root is node 0.
#[derive(Debug)]
pub(crate) struct BinaryTree {
    pub nodes: Vec<Node>,
    pub faces: Vec<u32>,
}

/// The frames of the triangles in the order of the leaves, for distances.
pub(crate) struct LeafFrames(pub Vec<Triangle>);

/// The corners of the triangles in the order of the leaves, for rays.
pub(crate) struct LeafCorners(pub Vec<Corners>);

/// A future child: part of the children of an eight-wide node, or of the triangles of a pack.
enum FutureChild {
    Children(Vec<(Aabb, ChildRef)>),
    Triangles(Vec<(Aabb, u32)>),
}

/// Position at which a child is written: a node, and its left or right side.
type ChildPosition = (usize, ChildSide);

#[derive(Clone, Copy)]
enum ChildSide {
    Left,
    Right,
}

/// Queries on a device keep the tree and the triangles with the mesh, as queries on the CPU keep theirs.
impl Derived for BinaryTree {
    fn derive(mesh: &Mesh) -> Self {
        Self::new(mesh.built_bvh(), mesh.positions(), mesh.faces())
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.faces[..])
    }
}

impl Derived for LeafFrames {
    fn derive(mesh: &Mesh) -> Self {
        Self(mesh.derived::<BinaryTree>().frames(mesh))
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

impl Derived for LeafCorners {
    fn derive(mesh: &Mesh) -> Self {
        let corners = |&face: &u32| {
            let [a, b, c] = mesh.faces()[face as usize].map(|vertex| mesh.positions()[vertex as usize].to_array());
            Corners { a, face, b, c, ..Corners::default() }
        };
        Self(mesh.derived::<BinaryTree>().faces.par_iter().map(corners).collect())
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.0[..])
    }
}

impl BinaryTree {
    /// `positions` and `faces` must be those from which the tree was built.
    pub(crate) fn new(bvh: &Bvh, positions: &[Vec3], faces: &[[u32; 3]]) -> Self {
        let mut tree = Self { nodes: vec![absent()], faces: Vec::with_capacity(faces.len()) };
        let expand = |child: ChildRef| expand(bvh, positions, faces, child);
        // The root is always an inner node. The tree of a single leaf has it on the left.
        let mut waiting: Vec<(ChildPosition, FutureChild)> = Vec::new();
        match expand(Bvh::ROOT).halves() {
            Ok([left, right]) => waiting.extend([((0, ChildSide::Right), right), ((0, ChildSide::Left), left)]),
            Err(whole) => waiting.push(((0, ChildSide::Left), whole)),
        }
        while let Some((place, part)) = waiting.pop() {
            let bounds = part.bounds();
            match part.halves() {
                Ok([left, right]) => {
                    let index = tree.nodes.len();
                    tree.nodes.push(absent());
                    tree.set(place, bounds, index as u32);
                    waiting.extend([((index, ChildSide::Right), right), ((index, ChildSide::Left), left)]);
                }
                Err(FutureChild::Triangles(triangles)) => {
                    let first = tree.faces.len() as u32;
                    tree.set(place, bounds, LEAF_FLAG + LEAF_ONE * (triangles.len() as u32 - 1) + first);
                    tree.faces.extend(triangles.iter().map(|(_, face)| face));
                }
                // A single child is used directly.
                Err(FutureChild::Children(children)) => {
                    waiting.extend(children.into_iter().map(|(_, child)| (place, expand(child))));
                }
            }
        }
        tree
    }

    /// The frames of the triangles in the order of the leaves.
    pub(crate) fn frames(&self, mesh: &Mesh) -> Vec<Triangle> {
        self.faces.par_iter().map(|&face| TriangleFrame::new(mesh.triangle(face)).for_device(face)).collect()
    }

    fn set(&mut self, (index, side): ChildPosition, bounds: Aabb, child: u32) {
        let node = &mut self.nodes[index];
        let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
        match side {
            ChildSide::Left => (node.left_min, node.left_max, node.left) = (min, max, child),
            ChildSide::Right => (node.right_min, node.right_max, node.right) = (min, max, child),
        }
    }
}

/// Expands a child of an eight-wide node to its contents.
fn expand(bvh: &Bvh, positions: &[Vec3], faces: &[[u32; 3]], child: ChildRef) -> FutureChild {
    if child.is_pack() {
        let pack = &bvh.packs[child.index()];
        let box_of = |face: u32| Aabb::of_points(&faces[face as usize].map(|v| positions[v as usize]));
        return FutureChild::Triangles(pack.faces().iter().map(|&face| (box_of(face), face)).collect());
    }
    let node = &bvh.nodes[child.index()];
    let corner = |of: &[[f32; WIDTH]; 3], i: usize| Vec3::new(of[0][i], of[1][i], of[2][i]);
    let lanes = (0..WIDTH).filter(|&i| !node.children[i].is_none());
    FutureChild::Children(
        lanes.map(|i| (Aabb { min: corner(&node.min, i), max: corner(&node.max, i) }, node.children[i])).collect(),
    )
}

impl FutureChild {
    fn bounds(&self) -> Aabb {
        let join = |bounds: Aabb, of: &Aabb| bounds.union(*of);
        match self {
            Self::Children(children) => children.iter().map(|(bounds, _)| bounds).fold(Aabb::EMPTY, join),
            Self::Triangles(triangles) => triangles.iter().map(|(bounds, _)| bounds).fold(Aabb::EMPTY, join),
        }
    }

    /// Splits the part in two; returns the part itself if it is a single child or a leaf.
    fn halves(self) -> Result<[Self; 2], Self> {
        let bounds = self.bounds();
        match self {
            Self::Children(mut left) if left.len() > 1 => {
                let right = left.split_off(left.len() / 2);
                Ok([Self::Children(left), Self::Children(right)])
            }
            Self::Triangles(mut left) if left.len() > LEAF => {
                let extent = bounds.extent();
                let axis = (1..3).fold(0, |longest, i| if extent[i] > extent[longest] { i } else { longest });
                let key = |bounds: &Aabb| bounds.min[axis] + bounds.max[axis];
                left.sort_by(|a, b| key(&a.0).total_cmp(&key(&b.0)).then(a.1.cmp(&b.1)));
                let right = left.split_off(left.len() / 2);
                Ok([Self::Triangles(left), Self::Triangles(right)])
            }
            whole => Err(whole),
        }
    }
}

/// A node without children.
fn absent() -> Node {
    let far = [FAR_AWAY; 3];
    Node {
        left_min: far,
        left_max: far,
        left: NOTHING,
        right_min: far,
        right_max: far,
        right: NOTHING,
        pad_0: 0,
        pad_1: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::{soup, uniform};

    /// The search of `shaders/shared/mesh/bvh.wgsl`. Returns also the deepest stack it needed.
    fn nearest(tree: &BinaryTree, frames: &[TriangleFrame], p: Vec3) -> (f32, usize) {
        let distance = |low: [f32; 3], high: [f32; 3]| {
            let outside = (Vec3::from(low) - p).max(p - Vec3::from(high)).max(Vec3::ZERO);
            outside.dot(outside)
        };
        let (mut best, mut deepest, mut stack) = (f32::INFINITY, 0, vec![(0.0, 0u32)]);
        while let Some((squared, child)) = stack.pop() {
            if squared >= best {
                continue;
            }
            if child >= LEAF_FLAG {
                let (first, count) = (child & (LEAF_ONE - 1), (child - LEAF_FLAG) / LEAF_ONE + 1);
                for slot in first..first + count {
                    best = best.min(frames[tree.faces[slot as usize] as usize].distance_squared(p));
                }
                continue;
            }
            let node = &tree.nodes[child as usize];
            let mut children = [
                (distance(node.left_min, node.left_max), node.left),
                (distance(node.right_min, node.right_max), node.right),
            ];
            children.sort_by(|a, b| b.0.total_cmp(&a.0));
            stack.extend(children.iter().filter(|(squared, _)| *squared < best));
            deepest = deepest.max(stack.len());
        }
        (best, deepest)
    }

    #[test]
    fn it_holds_every_face_once_and_finds_the_same_distances() {
        for faces in [1usize, 3, 9, 200, 5000] {
            let mesh = soup(faces, 0.1, faces as u64);
            let tree = BinaryTree::new(mesh.bvh(), mesh.positions(), mesh.faces());

            let mut named = tree.faces.clone();
            named.sort_unstable();
            assert_eq!(named, (0..mesh.faces().len() as u32).collect::<Vec<_>>());
            let frames: Vec<_> =
                (0..mesh.faces().len() as u32).map(|face| TriangleFrame::new(mesh.triangle(face))).collect();
            let mut next = uniform(faces as u64);
            for _ in 0..50 {
                let p = Vec3::new(next() as f32, next() as f32, next() as f32) - 0.5;
                let (squared, deepest) = nearest(&tree, &frames, p);
                assert_eq!(squared, mesh.bvh().nearest(p, f32::INFINITY).unwrap().distance_squared);
                assert!(deepest <= MAX_STACK);
            }
        }
    }
}
