//! The tokens of a shape that decide its field in a ball.
//!
//! A field of Lipschitz constant `L` stays within `L R` of its value at the centre of a ball of radius `R`. One
//! evaluation at the centre therefore bounds every node of the tree over the whole ball. An operand that cannot
//! determine the result anywhere is dropped: for two distances and a joint of width `k`, unless their difference is at
//! most `2 R + k` (W. Barbier et al., "Lipschitz Pruning: Hierarchical Simplification of Primitive-Based SDFs",
//! Eurographics 2025). The remaining tokens return the same bits in the ball, for values and for gradients.

use super::solid::Solid;
use crate::csg::evaluation::program::{Joint, PlacedDistanceOp, PlacedWarp, PlacedWarpKind, Program};
use crate::csg::model::lowered::Model;
use crate::csg::model::operand_stack::OperandStack;
use crate::csg::model::token::Token;
use crate::csg::tree::kind::Op;
use crate::simd::with_vectors;
use glam::{DVec3, IVec3};
use rustc_hash::FxHashMap;

/// Margin of the radius of a ball, relative to the model. Normals are evaluated this close to the faces of a cell, and
/// float32 rounds.
pub(super) const PAD: f64 = 1e-4;
/// Largest number of balls that are evaluated together.
pub(super) const BALLS: usize = 8;
/// Sides of the cells of [`NearTokens`], voxels. The tokens of a cell are pruned from the tokens of the larger cell
/// around it.
const SIDES: [i32; 3] = [64, 16, 4];
/// Ratio of consecutive [`SIDES`].
const NESTED: i32 = 4;
/// Largest number of tokens of the cells of one side, 8 MiB.
const MOST_TOKENS: usize = 1 << 20;
/// Least number of leaves of a shape whose evaluations use pruned tokens: with 20 leaves pruning saves no time.
const MANY_LEAVES: usize = 24;

/// A ball in local units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ball {
    pub middle: DVec3,
    pub radius: f64,
}

impl Ball {
    /// The ball around the box between two corners.
    pub(crate) fn around(lower: DVec3, upper: DVec3) -> Self {
        Self { middle: 0.5 * (lower + upper), radius: 0.5 * (upper - lower).length() }
    }
}

/// The constants of a shape for pruning.
#[derive(Debug)]
pub(crate) struct Pruning {
    /// Lipschitz constants of the leaves.
    steepness: Vec<f64>,
    has_many_leaves: bool,
}

impl Pruning {
    /// Whether evaluations near each other should share tokens.
    pub(crate) fn has_many_leaves(&self) -> bool {
        self.has_many_leaves
    }

    pub(crate) fn new(solid: &Solid) -> Self {
        Self {
            steepness: solid.model.leaves.iter().map(|leaf| leaf.primitive.lipschitz()).collect(),
            has_many_leaves: Model::leaf_count(&solid.model.tokens) >= MANY_LEAVES,
        }
    }

    /// Stores the tokens that decide the field in a ball, local units, in `scratch.kept`. `tokens` decide it in a ball
    /// around this one.
    pub(super) fn prune(&self, solid: &Solid, tokens: &[Token], ball: Ball, scratch: &mut PruningScratch) {
        scratch.evaluate(solid, tokens, &[ball.middle]);
        self.prune_at(solid, tokens, Ball { radius: ball.radius + PAD, ..ball }, 0, scratch);
    }

