//! The march of a ray through a stored field: to the first root of the trilinear field, over empty blocks.

pub(crate) mod blocks;
pub(crate) mod bricks;
pub(crate) mod cubic;
pub(crate) mod empty;
pub(crate) mod marcher;
pub(crate) mod tiles;
pub(crate) mod voxels;
