//! The side of the surface on which a point lies.
//!
//! `auto` examines the topology once and chooses the strongest rule that applies:
//!
//! | surface | rule | exact |
//! |---|---|---|
//! | closed | winding number counted by rays ([`crossing`]) | yes, by exact predicates |
//! | few or long openings | the same with the openings closed, less the caps' angle ([`openings`]) | yes |
//! | soup | fast winding number ([`winding`]) | no: an estimate, less accurate near large smooth sheets |
//!
//! A point is inside if the magnitude of its winding number exceeds 1/2. Nested and overlapping parts are solid, a
//! reversed shell inside a solid is a cavity, and a mesh that is wound inside out is the same solid. The distance never
//! depends on the sign. `parity`, `pseudonormal` and `normal` exist for comparison; each module states where its rule
//! fails.

mod caps;
mod closing;
pub(crate) mod crossing;
pub(crate) mod openings;
pub(crate) mod pseudonormal;
pub(crate) mod raw;
pub(crate) mod winding;

#[cfg(test)]
mod tests;

use crate::bvh::nearest::closest::ClosestPoint;
use crate::error::{ArgumentError, choice};
use crate::geometry::triangle_cross;
use crate::gpu::constants::bake_brute::NUDGE;
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crossing::{Axes, ClosedSurface};
use glam::DVec3;
use openings::Openings;
use std::str::FromStr;

/// A rule by its public name.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SignMethod {
    /// The method that suits the mesh.
    #[default]
    Auto,
    /// Generalised winding number.
    Winding,
    /// Odd number of crossings, by a vote of three axes (article 003).
    Parity,
    /// Angle-weighted pseudonormal.
    Pseudonormal,
    /// Normal of the face that is nearest after each is nudged along its normal (article 001).
    Normal,
    /// No signs.
    Unsigned,
}

impl SignMethod {
    /// The public name of each method.
    pub const NAMES: [(&'static str, Self); 6] = [
        ("auto", Self::Auto),
        ("winding", Self::Winding),
        ("parity", Self::Parity),
        ("pseudonormal", Self::Pseudonormal),
        ("normal", Self::Normal),
        ("unsigned", Self::Unsigned),
    ];

    /// The public name.
    pub fn name(self) -> &'static str {
        Self::NAMES.iter().find(|(_, method)| *method == self).map_or("", |(name, _)| name)
    }
}

impl FromStr for SignMethod {
    type Err = ArgumentError;

    fn from_str(name: &str) -> Result<Self, ArgumentError> {
        choice("sign", name, &Self::NAMES)
    }
}

/// A rule bound to a mesh, ready for evaluation.
#[derive(Debug)]
pub enum SignRule {
    /// Winding number of a mesh whose openings, if any, are closed by caps.
    Counted(Openings),
    /// Fast winding number.
    Winding,
    /// Parity of crossings along rays.
    Parity,
    /// Angle-weighted pseudonormals.
    Pseudonormal,
    /// The normal of the nearest face, as in article 001.
    Normal,
    /// No signs.
    Unsigned,
}

/// A rule, its public method, and the reason for its choice.
#[derive(Debug)]
pub struct SignChoice {
    /// The rule that was chosen.
    pub rule: SignRule,
    /// The method that was requested.
    pub method: SignMethod,
    /// Reason for the choice.
    pub reason: String,
}

impl Derived for SignChoice {
    fn derive(mesh: &Mesh) -> Self {
        Self::new(mesh, SignMethod::Auto)
    }

    fn bytes(&self) -> usize {
        size_of::<Self>()
    }
}

impl Mesh {
    /// The winding number's rule for this surface, chosen at the first call.
    pub fn winding_choice(&self) -> &SignChoice {
        self.derived()
    }
}

