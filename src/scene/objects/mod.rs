//! Objects in scenes without a dense grid: quadrics, shapes and sparse fields, each drawn and traced directly.

mod quadric;
mod shape;
mod sparse;

pub use quadric::QuadricField;
pub use shape::ShapeField;
pub use sparse::SparseBricks;
