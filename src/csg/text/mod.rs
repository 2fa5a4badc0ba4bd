//! Shapes as text: the language of users, functions of shaders, and graphs of operations.

pub(crate) mod graph;
pub(crate) mod language;
pub(crate) mod shader;
pub(crate) mod specialised_kernel;
pub(crate) mod structure_text;
pub(crate) mod volume_image;
