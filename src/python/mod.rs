//! The Python module `fieldbake._core`. It converts arrays, calls the core without the GIL, and converts the results.
//! It contains no algorithm.
//!
//! The Python layer passes C-contiguous arrays of the right dtype and shape. `_core.pyi` is the contract.

#![expect(clippy::too_many_arguments, reason = "a Python function has an argument for each keyword")]

mod assembly;
mod atlas;
mod bake;
mod cloud;
mod convert;
mod csg;
mod device;
mod error;
mod light;
mod merge;
mod mesh;
mod openexr;
mod quadric;
mod query;
mod rays;
mod region;
mod render;
mod run;
mod scene;
mod shader;
mod sparse;
mod surface;
mod sweep;
mod viewer;
mod volume;

use pyo3::prelude::*;

/// Registers all exported functions and classes.
#[pymodule]
mod _core {
    #[pymodule_export]
    use super::assembly::Bodies;
    #[pymodule_export]
    use super::atlas::{
        DevicePages, atlas_clear, atlas_entries, atlas_pack_device, atlas_plan, atlas_read, atlas_sample, atlas_shader,
        atlas_sound, atlas_texture_coordinates, atlas_write, require_memory,
    };
    #[pymodule_export]
    use super::bake::{bake, bake_blocks, bake_brute, bake_update, bake_window, sides_of_balls};
    #[pymodule_export]
    use super::cloud::{PointCloud, orient};
    #[pymodule_export]
    use super::csg::Shape;
    #[pymodule_export]
    use super::device::{DeviceField, devices};
    #[pymodule_export]
    use super::merge::merge;
    #[pymodule_export]
    use super::mesh::{Mesh, divide_obj_polygons, read_obj};
    #[pymodule_export]
    use super::openexr::exr_read;
    #[pymodule_export]
    use super::query::{
        OuterSides, closest_point, contains, query, refined, sample_surface, signed_distance, signed_distance_float64,
        thickness, winding_number,
    };
    #[pymodule_export]
    use super::rays::{all_intersections, cast_rays, count_intersections, occluded};
    #[pymodule_export]
    use super::region::{combined_polygons, offset_polygons, resolved_polygons};
    #[pymodule_export]
    use super::render::raymarch;
    #[pymodule_export]
    use super::run::{set_threads, watch};
    #[pymodule_export]
    use super::scene::{Renderer, Scene, SceneField, SceneMesh, Texture};
    #[pymodule_export]
    use super::shader::shader_library;
    #[pymodule_export]
    use super::sparse::{
        SparseField, bake_cloud_sparse, bake_sparse, check_scales, decode, encode, encoding_scale, to_sparse,
    };
    #[pymodule_export]
    use super::surface::{Surface, SurfaceBlocks};
    #[pymodule_export]
    use super::sweep::Sweep;
    #[pymodule_export]
    use super::viewer::{viewer_shader, viewer_triangles};
    #[pymodule_export]
    use super::volume::{gradient, resample, sample};

    use super::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }
}
