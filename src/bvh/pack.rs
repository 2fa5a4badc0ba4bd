//! Eight triangles side by side, and the squared distance of a point to all of them.
//!
//! Each triangle has a frame of its own: `a` is a corner, `u` points along the longest edge, `n` is the unit normal,
//! and `v = n x u`. In this frame the triangle is flat with the corners (0, 0), (length, 0) and the apex. The squared
//! distance is the squared height over the plane plus the squared 2D distance: zero inside, else the smallest of three
//! clamped edges. The evaluation has no branch and no division.
//!
//! *Precision.* Frames are computed in float64 and rounded once. The frame of a sliver is therefore accurate to 6e-8,
//! and the distance of `p` to a few 1e-7 of |p - a|, even if it is much smaller than |p - a|.

use super::WIDTH;
use super::lanes::mask_within;
use crate::gpu::layout::Triangle;
use crate::simd::with_vectors;
use glam::{DVec2, DVec3, Vec3};

/// Ratio of height to length below which a triangle is a line segment. Corners are rounded to float32, and the height
/// to float64, so a smaller one consists of rounding.
const FLAT: f64 = 1e-12;

/// One triangle in its own frame.
#[derive(Debug, Clone, Copy, Default)]
#[repr(C)]
pub struct TriangleFrame {
    /// Origin and axes.
    a: [f32; 3],
    u: [f32; 3],
    v: [f32; 3],
    n: [f32; 3],
    /// Length of the edge along `u`, and of the edges from its two ends to the apex, with their unit directions.
    length: f32,
    left: [f32; 2],
    left_length: f32,
    right: [f32; 2],
    right_length: f32,
}

/// Distance of a point to a triangle, and the vector from the nearest point to it in the triangle's frame. The height
/// is the third component of both vectors.
struct Offset {
    squared: f32,
    along_u: f32,
    along_v: f32,
    height: f32,
    /// The point itself in the frame.
    x: f32,
    y: f32,
}

impl TriangleFrame {
    /// Without branches, so that a loop over triangles compiles to vector instructions.
    #[inline(always)]
    pub fn new([a, b, c]: [DVec3; 3]) -> Self {
        // The longest edge comes first, because its direction is the most accurate.
        let (ab, bc, ca) = (a.distance_squared(b), b.distance_squared(c), c.distance_squared(a));
        let (starts_at_c, starts_at_b) = ((ca > ab) & (ca > bc), bc > ab);
        let choice = |a, b, c| {
            if starts_at_c {
                c
            } else if starts_at_b {
                b
            } else {
                a
            }
        };
        let corner =
            |[a, b, c]: [DVec3; 3]| DVec3::new(choice(a.x, b.x, c.x), choice(a.y, b.y, c.y), choice(a.z, b.z, c.z));
        let (a, b, c) = (corner([a, b, c]), corner([b, c, a]), corner([c, a, b]));

        let select_unit = |v: DVec3, other: DVec3| {
            let scale = v.length_recip();
            let is_unit = (scale > 0.0) & (scale < f64::INFINITY);
            let select = |x: f64, other: f64| if is_unit { x * scale } else { other };
            DVec3::new(select(v.x, other.x), select(v.y, other.y), select(v.z, other.z))
        };
        // Any direction suits a triangle whose corners coincide in float32.
        let u = select_unit(b - a, DVec3::X);
        // Perpendicular to u. The cross product of a sliver may consist of rounding only; any plane through the edge is
        // then valid.
        let cross = u.cross(c - a);
        let across = cross - u * cross.dot(u);
        let n = select_unit(across, u.any_orthonormal_vector());
        let v = n.cross(u);
        let length = (b - a).length();
        let apex = DVec2::new((c - a).dot(u), (c - a).dot(v));
        let from_end = apex - DVec2::new(length, 0.0);
        // A triangle without height is the edge along u. Its other edges become points at the ends of that edge, and
        // the half-planes to their sides exclude each other: x <= 0 and x >= length > 0.
        let is_flat = (apex.y <= FLAT * length) | (length == 0.0);
        let edge = |v: DVec2| {
            let unit = v.normalize().as_vec2().to_array();
            if is_flat { ([0.0, -1.0], 0.0) } else { (unit, v.length() as f32) }
        };
        let ((left, left_length), (right, right_length)) = (edge(apex), edge(from_end));
        Self {
            a: a.as_vec3().to_array(),
            u: u.as_vec3().to_array(),
            v: v.as_vec3().to_array(),
            n: n.as_vec3().to_array(),
            length: (length as f32).max(f32::MIN_POSITIVE),
            left,
            left_length,
            right,
            right_length,
        }
    }

