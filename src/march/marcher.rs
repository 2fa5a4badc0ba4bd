//! The first point on a ray where the stored field is <= 0.
//!
//! # Theory
//!
//! The ray is traced in grid space (voxel centres at integers, see [`crate::volume`]) with a unit direction, so `t` is
//! in voxels. Each iteration of the loop advances the ray through
//!
//! - *a cube of empty blocks*, if it is far from every surface ([`super::empty`]), or else
//! - *one cell*. If a corner is <= 0, the cubic that the trilinear field is along the ray ([`super::cubic`]) is solved
//!   on the part of the ray in the cell. With all corners above zero there is no root.
//!
//! and into the next cell, by the traversal of Amanatides and Woo (1987). Both are exact for *any* stored values
//! (noise, fields of other programs, a narrow band, an open mesh). Steps by the field value would overshoot, because
//! the stored field is not a lower bound. No epsilon decides a hit: a hit is a root of the trilinear field, to the
//! rounding of f32. If the field is <= 0 where the ray enters the box or starts in it, that point is the hit.
//!
//! Consecutive pieces `[t, t_end]` of the ray join without a gap, even if rounding selects a wrong cell: each piece
//! starts where the previous one ends, and a piece that begins at a value <= 0 is a hit.
//!
//! # Practice
//!
//! [`Marcher::new`] reads the field once; build it once per picture. It accepts every field that is divided into blocks
//! of cells ([`super::blocks`]). The loop is bounded by the number of cells that a ray can cross, since a cell index
//! never moves back. All arithmetic is f32 or i32, as in the shader.

use super::blocks::{Block, Blocks};
use super::cubic::Cubic;
use super::empty::EmptySpace;
use crate::error::Error;
use crate::gpu::constants::{FAR_ALONG_RAY, PARALLEL_DIRECTION};
use crate::progress::Progress;
use glam::{DVec3, IVec3, Vec3};

/// A ray in grid space that begins inside the box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GridRay {
    pub origin: Vec3,
    /// Unit length; grid space, so lengths along the ray are in voxels.
    pub direction: Vec3,
    /// The `t` at which the search begins. The callers ensure that the ray meets no surface before it.
    pub t_min: f32,
    /// The `t` at which the search ends, at most where the ray leaves the box.
    pub t_max: f32,
}

/// A ray clipped to the box, and where it entered.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BoxClip {
    pub ray: GridRay,
    /// Distance from the given origin to the box, in multiples of the given direction.
    pub t_enter: f64,
    /// Axis of the face through which the ray enters; None if it starts inside.
    pub enter_axis: Option<usize>,
}

impl BoxClip {
    /// The part of the ray between two depths, multiples of the given direction; `None` if it is empty. The direction
    /// has a length of `voxels_per_depth` voxels.
    #[inline]
    pub(crate) fn between(&self, depths: [f64; 2], voxels_per_depth: f64) -> Option<GridRay> {
        let [near, far] = depths.map(|depth| ((depth - self.t_enter) * voxels_per_depth) as f32);
        let (t_min, t_max) = (near.max(0.0), far.min(self.ray.t_max));
        (t_min <= t_max).then_some(GridRay { t_min, t_max, ..self.ray })
    }
}

/// The part of a ray inside the box of `shape` voxels, in grid space; `None` if it misses.
///
/// The arithmetic is f64, because an eye may be far away from a small box.
pub(crate) fn clip_to_box(origin: DVec3, direction: DVec3, shape: DVec3) -> Option<BoxClip> {
    let (mut t_enter, mut t_leave) = (0.0, f64::INFINITY);
    let mut enter_axis = None;
    for axis in 0..3 {
        let (lower, upper) = (-0.5, shape[axis] - 0.5);
        if direction[axis] == 0.0 {
            if origin[axis] < lower || origin[axis] > upper {
                return None;
            }
            continue;
        }
        let to_lower = (lower - origin[axis]) / direction[axis];
        let to_upper = (upper - origin[axis]) / direction[axis];
        let (near, far) = if to_lower < to_upper { (to_lower, to_upper) } else { (to_upper, to_lower) };
        if near > t_enter {
            t_enter = near;
            enter_axis = Some(axis);
        }
        t_leave = t_leave.min(far);
    }
    let voxels_per_t = direction.length();
    if t_leave < t_enter || voxels_per_t == 0.0 {
        return None;
    }
    let ray = GridRay {
        origin: (origin + t_enter * direction).as_vec3(),
        direction: (direction / voxels_per_t).as_vec3(),
        t_min: 0.0,
        t_max: ((t_leave - t_enter) * voxels_per_t) as f32,
    };
    Some(BoxClip { ray, t_enter, enter_axis })
}

