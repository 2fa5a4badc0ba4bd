//! The decomposition of the article: boxes carried from the leaves to the root (A. Palecek, "SDF Decomposition", 2021).
//!
//! Each operand is a list of pieces, a box and what stands in it, whose union is the operand's solid. Then
//!
//! ```text
//! a | b    the pieces of both: the nearest hit is the union
//! a & b    every pair of pieces whose boxes meet, in the common box
//! a - b    where a piece of a meets the box of one of b: their difference in there, the piece in up to 26 boxes around
//! a ^ b    the xor where the boxes of a and b meet, the pieces of both around
//! ```
//!
//! A smooth or chamfered joint needs the fields of both operands and not just their signs: within reach of its width the
//! whole joint is one piece, outside it is as the sharp one. What changes the field (offset, shell, warps) makes one piece of
//! its operand. Splitting less is always right, so where the number of pieces would explode it stops.

use super::bounds::Extent;
use super::decompose::{Part, grouped};
use super::model::{Model, Token};
use super::shape::{Blend, Op};
use glam::DVec3;
use std::sync::Arc;

/// Pieces of one operand at most; past it the pieces stay whole.
const MAX_PIECES: usize = 4096;

/// Pieces of a subtrahend that are cut out one by one; more of them are cut out together.
const MAX_CUTS: usize = 64;

type Bounds = [DVec3; 2];

#[derive(Debug, Clone)]
struct Piece {
    bounds: Bounds,
    tokens: Arc<[Token]>,
}

/// An operand: its pieces, and as a whole.
#[derive(Debug)]
struct Operand {
    pieces: Vec<Piece>,
    tokens: Arc<[Token]>,
    extent: Extent,
}

impl Operand {
    fn whole(tokens: Arc<[Token]>, extent: Extent) -> Self {
        let bounds = [extent.lower, extent.upper];
        let pieces = if is_empty(&bounds) { Vec::new() } else { vec![Piece { bounds, tokens: tokens.clone() }] };
        Self { pieces, tokens, extent }
    }
}

/// The parts of a bounded model.
pub fn parts(model: &Model) -> Vec<Part> {
    let mut stack: Vec<Operand> = Vec::new();
    let mut enters: Vec<Vec<Operand>> = Vec::new();
    for &token in &model.tokens {
        match token {
            Token::Leaf(leaf) => {
                let extent = model.leaves[leaf as usize].extent;
                stack.push(Operand::whole(Arc::new([token]), extent));
            }
            Token::Combine(i) => {
                let combine = model.combines[i as usize];
                let top = stack.pop().expect("two operands");
                let below = stack.pop().expect("two operands");
                let join = Join { token, is_swapped: combine.is_swapped };
                let (a, b) = if combine.is_swapped { (top, below) } else { (below, top) };
                stack.push(combined(combine.op, combine.blend, a, b, &join));
            }
            Token::Enter(_) => enters.push(std::mem::take(&mut stack)),
            Token::Level(_) | Token::Complement | Token::Leave(_) => {
                let operand = stack.pop().expect("one operand");
                if let Token::Leave(_) = token {
                    stack = enters.pop().expect("entered before");
                }
                let tokens = changed(&operand.tokens, token);
                let extent = model.extent_of(&tokens);
                stack.push(Operand::whole(tokens, extent));
            }
        }
    }
    let root = stack.pop().map(|operand| operand.pieces).unwrap_or_default();
    grouped(root.into_iter().filter(|piece| is_finite(&piece.bounds)).map(|piece| (piece.tokens, piece.bounds)))
}

/// Tokens with one more; a warp begins with the token that ends it.
fn changed(tokens: &[Token], token: Token) -> Arc<[Token]> {
    match token {
        Token::Leave(warp) => [&[Token::Enter(warp)], tokens, &[token]].concat().into(),
        _ => [tokens, &[token]].concat().into(),
    }
}

/// Puts two lists of tokens under one operator, in the order that it wants.
struct Join {
    token: Token,
    is_swapped: bool,
}

impl Join {
    fn tokens(&self, a: &[Token], b: &[Token]) -> Arc<[Token]> {
        let (first, second) = if self.is_swapped { (b, a) } else { (a, b) };
        [first, second, &[self.token]].concat().into()
    }
}

