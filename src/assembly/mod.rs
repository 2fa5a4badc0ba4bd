//! Rigid bodies at given poses.
//!
//! *Theory.* A body keeps its search tree, and only its pose changes: a point is transformed into the frame of each
//! geometry in float64, and the tree there is as accurate as for a mesh that does not move. [`nearest`] finds the
//! smallest signed distance over all bodies.
//!
//! *Practice.* [`Bodies`] is made once. A configuration is one rigid pose for each body.

pub mod clearance;
mod descent;
mod form;
pub mod nearest;
mod overlap;
mod separation;
mod sheet;
mod solid;
#[cfg(test)]
mod tests;

use crate::csg::parts::closed_form::ClosedForm;
use crate::mesh::Mesh;
use glam::{DMat3, DVec3};
use std::sync::Arc;

/// A map that keeps angles: x -> scale * rotation * x + translation. The rotation may contain a reflection.
#[derive(Debug, Clone, Copy)]
pub struct Similarity {
    /// An orthonormal matrix.
    pub rotation: DMat3,
    /// The image of the origin.
    pub translation: DVec3,
    /// The factor of all lengths.
    pub scale: f64,
}

impl Similarity {
    /// A row-major 4x4 matrix divided by `scale`, with a 3x3 part that is orthonormal to 1e-6. One step of Newton's
    /// iteration for the polar decomposition makes it orthonormal to 1e-12 (Higham, "Computing the polar
    /// decomposition", 1986).
    pub fn from_rows(rows: &[[f64; 4]; 4], scale: f64) -> Self {
        let column = |i: usize| DVec3::new(rows[0][i], rows[1][i], rows[2][i]);
        let rough = DMat3::from_cols(column(0), column(1), column(2)) * (1.0 / scale);
        let error = rough.transpose() * rough - DMat3::IDENTITY;
        Self { rotation: rough - rough * error * 0.5, translation: column(3), scale }
    }

    /// First `inner`, then `self`.
    pub fn after(&self, inner: &Self) -> Self {
        Self {
            rotation: self.rotation * inner.rotation,
            translation: self.point(inner.translation),
            scale: self.scale * inner.scale,
        }
    }

    /// The image of a point.
    pub fn point(&self, p: DVec3) -> DVec3 {
        self.rotation * (self.scale * p) + self.translation
    }

    /// The point whose image is `p`.
    pub fn inverse_point(&self, p: DVec3) -> DVec3 {
        self.rotation.transpose() * (p - self.translation) / self.scale
    }
}

/// Triangles with their search tree, or a closed form.
#[derive(Debug, Clone)]
pub enum Geometry {
    /// The winding number decides its inside.
    Mesh(Arc<Mesh>),
    /// A field that is the Euclidean distance everywhere.
    Shape(Arc<ClosedForm>),
}

/// A geometry that is fixed to a body.
#[derive(Debug, Clone)]
pub struct Element {
    pub(crate) geometry: Geometry,
    /// The shape whose triangles the geometry is, and the largest deviation of the triangles from it.
    pub(crate) source: Option<(Geometry, f64)>,
    pub(crate) body: usize,
    /// Body from geometry.
    pub(crate) place: Similarity,
    /// A box around the inside and the surface, in coordinates of the geometry; none if there is no such box.
    pub(crate) bounds: Option<[DVec3; 2]>,
}

/// The geometry of all bodies.
#[derive(Debug, Clone, Default)]
pub struct Bodies {
    pub(crate) elements: Vec<Element>,
    count: usize,
}

impl Bodies {
    /// `count` bodies without geometry.
    pub fn new(count: usize) -> Self {
        Self { elements: Vec::new(), count }
    }

    /// Fixes a geometry to a body. `source` is the shape whose triangles the geometry is, and their largest deviation
    /// from it.
    pub fn add(&mut self, body: usize, geometry: Geometry, place: Similarity, source: Option<(Arc<ClosedForm>, f64)>) {
        let bounds = match &geometry {
            // A point outside the box of an open mesh may be inside by the winding number.
            Geometry::Mesh(mesh) => mesh.topology().closed.then(|| mesh.bounds()),
            Geometry::Shape(shape) => shape.solid().bounds().ok(),
        };
        let source = source.map(|(shape, deviation)| (Geometry::Shape(shape), deviation));
        self.elements.push(Element { geometry, source, body, place, bounds });
    }

    /// Number of bodies.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of geometries.
    pub fn element_count(&self) -> usize {
        self.elements.len()
    }
}
