//! `fieldbake._core.Scene` and its parts, and `Renderer`.

use super::convert::{Field, image_array, row_array};
use super::csg::Shape;
use super::device::choose;
use super::error::Failure;
use super::light::LightRow;
use super::mesh::Mesh;
use super::quadric::quadric_rows;
use super::render::{camera, frame_dict};
use super::run::{run, run_owned};
use super::sparse::SparseField;
use crate::error::SceneError;
use crate::picture::Light;
use crate::quadric;
use crate::scene;
use crate::scene::content::instance::InstanceInput;
use crate::scene::content::material::{Alpha, Material};
use crate::scene::content::options::{Ambient, BounceOptions, FarField, Primary, RenderOptions, SceneShadows};
use crate::scene::content::texture::Texture as CoreTexture;
use crate::scene::content::triangles::Triangles;
use crate::scene::fields::field::{DenseField, SampledField};
use crate::scene::fields::nested::NestedField;
use crate::scene::fields::quadric::QuadricField;
use crate::scene::fields::shape::ShapeField;
use crate::scene::fields::slope;
use crate::scene::fields::sparse::SparseBricks;
use crate::volume::Trilinear;
use glam::{DAffine3, DMat4, DVec3, Mat4, Vec2, Vec4};
use numpy::ndarray::ArrayView2;
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

/// Distances prepared for the rays of a scene.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct SceneField {
    field: Arc<dyn scene::fields::field::Field>,
    /// The number by which the samples were divided, or would be divided if the caller had not chosen the divisor.
    divisor: f64,
}

impl SceneField {
    fn distance(field: impl scene::fields::field::Field + 'static) -> Self {
        Self { field: Arc::new(field), divisor: 1.0 }
    }
}

#[pymethods]
impl SceneField {
    #[new]
    fn new(
        py: Python<'_>,
        distances: PyReadonlyArray3<'_, f32>,
        lower: [f64; 3],
        upper: [f64; 3],
        inner_lower: [f64; 3],
        inner_upper: [f64; 3],
        divisor: Option<f64>,
    ) -> PyResult<Self> {
        let field = Field::new(&distances, lower, upper)?;
        let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
        let (made, divisor) = run(py, None, |progress| {
            let view = field.view()?;
            let dense = DenseField::new(*view.grid(), view.distances().to_vec())?;
            let own = slope::divisor(dense.slope());
            Ok((SampledField::new(dense.divided(divisor.unwrap_or(own)), inner, progress)?, own))
        })?;
        Ok(Self { field: Arc::new(made), divisor })
    }

    /// The slope of the samples if it is far above the slope of a distance, else 1.
    #[getter]
    fn divisor(&self) -> f64 {
        self.divisor
    }

    /// Nested fields as one field, finest first.
    #[staticmethod]
    fn nested(levels: Vec<Py<SceneField>>) -> PyResult<Self> {
        let levels = levels.iter().map(|level| level.get().field.clone()).collect();
        Ok(Self::distance(NestedField::new(levels).map_err(Failure::from)?))
    }

    /// The bricks of a sparse field, decoded.
    #[staticmethod]
    fn sparse(py: Python<'_>, field: &SparseField, inner_lower: [f64; 3], inner_upper: [f64; 3]) -> PyResult<Self> {
        let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
        let (made, divisor) = run(py, None, |progress| {
            let mut decoded = field.decoded();
            let divisor = slope::divisor(slope::largest_slope_of_bricks(&decoded));
            slope::divide(&mut decoded.texels, divisor);
            slope::divide(&mut decoded.nodes, divisor);
            decoded.band = (f64::from(decoded.band) / divisor) as f32;
            Ok((SampledField::new(SparseBricks::new(decoded, progress)?, inner, progress)?, divisor))
        })?;
        Ok(Self { field: Arc::new(made), divisor })
    }

