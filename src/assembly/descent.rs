//! A local minimum of the larger distance of two solids, and the normal of contact there.
//!
//! # Theory
//!
//! Let a and b be signed distances, f = max(a, b), and x a local minimum of f. A convex combination of the gradients of
//! a and b that are active at x is zero: u + w = 0, where u belongs to b and w to a. If a moves by v, the minimum
//! changes by u . v (J. Danskin, "The Theory of Max-Min", 1966), so u is a direction from b to a. At an edge and at a
//! corner a solid has several gradients. A single one, evaluated at x, is therefore arbitrary.
//!
//! A bundle method finds x and the combination together (C. Lemarechal, "Nonsmooth Optimization and Descent Methods",
//! 1978). Each evaluation adds the tangents of a and b, and the largest tangent plus |step|^2 / (2 reach) is a convex
//! model of f. Its dual is the smallest reach |g|^2 / 2 - offset over all convex combinations of tangents, with the
//! gradient g and the value `offset` at x. The step is -reach g. A step that does not decrease f adds the tangents that
//! the model lacks.
//!
//! # Practice
//!
//! Distances from solids that are not convex may lie below their tangents. A tangent is therefore lowered to the
//! distance at x, and the reach shrinks after a step without decrease.

use super::solid::{Solid, Value};
use glam::DVec3;

/// Largest number of steps of a descent. Steps along curved valleys shrink the distance to the minimum by a constant
/// factor, and reach the rounding of distances after about a hundred.
const MAX_STEPS: usize = 200;
/// Largest number of steps within [`CONTACT`] of a minimum. They add gradients of faces, of which a contact has few.
const CONTACT_STEPS: usize = 100;
/// Largest number of tangents of a model. Four are active in three dimensions; the others save evaluations.
const MAX_TANGENTS: usize = 16;
/// Largest number of exchanges of weight between two tangents.
const MAX_EXCHANGES: usize = 400;
/// Share of reach |g|^2, at most twice the predicted decrease, to which weights are computed. It is below [`ACCEPTED`],
/// so it decides no step.
const BALANCED: f64 = 1e-3;
/// Share of the predicted decrease that moves the place (Lemarechal's rule with the usual constant).
const ACCEPTED: f64 = 0.1;
/// Factor of the reach after a step without decrease.
const SHRINKS: f64 = 0.7;
/// Share of the size to which the value is computed: tenfold the rounding of distances.
const PRECISION: f64 = 1e-14;
/// Share of the size within which gradients belong to one contact. The gradient of a mesh there is accurate to the
/// rounding of its distance divided by this, 1e-11. The gradient of a curved surface turns by this divided by its
/// radius, in parts of the size.
pub(super) const CONTACT: f64 = 1e-5;
/// Predicted decrease at a contact, relative to the reach: the root of its double, 1e-5, bounds |u + w|.
const STATIONARY: f64 = 5e-11;
/// Length of u and w below which no combination is zero: one solid contains the ball of the other.
const NO_CONTACT: f64 = 1e-3;

/// The tangent of a distance.
struct Tangent {
    of_first: bool,
    point: DVec3,
    value: Value,
    /// Share of the convex combination.
    weight: f64,
}

/// The end of a descent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Descent {
    pub(super) at: DVec3,
    pub(super) value: f64,
}

/// Descends from a place to a local minimum of f. `reach` is the length of the first step.
pub(super) fn descend(a: &mut Solid<'_>, b: &mut Solid<'_>, start: DVec3, reach: f64, size: f64) -> Descent {
    let mut bundle = Bundle::new(a, b, start);
    bundle.steps(a, b, reach, PRECISION * size, false);
    Descent { at: bundle.at, value: bundle.value() }
}

/// The unit vector from the second solid to the first at the local minimum of f near a place; none where one solid
/// alone limits the value.
pub(super) fn contact_normal(a: &mut Solid<'_>, b: &mut Solid<'_>, at: DVec3, size: f64) -> Option<DVec3> {
    let mut bundle = Bundle::new(a, b, at);
    let reach = CONTACT * size;
    bundle.steps(a, b, reach, PRECISION * size, false);
    bundle.steps(a, b, reach, STATIONARY * reach, true);
    let [w, u] = bundle.combinations();
    let has_normal = u.length() > NO_CONTACT && w.length() > NO_CONTACT;
    if has_normal { (u - w).try_normalize() } else { None }
}

/// Tangents around a place.
struct Bundle {
    at: DVec3,
    here: [Value; 2],
    tangents: Vec<Tangent>,
}

