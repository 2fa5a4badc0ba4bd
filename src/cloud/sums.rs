//! Sums over all points with the smoothed kernel `1 / (|x|^2 + width^2)^(3/2)`, by the tree.
//!
//! A cluster whose radius is below half its distance counts as one point with the sum of its charges (Barnes, Hut, *A
//! hierarchical O(N log N) force-calculation algorithm*, 1986). Positions are float32, which suffices for the sides of
//! normals.

use super::neighbours::PointTree;
use crate::bvh::{Bvh, ChildRef, MAX_STACK, WIDTH};
use crate::error::Error;
use crate::progress::Progress;
use crate::simd::with_vectors;
use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// Largest ratio of the radius of a cluster to its distance.
const FAR_RATIO: f32 = 0.5;

/// A sum over points p with charges; x is the position, d = p - x, and k the kernel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Kind<const KIND: u8>;

/// Vectors m: `m.d k` in the first component.
pub(super) const POTENTIAL: Kind<0> = Kind;
/// Numbers s, the first component of a charge: `s d k`.
pub(super) const ATTRACTION: Kind<1> = Kind;
/// Vectors m: the gradient of the first sum by x.
pub(super) const GRADIENT: Kind<2> = Kind;

/// Eight sources side by side: the children of a node, or the points of a pack.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(32))]
struct Sources {
    at: [[f32; WIDTH]; 3],
    charge: [[f32; WIDTH]; 3],
    radius_squared: [f32; WIDTH],
}

impl Sources {
    const EMPTY: Self = Self { at: [[0.0; WIDTH]; 3], charge: [[0.0; WIDTH]; 3], radius_squared: [0.0; WIDTH] };

    fn charge_of(&self, lane: usize) -> Vec3 {
        Vec3::from_array([0, 1, 2].map(|axis| self.charge[axis][lane]))
    }

    fn set_charge(&mut self, lane: usize, charge: Vec3) {
        (0..3).for_each(|axis| self.charge[axis][lane] = charge[axis]);
    }

    /// Adds the lanes with a weight of 1 to the sums; the others have weight 0.
    #[inline(always)]
    fn add<const KIND: u8>(&self, p: Vec3, width_squared: f32, weight: &[f32; WIDTH], sums: &mut [[f32; WIDTH]; 3]) {
        let [px, py, pz] = p.to_array();
        let ([ax, ay, az], [cx, cy, cz]) = (&self.at, &self.charge);
        let [sx, sy, sz] = sums;
        for i in 0..WIDTH {
            let (x, y, z) = (ax[i] - px, ay[i] - py, az[i] - pz);
            let (mx, my, mz) = (cx[i] * weight[i], cy[i] * weight[i], cz[i] * weight[i]);
            let inverse = 1.0 / (x * x + y * y + z * z + width_squared);
            let kernel = inverse * inverse.sqrt();
            let along = mx * x + my * y + mz * z;
            let turned = 3.0 * along * inverse;
            match KIND {
                0 => sx[i] += along * kernel,
                1 => {
                    let share = mx * kernel;
                    (sx[i], sy[i], sz[i]) = (sx[i] + share * x, sy[i] + share * y, sz[i] + share * z);
                }
                _ => {
                    sx[i] += (turned * x - mx) * kernel;
                    sy[i] += (turned * y - my) * kernel;
                    sz[i] += (turned * z - mz) * kernel;
                }
            }
        }
    }
}

/// Points with charges in a tree.
#[derive(Debug)]
pub(super) struct ChargeTree<'a> {
    tree: &'a PointTree,
    nodes: Vec<Sources>,
    packs: Vec<Sources>,
}

