//! The decomposition of the article: boxes carried from the leaves to the root (A. Palecek, "SDF Decomposition", 2021).
//!
//! # Theory
//!
//! Each operand is a list of pieces, where a piece is a box and a tree of tokens. The operand's solid is the union of
//! the pieces' solids, each cut to its box. Operators act on the pieces:
//!
//! ```text
//! a | b    the pieces of both: the nearest hit is the hit of the union
//! a & b    every pair of pieces whose boxes intersect, in the common box
//! a - b    a piece of a that intersects the box of a piece of b: their difference in the common box, and the piece of
//!          a in up to 26 boxes around it
//! a ^ b    the xor where the boxes of a and b intersect; elsewhere the pieces of both
//! ```
//!
//! A ray that enters a box at `t` may already be inside the piece's tree. That is a hit only if the solid's surface is
//! there as well, and then its normal and colour follow from the piece's tree only if that tree holds the surface. Both
//! would fail where a face of a subtrahend lies in the common face of two boxes: the box beyond the face has a tree
//! without the subtrahend. The following invariant excludes this. Let `S` be the operand's solid, `T` the solid of a
//! piece's tree, `B` its box, and `B + m` the box grown by the operand's *margin* `m > 0` on every side. Then
//!
//! ```text
//! (1)  S is the union of all T & B           (2)  T & (B + m) is a subset of S
//! ```
//!
//! *Consequence.* Let `t` be the first hit of a ray over all pieces and `p` its point, in a box `B` with tree `T`. By
//! (1) the ray is outside `S` before `t` and inside right after it. If it were inside `T` right before `t`, it would be
//! inside `S` there by (2), because that point is in `B + m`. So the ray enters `T` at `p`: a leaf of `T` has its
//! surface there. Near `p`, `T` is a subset of `S` by (2), both have `p` on their surface, and so they have the same
//! tangent plane wherever `S` has one. The tree of the piece that is hit is therefore right for depth, normal and
//! colour.
//!
//! *Proof of the invariant.* A leaf, or any operand taken as one piece, has `T = S` and an unlimited margin. A union
//! keeps the smaller margin, as does an intersection. For `a - b` the box of each piece of `b` is first grown by `g`.
//! In the common box `T_a - T_b` removes a superset of the piece of `b`; by (2) for `b`, within `b.margin` of the
//! ungrown box it removes points of `b` only, so the margin there is `b.margin - g`. A box around the common box is at
//! least `g` away from the piece of `b`, so within `g` of it `T_a` does not intersect that piece. The result has the
//! margin `min(a.margin, g, b.margin - g)`, and `g` is half of `b.margin`, at most [`MARGIN`]. A piece whose tree does
//! not intersect the box of the subtrahend stays. Where the joint of two operands is one piece in a zone, the zone is
//! grown by [`MARGIN`] for the same reason.
//!
//! # Practice
//!
//! A smooth or chamfered joint needs the fields of both operands and not just their signs. Within reach of its width
//! the whole joint is one piece; outside it equals the sharp joint. Operations that change the field (offset, shell,
//! warps) make one piece of their operand. Fewer pieces are always valid, so splitting stops where their number would
//! explode.

use super::part::{Part, grouped};
use crate::csg::model::bounds::Extent;
use crate::csg::model::lowered::Model;
use crate::csg::model::operand_stack::OperandStack;
use crate::csg::model::token::Token;
use crate::csg::tree::kind::{Blend, Op};
use glam::DVec3;
use std::sync::Arc;

/// Largest number of pieces of an operand; beyond it the pieces stay whole.
const MAX_PIECES: usize = 4096;

/// Largest number of pieces of a subtrahend that are removed one by one; more of them are removed together.
const MAX_CUTS: usize = 64;

/// Largest growth of a subtrahend's box, relative to the longest side of the model.
const MARGIN: f64 = 1e-3;

/// Smallest margin, relative to the longest side of the model: ten times the erosion of hits and the rounding of boxes.
/// A subtrahend that would leave less (after seven nested differences) is removed as one piece.
const MIN_MARGIN: f64 = 1e-5;

