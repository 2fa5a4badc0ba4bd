//! The rays and cones of the light pass on a graphics device (`shaders/scene/scene_beams.wgsl`).
//!
//! Instances, their tree and their fields ([`crate::scene::fields::device_fields`]) stay in device memory between
//! frames. A picture then sends its rays and cones as [`Beam`]s and receives the fraction of each that passes. A beam
//! that runs out of the shader's bounded steps is flagged, and the CPU evaluates it.

use super::device_buffers::LightBuffers;
use super::device_meshes::DeviceMeshes;
use crate::error::Error;
use crate::geometry::Aabb;
use crate::gpu::Context;
use crate::gpu::constants::scene_beam::{ROOT, ROOT_WITHOUT_OWN};
use crate::gpu::constants::scene_occluders::{CASTS_FOR_ALL, CASTS_FOR_CONES, CASTS_NOTHING};
use crate::gpu::layout::{Beam, BeamParams, BeamResult, RasterInstance, SceneInstance, SceneNode};
use crate::gpu::pace::in_groups_from;
use crate::gpu::pipeline::{AnyPipeline, BindGroups, BoundRange, Dispatch, DispatchSize, whole};
use crate::gpu::raster::RasterTarget;
use crate::gpu::shader::Instead;
use crate::gpu::table::Table;
use crate::gpu::timer::Timer;
use crate::progress::Progress;
use crate::scene::content::instance::Instance;
use crate::scene::content::model::Scene;
use crate::scene::fields::device_fields::DeviceFields;
use crate::scene::fields::field::Field;
use crate::scene::fields::shader_variants::{GeometryKinds, cases_text};
use crate::scene::light::far_field::Far;
use crate::scene::light::light_rays::{LightCone, LightRay, LightWork, SurfacePoint};
use crate::scene::light::shadow::TracedScene;
use glam::{Mat3, Vec3};
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::sync::{Arc, Mutex, PoisonError};

/// State of a cone that needs a ray past an edge, as in the shader.
const NEEDS_EDGE: u32 = 2;
/// Finite value that stands for infinity in shaders.
const FAR: f32 = 1e30;
/// Index for no far field, as in the shader.
const NO_FAR: u32 = u32::MAX;
/// Value of [`BeamParams::far_distance`] for the default distance, a number of voxels, as in the shader.
const BY_VOXELS: f32 = -1.0;

/// A scene in device memory.
pub(crate) struct DeviceScene {
    context: Arc<Context>,
    nodes: Table<SceneNode>,
    /// Memory in place of cuts, for beams without any.
    no_cuts: wgpu::Buffer,
    instances: Table<SceneInstance>,
    fields: Fields,
    meshes: DeviceMeshes,
    pub(crate) light: LightBuffers,
    /// For each instance and then each level of the far field: whether the device has its field, or it has none.
    has_field: Vec<bool>,
    /// Numbers of workgroups with which the kernels of beams start, by entry point.
    paces: Mutex<HashMap<&'static str, u64>>,
    /// Time for the light on a face by one light, s, by whether a picture has cones and whether it has rays.
    pub(crate) light_rates: Mutex<HashMap<[bool; 2], f64>>,
    pub(crate) groups: BindGroups,
    /// Times of the stages of a frame, if the device has timestamps.
    pub(crate) timer: Option<Timer>,
    /// Memory of the primary pass.
    pub(crate) raster: Mutex<RasterMemory>,
}

/// Memory of the primary pass, allocated at the first use.
#[derive(Default)]
pub(crate) struct RasterMemory {
    /// Rows of the drawn instances.
    pub rows: Option<Table<RasterInstance>>,
    pub target: Option<RasterTarget>,
}

impl RasterMemory {
    /// Replaces the rows of the drawn instances. Returns their buffer.
    pub(crate) fn set_rows(&mut self, context: &Context, rows: Vec<RasterInstance>) -> Result<wgpu::Buffer, Error> {
        let table = match self.rows.take() {
            Some(mut table) => {
                table.set(context, rows)?;
                table
            }
            None => Table::new(context, "raster instances", rows)?,
        };
        Ok(self.rows.insert(table).buffer().clone())
    }
}

