//! `fieldbake._core.Surface` and `SurfaceBlocks`.

use super::convert::{Field, grid, owned_rows, points, rows, with_texels};
use super::csg::Shape;
use super::error::{Failure, exception};
use super::mesh::Mesh;
use super::run::{run, run_owned};
use super::sparse::SparseField;
use crate::csg::{ShapeSurface, level_surface, planes_around_of_shape, planes_of_shape};
use crate::error::{ArgumentError, Error};
use crate::progress::Progress;
use crate::surface::{self, Crossing, ExtraPlanes, LevelSurface, MeshOptions, Probes};
use glam::DVec3;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray2, PyReadonlyArray4, PyUntypedArrayMethods};
use pyo3::prelude::*;
use rayon::prelude::*;
use std::sync::{Arc, Mutex, PoisonError};

/// The crossed cells of a level set and the tangent planes at their crossed edges. Making the mesh frees them.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Surface(Arc<Mutex<Option<State>>>);

struct State {
    surface: LevelSurface,
    crossings: Vec<Crossing>,
    extra: ExtraPlanes,
    probes: Probes,
}

impl Surface {
    fn new(py: Python<'_>, surface: LevelSurface) -> PyResult<Self> {
        let state = run_owned(py, move |_| {
            let crossings = surface.crossings();
            Ok(State { surface, crossings, extra: ExtraPlanes::default(), probes: Probes::default() })
        })?;
        Ok(Self(Arc::new(Mutex::new(Some(state)))))
    }

    /// Calls `change` without the interpreter lock.
    fn with<T: Send + 'static>(
        &self,
        py: Python<'_>,
        change: impl FnOnce(&mut State, &Progress) -> Result<T, Error> + Send + 'static,
    ) -> PyResult<T> {
        let state = self.0.clone();
        Ok(run_owned(py, move |progress| {
            // A panic leaves every plane complete, so the data stay valid.
            let mut state = state.lock().unwrap_or_else(PoisonError::into_inner);
            change(state.as_mut().ok_or_else(mesh_was_made)?, progress)
        })?)
    }
}

