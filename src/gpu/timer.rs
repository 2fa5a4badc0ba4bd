//! Durations of stages on a device, by timestamps at the start and the end of passes.
//!
//! Each submission resolves the timestamps of its passes and copies them into one buffer, which the host reads after
//! the job. A job therefore needs no further submission for its times.
//!
//! Mesa's software driver takes the time of the start of a pass at its first indirect dispatch, or else at its end.
//! There a pass of dispatches with known sizes seems to take no time.

use super::buffer::ReadBack;
use super::context::Context;
use crate::error::DeviceError;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Largest number of timed passes of a job: a query set has at most 4,096 timestamps.
const MOST_PASSES: usize = wgpu::QUERY_SET_MAX_QUERIES as usize / 2;
/// Size of the timestamps of a pass, bytes.
const PASS_BYTES: u64 = size_of::<[u64; 2]>() as u64;

/// Timestamps of one job at a time.
#[derive(Debug)]
pub(crate) struct Timer {
    set: wgpu::QuerySet,
    /// Timestamps of one submission.
    resolved: wgpu::Buffer,
    /// Timestamps of all passes.
    memory: ReadBack,
    /// Duration of a tick, s.
    tick: f64,
    /// Stage of each pass; None if the job has more than [`MOST_PASSES`].
    stages: Mutex<Option<Vec<&'static str>>>,
}

impl Timer {
    /// None if the device has no timestamps.
    pub(crate) fn new(context: &Context) -> Result<Option<Self>, DeviceError> {
        if !context.device.features().contains(wgpu::Features::TIMESTAMP_QUERY) {
            return Ok(None);
        }
        let bytes = MOST_PASSES as u64 * PASS_BYTES;
        let (set, resolved) = context.guarded("timestamps", bytes, || {
            let set = context.device.create_query_set(&wgpu::QuerySetDescriptor {
                label: Some("timestamps"),
                ty: wgpu::QueryType::Timestamp,
                count: 2 * MOST_PASSES as u32,
            });
            let resolved = context.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("timestamps"),
                size: bytes,
                usage: wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC,
                mapped_at_creation: false,
            });
            (set, resolved)
        })?;
        let memory = context.read_back("timestamps", bytes)?;
        let tick = f64::from(context.queue.get_timestamp_period()) * 1e-9;
        Ok(Some(Self { set, resolved, memory, tick, stages: Mutex::default() }))
    }

    fn stages(&self) -> MutexGuard<'_, Option<Vec<&'static str>>> {
        self.stages.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Starts a job.
    pub(crate) fn start(&self) {
        *self.stages() = Some(Vec::new());
    }

    /// Number of timed passes of the job.
    pub(super) fn count(&self) -> usize {
        self.stages().as_ref().map_or(0, Vec::len)
    }

    /// Adds a pass. Returns the set and the indices of its timestamps, or None if there is no room.
    pub(super) fn add(&self, stage: &'static str) -> Option<(&wgpu::QuerySet, [Option<u32>; 2])> {
        let mut kept = self.stages();
        let Some(stages) = kept.as_mut().filter(|stages| stages.len() < MOST_PASSES) else {
            *kept = None;
            return None;
        };
        let first = 2 * stages.len() as u32;
        stages.push(stage);
        Some((&self.set, [Some(first), Some(first + 1)]))
    }

    /// Records the copy of the timestamps of all passes from `first` on, at the end of their submission.
    pub(super) fn record(&self, encoder: &mut wgpu::CommandEncoder, first: usize) {
        let count = self.count();
        if count > first {
            encoder.resolve_query_set(&self.set, 2 * first as u32..2 * count as u32, &self.resolved, 0);
            let bytes = (count - first) as u64 * PASS_BYTES;
            self.memory.record(encoder, &self.resolved, 0, first as u64 * PASS_BYTES, bytes);
        }
    }

    /// The time of each stage in s, in the order of their first passes, after all submissions of the job. Empty if
    /// the job had too many passes.
    pub(crate) fn finish(&self, context: &Context) -> Result<Vec<(&'static str, f64)>, DeviceError> {
        let stages = self.stages().take().unwrap_or_default();
        let mut times: Vec<(&'static str, f64)> = Vec::new();
        if stages.is_empty() {
            return Ok(times);
        }
        let mut ticks = vec![[0u64; 2]; stages.len()];
        // The submissions are finished, so one poll maps the memory.
        let outcome = context.guarded("timestamps", 0, || {
            self.memory.map(stages.len() as u64 * PASS_BYTES);
            context.device.poll(wgpu::PollType::Poll)
        })?;
        outcome.map_err(|error| context.failed("timestamps", error.to_string()))?;
        context.take("timestamps", &self.memory, &mut ticks)?;
        for (stage, [start, end]) in stages.into_iter().zip(ticks) {
            let time = end.saturating_sub(start) as f64 * self.tick;
            match times.iter_mut().find(|(known, _)| *known == stage) {
                Some((_, sum)) => *sum += time,
                None => times.push((stage, time)),
            }
        }
        Ok(times)
    }
}
