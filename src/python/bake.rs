//! `fieldbake._core.bake`, `bake_blocks`, `bake_update`, `bake_window`, `sides_of_balls` and `bake_brute`.

use super::convert::{self, grid, rows, volume_array};
use super::device::{DeviceField, choose};
use super::error::{Failure, exception};
use super::mesh::Mesh;
use super::run::run;
use crate::bake::{
    BakeOptions, BakedField, Before, Report, bake_at, bake_blocks as blocks, bake_brute as brute,
    bake_window as window, sides_of_balls as balls, update,
};
use crate::error::DeviceError;
use crate::gpu::Place;
use crate::sign::SignMethod;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Bakes a mesh: distances (nx, ny, nz), or a `DeviceField` on a graphics device, and the report.
#[pyfunction]
#[pyo3(signature = (mesh, lower, upper, shape, *, sign="auto", band=None, thickness=None, device="auto", progress=None))]
pub(super) fn bake<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    sign: &str,
    band: Option<f64>,
    thickness: Option<f64>,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyAny>, Bound<'py, PyDict>)> {
    let mesh = mesh.0.clone();
    let grid = grid(lower, upper, shape)?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let options = BakeOptions { sign, band, thickness };
    let place = choose(py, device)?;
    let (field, mut report) = run(py, progress, |progress| bake_at(&place, &mesh, &grid, &options, progress))?;
    report.warnings.extend(place.warning(device));
    let distances = match field {
        BakedField::Host(samples) => volume_array(py, samples, shape)?.into_any(),
        BakedField::Device(field) => Bound::new(py, DeviceField(field))?.into_any(),
    };
    Ok((distances, report_dict(py, &report)?))
}

/// Bakes a mesh whose vertices moved, on the CPU: the distances (nx, ny, nz) and the report of `bake`. `before` and
/// `distances` are the mesh and the result of a bake on the CPU with the same grid and options, `undecided` its number
/// of undecided voxels.
#[pyfunction]
#[pyo3(signature = (
    mesh, before, distances, undecided, lower, upper, *, sign="auto", band=None, thickness=None, progress=None
))]
pub(super) fn bake_update<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    before: &Mesh,
    distances: PyReadonlyArray3<'py, f32>,
    undecided: usize,
    lower: [f64; 3],
    upper: [f64; 3],
    sign: &str,
    band: Option<f64>,
    thickness: Option<f64>,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(Bound<'py, PyArray3<f32>>, Bound<'py, PyDict>)> {
    let field = convert::Field::new(&distances, lower, upper)?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let options = BakeOptions { sign, band, thickness };
    let (mesh, before) = (mesh.0.clone(), before.0.clone());
    let (grid, samples) = (field.grid(), field.samples());
    let before = Before { mesh: &before, distances: samples, undecided };
    let baked = run(py, progress, |progress| update(&before, &mesh, &grid, &options, progress))?;
    Ok((volume_array(py, baked.distances, grid.shape)?, report_dict(py, &baked.report)?))
}

/// Samples `low..low + size` of the bake on the CPU of a grid, (sx, sy, sz); distances beyond the band are cut to it.
#[pyfunction]
#[pyo3(signature = (mesh, lower, upper, shape, low, size, *, sign="auto", band=None))]
pub(super) fn bake_window<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    low: [usize; 3],
    size: [usize; 3],
    sign: &str,
    band: Option<f64>,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let grid = grid(lower, upper, shape)?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let options = BakeOptions { sign, band, thickness: None };
    let samples = run(py, None, |progress| window(&mesh, &grid, low, size, &options, progress))?;
    volume_array(py, samples, size)
}

