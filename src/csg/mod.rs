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
pub(crate) mod align;
pub(crate) mod bounds;
mod cells;
mod checks;
pub(crate) mod chord;
mod compiled;
mod deciding;
pub(crate) mod decompose;
pub(crate) mod draw;
mod dual;
mod field;
mod gpu;
pub(crate) mod language;
mod leaf;
mod level;
mod lower;
pub(crate) mod model;
mod octree;
pub(crate) mod part;
mod picture;
mod placement;
pub(crate) mod primitive;
pub(crate) mod profile;
pub(crate) mod program;
mod real;
pub(crate) mod shader;
pub(crate) mod shape;
pub(crate) mod solid;
pub(crate) mod token;
pub(crate) mod trace;
pub(crate) mod volume_leaf;
pub(crate) mod whole;
mod word;

#[cfg(test)]
pub(crate) use leaf::kernel_texts;
pub use level::{level_surface, planes_around_of_shape, planes_of_shape};
pub use shape::{Blend, Op, Shape};
pub use solid::Solid;
