//! A binary tree over emitters. A place draws an emitter from it in proportion to an estimate of its light.
//!
//! # Theory
//!
//! At each node the place chooses one of the two children in proportion to an estimate of its light: its power, times
//! means of the cosines at the place and at the emitter, divided by the square of the distance (A. Estevez Conty and
//! C. Kulla, *Importance sampling of many lights with adaptive tree splitting*, 2018). A node is bounded by a ball of
//! positions and a cone of normals. A child has the probability 0 only if it sends no light.
//!
//! A place that draws many emitters first divides the tree into a *cut*, some nodes that together have all emitters,
//! and chooses among these. The estimates are better for small nodes, so a cut follows the light better than choices
//! from the root (adaptive splitting, in the same work).
//!
//! One number from 0 to 1 makes all choices: after each choice it is the position within the part of the child. Even
//! steps of the number therefore spread evenly over the emitters, whose order is spatial.

use crate::error::Error;
use crate::progress::Progress;
use glam::DVec3;
use std::f64::consts::PI;

/// Most emitters around which one ball is tested for a ray.
const FEW: usize = 16;

/// Number of leaves from which the two halves are made by two threads.
const PARALLEL: usize = 1024;

/// The positions and normals of emitters.
#[derive(Debug, Clone, Copy)]
pub(super) struct Bounds {
    lower: DVec3,
    upper: DVec3,
    /// The axis of the cone of normals, and the largest angle between a normal and it, radians.
    axis: DVec3,
    spread: f64,
    /// Whether light also leaves against the normals.
    is_two_sided: bool,
    power: f64,
}

impl Bounds {
    /// An emitter with these corners. Without a normal it emits in all directions.
    pub(super) fn new(
        corners: impl IntoIterator<Item = DVec3>,
        normal: Option<DVec3>,
        is_two_sided: bool,
        power: f64,
    ) -> Self {
        let nothing = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let (lower, upper) = corners.into_iter().fold(nothing, |(lower, upper), p| (lower.min(p), upper.max(p)));
        let (axis, spread) = normal.map_or((DVec3::Z, PI), |normal| (normal, 0.0));
        Self { lower, upper, axis, spread, is_two_sided, power }
    }

    fn union(&self, other: &Self) -> Self {
        let (axis, spread) = union_of_cones((self.axis, self.spread), (other.axis, other.spread));
        Self {
            lower: self.lower.min(other.lower),
            upper: self.upper.max(other.upper),
            axis,
            spread,
            is_two_sided: self.is_two_sided || other.is_two_sided,
            power: self.power + other.power,
        }
    }
}

/// A cone around two cones, each an axis and an angle from it.
fn union_of_cones(first: (DVec3, f64), second: (DVec3, f64)) -> (DVec3, f64) {
    let (wide, narrow) = if first.1 >= second.1 { (first, second) } else { (second, first) };
    let between = wide.0.dot(narrow.0).clamp(-1.0, 1.0).acos();
    if between + narrow.1 <= wide.1 {
        return wide;
    }
    let spread = 0.5 * (wide.1 + between + narrow.1);
    let sine = between.sin();
    if spread >= PI || sine <= f64::EPSILON.sqrt() {
        return (wide.0, PI);
    }
    // The axis turns from the wider cone to the narrower one.
    let turn = spread - wide.1;
    let axis = (wide.0 * (between - turn).sin() + narrow.0 * turn.sin()) / sine;
    (axis.normalize_or(wide.0), spread)
}

/// A node with its ball and its cone.
#[derive(Debug, Clone, Copy, Default)]
struct Node {
    center: DVec3,
    radius: f64,
    axis: DVec3,
    /// Cosine and sine of the angle of the cone.
    spread: [f64; 2],
    is_two_sided: bool,
    power: f64,
}

impl Node {
    fn new(bounds: &Bounds) -> Self {
        let (sine, cosine) = bounds.spread.sin_cos();
        Self {
            center: 0.5 * (bounds.lower + bounds.upper),
            radius: 0.5 * bounds.lower.distance(bounds.upper),
            axis: bounds.axis,
            spread: [cosine, sine],
            is_two_sided: bounds.is_two_sided,
            power: bounds.power,
        }
    }

    /// Whether a ray hits the ball.
    fn is_hit(&self, p: DVec3, direction: DVec3) -> bool {
        let to = self.center - p;
        let squared = self.radius * self.radius;
        let (distance, along) = (to.length_squared(), to.dot(direction));
        distance <= squared || (along > 0.0 && distance - along * along <= squared)
    }

