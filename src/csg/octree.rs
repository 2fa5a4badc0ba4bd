//! Cells, and in each the leaves that can matter there: Lipschitz pruning (W. Barbier et al., "Lipschitz Pruning: Hierarchical
//! Simplification of Primitive-Based SDFs", Eurographics 2025).
//!
//! A field of Lipschitz constant `L` stays within `L R` of its value at the middle of a cell whose corners are `R` away. So one
//! evaluation at the middle bounds every node of the tree over the whole cell. An operand that cannot win anywhere is dropped
//! (for two distances and a joint of width `k`: unless `|a - b| <= 2 R + k`), and a cell whose whole field keeps its sign holds
//! no surface. What is left goes to the children, so a leaf is looked at in cells that it is near to. Cells that are all there
//! and hold the same tokens are merged again.

use super::decompose::{Part, grouped};
use super::model::Token;
use super::program::{Joint, PlacedLevel, PlacedWarp, PlacedWarpKind, Stack};
use super::shape::Op;
use super::solid::Solid;
use glam::{DVec3, UVec3};
use rayon::prelude::*;
use std::sync::Arc;

/// Cells are cut so often whatever they hold, so that boxes hug the surface.
const MIN_DEPTH: u32 = 4;
/// And no further.
const MAX_DEPTH: u32 = 7;
/// A cell of that depth with so few leaves is cut no further; a level deeper, twice as many will do: eight boxes for one have
/// to save more than they cost.
const FEW_LEAVES: usize = 2;
/// Cells with more tokens than this are worth a task of their own.
const TASK_TOKENS: usize = 16;
/// Added to the radius of a cell, relative to the model: normals are taken this close to the faces, and float32 rounds.
const PAD: f64 = 1e-4;
/// The root is larger than the bounds by this, so that no surface lies in its faces.
const ROOT_PAD: f64 = 1e-3;

/// Places of faces along an axis, from 0 to this.
const LATTICE: u32 = 1 << MAX_DEPTH;

/// A box of the lattice over the root.
#[derive(Debug, Clone, Copy)]
struct Cell {
    low: UVec3,
    high: UVec3,
}

/// What the pruning of a cell left.
enum Found {
    Nothing,
    Cells(Vec<(Cell, Arc<[Token]>)>),
}

struct Tree<'a> {
    solid: &'a Solid,
    lower: DVec3,
    extent: DVec3,
}

/// The parts of a bounded solid.
pub fn parts(solid: &Solid) -> Vec<Part> {
    let extent = &solid.model.extent;
    let pad = DVec3::splat(ROOT_PAD * (extent.upper - extent.lower).max_element());
    let (lower, upper) = (extent.lower - pad, extent.upper + pad);
    let tree = Tree { solid, lower, extent: upper - lower };
    let root = Cell { low: UVec3::ZERO, high: UVec3::splat(LATTICE) };
    let Found::Cells(cells) = tree.visit(root, &solid.model.tokens, 0) else { return Vec::new() };
    grouped(cells.into_iter().map(|(cell, tokens)| (tokens, [tree.corner(cell.low), tree.corner(cell.high)])))
}

impl Tree<'_> {
    /// The same lattice point is the same number, whichever cell asks.
    fn corner(&self, at: UVec3) -> DVec3 {
        self.lower + self.extent * (at.as_dvec3() / f64::from(LATTICE))
    }

    fn visit(&self, cell: Cell, tokens: &[Token], depth: u32) -> Found {
        let (low, high) = (self.corner(cell.low), self.corner(cell.high));
        let frame = self.solid.frame;
        let middle = frame.local(0.5 * (low + high));
        let radius = 0.5 * (high - low).length() / frame.scale + PAD;
        let Some(kept) = prune(self.solid, tokens, middle, radius) else { return Found::Nothing };
        let leaves = kept.iter().filter(|token| matches!(token, Token::Leaf(_))).count();
        if depth == MAX_DEPTH || (depth >= MIN_DEPTH && leaves <= FEW_LEAVES << (depth - MIN_DEPTH)) {
            return Found::Cells(vec![(cell, kept.into())]);
        }

        let children = self.children(cell);
        let look = |&child: &Cell| self.visit(child, &kept, depth + 1);
        let found: Vec<Found> = if kept.len() > TASK_TOKENS {
            children.par_iter().map(look).collect()
        } else {
            children.iter().map(look).collect()
        };
        merged(cell, found)
    }

    /// Halves of the long sides; a flat cell is not made flatter.
    fn children(&self, cell: Cell) -> Vec<Cell> {
        let sides = self.corner(cell.high) - self.corner(cell.low);
        let longest = sides.max_element();
        let halves = |axis: usize| {
            let (low, high) = (cell.low[axis], cell.high[axis]);
            let middle = (low + high) / 2;
            if sides[axis] > 0.6 * longest && middle > low {
                vec![(low, middle), (middle, high)]
            } else {
                vec![(low, high)]
            }
        };
        let [along_x, along_y, along_z] = [halves(0), halves(1), halves(2)];
        let mut children = Vec::with_capacity(8);
        for &(z0, z1) in &along_z {
            for &(y0, y1) in &along_y {
                for &(x0, x1) in &along_x {
                    children.push(Cell { low: UVec3::new(x0, y0, z0), high: UVec3::new(x1, y1, z1) });
                }
            }
        }
        children
    }
}

