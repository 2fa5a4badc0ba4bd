//! Constructive solid geometry: shapes made of simple solids, evaluated, decomposed and drawn.
//!
//! # Theory
//!
//! A user's tree ([`tree::shape`]) is lowered to a [`model`](model::lowered): placements at the leaves, repetitions
//! written out, operators in postfix order. [`program`](evaluation::program) evaluates it for many points at a time;
//! [`bounds`](model::bounds) carries boxes from the leaves to the root.
//!
//! The magnitude of every field is a lower bound on the distance times its declared Lipschitz constant. A ray may step
//! by the field divided by the constant and never passes through a surface.
//!
//! # Practice
//!
//! [`Solid`] is a shape prepared for evaluation. [`language`](text::language) reads and writes s-expressions.

mod between_samples;
pub(crate) mod device;
pub(crate) mod evaluation;
mod level_set;
pub(crate) mod model;
pub(crate) mod parts;
pub(crate) mod text;
pub(crate) mod tree;

pub use level_set::{ShapeSurface, level_surface, planes_around_of_shape, planes_of_shape};
pub use parts::solid::Solid;
pub use tree::kind::{Blend, Op};
pub use tree::shape::Shape;