impl Bundle {
    fn new(a: &mut Solid<'_>, b: &mut Solid<'_>, at: DVec3) -> Self {
        let here = [a.value(at), b.value(at)];
        let mut bundle = Self { at, here, tangents: Vec::with_capacity(MAX_TANGENTS + 2) };
        bundle.add(at, here);
        let active = usize::from(here[1].distance > here[0].distance);
        bundle.tangents[active].weight = 1.0;
        bundle
    }

    fn value(&self) -> f64 {
        self.here[0].distance.max(self.here[1].distance)
    }

    fn add(&mut self, point: DVec3, values: [Value; 2]) {
        for (value, of_first) in values.into_iter().zip([true, false]) {
            self.tangents.push(Tangent { of_first, point, value, weight: 0.0 });
        }
    }

    /// Steps until the model predicts a decrease of at most `precision`. With `is_fixed` the reach stays.
    fn steps(&mut self, a: &mut Solid<'_>, b: &mut Solid<'_>, mut reach: f64, precision: f64, is_fixed: bool) {
        for _ in 0..if is_fixed { CONTACT_STEPS } else { MAX_STEPS } {
            let offsets = self.offsets();
            self.balance(&offsets, reach, 0.1 * precision);
            let step = -reach * self.combinations().iter().sum::<DVec3>();
            let model =
                self.tangents.iter().zip(&offsets).map(|(tangent, offset)| offset + tangent.value.gradient.dot(step));
            let predicted = self.value() - model.fold(f64::NEG_INFINITY, f64::max);
            // Also ends at a distance that is no number.
            if predicted.is_nan() || predicted <= precision {
                break;
            }
            let next = self.at + step;
            let values = [a.value(next), b.value(next)];
            let decrease = self.value() - values[0].distance.max(values[1].distance);
            self.add(next, values);
            if decrease >= ACCEPTED * predicted {
                (self.at, self.here) = (next, values);
                reach *= if is_fixed { 1.0 } else { 2.0 };
            } else if !is_fixed {
                reach *= SHRINKS;
            }
            self.forget();
        }
    }

    /// Values of the tangents at the place.
    fn offsets(&self) -> Vec<f64> {
        let offset = |tangent: &Tangent| {
            let own = self.here[usize::from(!tangent.of_first)].distance;
            own.min(tangent.value.distance + tangent.value.gradient.dot(self.at - tangent.point))
        };
        self.tangents.iter().map(offset).collect()
    }

    /// The weights of the smallest reach |g|^2 / 2 - offset. The pair of tangents with the largest difference of slopes
    /// exchanges weight until the difference is below `precision`, or small beside the decrease by the step.
    fn balance(&mut self, offsets: &[f64], reach: f64, precision: f64) {
        let mut combined: DVec3 = self.combinations().iter().sum();
        for _ in 0..MAX_EXCHANGES {
            let slope = |i: usize| reach * self.tangents[i].value.gradient.dot(combined) - offsets[i];
            let (mut lowest, mut highest) = ((f64::INFINITY, 0), (f64::NEG_INFINITY, 0));
            for i in 0..self.tangents.len() {
                let slope = slope(i);
                if slope < lowest.0 {
                    lowest = (slope, i);
                }
                if self.tangents[i].weight > 0.0 && slope > highest.0 {
                    highest = (slope, i);
                }
            }
            let gap = highest.0 - lowest.0;
            if gap.is_nan() || gap <= precision.max(BALANCED * reach * combined.length_squared()) {
                break;
            }
            let change = self.tangents[lowest.1].value.gradient - self.tangents[highest.1].value.gradient;
            let best = gap / (reach * change.length_squared());
            let moved = best.min(self.tangents[highest.1].weight);
            self.tangents[highest.1].weight -= moved;
            self.tangents[lowest.1].weight += moved;
            combined += moved * change;
        }
    }

    /// The weighted sums of the gradients of both solids.
    fn combinations(&self) -> [DVec3; 2] {
        [true, false].map(|of_first| {
            let own = self.tangents.iter().filter(|tangent| tangent.of_first == of_first);
            own.map(|tangent| tangent.weight * tangent.value.gradient).sum()
        })
    }

    /// Drops the oldest tangents without weight.
    fn forget(&mut self) {
        let mut surplus = self.tangents.len().saturating_sub(MAX_TANGENTS);
        self.tangents.retain(|tangent| {
            let is_dropped = surplus > 0 && tangent.weight == 0.0;
            surplus -= usize::from(is_dropped);
            !is_dropped
        });
    }
}
