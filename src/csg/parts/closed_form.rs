//! A shape evaluated at single points in float64: the distance, and the distance with its gradient.

use super::solid::Solid;
use crate::csg::evaluation::dual::Dual;
use crate::csg::evaluation::program::{Program, Stack};
use glam::DVec3;
use std::sync::Arc;

/// A shape with programs for values and for slopes. Immutable, and shared between threads.
#[derive(Debug)]
pub struct ClosedForm {
    solid: Arc<Solid>,
    slopes: Program<Dual>,
}

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

    /// The value and the unit gradient of the field at a world point. Where there is no gradient, as at the centre of a
    /// ball, the gradient of one side is returned.
    pub fn distance_and_gradient(&self, p: DVec3, scratch: &mut Scratch) -> (f64, DVec3) {
        let at = Dual::position(self.solid.frame.local(p)).map(|x| [x]);
        let [value] = self.slopes.run(&self.solid.model.tokens, &at, &mut scratch.slopes);
        let gradient = DVec3::from_array(value.slope).try_normalize().unwrap_or(DVec3::X);
        (value.value * self.solid.frame.scale, gradient)
    }
}
