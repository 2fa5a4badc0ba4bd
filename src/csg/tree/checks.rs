//! Checks of the arguments of shapes.

use crate::error::ShapeError;
use glam::DVec3;

/// Largest magnitude of a length. Squares of derived values stay in the range of float64.
const FAR: f64 = 1e37;

/// A positive length.
pub(crate) fn positive(argument: &'static str, value: f64) -> Result<f64, ShapeError> {
    if value > 0.0 && value <= FAR {
        return Ok(value);
    }
    Err(ShapeError::argument(argument, format!("must be a number above 0, got {value}")))
}

/// A length of zero or more.
pub(crate) fn not_negative(argument: &'static str, value: f64) -> Result<f64, ShapeError> {
    if (0.0..=FAR).contains(&value) {
        return Ok(value);
    }
    Err(ShapeError::argument(argument, format!("must be a number of at least 0, got {value}")))
}

/// Any finite number of reasonable size.
pub(crate) fn finite(argument: &'static str, value: f64) -> Result<f64, ShapeError> {
    if value.abs() <= FAR {
        return Ok(value);
    }
    Err(ShapeError::argument(argument, format!("must be a finite number (at most {FAR:e}), got {value}")))
}

/// The unit vector along a vector of any length. A vector that has unit length up to rounding stays as it is, so that a
/// shape is equal to the one that is read from its text.
pub(crate) fn unit(name: &'static str, vector: [f64; 3]) -> Result<DVec3, ShapeError> {
    let [x, y, z] = vector.map(|component| finite(name, component));
    let vector = DVec3::new(x?, y?, z?);
    let largest = vector.abs().max_element();
    if largest == 0.0 {
        return Err(ShapeError::argument(name, "is zero, expected a direction"));
    }
    let is_unit = (vector.length_squared() - 1.0).abs() <= 4.0 * f64::EPSILON;
    Ok(if is_unit { vector } else { (vector / largest).normalize() })
}
