//! Distance fields of objects, for shadow, occlusion and scattering rays.
//!
//! A [`Field`] has a space of its own in which its rays are simple: grid space for a sampled volume (voxel centres at
//! whole numbers). Distances are in the object's own units. Any type that implements the trait can be an object of a
//! scene. [`SampledField`] implements it for the trilinear cells of a stored volume. The other files of this folder
//! implement it for sparse and nested volumes, shapes and quadrics.
//!
//! Outside its box a sampled field has bounds only. Let `b` be the nearest point of the box at distance `a`, and `s`
//! the distance there. The surface is at least `sqrt(a^2 + s^2)` away, because the box is convex: rays may step that
//! far. The point `q = b - s gradient` is the surface point nearest to `b`, so `|p - q|` is at least the true distance
//! from `p`. Penumbrae use this estimate; its error is of second order.

use super::device_fields::DeviceFields;
use super::slope::{divide, largest_slope};
use crate::error::{DeviceError, Error};
use crate::grid::Grid;
use crate::march::blocks::{BlockMask, Blocks, DenseBlock};
use crate::march::marcher::{GridRay, Marcher};
use crate::march::tiles::{GridCamera, Tiles};
use crate::progress::Progress;
use crate::volume::{Cell, FieldView, Trilinear, trilinear, trilinear_gradient};
use glam::{DAffine3, DMat3, DVec3, IVec3, Vec3};
use std::sync::OnceLock;

/// A ray in field space: `origin + t direction`, with `t` in the unit of the caller.
#[derive(Debug, Clone, Copy)]
pub struct FieldRay {
    pub origin: Vec3,
    pub direction: Vec3,
}

/// A hit of a ray with the surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FieldHit {
    pub t: f32,
    /// Whether the ray began inside, or entered the grid where it is inside.
    pub at_start: bool,
    /// Index of the part that was hit, for its appearance.
    pub part: u32,
}

/// Appearance of a surface at a hit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceAppearance {
    /// Unit normal in the object's own axes: outwards, or against the ray if there is no inside; zero if it is
    /// undefined.
    pub normal: Vec3,
    /// Linear RGB of the object itself; None if it has no colour.
    pub color: Option<[f32; 3]>,
}

/// A solid given by its distances.
pub trait Field: Send + Sync {
    /// Transform from the object's own coordinates to the coordinates of the field.
    fn field_from_local(&self) -> DAffine3;

    /// Lower and upper corner of the grid, field space.
    fn bounds(&self) -> [Vec3; 2];

    /// Lower and upper corner of a box that contains the surface, field space.
    fn surface_bounds(&self) -> [Vec3; 2];

    /// Size of the smallest detail in the object's units: the voxel.
    fn voxel(&self) -> f64;

    /// The first point with `t` in `[0, t_max]` that is inside, exact for the field's representation, and the number of
    /// steps. The ray must lie in `bounds`.
    fn first_hit(&self, ray: &FieldRay, t_max: f32) -> (Option<FieldHit>, u32);

    /// The distance at a point, in the object's units, negative inside. Outside the grid it is a lower bound.
    fn distance(&self, p: Vec3) -> f32;

    /// An estimate closer than [`Field::distance`] outside the grid, where it may exceed the true distance by a
    /// second-order error. `distance` is the value of [`Field::distance`] at `p`.
    fn distance_guess(&self, p: Vec3, distance: f32) -> f32;

    /// Gradient of the distance in the object's own axes, of about unit length; zero where it is undefined.
    fn gradient(&self, p: Vec3) -> Vec3;

    /// Appearance at the point `p`, which a ray of this direction hit.
    fn appearance(&self, p: Vec3, _hit: &FieldHit, _direction: Vec3) -> SurfaceAppearance {
        SurfaceAppearance { normal: self.gradient(p), color: None }
    }

    /// Fraction of the light that one crossing blocks, besides the instance's opacity.
    fn opacity(&self) -> f32 {
        1.0
    }

