//! Flat regions bounded by polygons: fill rules, Booleans and offsets.
//!
//! A region is a list of *loops*: simple polygons that do not cross each other, outer ones counter-clockwise and
//! holes clockwise, so that the inside lies to the left of every edge. Loops that cross, overlap or nest in any
//! orientation are resolved by the crate `i_overlay` in 64-bit integers, whose step is below the rounding of float64
//! for the box of the region.

use super::edge_grid::EdgeGrid;
use super::loops::{Loop, area, bounds};
use crate::error::ShapeError;
use glam::DVec2;
use i_overlay::core::fill_rule::FillRule;
use i_overlay::core::overlay_rule::OverlayRule;
use i_overlay::float::overlay::FloatOverlay;
use i_overlay::mesh::float::outline::offset::OutlineOffset;
use i_overlay::mesh::float::style::{LineJoin, OutlineStyle};
use i_overlay::mesh::math::MathMode;

/// Largest number of corners of a region: devices have the indices of its tables as float32.
pub(crate) const MAX_CORNERS: usize = 1 << 16;

/// Angle between the corners of an offset arc, radians, the smallest that `i_overlay` has. The chord of it is
/// `1 - cos(ARC_STEP / 2)`, 1.3e-4 of the radius, inside the arc.
const ARC_STEP: f64 = 0.01 * std::f64::consts::PI;

/// Largest coordinate. Its square and products of two are finite.
const MAX_COORDINATE: f64 = 1e37;

/// The rule that tells the inside of loops that cross or nest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Rule {
    /// Points around which the loops wind an odd number of times.
    EvenOdd,
    /// Points around which the loops wind a number of times other than zero.
    NonZero,
}

impl Rule {
    /// The rule by its name in the Python interface.
    pub fn named(name: &str) -> Result<Self, ShapeError> {
        match name {
            "even-odd" => Ok(Self::EvenOdd),
            "nonzero" => Ok(Self::NonZero),
            _ => Err(ShapeError::argument("rule", format!("must be \"even-odd\" or \"nonzero\", got \"{name}\""))),
        }
    }
}

/// Loops, and the grid over their edges that evaluates distances.
#[derive(Debug)]
pub struct Region {
    pub loops: Vec<Loop>,
    pub grid: EdgeGrid,
}

impl PartialEq for Region {
    fn eq(&self, other: &Self) -> bool {
        self.loops == other.loops
    }
}

impl Region {
    /// The region of any loops.
    pub fn new(loops: Vec<Loop>, rule: Rule) -> Result<Self, ShapeError> {
        let loops = resolved(loops, rule)?;
        if loops.is_empty() {
            return Err(ShapeError::argument("points", "the polygon has no area"));
        }
        let grid = EdgeGrid::new(&loops);
        Ok(Self { loops, grid })
    }
}

/// The loops of the region that any loops bound under a rule; none if it is empty.
pub(crate) fn resolved(mut loops: Vec<Loop>, rule: Rule) -> Result<Vec<Loop>, ShapeError> {
    check(&loops)?;
    for corners in &mut loops {
        corners.dedup();
        while corners.len() > 1 && corners.first() == corners.last() {
            corners.pop();
        }
    }
    loops.retain(|corners| corners.len() >= 3);
    if are_simple(&loops) {
        let depths: Vec<usize> = (0..loops.len()).map(|i| depth(&loops, i)).collect();
        let is_outer = |i: usize| depths[i].is_multiple_of(2);
        // Alternating orientations mean the same region under both rules.
        let is_regular = |i: usize| (area(&loops[i]) > 0.0) == is_outer(i);
        let alternate = (1..loops.len()).all(|i| is_regular(i) == is_regular(0));
        if alternate || rule == Rule::EvenOdd || loops.len() == 1 {
            for (i, corners) in loops.iter_mut().enumerate() {
                if (area(corners) > 0.0) != depths[i].is_multiple_of(2) {
                    corners.reverse();
                }
            }
            return Ok(loops);
        }
    }
    let fill = if rule == Rule::EvenOdd { FillRule::EvenOdd } else { FillRule::NonZero };
    Ok(overlaid(&loops, &[], OverlayRule::Subject, fill))
}

/// The union, intersection, difference or symmetric difference of two regions, by its name in the Python interface.
pub(crate) fn combined(op: &str, first: &[Loop], second: &[Loop]) -> Result<Vec<Loop>, ShapeError> {
    check(first)?;
    check(second)?;
    let rule = match op {
        "union" => OverlayRule::Union,
        "intersection" => OverlayRule::Intersect,
        "difference" => OverlayRule::Difference,
        "xor" => OverlayRule::Xor,
        _ => return Err(ShapeError::argument("op", format!("there is no {op}"))),
    };
    Ok(overlaid(first, second, rule, FillRule::NonZero))
}

