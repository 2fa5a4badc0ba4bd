//! Exact winding numbers by counting the crossings of an axis-parallel ray, for surfaces without openings.
//!
//! *Theory.* The winding number of p in a closed surface is the sum over the triangles that a ray from p hits, each
//! counted +1 if the ray leaves through it and -1 if it enters. For a ray along an axis, the test for a hit is 2D, in
//! the projection along that axis, and is decided edge by edge. Let the two projected coordinates be the row and the
//! column. A directed edge (a, b) *crosses* the row of p if exactly one end lies at or below it, and then p lies to one
//! side of it. The triangle's 2D winding around p is the number of upward crossings to the right of p minus the
//! downward ones.
//! - The row comparison depends on a vertex alone, the side on an edge alone, and both are exact (Shewchuk, *Adaptive
//!   precision floating-point arithmetic*, 1997; crate `robust`). The two faces of an edge therefore always give
//!   opposite results: no ray passes between triangles or counts an edge twice, at edges and vertices too.
//! - Ties (the row at a vertex, p on an edge) are decided as for a point moved by (delta, epsilon), delta >> epsilon >
//!   0, in (column, row). This is an actual point, so all decisions are consistent.
//! - The sign of an exact 3D orientation tells whether the hit lies ahead of p. It can be zero only for p on the
//!   surface, where the distance is zero and has no sign.
//!
//! The triangles have the float64 positions of the input. The tree, whose boxes are float32, only selects them.
//!
//! On a grid, one row of columns shares all work for an edge: an edge splits the row at one column.

use crate::bvh::boxes::round_down;
use crate::bvh::{BOX_ROUNDING, Bvh, Node};
use crate::mesh::Mesh;
use crate::mesh::topology::Topology;
use glam::{DVec3, Vec3};
use robust::{Coord, Coord3D, orient2d, orient3d};

/// Direction of the rays and the two axes of the projection: a right-handed triple.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Axes {
    pub ray: usize,
    pub column: usize,
    pub row: usize,
}

impl Axes {
    pub(crate) const X: Self = Self { ray: 0, column: 1, row: 2 };
    pub(crate) const Y: Self = Self { ray: 1, column: 2, row: 0 };
    pub(crate) const Z: Self = Self { ray: 2, column: 0, row: 1 };
}

/// The closed surface for the rays: the oriented faces of the mesh and any extra triangles, local units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ClosedSurface<'a> {
    pub bvh: &'a Bvh,
    pub mesh: &'a Mesh,
    pub topology: &'a Topology,
    /// Triangles that close the openings of the mesh.
    pub caps: &'a [[DVec3; 3]],
}

impl<'a> ClosedSurface<'a> {
    /// A mesh with its openings closed by `caps`.
    pub(crate) fn new(mesh: &'a Mesh, caps: &'a [[DVec3; 3]]) -> Self {
        Self { bvh: mesh.bvh(), mesh, topology: mesh.topology(), caps }
    }

    /// Winding number of a local point by the ray in the positive direction of `axes.ray`.
    pub(crate) fn winding(&self, p: DVec3, axes: Axes) -> i32 {
        let mut winding = 0;
        let ray = RayBox::new(p, axes);
        self.for_each_candidate(&ray, |triangle| winding += crossing(p, triangle, axes));
        winding
    }

    /// Number of faces that the ray crosses, in any direction.
    pub(crate) fn crossings(&self, p: DVec3, axes: Axes) -> u32 {
        let mut count = 0;
        let ray = RayBox::new(p, axes);
        self.for_each_candidate(&ray, |triangle| count += crossing(p, triangle, axes).unsigned_abs());
        count
    }

    fn for_each_candidate(&self, rays: &RayBox, mut on_triangle: impl FnMut([DVec3; 3])) {
        self.bvh.visit(
            |node| rays.overlaps(node),
            |pack| {
                for &face in pack.faces() {
                    if let Some(corners) = self.topology.oriented_face(self.mesh, face)
                        && rays.overlaps_triangle(self.mesh, corners)
                    {
                        on_triangle(corners.map(|v| self.mesh.exact_position(v)));
                    }
                }
            },
        );
        self.caps.iter().copied().for_each(on_triangle);
    }
}

