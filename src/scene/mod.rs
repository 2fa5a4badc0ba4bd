//! Scenes: instances of objects under any affine transform, viewed by a camera and lit through distance fields.
//!
//! # Theory
//!
//! A picture is made in two passes that communicate by a G-buffer. The *primary* pass ([`primary`]) finds the visible
//! surfaces of each pixel: triangles exactly, as a rasteriser would at pixel centres, or the root of a field. The
//! *light* pass ([`light`]) evaluates the scene's distance fields ([`field`], [`shadow`]): the fraction of each light
//! that arrives, the open part of the hemisphere, and the length of material behind the surface. Both search a tree
//! over the boxes of the instances ([`tree`]).
//!
//! Spaces: *world*, the user's; *scene*, `(world - center) / scale` with a power of two, where the scene spans about 1
//! and float32 is accurate; *local*, the coordinates of the object of an instance; *field*, see [`field`]. Matrices are
//! named target-from-source. A distance `d` of an instance allows a step of `d / |L r|` along a scene ray `r`, where
//! `L` maps scene to local: valid for any affine transform, as the local ball around a point is an ellipsoid in the
//! scene.
//!
//! # Practice
//!
//! Build a [`Scene`] once and draw it any number of times by a [`Renderer`]. Objects are shared: a forest of one tree
//! has one field, and [`Scene::moved`] shares them all. A new kind of object casts shadows if it implements
//! [`field::Field`].

pub(crate) mod article;
pub(crate) mod bounces;
pub(crate) mod caster;
pub(crate) mod cone;
pub(crate) mod device_beams;
pub(crate) mod device_buffers;
pub(crate) mod device_fields;
pub(crate) mod device_light;
pub(crate) mod device_meshes;
pub(crate) mod emitters;
pub(crate) mod evaluation;
pub(crate) mod eye;
pub(crate) mod face_look;
pub(crate) mod far;
pub(crate) mod field;
pub(crate) mod gbuffer;
pub(crate) mod gpu;
pub(crate) mod instance;
pub(crate) mod kinds;
pub(crate) mod last_picture;
pub(crate) mod light;
pub(crate) mod light_buffer;
pub(crate) mod light_hits;
pub(crate) mod light_rays;
pub(crate) mod lit_surface;
pub(crate) mod material;
pub(crate) mod model;
pub(crate) mod nearby;
pub(crate) mod nested;
pub(crate) mod objects;
pub(crate) mod occlusion;
pub(crate) mod options;
pub(crate) mod pass;
pub(crate) mod primary;
pub(crate) mod raster;
pub(crate) mod rasterizer;
pub(crate) mod renderer;
pub(crate) mod shadow;
pub(crate) mod sheets;
pub(crate) mod texture;
pub(crate) mod thin;
mod tile;
pub(crate) mod transmission;
pub(crate) mod tree;
pub(crate) mod triangles;
pub(crate) mod upsampling;

pub use bounces::{BounceOptions, MAX_BOUNCES};
pub use instance::{Instance, InstanceInput};
pub use material::{Alpha, Material};
pub use model::Scene;
pub use options::{Ambient, Light, MAX_LIGHTS, Primary, RenderOptions, SceneShadows, Spot};
pub use renderer::{Rendered, Renderer};

#[cfg(test)]
mod tests;