/// Intersection of a ray with the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct FieldHit {
    pub t: f32,
    /// Whether the field is <= 0 at the start of the ray.
    pub at_start: bool,
    /// Axis across the face of the voxel that the ray enters; None on a trilinear surface.
    pub face: Option<usize>,
}

/// Result of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct March {
    pub hit: Option<FieldHit>,
    /// Number of visited cells plus leaps.
    pub steps: u32,
}

/// A field prepared for rays.
#[derive(Debug, Clone)]
pub(crate) struct Marcher<F: Blocks> {
    pub field: F,
    signs: F::Signs,
    empty: EmptySpace,
}

impl<F: Blocks> Marcher<F> {
    /// Fails if a distance is not finite or too large.
    pub(crate) fn new(field: F, progress: &Progress) -> Result<Self, Error> {
        let signs = field.signs(progress)?;
        let empty = EmptySpace::new(field.block_counts(), &field.occupied(&signs), progress)?;
        Ok(Self { field, signs, empty })
    }

    /// The empty blocks of the field.
    pub(crate) fn empty(&self) -> &EmptySpace {
        &self.empty
    }

    /// A block that is not empty.
    #[inline]
    pub(crate) fn block(&self, index: [i32; 3]) -> F::Block<'_> {
        self.field.block(&self.signs, index)
    }

    /// Traces a ray to its first hit with the trilinear field.
    pub(crate) fn march(&self, ray: &GridRay) -> March {
        let shape = self.field.grid().shape;
        let shape = each_axis(|axis| shape[axis] as i32);
        let line = MarchLine::new(ray);
        let mut t = ray.t_min;
        let mut cell = each_axis(|axis| floor(line.origin[axis] + t * line.direction[axis]).clamp(-1, shape[axis] - 1));

        // Every iteration except the last advances by at least one cell, and never moves back along an axis.
        let max_steps = (shape[0] + shape[1] + shape[2] + 4) as u32;
        let mut steps = 0;
        while steps < max_steps {
            let index = each_axis(|axis| F::block_of(cell[axis]));
            let distance = self.empty.distance(index);

            // Leaps to the face of the empty cube around the block.
            if distance > 0 {
                steps += 1;
                let cells = (2 * distance - 1) * F::SIDE;
                let face = each_axis(|axis| F::first_cell(index[axis] - (distance - 1)) + cells * line.far[axis]);
                let (next, t_face) = first_axis(&each_axis(|axis| line.t_at(axis, face[axis])));
                t = if t_face > t { t_face } else { t };
                if t >= ray.t_max {
                    return March { hit: None, steps };
                }
                cell = each_axis(|axis| {
                    // The new cell is exact along the axis of the face, and never moves back along the others.
                    let here = floor(line.origin[axis] + t * line.direction[axis]);
                    let moved = if line.forward[axis] { here.max(cell[axis]) } else { here.min(cell[axis]) };
                    let entered = face[axis] + line.far[axis] - 1;
                    (if axis == next { entered } else { moved }).clamp(-1, shape[axis] - 1)
                });
                continue;
            }

            // Visits the cells up to the face of the block.
            let block = self.block(index);
            let (origin, shift) = (block.origin(), block.cell_shift());
            let mut local = each_axis(|axis| (cell[axis] - origin[axis]) >> shift);
            loop {
                steps += 1;
                let face = |axis: usize| origin[axis] + ((local[axis] + line.far[axis]) << shift);
                let (next, t_face) = first_axis(&each_axis(|axis| line.t_at(axis, face(axis))));
                let t_face = if t_face > t { t_face } else { t };
                let t_end = if t_face < ray.t_max { t_face } else { ray.t_max };
                if let Some(corners) = block.corners_around_root(local) {
                    let corner = each_axis(|axis| origin[axis] + (local[axis] << shift));
                    if let Some(hit) = hit_in_cell(&corners, ray, corner, shift, t, t_end) {
                        return March { hit: Some(hit), steps };
                    }
                }
                if t_end >= ray.t_max {
                    return March { hit: None, steps };
                }
                t = t_end;
                local = each_axis(|axis| local[axis] + if axis == next { 2 * line.far[axis] - 1 } else { 0 });
                if !(block.contains(0, local[0]) && block.contains(1, local[1]) && block.contains(2, local[2])) {
                    cell = each_axis(|axis| {
                        let low = origin[axis] + (local[axis] << shift);
                        let high = low + (1 << shift) - 1;
                        // A cell of several voxels is left at the position of the ray. Along the axis of the face the
                        // new cell is exact.
                        let here = if axis == next {
                            if line.forward[axis] { low } else { high }
                        } else if shift > 0 {
                            floor(line.origin[axis] + t * line.direction[axis]).clamp(low, high)
                        } else {
                            low
                        };
                        here.clamp(-1, shape[axis] - 1)
                    });
                    break;
                }
            }
        }
        debug_assert!(false, "a ray took more than {max_steps} steps: {ray:?}");
        March { hit: None, steps }
    }
}

