//! `fieldbake._core.Surface`.

use super::convert::{Field, grid, points, row_array, rows, with_texels};
use super::error::exception;
use super::mesh::Mesh;
use super::run::run;
use super::sparse::SparseField;
use crate::surface::{self, Crossing, ExtraPlanes, MeshOptions, Probes};
use glam::DVec3;
use numpy::{PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods};
use pyo3::prelude::*;
use std::sync::{Mutex, PoisonError};

/// The crossed cells of a level set and the tangent planes at their crossed edges.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Surface {
    surface: surface::LevelSurface,
    crossings: Mutex<Vec<Crossing>>,
    extra: Mutex<(ExtraPlanes, Probes)>,
}

impl Surface {
    fn new(surface: surface::LevelSurface) -> Self {
        let crossings = Mutex::new(surface.crossings());
        Self { surface, crossings, extra: Mutex::default() }
    }

    fn change(
        &self,
        change: impl FnOnce(&mut [Crossing]) -> Result<(), crate::error::Error>,
    ) -> Result<(), crate::error::Error> {
        // A panic in between leaves every plane complete, so the data stay valid.
        change(&mut self.crossings.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

#[pymethods]
impl Surface {
    /// The level set of samples (nx, ny, nz) in any encoding.
    #[staticmethod]
    #[pyo3(signature = (distances, lower, upper, level, *, scale=1.0))]
    fn of_field(
        py: Python<'_>,
        distances: &Bound<'_, PyAny>,
        lower: [f64; 3],
        upper: [f64; 3],
        level: f32,
        scale: f32,
    ) -> PyResult<Self> {
        with_texels!(distances, PyReadonlyArray3, |array| {
            let field = Field::encoded(&array, lower, upper, scale)?;
            Ok(run(py, None, |progress| {
                Ok(Self::new(surface::LevelSurface::of_field(&field.view()?, level, progress)?))
            })?)
        })
    }

    /// The level set of blocks of samples (k, n, n, n), z slowest, whose first cells are `origins` (k, 3).
    #[staticmethod]
    fn of_blocks(
        py: Python<'_>,
        origins: PyReadonlyArray2<'_, i32>,
        values: PyReadonlyArray4<'_, f32>,
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        level: f32,
    ) -> PyResult<Self> {
        let grid = grid(lower, upper, shape)?;
        let origins = rows(&origins, "origins")?;
        let side = values.shape()[1].saturating_sub(1);
        let flat = values.as_slice().ok().filter(|_| values.shape()[1..].iter().all(|&n| n == side + 1 && n > 1));
        let flat = flat.ok_or_else(|| {
            let message = "values: must be a C-contiguous (k, n, n, n) array with n of at least 2";
            exception(py, "ArgumentError", message.to_owned())
        })?;
        Ok(run(py, None, |_| Ok(Self::new(surface::LevelSurface::of_blocks(&grid, side, origins, flat, level)?)))?)
    }

    /// The level set of a sparse field.
    #[staticmethod]
    fn of_sparse(py: Python<'_>, field: PyRef<'_, SparseField>, level: f32) -> PyResult<Self> {
        let field = &*field;
        Ok(run(py, None, |progress| Ok(Self::new(field.surface(level, progress)?)))?)
    }

    /// Number of crossed edges.
    #[getter]
    fn edge_count(&self) -> usize {
        self.surface.edge_count()
    }

    /// Both ends of each crossed edge, (m, 3) each, and the fraction of the edge before the crossing, (m,).
    #[expect(clippy::type_complexity, reason = "a triple of arrays is what Python unpacks")]
    fn edges<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let crossings = self.crossings.lock().unwrap_or_else(PoisonError::into_inner);
        let end = |i: usize| crossings.iter().map(move |crossing| self.surface.ends(crossing)[i].to_array());
        let shares = PyArray1::from_iter(py, crossings.iter().map(|crossing| crossing.share));
        Ok((row_array(py, end(0))?, row_array(py, end(1))?, shares))
    }

    /// Uses the tangent planes of the surface at a distance from a mesh.
    #[pyo3(signature = (mesh, offset, *, unsigned=false))]
    fn use_mesh(&self, py: Python<'_>, mesh: PyRef<'_, Mesh>, offset: f64, unsigned: bool) -> PyResult<()> {
        let mesh = mesh.0.clone();
        Ok(run(py, None, |progress| {
            self.change(|crossings| {
                surface::planes_of_mesh(&self.surface, crossings, &mesh, offset, unsigned, progress)
            })
        })?)
    }

    /// Joins the tangent planes of the faces of a mesh around the sharp vertices. The faces must be oriented alike;
    /// `inward` tells that their normals point to the inside.
    fn join_mesh(&self, py: Python<'_>, mesh: PyRef<'_, Mesh>, inward: bool) -> PyResult<()> {
        let mesh = mesh.0.clone();
        Ok(run(py, None, |progress| {
            let crossings = self.crossings.lock().unwrap_or_else(PoisonError::into_inner);
            let planes = surface::planes_around_of_mesh(&self.surface, &crossings, &mesh, inward, progress)?;
            *self.extra.lock().unwrap_or_else(PoisonError::into_inner) = (planes, Probes::default());
            Ok(())
        })?)
    }

    /// Uses the tangent planes through `points` with `normals`, (m, 3) each; a row that is not finite keeps its plane.
    fn use_planes(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        #[pyo3(from_py_with = points)] normals: Vec<DVec3>,
    ) -> PyResult<()> {
        let count = self.surface.edge_count();
        if points.len() != count || normals.len() != count {
            let message =
                format!("points and normals: must have {count} rows, got {} and {}", points.len(), normals.len());
            return Err(exception(py, "ArgumentError", message));
        }
        Ok(run(py, None, |_| {
            self.change(|crossings| {
                for ((crossing, &point), &normal) in crossings.iter_mut().zip(&points).zip(&normals) {
                    let Some(normal) = normal.try_normalize().filter(|_| point.is_finite() && !crossing.on_box) else {
                        continue;
                    };
                    let outward = if normal.dot(crossing.normal) < 0.0 { -normal } else { normal };
                    (crossing.point, crossing.normal) = (point, outward);
                }
                Ok(())
            })
        })?)
    }

    /// Points (k, 3) around the vertices where the source has to be evaluated; `sharp_only` leaves out those on smooth
    /// parts.
    #[pyo3(signature = (*, sharp_only=false))]
    fn probes<'py>(&self, py: Python<'py>, sharp_only: bool) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = run(py, None, |_| {
            let crossings = self.crossings.lock().unwrap_or_else(PoisonError::into_inner);
            let mut extra = self.extra.lock().unwrap_or_else(PoisonError::into_inner);
            extra.1 = self.surface.probes(&crossings, &extra.0, sharp_only);
            Ok(extra.1.points.clone())
        })?;
        row_array(py, points.iter().map(DVec3::to_array))
    }

