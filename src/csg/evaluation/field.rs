//! Distances of the primitives at a point. The WGSL twins, function by function, are in
//! `shaders/shared/csg/csg_field.wgsl`.
//!
//! The formulas are the known ones (I. Quilez, "Distance functions", iquilezles.org) where they are exact. The pyramid
//! is a new formula: the nearer of a side and the base. `p` holds the parameters in the order of
//! [`Primitive::parameters`](crate::csg::tree::primitive::Primitive::parameters).
//!
//! The distance to an ellipsoid is computed as the Lagrange dual (D. Eberly, "Distance from a Point to an Ellipse, an
//! Ellipsoid, or a Hyperellipsoid", has the equation). With radii `r`, the nearest point to `y` is
//! `x = r^2 y / (r^2 + t)`, where `t` solves `sum (r y / (r^2 + t))^2 = 1`. The value `t (sum y^2 / (r^2 + t) - 1)` is
//! at most the squared distance for *every* `t` above `-min(r)^2`, and equal to it at the solution, so an iteration
//! that has not converged gives a lower bound. The inverse square root of the sum is concave in `t`, hence Newton's
//! method on it converges from below (J. More, D. Sorensen, "Computing a Trust Region Step", 1983). Counting `t` from
//! `-min(r)^2` avoids cancellation.

use super::flat_polygon::FlatPolygon;
pub(crate) use super::helicoid::thread;
use super::scalar::{Scalar, length2, length3};
use crate::csg::tree::primitive::PARAMETERS;
use crate::gpu::constants::csg_field::{ELLIPSOID_STEPS, ELLIPSOID_TINY};

type Parameters<F> = [F; PARAMETERS];

#[inline(always)]
pub(crate) fn sphere<F: Scalar>(at: [F; 3], p: &Parameters<F>) -> F {
    length3(at) - p[0]
}

#[inline(always)]
pub(crate) fn ellipsoid<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let (one, tiny) = (F::of(1.0), F::of(ELLIPSOID_TINY));
    let [rx, ry, rz, dx, dy, dz] = *p;
    let [x, y, z] = [x.abs(), y.abs(), z.abs()];
    let [cx, cy, cz] = [rx * x, ry * y, rz * z];
    // Newton's method starts below the root: one term of the sum is 1 here.
    let mut t = (cx - dx).most(cy - dy).most(cz - dz).most(tiny);
    for _ in 0..ELLIPSOID_STEPS {
        let [wx, wy, wz] = [one / (t + dx), one / (t + dy), one / (t + dz)];
        let [ax, ay, az] = [cx * wx, cy * wy, cz * wz];
        let [ax, ay, az] = [ax * ax, ay * ay, az * az];
        let sum = ax + ay + az;
        let slope = ax * wx + ay * wy + az * wz;
        t = (t + sum * (sum.sqrt() - one) / slope.most(tiny)).most(tiny);
    }
    let shortest = rx.least(ry).least(rz);
    let t_from_zero = t - shortest * shortest;
    let excess = x * (x / (t + dx)) + y * (y / (t + dy)) + z * (z / (t + dz)) - one;
    // `t_from_zero` and `excess` have the same sign, or the field is zero within rounding.
    let (zero, root) = (F::default(), t_from_zero.abs().sqrt());
    F::select_less(zero, t_from_zero, root * excess.most(zero).sqrt(), -(root * (-excess).most(zero).sqrt()))
}

/// A box with the given half sides.
#[inline(always)]
fn cuboid<F: Scalar>([x, y, z]: [F; 3], half: [F; 3]) -> F {
    let zero = F::default();
    let q = [x.abs() - half[0], y.abs() - half[1], z.abs() - half[2]];
    let outside = length3([q[0].most(zero), q[1].most(zero), q[2].most(zero)]);
    outside + q[0].most(q[1]).most(q[2]).least(zero)
}