type Bounds = [DVec3; 2];

#[derive(Debug, Clone)]
struct Piece {
    bounds: Bounds,
    tokens: Arc<[Token]>,
}

/// An operand: its pieces, and its tokens and extent as one piece.
#[derive(Debug)]
struct Operand {
    pieces: Vec<Piece>,
    /// Distance beyond its box within which each tree is valid, world units.
    margin: f64,
    tokens: Arc<[Token]>,
    extent: Extent,
}

impl Operand {
    fn whole(tokens: Arc<[Token]>, extent: Extent) -> Self {
        let bounds = [extent.lower, extent.upper];
        let pieces = if is_empty(&bounds) { Vec::new() } else { vec![Piece { bounds, tokens: tokens.clone() }] };
        Self { pieces, margin: f64::INFINITY, tokens, extent }
    }
}

/// The parts of a bounded model.
pub(crate) fn parts(model: &Model) -> Vec<Part> {
    let size = (model.extent.upper - model.extent.lower).max_element();
    let mut stack: OperandStack<Operand> = OperandStack::default();
    // The stacks outside the open warps.
    let mut outer: OperandStack<OperandStack<Operand>> = OperandStack::default();
    for &token in &model.tokens {
        match token {
            Token::Leaf(leaf) => {
                let extent = model.leaves[leaf as usize].extent;
                stack.push(Operand::whole(Arc::new([token]), extent));
            }
            Token::Combine(i) => {
                let combine = model.combines[i as usize];
                let (top, below) = (stack.pop(), stack.pop());
                let join = Join { model, size, token, is_swapped: combine.is_swapped };
                let (a, b) = if combine.is_swapped { (top, below) } else { (below, top) };
                stack.push(combined(combine.op, combine.blend, a, b, &join));
            }
            Token::Enter(_) => outer.push(std::mem::take(&mut stack)),
            Token::DistanceOp(_) | Token::Complement | Token::Leave(_) => {
                let operand = stack.pop();
                if let Token::Leave(_) = token {
                    stack = outer.pop();
                }
                let tokens = changed(&operand.tokens, token);
                let extent = model.extent_of(&tokens);
                stack.push(Operand::whole(tokens, extent));
            }
        }
    }
    let root = stack.finish().map(|operand| operand.pieces).unwrap_or_default();
    grouped(root.into_iter().filter(|piece| is_finite(&piece.bounds)).map(|piece| (piece.tokens, piece.bounds)))
}

/// Appends a token to a list. For the end of a warp, the token that begins the warp is put in front.
fn changed(tokens: &[Token], token: Token) -> Arc<[Token]> {
    match token {
        Token::Leave(warp) => [&[Token::Enter(warp)], tokens, &[token]].concat().into(),
        _ => [tokens, &[token]].concat().into(),
    }
}

/// Joins two lists of tokens under one operator, in the order of its operands.
struct Join<'a> {
    model: &'a Model,
    /// Longest side of the model, world units.
    size: f64,
    token: Token,
    is_swapped: bool,
}

impl Join<'_> {
    fn tokens(&self, a: &[Token], b: &[Token]) -> Arc<[Token]> {
        let (first, second) = if self.is_swapped { (b, a) } else { (a, b) };
        [first, second, &[self.token]].concat().into()
    }
}

