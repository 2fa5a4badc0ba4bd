//! The light pass's questions answered by a graphics device (`shaders/scene_beams.wgsl`).
//!
//! Instances, their tree and the dense fields behind them go up once a scene and device. A picture then sends its rays and
//! cones as [`Beam`]s and gets the share of each that passes. One that runs out of the shader's bounded steps says so and is
//! asked again on the CPU.

use super::far::Far;
use super::field::{DenseField, Field, SampledField};
use super::raster::DeviceMeshes;
use super::shadow::{Casters, Place, Ray, Work};
use super::{Instance, Scene};
use crate::error::Error;
use crate::geometry::Aabb;
use crate::gpu::Context;
use crate::gpu::layout::{Answer, Beam, BeamParams, SceneGrid, SceneInstance};
use crate::gpu::pace::in_pieces;
use crate::progress::Progress;
use crate::volume::Trilinear;
use glam::{Mat3, Vec3};
use std::sync::Arc;

/// Invocations of a workgroup, as in the shader.
const GROUP: u64 = 64;
/// Workgroups of a dispatch: the first one, and the most.
const GROUPS: (u64, u64) = (16, 65_535);
/// Stands for infinity in a shader.
const FAR: f32 = 1e30;
/// Stands for no far field, as in the shader.
const NO_FAR: u32 = u32::MAX;
/// Stands for a distance in voxels, as in the shader.
const BY_VOXELS: f32 = -1.0;

/// A scene in device memory.
pub struct DeviceScene {
    context: Arc<Context>,
    nodes: wgpu::Buffer,
    items: wgpu::Buffer,
    instances: wgpu::Buffer,
    grids: wgpu::Buffer,
    samples: wgpu::Buffer,
    blocks: wgpu::Buffer,
    meshes: DeviceMeshes,
    /// The levels of the far field that follow the instances.
    far: Vec<Arc<dyn Field>>,
    knows_all: bool,
}

impl DeviceScene {
    pub fn upload(context: &Arc<Context>, scene: &Scene, far: Option<&Far>) -> Result<Self, Error> {
        let mut fields: Vec<&SampledField<DenseField>> = Vec::new();
        let mut rows = Vec::with_capacity(scene.instances.len() + 1);
        let mut knows_all = true;
        let of_scene = scene.instances.iter().zip(&scene.boxes).map(|(instance, bounds)| (instance, bounds, 0.0));
        let levels = far.map_or(&[][..], |far| &far.levels);
        let of_far = levels.iter().map(|level| (&level.instance, &level.bounds, level.voxel));
        for (instance, bounds, voxel) in of_scene.chain(of_far) {
            let dense = instance.field.as_ref().and_then(|field| field.dense());
            knows_all &= instance.field.is_none() || dense.is_some();
            let grid = match dense {
                None => 0,
                Some(dense) => {
                    let known = fields.iter().position(|&known| std::ptr::eq(known, dense));
                    known.unwrap_or_else(|| {
                        fields.push(dense);
                        fields.len() - 1
                    })
                }
            };
            rows.push(SceneInstance { voxel: voxel as f32, ..instance_row(instance, bounds, grid as u32) });
        }

        let (mut grids, mut samples, mut blocks) = (Vec::new(), Vec::new(), Vec::new());
        let total: u64 = fields.iter().map(|field| 4 * field.marcher().field.samples().len() as u64).sum();
        context.check_size("the fields of a scene", total)?;
        for field in fields {
            let marcher = field.marcher();
            let grid = marcher.field.grid();
            grids.push(SceneGrid {
                shape: grid.shape.map(|n| n as u32),
                first_sample: samples.len() as u32,
                spacing: grid.spacing().as_vec3().to_array(),
                first_block: blocks.len() as u32,
                blocks: marcher.empty().shape().map(|n| n as u32),
                pad_0: 0,
            });
            samples.extend_from_slice(marcher.field.samples());
            blocks.extend_from_slice(marcher.empty().distances());
        }
        blocks.resize(blocks.len().next_multiple_of(4), 0u8);
        let words: Vec<u32> = blocks.as_chunks::<4>().0.iter().map(|&bytes| u32::from_le_bytes(bytes)).collect();
        Ok(Self {
            context: context.clone(),
            nodes: context.upload("scene tree", &scene.tree.nodes)?,
            items: context.upload("scene items", &scene.tree.items)?,
            instances: context.upload("scene instances", &rows)?,
            grids: context.upload("scene grids", &grids)?,
            samples: context.upload("scene fields", &samples)?,
            blocks: context.upload("scene blocks", &words)?,
            meshes: DeviceMeshes::upload(context, scene)?,
            far: levels.iter().filter_map(|level| level.instance.field.clone()).collect(),
            knows_all,
        })
    }

    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    /// Whether it has the fields of all instances, so that it can light them.
    pub fn knows_all(&self) -> bool {
        self.knows_all
    }

    pub fn meshes(&self) -> &DeviceMeshes {
        &self.meshes
    }

    /// The buffers of `shaders/shared/scene_field.wgsl`.
    pub fn field_bindings(&self) -> [(u32, &wgpu::Buffer); 4] {
        [(3, &self.instances), (4, &self.grids), (5, &self.samples), (6, &self.blocks)]
    }

