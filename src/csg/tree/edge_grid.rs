//! Distances to polygons of many edges: a grid whose cells list the edges that are nearest to any of their points.
//!
//! # Theory
//!
//! Let `d` be the distance of the centre of a cell from the nearest edge, and `r` half the diagonal of the cell. A
//! point of the cell is at most `d + r` from that edge, and at least `d' - r` from an edge at the distance `d'` of
//! the centre. Only edges with `d' <= d + 2 r` can therefore be nearest to a point of the cell. The lists are found
//! from the whole grid down to its cells: halves of a rectangle of cells search among the edges of the rectangle.
//!
//! The side of a point is the side of its nearest edge. Where the nearest point is a corner, the sign is the sign of
//! the product with the *pseudonormal* of the corner, the sum of the unit normals of both edges (J. Baerentzen, H.
//! Aanaes, "Signed Distance Computation Using the Angle Weighted Pseudonormal", 2005; in the plane the weights are
//! equal).
//!
//! # Practice
//!
//! The grid covers the box of the region, grown by half its longest side. Points beyond it search among all outer
//! loops: a segment from such a point to a hole crosses the outer loop around the hole first.

use super::loops::{Loop, area, bounds};
use glam::DVec2;

/// Regions of fewer edges have one list.
const FEW_EDGES: usize = 12;

/// Largest number of cells.
const MAX_CELLS: f64 = 65536.0;

/// Margin of the lists over the diagonal of the grid: float32 positions beside the border of a cell.
const SLACK: f64 = 1e-5;

/// Cells of a rectangle whose lists one thread finds.
const CELLS_AT_ONCE: u32 = 1024;

/// Number of values of an edge: its ends, and the pseudonormals of its ends, which point out of the region.
pub(crate) const EDGE_VALUES: usize = 8;

/// A grid over edges.
#[derive(Debug)]
pub struct EdgeGrid {
    pub lower: DVec2,
    /// One over the side of a cell.
    pub inverse: f64,
    /// Number of cells along x and y; zero for a region with one list.
    pub counts: [u32; 2],
    /// Start of each list in `listed`, and the end of the last one. List 0 is for points outside the grid; the list of
    /// a cell has the index `1 + x + counts[0] * y`.
    pub starts: Vec<u32>,
    pub listed: Vec<u32>,
    pub edges: Vec<[f64; EDGE_VALUES]>,
}

impl EdgeGrid {
    /// The grid of loops with the inside to their left.
    pub fn new(loops: &[Loop]) -> Self {
        let edges: Vec<[f64; EDGE_VALUES]> = loops.iter().flat_map(|corners| edges_of(corners)).collect();
        let all: Vec<u32> = (0..edges.len() as u32).collect();
        let segments: Vec<Segment> = edges.iter().map(Segment::of).collect();
        let [lower, upper] = bounds(loops);
        let mut grid = Self { lower, inverse: 1.0, counts: [0, 0], starts: vec![0], listed: Vec::new(), edges };
        if all.len() < FEW_EDGES {
            grid.listed = all;
            grid.starts.push(grid.listed.len() as u32);
            return grid;
        }
        let margin = 0.5 * (upper - lower).max_element();
        let size = upper - lower + 2.0 * margin;
        grid.lower = lower - margin;
        let side = (size.x * size.y / (4.0 * all.len() as f64).min(MAX_CELLS)).sqrt();
        grid.inverse = 1.0 / side;
        grid.counts = (size / side).ceil().to_array().map(|n| n.max(1.0) as u32);
        let mut first = 0;
        for corners in loops {
            let next = first + corners.len() as u32;
            if area(corners) > 0.0 {
                grid.listed.extend(first..next);
            }
            first = next;
        }
        grid.starts.push(grid.listed.len() as u32);
        let search = Search { grid: &grid, segments: &segments, slack: SLACK * size.length() };
        let mut lists = vec![Vec::new(); (grid.counts[0] * grid.counts[1]) as usize];
        for (cell, list) in search.lists(Rectangle { from: [0, 0], to: grid.counts }, &all) {
            lists[cell] = list;
        }
        for list in lists {
            grid.listed.extend(list);
            grid.starts.push(grid.listed.len() as u32);
        }
        grid
    }
}

