//! Decomposition by an octree with the relevant leaves per cell: Lipschitz pruning (W. Barbier et al., "Lipschitz
//! Pruning: Hierarchical Simplification of Primitive-Based SDFs", Eurographics 2025).
//!
//! A field of Lipschitz constant `L` stays within `L R` of its value at the centre of a cell whose corners are `R`
//! away. One evaluation at the centre therefore bounds every node of the tree over the whole cell. An operand that
//! cannot determine the result anywhere is dropped (for two distances and a joint of width `k`, unless their difference
//! is at most `2 R + k`), and a cell in which the whole field keeps its sign contains no surface. The remaining tokens
//! are passed to the children. A leaf is evaluated only in cells near it: at the centres of all children of a cell at
//! once, in the lanes of vector instructions. Sibling cells with equal tokens are merged again.
//!
//! A cell is divided until few leaves are left in it. For a sphere-traced part these are one or two leaves in a small
//! cell: its box should fit the surface tightly, because every step is expensive. Where hits have a closed form
//! ([`super::chord`]), a few leaves in a large cell are cheaper than many boxes.

use super::chord::PartKind;
use super::part::{Part, grouped};
use super::solid::Solid;
use crate::csg::evaluation::program::{Joint, PlacedDistanceOp, PlacedWarp, PlacedWarpKind, Program};
use crate::csg::model::lowered::Model;
use crate::csg::model::operand_stack::OperandStack;
use crate::csg::model::token::Token;
use crate::csg::tree::kind::Op;
use crate::simd::with_vectors;
use glam::{DVec3, UVec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Number of levels to which sphere-traced cells are always divided, so that boxes fit the surface tightly.
const MIN_DEPTH: u32 = 4;
/// Largest depth.
const MAX_DEPTH: u32 = 7;
/// A sphere-traced cell at depth [`MIN_DEPTH`] with at most this many leaves is not divided. One level deeper the limit
/// is twice as high: eight boxes instead of one must save more than they cost.
const FEW_LEAVES: usize = 2;
/// As [`FEW_LEAVES`], for cells whose hits have a closed form, at any depth.
const FEW_CHORDS: usize = 4;
/// Number of tokens above which a cell becomes a task of its own.
const TASK_TOKENS: usize = 48;
/// Margin of the radius of a cell, relative to the model. Normals are evaluated this close to the faces, and float32
/// rounds.
const PAD: f64 = 1e-4;
/// Enlargement of the root beyond the bounds, relative to the model, so that no surface lies in the root's faces.
const ROOT_PAD: f64 = 1e-3;

/// Number of lattice positions of faces along an axis.
const LATTICE: u32 = 1 << MAX_DEPTH;

/// Largest number of children of a cell.
const CHILDREN: usize = 8;

/// A box of the lattice over the root.
#[derive(Debug, Clone, Copy)]
struct OctreeCell {
    low: UVec3,
    high: UVec3,
}

impl OctreeCell {
    fn volume(&self) -> u64 {
        (self.high - self.low).as_u64vec3().element_product()
    }
}

/// A cell that is not divided, and its tokens.
type OctreeLeaf = (OctreeCell, Arc<[Token]>);

struct Octree<'a> {
    solid: &'a Solid,
    lower: DVec3,
    extent: DVec3,
    /// Lipschitz constants of the leaves.
    steepness: Vec<f64>,
}

/// The parts of a bounded solid.
pub(crate) fn parts(solid: &Solid) -> Vec<Part> {
    let extent = &solid.model.extent;
    let pad = DVec3::splat(ROOT_PAD * (extent.upper - extent.lower).max_element());
    let (lower, upper) = (extent.lower - pad, extent.upper + pad);
    let steepness = solid.model.leaves.iter().map(|leaf| leaf.primitive.lipschitz()).collect();
    let tree = Octree { solid, lower, extent: upper - lower, steepness };
    let root = OctreeCell { low: UVec3::ZERO, high: UVec3::splat(LATTICE) };
    let mut cells = Vec::new();
    let mut scratch = OctreeScratch::default();
    let (middle, radius) = (tree.middle(root), tree.radius(root));
    leaf_values(&solid.program, &solid.model.tokens, &[middle], &mut scratch);
    if tree.prune(&solid.model.tokens, middle, radius, 0, &mut scratch) {
        let kept = std::mem::take(&mut scratch.kept);
        tree.visit(root, &kept, 0, &mut scratch, &mut cells);
    }
    grouped(cells.into_iter().map(|(cell, tokens)| (tokens, [tree.corner(cell.low), tree.corner(cell.high)])))
}