/// The fields of a scene in device memory.
struct Fields {
    /// Fields by address, each with its record; None if devices do not support it.
    by_address: HashMap<usize, (Arc<dyn Field>, Option<u32>)>,
    records: wgpu::Buffer,
    samples: wgpu::Buffer,
    blocks: wgpu::Buffer,
    /// Kinds of its objects.
    kinds: GeometryKinds,
}

impl Fields {
    fn upload(context: &Context, scene: &Scene, far: Option<&Far>) -> Result<Self, Error> {
        let mut tables = DeviceFields::new(context);
        let mut by_address = HashMap::new();
        for field in fields_of(scene, far) {
            if let Entry::Vacant(new) = by_address.entry(address(field)) {
                // Nested fields append the records of their levels first.
                let is_supported = field.append_to(&mut tables)?;
                new.insert((field.clone(), is_supported.then(|| tables.records.len() as u32 - 1)));
            }
        }
        Ok(Self {
            by_address,
            records: context.upload("scene fields", &tables.records)?,
            samples: context.upload("samples of scene fields", &tables.samples)?,
            blocks: context.upload("scene blocks", &tables.words())?,
            kinds: tables.kinds,
        })
    }

    /// The rows of all instances, then of the levels of the far field, and whether the device has the field of each.
    fn rows(&self, scene: &Scene, far: Option<&Far>) -> (Vec<SceneInstance>, Vec<bool>) {
        let of_scene = scene.instances.iter().zip(&scene.boxes).map(|(instance, bounds)| (instance, bounds, 0.0));
        let levels = far.map_or(&[][..], |far| &far.levels);
        let of_far = levels.iter().map(|level| (&level.instance, &level.bounds, level.voxel));
        let row = |(instance, bounds, voxel): (&Instance, &Aabb, f64)| {
            let record = instance.field.as_ref().and_then(|field| self.by_address[&address(field)].1);
            let row = instance_row(instance, bounds, record.unwrap_or(0));
            let row = SceneInstance { voxel: voxel as f32, ..row };
            (row, instance.field.is_none() || record.is_some())
        };
        of_scene.chain(of_far).map(row).unzip()
    }
}

/// Fields of all instances, then of the levels of the far field.
fn fields_of<'a>(scene: &'a Scene, far: Option<&'a Far>) -> impl Iterator<Item = &'a Arc<dyn Field>> {
    let levels = far.map_or(&[][..], |far| &far.levels);
    scene.instances.iter().chain(levels.iter().map(|level| &level.instance)).filter_map(|i| i.field.as_ref())
}

/// Key of a field: its address. Callers keep the field beside the key, so that no other field gets the address.
fn address(field: &Arc<dyn Field>) -> usize {
    Arc::as_ptr(field).addr()
}

impl DeviceScene {
    pub(crate) fn upload(context: &Arc<Context>, scene: &Scene, far: Option<&Far>) -> Result<Self, Error> {
        let fields = Fields::upload(context, scene, far)?;
        let (rows, has_field) = fields.rows(scene, far);
        Ok(Self {
            context: context.clone(),
            nodes: Table::new(context, "scene tree", scene.tree.device_nodes())?,
            no_cuts: context.storage("no cuts", size_of::<u32>() as u64)?,
            instances: Table::new(context, "scene instances", rows)?,
            fields,
            meshes: DeviceMeshes::upload(context, scene)?,
            light: LightBuffers::default(),
            has_field,
            paces: Mutex::default(),
            light_rates: Mutex::default(),
            groups: BindGroups::default(),
            // A device that refuses the timestamps draws without them.
            timer: Timer::new(context).unwrap_or_default(),
            raster: Mutex::default(),
        })
    }

