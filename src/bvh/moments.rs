//! Moments of the children of a node: how the solid angle of their contents looks from far away.
//!
//! A set of surface elements acts as its area vector N at a centre, plus a first moment C about it. With x from a point
//! to the centre, the solid angle is `N.x / |x|^3 + (tr C - 3 x.C x / |x|^2) / |x|^3` and terms of higher order (Barill
//! et al., *Fast winding numbers for soups and clouds*, 2018). Only the symmetric part of C contributes: six values.

use super::WIDTH;
use glam::{DMat3, DVec3, Vec3};

/// Moments of some surface elements about their centre.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Cluster {
    pub(crate) weight: f64,
    pub(crate) center: DVec3,
    pub(crate) area: DVec3,
    pub(crate) first: DMat3,
}

impl Default for Cluster {
    /// No elements. The default of a matrix is the identity, which would hide the first moments in its rounding.
    fn default() -> Self {
        Self { weight: 0.0, center: DVec3::ZERO, area: DVec3::ZERO, first: DMat3::ZERO }
    }
}

impl Cluster {
    /// The cluster of several clusters.
    pub(crate) fn join(parts: &[Self]) -> Self {
        let weight: f64 = parts.iter().map(|part| part.weight).sum();
        let center = parts.iter().map(|part| part.center * part.weight).sum::<DVec3>() / weight;
        let mut joined = Self { weight, center, ..Self::default() };
        for part in parts {
            joined.area += part.area;
            joined.first += part.first + outer(part.center - center, part.area);
        }
        joined
    }

    /// The same elements with moments about another centre.
    pub(crate) fn about(&self, center: DVec3) -> Self {
        Self { center, first: self.first + outer(self.center - center, self.area), ..*self }
    }
}

/// The outer product d N^T, by columns.
fn outer(d: DVec3, area: DVec3) -> DMat3 {
    DMat3::from_cols(d * area.x, d * area.y, d * area.z)
}

/// Moments of the eight children of a node, side by side.
#[derive(Debug, Clone)]
#[repr(C, align(32))]
pub(crate) struct NodeMoments {
    center: [[f32; WIDTH]; 3],
    /// Squared radius of the child, or a multiple of it: the squared distance from which the child counts as far.
    pub(crate) far_squared: [f32; WIDTH],
    area: [[f32; WIDTH]; 3],
    /// Components xx, yy, zz, xy, yz, zx of the symmetric first moment; mixed terms are doubled.
    first: [[f32; WIDTH]; 6],
}

impl NodeMoments {
    pub(crate) const EMPTY: Self = Self {
        center: [[0.0; WIDTH]; 3],
        far_squared: [0.0; WIDTH],
        area: [[0.0; WIDTH]; 3],
        first: [[0.0; WIDTH]; 6],
    };

    pub(crate) fn set(&mut self, lane: usize, part: &Cluster, far: f32) {
        let c = &part.first;
        let symmetric = [
            c.x_axis.x,
            c.y_axis.y,
            c.z_axis.z,
            c.x_axis.y + c.y_axis.x,
            c.y_axis.z + c.z_axis.y,
            c.z_axis.x + c.x_axis.z,
        ];
        for axis in 0..3 {
            self.center[axis][lane] = part.center[axis] as f32;
            self.area[axis][lane] = part.area[axis] as f32;
        }
        for (row, value) in self.first.iter_mut().zip(symmetric) {
            row[lane] = value as f32;
        }
        self.far_squared[lane] = far.powi(2);
    }

    /// Approximate solid angle of each child, and the squared distance of its centre, as seen from `p + rest`. `rest`
    /// is the rounding of `p` to float32; it is added to the difference from a centre, which then has no error of
    /// cancellation.
    #[inline(always)]
    pub(crate) fn angles(&self, p: Vec3, rest: Vec3) -> ([f32; WIDTH], [f32; WIDTH]) {
        let mut angles = [0.0; WIDTH];
        let mut squares = [0.0; WIDTH];
        let ([px, py, pz], [rx, ry, rz]) = (p.to_array(), rest.to_array());
        // Rows in place of a closure for each lane, which the compiler would call lane by lane.
        let ([cx, cy, cz], [ax, ay, az]) = (&self.center, &self.area);
        let [cxx, cyy, czz, cxy, cyz, czx] = &self.first;
        for i in 0..WIDTH {
            let (x, y, z) = ((cx[i] - px) - rx, (cy[i] - py) - ry, (cz[i] - pz) - rz);
            let squared = x * x + y * y + z * z;
            let inverse = 1.0 / squared;
            let dipole = ax[i] * x + ay[i] * y + az[i] * z;
            let (xx, yy, zz, xy, yz, zx) = (cxx[i], cyy[i], czz[i], cxy[i], cyz[i], czx[i]);
            let along = xx * x * x + yy * y * y + zz * z * z + xy * x * y + yz * y * z + zx * z * x;
            angles[i] = (dipole + (xx + yy + zz) - 3.0 * along * inverse) * inverse * inverse.sqrt();
            squares[i] = squared;
        }
        (angles, squares)
    }
}
