//! A shape evaluated at single points in float64: the distance, and the distance with its gradient.

use super::solid::Solid;
use crate::csg::evaluation::dual::{ASIDE, Dual};
use crate::csg::evaluation::program::{Program, Stack};
use glam::DVec3;
use std::sync::Arc;

/// A shape with programs for values and for slopes. Immutable, and shared between threads.
#[derive(Debug)]
pub struct ClosedForm {
    solid: Arc<Solid>,
    slopes: Program<Dual>,
}

/// The value of a field at a point, with its gradient.
#[derive(Debug, Clone, Copy)]
pub struct Tangent {
    /// The value, world units.
    pub distance: f64,
    /// The gradient, divided by its length.
    pub gradient: DVec3,
    /// Largest amount by which the plane through the value with this gradient lies above a convex distance.
    pub error: f64,
}

/// A slope whose length differs by more from 1 is not the gradient of a distance.
const UNIT: f64 = 1e-6;

/// Length of the step to a point beside one, as a fraction of its largest coordinate, at least of the local unit.
const BESIDE: f64 = 1e-9;

/// Memory of one thread that evaluates closed forms.
#[derive(Debug, Default)]
pub struct Scratch {
    values: Stack<f64, 1>,
    slopes: Stack<Dual, 1>,
}

impl ClosedForm {
    /// Compiles the program for slopes.
    pub fn new(solid: Arc<Solid>) -> Self {
        let slopes = Program::new(&solid.model, solid.frame);
        Self { solid, slopes }
    }

    /// The shape.
    pub fn solid(&self) -> &Solid {
        &self.solid
    }

    /// The value of the field at a world point.
    pub fn distance(&self, p: DVec3, scratch: &mut Scratch) -> f64 {
        let at = self.solid.frame.local(p).to_array().map(|x| [x]);
        let [value] = self.solid.precise().run(&self.solid.model.tokens, &at, &mut scratch.values);
        value * self.solid.frame.scale
    }

    /// The value and the unit gradient of the field at a world point.
    ///
    /// The slope of a distance has length 1, except where several points of the surface are nearest, as on the axis of
    /// a cone. There the slope at a point beside it is the gradient of one side.
    pub fn tangent(&self, p: DVec3, scratch: &mut Scratch) -> Tangent {
        let local = self.solid.frame.local(p);
        let mut slope_at = |local: DVec3| {
            let at = Dual::position(local).map(|x| [x]);
            let [value] = self.slopes.run(&self.solid.model.tokens, &at, &mut scratch.slopes);
            (value.value, DVec3::from_array(value.slope))
        };
        let (value, slope) = slope_at(local);
        let scale = self.solid.frame.scale;
        let distance = value * scale;
        if (slope.length() - 1.0).abs() <= UNIT {
            return Tangent { distance, gradient: slope.normalize(), error: 0.0 };
        }
        let aside = BESIDE * (1.0 + local.abs().max_element()) * ASIDE;
        let (_, beside) = slope_at(local + aside);
        let gradient = beside.try_normalize().or(slope.try_normalize()).unwrap_or(DVec3::X);
        Tangent { distance, gradient, error: 2.0 * aside.length() * scale }
    }
}
