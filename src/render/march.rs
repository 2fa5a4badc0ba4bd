//! The first point on a ray where the stored field is not above zero.
//!
//! # Theory
//!
//! The ray walks in grid space (voxel centres at integers, see [`crate::volume`]) with a unit direction, so `t` counts
//! voxels. Each turn of the loop does two exact things and nothing else:
//!
//! 1. *The cell.* If a corner of the current cell is not above zero, solve the cubic that the trilinear field is along
//!    the ray ([`super::cubic`]) on the part of the ray in the cell. With all corners above zero there is no root: the
//!    field is their weighted mean.
//! 2. *The leap.* From the far side of the cell, move on by `f / rate`, with the field `f` there. Let `D_a` be the
//!    largest difference of two neighbours along axis `a` in the whole grid. A partial derivative of the trilinear
//!    field is a weighted mean of such differences, so along a direction `v` the field changes by at most
//!    `rate = sum of |v_a| D_a` a voxel, and nothing can be hit before the leap ends. For a true distance field on
//!    cubic voxels the rate is between 1 and sqrt(3) voxels a voxel. A leap shorter than a voxel is not worth the
//!    look-up: the walk then enters the next cell (Amanatides and Woo 1987).
//!
//! Both hold for *any* stored numbers (noise, other people's fields, a narrow band), and no epsilon decides a hit: a hit
//! is a root of the trilinear field, to the rounding of f32. Where the box is entered, or the ray starts in it, at a
//! value that is not above zero, the hit is right there.
//!
//! Along the ray the pieces `[t, t_end]` join without a gap, whatever rounding does to the cells: each ends where the
//! next begins, and a piece that begins at or below zero is a hit.
//!
//! # Practice
//!
//! [`Marcher::new`] reads the grid once (about 2 ms for 128^3); build it once a frame. The loop is bounded by the
//! number of cells that a ray can cross. Everything in it is f32 and will run the same in a shader.

use super::cubic::Cubic;
use crate::error::{ArgumentError, Error};
use crate::volume::{FieldView, trilinear};
use glam::{DVec3, IVec3, Vec3};
use rayon::prelude::*;

/// Leaps are shortened by this factor: the roundings of `f`, a sum of eight corners, stay below 1/4096 of it.
const LEAP_SAFETY: f32 = 1.0 - 1.0 / 4096.0;

/// Leaps shorter than this, in voxels, are left to the walk from cell to cell.
const SMALLEST_LEAP: f32 = 1.0;

/// An axis on which the direction is smaller than this counts as parallel: over 2^40 voxels the ray moves less than an
/// f32 can tell.
const PARALLEL: f32 = 1e-20;

/// Beyond every `t`; stands for infinity.
const FAR: f32 = 1e30;

/// Distances must lie within this, so that products of a few of them stay finite.
const LARGEST_DISTANCE: f32 = 1e30;

/// A ray in grid space that begins in the box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GridRay {
    pub origin: Vec3,
    /// Unit length, in voxels.
    pub direction: Vec3,
    /// Where the ray leaves the box.
    pub t_max: f32,
}

/// A ray clipped to the box, and how it got there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ClippedRay {
    pub ray: GridRay,
    /// Length of the part before the box, in multiples of the direction that was given.
    pub t_enter: f64,
    /// Axis of the face through which the ray enters; none if it starts inside.
    pub enter_axis: Option<usize>,
}

/// The part of a ray that lies in the box of `shape` voxels, in grid space; `None` where it misses.
///
/// In f64, because an eye may be far away from a small box.
pub fn clip_to_box(origin: DVec3, direction: DVec3, shape: DVec3) -> Option<ClippedRay> {
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
        t_max: ((t_leave - t_enter) * voxels_per_t) as f32,
    };
    Some(ClippedRay { ray, t_enter, enter_axis })
}

/// Where a ray met the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    pub t: f32,
    /// The cell that holds the root.
    pub cell: IVec3,
    /// The ray began at a value that was not above zero.
    pub at_start: bool,
}

/// What became of a ray.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct March {
    pub hit: Option<Hit>,
    /// Cells visited.
    pub steps: u32,
}

/// A field made ready for rays.
#[derive(Debug, Clone, Copy)]
pub struct Marcher<'a> {
    pub field: FieldView<'a>,
    /// `D_a` of the module's theory: the largest difference between neighbours along each axis.
    pub largest_difference: Vec3,
}