    /// Offset of a point from its nearest point.
    #[inline(always)]
    fn offset(&self, p: [f32; 3]) -> Offset {
        let d = [p[0] - self.a[0], p[1] - self.a[1], p[2] - self.a[2]];
        let dot = |axis: &[f32; 3]| d[0] * axis[0] + d[1] * axis[1] + d[2] * axis[2];
        let (x, y, height) = (dot(&self.u), dot(&self.v), dot(&self.n));

        // The edge along u.
        let base_x = x - clamp(x, self.length);
        let base = base_x * base_x + y * y;
        // The edge from the origin to the apex: position along it, and offset to its left.
        let [ex, ey] = self.left;
        let (along, beside) = (x * ex + y * ey, ex * y - ey * x);
        let past = along - clamp(along, self.left_length);
        let left = past * past + beside * beside;
        let (left_x, left_y) = (past * ex - beside * ey, past * ey + beside * ex);
        // The edge from the far end to the apex.
        let [ex, ey] = self.right;
        let end_x = x - self.length;
        let (along, aside) = (end_x * ex + y * ey, ex * y - ey * end_x);
        let past = along - clamp(along, self.right_length);
        let right = past * past + aside * aside;
        let (right_x, right_y) = (past * ex - aside * ey, past * ey + aside * ex);

        let inside = (y >= 0.0) & (beside <= 0.0) & (aside >= 0.0);
        let (edge, edge_x, edge_y) = if left < right { (left, left_x, left_y) } else { (right, right_x, right_y) };
        let (edge, edge_x, edge_y) = if base < edge { (base, base_x, y) } else { (edge, edge_x, edge_y) };
        let (flat, along_u, along_v) = if inside { (0.0, 0.0, 0.0) } else { (edge, edge_x, edge_y) };
        Offset { squared: height * height + flat, along_u, along_v, height, x, y }
    }

    /// Squared distance of one point.
    #[inline(always)]
    pub fn distance_squared(&self, p: Vec3) -> f32 {
        self.offset(p.to_array()).squared
    }

    /// Squared distances of several points.
    #[inline(always)]
    pub fn distances_squared<const N: usize>(&self, p: [[f32; N]; 3]) -> [f32; N] {
        let mut result = [0.0; N];
        for i in 0..N {
            result[i] = self.offset([p[0][i], p[1][i], p[2][i]]).squared;
        }
        result
    }
}

/// Up to eight triangles, one row of lanes per component of their frames. Empty lanes repeat the first triangle.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
pub struct Pack {
    frames: [[f32; WIDTH]; FRAME_FLOATS],
    faces: [u32; WIDTH],
    count: u32,
}

const FRAME_FLOATS: usize = size_of::<TriangleFrame>() / size_of::<f32>();

impl Pack {
    pub fn new(positions: &[Vec3], faces: &[[u32; 3]], members: &[u32]) -> Self {
        with_vectors!(
            (positions: &[Vec3] = positions, faces: &[[u32; 3]] = faces, members: &[u32] = members) -> Pack
            { Pack::new_portable(positions, faces, members) }
        )
    }

    #[inline(always)]
    fn new_portable(positions: &[Vec3], faces: &[[u32; 3]], members: &[u32]) -> Self {
        // Empty lanes repeat the first triangle.
        let faces_of_lanes: [u32; WIDTH] = std::array::from_fn(|lane| *members.get(lane).unwrap_or(&members[0]));
        // Coordinates by corner, axis and lane.
        let mut corners = [[[0.0; WIDTH]; 3]; 3];
        for (lane, &face) in faces_of_lanes.iter().enumerate() {
            for (corner, &vertex) in corners.iter_mut().zip(&faces[face as usize]) {
                let position = positions[vertex as usize];
                for axis in 0..3 {
                    corner[axis][lane] = position[axis];
                }
            }
        }
        let mut frames = [[0.0; WIDTH]; FRAME_FLOATS];
        for lane in 0..WIDTH {
            let corner = |i: usize| DVec3::from([0, 1, 2].map(|axis| f64::from(corners[i][axis][lane])));
            let floats = TriangleFrame::new([corner(0), corner(1), corner(2)]).floats();
            for row in 0..FRAME_FLOATS {
                frames[row][lane] = floats[row];
            }
        }
        Self { frames, faces: faces_of_lanes, count: members.len() as u32 }
    }

