//! The available devices, and the choice of a device for a call.

use super::context::{Context, context};
use crate::error::DeviceError;
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A device that can run kernels.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceInfo {
    /// Name by which the device is chosen.
    pub name: String,
    /// "cpu", "vulkan", "metal" or "dx12".
    pub backend: String,
    /// "cpu", "discrete", "integrated", "virtual", "software" or "other".
    pub kind: &'static str,
    /// False for the CPU and for drivers that emulate a GPU on the CPU.
    pub hardware: bool,
    /// Limits by name.
    pub limits: Vec<(&'static str, u64)>,
}

impl DeviceInfo {
    /// Name and backend, for reports.
    pub fn label(&self) -> String {
        format!("{} ({})", self.name, self.backend)
    }
}

/// The device of a call.
#[derive(Debug, Clone)]
pub enum Place {
    /// The processor.
    Cpu,
    /// A graphics device.
    Gpu(Arc<Context>),
}

impl Place {
    /// Label for reports.
    pub fn label(&self) -> String {
        match self {
            Self::Cpu => "cpu".into(),
            Self::Gpu(context) => context.label(),
        }
    }

    /// Warning for `device="gpu"` if there is only a software adapter. An adapter chosen by its name gives none.
    pub fn warning(&self, device: &str) -> Option<String> {
        match self {
            Self::Gpu(context) if device == "gpu" && !context.info.hardware => Some(format!(
                "device=\"gpu\" chose {}, a software adapter that runs on the CPU: a bake of 968 faces at 64 voxels took \
                 140 times as long there as with device=\"cpu\" (benches/results/2026-11-21-software-adapter.md)",
                self.label()
            )),
            _ => None,
        }
    }

    /// Number of passes of a query over its points: a device needs one more, for the search.
    pub fn passes(&self) -> u64 {
        match self {
            Self::Cpu => 1,
            Self::Gpu(_) => 2,
        }
    }
}

/// Environment variable that replaces `device="auto"`.
pub(crate) const OVERRIDE: &str = "FIELDBAKE_DEVICE";

/// Whether the environment replaces "auto".
pub fn is_overridden() -> bool {
    overriding().is_some()
}

fn overriding() -> Option<String> {
    std::env::var(OVERRIDE).ok().filter(|name| !name.is_empty())
}

/// The device for a user's `device=`: "auto" (hardware, else the CPU), "cpu", "gpu" (hardware, else a software adapter)
/// or an adapter by name.
pub fn choose(device: &str) -> Result<Place, DeviceError> {
    let named = if device == "auto" { overriding() } else { None };
    let device = named.as_deref().unwrap_or(device);
    match device {
        "cpu" => Ok(Place::Cpu),
        "auto" => match offered().iter().find(|info| info.hardware) {
            // A forked child cannot use the parent's device. "auto" uses the CPU instead.
            Some(_) if super::context::is_forked() => Ok(Place::Cpu),
            Some(info) => Ok(Place::Gpu(context(info)?)),
            None => Ok(Place::Cpu),
        },
        "gpu" => {
            let offered = offered();
            let best = offered.iter().find(|info| info.hardware).or(offered.first());
            Ok(Place::Gpu(context(best.ok_or_else(|| no_adapter(device))?)?))
        }
        name => {
            let offered = offered();
            let requested = name.to_lowercase();
            let exact = offered.iter().find(|info| info.name.to_lowercase() == requested);
            let mut partial = offered.iter().filter(|info| info.name.to_lowercase().contains(&requested));
            match (exact, partial.next(), partial.next()) {
                (Some(info), ..) | (None, Some(info), None) => Ok(Place::Gpu(context(info)?)),
                _ => Err(DeviceError::Unknown { requested: name.into() }),
            }
        }
    }
}

fn no_adapter(requested: &str) -> DeviceError {
    DeviceError::NotAvailable {
        requested: requested.into(),
        reason: "no Vulkan, Metal or DX12 driver offers an adapter; install one (Mesa's lavapipe emulates a GPU on the CPU), or use device=\"cpu\"".into(),
    }
}

/// The CPU, then every adapter of the drivers.
pub fn devices() -> Vec<DeviceInfo> {
    let threads = rayon::current_num_threads() as u64;
    let cpu = DeviceInfo {
        name: "cpu".into(),
        backend: "cpu".into(),
        kind: "cpu",
        hardware: false,
        limits: vec![("threads", threads)],
    };
    let found = enumerate().1;
    let mut list = vec![cpu];
    list.extend(found.iter().map(describe));
    list
}

/// The adapters at the first call in this process. Loading the drivers takes 50 to 250 ms.
fn offered() -> Arc<[DeviceInfo]> {
    static OFFERED: Mutex<Option<Arc<[DeviceInfo]>>> = Mutex::new(None);
    let mut offered = OFFERED.lock().unwrap_or_else(PoisonError::into_inner);
    offered.get_or_insert_with(|| enumerate().1.iter().map(describe).collect()).clone()
}

/// A new instance and its adapters. An instance must outlive the objects made from it, and a lost device needs a new
/// one.
pub(super) fn enumerate() -> (wgpu::Instance, Vec<wgpu::Adapter>) {
    let backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = backends;
    let quiet = Quiet::new();
    let instance = wgpu::Instance::new(descriptor);
    drop(quiet);
    let adapters = pollster::block_on(instance.enumerate_adapters(backends));
    (instance, adapters)
}

/// Disables Mesa's layer `VK_LAYER_MESA_device_select` for an instance that is made while this object exists.
///
/// The layer sorts adapters by the display server's. Without a display server, the Wayland library writes "error:
/// XDG_RUNTIME_DIR is invalid or not set in the environment." to stderr. The layer is therefore disabled where no
/// display server runs, unless the user has chosen an adapter through it.
struct Quiet<'a>(Option<MutexGuard<'a, ()>>);

