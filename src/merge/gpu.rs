//! The merge with a graphics device: the device finds the nearest field, the CPU evaluates its bound.
//!
//! # Theory
//!
//! Finding the field with the smallest bound at a sample is nearly all of the work. The device searches the tree for
//! each sample (`shaders/field/merge_owners.wgsl`) and encloses the bound of each field in an interval that covers
//! every float32 rounding. A field owns the sample if its interval lies below all others. Its bound is then the
//! minimum, and the CPU evaluates it in f64. A sample is undecided where intervals overlap, on a face of a field's
//! cell, and near quadrics and fields that their box cuts. The CPU evaluates undecided samples over all fields. The
//! merged field therefore equals the field of the CPU bit for bit, on every device.
//!
//! # Practice
//!
//! Scene space is world space relative to its centre, divided by a power of two, so that it spans about 1. The samples
//! of each volume are uploaded once and must fit one binding. Owners are read back by slabs of planes that fit a
//! binding.

use super::{Geometry, Merged, Merger, Placed};
use crate::bvh::boxes::BoxTree;
use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::constants::merge_owners::UNDECIDED;
use crate::gpu::layout::{MergeField, MergeGrid, MergeNode, MergeParams};
use crate::gpu::pace::in_groups;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::progress::Progress;
use crate::volume::outside::round_down;
use crate::volume::{FieldView, Trilinear};
use glam::{DAffine3, DMat3, DVec3, Vec3};
use rayon::prelude::*;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Error of a grid coordinate computed from a scene position, per grid unit that a scene unit spans along the three
/// axes together: 3 + 2 x 6 roundings of values up to 2, of 6e-8 each, doubled to cover the device's arithmetic.
const POSITION_ERROR: f64 = 2e-6;
/// Error of a grid coordinate per voxel of the grid: four roundings.
const VOXEL_ERROR: f64 = 2.5e-7;

/// [`super::merge`] with the search on a device. Returns also the number of undecided samples.
pub fn merge_on_device(
    context: &Arc<Context>,
    grid: &Grid,
    placed: &[Placed<'_>],
    progress: &Progress,
) -> Result<(Merged, u64), Error> {
    let merger = Merger::new(grid, placed)?;
    let what = format!("a merged field of {:?} samples", grid.shape);
    let mut distances = allocate_samples(&what, grid.len(), 4 * grid.len())?;
    let mut owners = vec![UNDECIDED; grid.len()];
    progress.set_total(2 * grid.len() as u64);
    find_owners(context, grid, placed, &mut owners, progress)?;

    let [nx, ny, _] = grid.shape;
    let (undecided, evaluations) = (AtomicU64::new(0), AtomicU64::new(0));
    let rows = distances.par_chunks_mut(nx).zip(owners.par_chunks_mut(nx)).enumerate();
    rows.try_for_each(|(row, (distances, owners))| {
        let (mut undecided_in_row, mut evaluated) = (0, 0);
        for (x, (distance, owner)) in distances.iter_mut().zip(owners).enumerate() {
            let p = merger.center(x, row % ny, row / ny);
            if let Some(placed) = placed.get(*owner as usize) {
                *distance = round_down(placed.lower_bound(p, f64::INFINITY));
                evaluated += 1;
                continue;
            }
            undecided_in_row += 1;
            let mut best = f32::INFINITY;
            merger.tree.around([p, p], f64::INFINITY, |place, limit| {
                let field = merger.tree.order[place];
                let bound = placed[field as usize].lower_bound(p, f64::from(best));
                evaluated += 1;
                if bound < f64::from(best) {
                    (best, *owner) = (round_down(bound), field);
                    *limit = f64::from(best);
                }
            });
            *distance = best;
        }
        undecided.fetch_add(undecided_in_row, Ordering::Relaxed);
        evaluations.fetch_add(evaluated, Ordering::Relaxed);
        progress.advance(nx as u64)
    })?;
    Ok((Merged { distances, owners, evaluations: evaluations.into_inner() }, undecided.into_inner()))
}

/// World space relative to its centre, divided by a power of two, so that it spans about 1.
struct SceneSpace {
    center: DVec3,
    scale: f64,
}

impl SceneSpace {
    fn new(grid: &Grid, placed: &[Placed<'_>]) -> Self {
        let lower = placed.iter().fold(grid.lower, |lower, placed| lower.min(placed.bounds[0]));
        let upper = placed.iter().fold(grid.upper, |upper, placed| upper.max(placed.bounds[1]));
        let scale = (upper - lower).max_element().log2().ceil().exp2();
        Self { center: 0.5 * lower + 0.5 * upper, scale }
    }

    fn scene_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.scale
    }

    fn world_from_scene(&self) -> DAffine3 {
        DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::splat(self.scale)), self.center)
    }
}