/// The points of a ray along an axis, or of a row of such rays, as a box for comparisons with the boxes of nodes.
///
/// A float32 bound of a node is at most a float64 coordinate if and only if it is at most that coordinate, rounded
/// down. The boxes contain float32 positions, so they are enlarged by the rounding of these. No child is missed.
pub(super) struct RayBox {
    low: Vec3,
    high: Vec3,
}

impl RayBox {
    /// The ray from `p` in the positive direction of `axes.ray`.
    pub(super) fn new(p: DVec3, axes: Axes) -> Self {
        let mut end = p;
        end[axes.ray] = f64::INFINITY;
        Self::between(p, end)
    }

    /// All points from `low` to `high`, which may be infinite.
    fn between(low: DVec3, high: DVec3) -> Self {
        Self { low: -round_down(BOX_ROUNDING - low), high: round_down(high + BOX_ROUNDING) }
    }

    /// Mask of the children that the rays can intersect.
    #[inline(always)]
    pub(super) fn overlaps(&self, node: &Node) -> u32 {
        node.overlaps(self.low, self.high)
    }

    /// Whether the rays can intersect the triangle of three vertices. Its float32 positions decide, which saves the
    /// float64 positions of most triangles.
    #[inline(always)]
    pub(super) fn overlaps_triangle(&self, mesh: &Mesh, corners: [u32; 3]) -> bool {
        let [a, b, c] = corners.map(|v| mesh.positions()[v as usize]);
        a.min(b).min(c).cmple(self.high).all() && a.max(b).max(c).cmpge(self.low).all()
    }
}

/// +1 if the ray from `p` leaves through the triangle, -1 if it enters, 0 if it misses.
pub(crate) fn crossing(p: DVec3, [a, b, c]: [DVec3; 3], axes: Axes) -> i32 {
    let turns = edge_turn(p, a, b, axes) + edge_turn(p, b, c, axes) + edge_turn(p, c, a, axes);
    if turns != 0 && is_ahead(p, [a, b, c], turns, axes) { turns } else { 0 }
}

/// Contribution of one directed edge to the 2D winding around `p`: nonzero if it crosses the row of `p` beyond its
/// column.
fn edge_turn(p: DVec3, a: DVec3, b: DVec3, axes: Axes) -> i32 {
    match (a[axes.row] <= p[axes.row], b[axes.row] <= p[axes.row]) {
        (true, false) => i32::from(side(a, b, p, axes) > 0.0),
        (false, true) => -i32::from(side(b, a, p, axes) > 0.0),
        _ => 0,
    }
}

/// Positive if `p` lies at smaller columns than the edge that rises from `low` to `high`.
fn side(low: DVec3, high: DVec3, p: DVec3, axes: Axes) -> f64 {
    let at = |q: DVec3| Coord { x: q[axes.column], y: q[axes.row] };
    orient2d(at(low), at(high), at(p))
}

/// Whether the plane of a triangle that covers `p` in the projection lies strictly ahead of it. `turns` is the
/// orientation of the triangle in the projection.
fn is_ahead(p: DVec3, [a, b, c]: [DVec3; 3], turns: i32, axes: Axes) -> bool {
    let at = |q: DVec3| Coord3D { x: q[axes.column], y: q[axes.row], z: q[axes.ray] };
    // orient3d is positive if p lies below the plane, where a, b, c are counter-clockwise as seen from above.
    orient3d(at(a), at(b), at(c), at(p)) * f64::from(turns) > 0.0
}

/// Equally spaced sample positions along one axis, local units.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Samples {
    /// Position of sample 0 of the whole axis.
    pub first: f64,
    pub step: f64,
    /// Samples of the whole axis that lie before this part of it. Positions are computed from the whole axis, so that
    /// they have the same bits in every part.
    pub start: usize,
    pub count: usize,
}

impl Samples {
    pub(crate) fn at(&self, index: usize) -> f64 {
        self.first + (self.start + index) as f64 * self.step
    }

    /// Number of samples that satisfy `is_before`, which holds for a leading run of them that ends near `estimate`.
    fn count_before(&self, estimate: f64, is_before: impl Fn(f64) -> bool) -> usize {
        let guess = ((estimate - self.at(0)) / self.step).ceil();
        // The cast saturates, and maps NaN to zero.
        let mut count = (guess as i64).clamp(0, self.count as i64) as usize;
        while count < self.count && is_before(self.at(count)) {
            count += 1;
        }
        while count > 0 && !is_before(self.at(count - 1)) {
            count -= 1;
        }
        count
    }
}

