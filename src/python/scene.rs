//! `fieldbake._core.Scene` and its parts, and `Renderer`.

use super::convert::{Field, row_array, rows};
use super::csg::Shape;
use super::device::choose;
use super::error::Failure;
use super::mesh::Mesh;
use super::quadric::quadric_rows;
use super::render::{frame_dict, pose_matrix};
use super::run::run;
use super::sparse::SparseField;
use crate::error::SceneError;
use crate::quadric::Quadrics;
use crate::render::Camera;
use crate::scene::far::FarField;
use crate::scene::field::{DenseField, SampledField};
use crate::scene::nested::NestedField;
use crate::scene::objects::{QuadricField, ShapeField, SparseBricks};
use crate::scene::texture::Texture as CoreTexture;
use crate::scene::triangles::Triangles;
use crate::scene::{self, Alpha, InstanceInput, Light, Material, Primary, RenderOptions, SceneShadows};
use crate::volume::Trilinear;
use glam::{DAffine3, DMat4, DVec3, Vec2, Vec4};
use numpy::{PyArray2, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::sync::Arc;
use std::sync::atomic::Ordering::Relaxed;

/// Distances prepared for the rays of a scene.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct SceneField(Arc<dyn scene::field::Field>);

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
    ) -> PyResult<Self> {
        let field = Field::new(&distances, lower, upper)?;
        let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
        let made = run(py, None, |progress| {
            let view = field.view()?;
            SampledField::new(DenseField::new(*view.grid(), view.distances().to_vec())?, inner, progress)
        })?;
        Ok(Self(Arc::new(made)))
    }

    /// Nested fields as one field, finest first.
    #[staticmethod]
    fn nested(levels: Vec<Py<SceneField>>) -> PyResult<Self> {
        let levels = levels.iter().map(|level| level.get().0.clone()).collect();
        Ok(Self(Arc::new(NestedField::new(levels).map_err(Failure::from)?)))
    }

    /// The bricks of a sparse field, decoded.
    #[staticmethod]
    fn sparse(py: Python<'_>, field: &SparseField, inner_lower: [f64; 3], inner_upper: [f64; 3]) -> PyResult<Self> {
        let inner = [DVec3::from_array(inner_lower), DVec3::from_array(inner_upper)];
        let made = run(py, None, |progress| {
            SampledField::new(SparseBricks::new(field.decoded(), progress)?, inner, progress)
        })?;
        Ok(Self(Arc::new(made)))
    }

    /// One field for each row of quadrics.
    #[staticmethod]
    fn quadrics(rows: PyReadonlyArray2<'_, f64>) -> PyResult<Vec<Self>> {
        let quadrics = quadric_rows(&rows)?;
        // All rows are checked at once.
        Quadrics::new(&quadrics).map_err(Failure::from)?;
        Ok(quadrics.iter().map(|quadric| Self(Arc::new(QuadricField::new(quadric)))).collect())
    }

    /// A shape, with the parts that rays are traced through.
    #[staticmethod]
    fn shape(py: Python<'_>, shape: &Shape) -> PyResult<Self> {
        let solid = shape.solid(py)?;
        Ok(Self(Arc::new(run(py, None, |_| ShapeField::new(solid))?)))
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
        // The slice is ndarray's, since NumPy's accepts columns first as well.
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

/// Number of columns of the material table.
const MATERIAL_COLUMNS: usize = 18;

#[pymethods]
impl Scene {
    #[new]
    fn new(
        py: Python<'_>,
        meshes: Vec<Option<Py<SceneMesh>>>,
        fields: Vec<Option<Py<SceneField>>>,
        transforms: PyReadonlyArray3<'_, f64>,
        first_materials: Vec<u32>,
        opacities: Vec<f32>,
        casts_shadow: Vec<bool>,
        visible: Vec<bool>,
        own_colors: Vec<bool>,
        objects: Vec<u32>,
        sheets: Vec<bool>,
        materials: PyReadonlyArray2<'_, f32>,
        textures: Vec<Py<Texture>>,
    ) -> PyResult<Self> {
        let count = meshes.len();
        let lengths = [
            fields.len(),
            first_materials.len(),
            opacities.len(),
            casts_shadow.len(),
            visible.len(),
            own_colors.len(),
            objects.len(),
            sheets.len(),
        ];
        let shapes_fit = transforms.shape() == [count, 4, 4] && materials.shape()[1] == MATERIAL_COLUMNS;
        if lengths != [count; 8] || !shapes_fit {
            return Err(Failure::from(SceneError::new("instances", "lists of different lengths")).into());
        }
        let inputs = affine_maps(&transforms)
            .enumerate()
            .map(|(i, world_from_local)| InstanceInput {
                triangles: meshes[i].as_ref().map(|mesh| mesh.get().0.clone()),
                field: fields[i].as_ref().map(|field| field.get().0.clone()),
                world_from_local,
                first_material: first_materials[i],
                opacity: opacities[i],
                casts_shadow: casts_shadow[i],
                visible: visible[i],
                own_colors: own_colors[i],
                object: objects[i],
                is_sheet: sheets[i],
            })
            .collect();
        let textures: Vec<_> = textures.iter().map(|texture| texture.get().0.clone()).collect();
        let materials = materials.as_array();
        let materials =
            materials.rows().into_iter().map(|row| material(&row.to_vec(), textures.len())).collect::<PyResult<_>>()?;
        let made = py.detach(|| scene::Scene::new(inputs, materials, textures)).map_err(Failure::from)?;
        Ok(Self(Arc::new(made)))
    }

    /// The same instances with other transforms.
    fn moved(&self, py: Python<'_>, transforms: PyReadonlyArray3<'_, f64>) -> PyResult<Self> {
        let maps: Vec<_> = affine_maps(&transforms).collect();
        Ok(Self(Arc::new(py.detach(|| self.0.moved(&maps)).map_err(Failure::from)?)))
    }

    #[getter]
    fn bounds<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        row_array(py, self.0.bounds().into_iter().map(|corner| corner.to_array()))
    }
}

