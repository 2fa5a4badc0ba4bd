//! Bounding volume hierarchy over triangles, eight wide.
//!
//! *Theory.* A node holds the boxes of up to eight children side by side, so that one pass over eight lanes measures
//! all of them. A leaf is one pack of up to eight triangles, measured in the same way. The tree is built top down by
//! the binned surface area heuristic (Wald, *On fast construction of SAH-based bounding volume hierarchies*, 2007); the
//! largest child is split until there are eight (Ylitie et al. 2017 do this after a binary build).
//!
//! *Practice.* [`Bvh::build`] costs about 0.3 us of processor time and 110 bytes per face. [`nearest`] finds nearest
//! triangles; other modules traverse the tree with [`Bvh::visit`].

pub(crate) mod binary;
pub(crate) mod boxes;
mod build;
mod lanes;
pub(crate) mod moments;
pub(crate) mod nearest;
pub(crate) mod pack;
pub(crate) mod rays;
mod refit;
mod stack;

use crate::geometry::Aabb;
use crate::mesh::Mesh;
use crate::mesh::derived::{Derived, on_own_threads};
use glam::{Vec3, Vec4};
use lanes::mask_within;
use pack::Pack;
use rustc_hash::{FxHashMap, FxHashSet};
pub(crate) use stack::Stack;

/// Half an ulp of 1/2: the float32 positions in boxes differ from the float64 positions of a mesh by at most this,
/// local units.
pub(crate) const BOX_ROUNDING: f64 = 3.1e-8;

/// Number of lanes of a node and of a pack.
pub(crate) const WIDTH: usize = 8;

/// Eight child boxes, one array per coordinate. An absent child has an empty box and [`ChildRef::NONE`].
#[derive(Debug, Clone)]
#[repr(C, align(32))]
pub struct Node {
    pub min: [[f32; WIDTH]; 3],
    pub max: [[f32; WIDTH]; 3],
    pub children: [ChildRef; WIDTH],
}

/// The child of a lane: an inner node, a pack of triangles, or nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(transparent)]
pub struct ChildRef(u32);

impl ChildRef {
    const PACK: u32 = 1 << 31;
    pub const NONE: Self = Self(u32::MAX);

    fn node(index: usize) -> Self {
        Self(index as u32)
    }

    fn pack(index: usize) -> Self {
        Self(index as u32 | Self::PACK)
    }

    pub fn is_none(self) -> bool {
        self == Self::NONE
    }

    pub fn is_pack(self) -> bool {
        self.0 & Self::PACK != 0
    }

    /// Index into [`Bvh::nodes`] or [`Bvh::packs`].
    pub fn index(self) -> usize {
        (self.0 & !Self::PACK) as usize
    }
}

/// The tree. The root is node 0; every inner node comes before its children.
#[derive(Debug)]
pub struct Bvh {
    pub nodes: Vec<Node>,
    pub packs: Vec<Pack>,
    pub bounds: Aabb,
    /// Cost of the tree by the surface area heuristic when it was built.
    built_cost: f64,
    /// Whether the boxes were refitted since.
    is_refitted: bool,
    /// Whether neighbouring children have equal boxes, as those over many equal faces do.
    has_equal_boxes: bool,
}

/// Largest local coordinate of a point for which searches bound the rounding of float32, so that their results do not
/// depend on the tree. Beyond it too many boxes would lie within the rounding.
pub(crate) const FAR: f64 = 8.0;
/// Rounding of a float32 distance, relative to 1 plus the largest coordinate of the point. Positions, the point and the
/// frames are rounded to 6e-8 each, and about twelve operations follow (the test of `bvh::pack` allows 2.5e-7).
const ROUNDING: f64 = 4e-7;

/// Capacity of the stack of a depth-first traversal: seven siblings per level, and the root.
pub(crate) const MAX_STACK: usize = build::MAX_DEPTH * (WIDTH - 1) + 1;

impl Derived for Bvh {
    fn derive(mesh: &Mesh) -> Self {
        Self::build(mesh.positions(), mesh.faces())
    }

    fn follow(&self, before: &Mesh, after: &Mesh) -> Option<Self> {
        self.refitted(before.positions(), after.positions(), after.faces())
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.packs[..])
    }
}

