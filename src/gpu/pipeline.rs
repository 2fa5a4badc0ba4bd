//! Compiled kernels, one per entry point and context, and their dispatch.

use super::buffer::ReadBack;
use super::context::Context;
use super::shader::{Instead, source_instead};
use super::timer::Timer;
use crate::error::DeviceError;
use std::collections::HashMap;
use std::num::NonZeroU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Kernels by name, entry point and overrides of imported files.
#[derive(Debug, Default)]
pub(crate) struct Pipelines(Mutex<HashMap<KernelKey, wgpu::ComputePipeline>>);

type KernelKey = (&'static str, &'static str, Vec<Instead>);

/// Kernels generated at run time, by their text.
#[derive(Debug, Default)]
pub(crate) struct WrittenKernels(Mutex<HashMap<String, Written>>);

#[derive(Debug)]
enum Written {
    /// Requested once. A kernel that is used only once is not worth compiling.
    Requested,
    /// A thread compiles it.
    BeingCompiled,
    Ready(wgpu::ComputePipeline),
    /// The driver refused it; it is not compiled again.
    Refused,
}

/// The invocations of one kernel in a submission.
#[derive(Debug, Clone)]
pub(crate) struct Dispatch<'a> {
    pub pipeline: &'a wgpu::ComputePipeline,
    pub group: &'a wgpu::BindGroup,
    pub size: DispatchSize<'a>,
    /// The stage to which its time counts.
    pub stage: &'static str,
}

/// Number of workgroups of a dispatch.
#[derive(Debug, Clone, Copy)]
pub(crate) enum DispatchSize<'a> {
    Known([u32; 3]),
    /// Three words in device memory at an offset in bytes.
    At(&'a wgpu::Buffer, u64),
}

/// A range of a buffer at a binding: the number of the binding, the buffer, the offset and the size in bytes.
pub(crate) type BoundRange<'a> = (u32, &'a wgpu::Buffer, u64, u64);

/// A binding with a whole buffer.
pub(crate) fn whole((binding, buffer): (u32, &wgpu::Buffer)) -> BoundRange<'_> {
    (binding, buffer, 0, buffer.size())
}

/// Bind groups by name. A group is made again only if its pipeline or one of its buffers is another one.
#[derive(Debug, Default)]
pub(crate) struct BindGroups(Mutex<HashMap<&'static str, KeptGroup>>);

#[derive(Debug)]
struct KeptGroup {
    pipeline: AnyPipeline,
    bindings: Vec<(u32, wgpu::Buffer, u64, u64)>,
    group: wgpu::BindGroup,
}

/// A pipeline with a layout of its own.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum AnyPipeline {
    Compute(wgpu::ComputePipeline),
    Raster(wgpu::RenderPipeline),
}

impl AnyPipeline {
    fn layout(&self) -> wgpu::BindGroupLayout {
        match self {
            Self::Compute(pipeline) => pipeline.get_bind_group_layout(0),
            Self::Raster(pipeline) => pipeline.get_bind_group_layout(0),
        }
    }
}

impl BindGroups {
    /// Releases all groups, and with them their buffers if no other owner is left.
    pub(crate) fn clear(&self) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clear();
    }

    /// The group of a name.
    pub(crate) fn get(
        &self,
        context: &Context,
        name: &'static str,
        pipeline: AnyPipeline,
        bindings: &[BoundRange<'_>],
    ) -> Result<wgpu::BindGroup, DeviceError> {
        let mut groups = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_same = |kept: &KeptGroup| {
            let ranges = kept.bindings.iter().map(|(binding, buffer, offset, size)| (*binding, buffer, *offset, *size));
            kept.pipeline == pipeline && ranges.eq(bindings.iter().copied())
        };
        if let Some(kept) = groups.get(name).filter(|kept| is_same(kept)) {
            return Ok(kept.group.clone());
        }
        let entries: Vec<_> = bindings
            .iter()
            .map(|&(binding, buffer, offset, size)| wgpu::BindGroupEntry {
                binding,
                resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding {
                    buffer,
                    offset,
                    size: NonZeroU64::new(size),
                }),
            })
            .collect();
        let group = context.guarded(name, 0, || {
            let layout = &pipeline.layout();
            let descriptor = wgpu::BindGroupDescriptor { label: Some(name), layout, entries: &entries };
            context.device.create_bind_group(&descriptor)
        })?;
        let owned = |&(binding, buffer, offset, size): &BoundRange<'_>| (binding, buffer.clone(), offset, size);
        let bindings = bindings.iter().map(owned).collect();
        groups.insert(name, KeptGroup { pipeline, bindings, group: group.clone() });
        Ok(group)
    }
}

