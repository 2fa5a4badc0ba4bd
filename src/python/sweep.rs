//! `fieldbake._core.Sweep`.

use super::assembly::Bodies;
use super::convert::{grid, with_encoding};
use super::error::{Failure, exception};
use super::run::run;
use super::sparse::{SparseField, Stored};
use crate::assembly::Similarity;
use crate::encoding::Encoding;
use crate::error::Error;
use crate::sweep::motion::{Chain, JointKind};
use crate::sweep::{self as core, SweepOptions};
use glam::DVec3;
use numpy::{PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;

/// Bodies and their motion.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Sweep(core::Sweep);

/// A transform (4, 4), a kind, an axis and the values of the joint in all rows.
type Joint = ([[f64; 4]; 4], String, [f64; 3], Vec<f64>);

/// Opposite corners of a box.
type Corners = ([f64; 3], [f64; 3]);

#[pymethods]
impl Sweep {
    /// A motion through world-from-body poses (rows * bodies, 4, 4).
    #[staticmethod]
    fn of_poses(bodies: &Bodies, poses: PyReadonlyArray3<'_, f64>, closed: bool, unsigned: bool) -> PyResult<Self> {
        let py = poses.py();
        let wrong = || exception(py, "ArgumentError", "poses: must be a C-contiguous (k, 4, 4) array".to_owned());
        let flat = poses.as_slice().ok().filter(|_| poses.shape()[1..] == [4, 4]).ok_or_else(wrong)?;
        let matrices = flat.as_chunks().0.as_chunks().0;
        let bodies = bodies.0.clone();
        let made = py.detach(|| core::Sweep::of_poses(bodies, matrices, closed, unsigned));
        Ok(Self(made.map_err(Failure::from)?))
    }

    /// A motion through joint values: for each body the pose of its root and the joints from there to the body.
    #[staticmethod]
    fn of_joints(
        py: Python<'_>,
        bodies: &Bodies,
        chains: Vec<([[f64; 4]; 4], Vec<Joint>)>,
        rows: usize,
        closed: bool,
        unsigned: bool,
    ) -> PyResult<Self> {
        let mut made = Vec::with_capacity(chains.len());
        for (root, joints) in chains {
            let mut chain = Chain { root: Similarity::from_rows(&root, 1.0), joints: Vec::new() };
            let mut values = vec![Vec::new(); rows];
            for (origin, kind, axis, own) in joints {
                let axis = DVec3::from_array(axis);
                let kind = match kind.as_str() {
                    "revolute" => JointKind::Revolute(axis),
                    "prismatic" => JointKind::Prismatic(axis),
                    _ => JointKind::Fixed,
                };
                chain.joints.push((Similarity::from_rows(&origin, 1.0), kind));
                values.iter_mut().zip(own).for_each(|(row, value)| row.push(value));
            }
            made.push((chain, values));
        }
        let bodies = bodies.0.clone();
        let made = py.detach(|| core::Sweep::of_joints(bodies, made, closed, unsigned));
        Ok(Self(made.map_err(Failure::from)?))
    }

    /// Number of steps of the motion.
    #[getter]
    fn steps(&self) -> usize {
        self.0.steps()
    }

    /// A box around the swept solid; none if a geometry is unbounded or there is none.
    fn bounds(&self, py: Python<'_>) -> Option<Corners> {
        py.detach(|| self.0.bounds()).map(|[lower, upper]| (lower.to_array(), upper.to_array()))
    }

    /// The field, the number of its evaluated samples, and the number of evaluated distances. `offset`, `tolerance` and
    /// `band` are in world units.
    #[pyo3(signature = (lower, upper, shape, *, offset, tolerance, band, encoding="float32", progress=None))]
    fn bake(
        &self,
        py: Python<'_>,
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        offset: f64,
        tolerance: f64,
        band: f64,
        encoding: &str,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<(SparseField, u64, u64)> {
        let grid = grid(lower, upper, shape)?;
        let options = SweepOptions { offset, tolerance, band };
        let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
        let (field, cost) = run(py, progress, |progress| {
            with_encoding!(encoding, T => {
                let (field, cost) = self.0.bake::<T>(&grid, &options, progress)?;
                Ok::<_, Error>((Stored::any(field), cost))
            })
        })?;
        Ok((SparseField(field), cost.samples, cost.evaluations))
    }
}
