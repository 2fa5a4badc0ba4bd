//! Boxes and triangles: closest points, solid angles and bounds in closed form.

mod aabb;
mod clip;
mod triangle;
mod triangle_crossing;
mod triangle_pair;

pub use aabb::Aabb;
pub(crate) use clip::clip;
pub use triangle::{Feature, SolidAngles, TrianglePoint, closest_point_on_triangle, solid_angle, triangle_cross};
pub(crate) use triangle::{is_needle, is_on_a_line};
pub use triangle_crossing::triangles_cross;
pub use triangle_pair::closest_points_of_triangles;
