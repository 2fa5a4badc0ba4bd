//! Evaluation of a model on the CPU: a list of tokens at many points at a time.
//!
//! A [`Program`] holds the tables of a model in local units, in float32 or float64. [`Program::run`] takes a list of
//! tokens and `N` points and processes the list once; each leaf is a plain loop over the lanes, which the compiler
//! turns into vector instructions. With 64 lanes the overhead of the list is negligible; one lane serves a ray. The
//! twin in WGSL is `shaders/shared/csg/csg_field.wgsl`.

use super::leaf::{LeafField, PlacedLeaf};
use super::scalar::{Scalar, length2};
use crate::csg::model::lowered::{Coat, DistanceOp, MaskDistance, Model};
use crate::csg::model::operand_stack::OperandStack;
use crate::csg::model::token::Token;
use crate::csg::tree::kind::{Blend, Op};
use crate::csg::tree::placement::WarpKind;
use glam::{DMat3, DVec3};
use std::sync::Arc;

#[derive(Debug, Clone, Copy)]
pub struct PlacedCombine<F> {
    pub op: Op,
    pub is_swapped: bool,
    pub joint: Joint<F>,
}

/// A blend in local units.
#[derive(Debug, Clone, Copy)]
pub enum Joint<F> {
    Sharp,
    /// The width and 1 / (4 width).
    Smooth(F, F),
    Chamfer(F),
}

#[derive(Debug, Clone, Copy)]
pub struct PlacedWarp<F> {
    pub kind: PlacedWarpKind<F>,
    pub rows: [[F; 3]; 3],
    pub shift: [F; 3],
    pub rate: F,
    pub radius: F,
}

#[derive(Debug, Clone, Copy)]
pub enum PlacedWarpKind<F> {
    Elongate([F; 3]),
    Twist(F),
    Bend(F),
    /// See [`crate::csg::tree::placement::Lattice::numbers`].
    NearestCopy([[F; 5]; 3]),
}

/// The tables of a model in local units.
#[derive(Debug, Clone)]
pub struct Program<F> {
    /// `local = (world - center) / scale`.
    pub frame: LocalFrame,
    pub leaves: Vec<PlacedLeaf<F>>,
    pub combines: Vec<PlacedCombine<F>>,
    pub levels: Vec<PlacedDistanceOp<F>>,
    pub warps: Vec<PlacedWarp<F>>,
}

#[derive(Debug, Clone, Copy)]
pub enum PlacedDistanceOp<F> {
    Offset(F),
    /// Half the thickness.
    Shell(F),
    Times(F),
}

/// The map from world units to local units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LocalFrame {
    pub center: DVec3,
    pub scale: f64,
}

impl LocalFrame {
    /// The frame that brings the model to a size near one, with the centre of its box at zero.
    pub fn of(model: &Model) -> Self {
        let extent = &model.extent;
        if extent.unbounded.is_some() || extent.is_empty() {
            // The bounded leaves determine the size; there may be none.
            let sides = model.leaves.iter().filter(|leaf| leaf.extent.unbounded.is_none() && !leaf.is_warped);
            let size = sides.map(|leaf| (leaf.extent.upper - leaf.extent.lower).max_element()).fold(0.0, f64::max);
            return Self { center: DVec3::ZERO, scale: power_of_two(size) };
        }
        let center = 0.5 * (extent.lower + extent.upper);
        Self { center, scale: power_of_two((extent.upper - extent.lower).max_element()) }
    }

    pub fn local(&self, world: DVec3) -> DVec3 {
        (world - self.center) / self.scale
    }

    pub fn world(&self, local: DVec3) -> DVec3 {
        self.center + self.scale * local
    }
}

/// The power of two between `size` and its half; 1 for size zero. Division by it is exact.
fn power_of_two(size: f64) -> f64 {
    if size > 0.0 && size.is_finite() { size.log2().ceil().exp2() } else { 1.0 }
}

/// Buffers of [`Program::run`], kept between calls.
#[derive(Debug, Clone)]
pub struct Stack<F, const N: usize> {
    values: OperandStack<[F; N]>,
    /// The points in the space of each open warp, the world first.
    positions: OperandStack<[[F; N]; 3]>,
}

impl<F: Scalar, const N: usize> Default for Stack<F, N> {
    fn default() -> Self {
        Self { values: OperandStack::with_capacity(16), positions: OperandStack::default() }
    }
}

