//! `fieldbake._core.devices`.

use crate::gpu;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// What can compute, the CPU first.
#[pyfunction]
pub fn devices(py: Python<'_>) -> PyResult<Vec<Bound<'_, PyDict>>> {
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
