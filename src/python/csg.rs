//! `fieldbake._core.Shape`.

use super::convert::{Field, grid, points, row_array, volume_array};
use super::device::choose;
use super::error::Failure;
use super::render::{PictureArguments, images_of};
use super::run::{run, run_owned};
use crate::csg;
use crate::csg::device::draw::{DrawMethod, draw, tracer};
use crate::csg::evaluation::program::LocalFrame;
use crate::csg::parts::decompose::shape_of;
use crate::csg::parts::part::{Method, structure};
use crate::csg::parts::solid::Solid;
use crate::csg::text::graph::{Graph, Node};
use crate::csg::text::language;
use crate::csg::text::shader::shader;
use crate::csg::text::volume_image::image;
use crate::csg::tree::kind::{Blend, Op};
use crate::csg::tree::profile::Profile;
use crate::csg::tree::region::Rule;
use crate::csg::tree::volume_leaf::{DividedCells, VolumeLeaf};
use crate::error::{Error, ShapeError};
use crate::shader_text::translation::Language;
use crate::volume::Trilinear;
use glam::DVec3;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray1, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::collections::HashSet;
use std::sync::{Arc, OnceLock};

/// A CSG tree. It is compiled at the first evaluation and kept.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Shape {
    shape: csg::Shape,
    solid: OnceLock<Arc<Solid>>,
}

/// Boxes of a decomposition, and the end of the boxes of each part.
type PartArrays<'py> = (Bound<'py, PyArray3<f64>>, Vec<usize>);

/// The name, the inputs and the value of each node of a graph, the node of the distance, and the samples of the volumes
/// (nx, ny, nz). The value of an image is the index of its volume.
type GraphLists<'py> = (Vec<&'static str>, Vec<[u32; 4]>, Vec<f64>, u32, Vec<Bound<'py, PyArray3<f32>>>);

impl Shape {
    fn of(shape: csg::Shape) -> Self {
        Self { shape, solid: OnceLock::new() }
    }

    fn made(shape: Result<csg::Shape, ShapeError>) -> PyResult<Self> {
        Ok(Self::of(shape.map_err(Failure::from)?))
    }

    /// The shape, compiled in given local units.
    pub(super) fn placed(&self, py: Python<'_>, center: [f64; 3], scale: f64) -> PyResult<Arc<Solid>> {
        let frame = LocalFrame { center: DVec3::from_array(center), scale };
        Ok(Arc::new(py.detach(|| Solid::placed(&self.shape, frame)).map_err(Failure::from)?))
    }

    pub(super) fn solid(&self, py: Python<'_>) -> PyResult<Arc<Solid>> {
        if let Some(solid) = self.solid.get() {
            return Ok(solid.clone());
        }
        let made = py.detach(|| Solid::new(&self.shape)).map_err(Failure::from)?;
        Ok(self.solid.get_or_init(|| Arc::new(made)).clone())
    }
}

/// A profile by its kind and numbers. `counts` has the number of corners of each polygon.
fn profile(kind: &str, numbers: &[f64], counts: &[usize]) -> Result<Arc<Profile>, ShapeError> {
    let made = match (kind, numbers) {
        ("circle", &[radius]) => Profile::circle(radius),
        ("rectangle", &[width, height]) => Profile::rectangle([width, height]),
        _ => {
            let mut rest: &[[f64; 2]] = numbers.as_chunks().0;
            let loops = counts.iter().map(|&count| rest.split_off(..count).unwrap_or_default());
            Profile::polygon(&loops.collect::<Vec<_>>(), Rule::EvenOdd)
        }
    };
    Ok(Arc::new(made?))
}

#[pymethods]
impl Shape {
    #[staticmethod]
    fn primitive(name: &str, numbers: Vec<f64>) -> PyResult<Self> {
        Self::made(csg::tree::primitive::Primitive::named(name, &numbers).map(csg::Shape::primitive))
    }