    /// Whether this far field, if any, is there.
    pub fn has(&self, far: Option<&Far>) -> bool {
        let Some(far) = far else { return true };
        let wanted = far.levels.iter().filter_map(|level| level.instance.field.as_ref());
        self.far.len() == far.levels.len() && wanted.zip(&self.far).all(|(wanted, there)| Arc::ptr_eq(wanted, there))
    }

    /// Share of each beam that passes.
    pub fn shares(&self, casters: &Casters<'_>, beams: &[Beam], progress: &Progress) -> Result<Vec<Answer>, Error> {
        let mut params = BeamParams { far: NO_FAR, ..BeamParams::default() };
        if let Some(far) = casters.far {
            params.far = casters.scene.instances.len() as u32;
            params.far_levels = far.levels.len() as u32;
            params.far_holds_all = u32::from(far.holds_all);
            params.far_distance = far.distance.map_or(BY_VOXELS, |distance| distance as f32);
        }
        let mut answers = self.ask("shares", params, beams, progress)?;
        for (answer, beam) in answers.iter_mut().zip(beams).filter(|(answer, _)| answer.is_complete == 0) {
            let (place, ray) = from_beam(beam);
            let mut work = Work::default();
            if beam.slope > 0.0 {
                let cone = casters.whole_cone(&place, &ray, beam.slope, &mut Vec::new(), &mut work);
                (answer.value, answer.is_proven) = (cone.share, u32::from(cone.is_proven));
            } else {
                answer.value = casters.ray_share(&place, &ray, &mut work);
            }
            answer.is_far = work.far_rays;
        }
        Ok(answers)
    }

    /// How far each beam goes through its own instance's matter.
    pub fn thicknesses(&self, beams: &[Beam], progress: &Progress) -> Result<Vec<Answer>, Error> {
        self.ask("thicknesses", BeamParams { far: NO_FAR, ..BeamParams::default() }, beams, progress)
    }

    fn ask(
        &self,
        entry: &'static str,
        mut params: BeamParams,
        beams: &[Beam],
        progress: &Progress,
    ) -> Result<Vec<Answer>, Error> {
        let context = &self.context;
        let mut answers = vec![Answer::default(); beams.len()];
        if beams.is_empty() {
            return Ok(answers);
        }
        let uniform = context.uniform("beam parameters", &params)?;
        let asked = context.upload("beams", beams)?;
        let found = context.storage("answers", size_of_val(&answers[..]) as u64)?;
        let kernel = context.kernel("scene_beams", entry)?;
        let all = [
            (0, &uniform),
            (1, &self.nodes),
            (2, &self.items),
            (3, &self.instances),
            (4, &self.grids),
            (5, &self.samples),
            (6, &self.blocks),
            (7, &asked),
            (8, &found),
        ];
        // The layout has what the entry point reads: a thickness needs no tree.
        let used: Vec<_> =
            all.into_iter().filter(|(binding, _)| entry == "shares" || ![1, 2, 6].contains(binding)).collect();
        let group = context.bind("scene_beams", &kernel, &used)?;
        let groups = (beams.len() as u64).div_ceil(GROUP);
        in_pieces(context, "the scene's light", groups, GROUPS.0, GROUPS.1, progress, |first, count| {
            params.first = (first * GROUP) as u32;
            params.count = ((count * GROUP) as u32).min(beams.len() as u32 - params.first);
            context.write("beam parameters", &uniform, 0, &[params])?;
            progress.check()?;
            Ok(context.dispatch("scene_beams", &kernel, &group, [count as u32, 1, 1])?)
        })?;
        context.read("answers", &found, &mut answers, progress)?;
        Ok(answers)
    }
}

/// A ray or, with a slope, a cone.
pub fn beam(place: &Place, ray: &Ray, slope: f32) -> Beam {
    Beam {
        p: place.p.as_vec3().to_array(),
        t_max: (ray.t_max as f32).min(FAR),
        direction: ray.direction.as_vec3().to_array(),
        slope,
        normal: place.normal.to_array(),
        bias_voxels: place.bias_voxels,
        own: place.own,
        ..Beam::default()
    }
}

fn from_beam(beam: &Beam) -> (Place, Ray) {
    let place = Place {
        p: Vec3::from_array(beam.p).as_dvec3(),
        normal: Vec3::from_array(beam.normal),
        own: beam.own,
        bias_voxels: beam.bias_voxels,
    };
    let direction = Vec3::from_array(beam.direction).as_dvec3().normalize();
    (place, Ray { direction, t_max: if beam.t_max < FAR { f64::from(beam.t_max) } else { f64::INFINITY } })
}

fn instance_row(instance: &Instance, bounds: &Aabb, grid: u32) -> SceneInstance {
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
        grid,
        normal_y,
        casts_shadow: u32::from(instance.casts_shadow && instance.field.is_some()),
        normal_z,
        box_min: bounds.min.to_array(),
        box_max: bounds.max.to_array(),
        surface_lower: lower.to_array(),
        surface_upper: upper.to_array(),
        field_extent: instance.field_extent.to_array(),
        ..SceneInstance::default()
    }
}
