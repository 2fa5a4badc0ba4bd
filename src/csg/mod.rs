//! Constructive solid geometry: shapes from simple solids, evaluated, decomposed and drawn.
//!
//! # Theory
//!
//! A user's tree ([`shape`]) is lowered to a [`model`]: placements at the leaves, repetitions written out, operators in
//! postfix order. [`program`] evaluates it for many points at a time; [`bounds`] carries boxes from the leaves to the root.
//!
//! Every field is a lower bound of the distance in size, up to its declared Lipschitz constant: a ray may step by field over
//! constant and never passes through a surface.
//!
//! # Practice
//!
//! [`Solid`] is a shape ready for questions. [`language`] reads and writes s-expressions.

mod aabb;
pub mod align;
pub mod bounds;
pub mod chord;
mod compiled;
pub mod decompose;
pub mod draw;
mod field;
mod gpu;
pub mod language;
mod leaf;
mod lower;
pub mod model;
mod octree;
pub mod primitive;
pub mod profile;
pub mod program;
mod real;
pub mod shader;
pub mod shape;
pub mod solid;
pub mod trace;
pub mod volume_leaf;
pub mod whole;
mod word;

#[cfg(test)]
pub(crate) use leaf::kernel_texts;
pub use shape::{Blend, Op, Shape};
pub use solid::Solid;
