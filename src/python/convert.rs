//! Arrays across the border.

use super::error::exception;
use numpy::{PyArray1, PyArray3, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;

/// The rows of an (n, 3) array, without a copy.
pub fn rows<'a, T: numpy::Element>(array: &'a PyReadonlyArray2<'_, T>, name: &str) -> PyResult<&'a [[T; 3]]> {
    let flat = array.as_slice().ok().filter(|_| array.as_array().ncols() == 3).ok_or_else(|| {
        exception(array.py(), "ArgumentError", format!("{name}: must be a C-contiguous (n, 3) array"))
    })?;
    Ok(flat.as_chunks().0)
}

/// A volume of shape (nx, ny, nz) with x fastest, as a view of the buffer that Rust filled.
pub fn volume_array<'py>(
    py: Python<'py>,
    samples: Vec<f32>,
    [nx, ny, nz]: [usize; 3],
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let array = PyArray1::from_vec(py, samples).reshape([nz, ny, nx])?;
    array.permute(Some([2, 1, 0]))
}
