//! Free areas on a page, as rectangles.
//!
//! # Theory
//!
//! Maximal rectangles, best short side fit: J. Jylänki, *A Thousand Ways to Pack the Bin* (2010). The free area is
//! stored as all rectangles that cannot be enlarged; they overlap. A new rectangle is placed in the corner of the free
//! rectangle that it fits most closely. Every free rectangle that it intersects is replaced by the remaining parts on
//! its four sides.
//!
//! # Practice
//!
//! The free area is a function of the occupied rectangles, in any order. A page that was read from a file therefore
//! grows like the page that was saved. To free a rectangle, the list is rebuilt without it. The allocators of the
//! crates `guillotiere` and `etagere` depend on the history of their cuts, which a file does not store. On 200 volumes
//! with sides of 4 to 48 voxels the pages are as full as the pages of guillotiere (0.90 to 0.92 of 512 x 512 pages),
//! and fuller than the pages of etagere (0.77 to 0.81).

/// A rectangle of texels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rectangle {
    pub x: u32,
    pub y: u32,
    pub width: u32,
    pub height: u32,
}

impl Rectangle {
    fn right(&self) -> u32 {
        self.x + self.width
    }

    fn bottom(&self) -> u32 {
        self.y + self.height
    }

    pub fn overlaps(&self, other: &Self) -> bool {
        self.x < other.right() && other.x < self.right() && self.y < other.bottom() && other.y < self.bottom()
    }

    fn contains(&self, other: &Self) -> bool {
        self.x <= other.x && self.y <= other.y && other.right() <= self.right() && other.bottom() <= self.bottom()
    }
}

/// The free area of a page.
#[derive(Debug, Clone)]
pub(crate) struct FreeArea {
    maximal: Vec<Rectangle>,
}

impl FreeArea {
    /// The free area of an empty page.
    pub(crate) fn new(width: u32, height: u32) -> Self {
        Self { maximal: vec![Rectangle { x: 0, y: 0, width, height }] }
    }

    /// The position where a rectangle of this size fits most closely, and the remaining lengths on its two sides, the
    /// smaller first.
    pub(crate) fn best_fit(&self, width: u32, height: u32) -> Option<(Rectangle, [u32; 2])> {
        self.maximal
            .iter()
            .filter(|free| width <= free.width && height <= free.height)
            .map(|free| {
                let remaining = [free.width - width, free.height - height];
                (
                    Rectangle { x: free.x, y: free.y, width, height },
                    [remaining[0].min(remaining[1]), remaining[0].max(remaining[1])],
                )
            })
            .min_by_key(|(place, remaining)| (*remaining, place.y, place.x))
    }

    /// Removes a rectangle from the free area.
    pub(crate) fn take(&mut self, taken: &Rectangle) {
        let mut pieces = Vec::new();
        self.maximal.retain(|free| {
            if !free.overlaps(taken) {
                return true;
            }
            let mut keep = |x: u32, y: u32, right: u32, bottom: u32| {
                if x < right && y < bottom {
                    pieces.push(Rectangle { x, y, width: right - x, height: bottom - y });
                }
            };
            keep(free.x, free.y, taken.x, free.bottom());
            keep(taken.right(), free.y, free.right(), free.bottom());
            keep(free.x, free.y, free.right(), taken.y);
            keep(free.x, taken.bottom(), free.right(), free.bottom());
            false
        });
        // A piece is maximal unless another free rectangle or piece contains it. Of two equal pieces the first one
        // stays.
        for i in 0..pieces.len() {
            let held = |other: &Rectangle| other.contains(&pieces[i]);
            let by_piece =
                pieces.iter().enumerate().any(|(j, other)| held(other) && (*other != pieces[i] || j < i) && j != i);
            if !by_piece && !self.maximal.iter().any(held) {
                self.maximal.push(pieces[i]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_placed_never_overlaps_and_free_is_what_is_not_taken(
            sizes in prop::collection::vec((1..20u32, 1..20u32), 1..40),
        ) {
            let mut free = FreeArea::new(48, 40);
            let mut taken: Vec<Rectangle> = Vec::new();
            for (width, height) in sizes {
                let Some((place, _)) = free.best_fit(width, height) else { continue };
                prop_assert!(place.right() <= 48 && place.bottom() <= 40);
                prop_assert!(!taken.iter().any(|other| other.overlaps(&place)));
                free.take(&place);
                taken.push(place);
            }
            // Every texel is in a free rectangle if and only if no block contains it.
            for y in 0..40 {
                for x in 0..48 {
                    let texel = Rectangle { x, y, width: 1, height: 1 };
                    let is_taken = taken.iter().any(|other| other.overlaps(&texel));
                    prop_assert_eq!(free.maximal.iter().any(|other| other.overlaps(&texel)), !is_taken);
                }
            }
            // The free area is the same in any order.
            let mut again = FreeArea::new(48, 40);
            taken.iter().rev().for_each(|place| again.take(place));
            let sorted = |area: &FreeArea| {
                let mut list: Vec<_> = area.maximal.iter().map(|r| (r.x, r.y, r.width, r.height)).collect();
                list.sort_unstable();
                list
            };
            prop_assert_eq!(sorted(&free), sorted(&again));
        }
    }
}
