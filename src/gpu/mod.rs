//! Graphics devices through wgpu: Vulkan, Metal and DX12.
//!
//! OpenGL is left out: its backend loses storage texture writes without an error.

use crate::error::DeviceError;

/// A device that can compute.
#[derive(Debug, Clone, PartialEq)]
pub struct DeviceInfo {
    pub name: String,
    /// "cpu", "vulkan", "metal" or "dx12".
    pub backend: String,
    /// "cpu", "discrete", "integrated", "virtual", "software" or "other".
    pub kind: &'static str,
    /// False for the CPU and for drivers that emulate a GPU on it.
    pub hardware: bool,
    pub limits: Vec<(&'static str, u64)>,
}

/// The CPU, then every adapter that the drivers offer.
pub fn devices() -> Vec<DeviceInfo> {
    let threads = rayon::current_num_threads() as u64;
    let cpu = DeviceInfo {
        name: "cpu".into(),
        backend: "cpu".into(),
        kind: "cpu",
        hardware: false,
        limits: vec![("threads", threads)],
    };
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
    descriptor.backends = wgpu::Backends::VULKAN | wgpu::Backends::METAL | wgpu::Backends::DX12;
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(wgpu::Backends::all()));
    std::iter::once(cpu).chain(adapters.iter().map(describe)).collect()
}

fn describe(adapter: &wgpu::Adapter) -> DeviceInfo {
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

/// Where a job that exists only on the CPU so far runs.
pub fn check_cpu_only(device: &str, job: &str) -> Result<(), DeviceError> {
    match device {
        "auto" | "cpu" => Ok(()),
        "gpu" => Err(DeviceError::NotAvailable {
            requested: device.into(),
            reason: format!("{job} runs on the CPU in this version; use device=\"auto\" or \"cpu\""),
        }),
        _ => Err(DeviceError::Unknown { requested: device.into() }),
    }
}
