//! A camera in the OpenGL convention: it looks along its -Z axis, +Y is up, +X right. Its rays pass through the eye, or
//! are parallel.

use super::options::{RaymarchOptions, Shadows};
use crate::error::{ArgumentError, Error};
use crate::gpu::layout::PictureRays;
use glam::{BVec3, DMat3, DVec2, DVec3, UVec2};
use std::ops::Range;

/// Position and orientation of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    /// Position, world space.
    pub eye: DVec3,
    /// Unit vector to the right in the picture, world space.
    pub right: DVec3,
    /// Unit vector upwards in the picture, world space.
    pub up: DVec3,
    /// Unit vector against the viewing direction, world space.
    pub back: DVec3,
    /// Half the height of the picture: on the plane at depth 1, or at any depth if the rays are parallel.
    half_height: f64,
    is_parallel: bool,
}

/// Largest cosine between two axes of a pose. Poses stored in float32 pass, sheared ones do not.
const LARGEST_SKEW: f64 = 1e-3;

impl Camera {
    /// Makes a camera from its pose, the rows of the matrix `world_from_camera`, and the vertical field of view in
    /// degrees.
    ///
    /// A scale in the pose is ignored: depth is in world units. A mirrored pose gives a mirrored picture.
    pub fn from_pose(pose: &[[f64; 4]; 4], fov_deg: f64) -> Result<Self, Error> {
        if !(fov_deg > 0.0 && fov_deg < 180.0) {
            let problem = format!("must lie between 0 and 180 degrees, got {fov_deg}");
            return Err(ArgumentError::new("fov_deg", problem).into());
        }
        Self::new(pose, (0.5 * fov_deg.to_radians()).tan(), false)
    }

    /// Makes a camera with parallel rays from its pose and the height of the picture in world units.
    pub fn orthographic(pose: &[[f64; 4]; 4], height: f64) -> Result<Self, Error> {
        if !(height > 0.0 && height.is_finite()) {
            return Err(ArgumentError::new("height", format!("must be finite and above 0, got {height}")).into());
        }
        Self::new(pose, 0.5 * height, true)
    }

    fn new(pose: &[[f64; 4]; 4], half_height: f64, is_parallel: bool) -> Result<Self, Error> {
        let error = |problem: String| Err(ArgumentError::new("pose", problem).into());
        if let Some((row, column)) = entries().find(|&(row, column)| !pose[row][column].is_finite()) {
            return error(format!("[{row}, {column}] is {}, expected a finite number", pose[row][column]));
        }
        if pose[3] != [0.0, 0.0, 0.0, 1.0] {
            return error(format!(
                "the last row must be 0 0 0 1, got {:?}; the position belongs in the last column",
                pose[3]
            ));
        }
        let column = |j: usize| DVec3::new(pose[0][j], pose[1][j], pose[2][j]);
        let axes = [0, 1, 2].map(|j| {
            // Dividing by the largest entry first keeps the direction at tiny and huge scales.
            let axis = column(j);
            (axis / axis.abs().max_element()).normalize_or_zero()
        });
        if let Some(j) = axes.iter().position(|axis| *axis == DVec3::ZERO) {
            return error(format!("column {j} is zero, expected an axis of the camera"));
        }
        let [right, up, back] = axes;
        let skew = right.dot(up).abs().max(up.dot(back).abs()).max(back.dot(right).abs());
        if skew > LARGEST_SKEW {
            return error(format!("the axes must be perpendicular, the largest cosine between two is {skew:.3}"));
        }
        Ok(Self { eye: column(3), right, up, back, half_height, is_parallel })
    }

    /// Whether all rays have the viewing direction.
    #[inline]
    pub fn is_parallel(&self) -> bool {
        self.is_parallel
    }

    /// World position at which the ray through the centre of pixel `(x, y)` starts, row 0 on top. Its depth is 0.
    #[inline]
    pub fn pixel_start(&self, x: u32, y: u32, size: [u32; 2]) -> DVec3 {
        if self.is_parallel { self.eye + self.aside(x, y, size) } else { self.eye }
    }

    /// World direction of the ray through the centre of pixel `(x, y)`, row 0 on top. Its component along the viewing
    /// axis is 1, so a multiple of it is a depth.
    #[inline]
    pub fn pixel_direction(&self, x: u32, y: u32, size: [u32; 2]) -> DVec3 {
        if self.is_parallel { -self.back } else { self.aside(x, y, size) - self.back }
    }

    /// Offset of the centre of a pixel from the viewing axis: at depth 1, or at any depth if the rays are parallel.
    #[inline]
    fn aside(&self, x: u32, y: u32, [width, height]: [u32; 2]) -> DVec3 {
        let pixel = self.pixel_size(height);
        let right = (x as f64 + 0.5 - 0.5 * width as f64) * pixel;
        let up = (0.5 * height as f64 - 0.5 - y as f64) * pixel;
        right * self.right + up * self.up
    }

