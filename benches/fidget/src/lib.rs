//! fidget's just-in-time renderer behind a C interface, for `csg_peers.py`.

use fidget::context::Context;
use fidget::jit::JitShape;
use fidget::raster::voxel::{RenderConfig, RenderSize};
use nalgebra::Matrix4;
use std::slice;

/// Read a tree in fidget's text format; null if it refuses it.
///
/// # Safety
/// `text` points to `length` bytes.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fidget_open(text: *const u8, length: usize) -> *mut JitShape {
    // SAFETY: by the contract above.
    let text = unsafe { slice::from_raw_parts(text, length) };
    let shape = Context::from_text(text).ok().and_then(|(context, root)| JitShape::new(&context, root).ok());
    shape.map_or(std::ptr::null_mut(), |shape| Box::into_raw(Box::new(shape)))
}

/// Draw the box from -1 to 1 of the viewing space, seen from +z without perspective, on all cores, `side` pixels and
/// voxels along each axis. `depths` gets the voxel that was hit, 0 for none.
///
/// # Safety
/// `shape` comes from `fidget_open`, `model_from_view` points to 16 floats, column by column, `depths` to the pixels.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fidget_draw(shape: *const JitShape, model_from_view: *const f32, side: u32, depths: *mut u32) {
    // SAFETY: by the contract above.
    let (shape, matrix, depths) = unsafe {
        (
            &*shape,
            Matrix4::from_column_slice(slice::from_raw_parts(model_from_view, 16)),
            slice::from_raw_parts_mut(depths, (side * side) as usize),
        )
    };
    let config = RenderConfig { image_size: RenderSize::from(side), world_to_model: matrix };
    let Ok(bound) = shape.clone().try_into() else { return };
    let image = config.run::<fidget::jit::JitFunction>(bound);
    for (depth, pixel) in depths.iter_mut().zip(image.iter()) {
        *depth = pixel.depth;
    }
}

/// Free a shape.
///
/// # Safety
/// `shape` comes from `fidget_open` and is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn fidget_free(shape: *mut JitShape) {
    // SAFETY: by the contract above.
    drop(unsafe { Box::from_raw(shape) });
}
