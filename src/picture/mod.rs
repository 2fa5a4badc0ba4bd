//! The arrays of a picture, its camera, and the options that pictures of one object have.

pub(crate) mod camera;
mod frame;
mod lit_point;
mod options;

pub use camera::Camera;
pub use frame::Frame;
pub(crate) use frame::Row;
pub(crate) use lit_point::LitPoint;
pub use options::{DirectionalLight, Filter, RaymarchOptions, Shadows};