/// The index of the field with the smallest bound at each sample, or [`UNDECIDED`].
fn find_owners(
    context: &Arc<Context>,
    grid: &Grid,
    placed: &[Placed<'_>],
    owners: &mut [u32],
    progress: &Progress,
) -> Result<(), Error> {
    let scene = SceneSpace::new(grid, placed);
    let tables = KernelTables::new(&scene, placed);
    let total: usize = tables.volumes.iter().map(|field| field.distances().len()).sum();
    context.check_size("the volumes of a merge", 4 * total as u64)?;
    let mut samples = Vec::with_capacity(total);
    tables.volumes.iter().for_each(|field| samples.extend_from_slice(field.distances()));

    let [nx, ny, nz] = grid.shape;
    let center = |i: usize, axis: usize| {
        let p = grid.lower + (i as f64 + 0.5) * grid.spacing();
        scene.scene_from_world(p)[axis] as f32
    };
    let axes: Vec<f32> = (0..3)
        .flat_map(|axis| (0..grid.shape[axis]).map(move |i| (i, axis)))
        .map(|(i, axis)| center(i, axis))
        .collect();
    let planes = ((context.max_binding() / (4 * (nx * ny) as u64)) as usize).clamp(1, nz);
    context.check_size("a plane of a merged field", 4 * (nx * ny) as u64)?;
    let mut params = MergeParams { shape: grid.shape.map(|n| n as u32), ..MergeParams::default() };
    let uniform = context.uniform("merge parameters", &params)?;
    let found = context.storage("owners", (4 * nx * ny * planes) as u64)?;
    let buffers = [
        context.upload("merge tree", &tables.nodes)?,
        context.upload("merge order", &tables.order)?,
        context.upload("merge fields", &tables.fields)?,
        context.upload("merge grids", &tables.grids)?,
        context.upload("merge samples", &samples)?,
        context.upload("merge positions", &axes)?,
    ];
    let kernel = context.kernel("merge_owners", "main")?;
    let bindings: Vec<_> = std::iter::once(&uniform).chain(&buffers).chain([&found]).enumerate().collect();
    let bindings: Vec<_> = bindings.into_iter().map(|(binding, buffer)| (binding as u32, buffer)).collect();
    let group = context.bind("merge", &kernel, &bindings)?;

    for (slab, owners) in owners.chunks_mut(nx * ny * planes).enumerate() {
        params.first_plane = (slab * planes) as u32;
        in_groups(context, "the merge", owners.len(), progress, |first, count, workgroups| {
            (params.first, params.count) = (first, count);
            context.write("merge parameters", &uniform, 0, &[params])?;
            progress.advance(count.into())?;
            Ok(context.dispatch("merge", &kernel, &group, workgroups)?)
        })?;
        context.read("owners", &found, owners, progress)?;
    }
    Ok(())
}

/// The buffers of the kernel.
struct KernelTables<'a> {
    nodes: Vec<MergeNode>,
    order: Vec<u32>,
    fields: Vec<MergeField>,
    grids: Vec<MergeGrid>,
    /// One volume per grid.
    volumes: Vec<FieldView<'a>>,
}

