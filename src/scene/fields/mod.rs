//! Distance fields of the objects of a scene, one kind in each file, and their tables on devices.

pub(crate) mod device_fields;
pub(crate) mod field;
pub(crate) mod nested;
pub(crate) mod quadric;
pub(crate) mod shader_variants;
pub(crate) mod shape;
pub(crate) mod slope;
pub(crate) mod sparse;
