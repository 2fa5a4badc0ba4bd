//! The faces nearest to points.

pub(crate) mod closest;
pub(crate) mod exact;
pub(crate) mod group;
