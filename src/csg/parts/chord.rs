//! Intersections of a line with a part in closed form: chords of convex leaves, combined by sharp operators.
//!
//! # Theory
//!
//! A line intersects a convex solid in one interval, its *chord*. The chords of a slab, a half space and a ball follow
//! from a division or a square root. The chords of the other leaves are intersections of these. Operators combine
//! chords as sets on the line (S. Roth, "Ray Casting for Modeling Solids", 1982). Membership in the whole can change
//! only at an end of a chord. So the ends are tried in increasing order, and the first end behind which the line is
//! inside is the hit.
//!
//! *Normal form.* A part is a tree of unions and intersections of *literals*. A literal is a leaf or the complement of
//! a leaf: De Morgan's laws push complements down to the leaves, `a - b` is `a & !b`, and `a ^ b` is
//! `(a & !b) | (!a & b)`.
//!
//! *Erosion.* Faces that coincide in the model have float32 positions that differ by rounding. Exact set operations on
//! such chords leave slivers, for example a film over the mouth of a pocket. Therefore each leaf is shrunk by
//! [`ERODED`], and each complemented leaf is grown by it. The solid that is hit is a subset of the true one, its
//! surface is moved by [`ERODED`] at most, and what remains between coincident faces is empty at every angle of the
//! ray, because the erosion acts along the normal and not along the ray. For sharp operators this solid is
//! `field < -ERODED`, which is also the condition of the march ([`super::trace`]). A wall thinner than `2 * ERODED`
//! disappears. A hit has the depth of the uneroded face.
//!
//! Quadratics are solved about the point of the line that is nearest to the axis, which avoids cancellation. Hits are
//! good to a few roundings of float32 over the sine of the angle between the line and the surface.
//!
//! # Practice
//!
//! [`PartKind::of`] determines whether a part has a closed form. The twin on graphics devices is
//! `shaders/shared/csg/csg_chord.wgsl`.

use crate::csg::evaluation::leaf::{Flat, LeafField, PlacedLeaf};
use crate::csg::evaluation::program::{Joint, Program};
use crate::csg::model::token::{Operation, Token, fold_postfix};
use crate::csg::tree::kind::Op;
use crate::gpu::constants::csg_chord::{CHORD_FAR, CHORD_PARALLEL, CHORD_STILL};
pub(crate) use crate::gpu::constants::csg_root::ERODED;
use glam::{Vec2, Vec3};

/// Largest number of literals of a part in closed form. A search keeps the chord of each literal and a bit per literal.
pub(crate) const MAX_LEAVES: usize = 12;

/// Method for intersecting rays with a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PartKind {
    /// Sphere tracing of its field.
    Field,
    /// Nearest chord of its leaves.
    Union,
    /// Boolean combination of the chords of its literals.
    Chords,
}

/// One step of a part in normal form, in postfix order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Step {
    /// Pushes a literal: whether a point is in the leaf, or outside it for a complement.
    Literal { leaf: u32, is_complement: bool },
    /// Replaces the two topmost values by their disjunction.
    Union,
    /// Replaces the two topmost values by their conjunction.
    Intersection,
}

impl PartKind {
    pub(crate) fn of(program: &Program<f32>, tokens: &[Token]) -> Self {
        let (mut leaves, mut is_union, mut has_xor) = (0, true, false);
        for &token in tokens {
            match token {
                Token::Leaf(leaf) if has_chord(&program.leaves[leaf as usize]) => leaves += 1,
                Token::Combine(i) if matches!(program.combines[i as usize].joint, Joint::Sharp) => {
                    is_union &= program.combines[i as usize].op == Op::Union;
                    has_xor |= program.combines[i as usize].op == Op::Xor;
                }
                Token::Complement => is_union = false,
                _ => return Self::Field,
            }
        }
        match leaves {
            0 => Self::Field,
            _ if leaves > MAX_LEAVES => Self::Field,
            // Only an xor repeats leaves.
            _ if has_xor && steps(program, tokens).is_none() => Self::Field,
            _ if is_union => Self::Union,
            _ => Self::Chords,
        }
    }
}

