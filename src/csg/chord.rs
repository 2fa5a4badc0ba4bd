//! Where a line is inside a primitive, in closed form; and so inside what sharp operators make of a few of them.
//!
//! # Theory
//!
//! A line meets a convex solid in one stretch, its *chord*: that of a slab, a half space and a ball follow from a division or
//! a square root, the others are intersections of these. Operators combine chords as sets on the line (S. Roth, "Ray Casting
//! for Modeling Solids", 1982): only where a ray goes in or out of a leaf can it go in or out of the whole, so these places
//! are tried in order. The first one behind which it is inside is the hit: the root that marching would creep up to, found
//! without a step.
//!
//! Quadratics are solved about the point of the line that is nearest to the axis, so that nothing cancels but the size of the
//! model against itself: places are good to some roundings of float32 over the sine of the angle to the surface, like the
//! roots of the field.
//!
//! # Practice
//!
//! [`Form::of`] says whether a part can be done this way. The twin on graphics devices is `shaders/shared/csg_chord.wgsl`.

use super::model::Token;
use super::program::{Flat, Joint, LeafField, PlacedLeaf, Program};
use super::shape::Op;
use glam::{Vec2, Vec3};

/// Leaves of a part that is done this way at most; as many chords are kept, and no more bits wait on the stack.
pub const MAX_LEAVES: usize = 12;

/// Beyond any place on a ray through a model of size 1.
const FAR: f32 = 1e30;

/// Slower than this along an axis is standing still; the inverse of what is faster is finite.
const STILL: f32 = 1e-30;

/// The square of a slant, relative to a unit direction, that leaves nothing of the slant in float32.
const PARALLEL: f32 = 1e-14;

/// How rays meet a part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Form {
    /// By marching its field.
    Field,
    /// The nearest of the chords of its leaves.
    Union,
    /// By what its operators make of the chords.
    Chords,
}

impl Form {
    pub fn of(program: &Program<f32>, tokens: &[Token]) -> Self {
        let mut leaves = 0;
        let mut is_union = true;
        for &token in tokens {
            match token {
                Token::Leaf(leaf) if has_chord(&program.leaves[leaf as usize]) => leaves += 1,
                Token::Combine(i) if matches!(program.combines[i as usize].joint, Joint::Sharp) => {
                    is_union &= program.combines[i as usize].op == Op::Union;
                }
                Token::Complement => is_union = false,
                _ => return Self::Field,
            }
        }
        match leaves {
            0 => Self::Field,
            _ if leaves > MAX_LEAVES => Self::Field,
            _ if is_union => Self::Union,
            _ => Self::Chords,
        }
    }
}

/// The leaves of a part, each with whether the surface is its own or the other side of it; `None` where that depends.
pub fn sides(program: &Program<f32>, tokens: &[Token]) -> Option<Vec<(u32, bool)>> {
    let mut leaves: Vec<(u32, bool)> = Vec::new();
    // Where the leaves of each operand that waits begin.
    let mut waiting: Vec<usize> = Vec::new();
    let turn = |leaves: &mut [(u32, bool)]| leaves.iter_mut().for_each(|(_, is_own)| *is_own = !*is_own);
    for &token in tokens {
        match token {
            Token::Leaf(leaf) => {
                waiting.push(leaves.len());
                leaves.push((leaf, true));
            }
            Token::Combine(i) => {
                let combine = &program.combines[i as usize];
                let (top, below) = (waiting.pop()?, *waiting.last()?);
                match combine.op {
                    Op::Union | Op::Intersection => {}
                    // What is taken away is the second operand, which may have been put first.
                    Op::Difference if combine.is_swapped => turn(&mut leaves[below..top]),
                    Op::Difference => turn(&mut leaves[top..]),
                    Op::Xor => return None,
                }
            }
            Token::Complement => turn(&mut leaves[*waiting.last()?..]),
            _ => return None,
        }
    }
    Some(leaves)
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
        | LeafField::HexPrism
        | LeafField::Extrude(Flat::Circle(_) | Flat::Rectangle(_)) => true,
        LeafField::Box => leaf.parameters[3] == 0.0,
        _ => false,
    }
}

