//! Shapes in postfix form: placements at the leaves, repetitions written out.

pub(crate) mod align;
pub(crate) mod bounds;
pub(crate) mod lower;
pub(crate) mod lowered;
pub(crate) mod operand_stack;
pub(crate) mod token;