    /// The estimate of the light at a place with a normal: 0 only if it is dark.
    #[inline]
    fn light(&self, p: DVec3, normal: DVec3) -> f64 {
        let to = self.center - p;
        let squared = to.length_squared();
        let least = self.radius * self.radius;
        if squared <= least {
            return self.power / least.max(f64::MIN_POSITIVE);
        }
        let inverse = squared.sqrt().recip();
        // The sine of the half angle of the ball. No direction in the ball and no normal in the cone changes a cosine
        // by more than the sum of the sines of their angles.
        let ball = self.radius * inverse;
        let at_place = mean_of_lit(normal.dot(to) * inverse, ball);
        let toward = -self.axis.dot(to) * inverse;
        let toward = if self.is_two_sided { toward.abs() } else { toward };
        let [cosine, sine] = self.spread;
        let at_emitter = if cosine <= 0.0 { 1.0 } else { mean_of_lit(toward, sine + ball) };
        self.power * at_place * at_emitter / squared
    }
}

/// The mean of the positive parts of numbers that are spread evenly, by at most `spread` from `middle`.
#[inline]
fn mean_of_lit(middle: f64, spread: f64) -> f64 {
    if middle >= spread {
        middle
    } else if middle <= -spread {
        0.0
    } else {
        (middle + spread).powi(2) / (4.0 * spread)
    }
}

/// The nodes of a tree over a list of emitters. The first half of the leaves of a node is below its first child.
#[derive(Debug, Default)]
pub(super) struct EmitterTree {
    /// In preorder: a node, the nodes below its first child, the nodes below its second child.
    nodes: Vec<Node>,
    count: usize,
}

/// A node on the way to a leaf: its index, its first leaf and the number of its leaves.
#[derive(Debug, Clone, Copy)]
struct Position {
    node: usize,
    first: usize,
    leaves: usize,
}

impl Position {
    fn children(self) -> [Self; 2] {
        let left = self.leaves / 2;
        [
            Self { node: self.node + 1, first: self.first, leaves: left },
            Self { node: self.node + 2 * left, first: self.first + left, leaves: self.leaves - left },
        ]
    }
}

/// Nodes that partition a tree, except nodes without light at a place. They are in the order of the tree, each with the
/// sum of the estimates of their light up to it.
#[derive(Debug)]
pub(crate) struct Cut {
    parts: Vec<(f64, Position)>,
    total: f64,
}

impl Cut {
    fn push(&mut self, node: Position, estimate: f64) {
        let end = self.total + estimate;
        // Beside a much brighter node the sum does not grow.
        if end > self.total {
            self.parts.push((end, node));
            self.total = end;
        }
    }

    /// The sum of the estimates before a part, and its own.
    fn start(&self, part: usize) -> f64 {
        part.checked_sub(1).map_or(0.0, |before| self.parts[before].0)
    }

    /// The part that a number from 0 to 1 draws, its probability, and the position within it, from 0 to 1.
    fn draw(&self, at: f64) -> (Position, f64, f64) {
        let target = at * self.total;
        let part = self.parts.partition_point(|part| part.0 <= target).min(self.parts.len() - 1);
        let (start, (end, position)) = (self.start(part), self.parts[part]);
        (position, (end - start) / self.total, ((target - start) / (end - start)).clamp(0.0, 1.0))
    }

    /// The part with a leaf, and its probability; None if it has no light.
    fn part_of(&self, leaf: usize) -> Option<(Position, f64)> {
        let part = self.parts.partition_point(|part| part.1.first <= leaf).checked_sub(1)?;
        let (end, position) = self.parts[part];
        (leaf < position.first + position.leaves).then(|| (position, (end - self.start(part)) / self.total))
    }
}

impl EmitterTree {
    /// `bounds` computes the bounds of the emitter with an index below `count`.
    pub(super) fn new(
        count: usize,
        bounds: impl Fn(usize) -> Bounds + Sync,
        progress: &Progress,
    ) -> Result<Self, Error> {
        let mut nodes = vec![Node::default(); (2 * count).saturating_sub(1)];
        if count > 0 {
            fill(&mut nodes, 0, count, &bounds, progress)?;
        }
        Ok(Self { nodes, count })
    }

    /// Memory of a tree over emitters, bytes.
    pub(super) fn bytes(count: usize) -> usize {
        2 * count * size_of::<Node>()
    }

    /// The shares of both children in the light at a place; None if both are dark.
    fn share(&self, [first, second]: [Position; 2], p: DVec3, normal: DVec3) -> Option<f64> {
        let [first, second] = [first, second].map(|child| self.nodes[child.node].light(p, normal));
        let total = first + second;
        (total > 0.0 && total.is_finite()).then(|| first / total)
    }