/// The points within `distance` of a region, or for a negative distance the points farther from the outside than its
/// magnitude. Corners of the result are round, with chords inside the arcs; see [`ARC_STEP`].
pub(crate) fn offset(loops: &[Loop], distance: f64) -> Result<Vec<Loop>, ShapeError> {
    check(loops)?;
    let [lower, upper] = bounds(loops);
    if !(-MAX_COORDINATE..=MAX_COORDINATE).contains(&distance) {
        return Err(ShapeError::argument("distance", format!("must be a finite number, got {distance}")));
    }
    if distance == 0.0 || loops.is_empty() {
        return Ok(loops.to_vec());
    }
    if distance < 0.0 && -distance >= 0.5 * (upper - lower).min_element() {
        return Ok(Vec::new());
    }
    let unit = unit_of(loops);
    let style = OutlineStyle::new(distance / unit).line_join(LineJoin::Round(ARC_STEP)).math(MathMode::Float);
    Ok(flattened(paths(loops, unit).outline_as::<i64>(&style), unit))
}

fn check(loops: &[Loop]) -> Result<(), ShapeError> {
    let error = |problem: String| Err(ShapeError::argument("points", problem));
    let count: usize = loops.iter().map(Vec::len).sum();
    if count > MAX_CORNERS {
        return error(format!("a profile has at most {MAX_CORNERS} corners, got {count}; use a coarser tolerance"));
    }
    for corners in loops {
        if let Some(i) = corners.iter().position(|corner| !corner.abs().cmple(DVec2::splat(MAX_COORDINATE)).all()) {
            return error(format!("[{i}] is {}, expected finite numbers", corners[i]));
        }
    }
    Ok(())
}

fn overlaid(first: &[Loop], second: &[Loop], op: OverlayRule, fill: FillRule) -> Vec<Loop> {
    if first.is_empty() && second.is_empty() {
        return Vec::new();
    }
    let unit = unit_of(first).max(unit_of(second));
    let (first, second) = (paths(first, unit), paths(second, unit));
    flattened(FloatOverlay::<[f64; 2], i64>::from_subj_and_clip(&first, &second).overlay(op, fill), unit)
}

/// A power of two of the size of the largest coordinate; division by it is exact.
fn unit_of(loops: &[Loop]) -> f64 {
    let largest = loops.iter().flatten().map(|p| p.abs().max_element()).fold(0.0, f64::max);
    if largest > 0.0 { largest.log2().ceil().exp2() } else { f64::MIN_POSITIVE }
}

fn paths(loops: &[Loop], unit: f64) -> Vec<Vec<[f64; 2]>> {
    loops.iter().map(|corners| corners.iter().map(|&p| (p / unit).to_array()).collect()).collect()
}

fn flattened(shapes: Vec<Vec<Vec<[f64; 2]>>>, unit: f64) -> Vec<Loop> {
    let loops = shapes.into_iter().flatten();
    let world = |path: Vec<[f64; 2]>| path.into_iter().map(|p| unit * DVec2::from_array(p)).collect();
    let mut loops: Vec<Loop> = loops.map(world).collect();
    loops.retain(|corners| corners.len() >= 3);
    loops
}

/// Number of other loops around a loop. No two loops touch.
fn depth(loops: &[Loop], which: usize) -> usize {
    let p = loops[which][0];
    let contains = |corners: &Loop| {
        let pairs = corners.iter().zip(corners.iter().cycle().skip(1));
        let crossings = pairs.filter(|&(&a, &b)| {
            // The side of a point beside an edge that spans its height is exact.
            let spans = (a.y > p.y) != (b.y > p.y);
            spans && (robust::orient2d(coord(a), coord(b), coord(p)) > 0.0) == (b.y > a.y)
        });
        crossings.count() % 2 == 1
    };
    loops.iter().enumerate().filter(|&(i, corners)| i != which && contains(corners)).count()
}

fn coord(p: DVec2) -> robust::Coord<f64> {
    robust::Coord { x: p.x, y: p.y }
}