/// Cells from one corner up to, and without, another one.
#[derive(Clone, Copy)]
struct Rectangle {
    from: [u32; 2],
    to: [u32; 2],
}

impl Rectangle {
    fn cells(&self) -> u32 {
        (self.to[0] - self.from[0]) * (self.to[1] - self.from[1])
    }

    /// Both halves, divided across the longer side.
    fn halves(&self) -> [Self; 2] {
        let Self { from, to } = *self;
        let axis = usize::from(to[1] - from[1] > to[0] - from[0]);
        let middle = (from[axis] + to[axis]) / 2;
        let (mut end, mut start) = (to, from);
        end[axis] = middle;
        start[axis] = middle;
        [Self { from, to: end }, Self { from: start, to }]
    }
}

/// The search for the lists of cells.
struct Search<'a> {
    grid: &'a EdgeGrid,
    segments: &'a [Segment],
    slack: f64,
}

impl Search<'_> {
    /// The cells of a rectangle with their lists, found among candidates.
    fn lists(&self, rectangle: Rectangle, candidates: &[u32]) -> Vec<(usize, Vec<u32>)> {
        let near = self.near(rectangle, candidates);
        if rectangle.cells() == 1 {
            let [x, y] = rectangle.from;
            return vec![((x + self.grid.counts[0] * y) as usize, near)];
        }
        let halves = rectangle.halves();
        let [mut lists, others] = if rectangle.cells() > CELLS_AT_ONCE {
            rayon::join(|| self.lists(halves[0], &near), || self.lists(halves[1], &near)).into()
        } else {
            halves.map(|half| self.lists(half, &near))
        };
        lists.extend(others);
        lists
    }

    /// The candidates that may be nearest to a point of a rectangle.
    fn near(&self, Rectangle { from, to }: Rectangle, candidates: &[u32]) -> Vec<u32> {
        let corner = |[x, y]: [u32; 2]| self.grid.lower + DVec2::new(f64::from(x), f64::from(y)) / self.grid.inverse;
        let (low, high) = (corner(from), corner(to));
        let centre = 0.5 * (low + high);
        let squared: Vec<f64> =
            candidates.iter().map(|&edge| self.segments[edge as usize].distance_squared(centre)).collect();
        let nearest = squared.iter().copied().fold(f64::INFINITY, f64::min).sqrt();
        let reach = (nearest + (high - low).length() + self.slack).powi(2);
        let near = candidates.iter().zip(&squared).filter(|&(_, &squared)| squared <= reach);
        near.map(|(&edge, _)| edge).collect()
    }
}

/// An edge as the search needs it: one end, the way to the other end, and one over the squared length.
struct Segment {
    start: DVec2,
    along: DVec2,
    inverse: f64,
}

impl Segment {
    fn of(&[ax, ay, bx, by, ..]: &[f64; EDGE_VALUES]) -> Self {
        let start = DVec2::new(ax, ay);
        let along = DVec2::new(bx, by) - start;
        Self { start, along, inverse: along.length_squared().recip() }
    }

    fn distance_squared(&self, p: DVec2) -> f64 {
        let from_start = p - self.start;
        let t = (from_start.dot(self.along) * self.inverse).clamp(0.0, 1.0);
        from_start.distance_squared(t * self.along)
    }
}

fn edges_of(corners: &[DVec2]) -> Vec<[f64; EDGE_VALUES]> {
    let n = corners.len();
    // The right-hand side of a counter-clockwise edge is outside.
    let outward = |i: usize| {
        let along = (corners[(i + 1) % n] - corners[i]).normalize_or_zero();
        DVec2::new(along.y, -along.x)
    };
    let pseudonormal = |i: usize| {
        let (before, after) = (outward((i + n - 1) % n), outward(i));
        let sum = before + after;
        // A needle of no width: its tip points along the edge.
        if sum.length() > 1e-12 { sum.normalize() } else { DVec2::new(-before.y, before.x) }
    };
    (0..n)
        .map(|i| {
            let j = (i + 1) % n;
            let ([a, b], [p, q]) = ([corners[i], corners[j]], [pseudonormal(i), pseudonormal(j)]);
            [a.x, a.y, b.x, b.y, p.x, p.y, q.x, q.y]
        })
        .collect()
}
