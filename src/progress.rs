//! Progress and cancellation, shared by the worker threads and the thread that waits for them.

use crate::error::Error;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Progress of a long job, and whether it was cancelled.
///
/// Workers call [`Progress::advance`] once per block of work, and [`Progress::check`] within a block that may take more
/// than 50 ms. They stop when it fails. A check reads one flag, so it may run once for each point.
#[derive(Debug, Default)]
pub struct Progress {
    done: AtomicU64,
    total: AtomicU64,
    cancelled: Alone,
}

/// A flag in a cache line of its own, which writes of `done` do not take from the processors that read the flag.
#[derive(Debug, Default)]
#[repr(align(128))]
struct Alone(AtomicBool);

impl Progress {
    /// Nothing done, total unknown.
    pub fn new() -> Self {
        Self::default()
    }

    /// Sets the size of the job, in the unit of `advance`.
    pub fn set_total(&self, total: u64) {
        self.total.store(total, Ordering::Relaxed);
    }

    /// Adds finished work. Fails once the job is cancelled.
    pub fn advance(&self, amount: u64) -> Result<(), Error> {
        self.done.fetch_add(amount, Ordering::Relaxed);
        self.check()
    }

    /// Fails once the job is cancelled.
    pub fn check(&self) -> Result<(), Error> {
        if self.cancelled.0.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Requests that the work stops.
    pub fn cancel(&self) {
        self.cancelled.0.store(true, Ordering::Relaxed);
    }

    /// Fraction of the work done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        let total = self.total.load(Ordering::Relaxed);
        if total == 0 { 0.0 } else { (self.done.load(Ordering::Relaxed) as f64 / total as f64).min(1.0) }
    }
}