    /// Updates the memory for another scene. Fields and meshes stay if all fields and meshes of the new scene are in
    /// memory; else they are uploaded again. Only rows that differ are uploaded.
    pub(crate) fn update(&mut self, scene: &Scene, far: Option<&Far>) -> Result<(), Error> {
        let context = &self.context;
        if !fields_of(scene, far).all(|field| self.fields.by_address.contains_key(&address(field))) {
            self.groups.clear();
            self.fields = Fields::upload(context, scene, far)?;
            self.paces = Mutex::default();
            self.light_rates = Mutex::default();
        }
        let (rows, has_field) = self.fields.rows(scene, far);
        self.has_field = has_field;
        self.instances.set(context, rows)?;
        self.nodes.set(context, scene.tree.device_nodes())?;
        if self.meshes.update(context, scene)? {
            self.groups.clear();
        }
        Ok(())
    }

    pub(crate) fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Whether the device has the fields of all instances, so that it can light them.
    pub(crate) fn has_all_fields(&self) -> bool {
        !self.has_field.contains(&false)
    }

    /// Whether the device has the field of an instance, if the instance has one.
    pub(crate) fn has_field(&self, instance: usize) -> bool {
        self.has_field[instance]
    }

    /// Overrides of imported files for the kinds of its objects.
    pub(crate) fn texts(&self) -> Vec<Instead> {
        self.fields.kinds.texts()
    }

    /// The same for kernels of beams.
    pub(crate) fn beam_texts(&self, has_far: bool) -> Vec<Instead> {
        [self.texts(), vec![cases_text(has_far)]].concat()
    }

    pub(crate) fn instances(&self) -> &wgpu::Buffer {
        self.instances.buffer()
    }

    /// Three corners and three normals of each face, if they fit into one buffer.
    pub(crate) fn faces(&self) -> Option<&wgpu::Buffer> {
        self.meshes.faces()
    }

    pub(crate) fn meshes(&self) -> &DeviceMeshes {
        &self.meshes
    }

    /// The buffers of `shaders/shared/scene/scene_field.wgsl`.
    pub(crate) fn field_bindings(&self) -> [(u32, &wgpu::Buffer); 4] {
        let fields = &self.fields;
        [(3, self.instances.buffer()), (4, &fields.records), (5, &fields.samples), (6, &fields.blocks)]
    }

    /// The parameters of kernels that evaluate beams.
    pub(crate) fn beam_params(traced: &TracedScene<'_>) -> BeamParams {
        let mut params = BeamParams { far: NO_FAR, ..BeamParams::default() };
        if let Some(far) = traced.far {
            params.far = traced.scene.instances.len() as u32;
            params.far_levels = far.levels.len() as u32;
            params.far_holds_all = u32::from(far.holds_all);
            params.far_distance = far.distance.map_or(BY_VOXELS, |distance| distance as f32);
        }
        params
    }