    /// Whether stored values are known to change no faster than a distance from each sample to its 26 neighbours. Most
    /// of the ball around a point with the radius of its value is then free; see [`crate::scene::light::cone`].
    fn is_lipschitz(&self) -> bool {
        false
    }

    /// Whether values may exceed the distance to the surface by more than a fraction of a voxel. Steps of such values
    /// may cross the surface.
    fn may_exceed_distance(&self) -> bool {
        false
    }

    /// Whether cones are estimated by thin rays ([`crate::scene::light::ray_bundle`]): for objects without depth, and
    /// for those whose distances cost more than rays.
    fn prefers_rays(&self) -> bool {
        false
    }

    /// Length of a ray's interval inside the object, in `t`, from a start on the surface to the next crossing, if there
    /// is a closed form. `enters`: the ray starts into the object. `None` if the length must be computed from
    /// distances.
    fn chord(&self, _ray: &FieldRay, _enters: bool) -> Option<f32> {
        None
    }

    /// Radius of a ball around the surface, field space. Its centre is the centre of the box `surface_bounds`.
    fn surface_radius(&self) -> f32 {
        let [lower, upper] = self.surface_bounds();
        0.5 * (upper - lower).length()
    }

    /// Appends its data to the tables of a device; false if devices do not support the kind.
    fn append_to(&self, _tables: &mut DeviceFields<'_>) -> Result<bool, DeviceError> {
        Ok(false)
    }

    /// The depths between which the surface lies on the rays of a picture, whose box covers about `pixels` pixels.
    /// `None` for a kind without blocks, or if the search for the depths takes longer than it saves.
    fn tiles(&self, _camera: &GridCamera, _pixels: usize, _progress: &Progress) -> Result<Option<Tiles>, Error> {
        Ok(None)
    }

    /// Whether a hit that a device found must be computed again by the ray of the pixel on the CPU: for objects with
    /// parts, or with more precision than float32.
    fn is_traced_again(&self) -> bool {
        false
    }
}

/// A stored field of trilinear cells, prepared for rays.
#[derive(Debug)]
pub(crate) struct SampledField<F: Blocks> {
    marcher: Marcher<F>,
    /// Corners of the box of the surface, grid space.
    surface: [Vec3; 2],
    spacing: Vec3,
    last_point: Vec3,
    /// Position of the last cell between samples: positions are clamped to it before they select a cell.
    last_cell: Vec3,
    is_lipschitz: OnceLock<bool>,
}

impl<F: Blocks> SampledField<F> {
    /// `inner` must contain the surface, world units of the grid. Fails if a distance is not finite or too large.
    pub(crate) fn new(field: F, inner: [DVec3; 2], progress: &Progress) -> Result<Self, Error> {
        let last_point = (field.shape() - 0.5).as_vec3();
        // The trilinear surface may deviate from the true one by less than a voxel.
        let lower = (field.grid_from_world(inner[0]).as_vec3() - 1.0).clamp(Vec3::splat(-0.5), last_point);
        let upper = (field.grid_from_world(inner[1]).as_vec3() + 1.0).clamp(Vec3::splat(-0.5), last_point);
        let spacing = field.grid().spacing().as_vec3();
        let last_cell = (last_point - 1.5).max(Vec3::ZERO);
        let marcher = Marcher::new(field, progress)?;
        let is_lipschitz = OnceLock::new();
        Ok(Self { marcher, surface: [lower, upper], spacing, last_point, last_cell, is_lipschitz })
    }

    pub(crate) fn marcher(&self) -> &Marcher<F> {
        &self.marcher
    }

    /// The corners of the cell at the nearest point of the box, the position in the cell from 0 to 1, and the side of
    /// the cell in voxels.
    ///
    /// The field is constant along an axis past the outermost samples, so the point moves to them: the cells there lie
    /// between samples.
    #[inline]
    fn cell_at(&self, p: Vec3) -> ([f32; 8], Vec3, f32) {
        let p = p.clamp(Vec3::ZERO, self.last_point - 0.5);
        // The position is not negative, so the conversion rounds down.
        let cell = self.marcher.field.cell(p.min(self.last_cell).as_ivec3());
        let size = cell.size as f32;
        (cell.corners, (p - cell.first.as_vec3()) / size, size)
    }