    /// A field for each row of quadrics.
    #[staticmethod]
    fn quadrics(rows: PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Self>> {
        let quadrics = quadric_rows(&rows)?;
        // All rows are checked at once.
        quadric::check(&quadrics).map_err(Failure::from)?;
        Ok(quadrics.iter().map(|quadric| Self::distance(QuadricField::new(quadric))).collect())
    }

    /// A shape, with the parts that rays are traced through.
    #[staticmethod]
    fn shape(py: Python<'_>, shape: &Shape) -> PyResult<Self> {
        let solid = shape.solid(py)?;
        Ok(Self::distance(run_owned(py, move |_| ShapeField::new(solid))?))
    }
}

/// Triangles with normals, texture coordinates and materials.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct SceneMesh(Arc<Triangles>);

#[pymethods]
impl SceneMesh {
    #[new]
    fn new(
        py: Python<'_>,
        mesh: &Mesh,
        uv: Option<PyReadonlyArray2<'_, f32>>,
        material: PyReadonlyArray1<'_, u32>,
        vertex_colors: Option<PyReadonlyArray2<'_, f32>>,
        face_colors: Option<PyReadonlyArray2<'_, f32>>,
    ) -> PyResult<Self> {
        let mesh = mesh.0.clone();
        let [vertex_colors, face_colors] = [vertex_colors, face_colors].map(|colors| {
            colors.map_or_else(Vec::new, |colors| {
                colors.as_array().rows().into_iter().map(|c| Vec4::new(c[0], c[1], c[2], c[3])).collect::<Vec<_>>()
            })
        });
        let uv: Vec<Vec2> = uv.map_or_else(Vec::new, |uv| {
            uv.as_array().rows().into_iter().map(|row| Vec2::new(row[0], row[1])).collect()
        });
        let material: Vec<u32> = material.as_array().to_vec();
        let made = py
            .detach(|| Triangles::new(mesh, uv, material)?.with_colors(vertex_colors, face_colors))
            .map_err(Failure::from)?;
        Ok(Self(Arc::new(made)))
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.0.bytes()
    }
}

/// An image and its smaller copies.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Texture(Arc<CoreTexture>);

#[pymethods]
impl Texture {
    #[new]
    fn new(py: Python<'_>, pixels: PyReadonlyArray3<'_, u8>) -> PyResult<Self> {
        let (height, width) = (pixels.shape()[0], pixels.shape()[1]);
        // ndarray's `as_slice` is used, because the method of NumPy also accepts arrays with columns first.
        let pixels = pixels.as_array();
        let bytes = pixels.as_slice().map_or_else(|| pixels.iter().copied().collect(), <[u8]>::to_vec);
        let made = py.detach(|| CoreTexture::new(&bytes, width, height)).map_err(Failure::from)?;
        Ok(Self(Arc::new(made)))
    }

    #[getter]
    fn nbytes(&self) -> usize {
        self.0.bytes()
    }
}

/// Instances, materials and textures, prepared for drawing.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Scene(Arc<scene::Scene>);

/// The instances of an object, as a dictionary: one, or one for each of its `fields`. `transform` is world from local.
/// They have the materials from `first_material` on, one for each material of the mesh. The identifiers of `numbered`
/// fields count from `object`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct InstanceRow<'py> {
    mesh: Option<Py<SceneMesh>>,
    fields: Vec<Py<SceneField>>,
    numbered: bool,
    transform: PyReadonlyArray2<'py, f64>,
    first_material: u32,
    opacity: f32,
    casts_shadow: bool,
    visible: bool,
    own_colors: bool,
    object: u32,
    is_sheet: bool,
    is_solid: bool,
}

impl InstanceRow<'_> {
    fn inputs(&self) -> PyResult<Vec<InstanceInput>> {
        let instance = InstanceInput {
            triangles: self.mesh.as_ref().map(|mesh| mesh.get().0.clone()),
            field: None,
            world_from_local: affine_map(&self.transform.as_array())?,
            first_material: self.first_material,
            opacity: self.opacity,
            casts_shadow: self.casts_shadow,
            visible: self.visible,
            own_colors: self.own_colors,
            object: self.object,
            is_sheet: self.is_sheet,
            is_solid: self.is_solid,
        };
        if self.fields.is_empty() {
            return Ok(vec![instance]);
        }
        let with_field = |(i, field): (u32, &Py<SceneField>)| InstanceInput {
            field: Some(field.get().field.clone()),
            object: if self.numbered { instance.object + i } else { instance.object },
            ..instance.clone()
        };
        Ok((0..).zip(&self.fields).map(with_field).collect())
    }
}

/// One material, as a dictionary. Textures are indices of the textures of the scene.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct MaterialRow {
    color: [f32; 4],
    specular: f32,
    shininess: f32,
    alpha_mode: String,
    alpha_cutoff: f32,
    two_sided: bool,
    scattering: [f32; 3],
    texture: Option<u32>,
    emission: [f32; 3],
    emission_texture: Option<u32>,
    unlit: bool,
}

