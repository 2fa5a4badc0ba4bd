//! The nearest triangles of eight points near each other, by one traversal.
//!
//! A triangle that is nearest to one of the points lies within a ball around their centre. The traversal visits the
//! triangles in this ball, and each is compared with the eight points side by side.

use super::{Bvh, ChildRef, MAX_STACK, WIDTH};
use crate::simd::with_vectors;
use glam::Vec3;

/// Largest number of triangles that are compared with all points. With more of them single searches cost less.
const MOST: usize = 48;

impl Bvh {
    /// The nearest face of each of eight points, x, y and z in rows, as [`Bvh::nearest`] finds it. Every nearest triangle
    /// must lie within `radius` of `center`. None if no triangle, or more than [`MOST`], lie within `radius`.
    pub fn nearest_of_group(&self, center: Vec3, radius: f32, points: &[[f32; WIDTH]; 3]) -> Option<[u32; WIDTH]> {
        with_vectors!((
            bvh: &Bvh = self, center: Vec3 = center, radius: f32 = radius, points: &[[f32; WIDTH]; 3] = points
        ) -> Option<[u32; WIDTH]> {
            bvh.nearest_of_group_portable(center, radius, points)
        })
    }

    #[inline(always)]
    fn nearest_of_group_portable(&self, center: Vec3, radius: f32, points: &[[f32; WIDTH]; 3]) -> Option<[u32; WIDTH]> {
        let limit = radius * radius;
        let (mut best, mut faces) = ([f32::INFINITY; WIDTH], [u32::MAX; WIDTH]);
        let mut stack = [ChildRef::NONE; MAX_STACK];
        stack[0] = Self::ROOT;
        let (mut top, mut count) = (1, 0);
        while top > 0 {
            top -= 1;
            let child = stack[top];
            if child.is_pack() {
                let pack = &self.packs[child.index()];
                let near = pack.distances_squared(center);
                for lane in (0..pack.faces().len()).filter(|&lane| near[lane] <= limit) {
                    count += 1;
                    if count > MOST {
                        return None;
                    }
                    let found = pack.frame(lane).distances_squared(*points);
                    let face = pack.face(lane);
                    for i in 0..WIDTH {
                        let is_nearer = found[i] < best[i] || (found[i] == best[i] && face < faces[i]);
                        best[i] = if is_nearer { found[i] } else { best[i] };
                        faces[i] = if is_nearer { face } else { faces[i] };
                    }
                }
                continue;
            }
            let node = &self.nodes[child.index()];
            let found = node.distances_squared(center);
            for lane in (0..WIDTH).filter(|&lane| found[lane] <= limit && !node.children[lane].is_none()) {
                stack[top] = node.children[lane];
                top += 1;
            }
        }
        (count > 0).then_some(faces)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::soup;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]
        #[test]
        fn a_group_finds_what_single_searches_find(
            count in 1usize..400, seed in any::<u64>(), x in -0.5..0.5f32, y in -0.5..0.5f32, z in -0.5..0.5f32
        ) {
            let mesh = soup(count, 0.1, seed);
            let (center, step) = (Vec3::new(x, y, z), 0.02);
            let offset = |i: usize| Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32) * step;
            let points = [0, 1, 2].map(|axis| std::array::from_fn(|i| center[axis] + offset(i)[axis]));
            let distance = mesh.bvh().nearest(center, f32::INFINITY).unwrap().distance_squared.sqrt();
            let radius = (distance + 4.0 * step) * 1.001;
            if let Some(faces) = mesh.bvh().nearest_of_group(center, radius, &points) {
                for (i, face) in faces.into_iter().enumerate() {
                    let p = Vec3::new(points[0][i], points[1][i], points[2][i]);
                    prop_assert_eq!(face, mesh.bvh().nearest(p, f32::INFINITY).unwrap().face);
                }
            } else {
                prop_assert!(count > MOST);
            }
        }
    }
}
