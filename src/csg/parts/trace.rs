//! First hits of rays with a shape, part by part.
//!
//! # Theory
//!
//! A ray is traced through a tree over the boxes of all parts, near child first. Each box that it enters before the
//! nearest hit so far is searched from the point of entry to the point of exit, in closed form ([`super::chord`]) or by
//! sphere tracing the part's field.
//!
//! *Hits.* A hit is where a ray enters the solid eroded by [`ERODED`], that is the set `field < -ERODED`. Without the
//! erosion the rounding of float32 would decide whether there is a film between coincident faces, for example over the
//! mouth of a pocket that is flush with the outer face.
//!
//! *Sphere tracing* (J. Hart, "Sphere Tracing", 1996). A step is the field over its Lipschitz constant, and at least
//! [`MIN_STEP`]. Only the smallest step can cross the surface. The root of the field is then bracketed and found by
//! regula falsi, so it does not depend on the start of the search: the whole shape and its parts have the same depth.
//! The search may miss a ray whose interval in the eroded solid is shorter than [`MIN_STEP`]. It finds every longer
//! interval, because two consecutive evaluations that are farther apart are separated by a step that crosses no
//! surface. Closed forms have no such limit.
//!
//! *Owner of a hit.* The nearest hit over all boxes is the hit of the whole shape, and the tree of its part has the
//! whole's surface there. For boxes from the leaves this follows from the invariant that [`super::carried_boxes`]
//! proves: within a margin around its box, each part is a subset of the whole. So a ray that is inside the part where
//! it enters the box was inside the whole before, unless the part's own surface is there. In the cells of
//! [`super::octree`] the part has the sign of the whole up to a margin around the cell, which implies the same. A box
//! contains its face of entry and not its face of exit. Neighbours have the same float32 coordinates at their common
//! face, so a root lies in exactly one of them.
//!
//! Everything along the ray is in local units and float32.

use super::cells::{CellNode, LocalBox, PartCells, PartProgram};
use super::chord;
use super::chord::{ERODED, PartKind, Step};
use super::part::Part;
use super::solid::{Solid, slope};
use crate::bvh::boxes::MAX_STACK;
use crate::csg::evaluation::leaf::PlacedLeaf;
use crate::csg::evaluation::program::Stack;
use crate::csg::model::lowered::Model;
use crate::gpu::constants::csg_draw::STILL;
use crate::gpu::constants::csg_root::{MAX_MARCH_STEPS, MAX_ROOT_STEPS, MIN_STEP, ROOT_WIDTH};
use crate::simd::with_vectors;
use glam::{DVec3, Vec3, Vec3A};
use std::sync::Arc;

/// Half the step of the central differences in float64 for normals of a part's field, local units.
const NORMAL_STEP: f64 = 1e-5;
/// Distance from the hit to the corners of a tetrahedron, along each axis, for the normal of one leaf's field, local
/// units.
const LEAF_STEP: f64 = 2e-6;

/// Weight of [`Tracer::cost`] for visiting a box, in evaluations of a leaf. With these weights the cheapest method is
/// the fastest, or nearly, on scattered leaves and on the models of `examples/csg`.
const BOX_LOOKS: f64 = 2.0;
/// Estimated sphere-tracing steps in a box of size 0, and additional steps in a box as large as the model.
const MARCH_LOOKS: [f64; 2] = [2.0, 15.0];

/// A shape, split or whole, prepared for rays. Cloning shares the tables.
#[derive(Debug, Clone)]
pub(crate) struct Tracer<'a> {
    pub solid: &'a Solid,
    pub programs: Arc<[PartProgram]>,
    pub boxes: Arc<[LocalBox]>,
    pub nodes: Arc<[CellNode]>,
    /// Lower and upper corner around all parts.
    pub bounds: [Vec3; 2],
}

/// Part of a line, local units; `direction` is unit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ShapeRay {
    pub origin: Vec3,
    pub direction: Vec3,
    pub t_max: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ShapeHit {
    pub t: f32,
    pub part: u32,
    /// Whether the hit is where the ray enters the box of the part: the ray may have begun inside.
    pub is_at_entry: bool,
}

