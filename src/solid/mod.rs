//! Functions of meshes for closed meshes from level sets: sides of samples, deviations, self-intersections.

mod deviation;
mod outer;
mod self_intersections;
mod side_grid;

pub use deviation::{Deviation, deviation};
pub use outer::OuterSides;
pub use self_intersections::count_self_intersections;
pub(crate) use side_grid::SideGrid;