impl MaterialRow {
    fn material(&self, textures: usize) -> PyResult<Material> {
        let numbers = [&self.color[..], &self.scattering, &self.emission].concat();
        let others = [self.specular, self.shininess, self.alpha_cutoff];
        if !numbers.iter().chain(&others).all(|value| value.is_finite()) {
            return Err(Failure::from(SceneError::new("material", "must be finite".to_owned())).into());
        }
        let is_there = |texture: &Option<u32>| texture.is_none_or(|texture| (texture as usize) < textures);
        if ![self.texture, self.emission_texture].iter().all(is_there) {
            return Err(Failure::from(SceneError::new("material", "refers to a texture that is not there")).into());
        }
        Ok(Material {
            color: self.color,
            specular: self.specular,
            shininess: self.shininess,
            alpha: match self.alpha_mode.as_str() {
                "opaque" => Alpha::Opaque,
                "mask" => Alpha::Mask(self.alpha_cutoff),
                "blend" => Alpha::Blend,
                other => return Err(unknown("alpha_mode", "\"opaque\", \"mask\" or \"blend\"", other)),
            },
            two_sided: self.two_sided,
            scattering: self.scattering,
            texture: self.texture,
            emission: self.emission,
            emission_texture: self.emission_texture,
            unlit: self.unlit,
        })
    }
}

/// The options of a picture by name, as Python checked them. `ambient_occlusion` is the range, world units.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct PictureOptions {
    size: [u32; 2],
    primary: String,
    shadows: String,
    ambient_occlusion: Option<f64>,
    bounces: u32,
    bounce_samples: u32,
    samples: u32,
    denoise: bool,
    light_scale: u32,
    exposure: f32,
    area_samples: u32,
    far: Vec<Py<SceneField>>,
    far_distance: Option<f64>,
}

impl PictureOptions {
    /// Converts the options to the options of the core; unknown words are errors.
    fn checked(self, lights: Vec<Light>, ambient: Ambient, background: [f32; 4]) -> PyResult<RenderOptions> {
        Ok(RenderOptions {
            size: self.size,
            primary: match self.primary.as_str() {
                "auto" => Primary::Auto,
                "raster" => Primary::Raster,
                "raymarch" => Primary::Raymarch,
                other => return Err(unknown("primary", "\"auto\", \"raster\" or \"raymarch\"", other)),
            },
            shadows: match self.shadows.as_str() {
                "none" => SceneShadows::None,
                "hard" => SceneShadows::Hard,
                "soft" => SceneShadows::Soft,
                "area" => SceneShadows::Area(self.area_samples),
                other => return Err(unknown("shadows", "\"soft\", \"hard\", \"none\" or \"area\"", other)),
            },
            lights,
            ambient,
            occlusion: self.ambient_occlusion,
            bounces: (self.bounces > 0).then_some(BounceOptions { count: self.bounces, samples: self.bounce_samples }),
            far: (!self.far.is_empty()).then(|| FarField {
                levels: self.far.iter().map(|level| level.get().field.clone()).collect(),
                distance: self.far_distance,
            }),
            background,
            exposure: self.exposure,
            samples: self.samples,
            light_scale: self.light_scale,
            denoise: self.denoise,
        })
    }
}

/// A number, or three 4x4 matrices.
#[derive(FromPyObject)]
enum AmbientLight {
    #[pyo3(transparent)]
    Constant(f32),
    #[pyo3(transparent)]
    Surroundings([[[f32; 4]; 4]; 3]),
}

impl From<AmbientLight> for Ambient {
    fn from(light: AmbientLight) -> Self {
        match light {
            AmbientLight::Constant(share) => Self::Constant(share),
            // The matrices are symmetric, so rows are columns.
            AmbientLight::Surroundings(forms) => {
                Self::Surroundings(Box::new(forms.map(|form| Mat4::from_cols_array_2d(&form))))
            }
        }
    }
}

#[pymethods]
impl Scene {
    #[new]
    fn new(
        py: Python<'_>,
        instances: Vec<InstanceRow<'_>>,
        materials: Vec<MaterialRow>,
        textures: Vec<Py<Texture>>,
    ) -> PyResult<Self> {
        let inputs = instances.iter().map(InstanceRow::inputs).collect::<PyResult<Vec<_>>>()?;
        let inputs = inputs.into_iter().flatten().collect();
        let materials = materials.iter().map(|row| row.material(textures.len())).collect::<PyResult<_>>()?;
        let textures = textures.iter().map(|texture| texture.get().0.clone()).collect();
        let made = py.detach(|| scene::Scene::new(inputs, materials, textures)).map_err(Failure::from)?;
        Ok(Self(Arc::new(made)))
    }

