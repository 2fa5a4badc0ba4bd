//! Pictures of shapes on the CPU, with the camera, the light and the frame of all other pictures.

use super::gpu;
use super::picture::{Drawing, PixelRays, ShapeView, draw_on_cpu};
use crate::csg::model::lowered::Model;
use crate::csg::parts::chord::PartKind;
use crate::csg::parts::part::Method;
use crate::csg::parts::solid::Solid;
use crate::csg::parts::trace::Tracer;
use crate::error::{Error, ShapeError, choice};
use crate::gpu::Place;
use crate::picture::{Camera, RaymarchOptions};
use crate::progress::Progress;

/// The parts that rays are traced through.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum DrawMethod {
    /// The whole shape: every step evaluates every leaf.
    Whole,
    /// The parts, each in its boxes.
    Parts(Method),
    /// The method with the smallest estimated cost per ray.
    #[default]
    Auto,
}

impl DrawMethod {
    /// Converts the public name of a method.
    pub(crate) fn from_name(name: &str) -> Result<Self, ShapeError> {
        choice(
            "method",
            name,
            &[
                ("auto", Self::Auto),
                ("whole", Self::Whole),
                ("aabb", Self::Parts(Method::Aabb)),
                ("octree", Self::Parts(Method::Octree)),
            ],
        )
        .map_err(ShapeError::from)
    }
}

/// The parts that rays are traced through at a place; a single part for [`DrawMethod::Whole`].
pub(crate) fn tracer<'a>(place: &Place, solid: &'a Solid, method: DrawMethod) -> Result<Tracer<'a>, Error> {
    solid.bounds()?;
    match method {
        DrawMethod::Whole => Ok(Tracer::whole(solid)),
        DrawMethod::Auto if matches!(place, Place::Gpu(_)) && is_one_structure(solid) => Ok(Tracer::one_box(solid)),
        DrawMethod::Auto => cheapest(solid),
        DrawMethod::Parts(method) => Ok(Tracer::of(solid, solid.cells(method)?.clone())),
    }
}

/// Largest number of leaves of a shape that is one function on a device. The parts of its decomposition would depend on
/// its parameters, and changing a parameter should compile nothing.
const FEW_LEAVES: usize = 12;

/// Whether a device compiles one function for a whole shape. Shapes in closed form have none.
fn is_one_structure(solid: &Solid) -> bool {
    let tokens = &solid.model.tokens;
    Model::leaf_count(tokens) <= FEW_LEAVES && PartKind::of(&solid.program, tokens) == PartKind::Field
}

/// The parts with the smallest estimated cost per ray. A few leaves are evaluated together; boxes carried from the
/// leaves are few and fit sparse scenes tightly; only the octree separates many leaves that intersect.
fn cheapest(solid: &Solid) -> Result<Tracer<'_>, Error> {
    let octree = Tracer::of(solid, solid.cells(Method::Octree)?.clone());
    if Model::leaf_count(&solid.model.tokens) > AABB_LEAVES {
        return Ok(octree);
    }
    let aabb = Tracer::of(solid, solid.cells(Method::Aabb)?.clone());
    let of_octree = octree.cost();
    let others = [Tracer::one_box(solid), aabb].into_iter().filter(|tracer| tracer.cost() < of_octree);
    Ok(others.min_by(|a, b| a.cost().total_cmp(&b.cost())).unwrap_or(octree))
}

/// Largest number of leaves for which boxes carried from the leaves are tried.
const AABB_LEAVES: usize = 256;

/// Draws a shape at a place.
pub(crate) fn draw(
    place: &Place,
    tracer: &Tracer<'_>,
    camera: &Camera,
    options: &RaymarchOptions,
    progress: &Progress,
) -> Result<Drawing, Error> {
    options.check()?;
    let lights = options.directional_lights()?;
    // The rays of an orthographic camera start at different points, so `draw_pixel` decides for each.
    let is_eye_inside = !camera.is_parallel() && tracer.is_inside(camera.eye);
    let rays = PixelRays::new(tracer, camera, options, lights.len());
    let view = ShapeView { tracer, camera, options, lights: &lights, is_eye_inside, rays };
    match place {
        // With the eye inside, or without boxes, there is nothing to trace.
        Place::Gpu(context) if !view.is_eye_inside && !tracer.boxes.is_empty() => gpu::draw(&view, context, progress),
        _ => draw_on_cpu(&view, progress),
    }
}