    /// Fraction of each beam that passes.
    pub(crate) fn shares(
        &self,
        traced: &TracedScene<'_>,
        beams: &[Beam],
        progress: &Progress,
    ) -> Result<Vec<BeamResult>, Error> {
        let params = Self::beam_params(traced);
        let has_far = traced.far.is_some();
        let mut beam_results = vec![BeamResult::default(); beams.len()];
        let is_cone = |i: usize| beams[i].slope > 0.0;
        type Selection<'a> = &'a dyn Fn(usize, &BeamResult) -> bool;
        let kernels: [(_, Selection<'_>); 3] = [
            ("rays", &|i, _| !is_cone(i)),
            ("cones", &|i, _| is_cone(i)),
            ("edge_cones", &|_, beam_result| beam_result.is_complete == NEEDS_EDGE),
        ];
        for (entry, is_selected) in kernels {
            let places: Vec<usize> = (0..beams.len()).filter(|&i| is_selected(i, &beam_results[i])).collect();
            let selected: Vec<Beam> = places.iter().map(|&i| beams[i]).collect();
            for (i, beam_result) in places.into_iter().zip(self.evaluate(entry, has_far, params, &selected, progress)?)
            {
                beam_results[i] = beam_result;
            }
        }
        for (beam_result, beam) in
            beam_results.iter_mut().zip(beams).filter(|(beam_result, _)| beam_result.is_complete == 0)
        {
            let (place, ray) = from_beam(beam);
            let mut work = LightWork::default();
            if beam.slope > 0.0 {
                let cone = LightCone { place: &place, ray: &ray, slope: beam.slope };
                if beam.is_coarse == 0 {
                    let whole = traced.whole_cone(cone, &mut Vec::new(), &mut work);
                    (beam_result.value, beam_result.is_proven) = (whole.share, u32::from(whole.is_proven));
                } else {
                    beam_result.value = traced.cone_share(cone, &traced.instances_in(cone), &mut work);
                }
            } else {
                beam_result.value = traced.field_share(&place, &ray, &mut work);
            }
            beam_result.is_far = work.far_rays;
        }
        Ok(beam_results)
    }

    /// The length of each beam inside its own instance.
    pub(crate) fn thicknesses(&self, beams: &[Beam], progress: &Progress) -> Result<Vec<BeamResult>, Error> {
        self.evaluate("thicknesses", false, BeamParams { far: NO_FAR, ..BeamParams::default() }, beams, progress)
    }

    pub(crate) fn nodes(&self) -> &wgpu::Buffer {
        self.nodes.buffer()
    }

    /// The buffers of a kernel that evaluates beams.
    pub(crate) fn beam_bindings<'a>(
        &'a self,
        entry: &str,
        params: BoundRange<'a>,
        cuts: &'a wgpu::Buffer,
        beams: &'a wgpu::Buffer,
        beam_results: &'a wgpu::Buffer,
    ) -> Vec<BoundRange<'a>> {
        let scene = [
            (1, self.nodes.buffer()),
            (2, cuts),
            (3, self.instances.buffer()),
            (4, &self.fields.records),
            (5, &self.fields.samples),
            (6, &self.fields.blocks),
            (7, beams),
            (8, beam_results),
        ];
        // The layout contains only the buffers that the entry point reads: a thickness needs no tree, and the distance
        // of a dense grid no blocks.
        let unused: &[u32] = match (entry, self.fields.kinds.sparse) {
            ("rays" | "cones" | "edge_cones", _) => &[],
            (_, true) => &[1, 2],
            (_, false) => &[1, 2, 6],
        };
        let used = scene.into_iter().filter(|(binding, _)| !unused.contains(binding));
        std::iter::once(params).chain(used.map(whole)).collect()
    }

    /// A kernel and its buffers. `name` is one of a kernel with these buffers.
    pub(crate) fn kernel(
        &self,
        name: &'static str,
        file: &'static str,
        entry: &'static str,
        instead: &[Instead],
        bindings: &[BoundRange<'_>],
    ) -> Result<(wgpu::ComputePipeline, wgpu::BindGroup), Error> {
        let pipeline = self.context.kernel_with(file, entry, instead)?;
        let group = self.groups.get(&self.context, name, AnyPipeline::Compute(pipeline.clone()), bindings)?;
        Ok((pipeline, group))
    }

    /// Evaluates beams by a kernel.
    fn evaluate(
        &self,
        entry: &'static str,
        has_far: bool,
        mut params: BeamParams,
        beams: &[Beam],
        progress: &Progress,
    ) -> Result<Vec<BeamResult>, Error> {
        let context = &self.context;
        let mut beam_results = vec![BeamResult::default(); beams.len()];
        if beams.is_empty() {
            return Ok(beam_results);
        }
        let beams: Vec<Beam> = beams.iter().zip(0..).map(|(beam, owner)| Beam { owner, ..*beam }).collect();
        let uploaded = context.upload("beams", &beams)?;
        let found = context.storage("beam results", size_of_val(&beam_results[..]) as u64)?;
        let stage = if entry == "edge_cones" { "edges" } else { entry };
        let uniform = context.uniform("beam parameters", &params)?;
        let kernel = context.kernel_with("scene_beams", entry, &self.beam_texts(has_far))?;
        let bindings = self.beam_bindings(entry, whole((0, &uniform)), &self.no_cuts, &uploaded, &found);
        let bindings: Vec<_> = bindings.into_iter().map(|(binding, buffer, ..)| (binding, buffer)).collect();
        let group = context.bind("scene_beams", &kernel, &bindings)?;
        let paces = || self.paces.lock().unwrap_or_else(PoisonError::into_inner);
        let mut size = paces().get(entry).copied().unwrap_or(0);
        in_groups_from(context, "the scene's light", beams.len(), &mut size, progress, |first, count, workgroups| {
            (params.first, params.count) = (first, count);
            context.write("beam parameters", &uniform, 0, &[params])?;
            progress.check()?;
            let dispatch = Dispatch { pipeline: &kernel, group: &group, size: DispatchSize::Known(workgroups), stage };
            Ok(context.submit_all("scene_beams", &[dispatch], None, self.timer.as_ref())?)
        })?;
        paces().insert(entry, size);
        context.read("beam results", &found, &mut beam_results, progress)?;
        Ok(beam_results)
    }
}

