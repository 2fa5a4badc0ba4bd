//! Conversion of arrays between Python and the core.

use super::error::{Failure, exception};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::space_for;
use crate::volume::{FieldView, Texel};
use glam::DVec3;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

/// The rows of an (n, 3) array, without a copy.
pub(super) fn rows<'a, T: numpy::Element>(array: &'a PyReadonlyArray2<'_, T>, name: &str) -> PyResult<&'a [[T; 3]]> {
    let flat = array.as_slice().ok().filter(|_| array.as_array().ncols() == 3).ok_or_else(|| {
        exception(array.py(), "ArgumentError", format!("{name}: must be a C-contiguous (n, 3) array"))
    })?;
    Ok(flat.as_chunks().0)
}

/// A volume of shape (nx, ny, nz) with x fastest, as a view of the buffer that Rust allocated.
pub(super) fn volume_array<T: numpy::Element>(
    py: Python<'_>,
    samples: Vec<T>,
    [nx, ny, nz]: [usize; 3],
) -> PyResult<Bound<'_, PyArray3<T>>> {
    let array = PyArray1::from_vec(py, samples).reshape([nz, ny, nx])?;
    array.permute(Some([2, 1, 0]))
}

/// The points of an (n, 3) array, without a copy.
pub(super) fn positions<'a>(array: &'a PyReadonlyArray2<'_, f64>) -> PyResult<&'a [DVec3]> {
    Ok(bytemuck::cast_slice(rows(array, "points")?))
}

/// Converts an (n, 3) array of points for the core.
pub(super) fn points(array: &Bound<'_, PyAny>) -> PyResult<Vec<DVec3>> {
    let array: PyReadonlyArray2<'_, f64> = array.extract()?;
    let rows = rows(&array, "points")?;
    let mut points = space_for("points", rows.len()).map_err(Failure::from)?;
    points.extend(rows.iter().copied().map(DVec3::from_array));
    Ok(points)
}

/// An (n, 3) array from rows.
pub(super) fn row_array<'py, T: numpy::Element>(
    py: Python<'py>,
    rows: impl ExactSizeIterator<Item = [T; 3]>,
) -> PyResult<Bound<'py, PyArray2<T>>> {
    let count = rows.len();
    let mut flat = space_for("numbers", 3 * count).map_err(Failure::from)?;
    flat.extend(rows.flatten());
    flat.into_pyarray(py).reshape([count, 3])
}

/// An (n, 3) array that owns the buffer of its rows.
pub(super) fn owned_rows<T: numpy::Element>(py: Python<'_>, rows: Vec<[T; 3]>) -> PyResult<Bound<'_, PyArray2<T>>> {
    let count = rows.len();
    rows.into_flattened().into_pyarray(py).reshape([count, 3])
}

/// An image from its pixels, row 0 on top.
pub(super) fn image_array<'py, T: numpy::Element>(
    py: Python<'py>,
    pixels: Vec<T>,
    shape: &[usize],
) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    pixels.into_pyarray(py).reshape(shape)
}

/// A box divided into voxels.
pub(super) fn grid(lower: [f64; 3], upper: [f64; 3], shape: [usize; 3]) -> PyResult<Grid> {
    Ok(Grid::new(DVec3::from_array(lower), DVec3::from_array(upper), shape).map_err(Failure::from)?)
}

/// The shape (nx, ny, nz) and the samples of an array with x fastest, without a copy.
pub(super) fn samples<'a, T: numpy::Element>(array: &'a PyReadonlyArray3<'_, T>) -> PyResult<([usize; 3], &'a [T])> {
    let shape = std::array::from_fn(|axis| array.shape()[axis]);
    let samples = array.as_slice().ok().filter(|_| array.is_fortran_contiguous());
    let samples = samples.ok_or_else(|| {
        let message = "distances: must be (nx, ny, nz) with x fastest in memory (Fortran order)";
        exception(array.py(), "ArgumentError", message.to_owned())
    })?;
    Ok((shape, samples))
}

/// A stored field from Python: (nx, ny, nz) with x fastest, and its box.
pub(super) struct Field<'a, T = f32> {
    grid: Grid,
    samples: &'a [T],
    scale: f32,
}

impl<'a> Field<'a> {
    pub(super) fn new(distances: &'a PyReadonlyArray3<'_, f32>, lower: [f64; 3], upper: [f64; 3]) -> PyResult<Self> {
        Self::encoded(distances, lower, upper, 1.0)
    }
}

impl<'a, T: Texel + numpy::Element> Field<'a, T> {
    /// Samples in any encoding.
    pub(super) fn encoded(
        distances: &'a PyReadonlyArray3<'_, T>,
        lower: [f64; 3],
        upper: [f64; 3],
        scale: f32,
    ) -> PyResult<Self> {
        let (shape, samples) = samples(distances)?;
        Ok(Self { grid: grid(lower, upper, shape)?, samples, scale })
    }

    pub(super) fn grid(&self) -> Grid {
        self.grid
    }

    /// Samples, x fastest.
    pub(super) fn samples(&self) -> &'a [T] {
        self.samples
    }

    pub(super) fn view(&self) -> Result<FieldView<'a, T>, Error> {
        FieldView::encoded(self.grid, self.samples, self.scale)
    }
}

/// Runs `$body` with `$array` as the array of its own element type, one for each encoding.
macro_rules! with_texels {
    ($any:expr, $rank:ident, |$array:ident| $body:expr) => {{
        let any = $any;
        if let Ok($array) = any.extract::<numpy::$rank<'_, f32>>() {
            $body
        } else if let Ok($array) = any.extract::<numpy::$rank<'_, half::f16>>() {
            $body
        } else if let Ok($array) = any.extract::<numpy::$rank<'_, i16>>() {
            $body
        } else {
            let $array = any.extract::<numpy::$rank<'_, i8>>()?;
            $body
        }
    }};
}
pub(super) use with_texels;

/// Evaluates `$body` with `$texel` as the type of the samples in an encoding.
macro_rules! with_encoding {
    ($encoding:expr, $texel:ident => $body:expr) => {
        match $encoding {
            crate::encoding::Encoding::Float32 => {
                type $texel = f32;
                $body
            }
            crate::encoding::Encoding::Float16 => {
                type $texel = half::f16;
                $body
            }
            crate::encoding::Encoding::Snorm16 => {
                type $texel = i16;
                $body
            }
            crate::encoding::Encoding::Snorm8 => {
                type $texel = i8;
                $body
            }
        }
    };
}
pub(super) use with_encoding;