impl SignChoice {
    /// Chooses the rule for a mesh.
    pub fn new(mesh: &Mesh, method: SignMethod) -> Self {
        let chosen = |rule| Self { rule, method, reason: "chosen by the caller".to_owned() };
        match method {
            SignMethod::Auto | SignMethod::Winding => Self::winding(mesh),
            SignMethod::Parity => chosen(SignRule::Parity),
            SignMethod::Pseudonormal => chosen(SignRule::Pseudonormal),
            SignMethod::Normal => chosen(SignRule::Normal),
            SignMethod::Unsigned => chosen(SignRule::Unsigned),
        }
    }

    /// The winding number by the cheapest method that is exact for the openings of the surface.
    fn winding(mesh: &Mesh) -> Self {
        let topology = mesh.topology();
        let rim = topology.rim.len();
        let (rule, reason) = if topology.closed {
            let reason = "the surface is closed: exact winding number by counted crossings".to_owned();
            (SignRule::Counted(Openings::default()), reason)
        } else if Openings::suit(mesh) {
            let how = "exact generalised winding number, openings closed by cones";
            (SignRule::Counted(Openings::of(mesh)), format!("the surface has {rim} open edges: {how}"))
        } else {
            (SignRule::Winding, format!("the surface has {rim} open edges: fast generalised winding number"))
        };
        Self { rule, method: SignMethod::Winding, reason }
    }
}

impl SignRule {
    /// Builds the tables of the rule before the samples are evaluated, so that their cost is reported separately.
    pub fn prepare(&self, mesh: &Mesh) {
        match self {
            Self::Winding => drop(mesh.moments()),
            Self::Pseudonormal => drop(mesh.pseudonormals()),
            Self::Counted(_) | Self::Parity | Self::Normal | Self::Unsigned => {}
        }
    }

    /// Whether a local point is inside, for the rules that do not use the closest point; false for the others.
    pub fn is_inside_without_distance(&self, mesh: &Mesh, p: DVec3) -> bool {
        match self {
            Self::Counted(openings) => {
                let (rounded, _) = openings.rounded_ball(p);
                openings.winding(mesh, p) != rounded
            }
            Self::Winding => mesh.moments().winding(mesh, p).abs() > 0.5,
            Self::Parity => parity(mesh, p).0,
            Self::Pseudonormal | Self::Normal | Self::Unsigned => false,
        }
    }

    /// Whether a local point is inside. `closest` is its closest point, which some rules use.
    pub fn is_inside(&self, mesh: &Mesh, p: DVec3, closest: &ClosestPoint) -> bool {
        match self {
            Self::Pseudonormal => mesh.pseudonormals().is_inside(mesh, p, closest),
            Self::Normal => is_behind_nudged_face(mesh, p, closest),
            _ => self.is_inside_without_distance(mesh, p),
        }
    }
}

/// Margin for the error of a distance whose face was chosen in float32, local units: six times the error.
const CARRY_MARGIN: f64 = 2e-6;

/// The sides of points that follow each other closely. The side of a point is carried over to the next one if no
/// surface lies between them.
#[derive(Debug, Default)]
pub struct SideWalk {
    /// The last point, its distance from the surface, and whether it is inside.
    last: Option<(DVec3, f64, bool)>,
    /// A ball in which the fraction of the openings has one nearest integer, and that contains no cap.
    fraction: Option<(DVec3, f64, i32)>,
}

impl SideWalk {
    /// [`SignRule::is_inside`] of the next point.
    pub fn is_inside(&mut self, rule: &SignRule, mesh: &Mesh, p: DVec3, closest: &ClosestPoint) -> bool {
        match rule {
            SignRule::Counted(openings) => self.carried_or_counted(openings, mesh, p, closest.distance),
            _ => rule.is_inside(mesh, p, closest),
        }
    }

    /// [`SignRule::is_inside_without_distance`] of the next point, at a distance from the surface, local units. Returns
    /// false for rules that need the closest point.
    pub fn is_inside_at(&mut self, rule: &SignRule, mesh: &Mesh, p: DVec3, distance: f64) -> bool {
        match rule {
            SignRule::Counted(openings) => self.carried_or_counted(openings, mesh, p, distance),
            _ => rule.is_inside_without_distance(mesh, p),
        }
    }

