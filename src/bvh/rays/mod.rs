//! The faces that rays hit.

pub(crate) mod cast;
#[cfg(target_arch = "x86_64")]
pub(crate) mod packet;
pub(crate) mod ray_group;
pub(crate) mod ray_lanes;
pub(crate) mod ray_search;
pub(crate) mod sorted_stack;
pub(crate) mod turns;
pub(crate) mod watertight;
