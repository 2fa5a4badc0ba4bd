//! Alignment of a shape by its own box.

use super::lowered::Model;
use crate::csg::tree::shape::Shape;
use crate::error::ShapeError;
use glam::DVec3;

/// The shape moved so that `anchor` of its box lies at the origin: -1 is the lower side, 0 the middle, 1 the upper
/// side. As in Tangerine, the box encloses the shape with sharp joints: fillets do not enlarge it.
pub(crate) fn aligned(shape: &Shape, anchor: DVec3) -> Result<Shape, ShapeError> {
    if !anchor.abs().cmple(DVec3::ONE).all() {
        return Err(ShapeError::argument("anchor", format!("must be from -1 to 1 on every axis, got {anchor}")));
    }
    let model = Model::new(shape)?;
    model.is_bounded()?;
    let inner = model.sharp_extent();
    if inner.is_empty() {
        return Err(ShapeError::argument("shape", "is empty, it has no box to align"));
    }
    let origin = 0.5 * (inner.lower + inner.upper) + 0.5 * anchor * (inner.upper - inner.lower);
    shape.changed("translate", &(-origin).to_array())
}