impl<'a> Marcher<'a> {
    /// Fails where a distance is not a finite number of reasonable size.
    pub fn new(field: FieldView<'a>) -> Result<Self, Error> {
        let [_, ny, nz] = field.grid().shape;
        let largest_difference = (0..nz)
            .into_par_iter()
            .map(|z| {
                let mut slice = Vec3::ZERO;
                for y in 0..ny {
                    slice = slice.max(row_differences(&field, y, z)?);
                }
                Ok::<Vec3, Error>(slice)
            })
            .try_reduce(|| Vec3::ZERO, |a, b| Ok(a.max(b)))?;
        Ok(Self { field, largest_difference })
    }

    /// Upper bound on the change of the field per voxel along a direction.
    #[inline]
    pub fn rate(&self, direction: Vec3) -> f32 {
        direction.abs().dot(self.largest_difference)
    }

    /// Walk along a ray to its first hit.
    pub fn march(&self, ray: &GridRay) -> March {
        let GridRay { origin, direction, t_max } = *ray;
        let [nx, ny, nz] = self.field.grid().shape.map(|n| n as i32);
        let first_cell = IVec3::NEG_ONE;
        let last_cell = IVec3::new(nx, ny, nz) - 1;
        let rate = self.rate(direction);
        // A unit in which the field changes by at most 1 a voxel keeps the cubic's products in range at any scale.
        let unit = 1.0 / rate.max(f32::MIN_POSITIVE);

        // Per axis: towards which face of a cell the ray moves, and how far apart in t the faces are.
        let is_parallel = direction.abs().cmplt(Vec3::splat(PARALLEL));
        let inverse = Vec3::select(is_parallel, Vec3::splat(FAR), 1.0 / direction);
        let forward = direction.cmpgt(Vec3::ZERO);
        let far_face = Vec3::select(forward, Vec3::ONE, Vec3::ZERO);
        let cell_step = IVec3::select(forward, IVec3::ONE, IVec3::NEG_ONE);

        let mut t = 0.0f32;
        let mut cell = origin.floor().as_ivec3().clamp(first_cell, last_cell);
        // Each turn moves at least one cell on, along an axis and never back; rounding may repeat a cell after a leap.
        let max_steps = 2 * (nx + ny + nz) as u32 + 8;
        for steps in 1..=max_steps {
            let corners = self.field.corners(cell);
            let cell_origin = cell.as_vec3();

            // Where the ray leaves the cell.
            let to_faces = (cell_origin + far_face - origin) * inverse;
            let to_faces = Vec3::select(is_parallel, Vec3::splat(FAR), to_faces);
            let to_next = to_faces.min_element();
            let t_end = to_next.max(t).min(t_max);

            // The cell: solve where the field can reach zero.
            if smallest(&corners) <= 0.0 {
                let p = origin + t * direction - cell_origin;
                let cubic = Cubic::along_ray(&corners, p, direction).scaled(unit);
                if let Some(s) = cubic.first_root(t_end - t) {
                    let at_start = t + s == 0.0 && cubic.c0 <= 0.0;
                    return March { hit: Some(Hit { t: t + s, cell, at_start }), steps };
                }
            }
            if t_end >= t_max {
                return March { hit: None, steps };
            }

            // The leap, or the next cell.
            let value = trilinear(&corners, origin + t_end * direction - cell_origin);
            let leap = value * unit * LEAP_SAFETY;
            if leap > SMALLEST_LEAP {
                t = t_end + leap;
                if t >= t_max {
                    return March { hit: None, steps };
                }
                cell = (origin + t * direction).floor().as_ivec3().clamp(first_cell, last_cell);
            } else {
                t = t_end;
                let step_axis = if to_faces.x == to_next {
                    IVec3::X
                } else if to_faces.y == to_next {
                    IVec3::Y
                } else {
                    IVec3::Z
                };
                cell = (cell + cell_step * step_axis).clamp(first_cell, last_cell);
            }
        }
        debug_assert!(false, "a ray took more than {max_steps} steps: {ray:?}");
        March { hit: None, steps: max_steps }
    }
}

#[inline]
fn smallest(corners: &[f32; 8]) -> f32 {
    let [c0, c1, c2, c3, c4, c5, c6, c7] = *corners;
    c0.min(c1).min(c2.min(c3)).min(c4.min(c5).min(c6.min(c7)))
}

