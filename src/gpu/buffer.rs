//! Buffers in device memory, and counters of their transfers.
//!
//! Sizes are compared with the limits of the device before anything is allocated, since software adapters allocate
//! lazily and grant more than they have. Uploads and read-backs are counted, so that a test can verify that a field
//! baked on the device is drawn without leaving it.

use super::context::Context;
use crate::error::{DeviceError, Error};
use crate::progress::Progress;
use bytemuck::Pod;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Number of transfers through the handles of a device that share these counters.
#[derive(Debug, Default)]
pub struct Counters {
    pub uploads: AtomicU64,
    pub uploaded_bytes: AtomicU64,
    pub submits: AtomicU64,
    pub readbacks: AtomicU64,
    pub readback_bytes: AtomicU64,
}

/// Interval between two checks of the progress while waiting.
const LOOK: Duration = Duration::from_millis(50);
/// A dispatch takes about 50 ms. A device that has not finished one within this time hangs.
const HANG: Duration = Duration::from_secs(120);
/// Size of the pieces of a read-back, which bounds the staging memory, bytes.
const STAGING_BYTES: u64 = 64 << 20;
/// Remedy for a buffer that is too large.
const ADVICE: &str = "lower the resolution, bake parts of the box through bounds=, or use device=\"cpu\"";

/// Memory for results that a submission copies, which the host can map.
#[derive(Debug)]
pub struct ReadBack {
    staging: wgpu::Buffer,
    /// Whether the last copy is mapped.
    is_mapped: Arc<AtomicBool>,
}

impl ReadBack {
    /// The size in bytes.
    pub fn size(&self) -> u64 {
        self.staging.size()
    }

    /// Records the copy of a part of a buffer, from the offset `from_byte` to the offset `to_byte` of the memory.
    pub(super) fn record(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        from: &wgpu::Buffer,
        from_byte: u64,
        to_byte: u64,
        bytes: u64,
    ) {
        encoder.copy_buffer_to_buffer(from, from_byte, &self.staging, to_byte, bytes);
    }

    /// Requests the mapping of the copied bytes, after the submission of the copy.
    pub(super) fn map(&self, bytes: u64) {
        self.is_mapped.store(false, Ordering::Release);
        let done = self.is_mapped.clone();
        self.staging.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
            done.store(result.is_ok(), Ordering::Release);
        });
    }
}

impl Context {
    /// The largest buffer that a kernel can bind as a whole, bytes; a multiple of 256.
    pub fn max_binding(&self) -> u64 {
        self.limits.max_buffer_size.min(self.limits.max_storage_buffer_binding_size) / 256 * 256
    }

    /// Fails if a buffer of this size cannot be bound.
    pub fn check_size(&self, what: &str, bytes: u64) -> Result<(), DeviceError> {
        let limit = self.max_binding();
        if bytes > limit {
            return Err(DeviceError::TooLarge {
                device: self.label(),
                what: what.into(),
                needed: bytes,
                limit,
                advice: ADVICE,
            });
        }
        Ok(())
    }

    /// A zeroed buffer that kernels read and write, and that can be copied in both directions.
    pub fn storage(&self, label: &str, bytes: u64) -> Result<wgpu::Buffer, DeviceError> {
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC | wgpu::BufferUsages::COPY_DST;
        self.allocate(label, bytes, usage)
    }

    /// A buffer for a struct of parameters.
    pub fn uniform<T: Pod>(&self, label: &str, value: &T) -> Result<wgpu::Buffer, DeviceError> {
        let usage = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let buffer = self.allocate(label, size_of::<T>() as u64, usage)?;
        self.write(label, &buffer, 0, std::slice::from_ref(value))?;
        Ok(buffer)
    }

    /// A storage buffer for parameters that are the same for all invocations of a dispatch. It is not a uniform buffer,
    /// because Mesa's llvmpipe optimises a kernel again for every value that its branches read from one: about 25 ms
    /// per dispatch for a long kernel.
    pub fn parameters<T: Pod>(&self, label: &str, value: &T) -> Result<wgpu::Buffer, DeviceError> {
        let buffer = self.storage(label, size_of::<T>() as u64)?;
        self.write(label, &buffer, 0, std::slice::from_ref(value))?;
        Ok(buffer)
    }

    /// A zeroed buffer for parameters or sizes of dispatches that a kernel writes.
    pub fn written_by_kernels(&self, label: &str, bytes: u64) -> Result<wgpu::Buffer, DeviceError> {
        use wgpu::BufferUsages as Usage;
        self.allocate(label, bytes, Usage::STORAGE | Usage::UNIFORM | Usage::INDIRECT | Usage::COPY_DST)
    }

    /// A storage buffer with `items`; one zeroed item if there are none, since an empty buffer cannot be bound.
    pub fn upload<T: Pod>(&self, label: &str, items: &[T]) -> Result<wgpu::Buffer, DeviceError> {
        let bytes = size_of_val(items).max(size_of::<T>()) as u64;
        let buffer = self.storage(label, bytes)?;
        self.fill(label, &buffer, items)?;
        Ok(buffer)
    }