/// A ray or, with a slope, a cone.
pub(crate) fn beam(place: &SurfacePoint, ray: &LightRay, slope: f32) -> Beam {
    Beam {
        p: place.p.as_vec3().to_array(),
        t_max: (ray.t_max as f32).min(FAR),
        direction: ray.direction.as_vec3().to_array(),
        slope,
        normal: place.normal.to_array(),
        bias_voxels: place.bias_voxels,
        own: place.own,
        cut: if place.skips_own { ROOT_WITHOUT_OWN } else { ROOT },
        ..Beam::default()
    }
}

/// The cost of a beam.
pub(crate) fn work_of(beam_result: &BeamResult) -> LightWork {
    LightWork { steps: beam_result.steps, rays: 1, far_rays: beam_result.is_far }
}

fn from_beam(beam: &Beam) -> (SurfacePoint, LightRay) {
    let place = SurfacePoint {
        p: Vec3::from_array(beam.p).as_dvec3(),
        normal: Vec3::from_array(beam.normal),
        own: beam.own,
        bias_voxels: beam.bias_voxels,
        lift: Vec3::ZERO,
        skips_own: beam.cut == ROOT_WITHOUT_OWN,
    };
    let direction = Vec3::from_array(beam.direction).as_dvec3().normalize();
    (place, LightRay { direction, t_max: if beam.t_max < FAR { f64::from(beam.t_max) } else { f64::INFINITY } })
}

fn instance_row(instance: &Instance, bounds: &Aabb, record: u32) -> SceneInstance {
    let rows = |m: Mat3| m.transpose().to_cols_array_2d();
    let map = instance.field_from_scene;
    let offset = map.translation.as_vec3();
    let field = rows(map.matrix3.as_mat3());
    let with_offset = |axis: usize| [field[axis][0], field[axis][1], field[axis][2], offset[axis]];
    let [local_x, local_y, local_z] = rows(instance.local_from_scene);
    let [normal_x, normal_y, normal_z] = rows(instance.field_normal_from_scene);
    let [lower, upper] = instance.field.as_ref().map_or([Vec3::ZERO; 2], |field| field.surface_bounds());
    SceneInstance {
        field_x: with_offset(0),
        field_y: with_offset(1),
        field_z: with_offset(2),
        local_x,
        opacity: instance.shade,
        local_y,
        least_stretch: instance.stretch[0],
        local_z,
        largest_stretch: instance.stretch[1],
        normal_x,
        field: record,
        normal_y,
        casts_shadow: match &instance.triangles {
            _ if instance.field.is_none() || instance.is_sheet || !instance.casts_shadow => CASTS_NOTHING,
            Some(_) => CASTS_FOR_CONES,
            None => CASTS_FOR_ALL,
        },
        normal_z,
        box_min: bounds.min.to_array(),
        prefers_rays: u32::from(instance.field.as_ref().is_some_and(|field| field.prefers_rays())),
        box_max: bounds.max.to_array(),
        surface_lower: lower.to_array(),
        surface_radius: instance.field.as_ref().map_or(0.0, |field| field.surface_radius()),
        surface_upper: upper.to_array(),
        field_extent: instance.field_extent.to_array(),
        ..SceneInstance::default()
    }
}
