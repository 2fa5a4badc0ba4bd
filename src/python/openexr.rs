//! `fieldbake._core.exr_read`: OpenEXR files of one channel, as bytes.

use super::error::Failure;
use super::run::run;
use crate::encoding::Encoding;
use crate::openexr;
use pyo3::prelude::*;
use pyo3::types::PyBytes;

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