    /// Stores the tokens that decide the field in a ball, local units, in `scratch.kept`. Ball `lane` of
    /// [`PruningScratch::evaluate`] has the distances at the centre. Returns whether the field may change its sign.
    pub(super) fn prune_at(
        &self,
        solid: &Solid,
        tokens: &[Token],
        ball: Ball,
        lane: usize,
        scratch: &mut PruningScratch,
    ) -> bool {
        let program = solid.precise();
        let PruningScratch { values, operands: stack, balls, kept, .. } = scratch;
        stack.clear();
        kept.clear();
        // Centre and radius in the space of each open warp.
        balls.clear();
        balls.push(ball);
        let mut leaf_count = 0;
        for &token in tokens {
            let ball = *balls.top();
            match token {
                Token::Leaf(leaf) => {
                    let distance = values[leaf_count][lane];
                    leaf_count += 1;
                    let reach = ball.radius * self.steepness[leaf as usize];
                    stack.push(BoundedOperand { low: distance - reach, high: distance + reach, start: kept.len() });
                    kept.push(token);
                }
                Token::Combine(i) => {
                    let (top, below) = (stack.pop(), stack.pop());
                    let combine = &program.combines[i as usize];
                    stack.push(combined(combine.op, combine.joint, combine.is_swapped, below, top, token, kept));
                }
                Token::DistanceOp(i) => {
                    let operand = stack.top_mut();
                    match program.levels[i as usize] {
                        PlacedDistanceOp::Offset(distance) => {
                            operand.low -= distance;
                            operand.high -= distance;
                        }
                        PlacedDistanceOp::Shell(half) => {
                            let (low, high) = (operand.low, operand.high);
                            let nearest = if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
                            operand.low = nearest - half;
                            operand.high = low.abs().max(high.abs()) - half;
                        }
                        PlacedDistanceOp::Times(factor) => {
                            operand.low *= factor;
                            operand.high *= factor;
                        }
                    }
                    kept.push(token);
                }
                Token::Complement => negate(stack.top_mut(), kept),
                Token::Enter(i) => {
                    let warp = &program.warps[i as usize];
                    balls.push(entered(warp, ball));
                    kept.push(token);
                }
                Token::Leave(i) => {
                    balls.pop();
                    let operand = stack.top_mut();
                    let (least, most) = stretches(&program.warps[i as usize], *balls.top());
                    operand.low /= if operand.low > 0.0 { most } else { least };
                    operand.high /= if operand.high > 0.0 { least } else { most };
                    // The `Enter` before it belongs to it.
                    operand.start -= 1;
                    kept.push(token);
                }
            }
        }
        stack.finish().is_some_and(|whole| whole.low <= 0.0 && whole.high >= 0.0)
    }
}

/// The tokens that decide a field in the cells of nested grids, found at the first use of each cell.
#[derive(Debug)]
pub(crate) struct NearTokens {
    /// Length of a voxel, local units.
    voxel: f64,
    /// For each side the tokens of its cells.
    cells: [FxHashMap<IVec3, Vec<Token>>; SIDES.len()],
    /// Number of tokens in the cells of each side.
    counts: [usize; SIDES.len()],
    /// The tokens of the last ball of [`Self::find_alone`].
    of_ball: Vec<Token>,
    scratch: PruningScratch,
}

impl NearTokens {
    /// No tokens yet. `voxel` is the length of a voxel in local units.
    pub(crate) fn new(voxel: f64) -> Self {
        let (cells, scratch) = (Default::default(), PruningScratch::default());
        Self { voxel, cells, counts: [0; SIDES.len()], of_ball: Vec::new(), scratch }
    }

    /// Largest radius of a ball with the fewest tokens, local units.
    pub(crate) fn small_radius(&self) -> f64 {
        0.5 * f64::from(SIDES[SIDES.len() - 1]) * self.voxel
    }

    /// Tokens that return the field of the shape, bit for bit, in a ball around a place, local units.
    pub(crate) fn find<'a>(&'a mut self, pruning: &Pruning, solid: &'a Solid, ball: Ball) -> &'a [Token] {
        // A cell has the tokens for all balls around its places with up to half its side.
        let fits = |side: &i32| pruning.has_many_leaves && 2.0 * ball.radius <= f64::from(*side) * self.voxel;
        match SIDES.iter().rposition(fits) {
            Some(level) => {
                let cell = (ball.middle / (f64::from(SIDES[level]) * self.voxel)).floor().as_ivec3();
                self.fill(pruning, solid, level, cell);
                &self.cells[level][&cell]
            }
            None => &solid.model.tokens,
        }
    }