fn combined(op: Op, blend: Blend, a: Operand, b: Operand, join: &Join) -> Operand {
    let tokens = join.tokens(&a.tokens, &b.tokens);
    let extent = Extent::combined(op, blend, a.extent, b.extent);
    let width = blend.width();
    // Where the joint is more than its operands.
    let zone = match (op, blend) {
        (Op::Union, Blend::Sharp) => None,
        (Op::Union | Op::Xor, _) => Some(intersection(&bounds_at(&a, width), &bounds_at(&b, width))),
        (Op::Difference, Blend::Sharp) | (Op::Intersection, Blend::Sharp) => None,
        (Op::Difference, _) => Some(intersection(&bounds_at(&a, 0.0), &bounds_at(&b, width))),
        (Op::Intersection, _) => Some(intersection(&bounds_at(&a, 0.0), &bounds_at(&b, 0.0))),
    };
    let pieces = match zone {
        Some(zone) => {
            let mut outside: Vec<Piece> = Vec::new();
            match op {
                Op::Intersection => {}
                Op::Difference => outside.extend(a.pieces),
                _ => outside.extend(a.pieces.into_iter().chain(b.pieces)),
            }
            if is_empty(&zone) {
                outside
            } else {
                let mut pieces: Vec<Piece> = outside.iter().flat_map(|piece| around(piece, &zone)).collect();
                pieces.push(Piece { bounds: zone, tokens: tokens.clone() });
                pieces
            }
        }
        None => match op {
            Op::Intersection => pairs(&a, &b, join),
            Op::Difference => differences(a.pieces, &b, join),
            _ => a.pieces.into_iter().chain(b.pieces).collect(),
        },
    };
    if pieces.len() > MAX_PIECES && op != Op::Union {
        return Operand::whole(tokens, extent);
    }
    Operand { pieces, tokens, extent }
}

fn bounds_at(operand: &Operand, level: f64) -> Bounds {
    let grown = operand.extent.level(level);
    [grown.lower, grown.upper]
}

fn pairs(a: &Operand, b: &Operand, join: &Join) -> Vec<Piece> {
    if a.pieces.len() * b.pieces.len() > MAX_PIECES {
        let bounds = intersection(&bounds_at(a, 0.0), &bounds_at(b, 0.0));
        let tokens = join.tokens(&a.tokens, &b.tokens);
        return if is_empty(&bounds) { Vec::new() } else { vec![Piece { bounds, tokens }] };
    }
    let mut pieces = Vec::new();
    for first in &a.pieces {
        for second in &b.pieces {
            let bounds = intersection(&first.bounds, &second.bounds);
            if !is_empty(&bounds) {
                pieces.push(Piece { bounds, tokens: join.tokens(&first.tokens, &second.tokens) });
            }
        }
    }
    pieces
}

fn differences(mut pieces: Vec<Piece>, b: &Operand, join: &Join) -> Vec<Piece> {
    let together = Piece { bounds: bounds_at(b, 0.0), tokens: b.tokens.clone() };
    let cuts = if b.pieces.len() > MAX_CUTS { std::slice::from_ref(&together) } else { &b.pieces };
    for cut in cuts {
        let mut left = Vec::new();
        for piece in &pieces {
            let common = intersection(&piece.bounds, &cut.bounds);
            if is_empty(&common) {
                left.push(piece.clone());
                continue;
            }
            let tokens = join.tokens(&piece.tokens, &cut.tokens);
            if left.len() + pieces.len() > MAX_PIECES {
                left.push(Piece { bounds: piece.bounds, tokens });
            } else {
                left.push(Piece { bounds: common, tokens });
                left.extend(around(piece, &common));
            }
        }
        pieces = left;
    }
    pieces
}

/// The boxes of a grid through the faces of `hole`, without that one.
fn around(piece: &Piece, hole: &Bounds) -> Vec<Piece> {
    let [lower, upper] = piece.bounds;
    let hole = intersection(&piece.bounds, hole);
    if is_empty(&hole) {
        return vec![piece.clone()];
    }
    let cuts = |axis: usize| [lower[axis], hole[0][axis], hole[1][axis], upper[axis]];
    let [x, y, z] = [cuts(0), cuts(1), cuts(2)];
    let mut pieces = Vec::new();
    for k in 0..3 {
        for j in 0..3 {
            for i in 0..3 {
                let bounds = [DVec3::new(x[i], y[j], z[k]), DVec3::new(x[i + 1], y[j + 1], z[k + 1])];
                if (i, j, k) != (1, 1, 1) && !is_empty(&bounds) {
                    pieces.push(Piece { bounds, tokens: piece.tokens.clone() });
                }
            }
        }
    }
    pieces
}

fn intersection(a: &Bounds, b: &Bounds) -> Bounds {
    [a[0].max(b[0]), a[1].min(b[1])]
}

/// Without volume.
fn is_empty(bounds: &Bounds) -> bool {
    !bounds[0].cmplt(bounds[1]).all()
}

fn is_finite(bounds: &Bounds) -> bool {
    bounds[0].is_finite() && bounds[1].is_finite()
}