/// The values of a function for x, y and z. `map` of an array is not inlined in long functions.
#[inline(always)]
pub(crate) fn each_axis<T>(value: impl Fn(usize) -> T) -> [T; 3] {
    [value(0), value(1), value(2)]
}

/// A ray and its constants.
pub(crate) struct MarchLine {
    pub(crate) origin: [f32; 3],
    pub(crate) direction: [f32; 3],
    /// `t` per voxel; 0 where the ray is parallel to the faces.
    inverse: [f32; 3],
    pub(crate) forward: [bool; 3],
    /// The side through which the ray leaves a cell: 0 lower, 1 upper.
    far: [i32; 3],
}

impl MarchLine {
    pub(crate) fn new(ray: &GridRay) -> Self {
        let direction = ray.direction.to_array();
        let inverse =
            each_axis(|axis| if direction[axis].abs() < PARALLEL_DIRECTION { 0.0 } else { 1.0 / direction[axis] });
        let forward = each_axis(|axis| direction[axis] > 0.0);
        Self { origin: ray.origin.to_array(), direction, inverse, forward, far: forward.map(i32::from) }
    }

    /// The `t` at which the ray crosses a face of a cell.
    #[inline]
    fn t_at(&self, axis: usize, face: i32) -> f32 {
        self.t_at_plane(axis, face as f32)
    }

    /// The `t` at which the ray crosses a plane across an axis.
    #[inline]
    pub(crate) fn t_at_plane(&self, axis: usize, coordinate: f32) -> f32 {
        if self.inverse[axis] == 0.0 { FAR_ALONG_RAY } else { (coordinate - self.origin[axis]) * self.inverse[axis] }
    }
}

/// The root of the field in one cell, on the interval `[t, t_end]` of the ray. The cell has its lower corner at `first`
/// and a side of `1 << shift` voxels.
#[inline]
fn hit_in_cell(corners: &[f32; 8], ray: &GridRay, first: [i32; 3], shift: u32, t: f32, t_end: f32) -> Option<FieldHit> {
    // Division by a power of two is exact.
    let per_voxel = 1.0 / (1 << shift) as f32;
    let p = (ray.origin + t * ray.direction - IVec3::from(first).as_vec3()) * per_voxel;
    let cubic = Cubic::along_ray(corners, p, ray.direction * per_voxel);
    // Scaling by the largest corner keeps products of coefficients in range.
    let s = cubic.scaled(1.0 / largest(corners)).first_root(t_end - t)?;
    Some(FieldHit { t: t + s, at_start: t + s == 0.0 && cubic.c0 <= 0.0, face: None })
}

/// The axis whose face comes first, and its `t`. Arrays in the loops of rays are read at constant indices only, so that
/// they stay in registers.
#[inline(always)]
pub(crate) fn first_axis(&[x, y, z]: &[f32; 3]) -> (usize, f32) {
    let first = if x <= y { (0, x) } else { (1, y) };
    if first.1 <= z { first } else { (2, z) }
}