    /// About `count` nodes that partition the tree, by their light at a place. None if all emitters are dark, or if an
    /// estimate is not finite.
    pub(super) fn cut(&self, p: DVec3, normal: DVec3, count: usize) -> Option<Cut> {
        let root = self.root();
        let mut cut = Cut { parts: Vec::with_capacity(count.min(root.leaves)), total: 0.0 };
        if root.leaves > 0 {
            let estimate = self.nodes[root.node].light(p, normal);
            self.divide(root, estimate, count.min(root.leaves) as f64, (p, normal), &mut cut);
        }
        (cut.total > 0.0 && cut.total.is_finite()).then_some(cut)
    }

    /// Adds `count` nodes below a node to a cut, more of them to the child with the larger estimate.
    fn divide(&self, node: Position, estimate: f64, count: f64, (p, normal): (DVec3, DVec3), cut: &mut Cut) {
        if node.leaves == 1 || count < 2.0 {
            cut.push(node, estimate);
            return;
        }
        let children = node.children();
        let estimates = children.map(|child| self.nodes[child.node].light(p, normal));
        let share = estimates[0] / (estimates[0] + estimates[1]);
        let [most_first, most_second] = children.map(|child| child.leaves as f64);
        let first = (count * share).min(most_first).max(count - most_second);
        for ((child, estimate), count) in children.into_iter().zip(estimates).zip([first, count - first]) {
            if estimate > 0.0 {
                self.divide(child, estimate, count, (p, normal), cut);
            }
        }
    }

    /// An emitter, the probability to draw it, and the position within it, from 0 to 1. `at`, from 0 to 1, draws it,
    /// from a cut at the place if there is one. None if `at` draws dark nodes.
    pub(super) fn draw(&self, cut: Option<&Cut>, p: DVec3, normal: DVec3, at: f64) -> Option<(usize, f64, f64)> {
        let (mut position, mut probability, mut at) = cut.map_or((self.root(), 1.0, at), |cut| cut.draw(at));
        while position.leaves > 1 {
            let children = position.children();
            let share = self.share(children, p, normal)?;
            if at < share {
                (position, probability, at) = (children[0], probability * share, at / share);
            } else {
                let rest = 1.0 - share;
                (position, probability, at) = (children[1], probability * rest, (at - share) / rest);
            }
        }
        (probability > 0.0).then(|| (position.first, probability, at.clamp(0.0, 1.0)))
    }

    /// The probability to draw an emitter, from a cut if there is one.
    pub(super) fn probability(&self, cut: Option<&Cut>, emitter: usize, p: DVec3, normal: DVec3) -> f64 {
        let start = cut.map_or(Some((self.root(), 1.0)), |cut| cut.part_of(emitter));
        let Some((mut position, mut probability)) = start else { return 0.0 };
        while position.leaves > 1 {
            let children = position.children();
            let is_second = emitter >= children[1].first;
            position = children[usize::from(is_second)];
            // Dark children below a node with an estimate are not drawn.
            probability *=
                self.share(children, p, normal).map_or(0.0, |share| if is_second { 1.0 - share } else { share });
        }
        probability
    }

    /// Whether a ray may hit an emitter: false if it hits no ball around [`FEW`] of them.
    pub(super) fn may_be_hit(&self, p: DVec3, direction: DVec3) -> bool {
        self.count > 0 && self.is_near(self.root(), p, direction)
    }

    fn is_near(&self, position: Position, p: DVec3, direction: DVec3) -> bool {
        self.nodes[position.node].is_hit(p, direction)
            && (position.leaves <= FEW || position.children().iter().any(|&child| self.is_near(child, p, direction)))
    }

    fn root(&self) -> Position {
        Position { node: 0, first: 0, leaves: self.count }
    }
}

