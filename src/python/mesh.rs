//! `fieldbake._core.Mesh`.

use super::convert::{owned_rows, row_array, rows};
use super::error::Failure;
use super::run::{run, run_owned};
use crate::bake::sign_warnings;
use crate::error::Error;
use crate::memory::require_rows;
use crate::mesh;
use crate::sign::SignMethod;
use crate::solid::{count_self_intersections, deviation};
use numpy::ndarray::ArrayView2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::sync::{Arc, Mutex, TryLockError};
use std::time::Duration;

/// Number of faces from which a mesh is made by a job that may be left in the background: its checks may last longer
/// than a tenth of a second.
const LARGE: usize = 1 << 21;
/// Memory of the arrays of a mesh, bytes for each face.
const BYTES_PER_INPUT_FACE: usize = 64;

/// Checked triangles; the search tree is built at the first query and kept.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Mesh(pub Arc<mesh::Mesh>);

/// Indices of the corners of faces, (m, 3).
#[derive(FromPyObject)]
enum Indices<'py> {
    Short(PyReadonlyArray2<'py, u32>),
    Long(PyReadonlyArray2<'py, i64>),
}

impl Mesh {
    fn checked<I: Copy + Send + Sync + Into<i64> + 'static>(
        py: Python<'_>,
        vertices: &[[f64; 3]],
        faces: &[[I; 3]],
    ) -> PyResult<Self> {
        let mesh = if vertices.len().max(faces.len()) < mesh::PARALLEL_ITEMS {
            py.detach(|| mesh::Mesh::of(vertices, faces)).map_err(Failure::from)?
        } else if faces.len() < LARGE {
            run(py, None, |_| Ok(mesh::Mesh::of(vertices, faces)?))?
        } else {
            // A job that may be left in the background owns its arrays.
            require_rows::<[u8; 2 * BYTES_PER_INPUT_FACE]>("faces", faces.len()).map_err(Failure::from)?;
            let (vertices, faces) = (vertices.to_vec(), faces.to_vec());
            run_owned(py, move |_| Ok(mesh::Mesh::of(&vertices, &faces)?))?
        };
        Ok(Self(Arc::new(mesh)))
    }
}

#[pymethods]
impl Mesh {
    #[new]
    fn new(py: Python<'_>, vertices: PyReadonlyArray2<'_, f64>, faces: Indices<'_>) -> PyResult<Self> {
        let vertices = rows(&vertices, "vertices")?;
        match faces {
            Indices::Short(faces) => Self::checked(py, vertices, rows(&faces, "faces")?),
            Indices::Long(faces) => Self::checked(py, vertices, rows(&faces, "faces")?),
        }
    }

