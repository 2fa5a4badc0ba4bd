//! A posed solid: its signed distance with the gradient, and lower bounds of the distance in a cell.

use super::form::Form;
use super::{Geometry, Similarity};
use crate::csg::model::token::Token;
use crate::csg::parts::closed_form::{Scratch, Tangent};
use crate::csg::tree::primitive::Primitive;
use crate::geometry::closest_point_on_triangle;
use crate::query::Search;
use glam::DVec3;

/// Share of the size that covers the rounding of distances and tangents.
pub(super) const ROUNDING: f64 = 1e-13;
/// Largest number of steps to the surface of a field that is a bound of the distance.
const MAX_SURFACE_STEPS: usize = 100;

/// A posed solid.
pub(super) struct Solid<'a> {
    geometry: &'a Geometry,
    place: Similarity,
    /// Whether the field is the distance, and no bound of it.
    is_distance: bool,
    search: Option<Search<'a>>,
    scratch: Scratch,
    /// The primitive of a convex closed form, and its placement.
    leaf: Option<(&'a Primitive, Similarity)>,
}

/// The signed distance of a point, its unit gradient, and the nearest point.
#[derive(Debug, Clone, Copy)]
pub(super) struct Value {
    pub(super) distance: f64,
    pub(super) gradient: DVec3,
    /// [`Tangent::error`]; zero for meshes.
    error: f64,
    /// The nearest face, world positions.
    face: Option<[DVec3; 3]>,
}

impl Value {
    const NONE: Self = Self { distance: f64::INFINITY, gradient: DVec3::X, error: 0.0, face: None };

    /// The value at `x` of the tangent plane at `at`, which a convex distance exceeds.
    fn tangent(&self, at: DVec3, x: DVec3) -> f64 {
        self.distance - self.error + self.gradient.dot(x - at)
    }
}

impl<'a> Solid<'a> {
    pub(super) fn new(geometry: &'a Geometry, place: Similarity, is_distance: bool) -> Self {
        let (search, leaf) = match geometry {
            Geometry::Mesh(mesh) => (Some(Search::new(mesh)), None),
            Geometry::Shape(shape) => {
                (None, convex_leaf(shape.solid()).map(|(primitive, own)| (primitive, place.after(&own))))
            }
        };
        Self { geometry, place, is_distance, search, scratch: Scratch::default(), leaf }
    }

    /// The signed distance.
    pub(super) fn distance(&mut self, p: DVec3) -> f64 {
        let local = self.place.inverse_point(p);
        match (self.geometry, &mut self.search) {
            (Geometry::Shape(shape), _) => shape.distance(local, &mut self.scratch),
            (_, Some(search)) => search.nearest(local, f64::INFINITY).map_or(f64::INFINITY, |found| found.distance),
            _ => f64::INFINITY,
        }
    }

    /// Whether the solid is a convex closed form.
    pub(super) fn is_convex(&self) -> bool {
        self.leaf.is_some()
    }

    /// Whether the distance is a convex function, so that its tangents bound it from below.
    fn has_tangents(&self) -> bool {
        match self.geometry {
            Geometry::Mesh(mesh) => *mesh.derived::<Form>() == Form::Convex,
            Geometry::Shape(_) => self.leaf.is_some(),
        }
    }

    /// The signed distance, its gradient and the nearest face.
    pub(super) fn value(&mut self, p: DVec3) -> Value {
        let local = self.place.inverse_point(p);
        match (self.geometry, &mut self.search) {
            (Geometry::Shape(shape), _) => {
                let Tangent { distance, gradient, error } = shape.tangent(local, &mut self.scratch);
                Value { distance, gradient: self.place.rotation * gradient, error, face: None }
            }
            (Geometry::Mesh(mesh), Some(search)) => match search.nearest(local, f64::INFINITY) {
                Some(found) => {
                    let world = mesh.world_positions();
                    let corner = |v: u32| self.place.point(DVec3::from_array(world[v as usize]));
                    Value {
                        distance: found.distance,
                        gradient: self.place.rotation * found.gradient,
                        error: 0.0,
                        face: Some(mesh.faces()[found.face as usize].map(corner)),
                    }
                }
                None => Value::NONE,
            },
            _ => Value::NONE,
        }
    }

