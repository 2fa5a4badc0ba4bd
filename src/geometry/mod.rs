//! Boxes and triangles: closest points, solid angles and bounds in closed form; and codes along a space-filling curve.

mod aabb;
mod clip;
mod morton;
mod triangle;
mod triangle_crossing;
mod triangle_pair;

/// 2 pi (1 - 1 / golden ratio), radians: multiples of it spread evenly over a turn (Vogel 1979).
pub(crate) const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

pub use aabb::Aabb;
pub(crate) use clip::clip;
pub(crate) use morton::morton_code;
pub use triangle::{Feature, SolidAngles, TrianglePoint, closest_point_on_triangle, solid_angle, triangle_cross};
pub(crate) use triangle::{is_needle, is_on_a_line};
pub use triangle_crossing::triangles_cross;
pub use triangle_pair::closest_points_of_triangles;
