//! Values of shapes at points: programs, the fields of leaves, and their scalar types.

pub(crate) mod active_operands;
pub(crate) mod dual;
pub(crate) mod field;
pub(crate) mod flat_polygon;
pub(crate) mod helicoid;
pub(crate) mod leaf;
pub(crate) mod placed_volume;
pub(crate) mod program;
pub(crate) mod scalar;
