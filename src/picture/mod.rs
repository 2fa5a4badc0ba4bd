//! The arrays of a picture, its camera, lights and reflection, and the options that pictures of one object have.

pub(crate) mod camera;
mod frame;
mod light;
mod lit_point;
mod options;

pub use camera::Camera;
pub use frame::Frame;
pub(crate) use frame::Row;
pub(crate) use light::DirectionalLight;
pub use light::{Light, MAX_LIGHTS, Spot};
pub(crate) use lit_point::LitPoint;
pub use options::{Filter, RaymarchOptions, Shadows};
