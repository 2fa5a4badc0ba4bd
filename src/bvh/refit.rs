//! A tree that follows the motion of its vertices.
//!
//! *Theory.* The hierarchy stays, and the boxes are computed anew from the leaves to the root. The boxes remain tight
//! for the new positions, but motion may make them overlap. The surface area heuristic measures this: the expected
//! number of nodes and packs that a random ray visits. Once it has grown by [`MOST_GROWTH`] since the build, a new tree
//! is cheaper.
//!
//! *Practice.* The cost is proportional to the number of faces. Packs without a moved vertex are copied.

use super::pack::Pack;
use super::{Bvh, Node, WIDTH};
use crate::geometry::Aabb;
use crate::memory::with_room;
use glam::Vec3;
use rayon::prelude::*;

/// Growth of the cost since the build above which a tree is built anew.
const MOST_GROWTH: f64 = 1.5;

impl Bvh {
    /// The tree for the positions `after`; this one was made for the positions `before` of the same faces. None if a
    /// new build is cheaper.
    pub(super) fn refitted(&self, before: &[Vec3], after: &[Vec3], faces: &[[u32; 3]]) -> Option<Self> {
        let refit = |pack: &Pack| {
            let (mut bounds, mut has_moved) = (Aabb::EMPTY, false);
            for &face in pack.faces() {
                for v in faces[face as usize] {
                    bounds = bounds.grown(after[v as usize]);
                    has_moved |= before[v as usize] != after[v as usize];
                }
            }
            (if has_moved { Pack::new(after, faces, pack.faces()) } else { pack.clone() }, bounds)
        };
        let (mut packs, mut pack_bounds) = (with_room(self.packs.len()), Vec::new());
        self.packs.par_iter().map(refit).unzip_into_vecs(&mut packs, &mut pack_bounds);

        let mut nodes = self.nodes.clone();
        // Children follow their parents in memory, so the loop runs backwards.
        for index in (0..nodes.len()).rev() {
            for lane in 0..WIDTH {
                let child = nodes[index].children[lane];
                if !child.is_none() {
                    let bounds =
                        if child.is_pack() { pack_bounds[child.index()] } else { nodes[child.index()].bounds() };
                    nodes[index].set(lane, bounds, child);
                }
            }
        }
        let is_good = Self::cost(&nodes) <= MOST_GROWTH * self.built_cost;
        let bounds = nodes[0].bounds();
        let (built_cost, has_equal_boxes) = (self.built_cost, Self::has_equal_boxes(&nodes));
        is_good.then_some(Self { nodes, packs, bounds, built_cost, is_refitted: true, has_equal_boxes })
    }

    /// Whether neighbouring children of a node have equal boxes.
    pub(super) fn has_equal_boxes(nodes: &[Node]) -> bool {
        let is_equal = |node: &Node, lane: usize| {
            !node.children[lane].is_none() && node.lane_bounds(lane - 1) == node.lane_bounds(lane)
        };
        nodes.iter().any(|node| (1..WIDTH).any(|lane| is_equal(node, lane)))
    }

    /// Expected number of nodes and packs below the root that a random ray through its box visits.
    pub(super) fn cost(nodes: &[Node]) -> f64 {
        let mut sum = 0.0;
        for node in nodes {
            for lane in 0..WIDTH {
                sum += f64::from(node.lane_bounds(lane).half_area());
            }
        }
        sum / f64::from(nodes[0].bounds().half_area())
    }
}

impl Node {
    /// The box around all children. Absent children have empty boxes.
    fn bounds(&self) -> Aabb {
        (0..WIDTH).fold(Aabb::EMPTY, |bounds, lane| bounds.union(self.lane_bounds(lane)))
    }