/// Winding numbers of one plane of samples: all rays of one row.
///
/// `windings[column * along.count + i]` is the winding number of the sample at `column` and position i along the ray.
/// The cost is one exact test per edge, and one per column that a triangle covers.
pub(crate) fn scan_row(
    surface: &ClosedSurface<'_>,
    axes: Axes,
    row: f64,
    columns: &Samples,
    along: &Samples,
    windings: &mut [i16],
) {
    debug_assert_eq!(windings.len(), columns.count * along.count);
    windings.fill(0);
    let (mut low, mut high) = (DVec3::NEG_INFINITY, DVec3::INFINITY);
    (low[axes.row], high[axes.row]) = (row, row);
    (low[axes.column], high[axes.column]) = (columns.at(0), columns.at(columns.count - 1));
    let rays = RayBox::between(low, high);
    surface.for_each_candidate(&rays, |triangle| mark_row(triangle, axes, row, columns, along, 1, windings));
    sum_marks(along, windings);
}

/// Adds the contribution of one triangle, times `weight`, to the marks of a row. [`sum_marks`] makes winding numbers of
/// the marks of all triangles.
pub(crate) fn mark_row(
    triangle: [DVec3; 3],
    axes: Axes,
    row: f64,
    columns: &Samples,
    along: &Samples,
    weight: i16,
    windings: &mut [i16],
) {
    // The row crosses two edges or none; the columns between them are covered.
    let mut cuts = [(0, 0); 2];
    let mut found = 0;
    for i in 0..3 {
        let (a, b) = (triangle[i], triangle[(i + 1) % 3]);
        let (low, high, turn) = match (a[axes.row] <= row, b[axes.row] <= row) {
            (true, false) => (a, b, 1),
            (false, true) => (b, a, -1),
            _ => continue,
        };
        let t = (row - low[axes.row]) / (high[axes.row] - low[axes.row]);
        let estimate = low[axes.column] + t * (high[axes.column] - low[axes.column]);
        let column = columns.count_before(estimate, |column| {
            let mut p = DVec3::ZERO;
            p[axes.column] = column;
            p[axes.row] = row;
            side(low, high, p, axes) > 0.0
        });
        cuts[found] = (column, turn);
        found += 1;
    }
    if found < 2 {
        return;
    }
    cuts.sort_unstable();
    // Columns before both cuts are left of both edges, which cancel. Between them only the farther edge counts.
    let turns = cuts[1].1;
    for column in cuts[0].0..cuts[1].0 {
        let mut origin = DVec3::ZERO;
        origin[axes.column] = columns.at(column);
        origin[axes.row] = row;
        let ahead = along.count_before(height_at(triangle, origin, axes), |position| {
            let mut p = origin;
            p[axes.ray] = position;
            is_ahead(p, triangle, turns, axes)
        });
        if ahead > 0 {
            // The triangle is ahead of every sample up to here. The last one is marked, and the marks are summed
            // below.
            let mark = &mut windings[column * along.count + ahead - 1];
            *mark = mark.wrapping_add(weight * turns as i16);
        }
    }
}

/// Sums the marks of each column of a row from the far end, which gives the winding numbers.
pub(crate) fn sum_marks(along: &Samples, windings: &mut [i16]) {
    for column in windings.chunks_exact_mut(along.count) {
        let mut sum = 0i16;
        for mark in column.iter_mut().rev() {
            sum = sum.wrapping_add(*mark);
            *mark = sum;
        }
    }
}

/// Approximate position at which the ray through `p` intersects the triangle; NaN if the triangle is parallel to the
/// ray.
fn height_at([a, b, c]: [DVec3; 3], p: DVec3, axes: Axes) -> f64 {
    let n = (b - a).cross(c - a);
    let beside = n[axes.column] * (p[axes.column] - a[axes.column]) + n[axes.row] * (p[axes.row] - a[axes.row]);
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    (a[axes.ray] - beside / n[axes.ray]).clamp(low[axes.ray], high[axes.ray])
}