    /// The faces in this pack.
    pub fn faces(&self) -> &[u32] {
        &self.faces[..self.count as usize]
    }

    /// Face of a lane. An empty lane returns the first face.
    pub fn face(&self, lane: usize) -> u32 {
        self.faces[lane]
    }

    /// Bit i is set if lane i holds a triangle.
    pub fn mask(&self) -> u8 {
        u8::MAX >> (WIDTH as u32 - self.count)
    }

    /// The triangles whose value is at most `limit`, in order of their lanes.
    #[inline(always)]
    pub(crate) fn lanes_within(&self, values: &[f32; WIDTH], limit: f32) -> impl Iterator<Item = usize> + use<> {
        let mut mask = mask_within(values, limit) & u32::from(self.mask());
        std::iter::from_fn(move || {
            let lane = (mask != 0).then(|| mask.trailing_zeros() as usize % WIDTH)?;
            mask &= mask - 1;
            Some(lane)
        })
    }

    /// The triangle of a lane.
    #[inline(always)]
    pub fn frame(&self, lane: usize) -> TriangleFrame {
        let row = |i: usize| self.frames[i][lane];
        TriangleFrame {
            a: [row(0), row(1), row(2)],
            u: [row(3), row(4), row(5)],
            v: [row(6), row(7), row(8)],
            n: [row(9), row(10), row(11)],
            length: row(12),
            left: [row(13), row(14)],
            left_length: row(15),
            right: [row(16), row(17)],
            right_length: row(18),
        }
    }

    /// Squared distance of `p` to each triangle.
    #[inline(always)]
    pub fn distances_squared(&self, p: Vec3) -> [f32; WIDTH] {
        let mut result = [0.0; WIDTH];
        for i in 0..WIDTH {
            result[i] = self.frame(i).offset(p.to_array()).squared;
        }
        result
    }

    /// A linear function for each triangle that is nowhere larger than the distance to it: its value at `p` and its
    /// gradient. The gradient is the unit vector from the nearest point to `p`, or zero where the distance is zero.
    ///
    /// Rounding turns the gradient where two features of the triangle are almost equally near, and anywhere very close
    /// to it. The distance lies above a plane through the nearest point only for the exact gradient. The value is
    /// therefore taken from the plane through the corner that lies farthest along the gradient g, the support of the
    /// triangle: for each point t of it |q - t| >= g.(q - t) >= g.q - max over the corners of g.t.
    #[inline(always)]
    pub fn tangents(&self, p: Vec3) -> ([f32; WIDTH], [[f32; WIDTH]; 3]) {
        let mut value = [0.0; WIDTH];
        let mut gradient = [[0.0; WIDTH]; 3];
        for i in 0..WIDTH {
            let frame = self.frame(i);
            let Offset { squared, along_u, along_v, height, x, y } = frame.offset(p.to_array());
            let distance = squared.sqrt();
            let inverse = if distance > 0.0 { 1.0 / distance } else { 0.0 };
            let [gu, gv, gn] = [along_u * inverse, along_v * inverse, height * inverse];
            // The corners are the origin, the end of the edge along u, and the apex.
            let (end, apex) = (gu * frame.length, frame.left_length * (gu * frame.left[0] + gv * frame.left[1]));
            let support = if end > 0.0 { end } else { 0.0 };
            let support = if apex > support { apex } else { support };
            value[i] = gu * x + gv * y + gn * height - support;
            for axis in 0..3 {
                gradient[axis][i] = gu * frame.u[axis] + gv * frame.v[axis] + gn * frame.n[axis];
            }
        }
        (value, gradient)
    }
}

impl TriangleFrame {
    /// The layout that shaders read.
    pub(crate) fn for_device(&self, face: u32) -> Triangle {
        let Self { a, u, v, n, length, left, left_length, right, right_length } = *self;
        Triangle { a, face, u, length, v, left_length, n, right_length, left, right }
    }

    #[inline(always)]
    fn floats(&self) -> [f32; FRAME_FLOATS] {
        let Self { a, u, v, n, length, left, left_length, right, right_length } = *self;
        let mut floats = [0.0; FRAME_FLOATS];
        for (i, axis) in [a, u, v, n].into_iter().enumerate() {
            floats[3 * i..3 * i + 3].copy_from_slice(&axis);
        }
        floats[12..].copy_from_slice(&[length, left[0], left[1], left_length, right[0], right[1], right_length]);
        floats
    }
}