    fn lane_bounds(&self, lane: usize) -> Aabb {
        let corner = |of: &[[f32; WIDTH]; 3]| Vec3::new(of[0][lane], of[1][lane], of[2][lane]);
        Aabb { min: corner(&self.min), max: corner(&self.max) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bvh::ChildRef;
    use crate::mesh::Mesh;
    use crate::mesh::random::{soup, uniform};
    use glam::DVec3;
    use proptest::prelude::*;

    /// The vertices of a mesh, a share of them moved by up to `size` along each axis.
    fn moved_vertices(mesh: &Mesh, share: f64, size: f64, seed: u64) -> Vec<[f64; 3]> {
        let mut next = uniform(seed);
        let mut moved = |p: &[f64; 3]| if next() < share { p.map(|x| x + size * (2.0 * next() - 1.0)) } else { *p };
        mesh.world_positions().iter().map(&mut moved).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(100))]
        /// Searches of a refitted tree have the faces and the bits of searches of a new tree, near and far.
        #[test]
        fn a_refitted_tree_finds_what_a_new_one_finds(
            count in 1usize..600, seed in any::<u64>(), size in prop::sample::select(vec![1e-3, 0.02, 0.1]),
            share in prop::sample::select(vec![0.05, 1.0]), far in prop::sample::select(vec![0.7, 3.0, 1e4])
        ) {
            let mesh = soup(count, 0.1, seed);
            mesh.bvh();
            mesh.topology();
            let vertices = moved_vertices(&mesh, share, size, seed ^ 1);
            let moved = mesh.moved(&vertices).unwrap();
            let faces: Vec<[i64; 3]> = mesh.input_faces().iter().map(|face| face.map(i64::from)).collect();
            let fresh = Mesh::new(&vertices, &faces).unwrap();
            prop_assert_eq!(moved.bvh().bounds, fresh.bvh().bounds);
            let mut next = uniform(seed ^ 2);
            for _ in 0..40 {
                let p = DVec3::from_array([0; 3].map(|_| far * (2.0 * next() - 1.0)));
                let (a, b) = (moved.closest_point(p), fresh.closest_point(p));
                prop_assert_eq!((a.face, a.distance.to_bits()), (b.face, b.distance.to_bits()));
                let (a, b) = (moved.exact_closest_point(p, f64::INFINITY), fresh.exact_closest_point(p, f64::INFINITY));
                prop_assert_eq!((a.face, a.distance.to_bits()), (b.face, b.distance.to_bits()));
                prop_assert_eq!(
                    moved.moments().winding(&moved, p).to_bits(), fresh.moments().winding(&fresh, p).to_bits()
                );
            }
        }
    }

    /// Every box contains its triangles after a motion, and no box is larger than needed.
    #[test]
    fn refitted_boxes_are_tight() {
        let mesh = soup(500, 0.1, 3);
        mesh.bvh();
        let moved = mesh.moved(&moved_vertices(&mesh, 0.3, 0.01, 5)).unwrap();
        let bvh = moved.bvh();
        assert!(bvh.is_refitted);
        for node in &bvh.nodes {
            for lane in (0..WIDTH).filter(|&lane| !node.children[lane].is_none()) {
                let below = box_of(bvh, &moved, node.children[lane]);
                assert_eq!(node.lane_bounds(lane), below);
            }
        }
    }

    fn box_of(bvh: &Bvh, mesh: &Mesh, child: ChildRef) -> Aabb {
        if child.is_pack() {
            let faces = bvh.packs[child.index()].faces();
            let corners: Vec<Vec3> =
                faces.iter().flat_map(|&f| mesh.faces()[f as usize].map(|v| mesh.positions()[v as usize])).collect();
            return Aabb::of_points(&corners);
        }
        let children = bvh.nodes[child.index()].children.iter().filter(|child| !child.is_none());
        children.fold(Aabb::EMPTY, |bounds, &child| bounds.union(box_of(bvh, mesh, child)))
    }

    #[test]
    fn a_tree_whose_boxes_overlap_is_built_anew() {
        let mesh = soup(500, 0.05, 3);
        mesh.bvh();
        let shuffled = mesh.moved(&moved_vertices(&mesh, 1.0, 0.5, 5)).unwrap();
        assert!(!shuffled.bvh().is_refitted);
        // The cost is compared with the cost of the build, so that many small motions add up.
        let mut walking = mesh;
        let is_refitted: Vec<bool> = (0..40)
            .map(|step| {
                walking = walking.moved(&moved_vertices(&walking, 1.0, 0.02, step)).unwrap();
                walking.bvh().is_refitted
            })
            .collect();
        assert!(is_refitted[0] && is_refitted.contains(&false), "{is_refitted:?}");
    }
}