/// The maps of (n, 4, 4) matrices for column vectors.
fn affine_maps(matrices: &PyReadonlyArray3<'_, f64>) -> impl Iterator<Item = DAffine3> {
    let matrices = matrices.as_array();
    matrices
        .outer_iter()
        .map(|matrix| {
            let columns = std::array::from_fn(|c| std::array::from_fn(|r| matrix[[r, c]]));
            DAffine3::from_mat4(DMat4::from_cols_array_2d(&columns))
        })
        .collect::<Vec<_>>()
        .into_iter()
}

/// A row of the material table: RGBA, specular, shininess, alpha mode (0 opaque, 1 mask, 2 blend), cutoff, two sided,
/// scattering RGB, texture or -1, emission RGB, its texture or -1, unlit.
fn material(row: &[f32], textures: usize) -> PyResult<Material> {
    if !row.iter().all(|value| value.is_finite()) {
        return Err(Failure::from(SceneError::new("material", format!("must be finite, got {row:?}"))).into());
    }
    let [texture, emission_texture] = [row[12], row[16]].map(|index| (index >= 0.0).then_some(index as u32));
    if [texture, emission_texture].into_iter().flatten().any(|texture| texture as usize >= textures) {
        return Err(Failure::from(SceneError::new("material", "refers to a texture that is not there")).into());
    }
    Ok(Material {
        color: [row[0], row[1], row[2], row[3]],
        specular: row[4],
        shininess: row[5],
        alpha: match row[6] as i32 {
            1 => Alpha::Mask(row[7]),
            2 => Alpha::Blend,
            _ => Alpha::Opaque,
        },
        two_sided: row[8] != 0.0,
        scattering: [row[9], row[10], row[11]],
        texture,
        emission: [row[13], row[14], row[15]],
        emission_texture,
        unlit: row[17] != 0.0,
    })
}

/// Draws frames, and keeps what they have in common in device memory.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct Renderer(scene::renderer::Renderer);

