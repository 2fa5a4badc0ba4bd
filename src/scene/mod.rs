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
//! Build a [`Scene`] once and draw it any number of times by a [`Renderer`](renderer::Renderer). Objects are shared: a
//! forest of one tree has one field, and [`Scene::moved`] shares them all. A new kind of object casts shadows if it
//! implements [`field::Field`].

pub mod article;
pub mod cone;
pub mod device_beams;
pub mod device_buffers;
pub mod device_fields;
pub mod device_light;
pub mod device_meshes;
pub mod evaluation;
pub mod eye;
pub mod far;
pub mod field;
pub mod gbuffer;
pub mod gpu;
pub mod instance;
pub mod kinds;
pub mod light;
pub mod light_buffer;
pub mod light_rays;
pub mod lit_surface;
pub mod material;
pub mod model;
pub mod nested;
pub mod objects;
pub mod occlusion;
pub mod options;
pub mod pass;
pub mod primary;
pub mod raster;
pub mod rasterizer;
pub mod renderer;
pub mod shadow;
pub mod sheets;
pub mod texture;
pub mod thin;
pub mod transmission;
pub mod tree;
pub mod triangles;
pub mod upsampling;

pub use instance::{Instance, InstanceInput};
pub use material::{Alpha, Material};
pub use model::Scene;
pub use options::{Light, MAX_LIGHTS, Primary, RenderOptions, SceneShadows};

#[cfg(test)]
mod tests;