fn combined(op: Op, blend: Blend, a: Operand, b: Operand, join: &Join<'_>) -> Operand {
    let tokens = join.tokens(&a.tokens, &b.tokens);
    let extent = Extent::combined(op, blend, a.extent, b.extent);
    let width = blend.width();
    // Boxes in which the joint may differ from its operands.
    let zone = match (op, blend) {
        (Op::Union, Blend::Sharp) => None,
        (Op::Union | Op::Xor, _) => Some(intersection(&bounds_at(&a, width), &bounds_at(&b, width))),
        (Op::Difference, Blend::Sharp) | (Op::Intersection, Blend::Sharp) => None,
        (Op::Difference, _) => Some(intersection(&bounds_at(&a, 0.0), &bounds_at(&b, width))),
        (Op::Intersection, _) => Some(intersection(&bounds_at(&a, 0.0), &bounds_at(&b, 0.0))),
    };
    let mut margin = a.margin.min(b.margin);
    let pieces = match zone {
        Some(zone) => {
            let room = MARGIN * join.size;
            margin = margin.min(room);
            let mut outside: Vec<Piece> = Vec::new();
            match op {
                Op::Intersection => {}
                Op::Difference => outside.extend(a.pieces),
                _ => outside.extend(a.pieces.into_iter().chain(b.pieces)),
            }
            if is_empty(&zone) {
                outside
            } else {
                let zone = grown(&zone, room);
                let mut pieces: Vec<Piece> = outside.iter().flat_map(|piece| around(piece, &zone)).collect();
                pieces.push(Piece { bounds: zone, tokens: tokens.clone() });
                pieces
            }
        }
        None => match op {
            Op::Intersection => pairs(&a, &b, join),
            Op::Difference => {
                let (pieces, kept) = differences(a.pieces, &b, join);
                margin = a.margin.min(kept);
                pieces
            }
            _ => a.pieces.into_iter().chain(b.pieces).collect(),
        },
    };
    if pieces.len() > MAX_PIECES && op != Op::Union {
        return Operand::whole(tokens, extent);
    }
    Operand { pieces, margin, tokens, extent }
}

fn bounds_at(operand: &Operand, level: f64) -> Bounds {
    let grown = operand.extent.level(level);
    [grown.lower, grown.upper]
}

fn pairs(a: &Operand, b: &Operand, join: &Join<'_>) -> Vec<Piece> {
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

/// The pieces without the solid of `b`, and the remaining margin of `b`.
fn differences(mut pieces: Vec<Piece>, b: &Operand, join: &Join<'_>) -> (Vec<Piece>, f64) {
    let together = Piece { bounds: bounds_at(b, 0.0), tokens: b.tokens.clone() };
    let is_one = b.pieces.len() > MAX_CUTS || b.margin < 2.0 * MIN_MARGIN * join.size;
    let (cuts, margin) =
        if is_one { (std::slice::from_ref(&together), f64::INFINITY) } else { (&b.pieces[..], b.margin) };
    let growth = (0.5 * margin).min(MARGIN * join.size);
    for cut in cuts {
        let zone = grown(&cut.bounds, growth);
        let mut remaining = Vec::new();
        for piece in &pieces {
            let common = intersection(&piece.bounds, &zone);
            let is_apart = || {
                let filled = join.model.extent_of(&piece.tokens);
                is_empty(&intersection(&[filled.lower, filled.upper], &cut.bounds))
            };
            if is_empty(&common) || is_apart() {
                remaining.push(piece.clone());
            } else if remaining.len() + pieces.len() > MAX_PIECES {
                // The tree of the cut is valid only near its own box, the tree of `b` everywhere.
                remaining.push(Piece { bounds: piece.bounds, tokens: join.tokens(&piece.tokens, &b.tokens) });
            } else {
                remaining.push(Piece { bounds: common, tokens: join.tokens(&piece.tokens, &cut.tokens) });
                remaining.extend(around(piece, &common));
            }
        }
        pieces = remaining;
    }
    (pieces, growth.min(margin - growth))
}

/// A box moved outwards on every side.
fn grown(bounds: &Bounds, by: f64) -> Bounds {
    [bounds[0] - by, bounds[1] + by]
}

/// The up to 26 boxes that the faces of `hole` cut from a piece, without the hole itself.
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

/// Whether a box has no volume.
fn is_empty(bounds: &Bounds) -> bool {
    !bounds[0].cmplt(bounds[1]).all()
}

fn is_finite(bounds: &Bounds) -> bool {
    bounds[0].is_finite() && bounds[1].is_finite()
}
