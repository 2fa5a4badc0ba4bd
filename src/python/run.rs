//! Long jobs: they run without the GIL, report progress, and stop on Ctrl-C.

use super::error::{Failure, exception};
use crate::error::Error;
use crate::progress::Progress;
use pyo3::prelude::*;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// Interval at which the waiting thread checks for signals and reports progress.
const POLL: Duration = Duration::from_millis(50);

/// Runs `job` on the worker threads. Meanwhile this thread waits, handles signals and calls `callback` with the
/// finished fraction. An exception in either cancels the job and is raised once the job has stopped.
pub(super) fn run<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    job: impl FnOnce(&Progress) -> Result<T, Error> + Send,
) -> Result<T, Failure> {
    let pool = worker_pool(py)?;
    let progress = Progress::new();
    let callback: Option<Py<PyAny>> = callback.map(|callback| callback.clone().unbind());
    let (outcome, interrupt) = py.detach(|| {
        std::thread::scope(|scope| {
            let (sender, receiver) = sync_channel(1);
            let progress = &progress;
            scope.spawn(move || {
                let outcome = catch_unwind(AssertUnwindSafe(|| pool.install(|| job(progress))));
                // The receiver waits until this arrives.
                let _ = sender.send(outcome);
            });
            let mut interrupt = None;
            loop {
                match receiver.recv_timeout(POLL) {
                    Ok(outcome) => return (outcome, interrupt),
                    Err(RecvTimeoutError::Timeout) if interrupt.is_none() => {
                        if let Err(error) = Python::attach(|py| look_at_python(py, callback.as_ref(), progress)) {
                            progress.cancel();
                            interrupt = Some(error);
                        }
                    }
                    Err(RecvTimeoutError::Timeout) => {}
                    Err(RecvTimeoutError::Disconnected) => return (Ok(Err(Error::Cancelled)), interrupt),
                }
            }
        })
    });
    if let Some(error) = interrupt {
        return Err(Failure::Python(error));
    }
    let value = outcome.map_err(|panic| internal_error(py, &*panic))??;
    if let Some(callback) = callback {
        callback.call1(py, (1.0,)).map_err(Failure::Python)?;
    }
    Ok(value)
}

/// Runs a short `job` on this thread, without the GIL. It neither uses the worker threads nor waits for one to wake up.
pub(super) fn run_short<T: Send>(py: Python<'_>, job: impl FnOnce() -> Result<T, Error> + Send) -> Result<T, Failure> {
    let outcome = py.detach(|| catch_unwind(AssertUnwindSafe(job)));
    Ok(outcome.map_err(|panic| internal_error(py, &*panic))??)
}

/// [`run`], or [`run_short`] for a job that `is_short`.
pub(super) fn run_sized<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    is_short: bool,
    job: impl FnOnce(&Progress) -> Result<T, Error> + Send,
) -> Result<T, Failure> {
    if is_short && callback.is_none() { run_short(py, || job(&Progress::new())) } else { run(py, callback, job) }
}

fn look_at_python(py: Python<'_>, callback: Option<&Py<PyAny>>, progress: &Progress) -> PyResult<()> {
    py.check_signals()?;
    if let Some(callback) = callback {
        callback.call1(py, (progress.fraction(),))?;
    }
    Ok(())
}

/// A panic is a defect of fieldbake. It becomes an exception that `except Exception` catches.
fn internal_error(py: Python<'_>, panic: &(dyn Any + Send)) -> Failure {
    let text =
        panic.downcast_ref::<&str>().map(ToString::to_string).or_else(|| panic.downcast_ref::<String>().cloned());
    let message = format!("internal error, please report it: {}", text.unwrap_or_else(|| "unknown panic".into()));
    Failure::Python(exception(py, "Error", message))
}

/// The worker threads of this process. A forked child inherits the handle but not the threads, so it makes new ones.
fn worker_pool(py: Python<'_>) -> Result<Arc<rayon::ThreadPool>, Failure> {
    static POOL: Mutex<Option<Workers>> = Mutex::new(None);
    let (process, threads) = (std::process::id(), THREADS.load(Ordering::Relaxed));
    let mut workers = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(workers) = workers.as_ref()
        && workers.process == process
        && workers.threads == threads
    {
        return Ok(workers.pool.clone());
    }
    let builder = rayon::ThreadPoolBuilder::new().num_threads(threads).thread_name(|i| format!("fieldbake-{i}"));
    let pool = builder.build().map_err(|error| Failure::Python(exception(py, "Error", error.to_string())))?;
    let pool = Arc::new(pool);
    let replaced = workers.replace(Workers { process, threads, pool: pool.clone() });
    // A pool of the parent process is leaked, since joining its threads would wait forever. A pool of this process ends
    // with the last job that uses it.
    std::mem::forget(replaced.filter(|workers| workers.process != process));
    Ok(pool)
}

/// The worker threads of one process.
struct Workers {
    process: u32,
    /// Requested number of threads; 0 means one per core.
    threads: usize,
    pool: Arc<rayon::ThreadPool>,
}

/// Number of worker threads that later jobs use; 0 for one per core or `RAYON_NUM_THREADS`.
static THREADS: AtomicUsize = AtomicUsize::new(0);

/// Limits the worker threads of later jobs.
#[pyfunction]
pub(super) fn set_threads(count: usize) {
    THREADS.store(count, Ordering::Relaxed);
}
