//! Walls and gaps between the samples of a grid, and joints on them.
//!
//! A wall without a sample inside is absent from the level set, and a gap without a sample outside is closed. Such thin
//! layers are searched along the edges of the grid, so that a report can name them.
//!
//! A joint is a place inside a solid where parts that touch have the value of the level. A sample on it would divide
//! the solid.

use crate::csg::parts::solid::Solid;
use crate::error::Error;
use crate::grid::Grid;
use crate::progress::Progress;
use glam::{DVec3, IVec3};

/// Cells along the side of a block. Smaller blocks evaluate fewer samples far from the surface, but share more samples
/// on their faces.
pub(super) const SIDE: usize = 8;

/// Largest difference of a sample on a joint from the level, voxels.
const ON_JOINT: f64 = 1.0 / 8192.0;

/// Distance of the points on both sides of a joint from the sample on it, voxels.
const BESIDE_JOINT: f64 = 1.0 / 8.0;

/// Largest difference of a sample on a joint from the level, world units.
pub(super) fn joint_depth(grid: &Grid) -> f32 {
    (ON_JOINT * grid.spacing().min_element()) as f32
}

/// The two sides of a surface. A layer inside is a wall, a layer outside is a gap.
#[derive(Clone, Copy)]
pub(super) enum Side {
    Inside,
    Outside,
}

impl Side {
    /// The factor of a difference from the level that makes it negative on this side.
    fn sign(self) -> f32 {
        match self {
            Self::Inside => 1.0,
            Self::Outside => -1.0,
        }
    }
}

/// The edges of a block that may cross a thin layer on one side of the surface, a wall or a gap, without a sample in
/// it. Both ends, and all samples within a voxel of them, are on the other side. Beyond both ends the distance from the
/// level increases along the axis. Each edge has the place, in voxels from the first sample, where a field with equal
/// slopes on both sides is nearest to the layer.
pub(super) fn edges_across(
    side: Side,
    samples: &[f32],
    level: f32,
    lipschitz: f64,
    spacing: DVec3,
) -> Vec<(DVec3, usize)> {
    let n = SIDE as i32 + 1;
    let signed = |value: f32| side.sign() * (value - level);
    let value = |index: IVec3| signed(samples[(index.x + n * (index.y + n * index.z)) as usize]);
    let is_beyond = |index: IVec3| {
        let [low, high] = [(index - 1).max(IVec3::ZERO), (index + 1).min(IVec3::splat(n - 1))];
        let mut rows = (low.z..=high.z).flat_map(|z| (low.y..=high.y).map(move |y| (y, z)));
        rows.all(|(y, z)| (low.x..=high.x).all(|x| value(IVec3::new(x, y, z)) >= 0.0))
    };
    let most = (spacing * lipschitz).as_vec3();
    let near = 0.0..most.max_element();
    let mut found = Vec::new();
    for (i, _) in samples.iter().enumerate().filter(|(_, value)| near.contains(&signed(**value))) {
        let i = i as i32;
        let start = IVec3::new(i % n, i / n % n, i / (n * n));
        // The last samples along each axis are the first ones of the next block.
        if start.max_element() == n - 1 {
            continue;
        }
        for axis in 0..3 {
            let (step, a) = (IVec3::AXES[axis], value(start));
            let (end, b) = (start + step, value(start + step));
            // Each block has one sample of its neighbours, so the outer neighbours of some edges are not known.
            let rises = |from: f32, outer: IVec3| outer[axis] < 0 || outer[axis] == n || value(outer) > from;
            let is_least = b >= 0.0 && a + b < most[axis] && rises(a, start - step) && rises(b, end + step);
            if is_least && is_beyond(start) && is_beyond(end) {
                let share = f64::from(a) / f64::from(a + b).max(f64::MIN_POSITIVE);
                found.push((start.as_dvec3() + share * step.as_dvec3(), axis));
            }
        }
    }
    found
}

/// Number of edges along the axis with the most of them whose place is in a layer on their side. A layer is deeper than
/// a joint.
pub(super) fn count_missed(
    solid: &Solid,
    grid: &Grid,
    level: f32,
    crossed: &[(DVec3, usize, Side)],
    progress: &Progress,
) -> Result<usize, Error> {
    let places: Vec<DVec3> = crossed.iter().map(|&(place, ..)| place).collect();
    let depth = joint_depth(grid);
    let mut counts = [0; 3];
    for (&(_, axis, side), value) in crossed.iter().zip(solid.distances(&places, progress)?) {
        counts[axis] += usize::from(side.sign() * (value - level) < -depth);
    }
    Ok(counts.into_iter().max().unwrap_or(0))
}

/// Samples of a block at the level, and the axis along which no neighbour in the block is outside.
pub(super) fn suspected_joints(samples: &[f32], level: f32, tolerance: f32) -> Vec<(DVec3, usize)> {
    let n = SIDE as i32 + 1;
    let mut found = Vec::new();
    for (i, _) in samples.iter().enumerate().filter(|(_, value)| (**value - level).abs() <= tolerance) {
        let i = i as i32;
        let index = IVec3::new(i % n, i / n % n, i / (n * n));
        for (axis, step) in [1, n, n * n].into_iter().enumerate() {
            let is_inside = |at: i32| samples[at as usize] < level - tolerance;
            let before = index[axis] == 0 || is_inside(i - step);
            let after = index[axis] == n - 1 || is_inside(i + step);
            if before && after {
                found.push((index.as_dvec3(), axis));
            }
        }
    }
    found
}

/// The axes along which both sides of a suspected sample are inside.
pub(super) fn axes_across_joints(
    solid: &Solid,
    grid: &Grid,
    level: f32,
    suspects: &[(DVec3, usize)],
    progress: &Progress,
) -> Result<[bool; 3], Error> {
    let sides = suspects.iter().flat_map(|&(place, axis)| {
        let step = BESIDE_JOINT * grid.spacing()[axis] * DVec3::AXES[axis];
        [place - step, place + step]
    });
    let values = solid.distances(&sides.collect::<Vec<_>>(), progress)?;
    let inside = level - joint_depth(grid);
    let mut across = [false; 3];
    for (&(_, axis), sides) in suspects.iter().zip(values.as_chunks::<2>().0) {
        across[axis] |= sides.iter().all(|&value| value < inside);
    }
    Ok(across)
}
