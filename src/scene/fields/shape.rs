//! A shape in a scene, without an intermediate grid.
//!
//! # Theory
//!
//! Field space is the shape's own local space ([`crate::csg::evaluation::program::LocalFrame`], a model of a size from
//! 1/2 to 1) in units of 1/[`UNITS`]. Rays are traced as in [`crate::csg::parts::trace`]: roots of the field, part by
//! part, each in its own boxes. A distance is the field over its declared Lipschitz constant, which is a lower bound
//! inside and outside.
//!
//! Penumbrae need the distance itself. If the shape is not exact, [`Field::distance_guess`] takes several first-order
//! steps to the surface, each of the field over its gradient. The end point is on the surface to first order, so its
//! distance is hardly less than the true one, and never less than the bound.
//!
//! A distance evaluates every leaf, a ray only the leaves of the parts that it intersects. Beyond [`DISTANCES_UP_TO`]
//! leaves cones are tested by thin rays.

use super::device_fields::DeviceFields;
use super::field::{Field, FieldHit, FieldRay, SurfaceAppearance};
use crate::csg::device::draw::{DrawMethod, tracer};
use crate::csg::evaluation::program::Stack;
use crate::csg::model::lowered::Model;
use crate::csg::parts::solid::{Solid, slope};
use crate::csg::parts::trace::{ShapeRay, TraceWork, Tracer};
use crate::error::{DeviceError, Error};
use crate::gpu::Place;
use glam::{DAffine3, DVec3, Vec3};
use std::cell::RefCell;
use std::sync::Arc;

/// Number of field units in a local unit. Rays that leave the surface start half a unit off it, several of the tracer's
/// shortest steps.
pub(crate) const UNITS: f32 = 1024.0;

/// Number of leaves from which on a ray through the parts costs less than the distances along it.
const DISTANCES_UP_TO: usize = 48;

/// Number of first-order steps to the surface.
const GUESSES: u32 = 3;

/// Half the step of the central differences in float64, local units.
const SLOPE_STEP: f64 = 1e-5;

/// A hit whose field is below this, local units, is not a root: the ray began in a box that the octree dropped because
/// it lies inside completely.
const DEEP: f32 = 1e-4;

self_cell::self_cell!(
    /// A solid and the parts that rays are traced through.
    struct Parts {
        owner: Arc<Solid>,
        #[covariant]
        dependent: Tracer,
    }
);

/// A shape prepared for the rays of a scene.
pub(crate) struct ShapeField {
    parts: Parts,
    /// Lower and upper corner of the surface's box, field space.
    surface: [Vec3; 2],
    inverse_lipschitz: f32,
    leaves: usize,
}

/// Buffers that a thread keeps between calls.
#[derive(Default)]
struct FieldScratch {
    march: Stack<f32, 1>,
    slope: Stack<f64, 6>,
}

thread_local! {
    static SCRATCH: RefCell<FieldScratch> = RefCell::default();
}

impl ShapeField {
    /// Fails for a shape without bounds, naming the leaf.
    pub(crate) fn new(solid: Arc<Solid>) -> Result<Self, Error> {
        let parts = Parts::try_new(solid, |solid| tracer(&Place::Cpu, solid, DrawMethod::Auto))?;
        let tracer = parts.borrow_dependent();
        let [lower, upper] = tracer.bounds.map(|corner| UNITS * corner);
        let model = &tracer.solid.model;
        let inverse_lipschitz = (1.0 / model.lipschitz) as f32;
        let leaves = Model::leaf_count(&model.tokens);
        // A ray starts one unit before the boxes, so that the tracer determines where it enters them.
        Ok(Self { surface: [lower - 1.0, upper + 1.0], inverse_lipschitz, leaves, parts })
    }

