//! The clearance of pairs of bodies: their distance if they are apart, the negative diameter of the largest ball in
//! their overlap if not.
//!
//! The distance from a body is the smallest one over its geometries, so the clearance of two bodies is the smallest one
//! over pairs of geometries. A pair of meshes, boxes, balls or capsules is compared by triangles ([`separation`]): a
//! ball is a point with a radius, a capsule a segment with a radius. Other pairs begin with alternating projections,
//! whose result planes of support prove between convex solids; a mesh and a convex shape are compared by tangents.
//! Overlaps, and pairs without a proof, are searched by branch and bound ([`overlap`]). The normal near contact comes
//! from the gradients around the minimum ([`descent`]). A flat sheet has no inside: its clearance from a solid that it
//! touches is 0 ([`sheet`]).
//!
//! [`separation`]: super::separation
//! [`overlap`]: super::overlap
//! [`descent`]: super::descent
//! [`sheet`]: super::sheet

use super::descent::{CONTACT, contact_normal};
use super::form::Form;
use super::overlap::{minimum, project};
use super::separation::{TriangleSet, distance, distance_from_convex};
use super::sheet::common_point;
use super::solid::{ROUNDING, Solid};
use super::{Bodies, Element, Geometry, Similarity};
use crate::csg::model::token::Token;
use crate::csg::tree::primitive::Primitive;
use crate::error::{ArgumentError, Error};
use crate::memory::zeroed_rows;
use crate::mesh::Mesh;
use crate::progress::Progress;
use bytemuck::Zeroable;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// Part of the size of the smaller solid below which a gap is no error of a distance, and the least tolerance.
const FLOOR: f64 = 1e-9;
/// Share of the size to which convex solids are compared where the rounding allows it, so that differences of distances
/// are derivatives.
const ACCURACY: f64 = 1e-13;

/// The clearance of one pair.
#[derive(Debug, Clone, Copy, Zeroable)]
pub struct Clearance {
    /// Negative where the bodies overlap; a lower bound beyond the cutoff.
    pub distance: f64,
    /// The true value is at least the distance minus this; infinite without a proof.
    pub error: f64,
    /// The nearest surface points of both bodies, world positions; NaN beyond the cutoff.
    pub points: [[f64; 3]; 2],
    /// Unit vector from the second body to the first.
    pub normal: [f64; 3],
    /// The place where the larger distance from both bodies is smallest; NaN beyond the cutoff.
    pub center: [f64; 3],
}

/// Accuracy of a call.
#[derive(Debug, Clone, Copy)]
pub struct Options {
    /// Distances of at least this are replaced by lower bounds.
    pub cutoff: f64,
    /// Largest error relative to the depth of an overlap.
    pub relative_tolerance: f64,
}

/// The clearance of all pairs in all configurations: pairs first, configuration by configuration. `poses` are
/// world-from-body, for all bodies of the first configuration, then of the next one.
pub fn clearances(
    bodies: &Bodies,
    poses: &[[[f64; 4]; 4]],
    pairs: &[[usize; 2]],
    options: &Options,
    progress: &Progress,
) -> Result<Vec<Clearance>, Error> {
    let configurations = poses.len().checked_div(bodies.count).unwrap_or(0);
    let total = configurations * pairs.len();
    progress.set_total(total as u64);
    let sets: Vec<Prepared<'_>> = bodies.elements.par_iter().map(Prepared::new).collect();
    let is_unbounded = |body: usize| sets.iter().any(|set| set.element.body == body && set.bounds.is_none());
    if let Some([a, b]) = pairs.iter().find(|pair| pair.iter().all(|&body| is_unbounded(body))) {
        let problem = format!("the bodies {a} and {b} are both unbounded, so they have no clearance");
        return Err(ArgumentError::new("pairs", problem).into());
    }
    let mut results: Vec<Clearance> = zeroed_rows("results", total)?;
    results.par_iter_mut().enumerate().try_for_each(|(row, out)| {
        let (configuration, [a, b]) = (row / pairs.len(), pairs[row % pairs.len()]);
        let pose = |body: usize| Similarity::from_rows(&poses[configuration * bodies.count + body], 1.0);
        *out = of_bodies(&sets, [a, b], [pose(a), pose(b)], options, progress);
        progress.advance(1)
    })?;
    Ok(results)
}

