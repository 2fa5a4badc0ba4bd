//! Texts of shaders in other languages.

pub(crate) mod library;
pub(crate) mod translation;