/// Largest number of generated kernels that are kept. Beyond it all of them are dropped.
const MAX_WRITTEN: usize = 256;

impl WrittenKernels {
    fn lock(&self) -> MutexGuard<'_, HashMap<String, Written>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Context {
    /// A kernel generated at run time, if it is compiled. The second request for a missing kernel starts a thread that
    /// compiles it.
    pub fn written_kernel(
        self: &Arc<Self>,
        name: &'static str,
        entry: &'static str,
        text: String,
    ) -> Option<wgpu::ComputePipeline> {
        let mut programs = self.written.lock();
        match programs.get(&text) {
            Some(Written::Ready(pipeline)) => return Some(pipeline.clone()),
            Some(Written::BeingCompiled | Written::Refused) => return None,
            Some(Written::Requested) => {}
            None => {
                if programs.len() >= MAX_WRITTEN {
                    programs.retain(|_, kernel| matches!(kernel, Written::BeingCompiled));
                }
                programs.insert(text, Written::Requested);
                return None;
            }
        }
        let context = self.clone();
        let source = text.clone();
        let work = move || {
            // Compilation runs outside of the lock, so that drawing continues meanwhile.
            let compiled = context.scoped(name, 0, || context.create(name, entry, &source));
            let kernel = compiled.map_or(Written::Refused, Written::Ready);
            context.written.lock().insert(source, kernel);
        };
        if std::thread::Builder::new().name("fieldbake-compile".into()).spawn(work).is_ok() {
            programs.insert(text, Written::BeingCompiled);
        }
        None
    }

    /// Number of compiled kernels that were generated at run time.
    pub fn written_kernel_count(&self) -> usize {
        self.written.lock().values().filter(|kernel| matches!(kernel, Written::Ready(_))).count()
    }

    /// A kernel of `shaders/`, compiled at the first use.
    pub fn kernel(&self, name: &'static str, entry: &'static str) -> Result<wgpu::ComputePipeline, DeviceError> {
        self.kernel_with(name, entry, &[])
    }

    /// [`Self::kernel`] with overrides of some files that it imports.
    pub fn kernel_with(
        &self,
        name: &'static str,
        entry: &'static str,
        instead: &[Instead],
    ) -> Result<wgpu::ComputePipeline, DeviceError> {
        let mut pipelines = self.pipelines.0.lock().unwrap_or_else(PoisonError::into_inner);
        let key = (name, entry, instead.to_vec());
        if let Some(pipeline) = pipelines.get(&key) {
            return Ok(pipeline.clone());
        }
        let text = source_instead(name, instead).map_err(|reason| self.refused(name, reason))?;
        let pipeline = self.compile(name, entry, &text)?;
        if pipelines.len() >= MAX_WRITTEN {
            pipelines.retain(|(_, _, instead), _| instead.is_empty());
        }
        pipelines.insert(key, pipeline.clone());
        Ok(pipeline)
    }

    /// Compiles one entry point of a WGSL text. The bind group layout is derived from the text.
    pub fn compile(&self, name: &str, entry: &str, text: &str) -> Result<wgpu::ComputePipeline, DeviceError> {
        let compiled = self.guarded(name, 0, || self.create(name, entry, text));
        compiled.map_err(|error| match error {
            DeviceError::Failed { reason, .. } => self.refused(name, reason),
            other => other,
        })
    }

