//! `fieldbake._core.raymarch`.

use super::convert::{Field, image_array, with_texels};
use super::device::choose;
use super::error::{Failure, exception};
use super::light::LightRow;
use super::run::run;
use super::sparse::SparseField;
use crate::gpu::Place;
use crate::picture::{Camera, Filter, Frame, Light, RaymarchOptions, Shadows};
use crate::render::raymarch as draw;
use glam::Vec3;
use numpy::PyReadonlyArray2;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::time::Instant;

/// Draws the zero level set of a field on the CPU. Returns `None` if `device` is a graphics device and `filter` is
/// "linear": a scene draws the field there.
#[pyfunction]
#[pyo3(signature = (distances, lower, upper, picture, *, filter="linear", scale=1.0, device="auto", progress=None))]
pub(super) fn raymarch<'py>(
    py: Python<'py>,
    distances: &Bound<'py, PyAny>,
    lower: [f64; 3],
    upper: [f64; 3],
    picture: PictureArguments<'py>,
    filter: &str,
    scale: f32,
    device: &str,
    progress: Option<&Bound<'py, PyAny>>,
) -> PyResult<Option<Bound<'py, PyDict>>> {
    let filter = Filter::from_name(filter).map_err(Failure::from)?;
    if matches!(choose(py, device)?, Place::Gpu(_)) && filter == Filter::Linear {
        return Ok(None);
    }
    let (camera, options) = picture.read()?;
    let options = RaymarchOptions { filter, ..options };
    let start = Instant::now();
    let frame = if let Ok(field) = distances.cast::<SparseField>() {
        let field = field.get();
        run(py, progress, |progress| field.raymarch(&camera, &options, progress))?
    } else {
        with_texels!(distances, PyReadonlyArray3, |array| {
            let field = Field::encoded(&array, lower, upper, scale)?;
            run(py, progress, |progress| draw(field.view()?, &camera, &options, progress))?
        })
    };
    images_of(py, frame, &Place::Cpu, start).map(Some)
}

/// The arguments of a picture: a mapping, described in `_core.pyi`. The Python layer defines every default.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct PictureArguments<'py> {
    pose: PyReadonlyArray2<'py, f64>,
    fov_deg: f64,
    height: Option<f64>,
    size: [u32; 2],
    lights: Vec<LightRow>,
    ambient: f32,
    color: [f32; 3],
    specular: f32,
    shininess: f32,
    background: [f32; 4],
    shadows: String,
}

impl PictureArguments<'_> {
    pub(super) fn read(self) -> PyResult<(Camera, RaymarchOptions)> {
        let camera = camera(&self.pose, self.fov_deg, self.height)?;
        let options = RaymarchOptions {
            size: self.size,
            lights: self.lights.into_iter().map(Light::from).collect(),
            ambient: self.ambient,
            color: Vec3::from_array(self.color),
            specular: self.specular,
            shininess: self.shininess,
            background: self.background,
            shadows: Shadows::from_name(&self.shadows).map_err(Failure::from)?,
            filter: Filter::default(),
        };
        Ok((camera, options))
    }
}

/// A camera; the height of the picture in world units makes its rays parallel.
pub(super) fn camera(pose: &PyReadonlyArray2<'_, f64>, fov_deg: f64, height: Option<f64>) -> PyResult<Camera> {
    let pose = pose_matrix(pose)?;
    let camera = match height {
        None => Camera::from_pose(&pose, fov_deg),
        Some(height) => Camera::orthographic(&pose, height),
    };
    Ok(camera.map_err(Failure::from)?)
}

fn pose_matrix(pose: &PyReadonlyArray2<'_, f64>) -> PyResult<[[f64; 4]; 4]> {
    let pose_array = pose.as_array();
    if pose_array.shape() != [4, 4] {
        let message = format!("pose: must be a (4, 4) matrix, got shape {:?}", pose_array.shape());
        return Err(exception(pose.py(), "ArgumentError", message));
    }
    Ok(std::array::from_fn(|row| std::array::from_fn(|column| pose_array[[row, column]])))
}

/// The arrays of a frame, its device and its duration.
pub(super) fn images_of<'py>(
    py: Python<'py>,
    frame: Frame,
    place: &Place,
    start: Instant,
) -> PyResult<Bound<'py, PyDict>> {
    let seconds = start.elapsed().as_secs_f64();
    let images = frame_dict(py, frame)?;
    images.set_item("device", place.label())?;
    images.set_item("seconds", seconds)?;
    Ok(images)
}

pub(super) fn frame_dict<'py>(py: Python<'py>, frame: Frame) -> PyResult<Bound<'py, PyDict>> {
    let (height, width) = (frame.height, frame.width);
    let images = PyDict::new(py);
    images.set_item("color", image_array(py, frame.color, &[height, width, 4])?)?;
    images.set_item("depth", image_array(py, frame.depth, &[height, width])?)?;
    images.set_item("normal", image_array(py, frame.normal, &[height, width, 3])?)?;
    images.set_item("object_id", image_array(py, frame.object_id, &[height, width])?)?;
    let shadow_shape = [height, width, frame.lights];
    let shadow_shape = if frame.lights == 1 { &shadow_shape[..2] } else { &shadow_shape };
    images.set_item("shadow", image_array(py, frame.shadow, shadow_shape)?)?;
    images.set_item("steps", image_array(py, frame.steps, &[height, width])?)?;
    Ok(images)
}