#[inline(always)]
pub(crate) fn rounded_box<F: Scalar>(at: [F; 3], p: &Parameters<F>) -> F {
    cuboid(at, [p[0], p[1], p[2]]) - p[3]
}

/// Distance to the nearest of three bars, one along each axis; all others follow by symmetry.
#[inline(always)]
pub(crate) fn box_frame<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let bar = p[3];
    let [hx, hy, hz] = [p[0], p[1], p[2]];
    // Coordinates relative to the middle of a bar, along the two axes across it.
    let at = [x.abs() - (hx - bar), y.abs() - (hy - bar), z.abs() - (hz - bar)];
    let along_x = cuboid([x, at[1], at[2]], [hx, bar, bar]);
    let along_y = cuboid([at[0], y, at[2]], [bar, hy, bar]);
    let along_z = cuboid([at[0], at[1], z], [bar, bar, hz]);
    along_x.least(along_y).least(along_z)
}

#[inline(always)]
pub(crate) fn torus<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    length2(length2(x, y) - p[0], z) - p[1]
}

#[inline(always)]
pub(crate) fn capped_torus<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let [radius, tube, cos, sin] = [p[0], p[1], p[2], p[3]];
    let y = y.abs();
    let to_ring = length2(length2(x, y) - radius, z);
    let to_end = length3([x - radius * cos, y - radius * sin, z]);
    F::select_less(F::default(), y * cos - x * sin, to_end, to_ring) - tube
}

/// Distance to a prism: a 2D distance extruded along z.
#[inline(always)]
fn prism<F: Scalar>(flat: F, z: F, half_height: F) -> F {
    let zero = F::default();
    let above = z.abs() - half_height;
    flat.most(above).least(zero) + length2(flat.most(zero), above.most(zero))
}

#[inline(always)]
pub(crate) fn cylinder<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    prism(length2(x, y) - p[0], z, p[1])
}

/// The points within `p[2]` of a smaller cylinder.
#[inline(always)]
pub(crate) fn rounded_cylinder<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    prism(length2(x, y) - p[0], z, p[1]) - p[2]
}

#[inline(always)]
pub(crate) fn capsule<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    length3([x, y, z - z.between(-p[1], p[1])]) - p[0]
}

/// The smaller of the distances to the cap and to the side of a truncated cone.
#[inline(always)]
pub(crate) fn cone<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let zero = F::default();
    let [low, high, half_height, inverse_slant_squared] = [p[0], p[1], p[2], p[3]];
    let r = length2(x, y);
    let cap_radius = F::select_less(z, zero, low, high);
    let cap = [(r - cap_radius).most(zero), z.abs() - half_height];
    // Position along the side, 0 at the top and 1 at the bottom.
    let slant = [low - high, -(half_height + half_height)];
    let along = ((r - high) * slant[0] + (z - half_height) * slant[1]) * inverse_slant_squared;
    let along = along.between(zero, F::of(1.0));
    let side = [r - high - along * slant[0], z - half_height - along * slant[1]];
    let squared = (cap[0] * cap[0] + cap[1] * cap[1]).least(side[0] * side[0] + side[1] * side[1]);
    let distance = squared.sqrt();
    F::select_less(side[0].most(cap[1]), zero, -distance, distance)
}

/// The nearest of the lower ball, the upper ball and the side. The normals of the side through the two centres
/// separate these regions, so the distance is exact inside too.
#[inline(always)]
pub(crate) fn rounded_cone<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let [low, high, base, height, cos, sin] = *p;
    let (r, z) = (length2(x, y), z - base);
    let along = z * cos - r * sin;
    let [lower, upper, side] = [length2(r, z) - low, length2(r, z - height) - high, r * cos + z * sin - low];
    F::select_less(along, F::default(), lower, F::select_less(height * cos, along, upper, side))
}

#[inline(always)]
pub(crate) fn plane<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    x * p[0] + y * p[1] + z * p[2] - p[3]
}

