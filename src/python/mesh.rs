//! `fieldbake._core.Mesh`.

use super::convert::{row_array, rows};
use super::error::Failure;
use crate::mesh;
use numpy::ndarray::ArrayView2;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;

/// Checked triangles; the search tree is built at the first query and kept.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Mesh(pub Arc<mesh::Mesh>);

#[pymethods]
impl Mesh {
    #[new]
    fn new(py: Python<'_>, vertices: PyReadonlyArray2<'_, f64>, faces: PyReadonlyArray2<'_, i64>) -> PyResult<Self> {
        let (vertices, faces) = (rows(&vertices, "vertices")?, rows(&faces, "faces")?);
        let mesh = py.detach(|| mesh::Mesh::new(vertices, faces)).map_err(Failure::from)?;
        Ok(Self(Arc::new(mesh)))
    }

    /// A read-only view of the core's own array; the mesh lives as long as the view.
    #[getter]
    fn vertices<'py>(mesh: Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let vertices = mesh.get().0.world_positions();
        let view = ArrayView2::from_shape((vertices.len(), 3), vertices.as_flattened());
        let view = view.expect("the flat array has three numbers a row");
        // SAFETY: the array is that of a frozen class, which never changes or moves it; the view keeps the object alive
        // and is made read-only before anybody sees it.
        let array = unsafe { PyArray2::borrow_from_array(&view, mesh.clone().into_any()) };
        array.readwrite().make_nonwriteable();
        Ok(array)
    }

    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        row_array(py, self.0.faces().iter().copied())
    }

    #[getter]
    fn source_vertices<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_iter(py, self.0.source_vertices().iter().map(|&row| i64::from(row)))
    }

    #[getter]
    fn source_faces<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<i64>> {
        PyArray1::from_iter(py, self.0.source_faces().iter().map(|&row| i64::from(row)))
    }

    #[getter]
    fn center<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &self.0.center().to_array())
    }

    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        row_array(py, self.0.bounds().into_iter().map(|corner| corner.to_array()))
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.0.bytes()
    }

    fn topology<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let mesh = self.0.clone();
        let topology = py.detach(|| mesh.topology());
        let facts = PyDict::new(py);
        facts.set_item("boundary_edges", topology.boundary_edges)?;
        facts.set_item("nonmanifold_edges", topology.nonmanifold_edges)?;
        facts.set_item("flipped_faces", topology.flipped_faces)?;
        facts.set_item("duplicate_faces", topology.duplicate_faces)?;
        facts.set_item("degenerate_faces", self.0.degenerate_faces().len())?;
        facts.set_item("dropped_vertices", self.0.dropped_vertices())?;
        facts.set_item("components", topology.components)?;
        facts.set_item("closed", topology.closed)?;
        Ok(facts)
    }
}