/// A geometry with the tables of its comparison.
struct Prepared<'a> {
    element: &'a Element,
    /// A box around the surface, in coordinates of the geometry.
    bounds: Option<[DVec3; 2]>,
    triangles: Option<(Triangles<'a>, f64)>,
}

/// Triangles of a mesh, or of a primitive.
enum Triangles<'a> {
    Mesh(&'a TriangleSet),
    Own(TriangleSet),
}

impl Triangles<'_> {
    fn set(&self) -> &TriangleSet {
        match self {
            Self::Mesh(set) => set,
            Self::Own(set) => set,
        }
    }
}

impl<'a> Prepared<'a> {
    fn new(element: &'a Element) -> Self {
        match &element.geometry {
            Geometry::Mesh(mesh) => {
                mesh.bvh();
                mesh.winding_choice().rule.prepare(mesh);
                let triangles = Some((Triangles::Mesh(mesh.derived::<TriangleSet>()), 0.0));
                Self { element, bounds: Some(mesh.bounds()), triangles }
            }
            Geometry::Shape(shape) => {
                let triangles = triangles_of(shape.solid()).map(|(set, radius)| (Triangles::Own(set), radius));
                Self { element, bounds: shape.solid().bounds().ok(), triangles }
            }
        }
    }

    /// Centre and half sides of a box around the surface in another frame.
    fn posed_box(&self, place: &Similarity) -> Option<[DVec3; 2]> {
        let [lower, upper] = self.bounds?;
        let (center, half) = (place.point(0.5 * (lower + upper)), 0.5 * (upper - lower));
        let r = place.rotation;
        let half = r.x_axis.abs() * half.x + r.y_axis.abs() * half.y + r.z_axis.abs() * half.z;
        Some([center - half, center + half])
    }

    /// The mesh, if it is a flat sheet.
    fn sheet(&self) -> Option<&Mesh> {
        match &self.element.geometry {
            Geometry::Mesh(mesh) if *mesh.derived::<Form>() == Form::Sheet => Some(mesh),
            _ => None,
        }
    }

    fn size(&self) -> f64 {
        self.bounds.map_or(f64::INFINITY, |[lower, upper]| (upper - lower).length())
    }
}

/// The triangles and the radius of a box, a ball or a capsule.
fn triangles_of(solid: &crate::csg::parts::solid::Solid) -> Option<(TriangleSet, f64)> {
    let model = &solid.model;
    let ([Token::Leaf(0)], [leaf]) = (&model.tokens[..], &model.leaves[..]) else { return None };
    let place = &leaf.place;
    let at = |p: DVec3| place.rotation * (place.scale * p) + place.translation;
    match leaf.primitive {
        Primitive::Sphere { radius } => Some((TriangleSet::new(&[[at(DVec3::ZERO); 3]]), place.scale * radius)),
        Primitive::Capsule { radius, half_height } => {
            let [low, high] = [-half_height, half_height].map(|z| at(DVec3::new(0.0, 0.0, z)));
            Some((TriangleSet::new(&[[low, high, high]]), place.scale * radius))
        }
        Primitive::Box { half, rounding: 0.0 } => {
            let corner = |i: usize| {
                let sign = |axis: usize| if i >> axis & 1 == 0 { -1.0 } else { 1.0 };
                at(half * DVec3::new(sign(0), sign(1), sign(2)))
            };
            let sides = [[0, 2, 3, 1], [0, 1, 5, 4], [0, 4, 6, 2], [1, 3, 7, 5], [2, 6, 7, 3], [4, 5, 7, 6]];
            let triangles: Vec<_> = sides
                .iter()
                .flat_map(|side| {
                    let [a, b, c, d] = side.map(corner);
                    [[a, b, c], [a, c, d]]
                })
                .collect();
            Some((TriangleSet::new(&triangles), 0.0))
        }
        _ => None,
    }
}

