//! Progress and cancellation, shared by the worker threads and the thread that waits for them.

use crate::error::Error;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Progress of a long job, and whether it was cancelled.
///
/// Workers call [`Progress::advance`] once per block of work (well under 50 ms each) and stop when it fails.
#[derive(Debug, Default)]
pub struct Progress {
    done: AtomicU64,
    total: AtomicU64,
    cancelled: AtomicBool,
}

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
        if self.cancelled.load(Ordering::Relaxed) { Err(Error::Cancelled) } else { Ok(()) }
    }

    /// Requests that the work stops.
    pub fn cancel(&self) {
        self.cancelled.store(true, Ordering::Relaxed);
    }

    /// Fraction of the work done, 0 to 1.
    pub fn fraction(&self) -> f64 {
        let total = self.total.load(Ordering::Relaxed);
        if total == 0 { 0.0 } else { (self.done.load(Ordering::Relaxed) as f64 / total as f64).min(1.0) }
    }
}