impl Mesh {
    /// The search tree, built at the first call.
    pub fn bvh(&self) -> &Bvh {
        self.derived()
    }

    /// The tree as a build makes it, never refitted. Results that depend on the tree use this one, so that a moved mesh
    /// has the results of a new one: sums over nodes, searches on a device, and searches far from the mesh.
    pub fn built_bvh(&self) -> &Bvh {
        let bvh = self.bvh();
        if bvh.is_refitted { &self.derived::<BuiltBvh>().0 } else { bvh }
    }

    /// The tree for points whose largest local coordinate is `reach`.
    pub fn bvh_within(&self, reach: f64) -> &Bvh {
        if reach <= FAR { self.bvh() } else { self.built_bvh() }
    }

    /// The tree for closest points whose largest local coordinate is `reach`. Faces that lie on an edge of another face
    /// are not in it. If there are many, neither are faces that repeat an earlier one exactly: all are equally near, so
    /// that a search would measure all of them. Among equally near faces the lowest one is returned, which is in this
    /// tree.
    pub fn distance_bvh(&self, reach: f64) -> &Bvh {
        let bvh = self.bvh_within(reach);
        let is_reduced = bvh.has_equal_boxes || !self.flat_faces().is_empty();
        if is_reduced { self.derived::<DistanceBvh>().0.as_ref().unwrap_or(bvh) } else { bvh }
    }

    /// Whether the tree and the connectivity have been built. A query then starts at once, except the first one of a
    /// mesh that needs another tree.
    pub fn is_prepared(&self) -> bool {
        self.has_derived::<Bvh>() && self.has_topology()
    }
}

/// See [`Mesh::built_bvh`].
struct BuiltBvh(Bvh);

impl Derived for BuiltBvh {
    fn derive(mesh: &Mesh) -> Self {
        Self(on_own_threads(|| Bvh::build(mesh.positions(), mesh.faces())))
    }

    fn bytes(&self) -> usize {
        self.0.bytes()
    }
}

/// The tree over the faces that lie on no edge of another face, of those with equal corners in equal order the first
/// one. None if these are all faces. See [`Mesh::distance_bvh`].
struct DistanceBvh(Option<Bvh>);

/// The faces whose corners lie on a line, and whose longest edge is an edge of a face with an area. The rest of the
/// surface contains their points.
fn covered_faces(mesh: &Mesh) -> FxHashSet<u32> {
    let mut covered = FxHashSet::default();
    if mesh.flat_faces().is_empty() {
        return covered;
    }
    let welded = &mesh.topology().welded;
    let edges = |face: u32| {
        let corners = mesh.faces()[face as usize];
        [0, 1, 2].map(|i| [corners[i], corners[(i + 1) % 3]].map(|v| welded[v as usize]))
    };
    let key = |[a, b]: [u32; 2]| [a.min(b), a.max(b)];
    let mut flat_by_edge: FxHashMap<[u32; 2], Vec<u32>> = FxHashMap::default();
    for &face in mesh.flat_faces() {
        let length = |[a, b]: &[u32; 2]| mesh.exact_position(*a).distance_squared(mesh.exact_position(*b));
        if let Some(longest) = edges(face).into_iter().max_by(|a, b| length(a).total_cmp(&length(b))) {
            flat_by_edge.entry(key(longest)).or_default().push(face);
        }
    }
    let has_area = |face: &u32| mesh.flat_faces().binary_search(face).is_err();
    for face in (0..mesh.faces().len() as u32).filter(has_area) {
        for edge in edges(face) {
            covered.extend(flat_by_edge.get(&key(edge)).into_iter().flatten());
        }
    }
    covered
}

impl Derived for DistanceBvh {
    fn derive(mesh: &Mesh) -> Self {
        let mut seen = FxHashSet::default();
        let position = |v: u32| mesh.world_positions()[v as usize].map(f64::to_bits);
        let covered = covered_faces(mesh);
        let is_first = |&face: &u32| !covered.contains(&face) && seen.insert(mesh.faces()[face as usize].map(position));
        let members: Vec<u32> = (0..mesh.faces().len() as u32).filter(is_first).collect();
        let is_smaller = members.len() < mesh.faces().len();
        Self(is_smaller.then(|| on_own_threads(|| build::build_of(mesh.positions(), mesh.faces(), &members))))
    }

