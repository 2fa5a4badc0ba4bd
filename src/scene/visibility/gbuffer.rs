//! The G-buffer: the visible surfaces of each pixel of a picture.

use crate::picture::Camera;
use glam::{DVec3, Vec3, Vec4};

/// A surface visible in a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Layer {
    pub x: u32,
    pub instance: u32,
    pub material: u32,
    /// Depth along the viewing axis, world units.
    pub depth: f64,
    /// Unit normal in world space, on the visible side.
    pub normal: Vec3,
    /// Linear RGB and opacity.
    pub color: Vec4,
    /// Linear RGB that the surface emits.
    pub emission: Vec3,
    /// Offset to the smooth surface above a face, in units of the mesh's tree; zero for a field.
    pub to_smooth: Vec3,
    /// Whether the hit is a triangle, not a field.
    pub is_triangle: bool,
    /// Whether the device that drew the picture has the surface too.
    pub is_from_device: bool,
}

/// Some pixels of a picture.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Pixels {
    pub width: usize,
    /// Whether each pixel is one of them, by rows from the top.
    pub is_chosen: Vec<bool>,
}

impl Pixels {
    #[inline]
    pub(crate) fn contains(&self, x: u32, y: u32) -> bool {
        self.is_chosen[x as usize + self.width * y as usize]
    }
}

/// The visible surfaces of a picture, by rows from the top. A row has the layers of its pixels in order, the layers of
/// one pixel from front to back.
#[derive(Debug)]
pub(crate) struct GBuffer {
    pub rows: Vec<Vec<Layer>>,
    /// Number of steps of each pixel.
    pub steps: Vec<Vec<u32>>,
    pub view: View,
    /// The same picture in the memory of the device, if the device drew all of it.
    pub visible: Option<DeviceVisibility>,
}

/// The camera in float64, with the position in a pixel that its rays pass through.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View {
    pub camera: Camera,
    pub size: [u32; 2],
    pub offset: [f64; 2],
}

impl View {
    /// World position at which a pixel's ray starts, at depth 0.
    #[inline]
    pub(crate) fn start(&self, x: u32, y: u32) -> DVec3 {
        let start = self.camera.pixel_start(x, y, self.size);
        if self.camera.is_parallel() { start + self.aside() } else { start }
    }

    /// World direction of a pixel's ray; multiples of it are depths.
    #[inline]
    pub(crate) fn direction(&self, x: u32, y: u32) -> DVec3 {
        let direction = self.camera.pixel_direction(x, y, self.size);
        if self.camera.is_parallel() { direction } else { direction + self.aside() }
    }

    /// World position at a depth on a pixel's ray.
    #[inline]
    pub(crate) fn position(&self, x: u32, y: u32, depth: f64) -> DVec3 {
        self.start(x, y) + depth * self.direction(x, y)
    }

    /// Offset of the rays from the centres of their pixels: at depth 1, or at any depth if they are parallel.
    #[inline]
    fn aside(&self) -> DVec3 {
        self.camera.pixel_size(self.size[1])
            * ((self.offset[0] - 0.5) * self.camera.right - (self.offset[1] - 0.5) * self.camera.up)
    }

    /// Side of a pixel at a depth, world units.
    #[inline]
    pub(crate) fn pixel_size_at(&self, depth: f64) -> f64 {
        self.camera.pixel_size_at(self.size[1], depth)
    }
}

/// The faces that a device found, in its memory.
#[derive(Debug)]
pub(crate) struct DeviceVisibility {
    /// Four words per pixel, with this number of pixels per row in memory.
    pub pixels: wgpu::Buffer,
    pub stride: u32,
    /// Rows of the drawn instances.
    pub rows: wgpu::Buffer,
    /// Scene directions of rays, one unit of depth long: through fragment (0, 0), and the changes to the right and
    /// down.
    pub rays: [DVec3; 3],
}