    /// The parts that rays are traced through.
    pub(crate) fn tracer(&self) -> &Tracer<'_> {
        self.parts.borrow_dependent()
    }

    fn solid(&self) -> &Solid {
        self.parts.borrow_owner()
    }

    /// The field of the whole shape, local units.
    fn value(&self, p_local: Vec3) -> f32 {
        let at = p_local.to_array().map(|x| [x]);
        let solid = self.solid();
        SCRATCH.with_borrow_mut(|scratch| solid.program.run(&solid.model.tokens, &at, &mut scratch.march)[0])
    }

    fn slope(&self, p_local: DVec3) -> DVec3 {
        let solid = self.solid();
        SCRATCH.with_borrow_mut(|scratch| {
            slope(solid.precise(), &solid.model.tokens, p_local, SLOPE_STEP, &mut scratch.slope)
        })
    }
}

impl Field for ShapeField {
    fn field_from_local(&self) -> DAffine3 {
        let frame = self.solid().frame;
        DAffine3::from_scale(DVec3::splat(f64::from(UNITS) / frame.scale)) * DAffine3::from_translation(-frame.center)
    }

    fn bounds(&self) -> [Vec3; 2] {
        self.surface
    }

    fn surface_bounds(&self) -> [Vec3; 2] {
        self.surface
    }

    fn voxel(&self) -> f64 {
        self.solid().frame.scale / f64::from(UNITS)
    }

    fn first_hit(&self, ray: &FieldRay, t_max: f32) -> (Option<FieldHit>, u32) {
        let units_per_t = ray.direction.length();
        let per_t = units_per_t / UNITS;
        let local =
            ShapeRay { origin: ray.origin / UNITS, direction: ray.direction / units_per_t, t_max: t_max * per_t };
        let tracer = self.tracer();
        let mut work = TraceWork::default();
        let found = SCRATCH.with_borrow_mut(|scratch| {
            let hit = tracer.first_hit(&local, &mut scratch.march, &mut work)?;
            if !hit.is_at_entry {
                return Some((hit, false));
            }
            let at = (local.origin + hit.t * local.direction).to_array().map(|x| [x]);
            let tokens = &tracer.programs[hit.part as usize].tokens;
            let value = tracer.solid.program.run(tokens, &at, &mut scratch.march)[0];
            Some((hit, value < -DEEP))
        });
        let hit = found.map(|(hit, is_inside)| FieldHit {
            t: if is_inside { 0.0 } else { hit.t / per_t },
            at_start: is_inside,
            part: hit.part,
        });
        (hit, work.steps)
    }

    fn distance(&self, p: Vec3) -> f32 {
        self.value(p / UNITS) * self.inverse_lipschitz * self.solid().frame.scale as f32
    }

    fn distance_guess(&self, p: Vec3, bound: f32) -> f32 {
        if self.solid().model.is_exact || bound <= 0.0 {
            return bound;
        }
        let start = (p / UNITS).as_dvec3();
        let mut q = start;
        for _ in 0..GUESSES {
            let slope = self.slope(q);
            let steepness = slope.length_squared();
            if steepness == 0.0 {
                break;
            }
            q -= f64::from(self.value(q.as_vec3())) / steepness * slope;
        }
        bound.max((q.distance(start) * self.solid().frame.scale) as f32)
    }

    fn gradient(&self, p: Vec3) -> Vec3 {
        self.slope((p / UNITS).as_dvec3()).normalize_or_zero().as_vec3()
    }

    fn appearance(&self, p: Vec3, hit: &FieldHit, direction: Vec3) -> SurfaceAppearance {
        let p = p / UNITS;
        let tracer = self.tracer();
        let normal = SCRATCH.with_borrow_mut(|scratch| tracer.normal(p, direction, hit.part, &mut scratch.slope));
        SurfaceAppearance { normal: normal.unwrap_or_default(), color: tracer.color(p, hit.part) }
    }

    fn prefers_rays(&self) -> bool {
        self.leaves > DISTANCES_UP_TO
    }

    fn append_to(&self, tables: &mut DeviceFields<'_>) -> Result<bool, DeviceError> {
        // Devices evaluate the whole shape, which is expensive with many leaves.
        if self.prefers_rays() { Ok(false) } else { tables.add_shape(self.solid()) }
    }

    fn is_traced_again(&self) -> bool {
        true
    }
}