/// Numbers of evaluations of a ray.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct TraceWork {
    /// Number of evaluations of a part's field.
    pub steps: u32,
    /// Number of evaluations of a leaf's field or chord.
    pub leaves: u64,
}

impl<'a> Tracer<'a> {
    /// Prepares the parts of a solid, whose boxes are in world units.
    pub(crate) fn new(solid: &'a Solid, parts: &[Part]) -> Self {
        Self::of(solid, PartCells::new(solid.tables(), parts))
    }

    pub(crate) fn of(solid: &'a Solid, cells: PartCells) -> Self {
        let PartCells { programs, boxes, nodes, bounds } = cells;
        Self { solid, programs, boxes, nodes, bounds }
    }

    /// The whole shape in one box, a little larger than its bounds.
    pub(crate) fn one_box(solid: &'a Solid) -> Self {
        let extent = &solid.model.extent;
        if extent.is_empty() {
            return Self::new(solid, &[]);
        }
        let pad = DVec3::splat(1e-3 * (extent.upper - extent.lower).max_element());
        let bounds = [extent.lower - pad, extent.upper + pad];
        Self::new(solid, &[Part { tokens: solid.model.tokens.as_slice().into(), boxes: vec![bounds] }])
    }

    /// The whole shape in one box, always by sphere tracing its field: the reference for the parts.
    pub(crate) fn whole(solid: &'a Solid) -> Self {
        let tracer = Self::one_box(solid);
        let march = |part: &PartProgram| PartProgram {
            form: PartKind::Field,
            steps: Box::default(),
            leaves: Model::leaf_count(&part.tokens) as u32,
            ..PartProgram::new(solid.tables(), &part.tokens)
        };
        Self { programs: tracer.programs.iter().map(march).collect(), ..tracer }
    }

    /// Expected cost of a ray that is not stopped, in evaluations of a leaf times a constant. The fraction of rays that
    /// reach a box is proportional to its surface area. A ray that reaches a box evaluates all leaves of the box's
    /// part, once or at every step.
    pub(crate) fn cost(&self) -> f64 {
        let of_box = |cell: &LocalBox| {
            let sides = (cell.upper - cell.lower).as_dvec3();
            let area = sides.x * sides.y + sides.y * sides.z + sides.z * sides.x;
            let part = &self.programs[cell.part as usize];
            let looks = match part.form {
                PartKind::Field => MARCH_LOOKS[0] + MARCH_LOOKS[1] * sides.element_sum() / 3.0,
                PartKind::Union | PartKind::Chords => 1.0,
            };
            area * (BOX_LOOKS + looks * f64::from(part.leaves))
        };
        self.boxes.iter().map(of_box).sum()
    }

    /// The first hit of a ray.
    pub(crate) fn first_hit(
        &self,
        ray: &ShapeRay,
        stack: &mut Stack<f32, 1>,
        work: &mut TraceWork,
    ) -> Option<ShapeHit> {
        self.trace(ray, false, stack, work)
    }

    /// Whether a ray hits the shape.
    pub(crate) fn is_hit(&self, ray: &ShapeRay, stack: &mut Stack<f32, 1>, work: &mut TraceWork) -> bool {
        self.trace(ray, true, stack, work).is_some()
    }

    fn trace(&self, ray: &ShapeRay, any: bool, stack: &mut Stack<f32, 1>, work: &mut TraceWork) -> Option<ShapeHit> {
        let line = BoxRay::new(ray);
        let mut best: Option<ShapeHit> = None;
        let mut t_best = ray.t_max;
        let mut waiting = [(0u32, 0f32); MAX_STACK];
        let mut count = 0;
        if let Some(root) = self.nodes.first()
            && let Some((t_in, _)) = line.span(root.lower, root.upper, t_best)
        {
            waiting[0] = (0, t_in);
            count = 1;
        }
        while count > 0 {
            count -= 1;
            let (node, t_in) = waiting[count];
            if t_in >= t_best {
                continue;
            }
            let node = &self.nodes[node as usize];
            if node.count > 0 {
                for cell in &self.boxes[node.first as usize..][..node.count as usize] {
                    if let Some(span) = line.span(cell.lower, cell.upper, t_best)
                        && let Some(t) = self.first_root(cell.part, ray, span, stack, work)
                    {
                        t_best = t;
                        best = Some(ShapeHit { t, part: cell.part, is_at_entry: t == span.0 });
                        if any {
                            return best;
                        }
                    }
                }
                continue;
            }
            let child = |i: u32| {
                let node = &self.nodes[i as usize];
                line.span(node.lower, node.upper, t_best).map(|(t_in, _)| (i, t_in))
            };
            let (left, right) = (child(node.first), child(node.first + 1));
            let (near, far) = match (left, right) {
                (Some(a), Some(b)) if b.1 < a.1 => (Some(b), Some(a)),
                pair => pair,
            };
            for next in [far, near].into_iter().flatten() {
                waiting[count] = next;
                count += 1;
            }
        }
        best
    }