/// The clearance of two posed bodies.
fn of_bodies(
    sets: &[Prepared<'_>],
    [a, b]: [usize; 2],
    poses: [Similarity; 2],
    options: &Options,
    progress: &Progress,
) -> Clearance {
    let of = |body: usize| sets.iter().filter(move |set| set.element.body == body);
    let mut waiting: Vec<(f64, &Prepared<'_>, &Prepared<'_>)> = Vec::new();
    for first in of(a) {
        for second in of(b) {
            let boxes = [
                first.posed_box(&poses[0].after(&first.element.place)),
                second.posed_box(&poses[1].after(&second.element.place)),
            ];
            let bound = match boxes {
                [Some(x), Some(y)] => (x[0] - y[1]).max(y[0] - x[1]).max(DVec3::ZERO).length() * (1.0 - 1e-12),
                _ => 0.0,
            };
            waiting.push((bound, first, second));
        }
    }
    waiting.sort_by(|x, y| x.0.total_cmp(&y.0));
    let far = Clearance {
        distance: f64::INFINITY,
        error: f64::INFINITY,
        points: [[f64::NAN; 3]; 2],
        normal: [f64::NAN; 3],
        center: [f64::NAN; 3],
    };
    let mut best = far;
    // The smallest proven lower bound over all pairs.
    let mut least = f64::INFINITY;
    for (bound, first, second) in waiting {
        let limit = best.distance.min(options.cutoff);
        if bound > 0.0 && bound >= limit {
            least = least.min(bound);
            continue;
        }
        let places = [poses[0].after(&first.element.place), poses[1].after(&second.element.place)];
        let accuracy = Accuracy { limit, relative_tolerance: options.relative_tolerance };
        match Pair::new([first, second], places).clearance(accuracy, progress) {
            Some(found) => {
                least = least.min(found.distance - found.error);
                if found.distance < best.distance {
                    best = found;
                }
            }
            None => least = least.min(limit),
        }
    }
    if best.distance >= options.cutoff && least >= options.cutoff {
        return Clearance { distance: least, ..far };
    }
    best.error = (best.distance - least).max(0.0);
    best
}

/// Two posed geometries. All is computed in the frame of the first one.
struct Pair<'a> {
    sets: [&'a Prepared<'a>; 2],
    /// World from geometry.
    places: [Similarity; 2],
    /// Frame of the first geometry from geometry.
    frames: [Similarity; 2],
}

/// A point on each of two solids, their distance, and a lower bound of the distance of the solids.
type Projected = (DVec3, DVec3, f64, f64);

/// Accuracy of a pair.
#[derive(Clone, Copy)]
struct Accuracy {
    /// A clearance that is certainly at least this is not computed.
    limit: f64,
    relative_tolerance: f64,
}

impl<'a> Pair<'a> {
    fn new(sets: [&'a Prepared<'a>; 2], places: [Similarity; 2]) -> Self {
        let back = places[0].rotation.transpose();
        let here = Similarity { rotation: glam::DMat3::IDENTITY, translation: DVec3::ZERO, scale: 1.0 };
        let there = Similarity {
            rotation: back * places[1].rotation,
            translation: back * (places[1].translation - places[0].translation),
            scale: 1.0,
        };
        Self { sets, places, frames: [here, there] }
    }

    /// Size of the smaller geometry.
    fn size(&self) -> f64 {
        self.sets[0].size().min(self.sets[1].size()).min(1e30)
    }

    /// A result in world space.
    fn world(&self, distance: f64, error: f64, points: [DVec3; 2], normal: DVec3, center: DVec3) -> Clearance {
        let [p, q, center] = [points[0], points[1], center].map(|point| self.places[0].point(point).to_array());
        let normal = (self.places[0].rotation * normal).to_array();
        Clearance { distance, error, points: [p, q], normal, center }
    }

