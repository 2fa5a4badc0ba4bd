//! The nearest triangles of eight points near each other, by one traversal.
//!
//! A triangle that is nearest to one of the points lies within a ball around their centre. The traversal visits the
//! triangles in this ball, and each is compared with the eight points side by side. Where several triangles are nearest
//! up to the rounding of float32, as beside an edge of the mesh, all of them are returned.

use crate::bvh::lanes::mask_within;
use crate::bvh::{Bvh, ROUNDING, WIDTH};
use crate::simd::with_vectors;
use glam::Vec3;

/// Largest number of triangles that are compared with all points. With more of them single searches cost less.
const MOST: usize = 48;

impl Bvh {
    /// Twice the rounding of a float32 distance at a point whose largest coordinate is `reach`: a face may be the
    /// nearest one if its distance exceeds the least distance by at most this.
    pub fn nearest_slack(reach: f64) -> f32 {
        (2.0 * ROUNDING * (1.0 + reach)) as f32
    }

    /// Appends the faces that may be the nearest of one of eight points, x, y and z in rows: the distance exceeds the
    /// least one by at most `slack`. Each has the set of those points, bit i for point i. These triangles must lie
    /// within `radius` of `center`. Returns false, and appends nothing, if no triangle, or more than [`MOST`], lie
    /// within `radius`.
    pub fn nearest_of_group(
        &self,
        center: Vec3,
        radius: f32,
        points: &[[f32; WIDTH]; 3],
        slack: f32,
        found: &mut Vec<(u32, u8)>,
    ) -> bool {
        with_vectors!((
            bvh: &Bvh = self,
            center: Vec3 = center,
            radius: f32 = radius,
            points: &[[f32; WIDTH]; 3] = points,
            slack: f32 = slack,
            found: &mut Vec<(u32, u8)> = found,
        ) -> bool {
            let limit = radius * radius;
            let mut best = [f32::INFINITY; WIDTH];
            let mut faces = [(0, [0.0; WIDTH]); MOST];
            let mut count = 0;
            let is_complete = bvh.visit_while(
                |node| mask_within(&node.distances_squared(center), limit),
                |pack| {
                    let near = pack.distances_squared(center);
                    for lane in (0..pack.faces().len()).filter(|&lane| near[lane] <= limit) {
                        if count == MOST {
                            return false;
                        }
                        let squared = pack.frame(lane).distances_squared(*points);
                        faces[count] = (pack.face(lane), squared);
                        count += 1;
                        for i in 0..WIDTH {
                            best[i] = if squared[i] < best[i] { squared[i] } else { best[i] };
                        }
                    }
                    true
                },
            );
            if !is_complete {
                return false;
            }
            let limits = best.map(|squared| (squared.sqrt() + slack) * (squared.sqrt() + slack));
            for (face, squared) in &faces[..count] {
                let mut nearest = 0;
                for i in 0..WIDTH {
                    nearest |= u8::from(squared[i] <= limits[i]) << i;
                }
                if nearest != 0 {
                    found.push((*face, nearest));
                }
            }
            count > 0
        })
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
            let slack = Bvh::nearest_slack(0.5);
            let radius = (distance + 4.0 * step) * 1.001 + slack;
            let mut found = Vec::new();
            if mesh.bvh().nearest_of_group(center, radius, &points, slack, &mut found) {
                for i in 0..WIDTH {
                    let p = Vec3::new(points[0][i], points[1][i], points[2][i]);
                    let least = mesh.bvh().nearest(p, f32::INFINITY).unwrap().distance_squared.sqrt();
                    let (mut expected, mut faces) = (Vec::new(), Vec::new());
                    mesh.bvh().faces_within(p, least + slack, |face| expected.push(face));
                    faces.extend(found.iter().filter(|(_, of)| of >> i & 1 == 1).map(|&(face, _)| face));
                    expected.sort_unstable();
                    faces.sort_unstable();
                    prop_assert_eq!(faces, expected);
                }
            } else {
                prop_assert!(count > MOST);
            }
        }
    }
}
