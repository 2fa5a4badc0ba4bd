//! The fields of a scene in the layout of devices (`shaders/shared/scene/scene_field.wgsl`): one record per field, and
//! the tables of floats and bytes that records refer to. The shader of each kind documents its layout.

use super::shader_variants::{ARRAY, FieldKind, GeometryKinds, MAX_STRUCTURES, TURNS};
use crate::csg::model::lowered::Model;
use crate::csg::parts::solid::Solid;
use crate::csg::text::structure_text::StructureText;
use crate::error::DeviceError;
use crate::gpu::Context;
use crate::gpu::layout::SceneField;
use crate::grid::Grid;
use crate::march::empty::EmptySpace;
use crate::quadric::local::Local;
use crate::volume::Trilinear;
use crate::volume::sparse::SparseView;

/// Tables that grow by one field at a time.
pub struct DeviceFields<'a> {
    context: &'a Context,
    pub(crate) records: Vec<SceneField>,
    pub samples: Vec<f32>,
    pub bytes: Vec<u8>,
    pub kinds: GeometryKinds,
}

impl<'a> DeviceFields<'a> {
    pub fn new(context: &'a Context) -> Self {
        Self { context, records: Vec::new(), samples: Vec::new(), bytes: Vec::new(), kinds: GeometryKinds::default() }
    }

    pub fn add_dense(&mut self, grid: &Grid, samples: &[f32], empty: &EmptySpace) -> Result<(), DeviceError> {
        let record = self.sampled(FieldKind::Dense, grid, empty);
        self.add(record, &[samples])
    }

    pub fn add_sparse(&mut self, view: &SparseView<'_, f32>, empty: &EmptySpace) -> Result<(), DeviceError> {
        let record = self.sampled(FieldKind::Sparse, view.grid(), empty);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        self.bytes.extend_from_slice(bytemuck::cast_slice(view.index()));
        let (header, nodes) = view.for_devices();
        self.add(record, &[&header, &nodes, view.texels()])
    }

    /// Appends the record of nested fields. The last `levels` records are their levels, finest first. `numbers` has the
    /// map and the region of each level, see `shaders/shared/scene/variants/scene_nested.wgsl`.
    pub(crate) fn add_nested(&mut self, levels: usize, numbers: &[f32]) -> Result<(), DeviceError> {
        let record = SceneField {
            shape: [levels as u32, 0, 0],
            first_block: (self.records.len() - levels) as u32,
            kind: FieldKind::Nested as u32,
            ..SceneField::default()
        };
        self.add(record, &[numbers])?;
        self.kinds.nested = true;
        Ok(())
    }

    pub fn add_quadric(&mut self, local: &Local) -> Result<(), DeviceError> {
        let numbers = local.matrix().to_cols_array().map(|entry| entry as f32);
        self.add(SceneField { kind: FieldKind::Quadric as u32, ..SceneField::default() }, &[&numbers])?;
        self.kinds.quadrics = true;
        Ok(())
    }

    /// Appends the record and the parameters of a shape. Returns false for a shape that has no function, or beyond the
    /// largest number of functions.
    pub fn add_shape(&mut self, solid: &Solid) -> Result<bool, DeviceError> {
        let Some(StructureText { body, numbers, .. }) = StructureText::of(solid, ARRAY, TURNS) else {
            return Ok(false);
        };
        let structures = &mut self.kinds.structures;
        let found = structures.iter().position(|found| *found == body);
        if found.is_none() && structures.len() == MAX_STRUCTURES {
            return Ok(false);
        }
        let structure = found.unwrap_or_else(|| {
            structures.push(body);
            structures.len() - 1
        });
        let Model { lipschitz, is_exact, .. } = solid.model;
        let header =
            [structure as f32, (1.0 / lipschitz) as f32, solid.frame.scale as f32, f32::from(u8::from(is_exact))];
        self.add(SceneField { kind: FieldKind::Shape as u32, ..SceneField::default() }, &[&header, &numbers])?;
        Ok(true)
    }

    /// The record of a sampled field; its empty space is appended to the bytes.
    fn sampled(&mut self, kind: FieldKind, grid: &Grid, empty: &EmptySpace) -> SceneField {
        self.kinds.sparse |= kind == FieldKind::Sparse;
        let first_block = self.bytes.len() as u32;
        self.bytes.extend_from_slice(empty.distances());
        SceneField {
            shape: grid.shape.map(|n| n as u32),
            spacing: grid.spacing().as_vec3().to_array(),
            first_block,
            blocks: empty.shape().map(|n| n as u32),
            kind: kind as u32,
            ..SceneField::default()
        }
    }

    /// Appends a record and its floats, if they fit on the device.
    fn add(&mut self, record: SceneField, numbers: &[&[f32]]) -> Result<(), DeviceError> {
        let count = self.samples.len() + numbers.iter().map(|numbers| numbers.len()).sum::<usize>();
        self.context.check_size("the fields of a scene", 4 * count as u64)?;
        self.context.check_size("the blocks of a scene", self.bytes.len() as u64)?;
        self.records.push(SceneField { first_sample: self.samples.len() as u32, ..record });
        numbers.iter().for_each(|numbers| self.samples.extend_from_slice(numbers));
        Ok(())
    }

    /// The bytes in words.
    pub fn words(&self) -> Vec<u32> {
        self.bytes
            .chunks(4)
            .map(|bytes| bytes.iter().rev().fold(0, |word, &byte| word << 8 | u32::from(byte)))
            .collect()
    }
}
