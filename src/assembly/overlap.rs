//! The smallest larger distance of two solids: half their clearance, by branch and bound.
//!
//! # Theory
//!
//! Let a and b be the signed distances of two solids and f = max(a, b). Twice the minimum of f is the clearance. If
//! the solids are apart, the minimum is half their distance, at the middle of the closest points. If they overlap, its
//! negative is the radius of the largest ball in the overlap.
//!
//! A cell is a box with the centre c and the radius r. Three functions bound f there from below:
//!
//! - f(c) - r, because distances are 1-Lipschitz;
//! - a minorant of a, or of b: a concave function that is smallest at a corner of the cell;
//! - the mean of two minorants, because max(a, b) >= (a + b) / 2. Where two flat faces are parallel it is constant, and
//!   no other bound ends the search there. Both may belong to one solid: in a wall that the other solid contains, they
//!   are the distances from both sides of the wall.
//!
//! The minorant of a convex solid is its tangent a(c) + g . (x - c). The minorant of another mesh is the negative
//! distance from the face nearest to c: inside, the depth is at most the distance from any part of the surface, and
//! distances from convex sets are convex. Any other has a(c) - |x - c|.
//!
//! Cells find the basin of the minimum, and descents ([`descend`]) find its bottom. Where the overlap is wide and thin,
//! as between a torus and a table, the value is therefore right even if the search ends without a proof.

use super::descent::{CONTACT, descend};
use super::solid::{ROUNDING, Solid};
use crate::progress::Progress;
use glam::DVec3;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Largest number of cells of a search. The bounds of a search that ends there are still proven.
const MAX_CELLS: usize = 200_000;
/// Number of cells after which the best place of a search descends for the first time, and the factor to the next time.
/// A descent costs as much as about a hundred cells.
const CELLS_TO_DESCENT: [usize; 2] = [400, 8];
/// Number of cells with the smallest bounds that descend at the end of a search without a proof.
const DESCENTS: usize = 16;
/// Largest number of steps of alternating projections.
const MAX_STEPS: usize = 5000;
/// Share of the size by which the closest points of convex solids may move in the last step.
const STAYS: f64 = 1e-11;

/// The minimum of f: an upper bound with its place, and a lower bound.
#[derive(Debug, Clone, Copy)]
pub(super) struct Minimum {
    pub(super) upper: f64,
    pub(super) lower: f64,
    pub(super) at: DVec3,
}

impl Minimum {
    /// Replaces the place by a lower one, if a descent from `start` ends there.
    fn descend(&mut self, a: &mut Solid<'_>, b: &mut Solid<'_>, start: DVec3, reach: f64, size: f64) {
        let end = descend(a, b, start, reach, size);
        if end.value < self.upper {
            (self.upper, self.at) = (end.value, end.at);
        }
    }
}

/// The closest points of two solids by projections from `start`, an upper bound of their distance; none if they reach
/// a common point. The distance is the third result, and a proven lower bound the last one.
///
/// Alternating projections are the steps of a projected gradient along half the squared distance, so they have
/// Nesterov's momentum, which ends where it points away from the step or the distance grows (B. O'Donoghue and
/// E. Candes, "Adaptive Restart for Accelerated Gradient Schemes", 2015). Planes of support prove a lower bound between
/// convex solids. The steps end where it is within `gap` and the closest points stay: their error is the root of an
/// error of the distance. Between other solids the steps end where the distance stays.
pub(super) fn project(
    a: &mut Solid<'_>,
    b: &mut Solid<'_>,
    start: DVec3,
    size: f64,
    gap: f64,
) -> Option<(DVec3, DVec3, f64, f64)> {
    let onto = |solid: &mut Solid<'_>, p: DVec3| solid.projection(p, ROUNDING * size);
    // The planes of support at the ends of a segment from a to b separate convex solids by at least this.
    let separation = |a: &Solid<'_>, b: &Solid<'_>, segment: DVec3| {
        let n = segment.try_normalize()?;
        Some(-b.support(-n)? - a.support(n)?)
    };
    let first = onto(a, start).unwrap_or(start);
    let mut best = (first, onto(b, first)?);
    let (mut distance, mut lower) = (f64::INFINITY, f64::NEG_INFINITY);
    // The point that is projected, and the weight of the momentum.
    let (mut ahead, mut weight) = (best.1, 1.0_f64);
    for _ in 0..MAX_STEPS {
        let has_momentum = ahead != best.1;
        let Some(p) = onto(a, ahead) else {
            if !has_momentum {
                return None;
            }
            (ahead, weight) = (best.1, 1.0);
            continue;
        };
        let q = onto(b, p)?;
        let nearer = distance - p.distance(q);
        if has_momentum && nearer < -ROUNDING * size {
            (ahead, weight) = (best.1, 1.0);
            continue;
        }
        let bound = separation(a, b, q - p);
        lower = bound.map_or(lower, |bound| lower.max(bound));
        let step = q - best.1;
        let is_ahead = (ahead - q).dot(step) > 0.0;
        let next = 0.5 * (1.0 + (1.0 + 4.0 * weight * weight).sqrt());
        (ahead, weight) = if is_ahead { (q, 1.0) } else { (q + (weight - 1.0) / next * step, next) };
        (best, distance) = ((p, q), p.distance(q));
        let stays = match bound {
            Some(_) if distance - lower <= gap => step.length() <= STAYS * size,
            Some(_) => !has_momentum && step.length() <= 1e-2 * ROUNDING * size,
            None => nearer <= ROUNDING * size,
        };
        if stays {
            break;
        }
    }
    let are_apart = distance > ROUNDING * size;
    are_apart.then(|| (best.0, best.1, distance, lower.min(distance)))
}

