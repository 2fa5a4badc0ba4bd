//! A shape prepared for evaluation: distances, gradients, colours.
//!
//! Queries run in float64 and are rounded once. Grids and pictures run in float32, in local units, where it is accurate
//! to about 1e-7 of the model's size at any position. Batches of 64 points are distributed to all cores.

use super::cells::{PartCells, SharedTables};
use super::part::Part;
use crate::csg::evaluation::program::{LocalFrame, Program, Stack};
use crate::csg::evaluation::scalar::Scalar;
use crate::csg::model::lowered::Model;
use crate::csg::model::token::Token;
use crate::csg::tree::primitive::Primitive;
use crate::csg::tree::shape::Shape;
use crate::error::{Error, ShapeError};
use crate::memory::zeroed_rows;
use crate::progress::Progress;
use crate::simd::with_vectors;
use bytemuck::Zeroable;
use glam::DVec3;
use rayon::prelude::*;
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

/// Number of points of a piece of a batch.
const CHUNK_POINTS: usize = 16 * LANES;

/// Half the step of a gradient's central differences, local units: the cube root of float64's rounding. There the
/// errors by the rounding of the field and by the curvature of the surface are equal, about 1e-10.
const GRADIENT_STEP: f64 = 6e-6;

/// Number of points whose gradients are evaluated together: six lanes each.
const GRADIENTS: usize = LANES / 6;

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

    /// Signed distance, or a bound on it, at world points.
    pub fn distances(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<f32>, Error> {
        self.distances_as(points, saturated, progress)
    }

    /// [`Solid::distances`] in float64. A baked volume has float32 samples, so a shape with one is refused.
    pub fn precise_distances(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<f64>, Error> {
        if self.model.leaves.iter().any(|leaf| matches!(leaf.primitive, Primitive::Volume(_))) {
            let problem = "\"float64\" does not apply to a shape with a volume_shape, whose samples are float32";
            return Err(ShapeError::argument("dtype", problem).into());
        }
        self.distances_as(points, |value| value.clamp(-f64::from(f32::MAX), f64::from(f32::MAX)), progress)
    }

    fn distances_as<T: Copy + Send + Zeroable>(
        &self,
        points: &[DVec3],
        rounded: impl Fn(f64) -> T + Sync,
        progress: &Progress,
    ) -> Result<Vec<T>, Error> {
        let mut out = zeroed_rows("results", points.len())?;
        progress.set_total(points.len() as u64);
        out.par_chunks_mut(CHUNK_POINTS).zip(points.par_chunks(CHUNK_POINTS)).try_for_each_init(
            Stack::<f64, LANES>::default,
            |stack, (out, points)| {
                for (out, points) in out.chunks_mut(LANES).zip(points.chunks(LANES)) {
                    let mut at = [[0.0; LANES]; 3];
                    for (i, &p) in points.iter().enumerate() {
                        let local = self.frame.local(p);
                        (at[0][i], at[1][i], at[2][i]) = (local.x, local.y, local.z);
                    }
                    let values = run_wide(&self.precise, &self.model.tokens, &at, stack);
                    for (out, value) in out.iter_mut().zip(values) {
                        *out = rounded(value * self.frame.scale);
                    }
                }
                progress.advance(points.len() as u64)
            },
        )?;
        Ok(out)
    }

    /// Gradient of the field at world points; zero where it is undefined.
    pub fn gradients(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<[f32; 3]>, Error> {
        let mut out = zeroed_rows("results", points.len())?;
        progress.set_total(points.len() as u64);
        out.par_chunks_mut(CHUNK_POINTS).zip(points.par_chunks(CHUNK_POINTS)).try_for_each_init(
            Stack::<f64, LANES>::default,
            |stack, (out, points)| {
                for (out, points) in out.chunks_mut(GRADIENTS).zip(points.chunks(GRADIENTS)) {
                    let (mut at, mut steps) = ([[0.0; LANES]; 3], [0.0; GRADIENTS]);
                    for (i, &p) in points.iter().enumerate() {
                        let local = self.frame.local(p);
                        // The step is proportional to the rounding of positions far away.
                        steps[i] = GRADIENT_STEP * local.abs().max_element().max(1.0);
                        for axis in 0..3 {
                            at[axis][6 * i..6 * i + 6].fill(local[axis]);
                            at[axis][6 * i + 2 * axis] += steps[i];
                            at[axis][6 * i + 2 * axis + 1] -= steps[i];
                        }
                    }
                    let values = run_wide(&self.precise, &self.model.tokens, &at, stack);
                    for ((out, values), step) in out.iter_mut().zip(values.chunks_exact(6)).zip(steps) {
                        let across = |axis: usize| (values[2 * axis] - values[2 * axis + 1]) / (2.0 * step);
                        *out = [across(0) as f32, across(1) as f32, across(2) as f32];
                    }
                }
                progress.advance(points.len() as u64)
            },
        )?;
        Ok(out)
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