/// The normal form of a part of leaves under sharp operators; `None` if it has more than [`MAX_LEAVES`] literals.
pub(crate) fn steps(program: &Program<f32>, tokens: &[Token]) -> Option<Vec<Step>> {
    let join = |a: &[Step], b: &[Step], step: Step| [a, b, &[step]].concat();
    // The steps of each operand, and of its complement.
    let both = fold_postfix::<[Vec<Step>; 2]>(tokens, |operation| {
        let both = match operation {
            Operation::Leaf(leaf) => [false, true].map(|is_complement| vec![Step::Literal { leaf, is_complement }]),
            Operation::Combine(i, below, top) => {
                let combine = &program.combines[i as usize];
                let ([a, not_a], [b, not_b]) = if combine.is_swapped { (top, below) } else { (below, top) };
                let or = |a: &[Step], b: &[Step]| join(a, b, Step::Union);
                let and = |a: &[Step], b: &[Step]| join(a, b, Step::Intersection);
                match combine.op {
                    Op::Union => [or(&a, &b), and(&not_a, &not_b)],
                    Op::Intersection => [and(&a, &b), or(&not_a, &not_b)],
                    Op::Difference => [and(&a, &not_b), or(&not_a, &b)],
                    Op::Xor => [or(&and(&a, &not_b), &and(&not_a, &b)), or(&and(&a, &b), &and(&not_a, &not_b))],
                }
            }
            Operation::Complement([operand, complement]) => [complement, operand],
            Operation::DistanceOp(..) | Operation::Warp(..) => return None,
        };
        // A normal form with `n` literals has `2 n - 1` steps.
        (both[0].len() < 2 * MAX_LEAVES).then_some(both)
    });
    both.map(|[operand, _]| operand)
}

/// Whether a leaf is convex and has a closed form here.
fn has_chord(leaf: &PlacedLeaf<f32>) -> bool {
    match &leaf.field {
        LeafField::Sphere
        | LeafField::Ellipsoid
        | LeafField::Cylinder
        | LeafField::Capsule
        | LeafField::Cone
        | LeafField::Plane
        | LeafField::Pyramid
        | LeafField::Octahedron
        | LeafField::HexPrism => true,
        // Neither taper nor chamfers.
        LeafField::Extrude(Flat::Circle(_) | Flat::Rectangle(_)) => leaf.parameters[5] == 0.0,
        LeafField::Box => leaf.parameters[3] == 0.0,
        _ => false,
    }
}

/// The first point in `[t_in, t_out)` where a line is inside a part of form `form`, which is not [`PartKind::Field`].
pub(crate) fn first_inside(
    program: &Program<f32>,
    steps: &[Step],
    form: PartKind,
    line: [Vec3; 2],
    [t_in, t_out]: [f32; 2],
) -> Option<f32> {
    let literals = steps.iter().filter_map(|step| match *step {
        Step::Literal { leaf, is_complement } => Some((&program.leaves[leaf as usize], is_complement)),
        _ => None,
    });
    if form == PartKind::Union {
        let mut nearest = t_out;
        for (leaf, _) in literals {
            // A union removes nothing, so there are no slivers and no erosion is needed.
            let chord = chord(leaf, line, 0.0);
            let from = chord.from.max(t_in);
            if from < chord.to && from < nearest {
                nearest = from;
            }
        }
        return (nearest < t_out).then_some(nearest);
    }

    let mut chords = [Chord::NONE; MAX_LEAVES];
    let mut count = 0;
    for (leaf, is_complement) in literals.clone() {
        chords[count] = chord(leaf, line, if is_complement { ERODED } else { -ERODED });
        count += 1;
    }
    let mut t = t_in;
    while !is_inside(steps, &chords, t) {
        let ends = chords[..count].iter().filter(|chord| !chord.is_empty()).flat_map(|chord| [chord.from, chord.to]);
        t = ends.filter(|&end| end > t).fold(t_out, f32::min);
        if t >= t_out {
            return None;
        }
    }
    if t == t_in {
        return Some(t);
    }
    // The depth of the hit is the end of the uneroded chord. It precedes the end of the eroded chord, or of the grown
    // chord of a complement.
    let (owner, (leaf, _)) = literals.enumerate().find(|&(i, _)| chords[i].from == t || chords[i].to == t)?;
    let whole = chord(leaf, line, 0.0);
    let end = if chords[owner].from == t { whole.from } else { whole.to };
    Some(end.clamp(t_in, t))
}

/// Whether a line is inside immediately behind `t`; `chords` has one entry per literal, in the order of the steps.
fn is_inside(steps: &[Step], chords: &[Chord; MAX_LEAVES], t: f32) -> bool {
    // A stack of bits; the top is bit 0.
    let mut bits = 0u32;
    let mut next = 0;
    for &step in steps {
        match step {
            Step::Literal { is_complement, .. } => {
                bits = bits << 1 | u32::from(chords[next].holds(t) != is_complement);
                next += 1;
            }
            Step::Union => bits = bits >> 1 | bits & 1,
            Step::Intersection => bits = bits >> 1 & (bits | !1),
        }
    }
    bits & 1 == 1
}

