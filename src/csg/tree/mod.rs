//! Shapes as users write them: trees of operators over primitives.

pub(crate) mod checks;
pub(crate) mod edge_grid;
pub(crate) mod ends;
pub(crate) mod field_kind;
pub(crate) mod kind;
pub(crate) mod language_table;
pub(crate) mod loops;
pub(crate) mod placement;
pub(crate) mod primitive;
pub(crate) mod profile;
pub(crate) mod region;
pub(crate) mod screw;
pub(crate) mod shape;
pub(crate) mod volume_leaf;
