//! `fieldbake._core.Bodies`.

use super::convert::{owned_rows, rows};
use super::csg::Shape;
use super::error::exception;
use super::mesh::Mesh;
use super::run::run;
use crate::assembly::clearance::{Clearance, Options, clearances};
use crate::assembly::nearest::{Found, Request, nearest};
use crate::assembly::{self as core, Geometry, Similarity};
use crate::csg::parts::closed_form::ClosedForm;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::Arc;

/// The geometry of rigid bodies.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Bodies(pub(super) core::Bodies);

/// World-from-body poses (k, 4, 4).
type Poses<'py> = PyReadonlyArray3<'py, f64>;

/// The body, the geometry, its transform (4, 4) to the body, the scale of the transform, and the shape whose triangles
/// the geometry is with their largest deviation.
type Element<'py> = (usize, Bound<'py, PyAny>, [[f64; 4]; 4], f64, Option<(Bound<'py, Shape>, f64)>);

#[pymethods]
impl Bodies {
    /// `elements`: the body, the geometry, its transform (4, 4) to the body, the scale of the transform, and the shape
    /// whose triangles the geometry is with their largest deviation, or None.
    #[new]
    fn new(py: Python<'_>, count: usize, elements: Vec<Element<'_>>) -> PyResult<Self> {
        let mut bodies = core::Bodies::new(count);
        for (body, geometry, rows, scale, source) in elements {
            let geometry = if let Ok(mesh) = geometry.cast::<Mesh>() {
                let mesh = mesh.get();
                mesh.prepare(py)?;
                Geometry::Mesh(mesh.0.clone())
            } else {
                let solid = geometry.cast::<Shape>()?.get().solid(py)?;
                Geometry::Shape(Arc::new(ClosedForm::new(solid)))
            };
            let source = match source {
                Some((shape, deviation)) => Some((Arc::new(ClosedForm::new(shape.get().solid(py)?)), deviation)),
                None => None,
            };
            bodies.add(body, geometry, Similarity::from_rows(&rows, scale), source);
        }
        Ok(Self(bodies))
    }

    /// Number of geometries.
    #[getter]
    fn count(&self) -> usize {
        self.0.element_count()
    }

    /// Signed distances (k,) of points (m, 3) in all configurations; k = configurations * points.
    #[pyo3(signature = (poses, points, *, paired, searched, progress=None))]
    fn distance<'py>(
        &self,
        py: Python<'py>,
        poses: Poses<'py>,
        points: PyReadonlyArray2<'py, f64>,
        paired: bool,
        searched: Vec<bool>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let request = self.request(&poses, &points, paired, &searched)?;
        let column = run(py, progress, |progress| {
            nearest(&self.0, &request, |found| found.distance, progress)?.column(|&distance| distance)
        })?;
        Ok(column.into_pyarray(py))
    }

    /// The clearance of pairs of bodies (k, 2) in all configurations: distances (n,), errors (n,), points of the first
    /// and the second body (n, 3), and normals (n, 3); n = configurations * k.
    #[pyo3(signature = (poses, pairs, *, cutoff, relative_tolerance, progress=None))]
    #[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
    fn clearance<'py>(
        &self,
        py: Python<'py>,
        poses: Poses<'py>,
        pairs: Vec<[usize; 2]>,
        cutoff: f64,
        relative_tolerance: f64,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(
        Bound<'py, PyArray1<f64>>,
        Bound<'py, PyArray1<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray2<f64>>,
    )> {
        let wrong = |what: &str| exception(py, "ArgumentError", what.to_owned());
        let flat = poses.as_slice().ok().filter(|_| poses.shape()[1..] == [4, 4]);
        let flat = flat.ok_or_else(|| wrong("poses: must be a C-contiguous (k, 4, 4) array"))?;
        let matrices = flat.as_chunks().0.as_chunks().0;
        if pairs.iter().flatten().any(|&body| body >= self.0.count()) {
            return Err(wrong("pairs: must name bodies by their rows"));
        }
        let options = Options { cutoff, relative_tolerance };
        let found = run(py, progress, |progress| clearances(&self.0, matrices, &pairs, &options, progress))?;
        let rows = |value: fn(&Clearance) -> [f64; 3]| owned_rows(py, found.iter().map(value).collect());
        Ok((
            found.iter().map(|row| row.distance).collect::<Vec<_>>().into_pyarray(py),
            found.iter().map(|row| row.error).collect::<Vec<_>>().into_pyarray(py),
            rows(|row| row.points[0])?,
            rows(|row| row.points[1])?,
            rows(|row| row.normal)?,
        ))
    }

    /// Signed distances (k,), gradients (k, 3), nearest points (k, 3), elements (k,), faces (k,) and weights (k, 3).
    #[pyo3(signature = (poses, points, *, paired, searched, progress=None))]
    #[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
    fn query<'py>(
        &self,
        py: Python<'py>,
        poses: Poses<'py>,
        points: PyReadonlyArray2<'py, f64>,
        paired: bool,
        searched: Vec<bool>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(
        Bound<'py, PyArray1<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray1<i64>>,
        Bound<'py, PyArray1<i64>>,
        Bound<'py, PyArray2<f64>>,
    )> {
        let request = self.request(&poses, &points, paired, &searched)?;
        let (distances, gradients, places, elements, faces, weights) = run(py, progress, |progress| {
            let found = nearest(&self.0, &request, |found| found, progress)?;
            Ok((
                found.column(|row: &Found| row.distance)?,
                found.column(|row| row.gradient)?,
                found.column(|row| row.point)?,
                found.column(|row| row.element)?,
                found.column(|row| row.face)?,
                found.column(|row| row.weights)?,
            ))
        })?;
        Ok((
            distances.into_pyarray(py),
            owned_rows(py, gradients)?,
            owned_rows(py, places)?,
            elements.into_pyarray(py),
            faces.into_pyarray(py),
            owned_rows(py, weights)?,
        ))
    }
}

impl Bodies {
    fn request<'a>(
        &self,
        poses: &'a Poses<'_>,
        points: &'a PyReadonlyArray2<'_, f64>,
        is_paired: bool,
        searched: &'a [bool],
    ) -> PyResult<Request<'a>> {
        let wrong = |what: &str| exception(poses.py(), "ArgumentError", what.to_owned());
        let flat = poses.as_slice().ok().filter(|_| poses.shape()[1..] == [4, 4]);
        let flat = flat.ok_or_else(|| wrong("poses: must be a C-contiguous (k, 4, 4) array"))?;
        let matrices = flat.as_chunks().0.as_chunks().0;
        let configurations = matrices.len().checked_div(self.0.count()).unwrap_or(0);
        let points = rows(points, "points")?;
        if configurations * self.0.count() != matrices.len()
            || searched.len() != self.0.element_count()
            || (is_paired && configurations > 0 && points.len() % configurations != 0)
        {
            return Err(wrong("poses, points, searched: have other lengths than the bodies"));
        }
        Ok(Request { poses: matrices, configurations, points, is_paired, searched })
    }
}
