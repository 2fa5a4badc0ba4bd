//! Oriented points as a surface: each point is a flat disk with an area and a normal.
//!
//! The *distance* is that to the union of the disks ([`distance`]). The *side* follows from the dipole sum `w(q) = sum
//! a n.(p - q) / (4 pi |p - q|^3)` over all points ([`winding`]), as Barill et al., *Fast winding numbers for soups and
//! clouds*, 2018. Points without areas get them from their neighbours ([`areas`]).
//!
//! Coordinates are local, as in a mesh: `local = (world - center) / scale`, with a power of two as scale that
//! brings the box of all disks to a size of at most 1.

mod areas;
mod distance;
mod neighbours;
mod orient;
mod sums;
mod winding;

pub use distance::NearestDisk;
pub use orient::{Oriented, orient};

use crate::bvh::{Bvh, WIDTH};
use crate::error::{Error, MeshError};
use crate::memory::require_rows;
use crate::mesh::derived::Derived;
use crate::progress::Progress;
use areas::Areas;
use glam::{DVec3, Vec3};
use std::f64::consts::PI;
use winding::CloudMoments;

/// Largest local coordinate of a query. The sum of three squared differences stays below 3e38.
const MAX_REACH: f64 = 1e18;
/// Memory of the tree, the disks and the moments while they are built, bytes for each point.
const BYTES_PER_POINT: usize = 300;
/// A cloud is inside out if its enclosed volume, as a share of the volume of a ball of equal area, is below this.
const INSIDE_OUT: f64 = -0.05;

/// The map from world units to local units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Frame {
    center: DVec3,
    scale: f64,
}

impl Frame {
    /// The frame of a box in world units.
    fn of_box(lower: DVec3, upper: DVec3) -> Self {
        let extent = (upper - lower).max_element();
        let scale = if extent > 0.0 { extent.log2().ceil().exp2() } else { 1.0 };
        Self { center: lower * 0.5 + upper * 0.5, scale }
    }

    pub(crate) fn of_points(points: &[[f64; 3]]) -> Self {
        let (lower, upper) = extent(points.iter().map(|&p| (DVec3::from_array(p), 0.0)));
        Self::of_box(lower, upper)
    }

    pub(crate) fn local(&self, world: [f64; 3]) -> DVec3 {
        (DVec3::from_array(world) - self.center) / self.scale
    }
}

/// The box of balls.
fn extent(balls: impl Iterator<Item = (DVec3, f64)>) -> (DVec3, DVec3) {
    balls.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lower, upper), (center, radius)| {
        (lower.min(center - radius), upper.max(center + radius))
    })
}

/// The disks of a pack, side by side. Lanes without a disk repeat the first position, with radius 0.
#[derive(Debug, Clone)]
#[repr(C, align(64))]
struct Disks {
    center: [[f64; WIDTH]; 3],
    /// Unit normal; zero for a point without one.
    normal: [[f64; WIDTH]; 3],
    radius: [f64; WIDTH],
}

impl Disks {
    #[inline(always)]
    fn center(&self, lane: usize) -> DVec3 {
        DVec3::new(self.center[0][lane], self.center[1][lane], self.center[2][lane])
    }

    #[inline(always)]
    fn normal(&self, lane: usize) -> DVec3 {
        DVec3::new(self.normal[0][lane], self.normal[1][lane], self.normal[2][lane])
    }
}

/// Points with normals and areas, and the tree over their disks.
#[derive(Debug)]
pub struct PointCloud {
    frame: Frame,
    bvh: Bvh,
    /// The disks of each pack of the tree.
    disks: Vec<Disks>,
    /// Moments of each node; empty without normals.
    moments: Vec<CloudMoments>,
    /// Areas of the points, and how they were found.
    pub areas: Areas,
    /// Whether the normals point to the inside of the enclosed volume.
    pub inside_out: bool,
    /// Distance between neighbouring points in world units: the median of the square roots of their areas.
    pub spacing: f64,
    /// The distance below which 95 % of the points have their neighbours, in the same sense.
    pub spacing_95: f64,
}