/// Clamps `x` to `0..=length`, in the form that compiles to one minimum and one maximum.
#[inline(always)]
fn clamp(x: f32, length: f32) -> f32 {
    let x = if x > 0.0 { x } else { 0.0 };
    if x < length { x } else { length }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::closest_point_on_triangle;
    use proptest::prelude::*;

    fn vector(range: std::ops::Range<f32>) -> impl Strategy<Value = Vec3> {
        (range.clone(), range.clone(), range).prop_map(|(x, y, z)| Vec3::new(x, y, z))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        /// Compared with float64 Voronoi regions, for triangles from compact to sliver.
        #[test]
        fn distances_match_float64(
            p in vector(-1.0..1.0), a in vector(-0.5..0.5), b in vector(-0.5..0.5), c in vector(-0.5..0.5), thin in 0.0..1.0f32
        ) {
            let thin = thin.powi(12).max(1e-6);
            let c = a + (b - a) * 0.3 + (c - a) * thin;
            let positions = [a, b, c];
            let corners = positions.map(Vec3::as_dvec3);
            let pack = Pack::new(&positions, &[[0, 1, 2]], &[0]);
            let exact = closest_point_on_triangle(p.as_dvec3(), corners).point.distance(p.as_dvec3());
            let found = f64::from(pack.distances_squared(p)[0].sqrt());
            // Each axis of the frame is rounded to 6e-8, |p - a| is below 4, and three terms add up.
            prop_assert!((found - exact).abs() < 1e-6, "{found} {exact}");
        }

        /// Corners on a line and coincident corners, seen from points on that line and beside it.
        #[test]
        fn triangles_without_area_are_segments(
            a in vector(-0.5..0.5), along in vector(-0.5..0.5), from in 0..4i8, to in 0..4i8, middle in 0..4i8,
            axis in 0..4usize, place in -6..6i8, aside in prop::sample::select(vec![0.0f32, 0.25])
        ) {
            // Multiples of a power of two are exact, so that corners on a line remain on it in float32.
            let round = |v: Vec3| (v * 64.0).round() / 64.0;
            let along = if axis < 3 { Vec3::AXES[axis] * 0.125 } else { round(along) };
            let at = |step: i8| round(a) + along * f32::from(step);
            let positions = [at(from), at(middle), at(to)];
            let corners = positions.map(Vec3::as_dvec3);
            let p = at(place) + Vec3::new(aside, aside, 0.0);
            let pack = Pack::new(&positions, &[[0, 1, 2]], &[0]);
            let exact = closest_point_on_triangle(p.as_dvec3(), corners).point.distance(p.as_dvec3());
            let found = f64::from(pack.distances_squared(p)[0].sqrt());
            prop_assert!((found - exact).abs() < 1e-6, "{found} {exact}");
        }

        /// Also where two features are almost equally near, and very close to a corner, where rounding turns the
        /// gradient: the point lies beside an end of an edge, in the plane through it, but for `near`.
        #[test]
        fn no_tangent_exceeds_a_distance(
            corners in [vector(-0.5..0.5), vector(-0.5..0.5), vector(-0.5..0.5)], away in vector(-0.5..0.5),
            near in vector(-1.0..1.0), reach in 0.0..1.0f32, exponents in (-9.0..0.0f32, -9.0..0.0f32), step in vector(-0.1..0.1)
        ) {
            let exact_corners = corners.map(Vec3::as_dvec3);
            prop_assume!(crate::geometry::triangle_cross(exact_corners).length() > 1e-6);
            let along = (corners[1] - corners[0]).normalize();
            let beside = reach * 10f32.powf(exponents.0) * (away - along * away.dot(along));
            let p = corners[0] + beside + near * 10f32.powf(exponents.1);
            let pack = Pack::new(&corners, &[[0, 1, 2]], &[0]);
            let (value, gradient) = pack.tangents(p);
            let g = Vec3::from_array([0, 1, 2].map(|axis| gradient[axis][0]));
            let q = p + step;
            let bound = f64::from(value[0]) + g.as_dvec3().dot(q.as_dvec3() - p.as_dvec3());
            let exact = closest_point_on_triangle(q.as_dvec3(), exact_corners).point.distance(q.as_dvec3());
            // The margin of the bake is four times as large.
            prop_assert!(bound <= exact + 1e-6, "{bound} {exact}");
        }
    }
}
