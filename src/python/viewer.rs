//! `fieldbake._core.viewer_shader` and `viewer_triangles`.

use super::csg::Shape;
use super::error::Failure;
use crate::encoding::Encoding;
use crate::shader_text::translation::Language;
use crate::viewer::{ShapeFunction, ViewedKinds, shader, triangle_shaders};
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;

/// Index and numbers of a shape's function, centre and scale of its local frame, one over its Lipschitz constant.
type ShapeRow<'py> = (u32, Bound<'py, PyArray1<f32>>, [f64; 3], f64, f64);

/// The fragment shader of rays, then the vertex and the fragment shader of meshes if the view has any; and one entry
/// for each shape. `kinds`: whether the view has dense fields, sparse fields, quadrics and triangles of meshes.
/// `frame`: centre and scale of the local frame of all shapes; by default each has its own.
#[pyfunction]
#[pyo3(signature = (language, kinds, encoding, shapes, frame=None))]
pub(super) fn viewer_shader<'py>(
    py: Python<'py>,
    language: &str,
    kinds: [bool; 4],
    encoding: Option<&str>,
    shapes: Vec<Py<Shape>>,
    frame: Option<([f64; 3], f64)>,
) -> PyResult<(Vec<String>, Vec<Option<ShapeRow<'py>>>)> {
    let language = Language::from_name(language).map_err(Failure::from)?;
    let solid = |shape: &Py<Shape>| match frame {
        Some((center, scale)) => shape.get().placed(py, center, scale),
        None => shape.get().solid(py),
    };
    let solids = shapes.iter().map(solid).collect::<PyResult<Vec<_>>>()?;
    let encoding = encoding.map(Encoding::from_name).transpose().map_err(Failure::from)?;
    let [dense, sparse, quadric, mesh] = kinds;
    let kinds = ViewedKinds { dense, sparse, quadric, mesh, encoding };
    let made = shader(kinds, &solids, language).map_err(Failure::from)?;
    let row = |found: ShapeFunction| {
        (found.structure, found.numbers.into_pyarray(py), found.center, found.scale, found.inverse_lipschitz)
    };
    let texts = [made.rays].into_iter().chain(made.mesh.into_iter().flatten()).collect();
    Ok((texts, made.shapes.into_iter().map(|found| found.map(row)).collect()))
}

/// The vertex and the fragment shader for triangles of level sets.
#[pyfunction]
pub(super) fn viewer_triangles(language: &str) -> PyResult<[String; 2]> {
    let language = Language::from_name(language).map_err(Failure::from)?;
    Ok(triangle_shaders(language).map_err(Failure::from)?)
}