/// The cells of the children, or the parent where they are all whole and equal.
fn merged(cell: Cell, found: Vec<Found>) -> Found {
    let mut cells = Vec::new();
    let count = found.len();
    for child in found {
        match child {
            Found::Nothing => {}
            Found::Cells(inner) => cells.extend(inner),
        }
    }
    let volume = |cell: &Cell| (cell.high - cell.low).as_u64vec3().element_product();
    let is_one = cells.len() == count
        && cells.iter().all(|(_, tokens)| tokens == &cells[0].1)
        && cells.iter().map(|(cell, _)| volume(cell)).sum::<u64>() == volume(&cell);
    match cells.first() {
        None => Found::Nothing,
        Some((_, tokens)) if is_one => Found::Cells(vec![(cell, tokens.clone())]),
        Some(_) => Found::Cells(cells),
    }
}

/// Bounds of a node's field over a cell, and where its tokens begin.
#[derive(Debug, Clone, Copy)]
struct Operand {
    low: f64,
    high: f64,
    start: usize,
}

/// The tokens that matter in a ball, local units; `None` if the field keeps its sign there.
fn prune(solid: &Solid, tokens: &[Token], middle: DVec3, radius: f64) -> Option<Vec<Token>> {
    let program = &solid.program;
    let mut kept: Vec<Token> = Vec::with_capacity(tokens.len());
    let mut stack: Vec<Operand> = Vec::with_capacity(16);
    // The middle and the radius, in the space of each warp that is open.
    let mut balls = vec![(middle, radius)];
    let mut one: Stack<f32, 1> = Stack::default();
    for &token in tokens {
        let (at, radius) = *balls.last().expect("there is always a ball");
        match token {
            Token::Leaf(leaf) => {
                let position = at.to_array().map(|x| [x as f32]);
                let distance = f64::from(program.run(&[token], &position, &mut one)[0]);
                let reach = radius * solid.model.leaves[leaf as usize].primitive.lipschitz();
                stack.push(Operand { low: distance - reach, high: distance + reach, start: kept.len() });
                kept.push(token);
            }
            Token::Combine(i) => {
                let top = stack.pop().expect("two operands");
                let below = stack.pop().expect("two operands");
                let combine = &program.combines[i as usize];
                stack.push(combined(combine.op, combine.joint, combine.is_swapped, below, top, token, &mut kept));
            }
            Token::Level(i) => {
                let operand = stack.last_mut().expect("one operand");
                match program.levels[i as usize] {
                    PlacedLevel::Offset(distance) => {
                        operand.low -= f64::from(distance);
                        operand.high -= f64::from(distance);
                    }
                    PlacedLevel::Shell(half) => {
                        let (low, high) = (operand.low, operand.high);
                        let nearest = if low <= 0.0 && high >= 0.0 { 0.0 } else { low.abs().min(high.abs()) };
                        operand.low = nearest - f64::from(half);
                        operand.high = low.abs().max(high.abs()) - f64::from(half);
                    }
                }
                kept.push(token);
            }
            Token::Complement => negate(stack.last_mut().expect("one operand"), &mut kept),
            Token::Enter(i) => {
                let warp = &program.warps[i as usize];
                let (inside, farthest) = entered(warp, at, radius);
                balls.push((inside, radius * farthest));
                kept.push(token);
            }
            Token::Leave(i) => {
                balls.pop();
                let (at, radius) = *balls.last().expect("there is always a ball");
                let operand = stack.last_mut().expect("one operand");
                let (least, most) = stretches(&program.warps[i as usize], at, radius);
                operand.low /= if operand.low > 0.0 { most } else { least };
                operand.high /= if operand.high > 0.0 { least } else { most };
                // The `Enter` before it belongs to it.
                operand.start -= 1;
                kept.push(token);
            }
        }
    }
    let whole = stack.pop()?;
    (whole.low <= 0.0 && whole.high >= 0.0).then_some(kept)
}

