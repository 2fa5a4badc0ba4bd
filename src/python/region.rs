//! `fieldbake._core.resolved_polygons`, `combined_polygons` and `offset_polygons`.

use super::error::Failure;
use crate::csg::tree::loops::Loop;
use crate::csg::tree::region::{Rule, combined, offset, resolved};
use crate::error::ShapeError;
use glam::DVec2;
use numpy::{PyArray2, PyReadonlyArray2};
use pyo3::prelude::*;

/// Closed polygons, (m, 2) each.
type Polygons<'py> = Vec<Bound<'py, PyArray2<f64>>>;

fn loops(arrays: &[PyReadonlyArray2<'_, f64>]) -> Vec<Loop> {
    let corners = |array: &PyReadonlyArray2<'_, f64>| -> Loop {
        array.as_array().rows().into_iter().map(|row| DVec2::new(row[0], row[1])).collect()
    };
    arrays.iter().map(corners).collect()
}

fn arrays<'py>(
    py: Python<'py>,
    made: impl FnOnce() -> Result<Vec<Loop>, ShapeError> + Send,
) -> PyResult<Polygons<'py>> {
    let made = py.detach(made).map_err(Failure::from)?;
    let rows = |corners: Loop| corners.into_iter().map(|p| p.to_array().to_vec()).collect::<Vec<_>>();
    made.into_iter().map(|corners| Ok(PyArray2::from_vec2(py, &rows(corners))?)).collect()
}

/// The loops of the region that polygons bound under a rule.
#[pyfunction]
pub(super) fn resolved_polygons<'py>(
    py: Python<'py>,
    polygons: Vec<PyReadonlyArray2<'py, f64>>,
    rule: &str,
) -> PyResult<Polygons<'py>> {
    let loops = loops(&polygons);
    arrays(py, || resolved(loops, Rule::named(rule)?))
}

/// A Boolean of two regions.
#[pyfunction]
pub(super) fn combined_polygons<'py>(
    py: Python<'py>,
    op: &str,
    first: Vec<PyReadonlyArray2<'py, f64>>,
    second: Vec<PyReadonlyArray2<'py, f64>>,
) -> PyResult<Polygons<'py>> {
    let (first, second) = (loops(&first), loops(&second));
    arrays(py, || combined(op, &first, &second))
}

/// The points within a distance of a region.
#[pyfunction]
pub(super) fn offset_polygons<'py>(
    py: Python<'py>,
    polygons: Vec<PyReadonlyArray2<'py, f64>>,
    distance: f64,
) -> PyResult<Polygons<'py>> {
    let loops = loops(&polygons);
    arrays(py, || offset(&loops, distance))
}