impl Quiet<'_> {
    const SWITCH: &'static str = "NODEVICE_SELECT";

    fn new() -> Self {
        static ONE: Mutex<()> = Mutex::new(());
        let guard = ONE.lock().unwrap_or_else(PoisonError::into_inner);
        let has_session = std::env::var_os("XDG_RUNTIME_DIR").is_some_and(|folder| Path::new(&folder).is_absolute());
        let chosen =
            [Self::SWITCH, "MESA_VK_DEVICE_SELECT", "DRI_PRIME"].iter().any(|name| std::env::var_os(name).is_some());
        if !cfg!(target_os = "linux") || has_session || chosen {
            return Self(None);
        }
        // SAFETY: the lock of std::env orders this with the rest of Rust, and glibc's lock orders it with `setenv`, by
        // which Python writes os.environ. The loader reads the variable on this thread. What is left is a `getenv` of
        // another library on another thread at this moment, on a C library that does not guard it: the risk of every
        // write to os.environ. It is taken once or twice in a process, when adapters are listed and when a device
        // opens.
        unsafe { std::env::set_var(Self::SWITCH, "1") };
        Self(Some(guard))
    }
}

impl Drop for Quiet<'_> {
    fn drop(&mut self) {
        if self.0.is_some() {
            // SAFETY: as in `new`.
            unsafe { std::env::remove_var(Self::SWITCH) };
        }
    }
}

pub(super) fn describe(adapter: &wgpu::Adapter) -> DeviceInfo {
    let info = adapter.get_info();
    let limits = adapter.limits();
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => "discrete",
        wgpu::DeviceType::IntegratedGpu => "integrated",
        wgpu::DeviceType::VirtualGpu => "virtual",
        wgpu::DeviceType::Cpu => "software",
        wgpu::DeviceType::Other => "other",
    };
    DeviceInfo {
        name: info.name,
        backend: info.backend.to_str().to_owned(),
        kind,
        hardware: kind != "software",
        limits: vec![
            ("max_buffer_size", limits.max_buffer_size),
            ("max_storage_buffer_binding_size", limits.max_storage_buffer_binding_size),
            ("max_compute_invocations_per_workgroup", limits.max_compute_invocations_per_workgroup.into()),
            ("max_texture_dimension_2d", limits.max_texture_dimension_2d.into()),
            ("max_texture_dimension_3d", limits.max_texture_dimension_3d.into()),
        ],
    }
}