impl Octree<'_> {
    /// A lattice point has the same coordinates in every cell.
    fn corner(&self, at: UVec3) -> DVec3 {
        self.lower + self.extent * (at.as_dvec3() / f64::from(LATTICE))
    }

    /// Centre of a cell, local units.
    fn middle(&self, cell: OctreeCell) -> DVec3 {
        self.solid.frame.local(0.5 * (self.corner(cell.low) + self.corner(cell.high)))
    }

    /// Slightly enlarged distance from the centre to the corners, local units.
    fn radius(&self, cell: OctreeCell) -> f64 {
        0.5 * (self.corner(cell.high) - self.corner(cell.low)).length() / self.solid.frame.scale + PAD
    }

    /// Whether a cell with these tokens is not divided further.
    fn is_done(&self, tokens: &[Token], depth: u32) -> bool {
        if depth == MAX_DEPTH {
            return true;
        }
        let leaves = Model::leaf_count(tokens);
        let few = if depth < MIN_DEPTH { 0 } else { FEW_LEAVES << (depth - MIN_DEPTH) };
        leaves <= few || (leaves <= FEW_CHORDS && PartKind::of(&self.solid.program, tokens) != PartKind::Field)
    }

    /// Appends the leaves of the octree in `cell`, where `tokens` are relevant.
    fn visit(
        &self,
        cell: OctreeCell,
        tokens: &[Token],
        depth: u32,
        scratch: &mut OctreeScratch,
        out: &mut Vec<OctreeLeaf>,
    ) {
        if self.is_done(tokens, depth) {
            out.push((cell, tokens.into()));
            return;
        }
        let children = self.children(cell);
        let middles: Vec<DVec3> = children.iter().map(|&child| self.middle(child)).collect();
        leaf_values(&self.solid.program, tokens, &middles, scratch);
        let mut kept: [Option<Vec<Token>>; CHILDREN] = Default::default();
        for (i, &child) in children.iter().enumerate() {
            if self.prune(tokens, middles[i], self.radius(child), i, scratch) {
                kept[i] = Some(scratch.kept.as_slice().into());
            }
        }

        let first = out.len();
        let inner = children.into_iter().zip(kept).filter_map(|(child, kept)| Some((child, kept?)));
        if tokens.len() > TASK_TOKENS {
            let inner: Vec<(OctreeCell, Vec<Token>)> = inner.collect();
            let found: Vec<Vec<OctreeLeaf>> = inner
                .par_iter()
                .map_init(OctreeScratch::default, |scratch, (child, kept)| {
                    let mut cells = Vec::new();
                    self.visit(*child, kept, depth + 1, scratch, &mut cells);
                    cells
                })
                .collect();
            out.extend(found.into_iter().flatten());
        } else {
            inner.for_each(|(child, kept)| self.visit(child, &kept, depth + 1, scratch, out));
        }
        merge(cell, first, out);
    }

    /// Whether the field may change its sign in a ball, local units. The relevant tokens are then in `scratch.kept`.
    /// Lane `lane` has the distances at the centre.
    fn prune(&self, tokens: &[Token], middle: DVec3, radius: f64, lane: usize, scratch: &mut OctreeScratch) -> bool {
        let program = &self.solid.program;
        let OctreeScratch { values, operands: stack, balls, kept, .. } = scratch;
        stack.clear();
        kept.clear();
        // Centre and radius in the space of each open warp.
        balls.clear();
        balls.push((middle, radius));
        let mut leaf_count = 0;
        for &token in tokens {
            let (at, radius) = *balls.top();
            match token {
                Token::Leaf(leaf) => {
                    let distance = f64::from(values[leaf_count][lane]);
                    leaf_count += 1;
                    let reach = radius * self.steepness[leaf as usize];
                    stack.push(CellOperand { low: distance - reach, high: distance + reach, start: kept.len() });
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
                            operand.low -= f64::from(distance);
                            operand.high -= f64::from(distance);
                        }
                        PlacedDistanceOp::Shell(half) => {
                            let (low, high) = (operand.low, operand.high);
                            let nearest = if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
                            operand.low = nearest - f64::from(half);
                            operand.high = low.abs().max(high.abs()) - f64::from(half);
                        }
                        PlacedDistanceOp::Times(factor) => {
                            operand.low *= f64::from(factor);
                            operand.high *= f64::from(factor);
                        }
                    }
                    kept.push(token);
                }
                Token::Complement => negate(stack.top_mut(), kept),
                Token::Enter(i) => {
                    let warp = &program.warps[i as usize];
                    let (inside, farthest) = entered(warp, at, radius);
                    balls.push((inside, radius * farthest));
                    kept.push(token);
                }
                Token::Leave(i) => {
                    balls.pop();
                    let (at, radius) = *balls.top();
                    let operand = stack.top_mut();
                    let (least, most) = stretches(&program.warps[i as usize], at, radius);
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

    /// Divides the long sides in half. A flat cell is not made flatter.
    fn children(&self, cell: OctreeCell) -> Vec<OctreeCell> {
        let sides = self.corner(cell.high) - self.corner(cell.low);
        let longest = sides.max_element();
        let halves = |axis: usize| {
            let (low, high) = (cell.low[axis], cell.high[axis]);
            let middle = (low + high) / 2;
            if sides[axis] > 0.6 * longest && middle > low { ([low, middle, high], 2) } else { ([low, high, high], 1) }
        };
        let [(xs, along_x), (ys, along_y), (zs, along_z)] = [halves(0), halves(1), halves(2)];
        let mut children = Vec::with_capacity(CHILDREN);
        for z in 0..along_z {
            for y in 0..along_y {
                for x in 0..along_x {
                    let (low, high) = (UVec3::new(xs[x], ys[y], zs[z]), UVec3::new(xs[x + 1], ys[y + 1], zs[z + 1]));
                    children.push(OctreeCell { low, high });
                }
            }
        }
        children
    }
}

/// Replaces the cells from `first` on by their parent if they fill it and are all equal.
fn merge(cell: OctreeCell, first: usize, out: &mut Vec<OctreeLeaf>) {
    let Some(((_, tokens), others)) = out[first..].split_first() else { return };
    let is_one = others.len() < CHILDREN
        && others.iter().all(|(_, other)| other == tokens)
        && out[first..].iter().map(|(cell, _)| cell.volume()).sum::<u64>() == cell.volume();
    if is_one {
        let tokens = tokens.clone();
        out.truncate(first);
        out.push((cell, tokens));
    }
}

/// Buffers that a thread keeps between cells.
#[derive(Default)]
struct OctreeScratch {
    /// The distance to each leaf, in the order of the tokens, at the centre of each child.
    values: Vec<[f32; CHILDREN]>,
    positions: OperandStack<[[f32; CHILDREN]; 3]>,
    operands: OperandStack<CellOperand>,
    balls: OperandStack<(DVec3, f64)>,
    /// The tokens kept by [`Octree::prune`].
    kept: Vec<Token>,
}

/// The distances to all leaves at some points, local units.
fn leaf_values(program: &Program<f32>, tokens: &[Token], points: &[DVec3], scratch: &mut OctreeScratch) {
    let mut at = [[0.0; CHILDREN]; 3];
    for (i, point) in points.iter().enumerate() {
        for axis in 0..3 {
            at[axis][i] = point[axis] as f32;
        }
    }
    scratch.values.clear();
    scratch.positions.clear();
    scratch.positions.push(at);
    with_vectors!((program: &Program<f32> = program, tokens: &[Token] = tokens, scratch: &mut OctreeScratch = scratch) {
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

/// Bounds on a node's field over a cell, and the start of its tokens.
#[derive(Debug, Clone, Copy)]
struct CellOperand {
    low: f64,
    high: f64,
    start: usize,
}

/// The ball in the space of a warp, and the factor by which the warp stretches it.
fn entered(warp: &PlacedWarp<f32>, at: DVec3, radius: f64) -> (DVec3, f64) {
    let position = at.to_array().map(|x| [x as f32]);
    let [x, y, z] = warp.positions(&position).map(|x| f64::from(x[0]));
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
        _ => 1.0 + f64::from(warp.rate) * (warp.radius_at(at) + radius),
    };
    (DVec3::new(x, y, z), stretch)
}

/// Smallest and largest divisor of distances in a ball.
fn stretches(warp: &PlacedWarp<f32>, at: DVec3, radius: f64) -> (f64, f64) {
    let (rate, least) = (f64::from(warp.rate), f64::from(warp.radius));
    let r = warp.radius_at(at);
    (1.0 + rate * (r - radius).max(least), 1.0 + rate * (r + radius).max(least))
}

fn negate(operand: &mut CellOperand, kept: &mut Vec<Token>) {
    (operand.low, operand.high) = (-operand.high, -operand.low);
    kept.push(Token::Complement);
}

/// One operand if the other cannot determine the result, else both under the operator.
fn combined(
    op: Op,
    joint: Joint<f32>,
    is_swapped: bool,
    below: CellOperand,
    top: CellOperand,
    token: Token,
    kept: &mut Vec<Token>,
) -> CellOperand {
    let (a, b) = if is_swapped { (top, below) } else { (below, top) };
    // The contributions as operands of a union, with the signs of the operator.
    let flip = |operand: CellOperand| CellOperand { low: -operand.high, high: -operand.low, ..operand };
    let (first, second) = match op {
        Op::Union | Op::Xor => (a, b),
        Op::Intersection => (flip(a), flip(b)),
        Op::Difference => (flip(a), b),
    };

    // Whether `far` is irrelevant beside `near` in a union.
    let is_beaten = |near: &CellOperand, far: &CellOperand| match joint {
        Joint::Sharp => far.low > near.high,
        Joint::Smooth(k, _) => far.low > near.high + f64::from(k),
        Joint::Chamfer(k) => far.low > near.high.max(f64::from(k) + (std::f64::consts::SQRT_2 - 1.0) * near.high),
    };
    // In an xor the farther operand must exceed the magnitude of the other, inside or outside.
    let size = |operand: &CellOperand| CellOperand { high: operand.low.abs().max(operand.high.abs()), ..*operand };
    let beaten = |near: &CellOperand, far: &CellOperand| match op {
        Op::Xor => is_beaten(&size(near), far),
        _ => is_beaten(near, far),
    };
    // Deep inside one operand, an xor is the complement of the other.
    let drowned = |near: &CellOperand, far: &CellOperand| op == Op::Xor && is_beaten(&size(near), &flip(*far));

    if beaten(&first, &second) || drowned(&first, &second) {
        let is_inverted = drowned(&first, &second);
        let mut remaining = keep(a, b, kept);
        if is_inverted {
            negate(&mut remaining, kept);
        }
        return remaining;
    }
    if beaten(&second, &first) || drowned(&second, &first) {
        let is_inverted = drowned(&second, &first) || op == Op::Difference;
        let mut remaining = keep(b, a, kept);
        if is_inverted {
            negate(&mut remaining, kept);
        }
        return remaining;
    }

    kept.push(token);
    let start = below.start;
    let union = |a: &CellOperand, b: &CellOperand| {
        // The smooth minimum is monotone in both operands.
        let at = |a: f64, b: f64| match joint {
            Joint::Sharp => a.min(b),
            Joint::Smooth(k, quarter) => {
                let h = (f64::from(k) - (a - b).abs()).max(0.0);
                a.min(b) - h * h * f64::from(quarter)
            }
            Joint::Chamfer(k) => a.min(b).min((a + b - f64::from(k)) * 0.5f64.sqrt()),
        };
        CellOperand { low: at(a.low, b.low), high: at(a.high, b.high), start }
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
fn keep(remaining: CellOperand, gone: CellOperand, kept: &mut Vec<Token>) -> CellOperand {
    if gone.start > remaining.start {
        kept.truncate(gone.start);
        remaining
    } else {
        kept.drain(gone.start..remaining.start);
        CellOperand { start: gone.start, ..remaining }
    }
}