/// Computes the nodes over some leaves; returns the bounds of the first one.
fn fill(
    nodes: &mut [Node],
    first: usize,
    leaves: usize,
    bounds: &(impl Fn(usize) -> Bounds + Sync),
    progress: &Progress,
) -> Result<Bounds, Error> {
    let own = if leaves == 1 {
        bounds(first)
    } else {
        let left = leaves / 2;
        let (lower, upper) = nodes[1..].split_at_mut(2 * left - 1);
        let mut first_half = || fill(lower, first, left, bounds, progress);
        let mut second_half = || fill(upper, first + left, leaves - left, bounds, progress);
        let (a, b) = if leaves >= PARALLEL {
            progress.check()?;
            rayon::join(first_half, second_half)
        } else {
            (first_half(), second_half())
        };
        a?.union(&b?)
    };
    nodes[0] = Node::new(&own);
    Ok(own)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Points of a ball with outward normals, in order around it.
    fn ball(i: usize) -> (DVec3, DVec3) {
        let z = 1.0 - 2.0 * (i as f64 + 0.5) / 100.0;
        let (y, x) = (i as f64 * crate::geometry::GOLDEN_ANGLE).sin_cos();
        let normal = DVec3::new(x * (1.0 - z * z).sqrt(), y * (1.0 - z * z).sqrt(), z);
        (0.5 * normal, normal)
    }

    #[test]
    fn every_lit_emitter_is_drawn_with_its_probability() {
        let tree = EmitterTree::new(
            100,
            |i| Bounds::new([ball(i).0], Some(ball(i).1), false, 1.0 + i as f64),
            &Progress::new(),
        )
        .unwrap();
        for (p, normal) in [
            (DVec3::new(0.0, 0.0, 3.0), DVec3::NEG_Z),
            (DVec3::new(2.0, 0.4, -1.0), DVec3::NEG_X),
            (DVec3::new(0.0, 0.6, 0.0), DVec3::new(0.6, -0.8, 0.0)),
        ] {
            let mut drawn = [0; 100];
            let steps = 100_000;
            for step in 0..steps {
                let at = (f64::from(step) + 0.5) / f64::from(steps);
                let Some((emitter, probability, within)) = tree.draw(None, p, normal, at) else { continue };
                assert!((0.0..=1.0).contains(&within));
                assert_eq!(probability, tree.probability(None, emitter, p, normal));
                drawn[emitter] += 1;
            }
            for i in 0..100 {
                let probability = tree.probability(None, i, p, normal);
                let share = f64::from(drawn[i]) / f64::from(steps);
                assert!((share - probability).abs() <= 1e-4, "{i}: {share} {probability}");
                let (place, facing) = ball(i);
                let to = place - p;
                if normal.dot(to) > 0.0 && facing.dot(to) < 0.0 {
                    assert!(probability > 0.0, "{i} is lit");
                }
            }
        }
    }

    #[test]
    fn a_cut_draws_every_lit_emitter_with_its_probability() {
        let count = 400;
        let place = |i: usize| ball(i % 100).0 + DVec3::new((i / 100) as f64, 0.0, 0.0);
        let bounds = |i: usize| Bounds::new([place(i)], Some(ball(i % 100).1), false, 1.0);
        let tree = EmitterTree::new(count, bounds, &Progress::new()).unwrap();
        let (p, normal) = (DVec3::new(3.0, 2.0, 0.5), DVec3::NEG_Y);
        let cut = tree.cut(p, normal, 50).unwrap();
        let mut sum = 0.0;
        for i in 0..count {
            let probability = tree.probability(Some(&cut), i, p, normal);
            sum += probability;
            let to = place(i) - p;
            let is_lit = normal.dot(to) > 0.0 && ball(i % 100).1.dot(to) < 0.0;
            assert!(probability > 0.0 || !is_lit, "{i}");
        }
        // The other numbers draw nodes whose emitters are all dark.
        assert!(sum <= 1.0 + 1e-9, "{sum}");
        let mut missing = 0;
        for step in 0..1000 {
            let at = f64::from(step) / 999.0;
            let Some((emitter, probability, within)) = tree.draw(Some(&cut), p, normal, at) else {
                missing += 1;
                continue;
            };
            assert!((0.0..=1.0).contains(&within));
            let again = tree.probability(Some(&cut), emitter, p, normal);
            assert!((again / probability - 1.0).abs() <= 1e-12);
        }
        // Each end of the parts of a cut is one step or none.
        assert!((f64::from(missing) / 1000.0 - (1.0 - sum)).abs() <= 0.05, "{missing} {sum}");
    }

    #[test]
    fn the_mean_of_lit_cosines_is_their_integral() {
        for (middle, spread) in [(0.5, 0.2), (0.1, 0.4), (-0.1, 0.4), (-0.5, 0.2)] {
            let steps = 10_000;
            let cosine = |i: i32| middle + spread * (2.0 * (f64::from(i) + 0.5) / f64::from(steps) - 1.0);
            let mean = (0..steps).map(|i| cosine(i).max(0.0)).sum::<f64>() / f64::from(steps);
            assert!((mean_of_lit(middle, spread) - mean).abs() <= 1e-6, "{middle} {spread}");
        }
    }

    #[test]
    fn a_cone_around_two_cones_contains_both() {
        let turned = |angle: f64| DVec3::new(angle.cos(), angle.sin(), 0.0);
        for (first, second) in [((0.0, 0.2), (1.0, 0.1)), ((0.0, 0.0), (2.5, 0.4)), ((0.3, 1.0), (0.4, 0.1))] {
            let (axis, spread) = union_of_cones((turned(first.0), first.1), (turned(second.0), second.1));
            for (angle, width) in [first, second] {
                for side in [angle - width, angle + width] {
                    assert!(axis.angle_between(turned(side)) <= spread + 1e-12);
                }
            }
            assert!(spread <= 0.5 * (first.1 + second.1 + (first.0 - second.0).abs()) + first.1.max(second.1) + 1e-12);
        }
        assert!(union_of_cones((DVec3::X, 0.1), (DVec3::NEG_X, 0.1)).1 >= PI);
    }
}