/// Whether no two edges touch except at their common corner. Edges are compared with those whose range of x they
/// share.
fn are_simple(loops: &[Loop]) -> bool {
    struct Edge {
        ends: [DVec2; 2],
        part: usize,
        index: usize,
    }
    let mut edges: Vec<Edge> = Vec::new();
    for (part, corners) in loops.iter().enumerate() {
        let ends = corners.iter().zip(corners.iter().cycle().skip(1));
        edges.extend(ends.enumerate().map(|(index, (&a, &b))| Edge { ends: [a, b], part, index }));
    }
    let low = |edge: &Edge| edge.ends[0].x.min(edge.ends[1].x);
    edges.sort_by(|a, b| low(a).total_cmp(&low(b)));
    let side = |[a, b]: [DVec2; 2], p: DVec2| robust::orient2d(coord(a), coord(b), coord(p));
    for (i, first) in edges.iter().enumerate() {
        let reach = first.ends[0].max(first.ends[1]);
        let floor = first.ends[0].min(first.ends[1]);
        for second in edges[i + 1..].iter().take_while(|edge| low(edge) <= reach.x) {
            if second.ends[0].y.max(second.ends[1].y) < floor.y || second.ends[0].y.min(second.ends[1].y) > reach.y {
                continue;
            }
            let count = loops[first.part].len();
            let apart = first.index.abs_diff(second.index);
            if first.part == second.part && (apart == 1 || apart == count - 1) {
                // Neighbours share a corner; they overlap if they run back along each other.
                let is_next = (first.index + 1) % count == second.index;
                let (before, after) = if is_next { (first, second) } else { (second, first) };
                let ([a, b], [_, c]) = (before.ends, after.ends);
                if side([a, b], c) == 0.0 && (b - a).dot(c - b) < 0.0 {
                    return false;
                }
                continue;
            }
            let (e, f) = (first.ends, second.ends);
            let is_apart = |one: [DVec2; 2], other: [DVec2; 2]| {
                let (s, t) = (side(one, other[0]), side(one, other[1]));
                (s > 0.0 && t > 0.0) || (s < 0.0 && t < 0.0)
            };
            if !is_apart(e, f) && !is_apart(f, e) {
                return false;
            }
        }
    }
    true
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(low: f64, high: f64) -> Loop {
        [[low, low], [high, low], [high, high], [low, high]].map(DVec2::from_array).to_vec()
    }

    fn areas(loops: &[Loop]) -> Vec<f64> {
        let mut found: Vec<f64> = loops.iter().map(|corners| 0.5 * area(corners)).collect();
        found.sort_by(f64::total_cmp);
        found
    }

    #[test]
    fn rules_differ_for_nested_loops_of_one_orientation() {
        let nested = vec![square(0.0, 4.0), square(1.0, 3.0)];
        assert_eq!(areas(&resolved(nested.clone(), Rule::EvenOdd).unwrap()), [-4.0, 16.0]);
        assert_eq!(areas(&resolved(nested, Rule::NonZero).unwrap()), [16.0]);
    }

    #[test]
    fn loops_that_cross_are_resolved() {
        let bow = [[0.0, 0.0], [2.0, 2.0], [2.0, 0.0], [0.0, 2.0]].map(DVec2::from_array).to_vec();
        assert_eq!(areas(&resolved(vec![bow], Rule::EvenOdd).unwrap()), [1.0, 1.0]);
        let line = [[0.0, 0.0], [2.0, 2.0], [1.0, 1.0]].map(DVec2::from_array).to_vec();
        assert!(resolved(vec![line], Rule::EvenOdd).unwrap().is_empty());
    }

    #[test]
    fn resolved_loops_stay_as_they_are() {
        let mut hole = square(1.0 / 3.0, 0.7);
        hole.reverse();
        let loops = vec![square(0.1, 0.9), hole];
        assert_eq!(resolved(loops.clone(), Rule::EvenOdd).unwrap(), loops);
        assert_eq!(resolved(loops.clone(), Rule::NonZero).unwrap(), loops);
    }

    #[test]
    fn offsets_have_the_area_of_steiner() {
        // The area of a convex region grows by its perimeter times r, and by pi r^2; chords lose 2e-4 of the latter.
        let grown = offset(&[square(0.0, 2.0)], 0.5).unwrap();
        let truth = 4.0 + 8.0 * 0.5 + std::f64::consts::PI * 0.25;
        assert!((areas(&grown)[0] - truth).abs() <= 2e-4 * std::f64::consts::PI * 0.25, "{:?}", areas(&grown));
        let shrunk = offset(&[square(0.0, 2.0)], -0.5).unwrap();
        assert!((areas(&shrunk)[0] - 1.0).abs() <= 1e-12);
        assert!(offset(&[square(0.0, 2.0)], -1.0).unwrap().is_empty());
    }

    #[test]
    fn booleans_have_their_areas() {
        let (a, b) = ([square(0.0, 2.0)], [square(1.0, 3.0)]);
        let area_of = |op: &str| areas(&combined(op, &a, &b).unwrap()).iter().sum::<f64>();
        assert_eq!(["union", "intersection", "difference", "xor"].map(area_of), [7.0, 1.0, 3.0, 6.0]);
    }
}
