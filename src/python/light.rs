//! The lights of `fieldbake._core.raymarch` and `fieldbake._core.Renderer`, as rows.

use crate::picture::{Light, Spot};
use glam::DVec3;
use pyo3::prelude::*;

/// One light, as a dictionary: a directional one with `direction` and `slope`, or a point light with `position`,
/// `radius`, `range` and `spot`.
#[derive(FromPyObject)]
pub(super) enum LightRow {
    #[pyo3(transparent)]
    Directional(DirectionalRow),
    #[pyo3(transparent)]
    Point(PointRow),
}

/// The light of a direction; `slope` is the tangent of half its angle.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct DirectionalRow {
    direction: [f64; 3],
    slope: f32,
    color: [f64; 3],
}

#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(super) struct PointRow {
    position: [f64; 3],
    radius: f64,
    color: [f64; 3],
    range: Option<f64>,
    /// Axis, and cosines of the inner and outer angle.
    spot: Option<([f64; 3], [f64; 2])>,
}

impl From<LightRow> for Light {
    fn from(row: LightRow) -> Self {
        let color = |color| DVec3::from_array(color).as_vec3();
        match row {
            LightRow::Directional(row) => Self::Directional {
                direction: DVec3::from_array(row.direction),
                color: color(row.color),
                slope: row.slope,
            },
            LightRow::Point(row) => Self::Point {
                position: DVec3::from_array(row.position),
                color: color(row.color),
                radius: row.radius,
                range: row.range,
                spot: row.spot.map(|(axis, cosines)| Spot { axis: DVec3::from_array(axis), cosines }),
            },
        }
    }
}
