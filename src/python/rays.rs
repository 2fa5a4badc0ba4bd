//! `fieldbake._core.cast_rays`, `occluded`, `count_intersections` and `all_intersections`.

use super::convert::{owned_rows, rows};
use super::device::choose;
use super::mesh::Mesh;
use super::query::FEW;
use super::run::run_sized;
use crate::error::Error;
use crate::gpu::Place;
use crate::progress::Progress;
use crate::query::{self, Rays};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

/// Runs `job` for rays (n, 3). A few rays run on the calling thread if the mesh is prepared for them.
fn with_rays<T: Send>(
    py: Python<'_>,
    mesh: &Mesh,
    [origins, directions]: [&PyReadonlyArray2<'_, f64>; 2],
    (t_min, t_max): (f64, f64),
    device: &str,
    progress: Option<&Bound<'_, PyAny>>,
    job: impl FnOnce(&Place, &crate::mesh::Mesh, &Rays<'_>, &Progress) -> Result<T, Error> + Send,
) -> PyResult<T> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let rays = Rays { origins: rows(origins, "origins")?, directions: rows(directions, "directions")?, t_min, t_max };
    let place = choose(py, query::device_for(device, &mesh, rays.origins.len()))?;
    let is_short = rays.origins.len() <= FEW && matches!(place, Place::Cpu) && mesh.is_prepared_for_rays();
    Ok(run_sized(py, progress, is_short, |progress| job(&place, &mesh, &rays, progress))?)
}

/// First hits: t (n,), faces (n,), barycentric coordinates (n, 3) and face normals (n, 3).
#[pyfunction]
#[pyo3(signature = (mesh, origins, directions, *, t_min=0.0, t_max=f64::INFINITY, device="auto", progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
pub(super) fn cast_rays<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    t_min: f64,
    t_max: f64,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let hits = with_rays(py, mesh, [&origins, &directions], (t_min, t_max), device, progress, query::cast_rays)?;
    Ok((
        hits.t.into_pyarray(py),
        hits.faces.into_pyarray(py),
        owned_rows(py, hits.barycentric)?,
        owned_rows(py, hits.normals)?,
    ))
}

/// Whether each ray hits anything, (n,).
#[pyfunction]
#[pyo3(signature = (mesh, origins, directions, *, t_min=0.0, t_max=f64::INFINITY, device="auto", progress=None))]
pub(super) fn occluded<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    t_min: f64,
    t_max: f64,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    let found = with_rays(py, mesh, [&origins, &directions], (t_min, t_max), device, progress, query::occluded)?;
    Ok(found.into_pyarray(py))
}

/// Number of intersections of each ray, (n,).
#[pyfunction]
#[pyo3(signature = (mesh, origins, directions, *, t_min=0.0, t_max=f64::INFINITY, device="auto", progress=None))]
pub(super) fn count_intersections<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    t_min: f64,
    t_max: f64,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<i64>>> {
    let found =
        with_rays(py, mesh, [&origins, &directions], (t_min, t_max), device, progress, query::count_intersections)?;
    Ok(found.into_pyarray(py))
}

/// All intersections by ray and t: rays (k,), t (k,), faces (k,) and barycentric coordinates (k, 3).
#[pyfunction]
#[pyo3(signature = (mesh, origins, directions, *, t_min=0.0, t_max=f64::INFINITY, device="auto", progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
pub(super) fn all_intersections<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    origins: PyReadonlyArray2<'py, f64>,
    directions: PyReadonlyArray2<'py, f64>,
    t_min: f64,
    t_max: f64,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let found =
        with_rays(py, mesh, [&origins, &directions], (t_min, t_max), device, progress, query::all_intersections)?;
    Ok((
        found.rays.into_pyarray(py),
        found.t.into_pyarray(py),
        found.faces.into_pyarray(py),
        owned_rows(py, found.barycentric)?,
    ))
}
