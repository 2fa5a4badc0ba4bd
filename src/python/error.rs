//! Core errors as Python exceptions, one class of `fieldbake.base.errors` for each stage.

use crate::error::Error;
use pyo3::prelude::*;
use pyo3::types::PyType;

/// An error of the core, or a Python exception raised while waiting (an interrupt, a failing callback).
pub enum Failure {
    Core(Error),
    Python(PyErr),
}

impl<E: Into<Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Core(error.into())
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Core(error) => Python::attach(|py| raise(py, &error)),
            Failure::Python(error) => error,
        }
    }
}

fn raise(py: Python<'_>, error: &Error) -> PyErr {
    let class = match error {
        Error::Mesh(_) => "MeshError",
        Error::Atlas(_) => "AtlasError",
        Error::Format(_) => "FormatError",
        Error::Argument(_) => "ArgumentError",
        Error::Scene(_) => "SceneError",
        Error::Shape(_) => "ShapeError",
        Error::Capacity(_) => "CapacityError",
        Error::Device(_) => "DeviceError",
        // Jobs are cancelled only after Python has an exception to raise; see `run`.
        Error::Cancelled => "Error",
    };
    exception(py, class, error.to_string())
}

/// An exception of `fieldbake.base.errors` by name; the import error itself if the package is broken.
pub(super) fn exception(py: Python<'_>, class: &str, message: String) -> PyErr {
    let found = py.import("fieldbake.base.errors").and_then(|module| module.getattr(class));
    match found.and_then(|class| Ok(class.cast_into::<PyType>()?)) {
        Ok(class) => PyErr::from_type(class, message),
        Err(error) => error,
    }
}
