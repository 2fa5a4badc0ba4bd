//! `fieldbake._core.texture_*` and `exr_*`: files for other programs, as bytes.

use super::convert::volume_array;
use super::error::{Failure, exception};
use super::run::run;
use crate::encoding::Encoding;
use crate::error::Error;
use crate::exchange::{self, Texture};
use numpy::{PyArray3, PyReadonlyArray1, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

/// A volume as the bytes of a "dds" or "ktx2" file.
#[pyfunction]
pub fn texture_write<'py>(
    py: Python<'py>,
    kind: &str,
    distances: PyReadonlyArray3<'py, f32>,
    encoding: &str,
    scale: f32,
    facts: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let size = std::array::from_fn(|axis| distances.shape()[axis] as u32);
    let samples = distances.as_slice().ok().filter(|_| distances.is_fortran_contiguous());
    let samples = samples.ok_or_else(|| exception(py, "ArgumentError", "distances: must be x fastest".into()))?;
    let bytes = run(py, None, |_| {
        // Words keep every encoding aligned.
        let mut words = vec![0u32; (samples.len() * encoding.bytes()).div_ceil(4)];
        let texels = &mut bytemuck::cast_slice_mut(&mut words)[..samples.len() * encoding.bytes()];
        encoding.encode_slice(samples, scale, texels);
        let texture = Texture { size, encoding, texels: texels.to_vec() };
        if kind == "dds" { texture.to_dds() } else { texture.to_ktx2(facts) }
    })?;
    Ok(PyBytes::new(py, &bytes))
}

/// Encoding, size, texels and metadata of a "dds" or "ktx2" file.
#[pyfunction]
pub fn texture_read<'py>(
    py: Python<'py>,
    kind: &str,
    bytes: &[u8],
) -> PyResult<(&'static str, [u32; 3], Bound<'py, PyBytes>, String)> {
    let read =
        || if kind == "dds" { Ok((Texture::from_dds(bytes)?, String::new())) } else { Texture::from_ktx2(bytes) };
    let (texture, facts) = run(py, None, |_| read())?;
    Ok((texture.encoding.name(), texture.size, PyBytes::new(py, &texture.texels), facts))
}

/// Distances (nx, ny, nz) from texels. The scale must be valid for the encoding.
#[pyfunction]
pub fn texture_decode<'py>(
    py: Python<'py>,
    texels: PyReadonlyArray1<'py, u8>,
    shape: [usize; 3],
    encoding: &str,
    scale: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let texels = texels.as_slice()?;
    let count = shape.iter().product::<usize>();
    if texels.len() != count * encoding.bytes() {
        return Err(exception(py, "FormatError", "the texels do not fill the shape".into()));
    }
    let samples = run(py, None, |_| {
        encoding.check_scale(scale)?;
        let mut samples = crate::memory::allocate_samples("a field", count, 0)?;
        encoding.decode_slice(texels, scale, &mut samples);
        Ok::<_, Error>(samples)
    })?;
    volume_array(py, samples, shape)
}

/// An OpenEXR file of one channel; `texels` (height, width, bytes).
#[pyfunction]
pub fn exr_write<'py>(
    py: Python<'py>,
    texels: PyReadonlyArray1<'py, u8>,
    width: usize,
    height: usize,
    encoding: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let texels = texels.as_slice()?;
    let bytes = run(py, None, |_| exchange::write_exr(width, height, encoding, texels))?;
    Ok(PyBytes::new(py, &bytes))
}

/// The texels of an OpenEXR file of one channel and of this size.
#[pyfunction]
pub fn exr_read<'py>(
    py: Python<'py>,
    bytes: &[u8],
    width: usize,
    height: usize,
    encoding: &str,
) -> PyResult<Bound<'py, PyBytes>> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let texels = run(py, None, |_| exchange::read_exr(bytes, width, height, encoding))?;
    Ok(PyBytes::new(py, &texels))
}
