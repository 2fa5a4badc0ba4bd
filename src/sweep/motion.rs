//! The motion of a rigid body from one pose to the next, and bounds on the speed of fixed points in its frame.
//!
//! # Theory
//!
//! A step has the parameter s from 0 to 1. Between two poses the body follows a *screw*: a rotation at a constant rate
//! about a line, and a slide along it at a constant speed. Its spatial velocity is constant: a point x of the body
//! moves at w x (x - c) + v, with the cross product of the rotation vector w. A point p that is fixed in the world
//! moves in the frame of the body at the speed |w x (p - c) + v|, which is constant too (R. Murray, Z. Li and S.
//! Sastry, "A Mathematical Introduction to Robotic Manipulation", 1994, chapter 2).
//!
//! Between two rows of joint values every joint moves linearly, by dq. A revolute joint at the place o adds at most
//! |dq| |p - o| to the speed of p, a prismatic one |dq|. The place o of a joint moves itself: the joints k below it on
//! the chain move it at most by the sum of |dq_k| times the length of the links between. So a place in the middle of an
//! interval bounds the speed on the whole interval, and halving the interval tightens the bound.

use crate::assembly::Similarity;
use glam::{DMat3, DQuat, DVec3};
use std::f64::consts::PI;
use std::sync::Arc;

/// Two poses that differ by half a turn, to this angle, have no unique screw between them.
const HALF_TURN: f64 = 1e-6;
/// Angle below which the coefficients of the exponential map are series.
const SMALL_ANGLE: f64 = 0.1;

/// A screw between two poses.
#[derive(Debug, Clone, Copy)]
pub struct Screw {
    start: Similarity,
    /// A point of the body, in its own coordinates, and its world position at the start.
    pivot: [DVec3; 2],
    /// Rotation vector of the whole step.
    turn: DVec3,
    /// Velocity of the pivot at the start.
    slide: DVec3,
}

impl Screw {
    /// The screw between two poses; none if they differ by half a turn. `pivot` is a point near the body, in its own
    /// coordinates.
    pub fn between(start: Similarity, end: Similarity, pivot: DVec3) -> Option<Self> {
        let relative = DQuat::from_mat3(&(end.rotation * start.rotation.transpose())).normalize();
        let relative = if relative.w < 0.0 { -relative } else { relative };
        let sine = relative.xyz().length();
        let angle = 2.0 * sine.atan2(relative.w);
        if angle >= PI - HALF_TURN {
            return None;
        }
        let turn = relative.xyz() * if sine > 0.0 { angle / sine } else { 2.0 };
        let from = start.point(pivot);
        let moved = end.point(pivot) - from;
        // The inverse of the integral in `at`.
        let half = 0.5 * angle;
        let factor = if angle < SMALL_ANGLE {
            let square = angle * angle;
            1.0 / 12.0 + square * (1.0 / 720.0 + square * (1.0 / 30_240.0 + square / 1_209_600.0))
        } else {
            (1.0 - half / half.tan()) / (angle * angle)
        };
        let across = turn.cross(moved);
        let slide = moved - 0.5 * across + factor * turn.cross(across);
        Some(Self { start, pivot: [pivot, from], turn, slide })
    }

    /// The pose at the share `s` of the step.
    fn at(&self, s: f64) -> Similarity {
        let turn = self.turn * s;
        let angle = turn.length();
        let (first, second) = if angle < SMALL_ANGLE {
            let square = angle * angle;
            let first = 0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0 - square / 40_320.0));
            (first, 1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0 - square / 362_880.0)))
        } else {
            ((1.0 - angle.cos()) / (angle * angle), (angle - angle.sin()) / (angle * angle * angle))
        };
        // The position of the pivot is the integral of its velocity.
        let across = turn.cross(self.slide);
        let pivot = self.pivot[1] + s * (self.slide + first * across + second * turn.cross(across));
        let step = turn.try_normalize().map_or(DMat3::IDENTITY, |axis| DMat3::from_axis_angle(axis, angle));
        let rotation = step * self.start.rotation;
        Similarity { rotation, translation: pivot - rotation * self.pivot[0], scale: 1.0 }
    }

    /// The speed of a point that is fixed in the world, in the frame of the body.
    fn speed(&self, p: DVec3) -> f64 {
        (self.turn.cross(p - self.pivot[1]) + self.slide).length()
    }
}

/// The kind of a joint, with its unit axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum JointKind {
    /// No motion.
    Fixed,
    /// A rotation about the axis, by the value in radians.
    Revolute(DVec3),
    /// A slide along the axis, by the value.
    Prismatic(DVec3),
}

/// The joints from the root of a tree to one body.
#[derive(Debug, Clone)]
pub struct Chain {
    /// World from the root.
    pub root: Similarity,
    /// The frame of each joint in the frame before it, and its kind.
    pub joints: Vec<(Similarity, JointKind)>,
}

/// A linear motion of all joints of a chain.
#[derive(Debug, Clone)]
pub struct JointStep {
    chain: Arc<Chain>,
    /// Joint values at both ends.
    values: Vec<[f64; 2]>,
    /// Most that the place of each joint moves during the whole step.
    travel: Vec<f64>,
    /// Places of the joints in the middle of the step.
    middle: Vec<DVec3>,
    /// Largest distance between the place of each joint and the origin of the body.
    reach: Vec<f64>,
}