/// Largest differences of a row to itself, to the next row and to the next slice; checks the row's values too.
fn row_differences(field: &FieldView<'_>, y: usize, z: usize) -> Result<Vec3, Error> {
    let grid = field.grid();
    let [nx, ny, nz] = grid.shape;
    let row = |y: usize, z: usize| &field.distances()[grid.offset(0, y, z)..][..nx];
    let here = row(y, z);
    if !here.iter().fold(true, |fine, d| fine & (d.abs() <= LARGEST_DISTANCE)) {
        let x = here.iter().position(|d| d.is_nan() || d.abs() > LARGEST_DISTANCE).unwrap_or(0);
        let problem =
            format!("[{x}, {y}, {z}] is {}; every distance must be finite, at most {LARGEST_DISTANCE:e}", here[x]);
        return Err(ArgumentError::new("distances", problem).into());
    }
    let largest = |other: &[f32]| here.iter().zip(other).fold(0.0f32, |largest, (a, b)| largest.max((a - b).abs()));
    Ok(Vec3::new(
        largest(&here[1..]),
        if y + 1 < ny { largest(row(y + 1, z)) } else { 0.0 },
        if z + 1 < nz { largest(row(y, z + 1)) } else { 0.0 },
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::grid::Grid;
    use proptest::prelude::*;

    fn unit_grid(shape: [usize; 3]) -> Grid {
        let upper = DVec3::new(shape[0] as f64, shape[1] as f64, shape[2] as f64);
        Grid::new(DVec3::ZERO, upper, shape).unwrap()
    }

    fn field_at(field: &FieldView<'_>, p_grid: Vec3) -> f32 {
        // The grid is in unit voxels with its corner at zero.
        field.sample_linear(p_grid.as_dvec3() + 0.5)
    }

    /// Roundings of a position in a box of up to 16 voxels, times slopes of up to 2 a voxel on each axis.
    const ROUNDING: f32 = 16.0 * 6.0 * 4.0 * f32::EPSILON;

    fn check_against_dense_samples(field: &FieldView<'_>, ray: &GridRay) {
        let marcher = Marcher::new(*field).unwrap();
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
        let marcher = Marcher::new(FieldView::new(grid, &distances).unwrap()).unwrap();
        assert_eq!(marcher.largest_difference, Vec3::X);
        let clipped = clip_to_box(DVec3::new(-100.0, 3.3, 3.7), DVec3::X, grid.upper).unwrap();
        let march = marcher.march(&clipped.ray);
        // Grid coordinate 40.25, from the face at -0.5.
        assert!((march.hit.unwrap().t - 40.75).abs() <= 64.0 * f32::EPSILON);
        // The leaps cover the empty part in a few steps.
        assert!(march.steps < 8, "{march:?}");
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
            let march = Marcher::new(FieldView::new(grid, &[value]).unwrap()).unwrap().march(&ray);
            assert_eq!(march.hit.map(|hit| (hit.t, hit.at_start)), hit.then_some((0.0, true)));
        }
    }

    #[test]
    fn values_that_are_not_finite_are_named() {
        let grid = unit_grid([2, 2, 1]);
        for bad in [f32::NAN, f32::INFINITY, -f32::INFINITY, 2e30] {
            let message = Marcher::new(FieldView::new(grid, &[1.0, 1.0, 1.0, bad]).unwrap()).unwrap_err().to_string();
            assert!(message.starts_with("distances: [1, 1, 0] is "), "{message}");
        }
    }

    #[test]
    fn tiny_and_huge_values_march_alike() {
        let grid = unit_grid([6, 6, 6]);
        let ray = clip_to_box(DVec3::new(-3.0, -2.1, 0.7), DVec3::new(1.0, 0.9, 0.31), grid.upper).unwrap().ray;
        let hit = |scale: f32| {
            let distances: Vec<f32> = (0..grid.len()).map(|i| scale * ((i * 7919 % 101) as f32 - 20.0)).collect();
            Marcher::new(FieldView::new(grid, &distances).unwrap()).unwrap().march(&ray).hit.unwrap().t
        };
        let expected = hit(1.0);
        for exponent in [-120, -60, 60, 90] {
            assert_eq!(hit(2.0f32.powi(exponent)), expected);
        }
    }
}