impl<F: Scalar, const N: usize> Stack<F, N> {
    /// Begins an evaluation at `N` points, local units.
    #[inline(always)]
    pub(crate) fn start(&mut self, at: &[[F; N]; 3]) {
        self.values.clear();
        self.positions.clear();
        self.positions.push(*at);
    }

    /// The last two values, in the order of their evaluation.
    #[inline(always)]
    pub(crate) fn top_two(&self) -> Option<[&[F; N]; 2]> {
        self.values.top_two()
    }
}

impl<F: Scalar> Program<F> {
    pub fn new(model: &Model, frame: LocalFrame) -> Self {
        let s = frame.scale;
        let unit = |x: f64| F::of(x / s);
        let rows = |rotation: DMat3| {
            // The inverse of a rotation is its transpose, whose rows are the columns.
            [rotation.x_axis, rotation.y_axis, rotation.z_axis].map(|axis| axis.to_array().map(F::of))
        };
        let shift = |rotation: DMat3, translation: DVec3, is_warped: bool| {
            let center = if is_warped { DVec3::ZERO } else { frame.center };
            (rotation.transpose() * ((center - translation) / s)).to_array().map(F::of)
        };
        let leaves = model.leaves.iter().map(|leaf| {
            let scale = leaf.place.scale / s;
            PlacedLeaf {
                rows: rows(leaf.place.rotation),
                shift: shift(leaf.place.rotation, leaf.place.translation, leaf.is_warped),
                is_turned: leaf.place.rotation != DMat3::IDENTITY,
                parameters: leaf.primitive.parameters(scale).map(F::of),
                field: LeafField::new(&leaf.primitive, scale),
            }
        });
        let combines = model.combines.iter().map(|combine| PlacedCombine {
            op: combine.op,
            is_swapped: combine.is_swapped,
            joint: match combine.blend {
                Blend::Sharp => Joint::Sharp,
                Blend::Smooth(k) => Joint::Smooth(unit(k), F::of(0.25 * s / k)),
                Blend::Chamfer(k) => Joint::Chamfer(unit(k)),
            },
        });
        let levels = model.levels.iter().map(|level| match *level {
            DistanceOp::Offset(distance) => PlacedDistanceOp::Offset(unit(distance)),
            DistanceOp::Shell(thickness) => PlacedDistanceOp::Shell(unit(0.5 * thickness)),
            DistanceOp::Times(factor) => PlacedDistanceOp::Times(F::of(factor)),
        });
        // A warp may be inside another. The tokens show which warps are outermost, and only those are placed in the
        // world.
        let mut is_inner = vec![false; model.warps.len()];
        let mut depth = 0;
        for token in &model.tokens {
            match token {
                Token::Enter(warp) => {
                    is_inner[*warp as usize] = depth > 0;
                    depth += 1;
                }
                Token::Leave(_) => depth -= 1,
                _ => {}
            }
        }
        let warps = model.warps.iter().zip(is_inner).map(|(warp, is_inner)| PlacedWarp {
            kind: match warp.kind {
                WarpKind::Elongate(half) => PlacedWarpKind::Elongate((half / s).to_array().map(F::of)),
                WarpKind::Twist(rate) => PlacedWarpKind::Twist(F::of(rate * s)),
                WarpKind::Bend(rate) => PlacedWarpKind::Bend(F::of(rate * s)),
                WarpKind::NearestCopy(lattice) => {
                    PlacedWarpKind::NearestCopy(lattice.numbers(1.0 / s).map(|axis| axis.map(F::of)))
                }
            },
            rows: rows(warp.place.rotation),
            shift: shift(warp.place.rotation, warp.place.translation, is_inner),
            rate: F::of((warp.stretch.rate * s).abs()),
            radius: unit(warp.stretch.radius),
        });
        Self {
            frame,
            leaves: leaves.collect(),
            combines: combines.collect(),
            levels: levels.collect(),
            warps: warps.collect(),
        }
    }

    /// The field at `N` points, local units.
    #[inline(always)]
    pub fn run<const N: usize>(&self, tokens: &[Token], at: &[[F; N]; 3], stack: &mut Stack<F, N>) -> [F; N] {
        stack.start(at);
        for &token in tokens {
            self.step(token, stack);
        }
        stack.values.finish().unwrap_or([F::of(f64::from(f32::MAX)); N])
    }