    /// [`Self::find`] for the ball alone, which takes longer and leaves fewer tokens.
    pub(crate) fn find_alone<'a>(&'a mut self, pruning: &Pruning, solid: &'a Solid, ball: Ball) -> &'a [Token] {
        if !pruning.has_many_leaves {
            return &solid.model.tokens;
        }
        let mut scratch = std::mem::take(&mut self.scratch);
        pruning.prune(solid, self.find(pruning, solid, ball), ball, &mut scratch);
        std::mem::swap(&mut self.of_ball, &mut scratch.kept);
        self.scratch = scratch;
        &self.of_ball
    }

    /// Finds the tokens of a cell and of the cells around it, if they are not known.
    fn fill(&mut self, pruning: &Pruning, solid: &Solid, level: usize, cell: IVec3) {
        if self.cells[level].contains_key(&cell) {
            return;
        }
        let outer = level.checked_sub(1).map(|outer| (outer, cell.div_euclid(IVec3::splat(NESTED))));
        if let Some((level, cell)) = outer {
            self.fill(pruning, solid, level, cell);
        }
        let tokens = outer.map_or(&solid.model.tokens[..], |(level, cell)| &self.cells[level][&cell]);
        let side = f64::from(SIDES[level]) * self.voxel;
        let ball = Ball { middle: (cell.as_dvec3() + 0.5) * side, radius: 0.5 * (3f64.sqrt() + 1.0) * side };
        pruning.prune(solid, tokens, ball, &mut self.scratch);
        let (cells, count) = (&mut self.cells[level], &mut self.counts[level]);
        if *count + self.scratch.kept.len() > MOST_TOKENS {
            cells.clear();
            *count = 0;
        }
        *count += self.scratch.kept.len();
        cells.insert(cell, self.scratch.kept.clone());
    }
}

/// Buffers that a thread keeps between balls.
#[derive(Debug, Default)]
pub(crate) struct PruningScratch {
    /// The distance to each leaf, in the order of the tokens, at the centre of each ball.
    values: Vec<[f64; BALLS]>,
    positions: OperandStack<[[f64; BALLS]; 3]>,
    operands: OperandStack<BoundedOperand>,
    balls: OperandStack<Ball>,
    /// The tokens kept by [`Pruning::prune_at`].
    pub(super) kept: Vec<Token>,
}

impl PruningScratch {
    /// Evaluates the distances to all leaves at the centres of up to [`BALLS`] balls, local units.
    pub(super) fn evaluate(&mut self, solid: &Solid, tokens: &[Token], points: &[DVec3]) {
        let (program, scratch) = (solid.precise(), self);
        let mut at = [[0.0; BALLS]; 3];
        for (i, point) in points.iter().enumerate() {
            for axis in 0..3 {
                at[axis][i] = point[axis];
            }
        }
        scratch.values.clear();
        scratch.positions.clear();
        scratch.positions.push(at);
        with_vectors!((program: &Program<f64> = program, tokens: &[Token] = tokens, scratch: &mut PruningScratch = scratch) {
            for &token in tokens {
                let at = scratch.positions.top();
                match token {
                    Token::Leaf(leaf) => scratch.values.push(program.leaves[leaf as usize].distances(at)),
                    Token::Enter(warp) => {
                        let inside = program.warps[warp as usize].positions(at);
                        scratch.positions.push(inside);
                    }
                    Token::Leave(_) => {
                        scratch.positions.pop();
                    }
                    _ => {}
                }
            }
        });
    }
}

/// Bounds on a node's field over a ball, and the start of its tokens.
#[derive(Debug, Clone, Copy)]
struct BoundedOperand {
    low: f64,
    high: f64,
    start: usize,
}

