//! `fieldbake._core.Quadrics`.

use super::device::choose;
use super::error::{Failure, exception};
use super::render::{PictureArguments, images_of};
use super::run::run;
use crate::quadric::draw::draw_at;
use crate::quadric::{Quadric, Quadrics as Core};
use glam::{DMat4, DVec3};
use numpy::{IntoPyArray, PyArray1, PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

/// Quadrics prepared for rays.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Quadrics(pub Core);

/// Number of values in a row.
const ROW: usize = 24;

/// Quadrics from rows: matrix (16), centre (3), radius, reflectance (3), opacity.
pub(super) fn quadric_rows(rows: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Quadric>> {
    let flat = rows.as_slice().ok().filter(|_| rows.shape()[1] == ROW);
    let flat = flat.ok_or_else(|| {
        exception(rows.py(), "ArgumentError", format!("quadrics: must be a C-contiguous (n, {ROW}) array"))
    })?;
    let quadric = |row: &[f64; ROW]| Quadric {
        matrix: DMat4::from_cols_slice(&row[..16]),
        center: DVec3::from_slice(&row[16..19]),
        radius: row[19],
        reflectance: DVec3::from_slice(&row[20..23]).as_vec3(),
        opacity: row[23] as f32,
    };
    Ok(flat.as_chunks().0.iter().map(quadric).collect())
}

#[pymethods]
impl Quadrics {
    #[new]
    fn new(py: Python<'_>, rows: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let quadrics = quadric_rows(&rows)?;
        Ok(Self(py.detach(|| Core::new(&quadrics)).map_err(Failure::from)?))
    }

    fn __len__(&self) -> usize {
        self.0.len()
    }

    /// Draws the nearest sheets.
    #[pyo3(signature = (picture, device, progress=None))]
    fn draw<'py>(
        &self,
        py: Python<'py>,
        picture: PictureArguments<'py>,
        device: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let place = choose(py, device)?;
        let (camera, options) = picture.read()?;
        let start = Instant::now();
        let frame = run(py, progress, |progress| draw_at(&place, &self.0, &camera, &options, progress))?;
        images_of(py, frame, &place, start)
    }

    /// Lower bound on the distance to the nearest quadric at points (n, 3).
    fn distance_bound<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = super::convert::points)] points: Vec<DVec3>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let bounds = run(py, None, |progress| self.0.distance_bounds(&points, progress))?;
        Ok(bounds.into_pyarray(py))
    }
}
