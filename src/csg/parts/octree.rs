//! Decomposition by an octree with the relevant leaves per cell: Lipschitz pruning (W. Barbier et al., "Lipschitz
//! Pruning: Hierarchical Simplification of Primitive-Based SDFs", Eurographics 2025).
//!
//! The operands that cannot determine the result in a cell are dropped ([`super::pruning`]), and a cell in which the
//! whole field keeps its sign contains no surface. The remaining tokens are passed to the children. A leaf is evaluated
//! only in cells near it: at the centres of all children of a cell at once, in the lanes of vector instructions.
//! Sibling cells with equal tokens are merged again.
//!
//! A cell is divided until few leaves are left in it. For a sphere-traced part these are one or two leaves in a small
//! cell: its box should fit the surface tightly, because every step is expensive. Where hits have a closed form
//! ([`super::chord`]), a few leaves in a large cell are cheaper than many boxes.

use super::chord::PartKind;
use super::part::{Part, grouped};
use super::pruning::{BALLS, Ball, PAD, Pruning, PruningScratch};
use super::solid::Solid;
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
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
/// Enlargement of the root beyond the bounds, relative to the model, so that no surface lies in the root's faces.
const ROOT_PAD: f64 = 1e-3;

/// Number of lattice positions of faces along an axis.
const LATTICE: u32 = 1 << MAX_DEPTH;

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
    pruning: Pruning,
}

/// The parts of a bounded solid.
pub(crate) fn parts(solid: &Solid) -> Vec<Part> {
    let extent = &solid.model.extent;
    let pad = DVec3::splat(ROOT_PAD * (extent.upper - extent.lower).max_element());
    let (lower, upper) = (extent.lower - pad, extent.upper + pad);
    let tree = Octree { solid, lower, extent: upper - lower, pruning: Pruning::new(solid) };
    let root = OctreeCell { low: UVec3::ZERO, high: UVec3::splat(LATTICE) };
    let mut cells = Vec::new();
    let mut scratch = PruningScratch::default();
    let (middle, radius) = (tree.middle(root), tree.radius(root));
    scratch.evaluate(solid, &solid.model.tokens, &[middle]);
    if tree.pruning.prune_at(solid, &solid.model.tokens, Ball { middle, radius }, 0, &mut scratch) {
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
        scratch: &mut PruningScratch,
        out: &mut Vec<OctreeLeaf>,
    ) {
        if self.is_done(tokens, depth) {
            out.push((cell, tokens.into()));
            return;
        }
        let children = self.children(cell);
        let middles: Vec<DVec3> = children.iter().map(|&child| self.middle(child)).collect();
        scratch.evaluate(self.solid, tokens, &middles);
        let mut kept: [Option<Vec<Token>>; BALLS] = Default::default();
        for (i, &child) in children.iter().enumerate() {
            let ball = Ball { middle: middles[i], radius: self.radius(child) };
            if self.pruning.prune_at(self.solid, tokens, ball, i, scratch) {
                kept[i] = Some(scratch.kept.as_slice().into());
            }
        }

        let first = out.len();
        let inner = children.into_iter().zip(kept).filter_map(|(child, kept)| Some((child, kept?)));
        if tokens.len() > TASK_TOKENS {
            let inner: Vec<(OctreeCell, Vec<Token>)> = inner.collect();
            let found: Vec<Vec<OctreeLeaf>> = inner
                .par_iter()
                .map_init(PruningScratch::default, |scratch, (child, kept)| {
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
        let mut children = Vec::with_capacity(BALLS);
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
    let is_one = others.len() < BALLS
        && others.iter().all(|(_, other)| other == tokens)
        && out[first..].iter().map(|(cell, _)| cell.volume()).sum::<u64>() == cell.volume();
    if is_one {
        let tokens = tokens.clone();
        out.truncate(first);
        out.push((cell, tokens));
    }
}
