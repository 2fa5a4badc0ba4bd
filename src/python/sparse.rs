//! `fieldbake._core.SparseField`, `bake_sparse`, `to_sparse`, `encode` and `decode`.

use super::bake::report_dict;
use super::cloud::PointCloud;
use super::convert::{Field, grid, points, row_array, volume_array, with_encoding, with_texels};
use super::error::{Failure, exception};
use super::mesh::Mesh;
use super::run::run;
use crate::bake::{BakeOptions, bake_cloud_sparse as bake_cloud, bake_sparse as bake};
use crate::encoding::Encoding;
use crate::error::Error;
use crate::march::bricks::MaskedBricks;
use crate::picture::{Camera, Frame, RaymarchOptions};
use crate::progress::Progress;
use crate::render::raymarch;
use crate::sign::SignMethod;
use crate::surface::LevelSurface;
use crate::volume::sparse::build::SparseOptions;
use crate::volume::sparse::{BRICK_LEN, BRICK_SAMPLES, SparseField as Sparse, brick_counts, node_grid};
use crate::volume::{SampleFilter, Texel, Trilinear, convert};
use glam::DVec3;
use half::f16;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayDyn, PyArrayMethods, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A sparse field in one of the encodings.
pub(super) enum Any {
    Float32(Sparse<f32>),
    Float16(Sparse<f16>),
    Snorm16(Sparse<i16>),
    Snorm8(Sparse<i8>),
}

/// An element type, and the variant of [`Any`] that holds it.
pub(super) trait Stored: Texel + numpy::Element {
    fn any(field: Sparse<Self>) -> Any
    where
        Self: Sized;
}

macro_rules! impl_stored {
    ($($texel:ty, $variant:ident;)*) => {$(
        impl Stored for $texel {
            fn any(field: Sparse<Self>) -> Any {
                Any::$variant(field)
            }
        }
    )*};
}
impl_stored!(f32, Float32; f16, Float16; i16, Snorm16; i8, Snorm8;);

/// Runs `$body` with the field of its own type.
macro_rules! with_field {
    ($any:expr, |$field:ident| $body:expr) => {
        match $any {
            Any::Float32($field) => $body,
            Any::Float16($field) => $body,
            Any::Snorm16($field) => $body,
            Any::Snorm8($field) => $body,
        }
    };
}

/// Bricks of samples near a surface.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct SparseField(pub(super) Any);

impl SparseField {
    /// A copy with float32 samples.
    pub fn decoded(&self) -> Sparse<f32> {
        with_field!(&self.0, |field| Sparse {
            grid: field.grid,
            band: field.band,
            scale: 1.0,
            index: field.index.clone(),
            nodes: field.nodes.clone(),
            texels: field.texels.iter().map(|texel| texel.decode(field.scale)).collect(),
        })
    }

    /// The surface where the field equals `level`.
    pub fn surface(&self, level: f32, progress: &Progress) -> Result<LevelSurface, Error> {
        with_field!(&self.0, |field| LevelSurface::of_sparse(&field.view()?, level, progress))
    }

    pub fn raymarch(&self, camera: &Camera, options: &RaymarchOptions, progress: &Progress) -> Result<Frame, Error> {
        with_field!(&self.0, |field| raymarch(MaskedBricks::new(field.view()?, progress)?, camera, options, progress))
    }
}

#[pymethods]
impl SparseField {
    /// Checks that the arrays are consistent.
    #[new]
    fn new(
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        band: f32,
        scale: f32,
        index: PyReadonlyArray3<'_, u32>,
        nodes: PyReadonlyArray3<'_, f32>,
        bricks: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let grid = grid(lower, upper, shape)?;
        let index = x_fastest(&index, "index", brick_counts(&grid))?;
        let nodes = x_fastest(&nodes, "nodes", node_grid(&grid).shape)?;
        with_texels!(bricks, PyReadonlyArray1, |texels| {
            let texels = texels.as_array().to_vec();
            let field = Sparse { grid, band, scale, index, nodes, texels };
            field.view().map_err(Failure::from)?;
            Ok(Self(Stored::any(field)))
        })
    }

