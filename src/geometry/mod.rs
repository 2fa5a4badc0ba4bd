//! Points, boxes and triangles: the closed forms that everything else is built from.

mod aabb;
mod triangle;

pub use aabb::Aabb;
pub use triangle::{
    Feature, TrianglePoint, barycentric_weights, closest_point_on_triangle, solid_angle, triangle_cross,
};
