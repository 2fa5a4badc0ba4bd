//! The directed edges of faces, sorted by their vertices.

use crate::memory::zeroed_result;
use std::ops::Range;

/// An edge of a face without its lower vertex. In order: the higher vertex, the face, and whether the face traverses
/// the edge from the higher to the lower vertex.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, bytemuck::Zeroable)]
#[repr(transparent)]
pub(super) struct HalfEdge(u64);

impl HalfEdge {
    pub(super) fn new(high: u32, face: u32, is_reversed: bool) -> Self {
        Self(u64::from(high) << 32 | u64::from(face) << 1 | u64::from(is_reversed))
    }

    pub(super) fn high(self) -> u32 {
        (self.0 >> 32) as u32
    }

    pub(super) fn face(self) -> u32 {
        self.0 as u32 >> 1
    }

    pub(super) fn is_reversed(self) -> bool {
        self.0 & 1 == 1
    }
}

/// The half-edges of some faces, sorted by the lower vertex, then in their own order.
pub(super) struct HalfEdges {
    pub(super) items: Vec<HalfEdge>,
    /// End of the items of each lower vertex.
    ends: Vec<u32>,
    /// Whether two faces may have the same corners.
    pub(super) may_repeat: bool,
}

/// The half-edges between two vertices.
#[derive(Clone, Copy)]
pub(super) struct Edge {
    pub(super) low: u32,
    start: u32,
    end: u32,
}

impl Edge {
    pub(super) fn range(&self) -> Range<usize> {
        self.start as usize..self.end as usize
    }
}

impl HalfEdges {
    /// The half-edges of all faces for which `is_skipped` is false.
    pub(super) fn of(vertices: usize, faces: &[[u32; 3]], is_skipped: impl Fn(u32) -> bool) -> Self {
        let kept = || faces.iter().zip(0..).filter(|&(_, f)| !is_skipped(f));
        // Distributes the half-edges to their lower vertices. Filling advances the start of each vertex to its end.
        let mut ends = vec![0u32; vertices + 1];
        for (&[a, b, c], _) in kept() {
            for low in [a.min(b), b.min(c), c.min(a)] {
                ends[low as usize + 1] += 1;
            }
        }
        for v in 0..vertices {
            ends[v + 1] += ends[v];
        }
        let mut items = zeroed_result(ends[vertices] as usize);
        for (&[a, b, c], f) in kept() {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                let place = &mut ends[from.min(to) as usize];
                items[*place as usize] = HalfEdge::new(from.max(to), f, from > to);
                *place += 1;
            }
        }

        // Faces with the same corners share edges, where they have the same third vertex.
        let third = |e: HalfEdge| faces[e.face() as usize].iter().fold(0, |all, v| all ^ v);
        let (mut start, mut may_repeat) = (0, false);
        for &end in &ends[..vertices] {
            let of_vertex = &mut items[start..end as usize];
            of_vertex.sort_unstable();
            may_repeat |= of_vertex.windows(2).any(|e| e[0].high() == e[1].high() && third(e[0]) == third(e[1]))
                || of_vertex.windows(3).any(|e| e[0].high() == e[2].high());
            start = end as usize;
        }
        Self { items, ends, may_repeat }
    }

    /// In the order of their lower, then of their higher vertices.
    pub(super) fn edges(&self) -> impl Iterator<Item = Edge> {
        let (mut low, mut start) = (0, 0);
        std::iter::from_fn(move || {
            let high = self.items.get(start)?.high();
            while self.ends[low] as usize <= start {
                low += 1;
            }
            let of_vertex = &self.items[start..self.ends[low] as usize];
            let count = of_vertex.iter().take_while(|e| e.high() == high).count();
            let edge = Edge { low: low as u32, start: start as u32, end: (start + count) as u32 };
            start += count;
            Some(edge)
        })
    }
}
