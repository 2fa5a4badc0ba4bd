//! Quadrics from Python, as rows.

use super::error::exception;
use crate::quadric::Quadric;
use glam::{DMat4, DVec3};
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;

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
