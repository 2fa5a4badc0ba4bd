//! Which instructions search the blocks: the fastest of this build and processor that are right.

use super::{SLACK, Scratch, TASK, Tile};
use crate::bake::{LocalGrid, Samples};
use crate::bvh::Bvh;
use crate::bvh::pack::TriangleFrame;
use glam::Vec3;
use std::sync::OnceLock;

/// How the samples of a tile are found.
///
/// Builds with rustc 1.95 are not all alike: LLVM's vectoriser of straight code made some in which the AVX2 path dropped
/// triangles, with the same source (with `-C no-vectorize-slp` all were right, and a fifth slower). So a path is tried on
/// a small soup before it is used: the bad builds were wrong on every soup of two triangles or more.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Path {
    #[cfg(target_arch = "x86_64")]
    Avx2,
    Portable,
    /// Every sample by its own search.
    Search,
}

impl Path {
    /// The fastest path of this build and processor that is right.
    pub fn trusted() -> Self {
        static TRUSTED: OnceLock<Path> = OnceLock::new();
        *TRUSTED.get_or_init(|| {
            let right =
                |path: &Self| is_right(|tile, low, high| tile.fill_by(*path, &mut Scratch::default(), low, high));
            Self::candidates().into_iter().find(right).unwrap_or(Self::Search)
        })
    }

    /// What this processor can run, fastest first.
    pub fn candidates() -> Vec<Self> {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") {
            return vec![Self::Avx2, Self::Portable];
        }
        vec![Self::Portable]
    }
}

/// Whether `fill` finds, to the bit, the distances to 48 triangles at 16^3 samples; about a millisecond.
pub(super) fn is_right(fill: impl FnOnce(&mut Tile<'_>, [usize; 3], [usize; 3])) -> bool {
    // Numbers that look random, from -0.5 to 0.5 (Knuth's multiplicative generator).
    let mut state = 1u32;
    let mut number = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 8) as f32 / (1 << 24) as f32 - 0.5
    };
    let mut positions = Vec::new();
    for _ in 0..48 {
        let center = Vec3::new(number(), number(), number());
        positions.extend([(); 3].map(|()| center + 0.3 * Vec3::new(number(), number(), number())));
    }
    let faces: Vec<[u32; 3]> = (0..48).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect();
    let bvh = Bvh::build(&positions, &faces);
    let frames: Vec<TriangleFrame> =
        faces.iter().map(|face| TriangleFrame::new(face.map(|corner| positions[corner as usize].as_dvec3()))).collect();

    let step = 1.2 / (TASK - 1) as f64;
    let grid = LocalGrid { axes: [Samples { first: -0.6, step, count: TASK }; 3] };
    let samples = [f32::INFINITY; TASK * TASK * TASK];
    let mut tile = Tile { bvh: &bvh, grid: &grid, slack: SLACK, limit: f32::INFINITY, low: [0; 3], samples };
    fill(&mut tile, [0; 3], [TASK; 3]);
    tile.samples.iter().enumerate().all(|(i, found)| {
        let p = grid.at([i % TASK, i / TASK % TASK, i / (TASK * TASK)]).as_vec3();
        let least = frames.iter().map(|frame| frame.distance_squared(p)).fold(f32::INFINITY, f32::min);
        least.sqrt().to_bits() == found.to_bits()
    })
}