    /// Joins the tangent planes through `points` with `normals`, (k, 3) each, one row for each of the last probes.
    fn join_planes(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        #[pyo3(from_py_with = points)] normals: Vec<DVec3>,
    ) -> PyResult<()> {
        let count = self.extra.lock().unwrap_or_else(PoisonError::into_inner).1.points.len();
        if points.len() != count || normals.len() != count {
            let message =
                format!("points and normals: must have {count} rows, got {} and {}", points.len(), normals.len());
            return Err(exception(py, "ArgumentError", message));
        }
        Ok(run(py, None, |_| {
            let crossings = self.crossings.lock().unwrap_or_else(PoisonError::into_inner);
            let mut extra = self.extra.lock().unwrap_or_else(PoisonError::into_inner);
            let (planes, probes) = &*extra;
            *extra = (self.surface.join_planes(&crossings, planes, probes, &points, &normals), Probes::default());
            Ok(())
        })?)
    }

    /// Vertices (n, 3), faces (m, 3) and the number of vertices that were clamped to their cell.
    #[expect(clippy::type_complexity, reason = "two arrays and a count are what Python unpacks")]
    #[pyo3(signature = (*, sharp=true, capped=true))]
    fn mesh<'py>(
        &self,
        py: Python<'py>,
        sharp: bool,
        capped: bool,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>, usize)> {
        let mesh = run(py, None, |_| {
            let crossings = self.crossings.lock().unwrap_or_else(PoisonError::into_inner);
            let extra = self.extra.lock().unwrap_or_else(PoisonError::into_inner);
            Ok(self.surface.mesh(&crossings, &extra.0, MeshOptions { sharp, capped }))
        })?;
        let vertices = row_array(py, mesh.vertices.iter().map(DVec3::to_array))?;
        Ok((vertices, row_array(py, mesh.faces.into_iter())?, mesh.clamped))
    }
}