    /// Side of a pixel: on the plane at depth 1, or at any depth if the rays are parallel.
    #[inline]
    pub fn pixel_size(&self, height: u32) -> f64 {
        2.0 * self.half_height / height as f64
    }

    /// Side of a pixel on the plane at a depth, world units.
    #[inline]
    pub fn pixel_size_at(&self, height: u32, depth: f64) -> f64 {
        if self.is_parallel { self.pixel_size(height) } else { self.pixel_size(height) * depth }
    }

    /// The rays of a picture for a device, in units of `unit` world units. The ray through the centre of the picture
    /// starts at `start`, in the units of the rays, and at the depth `start_depth`, world units.
    pub(crate) fn rays(
        &self,
        unit: f64,
        options: &RaymarchOptions,
        light_count: usize,
        start: DVec3,
        start_depth: f64,
    ) -> PictureRays {
        let [width, height] = options.size;
        let to_f32 = |v: DVec3| v.as_vec3().to_array();
        // The offset of a pixel applies to the directions of the rays or, if they are parallel, to their starts.
        let (to_start, to_direction) = if self.is_parallel { (unit.recip(), 0.0) } else { (start_depth / unit, 1.0) };
        PictureRays {
            start: start.as_vec3().to_array(),
            width,
            start_right: to_f32(to_start * self.right),
            height,
            start_up: to_f32(to_start * self.up),
            first_row: 0,
            forward: to_f32(-self.back),
            pixel: self.pixel_size(height) as f32,
            right: to_f32(to_direction * self.right),
            light_count: light_count as u32,
            up: to_f32(to_direction * self.up),
            shadows: u32::from(options.shadows == Shadows::Hard),
        }
    }

    /// Coordinates to the right, upwards and along the rays, from world space relative to the eye. The axes of a pose
    /// need not be quite perpendicular, so the inverse is not the transpose.
    pub(crate) fn view_from_world(&self) -> DMat3 {
        DMat3::from_cols(self.right, self.up, -self.back).inverse()
    }

    /// Columns and rows of the pixels whose rays may meet a box. A margin of one pixel, and of 1e-6 of the
    /// outline of the box, covers the rounding of rays in float32.
    pub(crate) fn window(&self, [lower, upper]: [DVec3; 2], size: [u32; 2]) -> [Range<usize>; 2] {
        let [width, height] = size.map(|n| n as usize);
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let view_from_world = self.view_from_world();
        for corner in 0..8 {
            let p = DVec3::select(BVec3::new(corner & 1 > 0, corner & 2 > 0, corner & 4 > 0), upper, lower);
            let p = view_from_world * (p - self.eye);
            let pixel = self.pixel_size_at(size[1], p.z);
            if !(p.z > 0.0 && pixel > 0.0) {
                // The box extends behind the eye.
                return [0..width, 0..height];
            }
            let at = DVec2::new(p.x, -p.y) / pixel + 0.5 * UVec2::from_array(size).as_dvec2();
            (low, high) = (low.min(at), high.max(at));
        }
        let range = |low: f64, high: f64, count: usize| {
            let margin = 1.0 + 1e-6 * (high - low);
            let end = ((high + margin).ceil() as usize).min(count);
            ((low - margin).floor() as usize).min(end)..end
        };
        [range(low.x, high.x, width), range(low.y, high.y, height)]
    }

    /// Depth of the nearest corner of a box, or zero if the box extends behind the eye. The depth is reduced slightly,
    /// so that rounding does not place the start of a ray inside the box.
    pub fn depth_before(&self, [lower, upper]: [DVec3; 2]) -> f64 {
        let reach = 0.5 * (upper - lower).dot(self.back.abs());
        let nearest = (self.eye - 0.5 * (lower + upper)).dot(self.back) - reach;
        (nearest - 0.01 * (upper - lower).length()).max(0.0)
    }
}