/// The ball in the space of a warp, and by how much the warp stretches it.
fn entered(warp: &PlacedWarp<f32>, at: DVec3, radius: f64) -> (DVec3, f64) {
    let position = at.to_array().map(|x| [x as f32]);
    let [x, y, z] = warp.positions(&position).map(|x| f64::from(x[0]));
    let stretch = match warp.kind {
        PlacedWarpKind::Elongate(_) => 1.0,
        // The real one over the ball, which may be less or more than the one that distances are divided by.
        _ => 1.0 + f64::from(warp.rate) * (warp.radius_at(at) + radius),
    };
    (DVec3::new(x, y, z), stretch)
}

/// The least and the most that distances are divided by in a ball.
fn stretches(warp: &PlacedWarp<f32>, at: DVec3, radius: f64) -> (f64, f64) {
    let (rate, least) = (f64::from(warp.rate), f64::from(warp.radius));
    let r = warp.radius_at(at);
    (1.0 + rate * (r - radius).max(least), 1.0 + rate * (r + radius).max(least))
}

fn negate(operand: &mut Operand, kept: &mut Vec<Token>) {
    (operand.low, operand.high) = (-operand.high, -operand.low);
    kept.push(Token::Complement);
}

/// One operand where the other cannot win, else both under the operator.
fn combined(
    op: Op,
    joint: Joint<f32>,
    is_swapped: bool,
    below: Operand,
    top: Operand,
    token: Token,
    kept: &mut Vec<Token>,
) -> Operand {
    let (a, b) = if is_swapped { (top, below) } else { (below, top) };
    // As a union: what each contributes, with the signs turned as the operator turns them.
    let flip = |operand: Operand| Operand { low: -operand.high, high: -operand.low, ..operand };
    let (first, second) = match op {
        Op::Union | Op::Xor => (a, b),
        Op::Intersection => (flip(a), flip(b)),
        Op::Difference => (flip(a), b),
    };

    // Whether `far` never matters beside `near`, in a union.
    let is_beaten = |near: &Operand, far: &Operand| match joint {
        Joint::Sharp => far.low > near.high,
        Joint::Smooth(k, _) => far.low > near.high + f64::from(k),
        Joint::Chamfer(k) => far.low > near.high.max(f64::from(k) + (std::f64::consts::SQRT_2 - 1.0) * near.high),
    };
    // In an xor the far one must be so far that it beats the other's size, inside or outside.
    let size = |operand: &Operand| Operand { high: operand.low.abs().max(operand.high.abs()), ..*operand };
    let beaten = |near: &Operand, far: &Operand| match op {
        Op::Xor => is_beaten(&size(near), far),
        _ => is_beaten(near, far),
    };
    // Deep inside one operand, an xor is what is outside the other.
    let drowned = |near: &Operand, far: &Operand| op == Op::Xor && is_beaten(&size(near), &flip(*far));

    if beaten(&first, &second) || drowned(&first, &second) {
        let is_inverted = drowned(&first, &second);
        let mut left = keep(a, b, kept);
        if is_inverted {
            negate(&mut left, kept);
        }
        return left;
    }
    if beaten(&second, &first) || drowned(&second, &first) {
        let is_inverted = drowned(&second, &first) || op == Op::Difference;
        let mut left = keep(b, a, kept);
        if is_inverted {
            negate(&mut left, kept);
        }
        return left;
    }

    kept.push(token);
    let start = below.start;
    let union = |a: &Operand, b: &Operand| {
        // The smooth minimum rises with both operands.
        let at = |a: f64, b: f64| match joint {
            Joint::Sharp => a.min(b),
            Joint::Smooth(k, quarter) => {
                let h = (f64::from(k) - (a - b).abs()).max(0.0);
                a.min(b) - h * h * f64::from(quarter)
            }
            Joint::Chamfer(k) => a.min(b).min((a + b - f64::from(k)) * 0.5f64.sqrt()),
        };
        Operand { low: at(a.low, b.low), high: at(a.high, b.high), start }
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

/// Drop the tokens of `gone`, which stand right before or right after those of `left`.
fn keep(left: Operand, gone: Operand, kept: &mut Vec<Token>) -> Operand {
    if gone.start > left.start {
        kept.truncate(gone.start);
        left
    } else {
        kept.drain(gone.start..left.start);
        Operand { start: gone.start, ..left }
    }
}
