//! Long jobs: they run without the GIL, report progress, and stop on Ctrl-C.

use super::error::{Failure, exception};
use crate::error::Error;
use crate::progress::Progress;
use pyo3::prelude::*;
use std::any::Any;
use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Interval at which the waiting thread checks for signals and reports progress.
const POLL: Duration = Duration::from_millis(50);

/// Duration that a cancelled job of [`run_owned`] has to stop, before it is left to end on its own.
const GRACE: Duration = Duration::from_millis(200);

thread_local! {
    /// The callable that receives the fraction of jobs of this thread that have no callable of their own.
    static WATCHER: RefCell<Option<Py<PyAny>>> = const { RefCell::new(None) };
}

/// Passes the finished fraction of every later job of this thread to a callable, unless the job has its own. Returns
/// the callable before; None stops it.
#[pyfunction]
#[pyo3(signature = (callback))]
pub(super) fn watch(callback: Option<Py<PyAny>>) -> Option<Py<PyAny>> {
    WATCHER.with(|watcher| watcher.replace(callback))
}

/// Runs `job` on the worker threads. Meanwhile this thread waits, handles signals and calls `callback` with the
/// finished fraction. An exception in either cancels the job and is raised once the job has stopped.
pub(super) fn run<T: Send>(
    py: Python<'_>,
    callback: Option<&Bound<'_, PyAny>>,
    job: impl FnOnce(&Progress) -> Result<T, Error> + Send,
) -> Result<T, Failure> {
    let pool = worker_pool(py)?;
    let progress = Progress::new();
    let callback = callback_of(py, callback);
    let (sender, receiver) = sync_channel(1);
    let watcher = callback.as_ref();
    let (outcome, interrupt) = py.detach(move || {
        let progress = &progress;
        pool.in_place_scope(move |scope| {
            scope.spawn(move |_| {
                // The receiver waits until this arrives.
                let _ = sender.send(catch_unwind(AssertUnwindSafe(|| job(progress))));
            });
            wait(receiver, watcher, progress, None)
        })
    });
    finish(py, outcome, interrupt, callback)
}

/// [`run`] for a job that owns its data. A job that does not stop in time when it is cancelled ends in the background,
/// and its result is dropped.
pub(super) fn run_owned<T: Send + 'static>(
    py: Python<'_>,
    job: impl FnOnce(&Progress) -> Result<T, Error> + Send + 'static,
) -> Result<T, Failure> {
    let pool = worker_pool(py)?;
    let progress = Arc::new(Progress::new());
    let callback = callback_of(py, None);
    let (sender, receiver) = sync_channel(1);
    let of_job = progress.clone();
    pool.spawn(move || {
        // The outcome of a job that was left has no receiver.
        let _ = sender.send(catch_unwind(AssertUnwindSafe(|| job(&of_job))));
    });
    let watcher = callback.as_ref();
    let (outcome, interrupt) = py.detach(move || wait(receiver, watcher, &progress, Some(GRACE)));
    finish(py, outcome, interrupt, callback)
}

type Outcome<T> = std::thread::Result<Result<T, Error>>;

fn callback_of(py: Python<'_>, callback: Option<&Bound<'_, PyAny>>) -> Option<Py<PyAny>> {
    match callback {
        Some(callback) => Some(callback.clone().unbind()),
        None => WATCHER.with_borrow(|watcher| watcher.as_ref().map(|callback| callback.clone_ref(py))),
    }
}

/// Waits for the outcome of a job. Meanwhile it handles signals and calls `callback`; an exception cancels the job. A
/// cancelled job that does not stop within `grace` is left without an outcome.
fn wait<T>(
    receiver: Receiver<Outcome<T>>,
    callback: Option<&Py<PyAny>>,
    progress: &Progress,
    grace: Option<Duration>,
) -> (Outcome<T>, Option<PyErr>) {
    let mut interrupt: Option<(PyErr, Instant)> = None;
    loop {
        let is_late = |interrupt: &Option<(PyErr, Instant)>| match (interrupt, grace) {
            (Some((_, since)), Some(grace)) => since.elapsed() >= grace,
            _ => false,
        };
        match receiver.recv_timeout(POLL) {
            Ok(outcome) => return (outcome, interrupt.map(|(error, _)| error)),
            Err(RecvTimeoutError::Timeout) if interrupt.is_none() => {
                if let Err(error) = Python::attach(|py| look_at_python(py, callback, progress)) {
                    progress.cancel();
                    interrupt = Some((error, Instant::now()));
                }
            }
            Err(RecvTimeoutError::Timeout) if !is_late(&interrupt) => {}
            Err(_) => return (Ok(Err(Error::Cancelled)), interrupt.map(|(error, _)| error)),
        }
    }
}

fn finish<T>(
    py: Python<'_>,
    outcome: Outcome<T>,
    interrupt: Option<PyErr>,
    callback: Option<Py<PyAny>>,
) -> Result<T, Failure> {
    if let Some(error) = interrupt {
        return Err(Failure::Python(error));
    }
    let value = outcome.map_err(|panic| internal_error(py, &*panic))??;
    if let Some(callback) = callback {
        call(py, &callback, 1.0).map_err(Failure::Python)?;
    }
    Ok(value)
}

/// Calls a callable with a fraction. Jobs that it starts are not watched.
fn call(py: Python<'_>, callback: &Py<PyAny>, fraction: f64) -> PyResult<()> {
    let watcher = watch(None);
    let called = callback.call1(py, (fraction,));
    watch(watcher);
    called.map(drop)
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
    callback.map_or(Ok(()), |callback| call(py, callback, progress.fraction()))
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