    /// The unit gradient and the nearest surface point.
    pub(super) fn gradient_and_point(&mut self, p: DVec3) -> (DVec3, DVec3) {
        let value = self.value(p);
        (value.gradient, p - value.distance * value.gradient)
    }

    /// The nearest surface point of a point outside; none inside. On a bound of the distance it is the end of steps
    /// along the gradients, within `accuracy` of the surface, and no nearest point.
    pub(super) fn projection(&mut self, p: DVec3, accuracy: f64) -> Option<DVec3> {
        let mut value = self.value(p);
        if value.distance <= 0.0 {
            return None;
        }
        let mut surface = p - value.distance * value.gradient;
        for _ in 0..if self.is_distance { 0 } else { MAX_SURFACE_STEPS } {
            value = self.value(surface);
            if value.distance <= accuracy {
                break;
            }
            surface -= value.distance * value.gradient;
        }
        Some(surface)
    }

    /// Lower bounds of the distance in a cell, at its corners.
    pub(super) fn minorant(&self, value: &Value, center: DVec3, corners: &[DVec3; 8]) -> [f64; 8] {
        let radius = center.distance(corners[0]);
        let has_tangents = self.has_tangents();
        match value.face {
            _ if has_tangents => corners.map(|x| value.tangent(center, x)),
            Some(face) if value.distance <= radius => {
                corners.map(|x| -closest_point_on_triangle(x, face).point.distance(x))
            }
            _ => [value.distance - radius; 8],
        }
    }

    /// [`Self::minorant`] from the value at a point farther inside.
    pub(super) fn minorant_beyond(
        &mut self,
        value: &Value,
        center: DVec3,
        radius: f64,
        corners: &[DVec3; 8],
    ) -> [f64; 8] {
        if value.distance > radius {
            return [f64::NEG_INFINITY; 8];
        }
        let beyond = center - 2.0 * radius * value.gradient;
        let found = self.value(beyond);
        let has_tangents = self.has_tangents();
        match found.face {
            _ if has_tangents => corners.map(|x| found.tangent(beyond, x)),
            Some(face) => corners.map(|x| -closest_point_on_triangle(x, face).point.distance(x)),
            None => [f64::NEG_INFINITY; 8],
        }
    }

    /// The largest n . x over a convex closed form.
    pub(super) fn support(&self, n: DVec3) -> Option<f64> {
        let (primitive, place) = self.leaf.as_ref()?;
        let own = place.rotation.transpose() * n;
        Some(n.dot(place.translation) + place.scale * primitive.support(own))
    }
}

/// The primitive of a shape that is a single convex one, and its placement.
fn convex_leaf(solid: &crate::csg::parts::solid::Solid) -> Option<(&Primitive, Similarity)> {
    let model = &solid.model;
    let ([Token::Leaf(0)], [leaf]) = (&model.tokens[..], &model.leaves[..]) else { return None };
    let is_convex = matches!(
        leaf.primitive,
        Primitive::Sphere { .. }
            | Primitive::Ellipsoid { .. }
            | Primitive::Box { .. }
            | Primitive::Cylinder { .. }
            | Primitive::RoundedCylinder { .. }
            | Primitive::Capsule { .. }
            | Primitive::Cone { .. }
            | Primitive::RoundedCone { .. }
            | Primitive::Plane { .. }
            | Primitive::Slab { .. }
            | Primitive::Pyramid { .. }
            | Primitive::Octahedron { .. }
            | Primitive::HexPrism { .. }
    );
    let place = &leaf.place;
    let place = Similarity { rotation: place.rotation, translation: place.translation, scale: place.scale };
    is_convex.then_some((&leaf.primitive, place))
}
