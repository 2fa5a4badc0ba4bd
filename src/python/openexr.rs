//! `fieldbake._core.exr_*`: OpenEXR files of one channel, as bytes.

use super::error::Failure;
use super::run::run;
use crate::encoding::Encoding;
use crate::openexr;
use numpy::PyReadonlyArray1;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// An OpenEXR file of one channel; `texels` (height, width, bytes).
#[pyfunction]
pub(super) fn exr_write<'py>(
    py: Python<'py>,
    texels: PyReadonlyArray1<'py, u8>,
    width: usize,
    height: usize,
    encoding: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let texels = texels.as_slice()?;
    let bytes = run(py, None, |_| openexr::write_exr(width, height, encoding, texels))?;
    Ok(PyBytes::new(py, &bytes))
}

/// The texels of an OpenEXR file of one channel and of this size.
#[pyfunction]
pub(super) fn exr_read<'py>(
    py: Python<'py>,
    bytes: &[u8],
    width: usize,
    height: usize,
    encoding: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let texels = run(py, None, |_| openexr::read_exr(bytes, width, height, encoding))?;
    Ok(PyBytes::new(py, &texels))
}