    #[staticmethod]
    fn extrude(
        py: Python<'_>,
        kind: &str,
        numbers: Vec<f64>,
        counts: Vec<usize>,
        height: f64,
        taper_deg: f64,
        chamfer: [f64; 2],
    ) -> PyResult<Self> {
        let made = || csg::Shape::extrude(profile(kind, &numbers, &counts)?, height, taper_deg, chamfer);
        Self::made(py.detach(made))
    }

    #[staticmethod]
    fn revolve(py: Python<'_>, kind: &str, numbers: Vec<f64>, counts: Vec<usize>, offset: f64) -> PyResult<Self> {
        Self::made(py.detach(|| csg::Shape::revolve(profile(kind, &numbers, &counts)?, offset)))
    }

    #[staticmethod]
    #[pyo3(signature = (distances, lower, upper, error=None, divided=None))]
    fn volume(
        distances: PyReadonlyArray3<'_, f32>,
        lower: [f64; 3],
        upper: [f64; 3],
        error: Option<f64>,
        divided: Option<(PyReadonlyArray1<'_, u64>, PyReadonlyArray1<'_, f32>)>,
    ) -> PyResult<Self> {
        let field = Field::new(&distances, lower, upper)?;
        let view = field.view().map_err(Failure::from)?;
        let divided = match divided {
            Some((cells, samples)) => {
                let cells: Vec<usize> = cells.as_array().iter().map(|&cell| cell as usize).collect();
                DividedCells::new(view.grid(), &cells, samples.as_array().to_vec()).map_err(Failure::from)?
            }
            None => DividedCells::default(),
        };
        let leaf = VolumeLeaf::new(*view.grid(), view.distances().to_vec(), divided, error).map_err(Failure::from)?;
        Ok(Self::of(csg::Shape::volume(leaf)))
    }

    #[staticmethod]
    fn combine(py: Python<'_>, op: &str, shapes: Vec<Py<Self>>, k: f64, chamfer: f64) -> PyResult<Self> {
        let known = Op::ALL.into_iter().find(|known| known.name() == op);
        let op = known.ok_or_else(|| Failure::from(ShapeError::argument("op", format!("there is no {op}"))))?;
        let shapes = shapes.iter().map(|shape| shape.borrow(py).shape.clone()).collect();
        Self::made(Blend::new(k, chamfer).and_then(|blend| csg::Shape::combine(op, blend, shapes)))
    }

    #[staticmethod]
    fn parse(py: Python<'_>, text: &str) -> PyResult<Self> {
        Self::made(py.detach(|| language::parse(text)))
    }

    fn changed(&self, name: &str, numbers: Vec<f64>) -> PyResult<Self> {
        Self::made(self.shape.changed(name, &numbers))
    }

    fn stencil(&self, mask: &Self, color: [f64; 3], outside: bool) -> PyResult<Self> {
        Self::made(self.shape.stencil(&mask.shape, color, outside))
    }

    fn reblended(&self, k: f64, chamfer: f64) -> PyResult<Self> {
        Self::made(Blend::new(k, chamfer).and_then(|blend| self.shape.reblended(blend)))
    }

    fn aligned(&self, anchor: [f64; 3]) -> PyResult<Self> {
        Self::made(csg::model::align::aligned(&self.shape, DVec3::from_array(anchor)))
    }

    fn to_sexpr(&self) -> PyResult<String> {
        Ok(language::to_sexpr(&self.shape).map_err(Failure::from)?)
    }

    /// Lower and upper corner of the bounding box.
    fn bounds(&self, py: Python<'_>) -> PyResult<([f64; 3], [f64; 3])> {
        let [lower, upper] = self.solid(py)?.bounds().map_err(Failure::from)?;
        Ok((lower.to_array(), upper.to_array()))
    }

    #[getter]
    fn is_exact(&self, py: Python<'_>) -> PyResult<bool> {
        Ok(self.solid(py)?.model.is_exact)
    }

