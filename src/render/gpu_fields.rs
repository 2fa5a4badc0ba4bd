//! Fields for the ray marcher on a graphics device: dense samples in any encoding, bricks, nested
//! grids.
//!
//! Stored samples are uploaded unchanged and decoded by the kernel, so a field has the same size on the device as on
//! the host. A sparse field needs one more byte per brick, for the leaps.

use crate::encoding::Encoding;
use crate::error::{ArgumentError, DeviceError, Error};
use crate::gpu::Context;
use crate::gpu::constants::ray_sparse::MAX_STEPS;
use crate::gpu::layout::{NestedLevel, StoredParams};
use crate::grid::Grid;
use crate::march::blocks::Blocks;
use crate::march::bricks::MaskedBricks;
use crate::march::empty::EmptySpace;
use crate::picture::Filter;
use crate::progress::Progress;
use crate::volume::device::DeviceField;
use crate::volume::sparse::SparseView;
use crate::volume::{FieldView, Texel, Trilinear};
use std::sync::Arc;

/// A field on a device, and the kernel that marches rays through it.
pub(super) struct MarchedField {
    pub context: Arc<Context>,
    pub kernel: &'static str,
    buffers: Vec<(u32, wgpu::Buffer)>,
}

impl MarchedField {
    /// The buffers that the kernel binds besides the parameters of the picture.
    pub(super) fn resources(&self) -> impl Iterator<Item = (u32, wgpu::BindingResource<'_>)> {
        self.buffers.iter().map(|(binding, buffer)| (*binding, buffer.as_entire_binding()))
    }

    /// Float32 samples that are already on the device.
    pub(super) fn dense(field: &DeviceField, filter: Filter) -> Result<Self, DeviceError> {
        let kernel = match filter {
            Filter::Linear => "raymarch",
            Filter::Nearest => "raymarch_nearest",
        };
        Ok(Self { context: field.context().clone(), kernel, buffers: vec![(1, whole(field)?.clone())] })
    }

    /// Copies samples to a device in their stored encoding.
    pub(super) fn encoded<T: Texel>(context: &Arc<Context>, field: FieldView<'_, T>) -> Result<Self, Error> {
        let buffers = stored(context, "a field", field.texels(), field.scale())?;
        Ok(Self { context: context.clone(), kernel: "raymarch_encoded", buffers: buffers.into() })
    }

    /// Copies bricks to a device in their stored encoding.
    pub(super) fn sparse<T: Texel>(
        context: &Arc<Context>,
        view: SparseView<'_, T>,
        progress: &Progress,
    ) -> Result<Self, Error> {
        check_sides(view.grid().shape.iter().sum())?;
        let bricks = MaskedBricks::new(view, progress)?;
        let empty = EmptySpace::new(bricks.block_counts(), &bricks.occupied(&()), progress)?;

        let (params, nodes) = view.for_devices();
        let mut buffers = Vec::from(stored(context, "bricks", view.texels(), view.scale())?);
        buffers.push((5, context.upload("the index of bricks", view.index())?));
        buffers.push((6, context.upload("distances between bricks", &nodes)?));
        buffers.push((8, context.upload_bytes("empty space", empty.distances())?));
        buffers.push((9, context.uniform("parameters of bricks", &params)?));
        Ok(Self { context: context.clone(), kernel: "raymarch_sparse", buffers })
    }

    /// Copies nested fields to a device, finest first. They are drawn on [`nested_grid`].
    pub(super) fn nested(context: &Arc<Context>, levels: &[FieldView<'_>], grid: &Grid) -> Result<Self, Error> {
        check_sides(levels.iter().flat_map(|level| level.grid().shape).sum())?;
        let voxel = grid.spacing();
        let mut first_sample = 0;
        let records: Vec<NestedLevel> = levels
            .iter()
            .map(|level| {
                let own = level.grid();
                let scale = voxel.x / own.spacing().x;
                let first = (own.lower - grid.lower) / own.spacing();
                let record = NestedLevel {
                    shape: own.shape.map(|n| n as u32),
                    first_sample,
                    offset: (0.5 * scale - 0.5 - first).as_vec3().to_array(),
                    scale: scale as f32,
                };
                first_sample += own.len() as u32;
                record
            })
            .collect();
        let samples = levels.iter().map(|level| level.distances()).collect::<Vec<_>>().concat();
        let buffers = vec![
            (1, context.upload("nested fields", &samples)?),
            (5, context.upload("levels of nested fields", &records)?),
        ];
        Ok(Self { context: context.clone(), kernel: "raymarch_nested", buffers })
    }
}

/// The grid of nested fields if every level were as fine as the first, the finest. It has no samples.
pub(super) fn nested_grid(levels: &[FieldView<'_>]) -> Option<Grid> {
    let (finest, outermost) = (levels.first()?.grid(), levels.last()?.grid());
    let ratio = (outermost.spacing() / finest.spacing()).round();
    let shape = [0, 1, 2].map(|axis| outermost.shape[axis] * ratio[axis] as usize);
    Some(Grid { shape, ..*outermost })
}

/// Loops on a device are bounded, which limits the number of cells along a ray.
fn check_sides(voxels: usize) -> Result<(), ArgumentError> {
    if voxels + 4 <= MAX_STEPS {
        return Ok(());
    }
    let problem = format!(
        "a graphics device follows a ray through {MAX_STEPS} voxels at most, and the sides of this field have {voxels} \
         together; use device=\"cpu\""
    );
    Err(ArgumentError::new("device", problem))
}

/// Stored samples and their decoding parameters; `shaders/shared/field/samples_encoded.wgsl`.
fn stored<T: Texel>(
    context: &Context,
    what: &str,
    texels: &[T],
    scale: f32,
) -> Result<[(u32, wgpu::Buffer); 2], DeviceError> {
    let encoding = match T::ENCODING {
        Encoding::Float32 => 0,
        Encoding::Float16 => 1,
        Encoding::Snorm16 => 2,
        Encoding::Snorm8 => 3,
    };
    let params = StoredParams { encoding, scale, ..StoredParams::default() };
    let samples = context.upload_bytes(what, bytemuck::cast_slice(texels))?;
    Ok([(1, samples), (7, context.uniform("encoding", &params)?)])
}

/// The samples as one buffer.
fn whole(field: &DeviceField) -> Result<&wgpu::Buffer, DeviceError> {
    match field.slabs() {
        [slab] => Ok(&slab.buffer),
        _ => Err(DeviceError::TooLarge {
            device: field.context().label(),
            what: "a field that is to be drawn".into(),
            needed: field.bytes(),
            limit: field.context().max_binding(),
            advice: "use device=\"cpu\" for the picture",
        }),
    }
}