fn entries() -> impl Iterator<Item = (usize, usize)> {
    (0..4).flat_map(|row| (0..4).map(move |column| (row, column)))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Pose of a camera at `eye` that looks at `target`, +Y up.
    pub(crate) fn look_at(eye: DVec3, target: DVec3) -> [[f64; 4]; 4] {
        let back = (eye - target).normalize();
        let right = DVec3::Y.cross(back).normalize();
        let up = back.cross(right);
        [
            [right.x, up.x, back.x, eye.x],
            [right.y, up.y, back.y, eye.y],
            [right.z, up.z, back.z, eye.z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    }

    const IDENTITY: [[f64; 4]; 4] =
        [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]];

    #[test]
    fn pixels_look_along_minus_z_with_row_0_on_top() {
        let camera = Camera::from_pose(&IDENTITY, 90.0).unwrap();
        let near = |a: DVec3, b: DVec3| (a - b).length() < 1e-12;
        assert!(near(camera.pixel_direction(0, 0, [1, 1]), DVec3::NEG_Z));
        // At 90 degrees the picture spans -1 to 1 vertically at depth 1; pixel centres are 1/4 from its edges.
        assert!(near(camera.pixel_direction(0, 0, [4, 4]), DVec3::new(-0.75, 0.75, -1.0)));
        assert!(near(camera.pixel_direction(7, 3, [8, 4]), DVec3::new(1.75, -0.75, -1.0)));
    }

    #[test]
    fn parallel_rays_start_at_their_pixels() {
        let camera = Camera::orthographic(&IDENTITY, 2.0).unwrap();
        let near = |a: DVec3, b: DVec3| (a - b).length() < 1e-12;
        assert!(near(camera.pixel_start(0, 0, [4, 4]), DVec3::new(-0.75, 0.75, 0.0)));
        assert!(near(camera.pixel_start(7, 3, [8, 4]), DVec3::new(1.75, -0.75, 0.0)));
        assert_eq!(camera.pixel_direction(7, 3, [8, 4]), DVec3::NEG_Z);
        assert_eq!((camera.pixel_size_at(4, 7.0), camera.pixel_size_at(4, 0.5)), (0.5, 0.5));
        for height in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(Camera::orthographic(&IDENTITY, height).unwrap_err().to_string().starts_with("height: "));
        }
    }

    #[test]
    fn a_window_holds_all_rays_that_meet_its_box() {
        let near = look_at(DVec3::new(3.0, 2.0, 4.0), DVec3::new(0.3, -0.2, 0.1));
        let mut skewed = look_at(DVec3::new(300.0, 200.0, 400.0), DVec3::ZERO);
        for row in &mut skewed[..3] {
            (row[0], row[1]) = (row[0] - 4e-4 * row[2], row[1] + 4e-4 * row[2]);
        }
        let size = [61, 47];
        let cameras = [
            Camera::from_pose(&near, 40.0),
            Camera::orthographic(&near, 5.0),
            Camera::from_pose(&skewed, 0.4),
            Camera::orthographic(&skewed, 5.0),
        ];
        for camera in cameras.map(Result::unwrap) {
            // The third box extends behind the near eye. The fourth lies beside the pictures.
            for (lower, sides) in [
                ([-0.5, -0.4, -0.3], [1.0, 0.7, 0.2]),
                ([0.9, -1.6, 0.0], [0.1, 0.1, 1.4]),
                ([-9.0; 3], [20.0; 3]),
                ([9.0, 0.0, -9.0], [1.0; 3]),
            ] {
                let lower = DVec3::from_array(lower);
                let upper = lower + DVec3::from_array(sides);
                let [columns, lines] = camera.window([lower, upper], size);
                let (mut inside, mut hit) = (0, 0);
                for (y, x) in (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (y, x))) {
                    let (start, way) = (camera.pixel_start(x, y, size), camera.pixel_direction(x, y, size));
                    let (a, b) = ((lower - start) / way, (upper - start) / way);
                    let is_hit = a.min(b).max_element().max(0.0) <= a.max(b).min_element();
                    let is_inside = columns.contains(&(x as usize)) && lines.contains(&(y as usize));
                    assert!(is_inside || !is_hit, "{x} {y}");
                    (inside, hit) = (inside + u32::from(is_inside), hit + u32::from(is_hit));
                }
                // A convex outline covers much of its rectangle, or the rectangle is small or the whole picture.
                assert!(inside <= 4 * hit + 100 || inside == size[0] * size[1], "{inside} pixels, {hit} hit");
            }
        }
    }

    #[test]
    fn a_scale_in_the_pose_is_dropped() {
        let mut pose = IDENTITY;
        for j in 0..3 {
            pose[j][j] = 1e-200;
        }
        assert_eq!(Camera::from_pose(&pose, 45.0), Camera::from_pose(&IDENTITY, 45.0));
    }

    #[test]
    fn bad_poses_and_angles_are_refused() {
        let with = |row: usize, column: usize, value: f64| {
            let mut pose = IDENTITY;
            pose[row][column] = value;
            Camera::from_pose(&pose, 45.0).unwrap_err().to_string()
        };
        assert!(with(1, 2, f64::NAN).contains("[1, 2] is NaN"));
        assert!(with(1, 1, 0.0).contains("column 1 is zero"));
        assert!(with(0, 1, 0.5).contains("perpendicular"));
        assert!(with(3, 0, 2.0).contains("last row"));
        for fov_deg in [0.0, 180.0, -10.0, f64::NAN, f64::INFINITY] {
            assert!(Camera::from_pose(&IDENTITY, fov_deg).unwrap_err().to_string().starts_with("fov_deg: "));
        }
    }
}
