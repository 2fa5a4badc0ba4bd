//! Rays through a shape: the first root of its field, part by part.
//!
//! # Theory
//!
//! A ray walks a tree over the boxes of all parts, near child first, and marches each box it meets from the point of entry to
//! the point of exit (J. Hart, "Sphere Tracing", 1996): a step is the field over its Lipschitz constant, and at least
//! [`MIN_STEP`]. Only the smallest step can cross the surface; the root is then bracketed and found by regula falsi. So what is
//! returned is a root and not a place closer than some epsilon, and it does not depend on where the march began: the whole shape
//! and its parts give the same depth. What is thinner than [`MIN_STEP`] along the ray may be missed.
//!
//! A hit counts only inside its own box, from the face of entry up to and not including the face of exit. Neighbours have a face
//! in common bit for bit, so a root belongs to one of them: there is nothing to fight over in depth. A box that the nearest hit
//! lies before is not looked at.
//!
//! Everything is in local units and float32 along the ray.

use super::decompose::Part;
use super::model::Token;
use super::program::Stack;
use super::solid::{Solid, slope};
use glam::{DVec3, Vec3};

/// Shortest step, relative to a model of size 1/2 to 1: a hundred roundings of the field. A ray that dips into a sphere of the
/// model's size for less than this goes 1e-10 deep.
pub const MIN_STEP: f32 = 3e-5;

/// Steps in one box at most; reached only by a ray that creeps along a surface closer than a step.
pub const MAX_STEPS: u32 = 4096;

/// Halvings of the bracket at most; regula falsi needs a fraction of them.
const MAX_ROOT_STEPS: u32 = 32;

/// A bracket of this width is a root: an ulp of a position near 1.
const ROOT_WIDTH: f32 = 1.2e-7;

/// Half the step of a normal's differences in float64.
const NORMAL_STEP: f64 = 1e-5;

/// Boxes in a leaf of the tree at most.
const LEAF_BOXES: usize = 4;

/// A part's box in local units.
#[derive(Debug, Clone, Copy)]
pub struct LocalBox {
    pub lower: Vec3,
    pub upper: Vec3,
    pub part: u32,
}

/// A node of the tree over boxes: its children are nodes `first` and `first + 1`, or, in a leaf, `count` boxes from `first`.
#[derive(Debug, Clone, Copy)]
pub struct BoxNode {
    pub lower: Vec3,
    pub upper: Vec3,
    pub first: u32,
    pub count: u32,
}

/// A shape, split or whole, ready for rays.
#[derive(Debug)]
pub struct Tracer<'a> {
    pub solid: &'a Solid,
    pub programs: Vec<PartProgram>,
    pub boxes: Vec<LocalBox>,
    pub nodes: Vec<BoxNode>,
    /// Lower and upper corner of everything.
    pub bounds: [Vec3; 2],
}

/// What is evaluated in the boxes of a part.
#[derive(Debug)]
pub struct PartProgram {
    pub tokens: std::sync::Arc<[Token]>,
    pub leaves: u32,
    pub inverse_lipschitz: f32,
}

/// Part of a line, local units; `direction` is unit.
#[derive(Debug, Clone, Copy)]
pub struct LocalRay {
    pub origin: Vec3,
    pub direction: Vec3,
    pub t_max: f32,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hit {
    pub t: f32,
    pub part: u32,
}

/// What a ray cost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Work {
    /// Evaluations of a part's field.
    pub steps: u32,
    /// Evaluations of a leaf's.
    pub leaves: u64,
}

impl<'a> Tracer<'a> {
    /// Over the parts of a solid, whose boxes are in world units.
    pub fn new(solid: &'a Solid, parts: &[Part]) -> Self {
        let local = |p: DVec3| solid.frame.local(p).as_vec3();
        let mut boxes: Vec<LocalBox> = Vec::new();
        for (i, part) in parts.iter().enumerate() {
            boxes.extend(part.boxes.iter().map(|[lower, upper]| LocalBox {
                lower: local(*lower),
                upper: local(*upper),
                part: i as u32,
            }));
        }
        let programs = parts.iter().map(|part| PartProgram {
            leaves: part.tokens.iter().filter(|token| matches!(token, Token::Leaf(_))).count() as u32,
            inverse_lipschitz: (1.0 / solid.model.lipschitz_of(&part.tokens)) as f32,
            tokens: part.tokens.clone(),
        });
        let programs = programs.collect();
        let nodes = box_tree(&mut boxes);
        let bounds = nodes.first().map_or([Vec3::ZERO; 2], |root| [root.lower, root.upper]);
        Self { solid, programs, boxes, nodes, bounds }
    }