/// A ball around the image of a ball in the space of a warp.
fn entered(warp: &PlacedWarp<f64>, Ball { middle: at, radius }: Ball) -> Ball {
    let position = at.to_array().map(|x| [x]);
    let [x, y, z] = warp.positions(&position).map(|x| x[0]);
    let stretch = match warp.kind {
        PlacedWarpKind::Elongate(_) => 1.0,
        // The space of the selected copy is torn where another one is selected.
        PlacedWarpKind::NearestCopy(_) => {
            if warp.is_one_copy(at, radius) {
                1.0
            } else {
                f64::INFINITY
            }
        }
        // The actual stretch over the ball, which may differ from the one that distances are divided by.
        _ => 1.0 + warp.rate * (warp.radius_at(at) + radius),
    };
    Ball { middle: DVec3::new(x, y, z), radius: radius * stretch }
}

/// Smallest and largest divisor of distances in a ball.
fn stretches(warp: &PlacedWarp<f64>, Ball { middle: at, radius }: Ball) -> (f64, f64) {
    let (rate, least) = (warp.rate, warp.radius);
    let r = warp.radius_at(at);
    (1.0 + rate * (r - radius).max(least), 1.0 + rate * (r + radius).max(least))
}

fn negate(operand: &mut BoundedOperand, kept: &mut Vec<Token>) {
    (operand.low, operand.high) = (-operand.high, -operand.low);
    kept.push(Token::Complement);
}

/// One operand if the other cannot determine the result, else both under the operator.
fn combined(
    op: Op,
    joint: Joint<f64>,
    is_swapped: bool,
    below: BoundedOperand,
    top: BoundedOperand,
    token: Token,
    kept: &mut Vec<Token>,
) -> BoundedOperand {
    let (a, b) = if is_swapped { (top, below) } else { (below, top) };
    // The contributions as operands of a union, with the signs of the operator.
    let flip = |operand: BoundedOperand| BoundedOperand { low: -operand.high, high: -operand.low, ..operand };
    let (first, second) = match op {
        Op::Union | Op::Xor => (a, b),
        Op::Intersection => (flip(a), flip(b)),
        Op::Difference => (flip(a), b),
    };

    // Whether `far` is irrelevant beside `near` in a union.
    let is_beaten = |near: &BoundedOperand, far: &BoundedOperand| match joint {
        Joint::Sharp => far.low > near.high,
        Joint::Smooth(k, _) => far.low > near.high + k,
        Joint::Chamfer(k) => far.low > near.high.max(k + (std::f64::consts::SQRT_2 - 1.0) * near.high),
    };
    // In an xor the farther operand must exceed the magnitude of the other, inside or outside.
    let size =
        |operand: &BoundedOperand| BoundedOperand { high: operand.low.abs().max(operand.high.abs()), ..*operand };
    let beaten = |near: &BoundedOperand, far: &BoundedOperand| match op {
        Op::Xor => is_beaten(&size(near), far),
        _ => is_beaten(near, far),
    };
    // Deep inside one operand, an xor is the complement of the other.
    let drowned = |near: &BoundedOperand, far: &BoundedOperand| op == Op::Xor && is_beaten(&size(near), &flip(*far));

    if beaten(&first, &second) || drowned(&first, &second) {
        let is_inverted = drowned(&first, &second);
        let mut remaining = drop_operand(a, b, kept);
        if is_inverted {
            negate(&mut remaining, kept);
        }
        return remaining;
    }
    if beaten(&second, &first) || drowned(&second, &first) {
        let is_inverted = drowned(&second, &first) || op == Op::Difference;
        let mut remaining = drop_operand(b, a, kept);
        if is_inverted {
            negate(&mut remaining, kept);
        }
        return remaining;
    }

    kept.push(token);
    let start = below.start;
    let union = |a: &BoundedOperand, b: &BoundedOperand| {
        // The smooth minimum is monotone in both operands.
        let at = |a: f64, b: f64| match joint {
            Joint::Sharp => a.min(b),
            Joint::Smooth(k, quarter) => {
                let h = (k - (a - b).abs()).max(0.0);
                a.min(b) - h * h * quarter
            }
            Joint::Chamfer(k) => a.min(b).min((a + b - k) * 0.5f64.sqrt()),
        };
        BoundedOperand { low: at(a.low, b.low), high: at(a.high, b.high), start }
    };
    match op {
        Op::Union => union(&first, &second),
        Op::Intersection | Op::Difference => flip(union(&first, &second)),
        Op::Xor => {
            let (either, both) = (union(&a, &b), flip(union(&flip(a), &flip(b))));
            flip(union(&flip(either), &both))
        }
    }
}

