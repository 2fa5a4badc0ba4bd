//! The space that moving bodies cover, as a sparse field with a proof.
//!
//! # Theory
//!
//! D(p) is the smallest signed distance of p from the bodies over the whole motion. It is the distance from the swept
//! solid outside; inside, |D| is a lower bound of the distance from the outer surface. Each sample is a lower bound of
//! D that differs from it by at most a tolerance ([`search`]), also between the given poses ([`motion`]).
//!
//! *Containment.* A point p of the swept solid has D <= 0. D is 1-Lipschitz, so D is at most the diagonal of a cell at
//! all corners of the cell that contains p. Samples from which the diagonal is subtracted are negative there:
//! interpolation is negative at p, and no surface enters the cell. The vertices of a level set lie in cells with
//! samples of both signs, and the four cells around an edge are convex together, so faces stay in such cells too.
//!
//! # Practice
//!
//! [`Sweep::of_poses`] and [`Sweep::of_joints`] prepare a motion, [`Sweep::bounds`] returns a box around it, and
//! [`Sweep::bake`] makes the field.

pub mod motion;
mod search;
mod source;
#[cfg(test)]
mod tests;

use crate::assembly::{Bodies, Element, Geometry, Similarity};
use crate::error::{ArgumentError, Error, MeshError};
use glam::DVec3;
use motion::{Chain, JointStep, Screw, Step};
pub use source::{Cost, SweepOptions};
use std::sync::Arc;

/// Parts of a step at which a box of a body is placed to find the box of the motion, at most.
const MAX_PLACES: f64 = 64.0;
/// Largest path between two of these places, in sizes of the motion.
const PLACE_STEP: f64 = 0.01;

/// The motion of one body.
#[derive(Debug)]
struct Path {
    steps: Vec<Step>,
    /// Sums of [`Step::turn`] over the steps before each one, and over all.
    turns: Vec<f64>,
    /// The geometries of the body.
    elements: Vec<usize>,
}

impl Path {
    fn new(steps: Vec<Step>, elements: Vec<usize>) -> Self {
        let mut sum = 0.0;
        let sums = steps.iter().map(|step| {
            sum += step.turn();
            sum
        });
        let turns = std::iter::once(0.0).chain(sums).collect();
        Self { steps, turns, elements }
    }
}

/// Bodies and their motion.
#[derive(Debug)]
pub struct Sweep {
    bodies: Bodies,
    paths: Vec<Path>,
    /// Whether surfaces are sheets without an inside.
    is_unsigned: bool,
}

impl Sweep {
    /// A motion through rows of world-from-body poses, the poses of all bodies row by row, along screws.
    pub fn of_poses(
        bodies: Bodies,
        poses: &[[[f64; 4]; 4]],
        is_closed: bool,
        is_unsigned: bool,
    ) -> Result<Self, Error> {
        check_surfaces(&bodies, is_unsigned)?;
        let rows = poses.len().checked_div(bodies.count()).unwrap_or(0);
        let pose = |row: usize, body: usize| Similarity::from_rows(&poses[row * bodies.count() + body], 1.0);
        let mut paths = Vec::with_capacity(bodies.count());
        for body in 0..bodies.count() {
            let elements = elements_of(&bodies, body);
            let pivot = box_of_body(&bodies, &elements).map_or(DVec3::ZERO, |[lower, upper]| 0.5 * (lower + upper));
            let mut steps = Vec::with_capacity(rows);
            // Bodies without geometry cover no space.
            for [from, to] in ends(if elements.is_empty() { 1 } else { rows }, is_closed) {
                let screw = Screw::between(pose(from, body), pose(to, body), pivot).ok_or_else(|| {
                    let of = if bodies.count() > 1 { format!(" of body {body}") } else { String::new() };
                    let problem = format!(
                        "rows {from} and {to}{of} differ by half a turn, so the way between them is not unique; add a \
                         row between them"
                    );
                    ArgumentError::new("motion", problem)
                })?;
                steps.push(Step::Screw(screw));
            }
            paths.push(Path::new(steps, elements));
        }
        Ok(Self { bodies, paths, is_unsigned })
    }