impl PointCloud {
    /// `normals` are unit vectors, and `areas` are in world units. Without areas the neighbours give them. All numbers
    /// are finite.
    pub fn new(
        points: &[[f64; 3]],
        normals: Option<&[[f64; 3]]>,
        areas: Option<&[f64]>,
        progress: &Progress,
    ) -> Result<Self, Error> {
        if points.is_empty() {
            return Err(MeshError::NoPoints.into());
        }
        require_rows::<[u8; BYTES_PER_POINT]>("points in a search tree", points.len())?;
        let areas = match areas {
            Some(areas) => Areas::given(points, areas),
            None => Areas::of_neighbours(points, progress)?,
        };
        // Without normals a disk is a point.
        let radius = |row: usize| normals.map_or(0.0, |_| (areas.values[row] / PI).sqrt());
        let (lower, upper) = extent((0..points.len()).map(|row| (DVec3::from_array(points[row]), radius(row))));
        let frame = Frame::of_box(lower, upper);
        let normal = |row: usize| normals.map_or(DVec3::ZERO, |normals| DVec3::from_array(normals[row]));
        let bvh = tree_of((0..points.len()).map(|row| {
            let (n, radius) = (normal(row), radius(row) / frame.scale);
            let half = (DVec3::ONE - n * n).max(DVec3::ZERO).map(f64::sqrt) * radius;
            (frame.local(points[row]), half)
        }));
        progress.check()?;
        let disks = bvh.packs.iter().map(|pack| {
            let mut disks = Disks { center: [[0.0; WIDTH]; 3], normal: [[0.0; WIDTH]; 3], radius: [0.0; WIDTH] };
            for lane in 0..WIDTH {
                let row = pack.face(lane) as usize;
                let is_used = lane < pack.faces().len();
                let (center, n) = (frame.local(points[row]), if is_used { normal(row) } else { DVec3::ZERO });
                for axis in 0..3 {
                    disks.center[axis][lane] = center[axis];
                    disks.normal[axis][lane] = n[axis];
                }
                disks.radius[lane] = if is_used { radius(row) / frame.scale } else { 0.0 };
            }
            disks
        });
        let disks: Vec<Disks> = disks.collect();
        let moments = if normals.is_some() { winding::moments(&bvh, &disks, progress)? } else { Vec::new() };
        let (spacing, spacing_95) = areas.spacings(points, progress)?;
        let mut cloud = Self { frame, bvh, disks, moments, areas, inside_out: false, spacing, spacing_95 };
        cloud.inside_out = cloud.is_inside_out();
        Ok(cloud)
    }

    /// The enclosed volume about the centroid, compared with the volume of a ball of equal area.
    fn is_inside_out(&self) -> bool {
        let weighted = |disks: &Disks, lane: usize| (disks.center(lane), disks.radius[lane] * disks.radius[lane]);
        let all = || self.disks.iter().flat_map(|disks| (0..WIDTH).map(move |lane| (disks, lane)));
        let (mut sum, mut area) = (DVec3::ZERO, 0.0);
        for (center, weight) in all().map(|(disks, lane)| weighted(disks, lane)) {
            sum += center * weight;
            area += weight;
        }
        if area <= 0.0 {
            return false;
        }
        let centroid = sum / area;
        let volume: f64 = all()
            .map(|(disks, lane)| {
                let (center, weight) = weighted(disks, lane);
                weight * disks.normal(lane).dot(center - centroid) / 3.0
            })
            .sum();
        // Both without the factor pi of the areas.
        volume < INSIDE_OUT * area * (area * PI).sqrt() / (6.0 * PI.sqrt())
    }

    /// Whether the points have normals, and so a side.
    pub fn is_oriented(&self) -> bool {
        !self.moments.is_empty()
    }

    /// Local coordinates of a world position.
    pub fn local_from_world(&self, world: [f64; 3]) -> DVec3 {
        self.frame.local(world)
    }

    /// World position of local coordinates.
    pub fn world_from_local(&self, local: DVec3) -> DVec3 {
        self.frame.center + local * self.frame.scale
    }

    /// World units for each local unit.
    pub fn scale(&self) -> f64 {
        self.frame.scale
    }

    /// Whether float32 can square the distance from a world position to the cloud.
    pub fn can_reach(&self, world: [f64; 3]) -> bool {
        self.frame.local(world).abs().cmplt(DVec3::splat(MAX_REACH)).all()
    }

    /// Memory in use, bytes.
    pub fn bytes(&self) -> usize {
        self.bvh.bytes()
            + size_of_val(&self.disks[..])
            + size_of_val(&self.moments[..])
            + size_of_val(&self.areas.values[..])
    }
}

/// The tree over boxes, each a centre and half its sides.
fn tree_of(boxes: impl ExactSizeIterator<Item = (DVec3, DVec3)>) -> Bvh {
    let mut corners: Vec<Vec3> = Vec::with_capacity(2 * boxes.len());
    for (center, half) in boxes {
        corners.extend([(center - half).as_vec3(), (center + half).as_vec3()]);
    }
    let faces: Vec<[u32; 3]> = (0..corners.len() as u32 / 2).map(|i| [2 * i, 2 * i + 1, 2 * i + 1]).collect();
    Bvh::build(&corners, &faces)
}
