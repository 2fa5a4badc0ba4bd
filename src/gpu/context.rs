//! An open device: made once a process, shared by all threads, opened again after a loss.
//!
//! A device can vanish at any time (driver update, watchdog, unplugged). wgpu then reports no error from later calls, so
//! the context keeps its own flag, set by the loss callback and looked at after every wait. [`context`] hands out a
//! living context or opens a new one.
//!
//! Drivers keep threads and locks that a forked child does not have. So the process that opened the first device is
//! remembered, and a child of it gets an error instead of a deadlock.

use super::buffer::Counters;
use super::device::{DeviceInfo, describe, enumerate};
use super::pipeline::{Pipelines, WrittenKernels};
use super::raster::RasterPipelines;
use crate::error::DeviceError;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// An open device, its queue, its compiled kernels and what went wrong with it.
#[derive(Debug)]
pub struct Context {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub info: DeviceInfo,
    pub limits: wgpu::Limits,
    pub counters: Counters,
    pub(super) pipelines: Pipelines,
    pub(super) raster_pipelines: RasterPipelines,
    pub(super) written: WrittenKernels,
    trouble: Arc<Trouble>,
    /// Held during every call into wgpu: its submissions and waits are not safe against each other in wgpu 30.0, and a
    /// mapping that another thread's wait completed must be seen complete.
    lane: Mutex<()>,
    // Dropped last: the device comes from it.
    _instance: wgpu::Instance,
}

/// What the driver reported by itself.
#[derive(Debug, Default)]
struct Trouble {
    lost: AtomicBool,
    reason: Mutex<String>,
    uncaptured: Mutex<Option<String>>,
}

/// Storage buffers that a kernel may bind; WebGPU's default limit.
pub const STORAGE_BUFFERS: u32 = 8;
/// Invocations of the largest workgroup.
pub const INVOCATIONS: u32 = 64;

/// The process that opened the first device, or zero.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Whether a parent of this process opened a device.
pub fn is_forked() -> bool {
    let owner = OWNER.load(Ordering::Acquire);
    owner != 0 && owner != std::process::id()
}

/// The context of an adapter, opened at the first call.
pub fn context(info: &DeviceInfo) -> Result<Arc<Context>, DeviceError> {
    static CONTEXTS: Mutex<Option<HashMap<String, Arc<Context>>>> = Mutex::new(None);
    // Before the lock, which another thread may have held at the fork.
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
        let can_compute = adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS);
        check_adapter(can_compute, &limits).map_err(unavailable)?;

        let wanted = wgpu::Features::FLOAT32_FILTERABLE | wgpu::Features::TIMESTAMP_QUERY;
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("fieldbake"),
            required_features: adapter.features() & wanted,
            required_limits: limits.clone(),
            memory_hints: wgpu::MemoryHints::Performance,
            ..wgpu::DeviceDescriptor::default()
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| unavailable(error.to_string()))?;

        let trouble = Arc::new(Trouble::default());
        let seen = trouble.clone();
        device.set_device_lost_callback(move |reason, message| seen.lose(&format!("{reason:?}: {message}")));
        let seen = trouble.clone();
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            *seen.uncaptured.lock().unwrap_or_else(PoisonError::into_inner) = Some(error.to_string());
        }));
        Ok(Self {
            device,
            queue,
            info: info.clone(),
            limits,
            counters: Counters::default(),
            pipelines: Pipelines::default(),
            raster_pipelines: RasterPipelines::default(),
            written: WrittenKernels::default(),
            trouble,
            lane: Mutex::new(()),
            _instance: instance,
        })
    }

    /// Name and backend, as reports show it.
    pub fn label(&self) -> String {
        self.info.label()
    }

    pub fn is_lost(&self) -> bool {
        self.trouble.lost.load(Ordering::Acquire)
    }

    /// Fails if the device is gone, or reported an error that no call was there to take.
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

    /// Give the device up, as if the driver had taken it away: what comes after is a loss.
    pub fn destroy(&self) {
        self.device.destroy();
        self.trouble.lose("destroyed on request");
    }

    /// Mark the device as lost after a wait without an answer.
    pub(super) fn abandon(&self, reason: &str) {
        self.trouble.lose(reason);
    }

    /// Run `call` between error scopes. `needed` is what it allocates, for the message.
    pub fn guarded<T>(&self, what: &str, needed: u64, call: impl FnOnce() -> T) -> Result<T, DeviceError> {
        let lane = self.lane();
        let value = self.scoped(what, needed, call);
        drop(lane);
        value
    }

    /// [`Self::guarded`] beside other threads' calls, for what neither submits nor waits.
    pub(super) fn scoped<T>(&self, what: &str, needed: u64, call: impl FnOnce() -> T) -> Result<T, DeviceError> {
        self.check(what)?;
        let memory = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let validation = self.device.push_error_scope(wgpu::ErrorFilter::Validation);
        let internal = self.device.push_error_scope(wgpu::ErrorFilter::Internal);
        let value = call();
        // Innermost first; the futures are ready at once on native backends.
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

    /// The right to call into wgpu.
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

/// Whether an adapter has what the kernels need; otherwise why not.
pub(super) fn check_adapter(can_compute: bool, limits: &wgpu::Limits) -> Result<(), String> {
    if !can_compute {
        return Err("it has no compute shaders".into());
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