    #[getter]
    fn field_kind(&self) -> &'static str {
        self.shape.field_kind().name()
    }

    #[getter]
    fn field_error(&self) -> f64 {
        self.shape.field_error()
    }

    /// Whether a size in the tree is in units of a field that is no distance.
    #[getter]
    fn is_misused(&self) -> bool {
        self.shape.is_misused()
    }

    /// The factor and the operand, if the root multiplies a field.
    fn without_factor(&self) -> Option<(f64, Self)> {
        match self.shape.kind() {
            csg::tree::kind::Kind::Times(factor) => Some((*factor, Self::of(self.shape.children()[0].clone()))),
            _ => None,
        }
    }

    /// The operands of the root, if it combines several, and the word of its operator.
    fn operands(&self) -> Option<(&'static str, Vec<Self>)> {
        match self.shape.kind() {
            csg::tree::kind::Kind::Combine { op, .. } => {
                Some((op.name(), self.shape.children().iter().cloned().map(Self::of).collect()))
            }
            _ => None,
        }
    }

    #[getter]
    fn lipschitz(&self, py: Python<'_>) -> PyResult<f64> {
        Ok(self.solid(py)?.model.lipschitz)
    }

    #[getter]
    fn evaluated_leaves(&self) -> u64 {
        self.shape.evaluated_leaves()
    }

    #[getter]
    fn leaf_count(&self) -> u64 {
        self.shape.leaf_count()
    }

    fn distance<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        device: &str,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let place = choose(py, device)?;
        let solid = self.solid(py)?;
        let values = run(py, None, |progress| solid.distances_at(&place, &points, progress))?;
        Ok(values.into_pyarray(py))
    }

    fn distance_float64<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
        device: &str,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        choose(py, device)?;
        let solid = self.solid(py)?;
        let values = run(py, None, |progress| solid.precise_distances(&points, progress))?;
        Ok(values.into_pyarray(py))
    }

    fn gradient<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let solid = self.solid(py)?;
        let slopes = run(py, None, |progress| solid.gradients(&points, progress))?;
        row_array(py, slopes.into_iter())
    }

    /// Linear RGB at points, (n, 3); NaN where the shape is not painted.
    fn color<'py>(
        &self,
        py: Python<'py>,
        #[pyo3(from_py_with = points)] points: Vec<DVec3>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let solid = self.solid(py)?;
        let colors = py.detach(|| points.iter().map(|&p| solid.color(p).unwrap_or([f32::NAN; 3])).collect::<Vec<_>>());
        row_array(py, colors.into_iter())
    }

    #[pyo3(signature = (lower, upper, shape, *, device="auto", progress=None))]
    fn bake<'py>(
        &self,
        py: Python<'py>,
        lower: [f64; 3],
        upper: [f64; 3],
        shape: [usize; 3],
        device: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(Bound<'py, PyArray3<f32>>, String)> {
        let place = choose(py, device)?;
        let grid = grid(lower, upper, shape)?;
        let solid = self.solid(py)?;
        let samples = run(py, progress, |progress| solid.bake_at(&place, &grid, progress))?;
        Ok((volume_array(py, samples, shape)?, place.label()))
    }

    /// The field in a shading language, and the parameters that it reads.
    fn shader<'py>(&self, py: Python<'py>, language: &str) -> PyResult<(String, Bound<'py, PyArray1<f32>>)> {
        let language = Language::from_name(language).map_err(ShapeError::from).map_err(Failure::from)?;
        let solid = self.solid(py)?;
        let shader = shader(&solid).map_err(Failure::from)?;
        let text = py.detach(|| shader.text(language)).map_err(Failure::from)?;
        Ok((text, shader.numbers.into_pyarray(py)))
    }

    /// The field as a graph of operations; None if it has no graph.
    fn graph<'py>(&self, py: Python<'py>) -> PyResult<Option<GraphLists<'py>>> {
        let solid = self.solid(py)?;
        let Some(graph) = py.detach(|| Graph::of(&solid.model)) else { return Ok(None) };
        let nodes = &graph.nodes;
        let value = |node: &Node| node.value().or(node.image().map(|index| index as f64)).unwrap_or(0.0);
        let images = graph.images.iter().map(|volume| {
            let (values, shape) = image(volume);
            volume_array(py, values, shape)
        });
        Ok(Some((
            nodes.iter().map(|node| node.name).collect(),
            nodes.iter().map(|node| node.inputs).collect(),
            nodes.iter().map(value).collect(),
            graph.result,
            images.collect::<PyResult<_>>()?,
        )))
    }

    /// The boxes of all parts (n, 2, 3), and the ranges of the boxes of each part.
    fn decompose<'py>(&self, py: Python<'py>, method: &str) -> PyResult<PartArrays<'py>> {
        let method = Method::from_name(method).map_err(Failure::from)?;
        let solid = self.solid(py)?;
        let (corners, firsts) = run_owned(py, move |_| {
            let parts = solid.parts(method)?;
            let boxes = parts.iter().flat_map(|part| &part.boxes);
            let corners: Vec<f64> = boxes.flatten().flat_map(|corner| corner.to_array()).collect();
            let ends = parts.iter().scan(0, |end, part| {
                *end += part.boxes.len();
                Some(*end)
            });
            let firsts: Vec<usize> = std::iter::once(0).chain(ends).collect();
            Ok::<_, Error>((corners, firsts))
        })?;
        let boxes = corners.len() / 6;
        Ok((corners.into_pyarray(py).reshape([boxes, 2, 3])?, firsts))
    }

    /// Number of different structures among the parts.
    fn structures(&self, py: Python<'_>, method: &str) -> PyResult<usize> {
        let method = Method::from_name(method).map_err(Failure::from)?;
        let solid = self.solid(py)?;
        let count = run_owned(py, move |_| {
            let parts = solid.parts(method)?;
            let structures: HashSet<_> = parts.iter().map(|part| structure(&solid.model, &part.tokens)).collect();
            Ok::<_, Error>(structures.len())
        })?;
        Ok(count)
    }

    /// The shape of a part.
    fn part(&self, py: Python<'_>, method: &str, index: usize) -> PyResult<Self> {
        let method = Method::from_name(method).map_err(Failure::from)?;
        let solid = self.solid(py)?;
        let parts = solid.parts(method).map_err(Failure::from)?;
        let part = parts.get(index).ok_or_else(|| {
            Failure::from(ShapeError::argument("index", format!("{index}, but there are {} parts", parts.len())))
        })?;
        Self::made(shape_of(&solid.model, &part.tokens))
    }

    /// Draws a picture. The result has the keys of `raymarch` and the cost.
    #[pyo3(signature = (method, picture, device, progress=None))]
    fn draw<'py>(
        &self,
        py: Python<'py>,
        method: &str,
        picture: PictureArguments<'py>,
        device: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let method = DrawMethod::from_name(method).map_err(Failure::from)?;
        let place = choose(py, device)?;
        let (camera, options) = picture.read()?;
        let solid = self.solid(py)?;
        let start = std::time::Instant::now();
        let drawing = run(py, progress, |progress| {
            let tracer = tracer(&place, &solid, method)?;
            draw(&place, &tracer, &camera, &options, progress)
        })?;
        let images = images_of(py, drawing.frame, &place, start)?;
        images.set_item("parts", drawing.parts)?;
        images.set_item("boxes", drawing.boxes)?;
        images.set_item("leaf_evaluations", drawing.leaf_evaluations)?;
        images.set_item("structures", drawing.structures)?;
        images.set_item("compiled", drawing.is_compiled)?;
        images.set_item("pipelines", drawing.pipelines)?;
        Ok(images)
    }

    fn __eq__(&self, other: &Self) -> bool {
        self.shape == other.shape
    }
}