    /// Copies `items` to the start of a buffer.
    pub fn fill<T: Pod>(&self, label: &str, buffer: &wgpu::Buffer, items: &[T]) -> Result<(), DeviceError> {
        // The copy is done in pieces, since the queue keeps a copy of each until it is submitted.
        let piece = (STAGING_BYTES as usize / size_of::<T>()).max(1);
        for (i, part) in items.chunks(piece).enumerate() {
            self.write(label, buffer, (i * piece * size_of::<T>()) as u64, part)?;
            self.guarded(label, 0, || self.submit(None))?;
        }
        Ok(())
    }

    /// Overwrites a part of a buffer, before the next submission.
    pub fn write<T: Pod>(
        &self,
        label: &str,
        buffer: &wgpu::Buffer,
        offset: u64,
        items: &[T],
    ) -> Result<(), DeviceError> {
        self.guarded(label, 0, || self.queue.write_buffer(buffer, offset, bytemuck::cast_slice(items)))?;
        self.counters.uploads.fetch_add(1, Ordering::Relaxed);
        self.counters.uploaded_bytes.fetch_add(size_of_val(items) as u64, Ordering::Relaxed);
        Ok(())
    }

    fn allocate(&self, label: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer, DeviceError> {
        self.check_size(label, bytes)?;
        let descriptor = wgpu::BufferDescriptor {
            label: Some(label),
            size: bytes.next_multiple_of(4),
            usage,
            mapped_at_creation: false,
        };
        self.guarded(label, bytes, || self.device.create_buffer(&descriptor))
    }

    /// Copies the first items of a buffer to `out`.
    pub fn read<T: Pod>(
        &self,
        label: &str,
        buffer: &wgpu::Buffer,
        out: &mut [T],
        progress: &Progress,
    ) -> Result<(), Error> {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(out);
        let total = bytes.len() as u64;
        if total == 0 {
            return Ok(());
        }
        let memory = self.read_back(label, total.min(STAGING_BYTES))?;
        for (i, part) in bytes.chunks_mut(STAGING_BYTES as usize).enumerate() {
            let (offset, size) = (i as u64 * STAGING_BYTES, part.len() as u64);
            let submission = self.guarded(label, size, || {
                let mut encoder =
                    self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
                memory.record(&mut encoder, buffer, offset, 0, size);
                let submission = self.submit(Some(encoder.finish()));
                memory.map(size);
                submission
            })?;
            self.wait(label, &submission, progress)?;
            self.take(label, &memory, part)?;
        }
        self.counters.readbacks.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Memory for results of at most this size, bytes.
    pub fn read_back(&self, label: &str, bytes: u64) -> Result<ReadBack, DeviceError> {
        let usage = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        Ok(ReadBack { staging: self.allocate(label, bytes, usage)?, is_mapped: Arc::default() })
    }

    /// Reads the bytes that a finished submission copied, and unmaps them.
    pub(super) fn take<T: Pod>(&self, label: &str, memory: &ReadBack, out: &mut [T]) -> Result<(), DeviceError> {
        if !memory.is_mapped.load(Ordering::Acquire) {
            self.check(label)?;
            return Err(self.failed(label, "the result could not be mapped".into()));
        }
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(out);
        let range = 0..bytes.len() as u64;
        let view = memory.staging.get_mapped_range(range).map_err(|error| self.failed(label, error.to_string()))?;
        bytes.copy_from_slice(&view);
        drop(view);
        memory.staging.unmap();
        self.counters.readback_bytes.fetch_add(bytes.len() as u64, Ordering::Relaxed);
        Ok(())
    }

    /// Reads results that a finished submission copied.
    pub fn finish<T: Pod>(&self, label: &str, memory: &ReadBack, out: &mut [T]) -> Result<(), DeviceError> {
        self.take(label, memory, out)?;
        self.counters.readbacks.fetch_add(1, Ordering::Relaxed);
        Ok(())
    }

    /// Waits for a submission. A cancelled job stops waiting; its submitted work finishes in the background.
    pub fn wait(&self, what: &str, submission: &wgpu::SubmissionIndex, progress: &Progress) -> Result<(), Error> {
        let start = Instant::now();
        loop {
            let poll = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: Some(LOOK) };
            let lane = self.lane();
            let outcome = self.device.poll(poll);
            drop(lane);
            self.check(what)?;
            match outcome {
                Ok(_) => return progress.check(),
                Err(wgpu::PollError::Timeout) if start.elapsed() > HANG => {
                    self.abandon("it did not answer");
                    self.check(what)?;
                }
                Err(wgpu::PollError::Timeout) => progress.check()?,
                Err(error) => return Err(self.failed(what, error.to_string()).into()),
            }
        }
    }
}