    fn bytes(&self) -> usize {
        self.0.as_ref().map_or(0, Bvh::bytes)
    }
}

impl Bvh {
    pub const ROOT: ChildRef = ChildRef(0);

    /// `faces` index `positions`. Every face must have a positive area.
    pub fn build(positions: &[Vec3], faces: &[[u32; 3]]) -> Self {
        build::build(positions, faces)
    }

    /// Visits all packs below the children whose lanes `overlaps` returns, a mask, in no particular order.
    #[inline]
    pub fn visit(&self, overlaps: impl Fn(&Node) -> u32, mut on_pack: impl FnMut(&Pack)) {
        self.visit_while(overlaps, |pack| {
            on_pack(pack);
            true
        });
    }

    /// [`Bvh::visit`] until `on_pack` returns false. Returns whether all packs were visited.
    #[inline(always)]
    pub fn visit_while(&self, overlaps: impl Fn(&Node) -> u32, mut on_pack: impl FnMut(&Pack) -> bool) -> bool {
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Self::ROOT;
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let node = &self.nodes[stack[top].index()];
            let mut mask = overlaps(node);
            while mask != 0 {
                let child = node.children[mask.trailing_zeros() as usize % WIDTH];
                mask &= mask - 1;
                if child.is_none() {
                    continue;
                }
                if child.is_pack() {
                    if !on_pack(&self.packs[child.index()]) {
                        return false;
                    }
                } else {
                    stack[top] = child;
                    top += 1;
                }
            }
        }
        true
    }

    /// The next pack of a search around `p`, the packs of the nearest boxes first: its boxes have squared distances of
    /// at most `limit`, which must be finite, since the box of an absent child is infinitely far. The search begins
    /// with [`Stack::of_root`]. It takes no closure, which the compiler may leave as a function without the vector
    /// instructions of the caller.
    #[inline(always)]
    pub(crate) fn next_pack(&self, stack: &mut Stack, p: Vec3, limit: f32) -> Option<usize> {
        let mut child = stack.pop(limit)?;
        while !child.is_pack() {
            let node = &self.nodes[child.index()];
            let found = node.distances_squared(p);
            let mask = mask_within(&found, limit);
            child = match mask {
                0 => stack.pop(limit)?,
                _ => stack.push_all_but_nearest(mask, &found, &node.children),
            };
        }
        Some(child.index())
    }
}

impl Node {
    /// Lower sides of the boxes along x, y and z, then their upper sides.
    #[inline(always)]
    pub fn rows(&self) -> &[[f32; WIDTH]; 6] {
        // SAFETY: the struct has C layout and begins with `min` and `max`, six rows without padding.
        unsafe { &*std::ptr::from_ref(self).cast() }
    }

    /// Mask of the lanes whose box has min <= high and max >= low along every axis: those that overlap the box from
    /// `low` to `high`.
    #[inline(always)]
    pub fn overlaps(&self, low: Vec3, high: Vec3) -> u32 {
        let half = |first: usize| {
            let row = |of: &[[f32; WIDTH]; 3], axis: usize| Vec4::from_slice(&of[axis][first..first + 4]);
            let along = |axis: usize| {
                let (min, max) = (row(&self.min, axis), row(&self.max, axis));
                min.cmple(Vec4::splat(high[axis])) & max.cmpge(Vec4::splat(low[axis]))
            };
            (along(0) & along(1) & along(2)).bitmask()
        };
        half(0) | half(4) << 4
    }

    fn empty() -> Self {
        Self {
            min: [[f32::INFINITY; WIDTH]; 3],
            max: [[f32::NEG_INFINITY; WIDTH]; 3],
            children: [ChildRef::NONE; WIDTH],
        }
    }

    fn set(&mut self, lane: usize, bounds: Aabb, child: ChildRef) {
        for axis in 0..3 {
            self.min[axis][lane] = bounds.min[axis];
            self.max[axis][lane] = bounds.max[axis];
        }
        self.children[lane] = child;
    }
}