    /// The same instances with other transforms.
    fn moved(&self, py: Python<'_>, transforms: PyReadonlyArray3<'_, f64>) -> PyResult<Self> {
        let maps: Vec<_> = transforms.as_array().outer_iter().map(|map| affine_map(&map)).collect::<PyResult<_>>()?;
        Ok(Self(Arc::new(py.detach(|| self.0.moved(&maps)).map_err(Failure::from)?)))
    }

    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        row_array(py, self.0.bounds().into_iter().map(|corner| corner.to_array()))
    }
}

/// The map of a 4x4 matrix for column vectors.
fn affine_map(matrix: &ArrayView2<'_, f64>) -> PyResult<DAffine3> {
    if matrix.shape() != [4, 4] {
        let problem = format!("must have shape (4, 4), got {:?}", matrix.shape());
        return Err(Failure::from(SceneError::new("transform", problem)).into());
    }
    let columns = std::array::from_fn(|c| std::array::from_fn(|r| matrix[[r, c]]));
    Ok(DAffine3::from_mat4(DMat4::from_cols_array_2d(&columns)))
}

/// Draws frames, and keeps what they have in common in device memory.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Renderer(scene::renderer::Renderer);

#[pymethods]
impl Renderer {
    /// Fails if a device is given and not available.
    #[new]
    #[pyo3(signature = (device=None, keeps_pictures=false))]
    fn new(py: Python<'_>, device: Option<&str>, keeps_pictures: bool) -> PyResult<Self> {
        if let Some(device) = device {
            choose(py, device)?;
        }
        Ok(Self(scene::renderer::Renderer::new(keeps_pictures)))
    }

    /// Transfers of all frames so far.
    #[getter]
    fn counters<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counters = self.0.counters();
        let facts = PyDict::new(py);
        facts.set_item("uploads", counters.uploads.load(Relaxed))?;
        facts.set_item("upload_bytes", counters.uploaded_bytes.load(Relaxed))?;
        facts.set_item("submits", counters.submits.load(Relaxed))?;
        facts.set_item("readbacks", counters.readbacks.load(Relaxed))?;
        Ok(facts)
    }

    /// Draws a scene.
    #[pyo3(signature = (
        scene, pose, *, fov_deg, height, lights, ambient, background, options, device, progress=None
    ))]
    fn frame<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        pose: PyReadonlyArray2<'py, f64>,
        fov_deg: f64,
        height: Option<f64>,
        lights: Vec<LightRow>,
        ambient: AmbientLight,
        background: [f32; 4],
        options: PictureOptions,
        device: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let place = choose(py, device)?;
        let camera = camera(&pose, fov_deg, height)?;
        let size = options.size;
        let lights = lights.into_iter().map(Light::from).collect();
        let options = options.checked(lights, ambient.into(), background)?;
        let scene = scene.0.clone();
        let rendered = run(py, progress, |progress| self.0.frame(&place, &scene, &camera, &options, progress))?;
        let images = frame_dict(py, rendered.frame)?;
        images.set_item("rays", image_array(py, rendered.pixel_rays, &[size[1] as usize, size[0] as usize])?)?;
        let lit_at = if rendered.is_lit_on_device { place.label() } else { "cpu".to_owned() };
        images.set_item("light_on", lit_at)?;
        images.set_item("device", place.label())?;
        let label = place.label();
        let places = [label.as_str(), "cpu"].into_iter().zip(rendered.primary_on).filter(|(_, used)| *used);
        images.set_item("primary_on", places.map(|(place, _)| place).collect::<Vec<_>>().join(" and "))?;
        for (name, stages) in [("seconds", rendered.seconds), ("device_seconds", rendered.device_seconds)] {
            let seconds = PyDict::new(py);
            for (stage, duration) in stages {
                seconds.set_item(stage, duration)?;
            }
            images.set_item(name, seconds)?;
        }
        let stages = ["primary", "light"].into_iter().zip(rendered.reused);
        images.set_item("reused", stages.filter(|(_, reused)| *reused).map(|(stage, _)| stage).collect::<Vec<_>>())?;
        images.set_item("sheets", rendered.sheets)?;
        images.set_item("ray_count", rendered.rays)?;
        images.set_item("far_rays", rendered.far_rays)?;
        Ok(images)
    }
}

fn unknown(what: &str, expected: &str, got: &str) -> PyErr {
    Failure::from(SceneError::new(what, format!("must be {expected}, got {got:?}"))).into()
}
