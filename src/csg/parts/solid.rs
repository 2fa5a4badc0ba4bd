//! A shape prepared for evaluation: distances, gradients, colours.
//!
//! Queries run in float64 and are rounded once. Grids and pictures run in float32, in local units, where it is accurate
//! to about 1e-7 of the model's size at any position. [`super::point_values`] evaluates points.

use super::cells::{PartCells, SharedTables};
use super::part::Part;
use crate::csg::evaluation::program::{LocalFrame, Program, Stack};
use crate::csg::evaluation::scalar::Scalar;
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use crate::csg::tree::shape::Shape;
use crate::error::Error;
use crate::simd::with_vectors;
use glam::DVec3;
use std::sync::OnceLock;

/// A lowered and compiled shape. Immutable, and shared between threads.
#[derive(Debug)]
pub struct Solid {
    /// The shape as it was written.
    pub shape: Shape,
    /// The lowered tree.
    pub model: Model,
    /// The map to local units.
    pub frame: LocalFrame,
    /// The program of the model in float32.
    pub program: Program<f32>,
    precise: Program<f64>,
    /// Parts by method (boxes, octree), computed at the first use.
    pub(crate) parts: [OnceLock<Vec<Part>>; 2],
    pub(crate) cells: [OnceLock<PartCells>; 2],
}

/// Number of points evaluated together.
pub(crate) const LANES: usize = 64;

impl Solid {
    /// Lowers and compiles a shape.
    pub fn new(shape: &Shape) -> Result<Self, Error> {
        let model = Model::new(shape)?;
        let frame = LocalFrame::of(&model);
        Ok(Self::in_frame(shape, model, frame))
    }

    /// [`Self::new`] in given local units. Numbers of shapes in one frame are comparable.
    pub fn placed(shape: &Shape, frame: LocalFrame) -> Result<Self, Error> {
        Ok(Self::in_frame(shape, Model::new(shape)?, frame))
    }

    fn in_frame(shape: &Shape, model: Model, frame: LocalFrame) -> Self {
        let program = Program::new(&model, frame);
        let precise = Program::new(&model, frame);
        Self {
            shape: shape.clone(),
            model,
            frame,
            program,
            precise,
            parts: Default::default(),
            cells: Default::default(),
        }
    }

    /// Lower and upper corner, or an error that names the leaf without bounds. An empty solid has its centre twice.
    pub fn bounds(&self) -> Result<[DVec3; 2], Error> {
        self.model.is_bounded()?;
        let extent = &self.model.extent;
        if extent.is_empty() {
            let middle = 0.5 * (extent.lower + extent.upper);
            let middle = if middle.is_finite() { middle } else { DVec3::ZERO };
            return Ok([middle, middle]);
        }
        Ok([extent.lower, extent.upper])
    }

    /// Linear RGB of the surface near a world point; `None` where it is not painted.
    pub fn color(&self, p: DVec3) -> Option<[f32; 3]> {
        self.precise.color(&self.model, &self.model.tokens, self.frame.local(p).to_array())
    }

    /// The tables that the parts share.
    pub(crate) fn tables(&self) -> SharedTables<'_> {
        SharedTables { model: &self.model, frame: self.frame, program: &self.program }
    }

    /// The program of the model in float64.
    pub fn precise(&self) -> &Program<f64> {
        &self.precise
    }
}

/// Converts to float32 and keeps the value finite: the distance to an empty solid is the largest float.
pub(super) fn saturated(value: f64) -> f32 {
    value.clamp(-f64::from(f32::MAX), f64::from(f32::MAX)) as f32
}

/// Gradient by central differences, six points at once.
pub(crate) fn slope<F: Scalar>(
    program: &Program<F>,
    tokens: &[Token],
    p: DVec3,
    step: f64,
    stack: &mut Stack<F, 6>,
) -> DVec3 {
    let mut at = [[F::default(); 6]; 3];
    for axis in 0..3 {
        at[axis] = [F::of(p[axis]); 6];
        at[axis][2 * axis] = F::of(p[axis] + step);
        at[axis][2 * axis + 1] = F::of(p[axis] - step);
    }
    let values = run_wide(program, tokens, &at, stack);
    let across = |axis: usize| values[2 * axis].widen() - values[2 * axis + 1].widen();
    DVec3::new(across(0), across(1), across(2)) / (2.0 * step)
}

/// [`Program::run`] with the vector instructions of this machine.
pub(crate) fn run_wide<F: Scalar, const N: usize>(
    program: &Program<F>,
    tokens: &[Token],
    at: &[[F; N]; 3],
    stack: &mut Stack<F, N>,
) -> [F; N] {
    with_vectors!(
        [F: Scalar, const N: usize]
        (program: &Program<F> = program, tokens: &[Token] = tokens, at: &[[F; N]; 3] = at,
         stack: &mut Stack<F, N> = stack)
        -> [F; N] { program.run(tokens, at, stack) }
    )
}