fn mesh_was_made() -> Error {
    ArgumentError::new("surface", "its mesh was made already".to_owned()).into()
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
            Self::new(py, run(py, None, |progress| LevelSurface::of_field(&field.view()?, level, progress))?)
        })
    }

    /// The level set of a sparse field.
    #[staticmethod]
    fn of_sparse(py: Python<'_>, field: PyRef<'_, SparseField>, level: f32) -> PyResult<Self> {
        let field = &*field;
        Self::new(py, run(py, None, |progress| field.surface(level, progress))?)
    }

    /// The level set of a shape on a grid.
    #[staticmethod]
    fn of_shape(
        py: Python<'_>,
        shape: PyRef<'_, Shape>,
        lower: [f64; 3],
        upper: [f64; 3],
        voxels: [usize; 3],
        level: f32,
    ) -> PyResult<(Self, usize)> {
        let (solid, grid) = (shape.solid(py)?, grid(lower, upper, voxels)?);
        let (surface, missed) = run_owned(py, move |progress| {
            let ShapeSurface { mut surface, missed } = level_surface(&solid, &grid, level, progress)?;
            // The box of the solid bounds the level zero and all levels below it.
            if let (true, Ok(bounds)) = (level <= 0.0, solid.bounds()) {
                surface.keep_within(bounds);
            }
            Ok((surface, missed))
        })?;
        Ok((Self::new(py, surface)?, missed))
    }

    /// Uses the crossings and the tangent planes of the level set of a shape. Joins the planes around all vertices too
    /// if the mesh is to be `sharp`.
    #[pyo3(signature = (shape, level, *, sharp=true))]
    fn use_shape(&self, py: Python<'_>, shape: PyRef<'_, Shape>, level: f64, sharp: bool) -> PyResult<()> {
        let solid = shape.solid(py)?;
        self.with(py, move |state, progress| {
            let State { surface, crossings, .. } = state;
            planes_of_shape(surface, crossings, &solid, level, progress)?;
            surface.set_exact();
            if sharp {
                state.extra = planes_around_of_shape(surface, crossings, &solid, level, progress)?;
            }
            Ok(())
        })
    }

    /// Both ends of each crossed edge, (m, 3) each, and the fraction of the edge before the crossing, (m,).
    #[expect(clippy::type_complexity, reason = "a triple of arrays is what Python unpacks")]
    fn edges<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (starts, ends, shares) = self.with(py, move |state, _| {
            let edges = (0..state.crossings.len()).into_par_iter().map(|edge| state.surface.edge(edge));
            let (starts, ends) = edges.map(|edge| (edge.start.to_array(), edge.at(1.0).to_array())).unzip();
            Ok((starts, ends, state.crossings.iter().map(|crossing| f64::from(crossing.share)).collect::<Vec<_>>()))
        })?;
        Ok((owned_rows(py, starts)?, owned_rows(py, ends)?, shares.into_pyarray(py)))
    }

    /// Uses the tangent planes of the surface at a distance from a mesh.
    #[pyo3(signature = (mesh, offset, *, unsigned=false))]
    fn use_mesh(&self, py: Python<'_>, mesh: PyRef<'_, Mesh>, offset: f64, unsigned: bool) -> PyResult<()> {
        let mesh = mesh.0.clone();
        self.with(py, move |state, progress| {
            surface::planes_of_mesh(&state.surface, &mut state.crossings, &mesh, offset, unsigned, progress)
        })
    }

    /// Joins the tangent planes of the faces of a mesh around the sharp vertices. The faces must be oriented alike;
    /// `inward` tells that their normals point to the inside.
    fn join_mesh(&self, py: Python<'_>, mesh: PyRef<'_, Mesh>, inward: bool) -> PyResult<()> {
        let mesh = mesh.0.clone();
        self.with(py, move |state, progress| {
            state.extra = surface::planes_around_of_mesh(&state.surface, &state.crossings, &mesh, inward, progress)?;
            Ok(())
        })
    }

    /// Joins the tangent planes of the surface at a distance from a mesh around all vertices. Returns False, and joins
    /// none, if the distance is too small for that.
    fn join_offset(&self, py: Python<'_>, mesh: PyRef<'_, Mesh>, offset: f64, unsigned: bool) -> PyResult<bool> {
        let mesh = mesh.0.clone();
        self.with(py, move |state, progress| {
            let State { surface, crossings, .. } = state;
            let planes = surface::planes_around_of_offset(surface, crossings, &mesh, offset, unsigned, progress)?;
            let is_joined = planes.is_some();
            state.extra = planes.unwrap_or_default();
            Ok(is_joined)
        })
    }

    /// Uses the tangent planes through `points` with `normals`, (m, 3) each; a row that is not finite keeps its plane.
    fn use_planes(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        #[pyo3(from_py_with = points)] normals: Vec<DVec3>,
    ) -> PyResult<()> {
        self.with(py, move |state, _| {
            check_rows(&points, &normals, state.crossings.len())?;
            let rows = points.par_iter().zip(&normals).enumerate();
            state.crossings.par_iter_mut().zip(rows).for_each(|(crossing, (edge, (&point, normal)))| {
                if let Some(normal) = normal.try_normalize().filter(|_| point.is_finite() && !crossing.on_box) {
                    crossing.set_plane(state.surface.edge(edge).at(crossing.share), point, normal);
                }
            });
            Ok(())
        })
    }

    /// Points (k, 3) around the vertices where the source has to be evaluated; `sharp_only` leaves out those on smooth
    /// parts.
    #[pyo3(signature = (*, sharp_only=false))]
    fn probes<'py>(&self, py: Python<'py>, sharp_only: bool) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let points = self.with(py, move |state, _| {
            state.probes = state.surface.probes(&state.crossings, &state.extra, sharp_only);
            Ok(bytemuck::cast_slice(&state.probes.points).to_vec())
        })?;
        owned_rows(py, points)
    }

    /// Joins the tangent planes through `points` with `normals`, (k, 3) each, one row for each of the last probes.
    fn join_planes(
        &self,
        py: Python<'_>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        #[pyo3(from_py_with = points)] normals: Vec<DVec3>,
    ) -> PyResult<()> {
        self.with(py, move |state, _| {
            let State { surface, crossings, extra, probes } = state;
            check_rows(&points, &normals, probes.points.len())?;
            *extra = surface.join_planes(crossings, extra, probes, &points, &normals);
            *probes = Probes::default();
            Ok(())
        })
    }

    /// Vertices (n, 3), faces (m, 3) and the number of vertices that were clamped to their cell. The surface is freed.
    #[expect(clippy::type_complexity, reason = "two arrays and a count are what Python unpacks")]
    #[pyo3(signature = (*, sharp=true, capped=true))]
    fn mesh<'py>(
        &self,
        py: Python<'py>,
        sharp: bool,
        capped: bool,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<u32>>, usize)> {
        let state = self.0.lock().unwrap_or_else(PoisonError::into_inner).take().ok_or_else(mesh_was_made);
        let state = state.map_err(Failure::from)?;
        let (vertices, faces, clamped) = run_owned(py, move |progress| {
            let State { surface, crossings, extra, .. } = state;
            let mesh = surface.into_mesh(crossings, extra, MeshOptions { sharp, capped }, progress)?;
            Ok((mesh.vertices, mesh.faces, mesh.clamped))
        })?;
        Ok((owned_rows(py, bytemuck::cast_vec(vertices))?, owned_rows(py, faces)?, clamped))
    }
}