    /// The first point of a ray in a part's box that is inside the part.
    fn first_root(
        &self,
        part: u32,
        ray: &ShapeRay,
        (t_in, t_out): (f32, f32),
        stack: &mut Stack<f32, 1>,
        work: &mut TraceWork,
    ) -> Option<f32> {
        let program = &self.programs[part as usize];
        if program.form == PartKind::Field {
            return self.march(program, ray, t_in, t_out, stack, work);
        }
        work.steps += 1;
        work.leaves += u64::from(program.leaves);
        let line = [ray.origin, ray.direction];
        chord::first_inside(&self.solid.program, &program.steps, program.form, line, [t_in, t_out])
    }

    /// The first root on `[t_in, t_out)` behind which the field is below `-ERODED`, or `t_in` itself if it is so there.
    /// Where the field only touches zero, as in `a - a`, nothing is hit.
    fn march(
        &self,
        program: &PartProgram,
        ray: &ShapeRay,
        t_in: f32,
        t_out: f32,
        stack: &mut Stack<f32, 1>,
        work: &mut TraceWork,
    ) -> Option<f32> {
        let mut field = |t: f32| {
            work.steps += 1;
            work.leaves += u64::from(program.leaves);
            let p = ray.origin + t * ray.direction;
            self.solid.program.run(&program.tokens, &[[p.x], [p.y], [p.z]], stack)[0]
        };
        let mut t = t_in;
        let mut value = field(t);
        if value < -ERODED {
            return Some(t);
        }
        // The last point that is not inside the uneroded solid.
        let (mut low, mut above) = (t, value.max(0.0));
        for _ in 0..MAX_MARCH_STEPS {
            let safe = value * program.inverse_lipschitz;
            // A safe step cannot cross a surface. The minimum step can.
            if t + safe >= t_out {
                return None;
            }
            let next = (t + safe.max(MIN_STEP)).min(t_out);
            let there = field(next);
            if there < -ERODED {
                return Some(root(&mut field, low, above, next, there)).filter(|&t| t < t_out);
            }
            if next == t_out {
                return None;
            }
            (t, value) = (next, there);
            if value >= 0.0 {
                (low, above) = (t, value);
            }
        }
        None
    }

    /// Unit normal at the hit `p` of a ray with a part, in local space, which has the axes of the world; `None` where
    /// the gradient is zero.
    pub(crate) fn normal(&self, p: Vec3, direction: Vec3, part: u32, stack: &mut Stack<f64, 6>) -> Option<Vec3> {
        let part = &self.programs[part as usize];
        if part.form == PartKind::Field {
            let slope = slope(self.solid.precise(), &part.tokens, p.as_dvec3(), NORMAL_STEP, stack);
            return slope.try_normalize().map(|normal| normal.as_vec3());
        }
        // The surface belongs to the leaf whose field is nearest to zero. Where two leaves share it, their normals are
        // equal or opposite. A ray enters the solid from outside, so the normal points against it.
        let at = [[p.x], [p.y], [p.z]];
        let leaves = part.steps.iter().filter_map(|step| match *step {
            Step::Literal { leaf, .. } => Some(leaf),
            _ => None,
        });
        let value = |leaf: u32| self.solid.program.leaves[leaf as usize].distances(&at)[0].abs();
        let leaf = match *part.steps {
            [Step::Literal { leaf, .. }] => leaf,
            _ => leaves.map(|leaf| (value(leaf), leaf)).min_by(|a, b| a.0.total_cmp(&b.0))?.1,
        };
        let normal = leaf_slope(&self.solid.precise().leaves[leaf as usize], p.as_dvec3()).try_normalize()?.as_vec3();
        Some(if normal.dot(direction) > 0.0 { -normal } else { normal })
    }