/// An interval `[from, to)` on a line; empty unless `from < to`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Chord {
    from: f32,
    to: f32,
}

impl Chord {
    const ALL: Self = Self { from: -CHORD_FAR, to: CHORD_FAR };
    const NONE: Self = Self { from: CHORD_FAR, to: -CHORD_FAR };

    fn and(self, other: Self) -> Self {
        Self { from: self.from.max(other.from), to: self.to.min(other.to) }
    }

    fn is_empty(&self) -> bool {
        self.from >= self.to
    }

    fn holds(&self, t: f32) -> bool {
        self.from <= t && t < self.to
    }

    /// The smallest chord that contains both. The two are pieces of one convex solid.
    fn hull(self, other: Self) -> Self {
        match (self.is_empty(), other.is_empty()) {
            (true, _) => other,
            (_, true) => self,
            _ => Self { from: self.from.min(other.from), to: self.to.max(other.to) },
        }
    }
}

/// The chord of a line in a leaf whose surface is moved outwards by `grow`, or inwards where that is negative. `line`
/// is the origin and the unit direction, local units.
fn chord(leaf: &PlacedLeaf<f32>, [origin, direction]: [Vec3; 2], grow: f32) -> Chord {
    let p = &leaf.parameters;
    let shift = Vec3::from_array(leaf.shift);
    let [mut o, mut d] = [origin + shift, direction];
    if leaf.is_turned {
        let [x, y, z] = &leaf.rows;
        let (x, y, z) = (Vec3::from_array(*x), Vec3::from_array(*y), Vec3::from_array(*z));
        o = Vec3::new(x.dot(origin), y.dot(origin), z.dot(origin)) + shift;
        d = Vec3::new(x.dot(direction), y.dot(direction), z.dot(direction));
    }
    let grown = |size: f32| (size + grow).max(0.0);
    match &leaf.field {
        LeafField::Sphere => ball(o, d, grown(p[0])),
        LeafField::Ellipsoid => {
            let inverse = (Vec3::new(p[0], p[1], p[2]) + grow).recip();
            ball(o * inverse, d * inverse, 1.0)
        }
        LeafField::Box => cuboid(o, d, [grown(p[0]), grown(p[1]), grown(p[2])]),
        LeafField::Cylinder => disc(o.truncate(), d.truncate(), grown(p[0])).and(slab(o.z, d.z, grown(p[1]))),
        LeafField::Capsule => {
            let (end, radius) = (Vec3::new(0.0, 0.0, p[1]), grown(p[0]));
            let side = disc(o.truncate(), d.truncate(), radius).and(slab(o.z, d.z, p[1]));
            side.hull(ball(o - end, d, radius)).hull(ball(o + end, d, radius))
        }
        LeafField::Cone => cone(o, d, [grown(p[0]), grown(p[1]), grown(p[2])]),
        LeafField::Plane => half_space(o, d, Vec3::new(p[0], p[1], p[2]), p[3] + grow),
        LeafField::Pyramid => {
            let [half, half_height, sin, cos] = [p[0], p[1], p[3], p[4]];
            let offset = half * cos - half_height * sin + grow;
            let side = |x: f32, y: f32| half_space(o, d, Vec3::new(x, y, sin), offset);
            let base = half_space(o, d, Vec3::NEG_Z, half_height + grow);
            base.and(side(cos, 0.0)).and(side(-cos, 0.0)).and(side(0.0, cos)).and(side(0.0, -cos))
        }
        LeafField::Octahedron => {
            // The normals below have length sqrt(3).
            let half = (p[0] + 3f32.sqrt() * grow).max(0.0);
            let across = |n: Vec3| slab(n.dot(o), n.dot(d), half);
            across(Vec3::new(1.0, 1.0, 1.0))
                .and(across(Vec3::new(1.0, 1.0, -1.0)))
                .and(across(Vec3::new(1.0, -1.0, 1.0)))
                .and(across(Vec3::new(-1.0, 1.0, 1.0)))
        }
        LeafField::HexPrism => {
            let across = |n: Vec2| slab(n.dot(o.truncate()), n.dot(d.truncate()), grown(p[0]));
            let slant = 0.75f32.sqrt();
            slab(o.z, d.z, grown(p[1]))
                .and(across(Vec2::Y))
                .and(across(Vec2::new(slant, 0.5)))
                .and(across(Vec2::new(slant, -0.5)))
        }
        LeafField::Extrude(Flat::Circle(radius)) => {
            disc(o.truncate(), d.truncate(), grown(*radius)).and(slab(o.z, d.z, grown(p[0])))
        }
        LeafField::Extrude(Flat::Rectangle(half)) => cuboid(o, d, [grown(half[0]), grown(half[1]), grown(p[0])]),
        _ => unreachable!("Form::of admits only leaves with a chord"),
    }
}