impl<'a> ChargeTree<'a> {
    pub(super) fn new(tree: &'a PointTree) -> Self {
        let mut packs = vec![Sources::EMPTY; tree.bvh.packs.len()];
        for (sources, pack) in packs.iter_mut().zip(&tree.bvh.packs) {
            for (lane, &row) in pack.faces().iter().enumerate() {
                (0..3).for_each(|axis| sources.at[axis][lane] = tree.points[row as usize][axis] as f32);
            }
        }
        let mut nodes = vec![Sources::EMPTY; tree.bvh.nodes.len()];
        for (sources, node) in nodes.iter_mut().zip(&tree.bvh.nodes) {
            for lane in 0..WIDTH {
                let corner = |side: &[[f32; WIDTH]; 3]| Vec3::from_array([0, 1, 2].map(|axis| side[axis][lane]));
                let (low, high) = (corner(&node.min), corner(&node.max));
                let center = 0.5 * (low + high);
                if !node.children[lane].is_none() {
                    (0..3).for_each(|axis| sources.at[axis][lane] = center[axis]);
                    sources.radius_squared[lane] = center.distance_squared(high);
                }
            }
        }
        Self { tree, nodes, packs }
    }

    /// Sets the charges of the points, in the order of their rows.
    pub(super) fn load(&mut self, charges: &[Vec3]) {
        let bvh = &self.tree.bvh;
        for (sources, pack) in self.packs.iter_mut().zip(&bvh.packs) {
            for (lane, &row) in pack.faces().iter().enumerate() {
                sources.set_charge(lane, charges[row as usize]);
            }
        }
        // Children follow their parents in memory.
        for index in (0..bvh.nodes.len()).rev() {
            for (lane, &child) in bvh.nodes[index].children.iter().enumerate().filter(|(_, child)| !child.is_none()) {
                let sources = if child.is_pack() { &self.packs } else { &self.nodes };
                let sum = (0..WIDTH).map(|inner| sources[child.index()].charge_of(inner)).sum();
                self.nodes[index].set_charge(lane, sum);
            }
        }
    }

    /// A sum at every local position.
    pub(super) fn sums<const KIND: u8>(
        &self,
        kind: Kind<KIND>,
        points: &[DVec3],
        width: f64,
        progress: &Progress,
    ) -> Result<Vec<Vec3>, Error> {
        let square = (width * width) as f32;
        let sum = |p: &DVec3| progress.check().map(|()| self.sum(kind, p.as_vec3(), square));
        points.par_iter().with_min_len(64).map(sum).collect()
    }

    fn sum<const KIND: u8>(&self, kind: Kind<KIND>, p: Vec3, width_squared: f32) -> Vec3 {
        with_vectors!(
            [const KIND: u8]
            (tree: &ChargeTree<'_> = self, kind: Kind<KIND> = kind, p: Vec3 = p, width_squared: f32 = width_squared)
            -> Vec3 { tree.sum_portable(kind, p, width_squared) }
        )
    }

    #[inline(always)]
    fn sum_portable<const KIND: u8>(&self, _: Kind<KIND>, p: Vec3, width_squared: f32) -> Vec3 {
        let mut sums = [[0.0f32; WIDTH]; 3];
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Bvh::ROOT;
        let mut top = 1;
        while top > 0 {
            top -= 1;
            let child = stack[top];
            if child.is_pack() {
                self.packs[child.index()].add::<KIND>(p, width_squared, &[1.0; WIDTH], &mut sums);
                continue;
            }
            let sources = &self.nodes[child.index()];
            let mut weight = [0.0f32; WIDTH];
            for i in 0..WIDTH {
                let [x, y, z] = [sources.at[0][i] - p.x, sources.at[1][i] - p.y, sources.at[2][i] - p.z];
                let squared = x * x + y * y + z * z;
                let is_far = sources.radius_squared[i] < FAR_RATIO * FAR_RATIO * squared;
                weight[i] = if is_far { 1.0 } else { 0.0 };
            }
            sources.add::<KIND>(p, width_squared, &weight, &mut sums);
            for (lane, &inner) in self.tree.bvh.nodes[child.index()].children.iter().enumerate() {
                if weight[lane] == 0.0 && !inner.is_none() {
                    stack[top] = inner;
                    top += 1;
                }
            }
        }
        Vec3::from_array(sums.map(|sum| sum.iter().sum()))
    }
}
