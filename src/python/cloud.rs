//! `fieldbake._core.PointCloud`.

use super::convert::{grid, owned_rows, rows, volume_array};
use super::query::FEW;
use super::run::{run, run_sized};
use crate::bake::bake_cloud;
use crate::cloud;
use crate::query::{cloud_contains, cloud_winding_numbers, query_cloud};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use std::sync::Arc;

/// Points with normals and areas, and the tree over their disks.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct PointCloud(pub(super) Arc<cloud::PointCloud>);

/// Unit normals (n, 3), and the method that chose their sides.
#[pyfunction]
#[pyo3(signature = (points, lines=None, viewpoints=None, *, neighbours, progress=None))]
pub(super) fn orient<'py>(
    py: Python<'py>,
    points: PyReadonlyArray2<'py, f64>,
    lines: Option<PyReadonlyArray2<'py, f64>>,
    viewpoints: Option<PyReadonlyArray2<'py, f64>>,
    neighbours: usize,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, &'static str)> {
    let points = rows(&points, "points")?;
    let lines = lines.as_ref().map(|lines| rows(lines, "lines")).transpose()?;
    let viewpoints = viewpoints.as_ref().map(|viewpoints| rows(viewpoints, "viewpoints")).transpose()?;
    let (normals, method) =
        run(py, progress, |progress| cloud::orient(points, lines, viewpoints, neighbours, progress))?;
    Ok((owned_rows(py, normals)?, method))
}

#[pymethods]
impl PointCloud {
    #[new]
    #[pyo3(signature = (points, normals=None, areas=None, *, progress=None))]
    fn new(
        py: Python<'_>,
        points: PyReadonlyArray2<'_, f64>,
        normals: Option<PyReadonlyArray2<'_, f64>>,
        areas: Option<PyReadonlyArray1<'_, f64>>,
        progress: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let points = rows(&points, "points")?;
        let normals = normals.as_ref().map(|normals| rows(normals, "normals")).transpose()?;
        let areas = areas.as_ref().map(|areas| areas.as_slice()).transpose()?;
        let cloud = run(py, progress, |progress| cloud::PointCloud::new(points, normals, areas, progress))?;
        Ok(Self(Arc::new(cloud)))
    }

    #[getter]
    fn areas<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.areas.values)
    }

    /// Number of repeated points and of capped areas, the median and the 95th percentile of the spacing, and whether
    /// the normals point inwards.
    fn facts(&self) -> (usize, usize, f64, f64, bool) {
        let cloud = &self.0;
        (cloud.areas.duplicates, cloud.areas.outliers, cloud.spacing, cloud.spacing_95, cloud.inside_out)
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.0.bytes()
    }

    /// Distances (n,), nearest points of the disks (n, 3), rows (n,), and the numbers of points inside and undecided.
    #[pyo3(signature = (points, *, signed, progress=None))]
    #[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
    fn query<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        signed: bool,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<i64>>, usize, usize)> {
        let points = rows(&points, "points")?;
        let found =
            run_sized(py, progress, points.len() <= FEW, |progress| query_cloud(&self.0, points, signed, progress))?;
        Ok((
            found.distances.into_pyarray(py),
            owned_rows(py, found.points)?,
            found.rows.into_pyarray(py),
            found.inside,
            found.undecided,
        ))
    }

    /// Whether each point (n, 3) is inside, (n,).
    #[pyo3(signature = (points, *, progress=None))]
    fn contains<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let points = rows(&points, "points")?;
        let inside =
            run_sized(py, progress, points.len() <= FEW, |progress| cloud_contains(&self.0, points, progress))?;
        Ok(inside.into_pyarray(py))
    }

    /// The winding number at points (n, 3), (n,), with an absolute error of at most `error`.
    #[pyo3(signature = (points, *, error, progress=None))]
    fn winding_number<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
        error: f64,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let points = rows(&points, "points")?;
        let found = run_sized(py, progress, points.len() <= FEW, |progress| {
            cloud_winding_numbers(&self.0, points, error, progress)
        })?;
        Ok(found.into_pyarray(py))
    }

    /// Distances of a grid (nx, ny, nz), and the numbers of samples inside and undecided.
    #[pyo3(signature = (lower, upper, shape, *, signed, progress=None))]
    fn bake<'py>(
        &self,
        py: Python<'py>,
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        signed: bool,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, usize, usize)> {
        let grid = grid(lower, upper, shape)?;
        let (distances, counts) = run(py, progress, |progress| bake_cloud(&self.0, &grid, signed, progress))?;
        Ok((volume_array(py, distances, shape)?, counts.inside, counts.undecided))
    }
}