/// Checks that there is a point and a normal for each of `count` rows.
fn check_rows(points: &[DVec3], normals: &[DVec3], count: usize) -> Result<(), Error> {
    if points.len() == count && normals.len() == count {
        return Ok(());
    }
    let problem = format!("must have {count} rows, got {} and {}", points.len(), normals.len());
    Err(ArgumentError::new("points and normals", problem).into())
}

/// Blocks of samples, from which the surface is made.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct SurfaceBlocks(Mutex<Option<surface::SurfaceBlocks>>);

#[pymethods]
impl SurfaceBlocks {
    #[new]
    fn new(lower: [f64; 3], upper: [f64; 3], shape: [usize; 3], level: f32) -> PyResult<Self> {
        let blocks = surface::SurfaceBlocks::new(grid(lower, upper, shape)?, level).map_err(Failure::from)?;
        Ok(Self(Mutex::new(Some(blocks))))
    }

    /// Adds blocks of samples (k, n, n, n), z slowest, whose first cells are `origins` (k, 3).
    fn add(
        &self,
        py: Python<'_>,
        origins: PyReadonlyArray2<'_, i32>,
        values: PyReadonlyArray4<'_, f32>,
    ) -> PyResult<()> {
        let origins = rows(&origins, "origins")?;
        let side = values.shape()[1].saturating_sub(1);
        let flat = values.as_slice().ok().filter(|_| values.shape()[1..].iter().all(|&n| n == side + 1 && n > 1));
        let flat = flat.ok_or_else(|| {
            let message = "values: must be a C-contiguous (k, n, n, n) array with n of at least 2";
            exception(py, "ArgumentError", message.to_owned())
        })?;
        Ok(run(py, None, |_| {
            let mut blocks = self.0.lock().unwrap_or_else(PoisonError::into_inner);
            blocks.as_mut().ok_or_else(mesh_was_made)?.add(side, origins, flat)
        })?)
    }

    /// The level set in all blocks, which are freed.
    fn surface(&self, py: Python<'_>) -> PyResult<Surface> {
        let blocks = self.0.lock().unwrap_or_else(PoisonError::into_inner).take().ok_or_else(mesh_was_made);
        let blocks = blocks.map_err(Failure::from)?;
        Surface::new(py, run_owned(py, move |_| Ok(blocks.surface()))?)
    }
}