#[pymethods]
impl Renderer {
    /// Fails if a device is given and not available.
    #[new]
    #[pyo3(signature = (device=None))]
    fn new(py: Python<'_>, device: Option<&str>) -> PyResult<Self> {
        if let Some(device) = device {
            choose(py, device)?;
        }
        Ok(Self(scene::renderer::Renderer::default()))
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
        scene, pose, *, fov_deg, size, lights, primary, shadows, area_samples, ambient, occlusion, far, far_distance,
        background, exposure, samples, light_scale, device, progress=None
    ))]
    fn frame<'py>(
        &self,
        py: Python<'py>,
        scene: &Scene,
        pose: PyReadonlyArray2<'py, f64>,
        fov_deg: f64,
        size: [u32; 2],
        lights: PyReadonlyArray2<'py, f64>,
        primary: &str,
        shadows: &str,
        area_samples: u32,
        ambient: f32,
        occlusion: Option<f64>,
        far: Vec<Py<SceneField>>,
        far_distance: Option<f64>,
        background: [f32; 4],
        exposure: f32,
        samples: u32,
        light_scale: u32,
        device: &str,
        progress: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let place = choose(py, device)?;
        let camera = Camera::from_pose(&pose_matrix(&pose)?, fov_deg).map_err(Failure::from)?;
        let options = RenderOptions {
            size,
            primary: match primary {
                "auto" => Primary::Auto,
                "raster" => Primary::Raster,
                "raymarch" => Primary::Raymarch,
                other => return Err(unknown("primary", "\"auto\", \"raster\" or \"raymarch\"", other)),
            },
            shadows: match shadows {
                "none" => SceneShadows::None,
                "hard" => SceneShadows::Hard,
                "soft" => SceneShadows::Soft,
                "area" => SceneShadows::Area(area_samples),
                "article" => SceneShadows::Article,
                other => return Err(unknown("shadows", "\"soft\", \"hard\", \"none\" or \"area\"", other)),
            },
            lights: rows::<f64>(&lights, "lights")?.as_chunks::<3>().0.iter().map(light).collect(),
            ambient,
            occlusion,
            far: (!far.is_empty()).then(|| FarField {
                levels: far.iter().map(|level| level.get().0.clone()).collect(),
                distance: far_distance,
            }),
            background,
            exposure,
            samples,
            light_scale,
        };
        let scene = scene.0.clone();
        let rendered = run(py, progress, |progress| self.0.frame(&place, &scene, &camera, &options, progress))?;
        let images = frame_dict(py, rendered.frame)?;
        let lit_at = if rendered.is_lit_on_device { place.label() } else { "cpu".to_owned() };
        images.set_item("light_on", lit_at)?;
        images.set_item("device", place.label())?;
        let label = place.label();
        let places = [label.as_str(), "cpu"].into_iter().zip(rendered.primary_on).filter(|(_, used)| *used);
        images.set_item("primary_on", places.map(|(place, _)| place).collect::<Vec<_>>().join(" and "))?;
        let seconds = PyDict::new(py);
        for (stage, duration) in rendered.seconds {
            seconds.set_item(stage, duration)?;
        }
        images.set_item("seconds", seconds)?;
        images.set_item("sheets", rendered.sheets)?;
        images.set_item("rays", rendered.rays)?;
        images.set_item("far_rays", rendered.far_rays)?;
        Ok(images)
    }
}

/// Three rows of three: kind (0 directional, 1 point), slope, radius; direction or position; colour.
fn light(rows: &[[f64; 3]; 3]) -> Light {
    let [[kind, slope, radius], place, color] = *rows;
    let (place, color) = (DVec3::from_array(place), DVec3::from_array(color).as_vec3());
    if kind == 0.0 {
        Light::Directional { direction: place, color, slope: slope as f32 }
    } else {
        Light::Point { position: place, color, radius }
    }
}

fn unknown(what: &str, expected: &str, got: &str) -> PyErr {
    Failure::from(SceneError::new(what, format!("must be {expected}, got {got:?}"))).into()
}