/// A cell and a lower bound of f there.
struct Cell {
    bound: f64,
    center: DVec3,
    half: DVec3,
}

// The cell with the smallest bound is the largest.
impl Ord for Cell {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |cell: &Self| (cell.center.x, cell.center.y, cell.center.z);
        other.bound.total_cmp(&self.bound).then(key(other).partial_cmp(&key(self)).unwrap_or(Ordering::Equal))
    }
}

impl PartialOrd for Cell {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cell {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cell {}

/// The minimum of f over a box, to a tolerance relative to its magnitude, or to `floor`. `start` is a place whose value
/// is an upper bound.
pub(super) fn minimum(
    a: &mut Solid<'_>,
    b: &mut Solid<'_>,
    [lower, upper]: [DVec3; 2],
    start: DVec3,
    relative: f64,
    floor: f64,
    progress: &Progress,
) -> Minimum {
    let at_start = a.distance(start).max(b.distance(start));
    let mut found = Minimum { upper: at_start, lower: f64::INFINITY, at: start };
    let slack = ROUNDING * ((upper - lower).length() + lower.abs().max(upper.abs()).max_element());
    let mut heap = BinaryHeap::new();
    let mut open = vec![Cell { bound: f64::NEG_INFINITY, center: 0.5 * (lower + upper), half: 0.5 * (upper - lower) }];
    let [mut next_descent, factor] = CELLS_TO_DESCENT;
    let size = (upper - lower).length();
    let mut cells = 0;
    loop {
        for mut cell in open.drain(..) {
            cells += 1;
            let (first, second) = (a.value(cell.center), b.value(cell.center));
            let value = first.distance.max(second.distance);
            if value < found.upper {
                (found.upper, found.at) = (value, cell.center);
            }
            let radius = cell.half.length();
            let corners = corners(cell.center, cell.half);
            let minorants = [
                a.minorant(&first, cell.center, &corners),
                b.minorant(&second, cell.center, &corners),
                // Beyond the middle of a wall the other side of the wall is nearest.
                a.minorant_beyond(&first, cell.center, radius, &corners),
                b.minorant_beyond(&second, cell.center, radius, &corners),
            ];
            let mut bound = value - radius;
            for (i, one) in minorants.iter().enumerate() {
                for other in &minorants[i..] {
                    let least = (0..8).map(|corner| 0.5 * (one[corner] + other[corner])).fold(f64::INFINITY, f64::min);
                    bound = bound.max(least);
                }
            }
            cell.bound = cell.bound.max(bound - slack);
            heap.push(cell);
        }
        if cells >= next_descent {
            next_descent *= factor;
            let reach = heap.peek().map_or(size, |cell| cell.half.length());
            found.descend(a, b, found.at, reach, size);
        }
        let enough = found.upper - (relative * found.upper.abs()).max(floor);
        let Some(cell) = heap.pop() else { break };
        if cell.bound >= enough || cells >= MAX_CELLS || progress.check().is_err() {
            found.lower = cell.bound;
            if cell.bound < enough {
                heap.push(cell);
                for cell in (0..DESCENTS).map_while(|_| heap.pop()) {
                    found.descend(a, b, cell.center, cell.half.length(), size);
                }
            }
            break;
        }
        let half = 0.5 * cell.half;
        open.extend(corners(cell.center, half).map(|center| Cell { bound: cell.bound, center, half }));
    }
    // Normals and values close to contact need the minimum itself.
    if found.upper <= CONTACT * size {
        found.descend(a, b, found.at, CONTACT * size, size);
    }
    found.lower = found.lower.min(found.upper);
    found
}

fn corners(center: DVec3, half: DVec3) -> [DVec3; 8] {
    let sign = |i: usize, axis: usize| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
    std::array::from_fn(|i| center + half * DVec3::new(sign(i, 0), sign(i, 1), sign(i, 2)))
}
