//! Checks of the arguments of shapes.

use crate::error::ShapeError;

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