    fn create(&self, name: &str, entry: &str, text: &str) -> wgpu::ComputePipeline {
        let module = self.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some(name),
            source: wgpu::ShaderSource::Wgsl(text.into()),
        });
        self.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: None,
            module: &module,
            entry_point: Some(entry),
            compilation_options: wgpu::PipelineCompilationOptions::default(),
            cache: None,
        })
    }

    pub(super) fn refused(&self, kernel: &str, reason: String) -> DeviceError {
        DeviceError::Shader { device: self.label(), kernel: kernel.into(), reason }
    }

    /// Binds whole buffers to group 0 in order of binding.
    pub fn bind(
        &self,
        label: &str,
        pipeline: &wgpu::ComputePipeline,
        buffers: &[(u32, &wgpu::Buffer)],
    ) -> Result<wgpu::BindGroup, DeviceError> {
        self.bind_resources(label, pipeline, buffers.iter().map(|(at, buffer)| (*at, buffer.as_entire_binding())))
    }

    /// Binds buffers, textures and samplers to group 0 in order of binding.
    pub fn bind_resources<'a>(
        &self,
        label: &str,
        pipeline: &wgpu::ComputePipeline,
        resources: impl IntoIterator<Item = (u32, wgpu::BindingResource<'a>)>,
    ) -> Result<wgpu::BindGroup, DeviceError> {
        let entries: Vec<_> =
            resources.into_iter().map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
        self.guarded(label, 0, || {
            self.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some(label),
                layout: &pipeline.get_bind_group_layout(0),
                entries: &entries,
            })
        })
    }

    /// Queues one dispatch.
    pub fn dispatch(
        &self,
        label: &'static str,
        pipeline: &wgpu::ComputePipeline,
        group: &wgpu::BindGroup,
        workgroups: [u32; 3],
    ) -> Result<wgpu::SubmissionIndex, DeviceError> {
        let dispatch = Dispatch { pipeline, group, size: DispatchSize::Known(workgroups), stage: label };
        self.submit_all(label, &[dispatch], None, None)
    }

    /// Queues dispatches in order, in one submission, and then the copy of the first bytes of a buffer for the host.
    /// With a timer, consecutive dispatches of one stage are one pass.
    pub(crate) fn submit_all(
        &self,
        label: &str,
        dispatches: &[Dispatch<'_>],
        result: Option<(&wgpu::Buffer, u64, &ReadBack)>,
        timer: Option<&Timer>,
    ) -> Result<wgpu::SubmissionIndex, DeviceError> {
        self.guarded(label, 0, || {
            let first = timer.map_or(0, Timer::count);
            let mut encoder =
                self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor { label: Some(label) });
            for stage in dispatches.chunk_by(|a, b| timer.is_none() || a.stage == b.stage) {
                let stamps = timer.and_then(|timer| timer.add(stage[0].stage));
                let timestamp_writes = stamps.map(|(query_set, [start, end])| wgpu::ComputePassTimestampWrites {
                    query_set,
                    beginning_of_pass_write_index: start,
                    end_of_pass_write_index: end,
                });
                let mut pass =
                    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(label), timestamp_writes });
                for Dispatch { pipeline, group, size, .. } in stage {
                    pass.set_pipeline(pipeline);
                    pass.set_bind_group(0, *group, &[]);
                    match *size {
                        DispatchSize::Known([x, y, z]) => pass.dispatch_workgroups(x, y, z),
                        DispatchSize::At(buffer, offset) => pass.dispatch_workgroups_indirect(buffer, offset),
                    }
                }
            }
            if let Some((from, bytes, memory)) = result {
                memory.record(&mut encoder, from, 0, 0, bytes);
            }
            if let Some(timer) = timer {
                timer.record(&mut encoder, first);
            }
            let submission = self.submit(Some(encoder.finish()));
            if let Some((_, bytes, memory)) = result {
                memory.map(bytes);
            }
            submission
        })
    }
}