/// The first place in `[t_in, t_out)` where a line is inside a part of plain leaves.
pub fn first_inside(
    program: &Program<f32>,
    tokens: &[Token],
    form: Form,
    line: [Vec3; 2],
    [t_in, t_out]: [f32; 2],
) -> Option<f32> {
    if form == Form::Union {
        let mut nearest = t_out;
        for token in tokens {
            let Token::Leaf(leaf) = token else { continue };
            let chord = chord(&program.leaves[*leaf as usize], line);
            let from = chord.from.max(t_in);
            if from < chord.to && from < nearest {
                nearest = from;
            }
        }
        return (nearest < t_out).then_some(nearest);
    }

    let mut chords = [Chord::NONE; MAX_LEAVES];
    let leaves = tokens.iter().filter_map(|token| match token {
        Token::Leaf(leaf) => Some(*leaf),
        _ => None,
    });
    let mut count = 0;
    for leaf in leaves {
        chords[count] = chord(&program.leaves[leaf as usize], line);
        count += 1;
    }
    let mut t = t_in;
    while !is_inside(program, tokens, &chords, t) {
        let ends = chords[..count].iter().filter(|chord| !chord.is_empty()).flat_map(|chord| [chord.from, chord.to]);
        t = ends.filter(|&end| end > t).fold(t_out, f32::min);
        if t >= t_out {
            return None;
        }
    }
    Some(t)
}

/// Whether a line is inside right behind `t`; `chords` are those of the leaves in the order of the tokens.
fn is_inside(program: &Program<f32>, tokens: &[Token], chords: &[Chord; MAX_LEAVES], t: f32) -> bool {
    // A stack of bits, the top one last.
    let mut waiting = 0u32;
    let mut next = 0;
    for &token in tokens {
        match token {
            Token::Leaf(_) => {
                waiting = waiting << 1 | u32::from(chords[next].holds(t));
                next += 1;
            }
            Token::Combine(i) => {
                let combine = &program.combines[i as usize];
                let (top, below) = (waiting & 1, waiting >> 1 & 1);
                let (a, b) = if combine.is_swapped { (top, below) } else { (below, top) };
                let joined = match combine.op {
                    Op::Union => a | b,
                    Op::Intersection => a & b,
                    Op::Difference => a & !b,
                    Op::Xor => a ^ b,
                };
                waiting = waiting >> 2 << 1 | joined & 1;
            }
            _ => waiting ^= 1,
        }
    }
    waiting & 1 == 1
}

/// A stretch of a line; there is none where `from` is not before `to`.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Chord {
    from: f32,
    to: f32,
}

impl Chord {
    const ALL: Self = Self { from: -FAR, to: FAR };
    const NONE: Self = Self { from: FAR, to: -FAR };

    fn and(self, other: Self) -> Self {
        Self { from: self.from.max(other.from), to: self.to.min(other.to) }
    }

    fn is_empty(&self) -> bool {
        self.from >= self.to
    }

    fn holds(&self, t: f32) -> bool {
        self.from <= t && t < self.to
    }

    /// The least chord over two of one convex solid.
    fn hull(self, other: Self) -> Self {
        match (self.is_empty(), other.is_empty()) {
            (true, _) => other,
            (_, true) => self,
            _ => Self { from: self.from.min(other.from), to: self.to.max(other.to) },
        }
    }
}

/// The chord of a line in a leaf; `line` is its origin and its unit direction in local units.
fn chord(leaf: &PlacedLeaf<f32>, [origin, direction]: [Vec3; 2]) -> Chord {
    let p = &leaf.parameters;
    let shift = Vec3::from_array(leaf.shift);
    let [mut o, mut d] = [origin + shift, direction];
    if leaf.is_turned {
        let [x, y, z] = &leaf.rows;
        let (x, y, z) = (Vec3::from_array(*x), Vec3::from_array(*y), Vec3::from_array(*z));
        o = Vec3::new(x.dot(origin), y.dot(origin), z.dot(origin)) + shift;
        d = Vec3::new(x.dot(direction), y.dot(direction), z.dot(direction));
    }
    match &leaf.field {
        LeafField::Sphere => ball(o, d, p[0]),
        LeafField::Ellipsoid => {
            let inverse = Vec3::new(p[0], p[1], p[2]).recip();
            ball(o * inverse, d * inverse, 1.0)
        }
        LeafField::Box => cuboid(o, d, [p[0], p[1], p[2]]),
        LeafField::Cylinder => disc(o.truncate(), d.truncate(), p[0]).and(slab(o.z, d.z, p[1])),
        LeafField::Capsule => {
            let end = Vec3::new(0.0, 0.0, p[1]);
            let side = disc(o.truncate(), d.truncate(), p[0]).and(slab(o.z, d.z, p[1]));
            side.hull(ball(o - end, d, p[0])).hull(ball(o + end, d, p[0]))
        }
        LeafField::Cone => cone(o, d, [p[0], p[1], p[2]]),
        LeafField::Plane => half_space(o, d, Vec3::new(p[0], p[1], p[2]), p[3]),
        LeafField::Pyramid => {
            let [half, half_height, sin, cos] = [p[0], p[1], p[3], p[4]];
            let offset = half * cos - half_height * sin;
            let side = |x: f32, y: f32| half_space(o, d, Vec3::new(x, y, sin), offset);
            let base = half_space(o, d, Vec3::NEG_Z, half_height);
            base.and(side(cos, 0.0)).and(side(-cos, 0.0)).and(side(0.0, cos)).and(side(0.0, -cos))
        }
        LeafField::Octahedron => {
            let across = |n: Vec3| slab(n.dot(o), n.dot(d), p[0]);
            across(Vec3::new(1.0, 1.0, 1.0))
                .and(across(Vec3::new(1.0, 1.0, -1.0)))
                .and(across(Vec3::new(1.0, -1.0, 1.0)))
                .and(across(Vec3::new(-1.0, 1.0, 1.0)))
        }
        LeafField::HexPrism => {
            let across = |n: Vec2| slab(n.dot(o.truncate()), n.dot(d.truncate()), p[0]);
            let slant = 0.75f32.sqrt();
            slab(o.z, d.z, p[1])
                .and(across(Vec2::Y))
                .and(across(Vec2::new(slant, 0.5)))
                .and(across(Vec2::new(slant, -0.5)))
        }
        LeafField::Extrude(Flat::Circle(radius)) => disc(o.truncate(), d.truncate(), *radius).and(slab(o.z, d.z, p[0])),
        LeafField::Extrude(Flat::Rectangle(half)) => cuboid(o, d, [half[0], half[1], p[0]]),
        _ => unreachable!("told by Form::of"),
    }
}