    /// The arrays, copied: ``index`` (bx, by, bz), ``nodes`` (bx + 1, by + 1, bz + 1), ``bricks`` (n, 8, 8, 8).
    fn arrays<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let arrays = PyDict::new(py);
        with_field!(&self.0, |field| {
            let [x, y, z] = brick_counts(&field.grid);
            let index = field.index.clone().into_pyarray(py).reshape([z, y, x])?.permute(Some([2, 1, 0]))?;
            arrays.set_item("index", index)?;
            arrays.set_item("nodes", volume_array(py, field.nodes.clone(), node_grid(&field.grid).shape)?)?;
            arrays.set_item("bricks", brick_array(py, &field.texels)?)?;
        });
        Ok(arrays)
    }

    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        with_field!(&self.0, |field| field.grid.shape.into())
    }

    #[getter]
    fn nbytes(&self) -> usize {
        with_field!(&self.0, |field| field.bytes())
    }

    #[getter]
    fn encoding(&self) -> &'static str {
        fn name<T: Texel>(_: &Sparse<T>) -> &'static str {
            T::ENCODING.name()
        }
        with_field!(&self.0, |field| name(field))
    }

    /// Distance from the surface up to which bricks are stored, world units.
    #[getter]
    fn band(&self) -> f32 {
        with_field!(&self.0, |field| field.band)
    }

    /// Scale of the stored samples.
    #[getter]
    fn scale(&self) -> f32 {
        with_field!(&self.0, |field| field.scale)
    }

    /// Number of stored bricks of each level, finest first.
    #[getter]
    fn levels(&self) -> PyResult<Vec<usize>> {
        Ok(with_field!(&self.0, |field| field.view().map_err(Failure::from)?.bricks_by_level()).to_vec())
    }

    /// The field at points (n, 3); a proven lower bound outside the box and in empty bricks.
    #[pyo3(signature = (inner_lower, inner_upper, points, *, filter="linear"))]
    fn sample<'py>(
        &self,
        py: Python<'py>,
        inner_lower: [f64; 3],
        inner_upper: [f64; 3],
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        filter: &str,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let filter = SampleFilter::from_name(filter).map_err(Failure::from)?;
        let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
        let values = run(py, None, |progress| {
            with_field!(&self.0, |field| field.view()?.sample(&points, inner, filter, progress))
        })?;
        Ok(values.into_pyarray(py))
    }

    /// Gradient of the field at points (n, 3).
    fn gradient<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let gradients =
            run(py, None, |progress| with_field!(&self.0, |field| field.view()?.gradients(&points, progress)))?;
        row_array(py, gradients.iter().map(glam::Vec3::to_array))
    }

    /// The field on the whole grid, (nx, ny, nz).
    fn dense<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (samples, shape) = with_field!(&self.0, |field| {
            (run(py, None, |progress| field.view()?.dense(progress))?, field.grid.shape)
        });
        volume_array(py, samples, shape)
    }
}

/// The elements of an array of this shape with x fastest, copied.
fn x_fastest<T: numpy::Element + Copy>(
    array: &PyReadonlyArray3<'_, T>,
    name: &str,
    shape: [usize; 3],
) -> PyResult<Vec<T>> {
    match array.as_slice() {
        Ok(elements) if array.is_fortran_contiguous() && array.shape() == shape => Ok(elements.to_vec()),
        _ => {
            let message = format!("{name}: must have shape {shape:?} with x fastest, got {:?}", array.shape());
            Err(exception(array.py(), "ArgumentError", message))
        }
    }
}

/// Bricks as (n, 8, 8, 8), axes x, y, z, x fastest.
fn brick_array<'py, T: numpy::Element + Copy>(py: Python<'py>, texels: &[T]) -> PyResult<Bound<'py, PyArrayDyn<T>>> {
    let side = BRICK_SAMPLES;
    let bricks = texels.to_vec().into_pyarray(py).reshape([texels.len() / BRICK_LEN, side, side, side])?;
    Ok(bricks.permute(Some([0, 3, 2, 1]))?.to_dyn().clone())
}

/// A sparse field of a mesh, and the report of the bake.
#[pyfunction]
#[pyo3(signature = (
    mesh, lower, upper, shape, *, sign="auto", thickness=None, band, tolerance=None, encoding="float32", progress=None
))]
pub(super) fn bake_sparse<'py>(
    py: Python<'py>,
    mesh: &Mesh,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    sign: &str,
    thickness: Option<f64>,
    band: f64,
    tolerance: Option<f64>,
    encoding: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(SparseField, Bound<'py, PyDict>)> {
    let mesh = mesh.0.clone();
    let grid = grid(lower, upper, shape)?;
    let sign = sign.parse::<SignMethod>().map_err(Failure::from)?;
    let options = BakeOptions { sign, band: None, thickness };
    let sparse = SparseOptions { band, tolerance };
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let (field, report) = run(py, progress, |progress| {
        with_encoding!(encoding, T => {
            let (field, report) = bake::<T>(&mesh, &grid, &options, &sparse, progress)?;
            Ok((Stored::any(field), report))
        })
    })?;
    Ok((SparseField(field), report_dict(py, &report)?))
}

