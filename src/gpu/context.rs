//! An open device: one per process, shared by all threads, opened again after a loss.
//!
//! A device can be lost at any time (driver update, watchdog, unplugged). wgpu then reports no error from later calls,
//! so the context has a flag of its own, which the loss callback sets and every wait checks. [`context`] returns a
//! working context or opens a new one.
//!
//! Drivers have threads and locks that a forked child does not inherit. The process that opened the first device is
//! therefore recorded, and a child of it gets an error instead of a deadlock.

use super::buffer::Counters;
use super::device::{DeviceInfo, describe, enumerate};
use super::pipeline::{Pipelines, WrittenKernels};
use super::raster::RasterPipelines;
use crate::error::DeviceError;
use std::collections::HashMap;
use std::ops::Deref;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A handle of an open device. Each handle counts the transfers that were made through it.
#[derive(Debug)]
pub struct Context {
    open: Arc<OpenDevice>,
    /// Transfers and submissions of the context.
    pub counters: Arc<Counters>,
}

impl Deref for Context {
    type Target = OpenDevice;

    fn deref(&self) -> &OpenDevice {
        &self.open
    }
}

/// An open device, its queue, its compiled kernels and its errors.
#[derive(Debug)]
pub struct OpenDevice {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub info: DeviceInfo,
    pub limits: wgpu::Limits,
    pub(super) pipelines: Pipelines,
    pub(super) raster_pipelines: RasterPipelines,
    pub(super) written: WrittenKernels,
    trouble: Arc<Trouble>,
    /// Held during every call into wgpu. Its submissions and waits are not safe against each other in wgpu 30.0, and a
    /// mapping that another thread's wait completed must be visible as complete.
    lane: Mutex<()>,
    // Dropped last, because the device was made from it.
    _instance: wgpu::Instance,
}

/// Errors that the driver reported asynchronously.
#[derive(Debug, Default)]
struct Trouble {
    lost: AtomicBool,
    reason: Mutex<String>,
    uncaptured: Mutex<Option<String>>,
}

/// Number of storage buffers that a kernel may bind: the default limit of WebGPU.
pub(crate) const STORAGE_BUFFERS: u32 = 8;
/// Number of invocations of the largest workgroup.
pub(crate) const INVOCATIONS: u32 = 64;

/// Id of the process that opened the first device, or zero.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Whether a parent of this process opened a device.
pub(crate) fn is_forked() -> bool {
    let owner = OWNER.load(Ordering::Acquire);
    owner != 0 && owner != std::process::id()
}

/// The context of an adapter, opened at the first call.
pub fn context(info: &DeviceInfo) -> Result<Arc<Context>, DeviceError> {
    static CONTEXTS: Mutex<Option<HashMap<String, Arc<Context>>>> = Mutex::new(None);
    // This check precedes the lock, which another thread may have held at the fork.
    if is_forked() {
        return Err(DeviceError::Forked { device: info.label() });
    }
    let mut contexts = CONTEXTS.lock().unwrap_or_else(PoisonError::into_inner);
    let contexts = contexts.get_or_insert_with(HashMap::new);
    if let Some(context) = contexts.get(&info.label())
        && !context.is_lost()
    {
        return Ok(context.clone());
    }
    let context = Arc::new(Context::open(info)?);
    contexts.insert(info.label(), context.clone());
    Ok(context)
}

impl Context {
    pub(crate) fn open(info: &DeviceInfo) -> Result<Self, DeviceError> {
        let unavailable = |reason: String| DeviceError::NotAvailable { requested: info.label(), reason };
        let (instance, adapters) = enumerate();
        OWNER.store(std::process::id(), Ordering::Release);
        let adapter = adapters.into_iter().find(|adapter| describe(adapter).label() == info.label());
        let adapter = adapter.ok_or_else(|| unavailable("the driver no longer offers it".into()))?;
        let limits = adapter.limits();
        let needed = wgpu::DownlevelFlags::COMPUTE_SHADERS | wgpu::DownlevelFlags::INDIRECT_EXECUTION;
        let can_compute = adapter.get_downlevel_capabilities().flags.contains(needed);
        check_adapter(can_compute, &limits).map_err(unavailable)?;

        let optional = wgpu::Features::FLOAT32_FILTERABLE | wgpu::Features::TIMESTAMP_QUERY;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("fieldbake"),
            required_features: adapter.features() & optional,
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| unavailable(error.to_string()))?;

