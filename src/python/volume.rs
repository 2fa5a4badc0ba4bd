//! `fieldbake._core.sample`, `gradient` and `resample`.

use super::convert::{Field, grid, positions, row_array, volume_array, with_texels};
use super::device::DeviceField;
use super::error::Failure;
use super::run::run;
use crate::volume::{SampleFilter, Trilinear, cells};
use glam::DVec3;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray2};
use pyo3::prelude::*;

/// The field, an array or a `DeviceField`, at points (n, 3); a proven lower bound outside the box.
#[pyfunction]
#[pyo3(signature = (distances, lower, upper, inner_lower, inner_upper, points, *, filter="linear", scale=1.0))]
pub(super) fn sample<'py>(
    py: Python<'py>,
    distances: &Bound<'py, PyAny>,
    lower: [f64; 3],
    upper: [f64; 3],
    inner_lower: [f64; 3],
    inner_upper: [f64; 3],
    points: PyReadonlyArray2<'py, f64>,
    filter: &str,
    scale: f32,
) -> PyResult<Bound<'py, PyArray1<f32>>> {
    let filter = SampleFilter::from_name(filter).map_err(Failure::from)?;
    let points = positions(&points)?;
    let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
    let values = if let Ok(field) = distances.cast::<DeviceField>() {
        let field = &field.get().0;
        let grid = grid(lower, upper, field.shape())?;
        run(py, None, |progress| cells::sample(field, &grid, points, inner, filter, progress))?
    } else {
        with_texels!(distances, PyReadonlyArray3, |array| {
            let field = Field::encoded(&array, lower, upper, scale)?;
            run(py, None, |progress| field.view()?.sample(points, inner, filter, progress))?
        })
    };
    Ok(values.into_pyarray(py))
}

/// Gradient of the trilinear field at points (n, 3).
#[pyfunction]
#[pyo3(signature = (distances, lower, upper, points, *, scale=1.0))]
pub(super) fn gradient<'py>(
    py: Python<'py>,
    distances: &Bound<'py, PyAny>,
    lower: [f64; 3],
    upper: [f64; 3],
    points: PyReadonlyArray2<'py, f64>,
    scale: f32,
) -> PyResult<Bound<'py, PyArray2<f32>>> {
    let points = positions(&points)?;
    let gradients = if let Ok(field) = distances.cast::<DeviceField>() {
        let field = &field.get().0;
        let grid = grid(lower, upper, field.shape())?;
        run(py, None, |progress| cells::gradients(field, &grid, points, progress))?
    } else {
        with_texels!(distances, PyReadonlyArray3, |array| {
            let field = Field::encoded(&array, lower, upper, scale)?;
            run(py, None, |progress| field.view()?.gradients(points, progress))?
        })
    };
    row_array(py, gradients.iter().map(glam::Vec3::to_array))
}

/// The trilinear field on another grid over the same box.
#[pyfunction]
#[pyo3(signature = (distances, lower, upper, shape, *, scale=1.0))]
pub(super) fn resample<'py>(
    py: Python<'py>,
    distances: &Bound<'py, PyAny>,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    scale: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let samples = with_texels!(distances, PyReadonlyArray3, |array| {
        let field = Field::encoded(&array, lower, upper, scale)?;
        run(py, None, |progress| field.view()?.resample(shape, progress))?
    });
    volume_array(py, samples, shape)
}