    /// The clearance; none if it is certainly at least the limit.
    ///
    /// Where a geometry is the triangles of a shape, both differ by at most a deviation. The clearance of the triangles
    /// therefore bounds the clearance of the shapes from below. Projections onto the surfaces of the shapes begin at
    /// the result of the triangles, and their end bounds the clearance from above.
    fn clearance(&self, accuracy: Accuracy, progress: &Progress) -> Option<Clearance> {
        let sources = self.sets.map(|set| set.element.source.as_ref());
        if sources.iter().all(Option::is_none) {
            return self.of_geometries(accuracy, progress);
        }
        // A distance changes by at most the sum of both deviations, and twice a depth by twice the larger one.
        let slack = sources.iter().flatten().fold(0.0_f64, |slack, (_, deviation)| slack.max(2.0 * deviation));
        let found = self.of_geometries(Accuracy { limit: accuracy.limit + slack, ..accuracy }, progress)?;
        let lower = found.distance - found.error - slack;
        if lower >= accuracy.limit {
            return None;
        }

        let solid = |i: usize| match sources[i] {
            Some((shape, _)) => Solid::new(shape, self.frames[i], false),
            None => Solid::new(&self.sets[i].element.geometry, self.frames[i], true),
        };
        let (mut a, mut b) = (solid(0), solid(1));
        let center = self.places[0].inverse_point(DVec3::from_array(found.center));
        let size = self.size() + center.length();
        let (distance, points, normal) = match project(&mut a, &mut b, center, size, ACCURACY * size) {
            Some((p, q, apart, _)) => (apart, [p, q], direction(&mut a, &mut b, [p, q], size)),
            // The solids have a common point. Fields are bounds of distances, also inside.
            None => {
                let depth = a.distance(center).max(b.distance(center)).min(0.0);
                let (points, normal) = facing(&mut a, &mut b, center, size);
                (2.0 * depth, points, normal)
            }
        };
        Some(self.world(distance, (distance - lower).max(0.0), points, normal, center))
    }

    /// A clearance in world space whose centre is the midpoint of its two points; negative for an overlap.
    fn between_points(&self, distance: f64, error: f64, points: [DVec3; 2], normal: DVec3) -> Clearance {
        self.world(distance, error, points, normal, 0.5 * (points[0] + points[1]))
    }

    /// [`Self::clearance`] of the geometries as they are.
    fn of_geometries(&self, accuracy: Accuracy, progress: &Progress) -> Option<Clearance> {
        let ([first, second], [here, place]) = (self.sets, self.frames);
        let mut solids =
            [Solid::new(&first.element.geometry, here, true), Solid::new(&second.element.geometry, place, true)];
        let floor = FLOOR * self.size();
        let start = match self.of_triangles(&mut solids, accuracy) {
            ControlFlow::Break(found) => return found,
            ControlFlow::Continue(start) => start,
        };

        let boxes = [first.posed_box(&here), second.posed_box(&place)];
        let middle = |[lower, upper]: [DVec3; 2]| 0.5 * (lower + upper);
        let start = start.or_else(|| Some(middle(boxes[1].or(boxes[0])?))).unwrap_or(DVec3::ZERO);
        let [a, b] = &mut solids;
        let size = self.size() + start.length();
        let projected = project(a, b, start, size, ACCURACY * size);
        if let Some((p, q, apart, lower)) = projected
            && apart - lower <= floor
        {
            let is_near = lower < accuracy.limit;
            return is_near.then(|| self.between_points(apart, apart - lower, [p, q], direction(a, b, [p, q], size)));
        }
        if let Some((p, q, apart, lower)) = projected.and_then(|found| self.of_tangents(&mut solids, found, floor))
            && apart - lower <= (accuracy.relative_tolerance * apart).max(2.0 * floor)
        {
            let [a, b] = &mut solids;
            let is_near = lower < accuracy.limit;
            return is_near.then(|| self.between_points(apart, apart - lower, [p, q], direction(a, b, [p, q], size)));
        }
        if let Some(contact) = self.at_sheet(&mut solids, size) {
            return Some(contact);
        }
        self.by_search(&mut solids, boxes, start, projected, accuracy, progress)
    }

