//! Structs shared with shaders, each the twin of the WGSL struct of the same name.
//!
//! Fields are ordered so that no padding is needed: a three-component vector is followed by a scalar. A test parses
//! the WGSL and compares names, offsets and sizes.

mod bake;
mod merge;
mod picture;
mod scene;
mod surfaces;
#[cfg(test)]
mod tests;

pub use bake::*;
pub use merge::*;
pub use picture::*;
pub use scene::*;
pub use surfaces::*;