    /// The trilinear field at the nearest point of the box.
    #[inline]
    fn sample(&self, p: Vec3) -> f32 {
        let (corners, fraction, _) = self.cell_at(p);
        trilinear(&corners, fraction)
    }

    /// [`Self::sample`], and the unit direction of the gradient of its cell; zero where there is none.
    #[inline]
    fn sample_and_direction(&self, p: Vec3) -> (f32, Vec3) {
        let (corners, fraction, size) = self.cell_at(p);
        let slope = trilinear_gradient(&corners, fraction) / (size * self.spacing);
        (trilinear(&corners, fraction), unit(slope))
    }
}

/// The unit vector of a slope; zero if the slope is zero. Division by the largest component keeps squares in range.
#[inline]
fn unit(slope: Vec3) -> Vec3 {
    let largest = slope.abs().max_element();
    if largest == 0.0 { Vec3::ZERO } else { (slope / largest).normalize_or_zero() }
}

impl<F: Blocks + Send + Sync + OnDevice> Field for SampledField<F> {
    fn field_from_local(&self) -> DAffine3 {
        let grid = self.marcher.field.grid();
        let inverse = 1.0 / grid.spacing();
        DAffine3::from_mat3_translation(DMat3::from_diagonal(inverse), -grid.lower * inverse - 0.5)
    }

    fn bounds(&self) -> [Vec3; 2] {
        [Vec3::splat(-0.5), self.last_point]
    }

    fn surface_bounds(&self) -> [Vec3; 2] {
        self.surface
    }

    fn voxel(&self) -> f64 {
        self.marcher.field.grid().spacing().max_element()
    }

    fn first_hit(&self, ray: &FieldRay, t_max: f32) -> (Option<FieldHit>, u32) {
        let voxels_per_t = ray.direction.length();
        let direction = ray.direction / voxels_per_t;
        let grid_ray = GridRay { origin: ray.origin, direction, t_min: 0.0, t_max: t_max * voxels_per_t };
        let march = self.marcher.march(&grid_ray);
        let hit = march.hit.map(|hit| FieldHit { t: hit.t / voxels_per_t, at_start: hit.at_start, part: 0 });
        (hit, march.steps)
    }

    #[inline]
    fn distance(&self, p: Vec3) -> f32 {
        let b = p.clamp(Vec3::splat(-0.5), self.last_point);
        let a_squared = ((p - b) * self.spacing).length_squared();
        let s = self.sample(b);
        if a_squared == 0.0 { s } else { (a_squared + s.max(0.0) * s.max(0.0)).sqrt() }
    }

    #[inline]
    fn distance_guess(&self, p: Vec3, distance: f32) -> f32 {
        let b = p.clamp(Vec3::splat(-0.5), self.last_point);
        if p == b {
            return distance;
        }
        let (s, direction) = self.sample_and_direction(b);
        ((p - b) * self.spacing + s.max(0.0) * direction).length()
    }

    fn gradient(&self, p: Vec3) -> Vec3 {
        // Averaged over a voxel. The point is moved out of the outermost half voxel, where the field is constant along
        // an axis.
        let low = Vec3::splat(0.5).min(self.last_point - 1.0);
        let p = p.max(low).min((self.last_point - 1.0).max(low));
        let across = |half: Vec3| self.sample(p + half) - self.sample(p - half);
        let slope = Vec3::new(across(0.5 * Vec3::X), across(0.5 * Vec3::Y), across(0.5 * Vec3::Z)) / self.spacing;
        unit(slope)
    }

    fn is_lipschitz(&self) -> bool {
        *self.is_lipschitz.get_or_init(|| self.marcher.field.is_lipschitz())
    }

    fn may_exceed_distance(&self) -> bool {
        F::HAS_ANY_VALUES && !self.is_lipschitz()
    }

    fn append_to(&self, tables: &mut DeviceFields<'_>) -> Result<bool, DeviceError> {
        F::append_to(self, tables)?;
        Ok(true)
    }

