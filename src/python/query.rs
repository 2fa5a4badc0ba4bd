//! `fieldbake._core.signed_distance`, `closest_point`, `query`, `contains`, `winding_number`, `thickness` and
//! `sample_surface`.

use super::bake::report_dict;
use super::convert::{Field, owned_rows, rows, volume_array};
use super::device::choose;
use super::error::Failure;
use super::mesh::Mesh;
use super::run::{run, run_owned, run_sized};
use crate::gpu::Place;
use crate::query as core;
use crate::sign::SignMethod;
use crate::sign::raw::RawClosure;
use crate::solid;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Largest number of points that the calling thread processes itself, since waking a worker takes longer.
pub(super) const FEW: usize = 64;

/// Signed distance at points (n, 3).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, sign="auto", device="auto", progress=None))]
pub(super) fn signed_distance<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    sign: &str,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, core::device_for(device, &mesh, points.len()))?;
    let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let distances = run_sized(py, progress, is_short(&mesh, points.len(), &place), |progress| {
        core::signed_distances(&place, &mesh, points, method, progress)
    })?;
    Ok(distances.into_pyarray(py))
}

/// [`signed_distance`] in float64.
#[pyfunction]
#[pyo3(signature = (mesh, points, *, sign="auto", device="auto", progress=None))]
pub(super) fn signed_distance_float64<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    sign: &str,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, core::device_for(device, &mesh, points.len()))?;
    let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let distances = run_sized(py, progress, is_short(&mesh, points.len(), &place), |progress| {
        core::precise_signed_distances(&place, &mesh, points, method, progress)
    })?;
    Ok(distances.into_pyarray(py))
}

/// Float64 distances (nx, ny, nz) of the samples of a grid, with the signs of their float32 `distances`.
#[pyfunction]
pub(super) fn refined<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    distances: PyReadonlyArray3<'py, f32>,
    lower: [f64; 3],
    upper: [f64; 3],
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    mesh.prepare(py)?;
    let field = Field::new(&distances, lower, upper)?;
    let (grid, mesh) = (field.grid(), mesh.0.clone());
    let refined = run(py, None, |progress| core::refined(&mesh, &grid, field.samples(), progress))?;
    volume_array(py, refined, grid.shape)
}

/// Closest points (n, 3), unsigned distances (n,), faces (n,), barycentric coordinates (n, 3) and face normals (n, 3).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, device="auto", progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
pub(super) fn closest_point<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, core::device_for(device, &mesh, points.len()))?;
    let found = run_sized(py, progress, is_short(&mesh, points.len(), &place), |progress| {
        core::closest_points(&place, &mesh, points, progress)
    })?;
    Ok((
        owned_rows(py, found.points)?,
        found.distances.into_pyarray(py),
        found.faces.into_pyarray(py),
        owned_rows(py, found.barycentric)?,
        owned_rows(py, found.normals)?,
    ))
}

/// Signed distances (n,), gradients (n, 3), closest points (n, 3), faces (n,), barycentric coordinates (n, 3), report.
#[pyfunction]
#[pyo3(signature = (mesh, points, *, sign="auto", device="auto", progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
pub(super) fn query<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    sign: &str,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyDict>,
)> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let place = choose(py, core::device_for(device, &mesh, points.len()))?;
    let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let found = run_sized(py, progress, is_short(&mesh, points.len(), &place), |progress| {
        core::query(&place, &mesh, points, method, progress)
    })?;
    Ok((
        found.distances.into_pyarray(py),
        owned_rows(py, found.gradients)?,
        owned_rows(py, found.points)?,
        found.faces.into_pyarray(py),
        owned_rows(py, found.barycentric)?,
        report_dict(py, &found.report)?,
    ))
}

/// Whether the calling thread processes the query: few points, on the CPU, and the mesh has the structures it needs.
pub(super) fn is_short(mesh: &crate::mesh::Mesh, points: usize, place: &Place) -> bool {
    points <= FEW && matches!(place, Place::Cpu) && mesh.is_prepared()
}

/// Whether each point (n, 3) is inside, (n,).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, sign="auto", progress=None))]
pub(super) fn contains<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    sign: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<bool>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let inside = run_sized(py, progress, is_short(&mesh, points.len(), &Place::Cpu), |progress| {
        core::contains(&mesh, points, method, progress)
    })?;
    Ok(inside.into_pyarray(py))
}

/// Signed winding number of the faces as they are wound at points (n, 3), (n,).
#[pyfunction]
#[pyo3(signature = (mesh, points, *, error=1e-6, progress=None))]
pub(super) fn winding_number<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    error: f64,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    if !mesh.has_derived::<RawClosure>() {
        // The tables of millions of faces take seconds. Ctrl-C leaves them to a worker thread.
        let owned = mesh.clone();
        run_owned(py, move |_| Ok(core::derive_winding_tables(&owned, error)))?;
    }
    let found = run_sized(py, progress, is_short(&mesh, points.len(), &Place::Cpu), |progress| {
        core::winding_numbers(&mesh, points, error, progress)
    })?;
    Ok(found.into_pyarray(py))
}

/// Diameter of the largest inscribed ball that touches each point (n, 3), (n,).
#[pyfunction]
#[pyo3(signature = (mesh, points, normals=None, *, progress=None))]
pub(super) fn thickness<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    points: PyReadonlyArray2<'py, f64>,
    normals: Option<PyReadonlyArray2<'py, f64>>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let points = rows(&points, "points")?;
    let normals = normals.as_ref().map(|normals| rows(normals, "normals")).transpose()?;
    let found = run(py, progress, |progress| core::thickness(&mesh, points, normals, progress))?;
    Ok(found.into_pyarray(py))
}

/// Points uniform by area: points (n, 3), face normals (n, 3), faces (n,) and barycentric coordinates (n, 3).
#[pyfunction]
#[pyo3(signature = (mesh, count, *, seed=0, progress=None))]
#[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
pub(super) fn sample_surface<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    count: usize,
    seed: u64,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<i64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let samples = run(py, progress, |progress| core::sample_surface(&mesh, count, seed, progress))?;
    Ok((
        owned_rows(py, samples.points)?,
        owned_rows(py, samples.normals)?,
        samples.faces.into_pyarray(py),
        owned_rows(py, samples.barycentric)?,
    ))
}

/// The samples of a grid that a flood from the box reaches without crossing a triangle.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct OuterSides {
    sides: solid::OuterSides,
    grid: crate::grid::Grid,
}

#[pymethods]
impl OuterSides {
    #[new]
    fn new(
        py: Python<'_>,
        mesh: PyRef<'_, Mesh>,
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        radius: f64,
    ) -> PyResult<Self> {
        let grid = super::convert::grid(lower, upper, shape)?;
        let mesh = mesh.0.clone();
        let sides = run(py, None, |progress| solid::OuterSides::new(&mesh, &grid, radius, progress))?;
        Ok(Self { sides, grid })
    }

    /// Whether the samples nearest to points (n, 3) lie outside, (n,).
    fn is_outside<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray1<bool>>> {
        let points = rows(&points, "points")?;
        let spacing = self.grid.spacing();
        let found: Vec<bool> = points
            .iter()
            .map(|&p| {
                let at = (glam::DVec3::from_array(p) - self.grid.lower) / spacing - 0.5;
                self.sides.is_outside(at.round().to_array().map(|i| i as i64))
            })
            .collect();
        Ok(found.into_pyarray(py))
    }
}