/// Distances at the samples of blocks (k, (side + 1)^3), x fastest. The first sample of a block is a row of `origins`
/// (k, 3). Samples outside the grid repeat the nearest one of the grid.
#[pyfunction]
#[pyo3(signature = (mesh, lower, upper, shape, origins, side, *, unsigned=false))]
pub(super) fn bake_blocks<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    origins: PyReadonlyArray2<'py, i32>,
    side: usize,
    unsigned: bool,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let grid = grid(lower, upper, shape)?;
    let origins = rows(&origins, "origins")?;
    let samples = run(py, None, |progress| blocks(&mesh, &grid, side, origins, unsigned, progress))?;
    samples.into_pyarray(py).reshape([origins.len(), (side + 1).pow(3)])
}

/// Distance of the surface from the centres (n, 3) of balls, (n,), and the side of each ball, (n,): 1 outside, -1
/// inside, 0 if the surface is in the ball or the sign rule decides each point by itself.
#[pyfunction]
#[pyo3(signature = (mesh, centers, radii, *, sign="auto"))]
#[expect(clippy::type_complexity, reason = "two arrays are what Python unpacks")]
pub(super) fn sides_of_balls<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    centers: PyReadonlyArray2<'py, f64>,
    radii: PyReadonlyArray1<'py, f64>,
    sign: &str,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<i8>>)> {
    mesh.prepare(py)?;
    let mesh = mesh.0.clone();
    let centers = rows(&centers, "centers")?;
    let radii = radii.as_slice().ok().filter(|radii| radii.len() == centers.len());
    let radii = radii.ok_or_else(|| {
        let message = "radii: must be contiguous, one for each centre";
        exception(py, "ArgumentError", message.to_owned())
    })?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let (distances, sides) = run(py, None, |progress| balls(&mesh, sign, centers, radii, progress))?;
    Ok((distances.into_pyarray(py), sides.into_pyarray(py)))
}

/// Bakes a mesh as the articles do, every sample against every triangle, on a graphics device: distances (nx, ny, nz).
#[pyfunction]
pub(super) fn bake_brute<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    sign: &str,
    device: &str,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let mesh = mesh.0.clone();
    let grid = grid(lower, upper, shape)?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let context = match choose(py, device)? {
        Place::Gpu(context) => context,
        Place::Cpu => {
            let reason = "brute force runs on a graphics device only".to_owned();
            let missing = DeviceError::NotAvailable { requested: device.to_owned(), reason };
            return Err(Failure::from(missing).into());
        }
    };
    let baked = run(py, None, |progress| brute(&context, &mesh, &grid, sign, progress))?;
    volume_array(py, baked.distances, shape)
}

pub(super) fn report_dict<'py>(py: Python<'py>, report: &Report) -> PyResult<Bound<'py, PyDict>> {
    let facts = PyDict::new(py);
    facts.set_item("sign_method", report.sign_method)?;
    facts.set_item("sign_reason", &report.sign_reason)?;
    facts.set_item("faces", report.faces)?;
    facts.set_item("boundary_edges", report.boundary_edges)?;
    facts.set_item("nonmanifold_edges", report.nonmanifold_edges)?;
    facts.set_item("flipped_faces", report.flipped_faces)?;
    facts.set_item("duplicate_faces", report.duplicate_faces)?;
    facts.set_item("degenerate_faces", report.degenerate_faces)?;
    facts.set_item("dropped_vertices", report.dropped_vertices)?;
    facts.set_item("components", report.components)?;
    facts.set_item("closed", report.closed)?;
    facts.set_item("undecided_voxels", report.undecided_voxels)?;
    facts.set_item("inside_voxels", report.inside_voxels)?;
    facts.set_item("points", report.points)?;
    facts.set_item("inside_points", report.inside_points)?;
    facts.set_item("device", &report.device)?;
    let seconds = PyDict::new(py);
    for (stage, duration) in &report.seconds {
        seconds.set_item(stage, duration)?;
    }
    facts.set_item("seconds", seconds)?;
    facts.set_item("peak_bytes", report.peak_bytes)?;
    facts.set_item("warnings", &report.warnings)?;
    Ok(facts)
}