/// A sparse field of a cloud, and the numbers of samples inside and undecided.
#[pyfunction]
#[pyo3(signature = (
    cloud, lower, upper, shape, *, signed, band, tolerance=None, encoding="float32", progress=None
))]
pub(super) fn bake_cloud_sparse<'py>(
    py: Python<'py>,
    cloud: &PointCloud,
    lower: [f64; 3],
    upper: [f64; 3],
    shape: [usize; 3],
    signed: bool,
    band: f64,
    tolerance: Option<f64>,
    encoding: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<(SparseField, usize, usize)> {
    let (cloud, grid) = (cloud.0.clone(), grid(lower, upper, shape)?);
    let sparse = SparseOptions { band, tolerance };
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let (field, counts) = run(py, progress, |progress| {
        with_encoding!(encoding, T => {
            let (field, counts) = bake_cloud::<T>(&cloud, &grid, signed, &sparse, progress)?;
            Ok((Stored::any(field), counts))
        })
    })?;
    Ok((SparseField(field), counts.inside, counts.undecided))
}

/// The bricks of a dense field.
#[pyfunction]
#[pyo3(signature = (
    distances, lower, upper, inner_lower, inner_upper, *, band, tolerance=None, encoding="float32", scale=1.0,
    progress=None
))]
pub(super) fn to_sparse<'py>(
    py: Python<'py>,
    distances: &Bound<'py, PyAny>,
    lower: [f64; 3],
    upper: [f64; 3],
    inner_lower: [f64; 3],
    inner_upper: [f64; 3],
    band: f64,
    tolerance: Option<f64>,
    encoding: &str,
    scale: f32,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<SparseField> {
    let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
    let sparse = SparseOptions { band, tolerance };
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    let field = with_texels!(distances, PyReadonlyArray3, |array| {
        let field = Field::encoded(&array, lower, upper, scale)?;
        run(py, progress, |progress| {
            let view = field.view()?;
            with_encoding!(encoding, T => Ok(Stored::any(view.to_sparse::<T>(inner, &sparse, progress)?)))
        })?
    });
    Ok(SparseField(field))
}

/// The scale of an encoding for a field with voxels of this longest side and a band of this width, world units.
#[pyfunction]
pub(super) fn encoding_scale(encoding: &str, voxel: f64, band: f64) -> PyResult<f32> {
    Ok(Encoding::from_name(encoding).map_err(Failure::from)?.scale(voxel, band))
}

/// Raises an error unless the scales are valid for the encoding.
#[pyfunction]
pub(super) fn check_scales(encoding: &str, scales: Vec<f32>) -> PyResult<()> {
    let encoding = Encoding::from_name(encoding).map_err(Failure::from)?;
    Ok(scales.into_iter().try_for_each(|scale| encoding.check_scale(scale)).map_err(Failure::from)?)
}

/// Distances (nx, ny, nz) in another encoding, rounded toward zero.
#[pyfunction]
pub(super) fn encode<'py>(
    py: Python<'py>,
    distances: PyReadonlyArray3<'py, f32>,
    encoding: &str,
    scale: f32,
) -> PyResult<Bound<'py, PyAny>> {
    let samples = distances.as_slice().map_err(|error| exception(py, "ArgumentError", error.to_string()))?;
    let [x, y, z] = std::array::from_fn(|axis| distances.shape()[axis]);
    with_encoding!(Encoding::from_name(encoding).map_err(Failure::from)?, T => {
        let texels: Vec<T> = run(py, None, |progress| convert(samples, progress, |d| Texel::encode(d, scale)))?;
        Ok(texels.into_pyarray(py).reshape([z, y, x])?.permute(Some([2, 1, 0]))?.into_any())
    })
}

/// Decodes the result of [`encode`].
#[pyfunction]
pub(super) fn decode<'py>(
    py: Python<'py>,
    texels: &Bound<'py, PyAny>,
    scale: f32,
) -> PyResult<Bound<'py, PyArray3<f32>>> {
    with_texels!(texels, PyReadonlyArray3, |array| {
        let shape = std::array::from_fn(|axis| array.shape()[axis]);
        let field = Field::encoded(&array, [0.0; 3], [1.0; 3], scale)?;
        let samples = run(py, None, |progress| field.view()?.decoded(progress))?;
        volume_array(py, samples, shape)
    })
}
