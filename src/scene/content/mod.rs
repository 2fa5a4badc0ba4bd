//! The contents of a scene: instances, meshes, materials and textures; and the options of its pictures.

pub(crate) mod instance;
pub(crate) mod material;
pub(crate) mod model;
pub(crate) mod options;
pub(crate) mod sheets;
pub(crate) mod texture;
pub(crate) mod tree;
pub(crate) mod triangles;