impl JointStep {
    /// `values` are the joint values at both ends, one pair for each joint of the chain.
    pub fn new(chain: Arc<Chain>, values: Vec<[f64; 2]>) -> Self {
        let count = chain.joints.len();
        let change = |j: usize| (values[j][1] - values[j][0]).abs();
        // The length of the link before a joint, and the largest slide after it.
        let link = |j: usize| chain.joints[j].0.translation.length();
        let slide = |j: usize| match chain.joints[j].1 {
            JointKind::Prismatic(_) => values[j][0].abs().max(values[j][1].abs()),
            _ => 0.0,
        };
        let moved_by = |k: usize, lever: f64| match chain.joints[k].1 {
            JointKind::Fixed => 0.0,
            JointKind::Revolute(_) => change(k) * lever,
            JointKind::Prismatic(_) => change(k),
        };
        let lever = |k: usize, j: usize| (k + 1..=j).map(link).sum::<f64>() + (k + 1..j).map(slide).sum::<f64>();
        let travel = (0..count).map(|j| (0..j).map(|k| moved_by(k, lever(k, j))).sum()).collect();
        let reach =
            (0..count).map(|j| (j + 1..count).map(link).sum::<f64>() + (j..count).map(slide).sum::<f64>()).collect();
        let mut step = Self { chain, values, travel, middle: Vec::new(), reach };
        let mut middle = Vec::with_capacity(count);
        step.visit(0.5, |_, place| middle.push(place));
        step.middle = middle;
        step
    }

    /// The pose of the body at the share `s` of the step. `see` receives the place of each joint.
    fn visit(&self, s: f64, mut see: impl FnMut(usize, DVec3)) -> Similarity {
        let mut pose = self.chain.root;
        for (j, ((origin, kind), [from, to])) in self.chain.joints.iter().zip(&self.values).enumerate() {
            pose = pose.after(origin);
            see(j, pose.translation);
            let value = from + (to - from) * s;
            match *kind {
                JointKind::Fixed => {}
                JointKind::Revolute(axis) => pose.rotation *= DMat3::from_axis_angle(axis, value),
                JointKind::Prismatic(axis) => pose.translation += pose.rotation * (axis * value),
            }
        }
        pose
    }

    /// The contribution of joint j to the speed of a point at a distance from its place.
    fn rate(&self, j: usize, distance: f64) -> f64 {
        let change = (self.values[j][1] - self.values[j][0]).abs();
        match self.chain.joints[j].1 {
            JointKind::Fixed => 0.0,
            JointKind::Revolute(_) => change * distance,
            JointKind::Prismatic(_) => change,
        }
    }

    /// Largest speed of a fixed point during the whole step.
    fn speed(&self, p: DVec3) -> f64 {
        let place = |j: usize| p.distance(self.middle[j]) + 0.5 * self.travel[j];
        (0..self.values.len()).map(|j| self.rate(j, place(j))).sum()
    }
}

/// One step of a motion.
#[derive(Debug, Clone)]
pub enum Step {
    /// From one pose to the next.
    Screw(Screw),
    /// From one row of joint values to the next.
    Joints(JointStep),
}

impl Step {
    /// The pose at the share `s` of the step.
    pub fn at(&self, s: f64) -> Similarity {
        match self {
            Self::Screw(screw) => screw.at(s),
            Self::Joints(joints) => joints.visit(s, |_, _| {}),
        }
    }

    /// Largest speed of a point that is fixed in the world, in the frame of the body, per step.
    pub fn speed(&self, p: DVec3) -> f64 {
        match self {
            Self::Screw(screw) => screw.speed(p),
            Self::Joints(joints) => joints.speed(p),
        }
    }

    /// The pose in the middle of an interval, and the largest speed of a fixed point on that interval.
    pub fn middle(&self, p: DVec3, from: f64, to: f64) -> (Similarity, f64) {
        match self {
            Self::Screw(screw) => (screw.at(0.5 * (from + to)), screw.speed(p)),
            Self::Joints(joints) => {
                let half = 0.5 * (to - from);
                let mut speed = 0.0;
                let pose = joints.visit(0.5 * (from + to), |j, place| {
                    speed += joints.rate(j, p.distance(place) + joints.travel[j] * half);
                });
                (pose, speed)
            }
        }
    }

    /// The change of [`Self::speed`] by the position of the point, at most.
    pub fn turn(&self) -> f64 {
        match self {
            Self::Screw(screw) => screw.turn.length(),
            Self::Joints(joints) => (0..joints.values.len()).map(|j| joints.rate(j, 1.0) - joints.rate(j, 0.0)).sum(),
        }
    }

    /// Largest speed of a point of the body, in its own coordinates, in the world.
    pub fn speed_of_body_point(&self, x: DVec3) -> f64 {
        match self {
            Self::Screw(screw) => screw.speed(screw.start.point(x)),
            Self::Joints(joints) => {
                (0..joints.values.len()).map(|j| joints.rate(j, joints.reach[j] + x.length())).sum()
            }
        }
    }
}