#[inline(always)]
pub(crate) fn slab<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    (x * p[0] + y * p[1] + z * p[2]).abs() - p[3]
}

/// By symmetry the point has x >= y >= 0, and the nearest side is the one that faces +x.
#[inline(always)]
pub(crate) fn pyramid<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let zero = F::default();
    let [half, half_height, slant, sin, cos] = [p[0], p[1], p[2], p[3], p[4]];
    let (x, y) = (x.abs(), y.abs());
    let (x, y) = (F::select_less(x, y, y, x), F::select_less(x, y, x, y));
    let height = z + half_height;
    // Distance out of the side, and position up the side from the middle of its base edge.
    let out = (x - half) * cos + height * sin;
    let up = (half - x) * sin + height * cos;

    // Inside: the nearer of the planes. Outside: the nearer of the triangle and the square, whose points are clamped.
    let inside = out.most(-height);
    // The other edge of the triangle, from (half, 0) to (0, slant) in (y, up).
    let edge_squared = half * half + slant * slant;
    let beyond = ((y - half) * slant + up * half) / edge_squared;
    let if_beyond = |then: F, otherwise: F| F::select_less(zero, beyond, then, otherwise);
    let (on_y, on_up) = (if_beyond(y - beyond * slant, y), if_beyond(up - beyond * half, up));
    // The nearest point on the edge, between its ends; then the position above the base.
    let along = (on_up / slant).between(zero, F::of(1.0));
    let foot_y = if_beyond(half * (F::of(1.0) - along), on_y);
    let foot_up = if_beyond(slant * along, on_up.most(zero));
    let foot_y = foot_y.least(half);
    let to_side = [out, y - foot_y, up - foot_up];
    let to_base = [(x - half).most(zero), (y - half).most(zero), height];
    let outside = length3(to_side).least(length3(to_base));
    F::select_less(zero, inside, outside, inside)
}

#[inline(always)]
pub(crate) fn octahedron<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let zero = F::default();
    let three = F::of(3.0);
    let radius = p[0];
    let [x, y, z] = [x.abs(), y.abs(), z.abs()];
    let m = x + y + z - radius;
    // Where the projection onto the plane of the face has a negative coordinate, the nearest point lies on that edge.
    let pick = |[a, b, c]: [F; 3]| F::select_less(three * x, m, a, F::select_less(three * y, m, b, c));
    let [u, v, w] = [pick([x, y, z]), pick([y, z, x]), pick([z, x, y])];
    let k = (F::of(0.5) * (w - v + radius)).between(zero, radius);
    let (edge, face) = (length3([u, v - radius + k, w - k]), m * F::of(1.0 / 3f64.sqrt()));
    F::select_less(three * x.least(y).least(z), m, edge, face)
}

#[inline(always)]
pub(crate) fn hex_prism<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let zero = F::default();
    let apothem = p[0];
    // Mirrors the sides onto the one that faces +y.
    let (kx, ky) = (F::of(-(0.75f64.sqrt())), F::of(0.5));
    let (x, y) = (x.abs(), y.abs());
    let beyond = (kx * x + ky * y).least(zero);
    let (x, y) = (x - (beyond + beyond) * kx, y - (beyond + beyond) * ky);
    let half_side = apothem * F::of(1.0 / 3f64.sqrt());
    let along = x - x.between(-half_side, half_side);
    let across = y - apothem;
    let distance = length2(along, across);
    prism(F::select_less(across, zero, -distance, distance), z, p[1])
}

#[inline(always)]
pub(crate) fn gyroid<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let [x, y, z] = [x * p[0], y * p[0], z * p[0]];
    let value = x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos();
    value.abs() * p[1] - p[2]
}

#[inline(always)]
pub(crate) fn schwarz_p<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let value = (x * p[0]).cos() + (y * p[0]).cos() + (z * p[0]).cos();
    value.abs() * p[1] - p[2]
}