    /// Evaluates one token.
    #[inline(always)]
    pub(crate) fn step<const N: usize>(&self, token: Token, stack: &mut Stack<F, N>) {
        match token {
            Token::Leaf(leaf) => {
                let distance = self.leaves[leaf as usize].distances(stack.positions.top());
                stack.values.push(distance);
            }
            Token::Combine(i) => {
                let combine = &self.combines[i as usize];
                let top = stack.values.pop();
                let below = stack.values.top_mut();
                let (a, b) = if combine.is_swapped { (top, *below) } else { (*below, top) };
                *below = combine.apply(&a, &b);
            }
            Token::DistanceOp(i) => {
                let values = stack.values.top_mut();
                match self.levels[i as usize] {
                    PlacedDistanceOp::Offset(distance) => values.iter_mut().for_each(|d| *d = *d - distance),
                    PlacedDistanceOp::Shell(half) => values.iter_mut().for_each(|d| *d = d.abs() - half),
                    PlacedDistanceOp::Times(factor) => values.iter_mut().for_each(|d| *d = *d * factor),
                }
            }
            Token::Complement => stack.values.top_mut().iter_mut().for_each(|d| *d = -*d),
            Token::Enter(i) => {
                let warped = self.warps[i as usize].positions(stack.positions.top());
                stack.positions.push(warped);
            }
            Token::Leave(i) => {
                stack.positions.pop();
                self.warps[i as usize].unstretch(stack.positions.top(), stack.values.top_mut());
            }
        }
    }

    /// Distance, and colour if there is paint, at a point in local units.
    pub fn color(&self, model: &Model, tokens: &[Token], at: [F; 3]) -> Option<[f32; 3]> {
        let mut stack: Stack<F, 1> = Stack::default();
        stack.positions.push(at.map(|x| [x]));
        let mut colors: Vec<Option<[f32; 3]>> = Vec::new();
        for &token in tokens {
            let operands = stack.top_two().map(|values| values.map(|d| d[0]));
            match (token, operands) {
                (Token::Leaf(i), _) => {
                    let leaf = &model.leaves[i as usize];
                    let [x, y, z] = stack.positions.top().map(|x| x[0].widen());
                    let local = DVec3::new(x, y, z);
                    let p = if leaf.is_warped { self.frame.scale * local } else { self.frame.world(local) };
                    colors.push(Coat::color(leaf.paint.as_deref(), p, mask_distance));
                }
                (Token::Combine(i), Some([below, top])) => {
                    let combine = &self.combines[i as usize];
                    let (top_color, below_color) = (colors.pop().flatten(), colors.pop().flatten());
                    let ((a, a_color), (b, b_color)) = if combine.is_swapped {
                        ((top, top_color), (below, below_color))
                    } else {
                        ((below, below_color), (top, top_color))
                    };
                    colors.push(combine.color(a, a_color, b, b_color));
                }
                _ => {}
            }
            self.step(token, &mut stack);
        }
        colors.pop().flatten()
    }
}

impl<F: Scalar> PlacedCombine<F> {
    #[inline(always)]
    fn apply<const N: usize>(&self, a: &[F; N], b: &[F; N]) -> [F; N] {
        let mut out = [F::default(); N];
        let join = &self.joint;
        match self.op {
            Op::Union => {
                for i in 0..N {
                    out[i] = join.union(a[i], b[i]);
                }
            }
            Op::Intersection => {
                for i in 0..N {
                    out[i] = -join.union(-a[i], -b[i]);
                }
            }
            Op::Difference => {
                for i in 0..N {
                    out[i] = -join.union(-a[i], b[i]);
                }
            }
            // The xor is the union minus the intersection.
            Op::Xor => {
                for i in 0..N {
                    let (either, both) = (join.union(a[i], b[i]), -join.union(-a[i], -b[i]));
                    out[i] = -join.union(-either, both);
                }
            }
        }
        out
    }

    /// The colour of the operand that has the surface here, blended on a fillet. An unpainted operand takes the colour
    /// of the other.
    fn color(&self, a: F, a_color: Option<[f32; 3]>, b: F, b_color: Option<[f32; 3]>) -> Option<[f32; 3]> {
        let (a, b) = match self.op {
            Op::Union => (a, b),
            Op::Intersection => (-a, -b),
            Op::Difference => (-a, b),
            // The surface belongs to either operand: the one whose zero is nearer.
            Op::Xor => (a.abs(), b.abs()),
        };
        let (Some(first), Some(second)) = (a_color, b_color) else { return a_color.or(b_color) };
        let (near, far) = if a <= b { (first, second) } else { (second, first) };
        let Joint::Smooth(k, _) = self.joint else { return Some(near) };
        // Weight of the farther operand in the gradient of the fillet.
        let reach = (k - (a - b).abs()).most(F::default()) / (k + k);
        let share = reach.widen() as f32;
        Some([0, 1, 2].map(|i| near[i] + share * (far[i] - near[i])))
    }
}