/// Where `|o + t d| < half`. A line along a face is outside, where the field is zero and no less.
fn slab(o: f32, d: f32, half: f32) -> Chord {
    if d.abs() < STILL {
        return if o.abs() < half { Chord::ALL } else { Chord::NONE };
    }
    let inverse = 1.0 / d;
    let (a, b) = ((-half - o) * inverse, (half - o) * inverse);
    Chord { from: a.min(b), to: a.max(b) }
}

fn cuboid(o: Vec3, d: Vec3, half: [f32; 3]) -> Chord {
    slab(o.x, d.x, half[0]).and(slab(o.y, d.y, half[1])).and(slab(o.z, d.z, half[2]))
}

/// Where `normal . p < offset`.
fn half_space(o: Vec3, d: Vec3, normal: Vec3, offset: f32) -> Chord {
    let (rate, room) = (normal.dot(d), offset - normal.dot(o));
    if rate.abs() < STILL {
        return if room > 0.0 { Chord::ALL } else { Chord::NONE };
    }
    let t = (room / rate).clamp(-FAR, FAR);
    if rate > 0.0 { Chord { to: t, ..Chord::ALL } } else { Chord { from: t, ..Chord::ALL } }
}

/// Where a line is in a ball about zero, in any number of dimensions: from the squares of the direction and of the nearest
/// point of the line, which is at `middle`.
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
    if speed_squared < PARALLEL {
        return if o.length_squared() < radius * radius { Chord::ALL } else { Chord::NONE };
    }
    let middle = -o.dot(d) / speed_squared;
    round(middle, speed_squared, (o + middle * d).length_squared(), radius)
}

/// Between its ends a cone is where `x^2 + y^2 <= (middle + slope z)^2`.
fn cone(o: Vec3, d: Vec3, [low, high, half_height]: [f32; 3]) -> Chord {
    let ends = slab(o.z, d.z, half_height);
    if ends.is_empty() {
        return Chord::NONE;
    }
    let (middle, slope) = (0.5 * (low + high), 0.5 * (high - low) / half_height);
    // Solved about the point nearest to the axis, between the ends.
    let speed_squared = d.truncate().length_squared();
    let nearest = if speed_squared < PARALLEL { 0.0 } else { -o.truncate().dot(d.truncate()) / speed_squared };
    let start = nearest.clamp(ends.from, ends.to);
    let q = o + start * d;
    let (radius, widens) = (middle + slope * q.z, slope * d.z);
    let a = speed_squared - widens * widens;
    let b = q.truncate().dot(d.truncate()) - widens * radius;
    let c = q.truncate().length_squared() - radius * radius;
    let discriminant = b * b - a * c;
    if discriminant <= 0.0 {
        // Without roots the sign is that of the square term.
        return if a < 0.0 { ends } else { Chord::NONE };
    }
    // Roots without cancellation; the first is out of sight where the square term vanishes.
    let far = -(b + discriminant.sqrt().copysign(b));
    let first = if a == 0.0 { FAR.copysign(far) } else { (far / a).clamp(-FAR, FAR) };
    let second = if far == 0.0 { 0.0 } else { c / far };
    let (early, late) = (start + first.min(second), start + first.max(second));
    if a > 0.0 {
        return ends.and(Chord { from: early, to: late });
    }
    // Outside the roots, in one of the two halves of the double cone; the other is beyond the ends.
    let (before, after) = (Chord { to: early, ..ends }.and(ends), Chord { from: late, ..ends }.and(ends));
    if before.to - before.from > after.to - after.from { before } else { after }
}
