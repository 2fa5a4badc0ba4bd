//! `fieldbake._core.shader_library`: functions for the shaders of users.

use super::error::Failure;
use crate::shader_text::library::Library;
use crate::shader_text::translation::Language;
use pyo3::prelude::*;

/// The functions of a library ("volume", "sparse", "nested" or "quadrics") in a language. `head` is WGSL: a comment
/// and the constants that the functions read.
#[pyfunction]
pub(super) fn shader_library(library: &str, head: &str, language: &str) -> PyResult<String> {
    let library = Library::from_name(library).map_err(Failure::from)?;
    let language = Language::from_name(language).map_err(Failure::from)?;
    Ok(library.text(head, language).map_err(Failure::from)?)
}