#[inline(always)]
pub(crate) fn diamond<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let [x, y, z] = [x * p[0], y * p[0], z * p[0]];
    let value = x.sin() * (y - z).cos() + x.cos() * (y + z).sin();
    value.abs() * p[1] - p[2]
}

#[inline(always)]
pub(crate) fn iwp<F: Scalar>([x, y, z]: [F; 3], p: &Parameters<F>) -> F {
    let [x, y, z] = [(x * p[0]).cos(), (y * p[0]).cos(), (z * p[0]).cos()];
    // cos 2x = 2 cos^2 x - 1.
    let value = x * y + y * z + z * x - x * x - y * y - z * z + F::of(1.5);
    (value + value).abs() * p[1] - p[2]
}

#[inline(always)]
pub(crate) fn circle<F: Scalar>(x: F, y: F, radius: F) -> F {
    length2(x, y) - radius
}

#[inline(always)]
pub(crate) fn rectangle<F: Scalar>(x: F, y: F, half: [F; 2]) -> F {
    let zero = F::default();
    let q = [x.abs() - half[0], y.abs() - half[1]];
    length2(q[0].most(zero), q[1].most(zero)) + q[0].most(q[1]).least(zero)
}

/// Distance to the nearest of the edges that are nearest to a point of the cell of the grid; see
/// [`crate::csg::tree::edge_grid`].
pub(crate) fn polygon<F: Scalar>(x: F, y: F, flat: &FlatPolygon<F>) -> F {
    let (zero, one) = (F::default(), F::of(1.0));
    let mut nearest = F::of(f64::from(f32::MAX));
    // The product with the outward normal of the nearest point, and the squared length of an edge; zero for a corner.
    let (mut side, mut length_squared) = (zero, zero);
    for &edge in flat.near(x, y) {
        let [ax, ay, bx, by, px, py, qx, qy] = flat.edges[edge as usize];
        let along = [bx - ax, by - ay];
        let to = [x - ax, y - ay];
        let squared = along[0] * along[0] + along[1] * along[1];
        let share = (to[0] * along[0] + to[1] * along[1]) / squared;
        // The start, a point between the ends, or the end: the way from it, its normal, and the length.
        let start = || [to[0], to[1], px, py, zero];
        let between = || [to[0] - share * along[0], to[1] - share * along[1], along[1], -along[0], squared];
        let end = || [x - bx, y - by, qx, qy, zero];
        let [away_x, away_y, normal_x, normal_y, length] =
            F::branch_less(zero, share, || F::branch_less(share, one, between, end), start);
        let distance = away_x * away_x + away_y * away_y;
        let nearer = || {
            let [from_x, from_y] = F::branch_less(zero, length, || to, || [away_x, away_y]);
            [distance, from_x * normal_x + from_y * normal_y, length]
        };
        [nearest, side, length_squared] = F::branch_less(distance, nearest, nearer, || [nearest, side, length_squared]);
    }
    let from_corner = || {
        let distance = nearest.sqrt();
        [F::select_less(side, zero, -distance, distance)]
    };
    let [distance] = F::branch_less(zero, length_squared, || [side / length_squared.sqrt()], from_corner);
    distance
}

/// An extrusion. With taper or chamfers it is the intersection of its bounded sides, a lower bound outside.
#[inline(always)]
pub(crate) fn extrude<F: Scalar>(flat: F, z: F, p: &Parameters<F>) -> F {
    let zero = F::default();
    let [half_height, sin, cos, low, high, inverse] = *p;
    if inverse <= zero {
        return prism(flat, z, half_height);
    }
    let from_wide = F::select_less(zero, sin, z + half_height, z - half_height);
    let side = flat * cos + from_wide * sin;
    let above = z.abs() - half_height;
    let chamfers = (side + high + z - half_height).most(side + low - z - half_height) * inverse;
    let solid = side.most(above);
    F::select_less(zero, low + high, solid.most(chamfers), solid)
}