/// Rounds a grid coordinate down. It is at least -1/2 in the box; after adding one, truncation rounds down.
#[inline]
pub(crate) fn floor(coordinate: f32) -> i32 {
    (coordinate + 1.0) as i32 - 1
}

/// Largest magnitude, at least the smallest normal float.
#[inline]
fn largest(corners: &[f32; 8]) -> f32 {
    corners.iter().fold(f32::MIN_POSITIVE, |largest, corner| largest.max(corner.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use crate::volume::{FieldView, Trilinear};
    use proptest::prelude::*;

    fn unit_grid(shape: [usize; 3]) -> Grid {
        let upper = DVec3::new(shape[0] as f64, shape[1] as f64, shape[2] as f64);
        Grid::new(DVec3::ZERO, upper, shape).unwrap()
    }

    fn marcher(grid: Grid, distances: &[f32]) -> Marcher<FieldView<'_>> {
        Marcher::new(FieldView::new(grid, distances).unwrap(), &Progress::new()).unwrap()
    }

    fn field_at(field: &FieldView<'_>, p_grid: Vec3) -> f32 {
        // The grid is in unit voxels with its corner at zero.
        field.sample_linear(p_grid.as_dvec3() + 0.5)
    }

    /// Roundings of a position in a box of up to 16 voxels, times slopes of up to 2 per voxel along each axis.
    const ROUNDING: f32 = 16.0 * 6.0 * 4.0 * f32::EPSILON;

    fn check_against_dense_samples(field: &FieldView<'_>, ray: &GridRay) {
        let marcher = Marcher::new(*field, &Progress::new()).unwrap();
        let march = marcher.march(ray);
        let t_last = march.hit.map_or(ray.t_max, |hit| hit.t);
        if let Some(hit) = march.hit {
            let value = field_at(field, ray.origin + hit.t * ray.direction);
            if hit.at_start {
                return assert!(hit.t == 0.0 && value <= ROUNDING);
            }
            assert!(value.abs() <= ROUNDING, "{value} at {hit:?}");
        }
        let samples = 200 * (1 + ray.t_max as usize);
        for i in 0..samples {
            let t = t_last * i as f32 / samples as f32;
            let value = field_at(field, ray.origin + t * ray.direction);
            assert!(value > -ROUNDING, "skipped {value} at t = {t}, found {march:?} on {ray:?}");
        }
    }

    proptest! {
        #[test]
        fn noise_is_never_skipped(
            shape in prop::array::uniform3(1..9usize),
            seed in prop::collection::vec(-1.0..1.0f32, 512),
            lift in 0.0..1.0f32,
            from in prop::array::uniform3(-20.0..20.0f64),
            to in prop::array::uniform3(0.0..1.0f64),
        ) {
            let grid = unit_grid(shape);
            let distances: Vec<f32> = seed[..grid.len()].iter().map(|d| d + lift).collect();
            let field = FieldView::new(grid, &distances).unwrap();
            let (from, to) = (DVec3::from(from), DVec3::from(to) * grid.upper - 0.5);
            if let Some(clipped) = clip_to_box(from, to - from, grid.upper) {
                check_against_dense_samples(&field, &clipped.ray);
            }
        }

        #[test]
        fn axis_parallel_rays_on_cell_faces_skip_nothing(
            seed in prop::collection::vec(-1.0..1.0f32, 125),
            lift in 0.0..1.0f32,
            axis in 0..3usize,
            forward in any::<bool>(),
            a in 0..11i32,
            b in 0..11i32,
        ) {
            let grid = unit_grid([5, 5, 5]);
            let distances: Vec<f32> = seed.iter().map(|d| d + lift).collect();
            let field = FieldView::new(grid, &distances).unwrap();
            // Half-integer steps: box faces, cell faces, voxel centres and cell middles.
            let mut origin = DVec3::splat(-3.0);
            origin[(axis + 1) % 3] = a as f64 / 2.0 - 0.5;
            origin[(axis + 2) % 3] = b as f64 / 2.0 - 0.5;
            let mut direction = DVec3::ZERO;
            direction[axis] = 1.0;
            if !forward {
                origin[axis] = 9.0;
                direction[axis] = -1.0;
            }
            let clipped = clip_to_box(origin, direction, grid.upper).unwrap();
            prop_assert_eq!(clipped.ray.t_max, 5.0);
            check_against_dense_samples(&field, &clipped.ray);
        }

        #[test]
        fn diagonal_rays_through_voxel_centres_skip_nothing(
            seed in prop::collection::vec(-1.0..1.0f32, 125),
            lift in 0.0..1.0f32,
            start in prop::array::uniform3(0..5i32),
            direction in prop::array::uniform3(-1..2i32),
        ) {
            prop_assume!(direction != [0, 0, 0]);
            let grid = unit_grid([5, 5, 5]);
            let distances: Vec<f32> = seed.iter().map(|d| d + lift).collect();
            let field = FieldView::new(grid, &distances).unwrap();
            let direction = IVec3::from(direction).as_dvec3();
            let origin = IVec3::from(start).as_dvec3() - 10.0 * direction;
            let clipped = clip_to_box(origin, direction, grid.upper).unwrap();
            check_against_dense_samples(&field, &clipped.ray);
        }
    }

    #[test]
    fn a_plane_is_hit_where_it_is() {
        let grid = unit_grid([64, 8, 8]);
        let distances: Vec<f32> = (0..grid.len()).map(|i| 40.25 - (i % 64) as f32).collect();
        let marcher = marcher(grid, &distances);
        let clipped = clip_to_box(DVec3::new(-100.0, 3.3, 3.7), DVec3::X, grid.upper).unwrap();
        let march = marcher.march(&clipped.ray);
        // Grid coordinate 40.25, from the face at -0.5.
        assert!((march.hit.unwrap().t - 40.75).abs() <= 64.0 * f32::EPSILON);
        // Each leap halves the rest of the empty part, down to a block.
        assert!(march.steps < 12, "{march:?}");
    }

    #[test]
    fn clipping_knows_the_entry_face_and_parallel_rays() {
        let shape = DVec3::new(4.0, 4.0, 4.0);
        let clipped = clip_to_box(DVec3::new(1.0, -2.5, 1.0), DVec3::new(0.0, 2.0, 0.0), shape).unwrap();
        assert_eq!((clipped.enter_axis, clipped.t_enter, clipped.ray.t_max), (Some(1), 1.0, 4.0));
        assert_eq!(clip_to_box(DVec3::new(9.0, -2.0, 1.0), DVec3::Y, shape), None);
        assert_eq!(clip_to_box(DVec3::new(1.0, 9.0, 1.0), DVec3::Y, shape), None);
        assert_eq!(clip_to_box(DVec3::ONE, DVec3::Y, shape).unwrap().enter_axis, None);
        assert_eq!(clip_to_box(DVec3::ONE, DVec3::ZERO, shape), None);
    }

    #[test]
    fn a_constant_field_is_hit_at_the_entry_or_not_at_all() {
        let grid = unit_grid([1, 1, 1]);
        let ray = clip_to_box(DVec3::new(-3.0, 0.1, 0.2), DVec3::X, grid.upper).unwrap().ray;
        for (value, hit) in [(1.0f32, false), (0.0, true), (-1.0, true)] {
            let march = marcher(grid, &[value]).march(&ray);
            assert_eq!(march.hit.map(|hit| (hit.t, hit.at_start)), hit.then_some((0.0, true)));
        }
    }

    #[test]
    fn tiny_and_huge_values_march_alike() {
        let grid = unit_grid([6, 6, 6]);
        let ray = clip_to_box(DVec3::new(-3.0, -2.1, 0.7), DVec3::new(1.0, 0.9, 0.31), grid.upper).unwrap().ray;
        let hit = |scale: f32| {
            let distances: Vec<f32> = (0..grid.len()).map(|i| scale * ((i * 7919 % 101) as f32 - 20.0)).collect();
            marcher(grid, &distances).march(&ray).hit.unwrap().t
        };
        let expected = hit(1.0);
        for exponent in [-120, -60, 60, 116] {
            assert_eq!(hit(2.0f32.powi(exponent)), expected);
        }
    }
}
