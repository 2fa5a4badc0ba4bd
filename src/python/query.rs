//! `fieldbake._core.signed_distance` and `closest_point`.

use super::convert::{row_array, rows};
use super::device::choose;
use super::error::Failure;
use super::mesh::Mesh;
use super::run::run;
use crate::query;
use crate::sign::SignMethod;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

/// Signed distance at points (n, 3).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, sign="auto", device="auto", progress=None))]
pub fn signed_distance<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    sign: &str,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, device)?;
    let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let distances = run(py, progress, |progress| query::signed_distances(&place, &mesh, points, method, progress))?;
    Ok(distances.into_pyarray(py))
}

/// Closest points (n, 3), unsigned distances (n,) and faces (n,).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, device="auto", progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of three arrays is what Python unpacks")]
pub fn closest_point<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f32>>, Bound<'py, PyArray1<u32>>)> {
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, device)?;
    let found = run(py, progress, |progress| query::closest_points(&place, &mesh, points, progress))?;
    let positions = row_array(py, found.points.into_iter())?;
    Ok((positions, found.distances.into_pyarray(py), found.faces.into_pyarray(py)))
}
