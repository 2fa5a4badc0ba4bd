//! Disjoint sets whose elements may be flipped relative to each other.

use rustc_hash::FxHashSet;

/// Union-find that also stores, for each element, whether it is flipped relative to its root.
pub(crate) struct DisjointSets {
    parents: Vec<Parent>,
    size: Vec<u32>,
    /// Roots of sets that were joined to themselves with opposite orientation.
    pub(crate) conflicts: FxHashSet<u32>,
}

/// The parent of an element, and in the lowest bit whether the element is flipped relative to it.
#[derive(Clone, Copy)]
struct Parent(u32);

impl Parent {
    fn new(index: u32, turned: bool) -> Self {
        Self(index << 1 | u32::from(turned))
    }

    fn index(self) -> u32 {
        self.0 >> 1
    }

    fn turned(self) -> bool {
        self.0 & 1 == 1
    }
}

impl DisjointSets {
    pub(crate) fn new(n: usize) -> Self {
        let parents = (0..n as u32).map(|i| Parent::new(i, false)).collect();
        Self { parents, size: vec![1; n], conflicts: FxHashSet::default() }
    }

    /// The root of `x`, and whether `x` is flipped relative to it. Halves the path.
    pub(crate) fn root(&mut self, mut x: u32) -> (u32, bool) {
        let mut turned = false;
        loop {
            let mut parent = self.parents[x as usize];
            if parent.index() == x {
                return (x, turned);
            }
            let grand = self.parents[parent.index() as usize];
            if grand.index() != parent.index() {
                parent = Parent::new(grand.index(), parent.turned() ^ grand.turned());
                self.parents[x as usize] = parent;
            }
            turned ^= parent.turned();
            x = parent.index();
        }
    }

    /// Joins two sets; `turned` tells whether `b` is flipped relative to `a`.
    pub(crate) fn join(&mut self, a: u32, b: u32, turned: bool) {
        let ((root_a, turned_a), (root_b, turned_b)) = (self.root(a), self.root(b));
        let relative = turned_a ^ turned_b ^ turned;
        if root_a == root_b {
            if relative {
                self.conflicts.insert(root_a);
            }
            return;
        }
        let (parent, child) =
            if self.size[root_a as usize] >= self.size[root_b as usize] { (root_a, root_b) } else { (root_b, root_a) };
        self.parents[child as usize] = Parent::new(parent, relative);
        self.size[parent as usize] += self.size[child as usize];
        if !self.conflicts.is_empty() && self.conflicts.remove(&child) {
            self.conflicts.insert(parent);
        }
    }
}
