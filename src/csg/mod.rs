//! Constructive solid geometry: shapes made of simple solids, evaluated, decomposed and drawn.
//!
//! # Theory
//!
//! A user's tree ([`shape`]) is lowered to a [`model`]: placements at the leaves, repetitions written out, operators in
//! postfix order. [`program`] evaluates it for many points at a time; [`bounds`] carries boxes from the leaves to the
//! root.
//!
//! The magnitude of every field is a lower bound on the distance times its declared Lipschitz constant. A ray may step
//! by the field divided by the constant and never passes through a surface.
//!
//! # Practice
//!
//! [`Solid`] is a shape prepared for evaluation. [`language`] reads and writes s-expressions.

mod aabb;
pub mod align;
pub mod bounds;
mod cells;
mod checks;
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
pub mod part;
mod picture;
mod placement;
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