/// Drops the tokens of `gone`, which are adjacent to the tokens of `remaining`.
fn drop_operand(remaining: BoundedOperand, gone: BoundedOperand, kept: &mut Vec<Token>) -> BoundedOperand {
    if gone.start > remaining.start {
        kept.truncate(gone.start);
        remaining
    } else {
        kept.drain(gone.start..remaining.start);
        BoundedOperand { start: gone.start, ..remaining }
    }
}

/// The text of a box, joined by some operators in turn with `count` leaves at random places.
#[cfg(test)]
pub(super) fn text_of_many_leaves(count: usize, joints: &[&str], random: &mut impl FnMut() -> f64) -> String {
    let leaves = ["(sphere 0.3)", "(rotate 1 2 3 40 (box 0.3 0.2 0.4))", "(twist 60 (cone 0.4 0.5))"];
    (0..count).fold("(box 2 2 2)".to_owned(), |text, i| {
        let [x, y, z] = [random(), random(), random()].map(|x| 2.4 * x - 1.2);
        format!("({} {text} (move {x} {y} {z} {}))", joints[i % joints.len()], leaves[i % leaves.len()])
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::evaluation::dual::Dual;
    use crate::csg::evaluation::program::Stack;
    use crate::csg::parts::solid::run_wide;
    use crate::csg::text::language::parse;

    #[test]
    fn tokens_near_a_place_return_the_same_bits() {
        let mut random = crate::mesh::random::uniform(5);
        for joint in ["union", "blend union 0.1", "chamfer union 0.1", "xor", "diff"] {
            let text = text_of_many_leaves(40, &[joint], &mut random);
            // A leaf far larger than the shape, whose values float32 rounds by 1e-3.
            let text = format!("(inter {text} (move 0 0 -10000 (sphere 20000)))");
            let solid = Solid::new(&parse(&text).unwrap()).unwrap();
            let (pruning, voxel) = (Pruning::new(&solid), 0.02);
            let with_gradients = Program::<Dual>::new(&solid.model, solid.frame);
            let mut near = NearTokens::new(voxel);
            let mut shorter = 0;
            for i in 0..300 {
                let place = DVec3::new(random(), random(), random()) * 2.0 - 1.0;
                let radius = voxel * [0.1, 1.5, 6.0, 30.0, 50.0][i % 5];
                let at: [[f64; 8]; 3] = std::array::from_fn(|axis| {
                    std::array::from_fn(|_| place[axis] + (2.0 * random() - 1.0) * radius / 3f64.sqrt())
                });
                let dual: [[Dual; 8]; 3] = std::array::from_fn(|axis| {
                    std::array::from_fn(|i| Dual::position(DVec3::new(at[0][i], at[1][i], at[2][i]))[axis])
                });
                let all = run_wide(solid.precise(), &solid.model.tokens, &at, &mut Stack::default());
                let tokens = near.find(&pruning, &solid, Ball { middle: place, radius }).to_vec();
                let alone = near.find_alone(&pruning, &solid, Ball { middle: place, radius }).to_vec();
                for tokens in [tokens, alone] {
                    let some = run_wide(solid.precise(), &tokens, &at, &mut Stack::default());
                    assert_eq!(all.map(f64::to_bits), some.map(f64::to_bits), "{joint} at {place}");
                    let [whole, part] = [&solid.model.tokens, &tokens]
                        .map(|tokens| run_wide(&with_gradients, tokens, &dual, &mut Stack::default()));
                    assert!(whole.iter().zip(&part).all(|(a, b)| a.slope == b.slope), "{joint} at {place}");
                    shorter += usize::from(2 * tokens.len() < solid.model.tokens.len());
                }
            }
            assert!(shorter >= 100, "{joint}: {shorter}");
        }
    }
}