impl<F: Scalar> Joint<F> {
    /// The smooth minimum is the quadratic one (I. Quilez, "Smooth minimum"): never above the sharp minimum, below it
    /// by at most `k / 4`, and its gradient is a weighted mean of the gradients.
    #[inline(always)]
    fn union(&self, a: F, b: F) -> F {
        match *self {
            Self::Sharp => a.least(b),
            Self::Smooth(k, quarter) => {
                let h = (k - (a - b).abs()).most(F::default());
                a.least(b) - h * h * quarter
            }
            Self::Chamfer(k) => a.least(b).least((a + b - k) * F::of(0.5f64.sqrt())),
        }
    }
}

impl<F: Scalar> PlacedWarp<F> {
    #[inline(always)]
    fn placed(&self, [x, y, z]: [F; 3]) -> [F; 3] {
        [0, 1, 2].map(|i| {
            let row = &self.rows[i];
            row[0] * x + row[1] * y + row[2] * z + self.shift[i]
        })
    }

    /// Distance of a local point from the axis of the warp.
    pub fn radius_at(&self, local: DVec3) -> f64 {
        let [x, y, _] = self.placed(local.to_array().map(F::of)).map(F::widen);
        x.hypot(y)
    }

    #[inline(always)]
    pub fn positions<const N: usize>(&self, at: &[[F; N]; 3]) -> [[F; N]; 3] {
        let mut out = [[F::default(); N]; 3];
        for i in 0..N {
            let [x, y, z] = self.placed([at[0][i], at[1][i], at[2][i]]);
            let q = match self.kind {
                PlacedWarpKind::Elongate([hx, hy, hz]) => {
                    [x - x.between(-hx, hx), y - y.between(-hy, hy), z - z.between(-hz, hz)]
                }
                PlacedWarpKind::Twist(rate) => turned(x, y, z, -(rate * z)),
                PlacedWarpKind::Bend(rate) => turned(x, y, z, -(rate * x)),
                PlacedWarpKind::NearestCopy([a, b, c]) => {
                    [nearest_copy(x, &a), nearest_copy(y, &b), nearest_copy(z, &c)]
                }
            };
            for axis in 0..3 {
                out[axis][i] = q[axis];
            }
        }
        out
    }

    /// Whether the same copy is selected at all points of a ball, local units. Other warps select nothing.
    pub fn is_one_copy(&self, local: DVec3, radius: f64) -> bool {
        let PlacedWarpKind::NearestCopy(axes) = self.kind else { return true };
        let at = self.placed(local.to_array().map(F::of)).map(F::widen);
        at.into_iter().zip(axes).all(|(x, axis)| {
            let [_, inverse, start, last, _] = axis.map(F::widen);
            let (cell, reach) = (x * inverse + start, radius * inverse.abs());
            let lower = |cell: f64| cell.floor().clamp(0.0, last.max(0.0));
            lower(cell - reach) == lower(cell + reach)
        })
    }

    /// Divides by the stretch of the warp at each position.
    #[inline(always)]
    fn unstretch<const N: usize>(&self, at: &[[F; N]; 3], values: &mut [F; N]) {
        if self.rate == F::default() {
            return;
        }
        for i in 0..N {
            let [x, y, _] = self.placed([at[0][i], at[1][i], at[2][i]]);
            values[i] = values[i] / (F::of(1.0) + self.rate * length2(x, y).most(self.radius));
        }
    }
}

/// A coordinate in the space of the selected copy.
#[inline(always)]
fn nearest_copy<F: Scalar>(x: F, [spacing, inverse, start, last, step]: &[F; 5]) -> F {
    let lower = (x * *inverse + *start).floor().between(F::default(), *last);
    x - *spacing * (lower + *step)
}

/// Rotates about z.
#[inline(always)]
fn turned<F: Scalar>(x: F, y: F, z: F, angle: F) -> [F; 3] {
    let (sin, cos) = (angle.sin(), angle.cos());
    [cos * x - sin * y, sin * x + cos * y, z]
}

/// Compiles the field of a mask.
fn mask_distance(model: &Arc<Model>) -> MaskDistance {
    let model = model.clone();
    let program = Program::<f64>::new(&model, LocalFrame::of(&model));
    MaskDistance(Box::new(move |p| {
        let at = program.frame.local(p).to_array().map(|x| [x]);
        program.run(&model.tokens, &at, &mut Stack::default())[0]
    }))
}