    /// A read-only view of the core's own array. The view keeps the mesh alive.
    #[getter]
    fn vertices<'py>(mesh: Bound<'py, Self>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let vertices = mesh.get().0.world_positions();
        let view = ArrayView2::from_shape((vertices.len(), 3), vertices.as_flattened());
        let view = view.expect("the flat array has three numbers a row");
        // SAFETY: the array belongs to a frozen class, which never changes or moves it; the view keeps the object alive
        // and is made read-only before any other code has it.
        let array = unsafe { PyArray2::borrow_from_array(&view, mesh.clone().into_any()) };
        array.readwrite().make_nonwriteable();
        Ok(array)
    }

    #[getter]
    fn faces<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<u32>>> {
        row_array(py, self.0.faces().iter().copied())
    }

    #[getter]
    fn source_vertices<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<i64>>> {
        self.0.source_vertices().map(|rows| PyArray1::from_iter(py, rows.iter().map(|&row| i64::from(row))))
    }

    #[getter]
    fn source_faces<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<i64>>> {
        self.0.source_faces().map(|rows| PyArray1::from_iter(py, rows.iter().map(|&row| i64::from(row))))
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

    /// The data that restores this mesh: kept vertices (n, 3); all faces in input order as rows of those (m, 3); and,
    /// if vertices were dropped, the input row of each kept one, followed by the number of input vertices.
    #[expect(clippy::type_complexity, reason = "a tuple of arrays is what Python unpacks")]
    fn state<'py>(
        mesh: Bound<'py, Self>,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>, Option<Bound<'py, PyArray1<u32>>>)> {
        let core = &mesh.get().0;
        let rows = core.source_vertices().map(|rows| {
            let count = rows.len() + core.dropped_vertices();
            PyArray1::from_iter(py, rows.iter().copied().chain([count as u32]))
        });
        let vertices = row_array(py, core.world_positions().iter().copied())?;
        Ok((vertices, row_array(py, core.input_faces().into_iter())?, rows))
    }

    /// The mesh with its kept vertices at other positions (n, 3).
    fn moved(&self, py: Python<'_>, vertices: PyReadonlyArray2<'_, f64>) -> PyResult<Self> {
        let vertices = rows(&vertices, "vertices")?;
        let (mesh, vertices) = (self.0.clone(), vertices.to_vec());
        let moved = run_owned(py, move |_| Ok(mesh.moved(&vertices)))?;
        Ok(Self(Arc::new(moved.map_err(Failure::from)?)))
    }

    /// Records of a binary STL file, 50 bytes for each of at most `count` faces from the face `first` on.
    fn stl_records<'py>(&self, py: Python<'py>, first: usize, count: usize) -> PyResult<Bound<'py, PyArray1<u8>>> {
        let mesh = &self.0;
        Ok(run(py, None, |_| Ok(mesh.stl_records(first, count)))?.into_pyarray(py))
    }

    /// Number of pairs of faces without a common vertex that intersect.
    fn self_intersections(&self, py: Python<'_>) -> PyResult<u64> {
        self.prepare(py)?;
        Ok(run(py, None, |progress| count_self_intersections(&self.0, progress))?)
    }

    /// Bounds from below and above of the largest distance from this surface to another one.
    fn deviation(&self, py: Python<'_>, other: PyRef<'_, Self>) -> PyResult<(f64, f64)> {
        self.prepare(py)?;
        other.prepare(py)?;
        let other = other.0.clone();
        let found = run(py, None, |progress| deviation(&self.0, &other, progress))?;
        Ok((found.lower, found.upper))
    }

    /// Warnings about the sign of this surface by a method. Builds the connectivity.
    fn sign_warnings(&self, py: Python<'_>, sign: &str) -> PyResult<Vec<String>> {
        let method = sign.parse::<SignMethod>().map_err(Failure::from)?;
        self.prepare(py)?;
        Ok(sign_warnings(&self.0, method))
    }

    /// Whether a connected part of this closed mesh is wound inside out. Builds the connectivity.
    fn has_reversed_body(&self, py: Python<'_>) -> PyResult<bool> {
        self.prepare(py)?;
        Ok(self.0.topology().has_reversed_body(&self.0))
    }

    fn topology<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        self.prepare(py)?;
        let topology = self.0.topology();
        let facts = PyDict::new(py);
        facts.set_item("boundary_edges", topology.boundary_edges)?;
        facts.set_item("nonmanifold_edges", topology.nonmanifold_edges)?;
        facts.set_item("flipped_faces", topology.flipped_faces)?;
        facts.set_item("duplicate_faces", topology.duplicate_faces)?;
        facts.set_item("degenerate_faces", self.0.degenerate_faces())?;
        facts.set_item("dropped_vertices", self.0.dropped_vertices())?;
        facts.set_item("components", topology.components)?;
        facts.set_item("closed", topology.closed)?;
        Ok(facts)
    }
}

/// Memory of the tree and the connectivity of a mesh while they are built, bytes for each face.
const BYTES_PER_FACE: usize = 320;

/// Fails if there is no memory for the tree and the connectivity of a mesh.
fn require(mesh: &mesh::Mesh) -> Result<(), Error> {
    require_rows::<[u8; BYTES_PER_FACE]>("faces in a search tree", mesh.faces().len())
}

impl Mesh {
    /// Builds the tree and the connectivity on the worker threads. A forked child must not use the pool of its parent.
    pub fn prepare(&self, py: Python<'_>) -> PyResult<()> {
        // One thread at a time builds: a worker that waits for its part of a tree may start a job that needs the same
        // tree.
        static PREPARING: Mutex<()> = Mutex::new(());
        if !self.0.is_prepared() {
            let _guard = loop {
                match PREPARING.try_lock() {
                    Ok(guard) => break guard,
                    Err(TryLockError::Poisoned(poisoned)) => break poisoned.into_inner(),
                    Err(TryLockError::WouldBlock) => py.detach(|| std::thread::sleep(Duration::from_millis(1))),
                }
            };
            let mesh = self.0.clone();
            run_owned(py, move |_| {
                require(&mesh)?;
                rayon::join(|| mesh.bvh(), || mesh.topology());
                Ok(())
            })?;
        }
        Ok(())
    }
}

/// The vertices and faces of a Wavefront OBJ file; None if it has materials, texture coordinates, colours or damage.
#[pyfunction]
pub(super) fn read_obj<'py>(py: Python<'py>, content: &[u8]) -> PyResult<Option<Triangles<'py>>> {
    let found = run(py, None, |progress| mesh::wavefront::read(content, progress))?;
    found.map(|found| Ok((owned_rows(py, found.vertices)?, owned_rows(py, found.faces)?))).transpose()
}

/// A Wavefront OBJ file with its polygons divided where a fan would leave their outline; None without such polygons.
#[pyfunction]
pub(super) fn divide_obj_polygons<'py>(py: Python<'py>, content: &[u8]) -> PyResult<Option<Bound<'py, PyBytes>>> {
    let divided = run(py, None, |progress| mesh::wavefront::with_divided_polygons(content, progress))?;
    Ok(divided.map(|content| PyBytes::new(py, &content)))
}

type Triangles<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<i64>>);
