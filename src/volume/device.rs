//! A field in device memory.
//!
//! The field is divided into slabs of whole planes. Each slab is a buffer that a kernel can bind, so a field may be
//! larger than the largest binding. It stays on the device until its samples are read.

use crate::error::{DeviceError, Error};
use crate::gpu::Context;
use crate::memory::{allocate_samples, require_for_device};
use crate::progress::Progress;
use std::sync::Arc;

/// Samples of a grid on a device, x fastest.
#[derive(Debug, Clone)]
pub struct DeviceField {
    context: Arc<Context>,
    shape: [usize; 3],
    slabs: Vec<Slab>,
}

/// Whole planes of a field.
#[derive(Debug, Clone)]
pub struct Slab {
    pub first_plane: usize,
    pub planes: usize,
    pub buffer: wgpu::Buffer,
}

/// The number of planes of a slab is a multiple of this if it fits, so that blocks of samples are whole.
const ALIGN_PLANES: usize = 4;

impl DeviceField {
    /// Allocates a field. No slab is larger than `max_bytes` or than the device can bind.
    pub fn allocate(context: &Arc<Context>, shape: [usize; 3], max_bytes: u64) -> Result<Self, Error> {
        let [nx, ny, nz] = shape;
        let what = format!("a field of {nx} x {ny} x {nz} samples");
        let total = (nx * ny * nz) as u64 * SAMPLE;
        if !context.info.hardware {
            // An emulated device would grant more memory than the machine has.
            require_for_device(&what, total)?;
        }
        let plane_bytes = (nx * ny) as u64 * SAMPLE;
        context.check_size(&format!("a plane of {nx} x {ny} samples"), plane_bytes)?;
        let fitting = (max_bytes.min(context.max_binding()) / plane_bytes).max(1) as usize;
        let planes = if fitting > ALIGN_PLANES { fitting / ALIGN_PLANES * ALIGN_PLANES } else { fitting };
        let slabs = (0..nz)
            .step_by(planes)
            .map(|first_plane| {
                let planes = planes.min(nz - first_plane);
                let buffer = context.storage(&what, plane_bytes * planes as u64)?;
                Ok(Slab { first_plane, planes, buffer })
            })
            .collect::<Result<_, DeviceError>>()?;
        Ok(Self { context: context.clone(), shape, slabs })
    }

    /// Copies samples to a device.
    pub fn upload(context: &Arc<Context>, shape: [usize; 3], samples: &[f32]) -> Result<Self, Error> {
        let field = Self::allocate(context, shape, u64::MAX)?;
        let plane = shape[0] * shape[1];
        for slab in &field.slabs {
            context.fill("a field", &slab.buffer, &samples[plane * slab.first_plane..][..plane * slab.planes])?;
        }
        Ok(field)
    }

    /// Copies the samples to the host.
    pub fn read(&self, progress: &Progress) -> Result<Vec<f32>, Error> {
        let [nx, ny, nz] = self.shape;
        let what = format!("a field of {nx} x {ny} x {nz} samples");
        let mut samples = allocate_samples(&what, nx * ny * nz, 0)?;
        for slab in &self.slabs {
            let part = &mut samples[nx * ny * slab.first_plane..][..nx * ny * slab.planes];
            self.context.read("read back a field", &slab.buffer, part, progress)?;
        }
        Ok(samples)
    }

    pub fn context(&self) -> &Arc<Context> {
        &self.context
    }

    pub fn shape(&self) -> [usize; 3] {
        self.shape
    }

    pub fn slabs(&self) -> &[Slab] {
        &self.slabs
    }

    /// Size of the device memory in use, bytes.
    pub fn bytes(&self) -> u64 {
        self.slabs.iter().map(|slab| slab.buffer.size()).sum()
    }
}

const SAMPLE: u64 = size_of::<f32>() as u64;