    /// Linear RGB at a hit; `None` without paint.
    pub(crate) fn color(&self, p: Vec3, part: u32) -> Option<[f32; 3]> {
        if !self.solid.model.is_painted {
            return None;
        }
        let tokens = &self.programs[part as usize].tokens;
        self.solid.program.color(&self.solid.model, tokens, p.to_array())
    }

    /// Whether a world point is in the solid.
    pub(crate) fn is_inside(&self, world: DVec3) -> bool {
        let local = self.solid.frame.local(world);
        let [lower, upper] = self.bounds.map(Vec3::as_dvec3);
        if self.boxes.is_empty() || !(local.cmpge(lower).all() && local.cmple(upper).all()) {
            return false;
        }
        let at = local.to_array().map(|x| [x as f32]);
        self.solid.program.run(&self.solid.model.tokens, &at, &mut Stack::default())[0] < 0.0
    }
}

/// The root between `t0`, where the field is zero or more, and `t1`, where it is below: regula falsi, Illinois variant
/// (Dowell and Jarratt, 1971).
fn root(field: &mut impl FnMut(f32) -> f32, t0: f32, value0: f32, t1: f32, value1: f32) -> f32 {
    let (mut low, mut above) = (t0, value0);
    let (mut high, mut below) = (t1, value1);
    let mut last_side = 0;
    for _ in 0..MAX_ROOT_STEPS {
        if high - low <= ROOT_WIDTH * high.max(1.0) || below == 0.0 {
            break;
        }
        let t = (low + (high - low) * (above / (above - below))).clamp(low, high);
        // The next t is an end of the bracket: the root is exact to float32.
        if t == low || t == high {
            return t;
        }
        let value = field(t);
        if value > 0.0 {
            (low, above) = (t, value);
            if last_side == 1 {
                below *= 0.5;
            }
            last_side = 1;
        } else {
            (high, below) = (t, value);
            if last_side == -1 {
                above *= 0.5;
            }
            last_side = -1;
        }
    }
    high
}

/// Gradient of a leaf's field, of any length, by differences on a tetrahedron.
fn leaf_slope(leaf: &PlacedLeaf<f64>, p: DVec3) -> DVec3 {
    const CORNERS: [DVec3; 4] =
        [DVec3::new(1.0, -1.0, -1.0), DVec3::new(-1.0, -1.0, 1.0), DVec3::new(-1.0, 1.0, -1.0), DVec3::ONE];
    let at = [0, 1, 2].map(|axis| CORNERS.map(|corner| p[axis] + LEAF_STEP * corner[axis]));
    CORNERS.iter().zip(wide_distances(leaf, &at)).map(|(&corner, value)| value * corner).sum()
}

/// The distances of a leaf at four points, with the vector instructions of this machine.
fn wide_distances(leaf: &PlacedLeaf<f64>, at: &[[f64; 4]; 3]) -> [f64; 4] {
    with_vectors!((leaf: &PlacedLeaf<f64> = leaf, at: &[[f64; 4]; 3] = at) -> [f64; 4] { leaf.distances(at) })
}

/// A ray, with the inverse of its direction.
struct BoxRay {
    origin: Vec3A,
    inverse: Vec3A,
}

impl BoxRay {
    fn new(ray: &ShapeRay) -> Self {
        let still = Vec3A::splat(STILL);
        let direction = Vec3A::from(ray.direction);
        let inverse = Vec3A::select(direction.abs().cmplt(still), still, direction).recip();
        Self { origin: ray.origin.into(), inverse }
    }

    /// The interval of the ray in a box, cut to `[0, t_max]`. A ray in the common face of two boxes is in the upper
    /// one.
    #[inline(always)]
    fn span(&self, lower: Vec3A, upper: Vec3A, t_max: f32) -> Option<(f32, f32)> {
        let (a, b) = ((lower - self.origin) * self.inverse, (upper - self.origin) * self.inverse);
        let t_in = a.min(b).max_element().max(0.0);
        let t_out = a.max(b).min_element().min(t_max);
        (t_in < t_out).then_some((t_in, t_out))
    }
}
