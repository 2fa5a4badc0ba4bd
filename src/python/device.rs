//! `fieldbake._core.devices` and `DeviceField`.

use super::convert::{samples, volume_array};
use super::error::{Failure, exception};
use super::run::run;
use crate::gpu::{self, Place};
use crate::volume::device;
use numpy::{PyArray3, PyReadonlyArray3};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ffi::CString;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

/// The available devices, the CPU first.
#[pyfunction]
pub(super) fn devices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
    let found = py.detach(gpu::devices);
    found
        .into_iter()
        .map(|device| {
            let facts = PyDict::new(py);
            facts.set_item("name", device.name)?;
            facts.set_item("backend", device.backend)?;
            facts.set_item("type", device.kind)?;
            facts.set_item("hardware", device.hardware)?;
            let limits = PyDict::new(py);
            for (name, value) in device.limits {
                limits.set_item(name, value)?;
            }
            facts.set_item("limits", limits)?;
            Ok(facts)
        })
        .collect()
}

/// The device of a call with this `device=`. Warns once per process if "gpu" is a software adapter.
pub(super) fn choose(py: Python<'_>, device: &str) -> PyResult<Place> {
    static WARNED: AtomicBool = AtomicBool::new(false);
    let place = py.detach(|| gpu::choose(device)).map_err(Failure::from)?;
    if let Some(warning) = place.warning(device)
        && !WARNED.swap(true, Relaxed)
    {
        let category = py.import("fieldbake.base.errors")?.getattr("PerformanceWarning")?;
        // Level 1 is the Python function that called the core; level 2 is the line that called it.
        PyErr::warn(py, &category, &CString::new(warning)?, 2)?;
    }
    Ok(place)
}

/// Distances in device memory, read back on request.
#[pyclass(frozen, module = "fieldbake._core")]
pub struct DeviceField(pub device::DeviceField);

#[pymethods]
impl DeviceField {
    #[getter]
    fn shape(&self) -> (usize, usize, usize) {
        self.0.shape().into()
    }

    #[getter]
    fn nbytes(&self) -> u64 {
        self.0.bytes()
    }

    #[getter]
    fn device(&self) -> String {
        self.0.context().label()
    }

    /// Copies samples (nx, ny, nz) with x fastest to a device, which must not be the CPU.
    #[staticmethod]
    fn upload(py: Python<'_>, distances: PyReadonlyArray3<'_, f32>, device: &str) -> PyResult<Self> {
        let Place::Gpu(context) = choose(py, device)? else {
            return Err(exception(py, "ArgumentError", format!("device: samples on {device:?} need no upload")));
        };
        let (shape, samples) = samples(&distances)?;
        Ok(Self(run(py, None, |_| device::DeviceField::upload(&context, shape, samples))?))
    }

    /// The samples, (nx, ny, nz) float32 with x fastest.
    fn read<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let samples = run(py, None, |progress| self.0.read(progress))?;
        volume_array(py, samples, self.0.shape())
    }

    /// Whether a call with this `device=` runs on the device of the field.
    fn serves(&self, py: Python<'_>, device: &str) -> PyResult<bool> {
        Ok(match choose(py, device)? {
            Place::Gpu(context) => std::sync::Arc::ptr_eq(&context, self.0.context()),
            Place::Cpu => false,
        })
    }

    /// Number of transfers of the device so far, for tests.
    fn _transfers<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let counters = &self.0.context().counters;
        let facts = PyDict::new(py);
        facts.set_item("uploads", counters.uploads.load(Relaxed))?;
        facts.set_item("uploaded_bytes", counters.uploaded_bytes.load(Relaxed))?;
        facts.set_item("readbacks", counters.readbacks.load(Relaxed))?;
        facts.set_item("readback_bytes", counters.readback_bytes.load(Relaxed))?;
        Ok(facts)
    }

    /// Destroys the device, as if the driver had removed it, for tests.
    fn _destroy_device(&self) {
        self.0.context().destroy();
    }
}
