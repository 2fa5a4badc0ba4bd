//! Objects in scenes without a dense grid: quadrics, shapes and sparse fields, each drawn and traced directly.

mod quadric;
mod shape;
mod sparse;

pub(crate) use quadric::QuadricField;
pub(crate) use shape::ShapeField;
pub(crate) use sparse::SparseBricks;