    fn tiles(&self, camera: &GridCamera, pixels: usize, progress: &Progress) -> Result<Option<Tiles>, Error> {
        let blocks: usize = self.marcher.empty().shape().into_iter().product();
        (blocks <= BLOCKS_PER_PIXEL * pixels).then(|| Tiles::new(&self.marcher, camera, progress)).transpose()
    }
}

/// Largest number of blocks of a field for each pixel of its picture for which tiles are found: a tile saves a ray the
/// search through empty blocks.
const BLOCKS_PER_PIXEL: usize = 8;

/// Fields that devices support.
pub(crate) trait OnDevice: Blocks + Sized {
    /// Whether the values may be any numbers, not only distances and lower bounds of them.
    const HAS_ANY_VALUES: bool = false;

    /// See [`Field::is_lipschitz`]. Each call may read all values.
    fn is_lipschitz(&self) -> bool {
        false
    }

    /// Appends a field that is prepared for rays to the tables of a device.
    fn append_to(field: &SampledField<Self>, tables: &mut DeviceFields<'_>) -> Result<(), DeviceError>;
}

/// A grid of distances that owns its samples, x fastest.
#[derive(Debug)]
pub(crate) struct DenseField {
    grid: Grid,
    samples: Vec<f32>,
}

impl DenseField {
    pub(crate) fn new(grid: Grid, samples: Vec<f32>) -> Result<Self, Error> {
        FieldView::new(grid, &samples)?;
        Ok(Self { grid, samples })
    }

    pub(crate) fn samples(&self) -> &[f32] {
        &self.samples
    }

    /// Largest slope between neighbouring samples.
    pub(crate) fn slope(&self) -> f64 {
        largest_slope(&self.samples, self.grid.shape, self.grid.spacing())
    }

    /// The field with its samples divided by a number of at least 1.
    pub(crate) fn divided(mut self, divisor: f64) -> Self {
        divide(&mut self.samples, divisor);
        self
    }

    #[inline]
    fn view(&self) -> FieldView<'_> {
        FieldView::checked(self.grid, &self.samples)
    }
}

/// Largest difference of neighbouring samples of a distance, relative to their distance: 1 and the rounding of samples.
const LARGEST_SLOPE: f64 = 1.0 + 1.0 / 64.0;

/// Largest ratio of the sides of voxels for which differences along edges and diagonals bound the slope.
const MOST_OBLONG: f64 = 1.05;

impl OnDevice for DenseField {
    const HAS_ANY_VALUES: bool = true;

    fn is_lipschitz(&self) -> bool {
        let spacing = self.grid.spacing();
        spacing.max_element() <= MOST_OBLONG * spacing.min_element() && self.slope() <= LARGEST_SLOPE
    }

    fn append_to(field: &SampledField<Self>, tables: &mut DeviceFields<'_>) -> Result<(), DeviceError> {
        let marcher = field.marcher();
        tables.add_dense(marcher.field.grid(), marcher.field.samples(), marcher.empty())
    }
}

impl Trilinear for DenseField {
    fn grid(&self) -> &Grid {
        &self.grid
    }

    #[inline]
    fn cell(&self, index: IVec3) -> Cell {
        self.view().cell(index)
    }

    fn distance_bound(&self, p: DVec3, inner: [DVec3; 2]) -> f32 {
        self.view().distance_bound(p, inner)
    }
}

impl Blocks for DenseField {
    const SIDE: i32 = <FieldView<'static> as Blocks>::SIDE;
    type Block<'b> = DenseBlock<'b>;
    type Signs = Vec<BlockMask>;

    fn signs(&self, progress: &Progress) -> Result<Vec<BlockMask>, Error> {
        self.view().signs(progress)
    }

    fn occupied(&self, signs: &Vec<BlockMask>) -> Vec<bool> {
        self.view().occupied(signs)
    }

    #[inline]
    fn block<'b>(&'b self, signs: &'b Vec<BlockMask>, index: [i32; 3]) -> DenseBlock<'b> {
        DenseBlock::new(self.view(), signs, index)
    }
}