impl<'a> KernelTables<'a> {
    fn new(scene: &SceneSpace, placed: &[Placed<'a>]) -> Self {
        let boxes: Vec<_> =
            placed.iter().map(|placed| placed.bounds.map(|corner| scene.scene_from_world(corner))).collect();
        let tree = BoxTree::new(&boxes);
        // One more rounding than the boxes of the tree; the shader's margin covers it.
        let about_center = |corner: Vec3| (corner.as_dvec3() + tree.center).as_vec3().to_array();
        let nodes = tree.nodes.iter().map(|node| MergeNode {
            min: about_center(node.min),
            first: node.first,
            max: about_center(node.max),
            count: node.count,
        });
        let mut tables =
            Self { nodes: nodes.collect(), order: tree.order.clone(), fields: vec![], grids: vec![], volumes: vec![] };
        for (placed, bounds) in placed.iter().zip(&boxes) {
            let field = tables.field(scene, placed, bounds);
            tables.fields.push(field);
        }
        tables
    }

    fn field(&mut self, scene: &SceneSpace, placed: &Placed<'a>, bounds: &[DVec3; 2]) -> MergeField {
        let unknown = MergeField {
            lower: bounds[0].as_vec3().to_array(),
            upper: bounds[1].as_vec3().to_array(),
            ..MergeField::default()
        };
        let Geometry::Volume { field, inner } = placed.geometry else { return unknown };
        if placed.is_cut {
            return unknown;
        }
        let grid = *field.grid();
        // The unit makes lengths about 1.
        let unit = (grid.upper - grid.lower).length().log2().ceil().exp2();
        let center = (0.5 * bounds[0] + 0.5 * bounds[1]).as_vec3();
        let local_from_scene = placed.local_from_world * scene.world_from_scene();
        let per_voxel = 1.0 / grid.spacing();
        let rows = (DMat3::from_diagonal(per_voxel) * local_from_scene.matrix3).transpose();
        let middle = field.grid_from_world(local_from_scene.transform_point3(center.as_dvec3()));
        let span = [rows.x_axis, rows.y_axis, rows.z_axis].map(|row| row.abs().element_sum());
        let voxels = grid.shape.map(|n| n as f64).into_iter().fold(0.0, f64::max);
        let error = POSITION_ERROR * span.into_iter().fold(0.0, f64::max) + VOXEL_ERROR * voxels;
        // The cells are so small that every point may lie on a face of one.
        if error > 0.1 {
            return unknown;
        }
        let row = |row: DVec3, middle: f64| row.extend(middle).as_vec4().to_array();
        MergeField {
            row_x: row(rows.x_axis, middle.x),
            row_y: row(rows.y_axis, middle.y),
            row_z: row(rows.z_axis, middle.z),
            center: center.to_array(),
            grid: self.grid(field, unit),
            sigma_min: (placed.sigma_min * unit / scene.scale) as f32,
            sigma_max: (placed.sigma_max * unit / scene.scale) as f32,
            inner_lower: field.grid_from_world(inner[0]).as_vec3().to_array(),
            inner_upper: field.grid_from_world(inner[1]).as_vec3().to_array(),
            error: error as f32,
            is_known: 1,
            ..unknown
        }
    }

    /// Index of a volume among the grids. Each volume is stored once.
    fn grid(&mut self, field: FieldView<'a>, unit: f64) -> u32 {
        let is_same =
            |known: &FieldView<'_>| std::ptr::eq(known.distances(), field.distances()) && known.grid() == field.grid();
        if let Some(found) = self.volumes.iter().position(is_same) {
            return found as u32;
        }
        let first_sample = self.volumes.iter().map(|volume| volume.distances().len() as u32).sum();
        self.grids.push(MergeGrid {
            shape: field.grid().shape.map(|n| n as u32),
            first_sample,
            spacing: (field.grid().spacing() / unit).as_vec3().to_array(),
            inverse_unit: (1.0 / unit) as f32,
        });
        self.volumes.push(field);
        (self.volumes.len() - 1) as u32
    }
}