        let trouble = Arc::new(Trouble::default());
        let shared = trouble.clone();
        device.set_device_lost_callback(move |reason, message| shared.lose(&format!("{reason:?}: {message}")));
        let shared = trouble.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            *shared.uncaptured.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
        }));
        let open = OpenDevice {
            device,
            queue,
            info: info.clone(),
            limits,
            pipelines: Pipelines::default(),
            raster_pipelines: RasterPipelines::default(),
            written: WrittenKernels::default(),
            trouble,
            lane: Mutex::new(()),
            _instance: instance,
        };
        Ok(Self { open: Arc::new(open), counters: Arc::default() })
    }

    /// Another handle of the same device, with these counters.
    pub fn counted_by(&self, counters: &Arc<Counters>) -> Arc<Self> {
        Arc::new(Self { open: self.open.clone(), counters: counters.clone() })
    }

    /// Whether two handles have the same open device.
    pub fn is_same_device(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.open, &other.open)
    }

    /// Submits commands, or only the pending writes if there are none.
    pub(super) fn submit(&self, commands: Option<wgpu::CommandBuffer>) -> wgpu::SubmissionIndex {
        self.counters.submits.fetch_add(1, Ordering::Relaxed);
        self.queue.submit(commands)
    }

    /// Name and backend, for reports.
    pub fn label(&self) -> String {
        self.info.label()
    }

    /// Whether the device stopped working.
    pub fn is_lost(&self) -> bool {
        self.trouble.lost.load(Ordering::Acquire)
    }

    /// Fails if the device is lost, or reported an error outside of a call.
    pub fn check(&self, what: &str) -> Result<(), DeviceError> {
        if self.is_lost() {
            let reason = self.trouble.reason.lock().unwrap_or_else(PoisonError::into_inner).clone();
            return Err(DeviceError::Lost { device: self.label(), what: what.into(), reason });
        }
        match self.trouble.uncaptured.lock().unwrap_or_else(PoisonError::into_inner).take() {
            Some(reason) => Err(self.failed(what, reason)),
            None => Ok(()),
        }
    }

    /// Destroys the device, as if the driver had removed it; later calls report a loss.
    pub fn destroy(&self) {
        self.device.destroy();
        self.trouble.lose("destroyed on request");
    }

    /// Marks the device as lost after a wait without a result.
    pub(super) fn abandon(&self, reason: &str) {
        self.trouble.lose(reason);
    }

    /// Runs `call` inside error scopes. `needed` is the size of its allocation for the message, bytes.
    pub fn guarded<T>(&self, what: &str, needed: u64, call: impl FnOnce() -> T) -> Result<T, DeviceError> {
        let lane = self.lane();
        let value = self.scoped(what, needed, call);
        drop(lane);
        value
    }

    /// [`Self::guarded`] without the lock, for calls that neither submit nor wait.
    pub(super) fn scoped<T>(&self, what: &str, needed: u64, call: impl FnOnce() -> T) -> Result<T, DeviceError> {
        self.check(what)?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let value = call();
        // Scopes are popped from the innermost outwards. The futures are ready at once on native backends.
        let errors = [internal.pop(), validation.pop(), memory.pop()].map(pollster::block_on);
        self.check(what)?;
        match errors.into_iter().flatten().next() {
            None => Ok(value),
            Some(wgpu::Error::OutOfMemory { .. }) => {
                Err(DeviceError::OutOfMemory { device: self.label(), what: what.into(), needed })
            }
            Some(error) => Err(self.failed(what, error.to_string())),
        }
    }

    /// Locks the calls into wgpu.
    pub(super) fn lane(&self) -> MutexGuard<'_, ()> {
        self.lane.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn failed(&self, what: &str, reason: String) -> DeviceError {
        DeviceError::Failed { device: self.label(), what: what.into(), reason }
    }
}

impl Trouble {
    fn lose(&self, reason: &str) {
        if !self.lost.swap(true, Ordering::AcqRel) {
            reason.clone_into(&mut self.reason.lock().unwrap_or_else(PoisonError::into_inner));
        }
    }
}

/// Whether an adapter has the features and limits of the kernels; otherwise the reason.
pub(super) fn check_adapter(can_compute: bool, limits: &wgpu::Limits) -> Result<(), String> {
    if !can_compute {
        return Err("it has no compute shaders with indirect dispatches".into());
    }
    let needs = [
        ("storage buffers per shader stage", limits.max_storage_buffers_per_shader_stage, STORAGE_BUFFERS),
        ("invocations per workgroup", limits.max_compute_invocations_per_workgroup, INVOCATIONS),
        ("workgroups per dimension", limits.max_compute_workgroups_per_dimension, 65_535),
    ];
    match needs.into_iter().find(|(_, has, needs)| has < needs) {
        Some((what, has, needs)) => Err(format!("it allows {has} {what}, {needs} are needed")),
        None => Ok(()),
    }
}