    /// The clearance by the triangles of both solids: from surface to surface, for meshes, balls and capsules.
    ///
    /// `Break` has the result; None if the distance is at least the limit. `Continue` means that triangles do not
    /// suffice. It has the midpoint of the closest points, or None for nested solids and without triangles.
    fn of_triangles(
        &self,
        solids: &mut [Solid<'_>; 2],
        accuracy: Accuracy,
    ) -> ControlFlow<Option<Clearance>, Option<DVec3>> {
        let ([first, second], [here, place]) = (self.sets, self.frames);
        let (Some((a, radius_a)), Some((b, radius_b))) = (&first.triangles, &second.triangles) else {
            return ControlFlow::Continue(None);
        };
        let (a, b, radii) = (a.set(), b.set(), radius_a + radius_b);
        let nested = contains_start(&mut solids[1], a, &here, second, &place)
            || contains_start(&mut solids[0], b, &place, first, &here);
        if nested {
            return ControlFlow::Continue(None);
        }
        let Some((apart, p, q)) = distance([a, b], &place, accuracy.limit + radii) else {
            return ControlFlow::Break(None);
        };
        if radii == 0.0 && apart > 0.0 {
            let [a, b] = solids;
            let normal = direction(a, b, [p, q], self.size());
            return ControlFlow::Break(Some(self.between_points(apart, 0.0, [p, q], normal)));
        }
        // Balls and capsules: the largest ball of the overlap lies on the line of the closest points.
        let is_thin = *radius_a > 0.0 && *radius_b > 0.0 && (radius_a - radius_b).abs() <= apart;
        if let (true, Some(n)) = (apart > radii || is_thin, (p - q).try_normalize()) {
            let points = [p - n * *radius_a, q + n * *radius_b];
            return ControlFlow::Break(Some(self.between_points(apart - radii, 0.0, points, n)));
        }
        ControlFlow::Continue(Some(0.5 * (p + q)))
    }

    /// Closest points of a mesh and a convex solid, their distance and its lower bound. None for other pairs, and where
    /// the point on the convex solid is not outside the mesh. `p` and `q` are points on the first and second solid.
    fn of_tangents(&self, solids: &mut [Solid<'_>; 2], (p, q, ..): Projected, floor: f64) -> Option<Projected> {
        let mut tangents = None;
        for (of, other) in [(0, 1), (1, 0)] {
            if let (Some((Triangles::Mesh(set), _)), true) = (&self.sets[of].triangles, solids[other].is_convex())
                && solids[of].distance([p, q][other]) > 0.0
                && let Some((apart, points, lower)) =
                    distance_from_convex(set, &self.frames[of], &mut solids[other], floor)
            {
                let [p, q] = if of == 0 { points } else { [points[1], points[0]] };
                tangents = Some((p, q, apart, lower));
            }
        }
        tangents
    }

    /// The contact of a sheet that has a point in the other solid.
    fn at_sheet(&self, solids: &mut [Solid<'_>; 2], size: f64) -> Option<Clearance> {
        for (of, other) in [(0, 1), (1, 0)] {
            let Some(sheet) = self.sets[of].sheet() else { continue };
            if let Some(x) = common_point(sheet, &self.frames[of], &mut solids[other], ROUNDING * size) {
                let outwards = solids[other].value(x).gradient;
                let [a, b] = solids;
                let turned = if of == 0 { outwards } else { -outwards };
                let normal = contact_normal(a, b, x, size).unwrap_or(turned);
                return Some(self.between_points(0.0, 0.0, [x, x], normal));
            }
        }
        None
    }

    /// The clearance by a search for the minimum of the larger distance of both solids, by branch and bound.
    fn by_search(
        &self,
        [a, b]: &mut [Solid<'_>; 2],
        boxes: [Option<[DVec3; 2]>; 2],
        start: DVec3,
        projected: Option<Projected>,
        accuracy: Accuracy,
        progress: &Progress,
    ) -> Option<Clearance> {
        let (size, floor) = (self.size() + start.length(), FLOOR * self.size());
        // The minimum lies within its value of both boxes.
        let reach = match projected {
            Some((_, _, apart, _)) => 0.5 * apart,
            None => 0.0,
        };
        let grown = boxes.map(|bounds| bounds.map(|[lower, upper]| [lower - reach, upper + reach]));
        let region = match grown {
            [Some(x), Some(y)] => [x[0].max(y[0]), x[1].min(y[1])],
            [Some(x), None] | [None, Some(x)] => x,
            [None, None] => [start - size, start + size],
        };
        let start = projected.map_or_else(|| start.max(region[0]).min(region[1]), |(p, q, _, _)| 0.5 * (p + q));
        // The signed distance of an open mesh jumps across its opening, where no bound holds.
        let is_closed = |of: &Prepared<'_>| match &of.element.geometry {
            Geometry::Mesh(mesh) => mesh.topology().closed || of.sheet().is_some(),
            Geometry::Shape(_) => true,
        };
        let unproven = if self.sets.into_iter().all(is_closed) { 0.0 } else { f64::INFINITY };
        let found = minimum(a, b, region, start, accuracy.relative_tolerance, 0.5 * floor, progress);
        // A sheet has no inside, so no clearance of it is negative.
        let has_sheet = self.sets.iter().any(|set| set.sheet().is_some());
        let lower = if has_sheet { (2.0 * found.lower).max(0.0) } else { 2.0 * found.lower };
        if lower >= accuracy.limit && lower > 0.0 {
            return None;
        }
        if found.upper > 0.0 {
            // The closest points near the minimum.
            let (p, q, apart, own) =
                project(a, b, found.at, size, ACCURACY * size).or(projected).unwrap_or_else(|| {
                    let (p, q) = (a.gradient_and_point(found.at).1, b.gradient_and_point(found.at).1);
                    (p, q, p.distance(q), lower)
                });
            let apart = apart.min(2.0 * found.upper);
            let error = (apart - lower.max(own)).max(unproven);
            return Some(self.between_points(apart, error, [p, q], direction(a, b, [p, q], size)));
        }
        let (points, normal) = facing(a, b, found.at, size);
        let error = (2.0 * (found.upper - found.lower)).max(unproven);
        Some(self.world(2.0 * found.upper, error, points, normal, found.at))
    }
}

/// The unit vector from the second of two closest points to the first. Near contact the direction of the points is
/// rounding, and the gradients decide.
fn direction(a: &mut Solid<'_>, b: &mut Solid<'_>, [p, q]: [DVec3; 2], size: f64) -> DVec3 {
    if p.distance(q) > CONTACT * size {
        return (p - q).normalize();
    }
    let normal = contact_normal(a, b, 0.5 * (p + q), size);
    normal.or((p - q).try_normalize()).unwrap_or(DVec3::X)
}

/// The points of two overlapping solids nearest to a place, and the unit vector from the second surface to the first.
fn facing(a: &mut Solid<'_>, b: &mut Solid<'_>, at: DVec3, size: f64) -> ([DVec3; 2], DVec3) {
    let ((gradient_a, p), (gradient_b, q)) = (a.gradient_and_point(at), b.gradient_and_point(at));
    let normal = contact_normal(a, b, at, size).or((gradient_b - gradient_a).try_normalize());
    ([p, q], normal.unwrap_or(gradient_b))
}

/// Whether a component of a set begins inside a solid. `place` belongs to the set, `other` to the solid.
fn contains_start(
    solid: &mut Solid<'_>,
    set: &TriangleSet,
    place: &Similarity,
    prepared: &Prepared<'_>,
    other: &Similarity,
) -> bool {
    set.starts.iter().any(|&start| {
        let p = place.point(start);
        let is_near = prepared.element.bounds.is_none_or(|[lower, upper]| {
            let local = other.inverse_point(p);
            local.cmpge(lower).all() && local.cmple(upper).all()
        });
        is_near && solid.distance(p) < 0.0
    })
}
