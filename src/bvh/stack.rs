//! The stack of a depth-first search of the tree by one point or one ray.
//!
//! The nearest child of a node is searched first; the others wait on the stack in the order of their distances: squared
//! distances of a point, or the t at which a ray enters a box.

use super::{Bvh, ChildRef, MAX_STACK, WIDTH};
use std::mem::MaybeUninit;

/// Boxes that are still to be searched, with their distances, the nearest of each node on top.
///
/// The memory is not initialised, since that takes longer than a short search.
pub(crate) struct Stack {
    slots: [MaybeUninit<(f32, ChildRef)>; MAX_STACK],
    /// Number of slots in use. All of them have been written.
    top: usize,
}

impl Stack {
    #[inline(always)]
    pub(super) const fn new() -> Self {
        Self { slots: [const { MaybeUninit::uninit() }; MAX_STACK], top: 0 }
    }

    /// A stack that holds the root of the tree.
    #[inline(always)]
    pub(crate) fn of_root() -> Self {
        let mut stack = Self::new();
        stack.push((0.0, Bvh::ROOT));
        stack
    }

    #[inline(always)]
    fn push(&mut self, entry: (f32, ChildRef)) {
        self.slots[self.top].write(entry);
        self.top += 1;
    }

    /// The entry at an index; None from `top` on.
    #[inline(always)]
    fn at(&self, index: usize) -> Option<(f32, ChildRef)> {
        // SAFETY: every slot below `top` has been written, and the type has no destructor.
        (index < self.top).then(|| unsafe { self.slots[index].assume_init() })
    }

    /// The nearest child of a mask that is not zero; the others are pushed.
    #[inline(always)]
    pub(super) fn push_all_but_nearest(
        &mut self,
        mut mask: u32,
        distances: &[f32; WIDTH],
        children: &[ChildRef; WIDTH],
    ) -> ChildRef {
        let mut take = || {
            let lane = mask.trailing_zeros() as usize & (WIDTH - 1);
            mask &= mask - 1;
            ((distances[lane], children[lane]), mask != 0)
        };
        let (mut nearest, mut more) = take();
        let bottom = self.top;
        while more {
            let next;
            (next, more) = take();
            // The nearer of the two stays out of the stack; the other one goes to its place.
            let farther = if next.0 < nearest.0 { std::mem::replace(&mut nearest, next) } else { next };
            let mut slot = self.top;
            self.push(farther);
            while slot > bottom && self.at(slot - 1).is_some_and(|above| above.0 < farther.0) {
                self.slots[slot] = self.slots[slot - 1];
                slot -= 1;
            }
            self.slots[slot].write(farther);
        }
        nearest.1
    }

    /// The next box whose distance is at most `limit`.
    #[inline(always)]
    pub(super) fn pop(&mut self, limit: f32) -> Option<ChildRef> {
        while let Some((near, child)) = self.at(self.top.wrapping_sub(1)) {
            self.top -= 1;
            if near <= limit {
                return Some(child);
            }
        }
        None
    }
}
