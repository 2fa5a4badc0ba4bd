//! The Python module `fieldbake._core`: arrays in, the core's call without the GIL, arrays out. No algorithm lives here.
//!
//! The Python layer hands over C-contiguous arrays of the right dtype and shape; `_core.pyi` beside it is the contract.

mod bake;
mod convert;
mod device;
mod error;
mod mesh;
mod query;
mod render;
mod run;
mod scene;
mod sparse;
mod volume;

use pyo3::prelude::*;

/// The whole exported surface.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::bake::{bake, bake_brute};
    #[pymodule_export]
    use super::device::{DeviceField, devices};
    #[pymodule_export]
    use super::mesh::Mesh;
    #[pymodule_export]
    use super::query::{closest_point, signed_distance};
    #[pymodule_export]
    use super::render::raymarch;
    #[pymodule_export]
    use super::scene::{Scene, SceneField, SceneMesh, Texture, render};
    #[pymodule_export]
    use super::sparse::{SparseField, bake_sparse, decode, encode, to_sparse};
    #[pymodule_export]
    use super::volume::{gradient, resample, sample, surface_nets};

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