    fn carried_or_counted(&mut self, openings: &Openings, mesh: &Mesh, p: DVec3, distance: f64) -> bool {
        // Every point between two points is nearer to one of them than the surface is, if they are nearer to each other
        // than the sum of their distances. In the ball of the fraction no cap lies between them either.
        let is_clear = |&(q, other, _): &(DVec3, f64, bool)| {
            p.distance(q) < (distance + other) * (1.0 - 1e-5) - CARRY_MARGIN
                && self
                    .fraction
                    .is_some_and(|(center, radius, _)| p.distance(center) < radius && q.distance(center) < radius)
        };
        let inside = match self.last.filter(is_clear) {
            Some((_, _, inside)) => inside,
            None => self.counted(openings, mesh, p),
        };
        self.last = Some((p, distance, inside));
        inside
    }

    /// [`SignRule::is_inside_without_distance`] of the next point, by the tables of rays where a ray suffices.
    pub fn is_inside_by_ray(&mut self, rule: &SignRule, mesh: &Mesh, p: DVec3) -> bool {
        match rule {
            SignRule::Counted(openings) => match openings.winding_by_ray(mesh, p) {
                Some(winding) => winding != self.rounded(openings, p),
                None => self.counted(openings, mesh, p),
            },
            _ => rule.is_inside_without_distance(mesh, p),
        }
    }

    /// [`SignRule::is_inside_without_distance`] of the next point.
    pub fn is_inside_without_distance(&mut self, rule: &SignRule, mesh: &Mesh, p: DVec3) -> bool {
        match rule {
            SignRule::Counted(openings) => self.counted(openings, mesh, p),
            _ => rule.is_inside_without_distance(mesh, p),
        }
    }

    /// Whether a point is inside.
    fn counted(&mut self, openings: &Openings, mesh: &Mesh, p: DVec3) -> bool {
        openings.winding(mesh, p) != self.rounded(openings, p)
    }

    /// The nearest integer of the fraction, which is kept for the next points.
    fn rounded(&mut self, openings: &Openings, p: DVec3) -> i32 {
        if let Some((_, _, rounded)) = self.fraction.filter(|&(center, radius, _)| p.distance(center) < radius) {
            return rounded;
        }
        let (rounded, radius) = openings.rounded_ball(p);
        self.fraction = Some((p, radius * (1.0 - 1e-9), rounded));
        rounded
    }
}

/// Whether most of three axis-parallel rays cross an odd number of faces, and whether all three agree.
pub fn parity(mesh: &Mesh, p: DVec3) -> (bool, bool) {
    let surface = ClosedSurface::new(mesh, &[]);
    let votes = [Axes::X, Axes::Y, Axes::Z].iter().filter(|&&axes| surface.crossings(p, axes) % 2 == 1).count();
    (votes >= 2, votes == 0 || votes == 3)
}

/// Article 001: move the closest point of every face along its normal by a small step, take the nearest, and test the
/// side of that face. The step breaks ties at edges. Here it scales with the mesh.
fn is_behind_nudged_face(mesh: &Mesh, p: DVec3, closest: &ClosestPoint) -> bool {
    let mut best = (f64::INFINITY, u32::MAX, false);
    // A nudge changes a distance by at most its length, so no other face can become the nearest.
    let reach = (closest.distance + 2.0 * NUDGE) * (1.0 + 1e-6);
    mesh.bvh().faces_within(p.as_vec3(), reach as f32, |face| {
        // A face without area has no side.
        let Some(normal) = triangle_cross(mesh.triangle(face)).try_normalize() else { return };
        let q = mesh.closest_point_on_face(face, p).on_triangle.point;
        let nudged = (q + normal * NUDGE).distance(p);
        // Among equally near faces the lowest one decides, in any order of the faces.
        if nudged < best.0 || (nudged == best.0 && face < best.1) {
            best = (nudged, face, (p - q).dot(normal) < 0.0);
        }
    });
    best.2
}
