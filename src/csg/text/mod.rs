//! Shapes as text: the language of users, and functions of shaders.

pub(crate) mod language;
pub(crate) mod shader;
pub(crate) mod specialised_kernel;
pub(crate) mod structure_text;