    /// A motion through rows of joint values, linear between them. Each body has its chain, and the values of the
    /// joints of that chain, row by row.
    pub fn of_joints(
        bodies: Bodies,
        chains: Vec<(Chain, Vec<Vec<f64>>)>,
        is_closed: bool,
        is_unsigned: bool,
    ) -> Result<Self, Error> {
        check_surfaces(&bodies, is_unsigned)?;
        let path = |(body, (chain, values)): (usize, (Chain, Vec<Vec<f64>>))| {
            let chain = Arc::new(chain);
            let step = |[from, to]: [usize; 2]| {
                let pairs = values[from].iter().zip(&values[to]).map(|(&a, &b)| [a, b]).collect();
                Step::Joints(JointStep::new(chain.clone(), pairs))
            };
            Path::new(ends(values.len(), is_closed).map(step).collect(), elements_of(&bodies, body))
        };
        let paths = chains.into_iter().enumerate().map(path).collect();
        Ok(Self { bodies, paths, is_unsigned })
    }

    /// Number of steps of the motion.
    pub fn steps(&self) -> usize {
        self.paths.iter().map(|path| path.steps.len()).max().unwrap_or(0)
    }

    /// Whether no body moves.
    fn is_still(&self) -> bool {
        let mut steps = self.paths.iter().flat_map(|path| &path.steps);
        steps.all(|step| step.turn() == 0.0 && step.speed(DVec3::ZERO) == 0.0)
    }

    /// A box around the swept solid, world units; none if a geometry is unbounded or there is none.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        let mut ends = Vec::new();
        for path in self.paths.iter().filter(|path| !path.elements.is_empty()) {
            ends.push((path, corners(box_of_body(&self.bodies, &path.elements)?)));
        }
        if ends.is_empty() {
            return None;
        }
        // The size of the motion, from its rows.
        let mut rough = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        for (path, corners) in &ends {
            for step in &path.steps {
                for pose in [step.at(0.0), step.at(1.0)] {
                    corners.iter().for_each(|&corner| grow(&mut rough, pose.point(corner), 0.0));
                }
            }
        }
        let size = (rough[1] - rough[0]).length();
        let mut bounds = rough;
        for (path, corners) in &ends {
            for step in &path.steps {
                // The body lies in the convex hull of its corners, and each corner within half a part of its path.
                let speeds = corners.map(|corner| step.speed_of_body_point(corner));
                let fastest = speeds.into_iter().fold(0.0, f64::max);
                let count = (fastest / (PLACE_STEP * size)).ceil().clamp(1.0, MAX_PLACES);
                for i in 0..=count as usize {
                    let pose = step.at(i as f64 / count);
                    for (&corner, speed) in corners.iter().zip(speeds) {
                        grow(&mut bounds, pose.point(corner), 0.5 * speed / count);
                    }
                }
            }
        }
        Some(bounds)
    }
}

/// The rows at both ends of each step. One row is a motion that stands still.
fn ends(rows: usize, is_closed: bool) -> impl Iterator<Item = [usize; 2]> {
    let count = if is_closed && rows > 1 { rows } else { rows.saturating_sub(1).max(1) };
    (0..count).map(move |i| [i, (i + 1) % rows.max(1)])
}

fn elements_of(bodies: &Bodies, body: usize) -> Vec<usize> {
    (0..bodies.elements.len()).filter(|&i| bodies.elements[i].body == body).collect()
}

/// Open meshes have no inside with a continuous distance.
fn check_surfaces(bodies: &Bodies, is_unsigned: bool) -> Result<(), Error> {
    for element in &bodies.elements {
        match &element.geometry {
            Geometry::Mesh(mesh) if !is_unsigned && !mesh.topology().closed => return Err(MeshError::OpenSweep.into()),
            Geometry::Mesh(mesh) => {
                mesh.bvh();
                mesh.winding_choice().rule.prepare(mesh);
            }
            Geometry::Shape(_) => {}
        }
    }
    Ok(())
}

/// A box around the surface of a geometry, in its own coordinates; none if it is unbounded.
fn box_of(element: &Element) -> Option<[DVec3; 2]> {
    match &element.geometry {
        Geometry::Mesh(mesh) => Some(mesh.bounds()),
        Geometry::Shape(shape) => shape.solid().bounds().ok(),
    }
}

/// A box around the geometries of a body, in its coordinates.
fn box_of_body(bodies: &Bodies, elements: &[usize]) -> Option<[DVec3; 2]> {
    let mut bounds = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    for &i in elements {
        let element = &bodies.elements[i];
        corners(box_of(element)?).iter().for_each(|&corner| grow(&mut bounds, element.place.point(corner), 0.0));
    }
    Some(bounds)
}

fn corners([lower, upper]: [DVec3; 2]) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        DVec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 0 { lower[axis] } else { upper[axis] }))
    })
}

/// Adds a ball to a box.
fn grow(bounds: &mut [DVec3; 2], center: DVec3, radius: f64) {
    bounds[0] = bounds[0].min(center - radius);
    bounds[1] = bounds[1].max(center + radius);
}
