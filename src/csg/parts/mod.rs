//! The decomposition of a shape into parts, each valid in its own boxes, and rays through them.

pub(crate) mod carried_boxes;
pub(crate) mod cells;
pub(crate) mod chord;
pub(crate) mod closed_form;
pub(crate) mod decompose;
pub(crate) mod grid_samples;
pub(crate) mod octree;
pub(crate) mod part;
pub(crate) mod point_values;
pub(crate) mod pruning;
pub(crate) mod solid;
pub(crate) mod trace;
