//! Scenes: instances of objects under any affine transform, viewed by a camera and lit through distance fields.
//!
//! # Theory
//!
//! A picture is made in two passes that communicate by a G-buffer. The *primary* pass ([`visibility::primary`]) finds
//! the visible surfaces of each pixel: triangles exactly, as a rasteriser would at pixel centres, or the root of a
//! field. The *light* pass ([`lighting`]) traces thin rays past the triangles of meshes, and everything else through
//! the scene's distance fields ([`fields`], [`light::shadow`]): the fraction of each light that arrives, the open part
//! of the hemisphere, and the length of material behind the surface. Both search a tree over the boxes of the
//! instances ([`content::tree`]).
//!
//! Spaces: *world*, the user's; *scene*, `(world - center) / scale` with a power of two, where the scene spans about 1
//! and float32 is accurate; *local*, the coordinates of the object of an instance; *field*, see [`fields::field`].
//! Matrices are named target-from-source. A distance `d` of an instance allows a step of `d / |L r|` along a scene ray
//! `r`, where `L` maps scene to local: valid for any affine transform, as the local ball around a point is an ellipsoid
//! in the scene.
//!
//! # Practice
//!
//! Build a [`Scene`] once and draw it any number of times by a [`Renderer`]. Objects are shared: a forest of one tree
//! has one field, and [`Scene::moved`] shares them all. A new kind of object casts shadows if it implements
//! [`fields::field::Field`].

pub(crate) mod content;
pub(crate) mod device;
pub(crate) mod fields;
pub(crate) mod last_picture;
pub(crate) mod light;
pub(crate) mod lighting;
pub(crate) mod renderer;
mod uneven;
pub(crate) mod visibility;

pub use content::instance::{Instance, InstanceInput};
pub use content::material::{Alpha, Material};
pub use content::model::Scene;
pub use content::options::{Ambient, BounceOptions, MAX_BOUNCES, Primary, RenderOptions, SceneShadows};
pub use renderer::{Rendered, Renderer};

#[cfg(test)]
mod tests;