/// The interval where `|o + t d| < half`. A line in the plane of a face is outside, because the field is zero there and
/// not below.
fn slab(o: f32, d: f32, half: f32) -> Chord {
    if d.abs() < CHORD_STILL {
        return if o.abs() < half { Chord::ALL } else { Chord::NONE };
    }
    let inverse = 1.0 / d;
    let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
    Chord { from: a.min(b), to: a.max(b) }
}

fn cuboid(o: Vec3, d: Vec3, half: [f32; 3]) -> Chord {
    slab(o.x, d.x, half[0]).and(slab(o.y, d.y, half[1])).and(slab(o.z, d.z, half[2]))
}

/// The interval where `normal . p < offset`.
fn half_space(o: Vec3, d: Vec3, normal: Vec3, offset: f32) -> Chord {
    let (rate, room) = (normal.dot(d), offset - normal.dot(o));
    if rate.abs() < CHORD_STILL {
        return if room > 0.0 { Chord::ALL } else { Chord::NONE };
    }
    let t = (room / rate).clamp(-CHORD_FAR, CHORD_FAR);
    if rate > 0.0 { Chord { to: t, ..Chord::ALL } } else { Chord { from: t, ..Chord::ALL } }
}

/// The chord in a ball about zero, in any number of dimensions. `middle` is the parameter of the point of the line
/// nearest to zero, `nearest_squared` its squared distance from zero, `speed_squared` the squared length of the
/// direction.
fn round(middle: f32, speed_squared: f32, nearest_squared: f32, radius: f32) -> Chord {
    let room = radius * radius - nearest_squared;
    if room <= 0.0 {
        return Chord::NONE;
    }
    let half = (room / speed_squared).sqrt();
    Chord { from: middle - half, to: middle + half }
}

fn ball(o: Vec3, d: Vec3, radius: f32) -> Chord {
    let speed_squared = d.length_squared();
    let middle = -o.dot(d) / speed_squared;
    round(middle, speed_squared, (o + middle * d).length_squared(), radius)
}

fn disc(o: Vec2, d: Vec2, radius: f32) -> Chord {
    let speed_squared = d.length_squared();
    if speed_squared < CHORD_PARALLEL {
        return if o.length_squared() < radius * radius { Chord::ALL } else { Chord::NONE };
    }
    let middle = -o.dot(d) / speed_squared;
    round(middle, speed_squared, (o + middle * d).length_squared(), radius)
}

/// The chord in a cone: `x^2 + y^2 <= (middle + slope z)^2` between its ends. `low` and `high` are its radii there.
fn cone(o: Vec3, d: Vec3, [low, high, half_height]: [f32; 3]) -> Chord {
    let ends = slab(o.z, d.z, half_height);
    if ends.is_empty() {
        return Chord::NONE;
    }
    let (middle, slope) = (0.5 * (low + high), 0.5 * (high - low) / half_height);
    // The quadratic is solved about the point nearest to the axis, clamped to the two ends.
    let speed_squared = d.truncate().length_squared();
    let nearest = if speed_squared < CHORD_PARALLEL { 0.0 } else { -o.truncate().dot(d.truncate()) / speed_squared };
    let start = nearest.clamp(ends.from, ends.to);
    let q = o + start * d;
    let (radius, widens) = (middle + slope * q.z, slope * d.z);
    let a = speed_squared - widens * widens;
    let b = q.truncate().dot(d.truncate()) - widens * radius;
    let c = q.truncate().length_squared() - radius * radius;
    let discriminant = b * b - a * c;
    if discriminant <= 0.0 {
        // Without roots the function has the sign of the quadratic term.
        return if a < 0.0 { ends } else { Chord::NONE };
    }
    // Roots without cancellation. The first is at infinity if the quadratic term vanishes.
    let far = -(b + discriminant.sqrt().copysign(b));
    let first = if a == 0.0 { CHORD_FAR.copysign(far) } else { (far / a).clamp(-CHORD_FAR, CHORD_FAR) };
    let second = if far == 0.0 { 0.0 } else { c / far };
    let (early, late) = (start + first.min(second), start + first.max(second));
    if a > 0.0 {
        return ends.and(Chord { from: early, to: late });
    }
    // The chord lies outside the roots, in one of the two halves of the double cone. The other half lies beyond the
    // ends.
    let (before, after) = (Chord { to: early, ..ends }.and(ends), Chord { from: late, ..ends }.and(ends));
    if before.to - before.from > after.to - after.from { before } else { after }
}