    /// The whole shape in one box, a little larger than its bounds.
    pub fn whole(solid: &'a Solid) -> Self {
        let extent = &solid.model.extent;
        if extent.is_empty() {
            return Self::new(solid, &[]);
        }
        let pad = DVec3::splat(1e-3 * (extent.upper - extent.lower).max_element());
        let bounds = [extent.lower - pad, extent.upper + pad];
        Self::new(solid, &[Part { tokens: solid.model.tokens.as_slice().into(), boxes: vec![bounds] }])
    }

    /// The first hit of a ray.
    pub fn first_hit(&self, ray: &LocalRay, stack: &mut Stack<f32, 1>, work: &mut Work) -> Option<Hit> {
        self.trace(ray, false, stack, work)
    }

    /// Whether anything is hit.
    pub fn is_hit(&self, ray: &LocalRay, stack: &mut Stack<f32, 1>, work: &mut Work) -> bool {
        self.trace(ray, true, stack, work).is_some()
    }

    fn trace(&self, ray: &LocalRay, any: bool, stack: &mut Stack<f32, 1>, work: &mut Work) -> Option<Hit> {
        let line = Line::new(ray);
        let mut best: Option<Hit> = None;
        let mut t_best = ray.t_max;
        let mut waiting = [(0u32, 0f32); 64];
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
                // The few boxes of a leaf in the order in which the ray meets them.
                let boxes = &self.boxes[node.first as usize..][..node.count as usize];
                let mut spans = [(0f32, 0f32, 0usize); LEAF_BOXES];
                let mut met = 0;
                for (i, candidate) in boxes.iter().enumerate() {
                    if let Some((t_in, t_out)) = line.span(candidate.lower, candidate.upper, t_best) {
                        spans[met] = (t_in, t_out, i);
                        met += 1;
                    }
                }
                spans[..met].sort_by(|a, b| a.0.total_cmp(&b.0));
                for &(t_in, t_out, i) in &spans[..met] {
                    if t_in < t_best
                        && let Some(t) = self.march(boxes[i].part, ray, t_in, t_out.min(t_best), stack, work)
                    {
                        t_best = t;
                        best = Some(Hit { t, part: boxes[i].part });
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

    /// The first root on `[t_in, t_out)` behind which the field is below zero; `t_in` itself if it is so there. Where the field
    /// touches zero and no more, as in `a - a`, there is nothing.
    fn march(
        &self,
        part: u32,
        ray: &LocalRay,
        t_in: f32,
        t_out: f32,
        stack: &mut Stack<f32, 1>,
        work: &mut Work,
    ) -> Option<f32> {
        let program = &self.programs[part as usize];
        let mut field = |t: f32| {
            work.steps += 1;
            work.leaves += u64::from(program.leaves);
            let p = ray.origin + t * ray.direction;
            self.solid.program.run(&program.tokens, &[[p.x], [p.y], [p.z]], stack)[0]
        };
        let mut t = t_in;
        let mut value = field(t);
        if value < 0.0 {
            return Some(t);
        }
        for _ in 0..MAX_STEPS {
            let safe = value * program.inverse_lipschitz;
            let next = t + safe.max(MIN_STEP);
            if next >= t_out {
                // A safe step crosses nothing; the smallest step might.
                if t + safe >= t_out {
                    return None;
                }
                let end = field(t_out);
                return if end < 0.0 {
                    Some(root(&mut field, t, value, t_out, end)).filter(|&t| t < t_out)
                } else {
                    None
                };
            }
            let there = field(next);
            if there < 0.0 {
                return Some(root(&mut field, t, value, next, there));
            }
            (t, value) = (next, there);
        }
        None
    }

    /// Unit normal at a hit, local space, which is turned like the world; `None` where the field has no slope.
    pub fn normal(&self, p: Vec3, part: u32, stack: &mut Stack<f64, 6>) -> Option<Vec3> {
        let tokens = &self.programs[part as usize].tokens;
        let slope = slope(self.solid.precise(), tokens, p.as_dvec3(), NORMAL_STEP, stack);
        slope.try_normalize().map(|normal| normal.as_vec3())
    }

    /// Linear RGB at a hit; `None` where there is no paint.
    pub fn color(&self, p: Vec3, part: u32) -> Option<[f32; 3]> {
        if self.solid.model.leaves.iter().all(|leaf| leaf.paint.is_none()) {
            return None;
        }
        let tokens = &self.programs[part as usize].tokens;
        self.solid.program.color(&self.solid.model, tokens, p.to_array())
    }

    /// Whether a world point is in the solid.
    pub fn is_inside(&self, world: DVec3) -> bool {
        let local = self.solid.frame.local(world);
        let [lower, upper] = self.bounds.map(Vec3::as_dvec3);
        if self.boxes.is_empty() || !(local.cmpge(lower).all() && local.cmple(upper).all()) {
            return false;
        }
        let at = local.to_array().map(|x| [x as f32]);
        self.solid.program.run(&self.solid.model.tokens, &at, &mut Stack::default())[0] < 0.0
    }
}

/// The root between a value of zero or more and one below: regula falsi, Illinois variant (Dowell and Jarratt, 1971).
fn root(field: &mut impl FnMut(f32) -> f32, t0: f32, value0: f32, t1: f32, value1: f32) -> f32 {
    let (mut low, mut above) = (t0, value0);
    let (mut high, mut below) = (t1, value1);
    let mut last_side = 0;
    for _ in 0..MAX_ROOT_STEPS {
        if high - low <= ROOT_WIDTH * high.max(1.0) || below == 0.0 {
            break;
        }
        let t = (low + (high - low) * (above / (above - below))).clamp(low, high);
        // The root is an end of the bracket as far as float32 can tell.
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

/// A ray and what does not change along it.
struct Line {
    origin: Vec3,
    inverse: Vec3,
    direction: Vec3,
}

impl Line {
    fn new(ray: &LocalRay) -> Self {
        Self { origin: ray.origin, direction: ray.direction, inverse: 1.0 / ray.direction }
    }

    /// Where the ray is in a box, from 0 to `t_max`. A ray along a face is in the box above it.
    fn span(&self, lower: Vec3, upper: Vec3, t_max: f32) -> Option<(f32, f32)> {
        let (mut t_in, mut t_out) = (0f32, t_max);
        for axis in 0..3 {
            if self.direction[axis] == 0.0 {
                if self.origin[axis] < lower[axis] || self.origin[axis] >= upper[axis] {
                    return None;
                }
                continue;
            }
            let a = (lower[axis] - self.origin[axis]) * self.inverse[axis];
            let b = (upper[axis] - self.origin[axis]) * self.inverse[axis];
            t_in = t_in.max(a.min(b));
            t_out = t_out.min(a.max(b));
        }
        (t_in < t_out).then_some((t_in, t_out))
    }
}

/// A tree over boxes, which it puts in order: halves along the longest side of the middles.
fn box_tree(boxes: &mut [LocalBox]) -> Vec<BoxNode> {
    if boxes.is_empty() {
        return Vec::new();
    }
    let over = |boxes: &[LocalBox], first: usize, count: usize| {
        let lower = boxes.iter().map(|b| b.lower).reduce(Vec3::min).unwrap_or_default();
        let upper = boxes.iter().map(|b| b.upper).reduce(Vec3::max).unwrap_or_default();
        BoxNode { lower, upper, first: first as u32, count: count as u32 }
    };
    let mut nodes = vec![over(boxes, 0, boxes.len())];
    let mut waiting = vec![0];
    while let Some(at) = waiting.pop() {
        let (first, count) = (nodes[at].first as usize, nodes[at].count as usize);
        if count <= LEAF_BOXES {
            continue;
        }
        let range = &mut boxes[first..first + count];
        let middle = |b: &LocalBox| b.lower + b.upper;
        let low = range.iter().map(middle).reduce(Vec3::min).unwrap_or_default();
        let high = range.iter().map(middle).reduce(Vec3::max).unwrap_or_default();
        let axis = (high - low).max_position();
        let half = count / 2;
        range.select_nth_unstable_by(half, |a, b| middle(a)[axis].total_cmp(&middle(b)[axis]));
        let (left, right) = (over(&range[..half], first, half), over(&range[half..], first + half, count - half));
        nodes[at].first = nodes.len() as u32;
        nodes[at].count = 0;
        waiting.extend([nodes.len(), nodes.len() + 1]);
        nodes.extend([left, right]);
    }
    nodes
}
