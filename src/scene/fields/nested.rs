//! Nested fields, each twice as fine as the one around it: a far field that is finer near its centre.
//!
//! # Theory
//!
//! A point belongs to the finest level with samples on all sides of it. Every sample of a level lies on the lattice of
//! the next finer one, and the outermost samples of a level are values of the level around it. A finer level therefore
//! ends at whole cells of the coarser one with the same values: the field has no jump, and between samples it is
//! trilinear everywhere. (Losasso and Hoppe, *Geometry clipmaps*, SIGGRAPH 2004, join height fields in this way.) The
//! caller must provide such levels.
//!
//! A ray has one piece in each level before it enters the next finer one and one behind it. Each piece is traced
//! exactly in its level.
//!
//! # Practice
//!
//! Field space is the grid space of the finest level.

use super::device_fields::DeviceFields;
use super::field::{Field, FieldHit, FieldRay};
use crate::error::{DeviceError, Error, SceneError};
use crate::geometry::clip;
use glam::{DAffine3, Vec3};
use std::sync::Arc;

/// Nested levels, finest first.
pub(crate) struct NestedField {
    levels: Vec<NestedLevel>,
}

struct NestedLevel {
    field: Arc<dyn Field>,
    /// Map to its grid space from the grid space of the finest level, along each axis.
    scale: Vec3,
    offset: Vec3,
    /// Region in its own grid space: between its samples; for the outermost level its whole box.
    region: [Vec3; 2],
}

impl NestedLevel {
    fn in_its_grid(&self, p: Vec3) -> Vec3 {
        self.scale * p + self.offset
    }

    fn holds(&self, p: Vec3) -> bool {
        p.cmpge(self.region[0]).all() && p.cmple(self.region[1]).all()
    }

    /// The part of a ray in the region, in grid space of the finest level; empty if the ray misses.
    fn clip(&self, ray: &FieldRay, t_max: f32) -> [f32; 2] {
        let (origin, direction) = (self.in_its_grid(ray.origin), self.scale * ray.direction);
        let part = clip(origin.as_dvec3(), direction.as_dvec3(), self.region[0], self.region[1], 0.0, f64::from(t_max));
        part.map_or([t_max, t_max], |(enter, leave)| [enter as f32, leave as f32])
    }
}

impl NestedField {
    /// `fields` must be finest first, on grids along the same axes, each in the box of the next.
    pub(crate) fn new(fields: Vec<Arc<dyn Field>>) -> Result<Self, Error> {
        let Some(finest) = fields.first() else {
            return Err(SceneError::new("levels", "are empty").into());
        };
        let local_from_finest = finest.field_from_local().inverse();
        let outermost = fields.len() - 1;
        let levels = fields.into_iter().enumerate().map(|(k, field)| {
            let map = field.field_from_local() * local_from_finest;
            let m = map.matrix3;
            let border = if k == outermost { 0.0 } else { 0.5 };
            let [lower, upper] = field.bounds();
            NestedLevel {
                scale: Vec3::new(m.x_axis.x as f32, m.y_axis.y as f32, m.z_axis.z as f32),
                offset: map.translation.as_vec3(),
                region: [lower + border, upper - border],
                field,
            }
        });
        Ok(Self { levels: levels.collect() })
    }

    fn outermost(&self) -> &NestedLevel {
        self.levels.last().expect("there is one")
    }

    /// The level of a point, and the point in its grid space.
    fn at(&self, p: Vec3) -> (&NestedLevel, Vec3) {
        let found = self.levels.iter().map(|level| (level, level.in_its_grid(p))).find(|(level, p)| level.holds(*p));
        found.unwrap_or_else(|| (self.outermost(), self.outermost().in_its_grid(p)))
    }

    fn in_finest(&self, corners: [Vec3; 2]) -> [Vec3; 2] {
        let outermost = self.outermost();
        corners.map(|corner| (corner - outermost.offset) / outermost.scale)
    }
}

impl Field for NestedField {
    fn field_from_local(&self) -> DAffine3 {
        self.levels[0].field.field_from_local()
    }

    fn bounds(&self) -> [Vec3; 2] {
        self.in_finest(self.outermost().field.bounds())
    }

    fn surface_bounds(&self) -> [Vec3; 2] {
        self.in_finest(self.outermost().field.surface_bounds())
    }

    fn voxel(&self) -> f64 {
        self.levels[0].field.voxel()
    }

    fn first_hit(&self, ray: &FieldRay, t_max: f32) -> (Option<FieldHit>, u32) {
        let parts: Vec<[f32; 2]> = self.levels.iter().map(|level| level.clip(ray, t_max)).collect();
        // Inwards to the finest level that the ray enters, then outwards again.
        let inwards = (1..self.levels.len()).rev().map(|k| (k, [parts[k][0], parts[k - 1][0].min(parts[k][1])]));
        let outwards = (1..self.levels.len()).map(|k| (k, [parts[k - 1][1].max(parts[k][0]), parts[k][1]]));
        let mut steps = 0;
        for (k, [from, to]) in inwards.chain([(0, parts[0])]).chain(outwards) {
            if from >= to {
                continue;
            }
            let level = &self.levels[k];
            let direction = level.scale * ray.direction;
            let piece = FieldRay { origin: level.in_its_grid(ray.origin) + from * direction, direction };
            let (hit, taken) = level.field.first_hit(&piece, to - from);
            steps += taken;
            if let Some(mut hit) = hit {
                hit.t += from;
                hit.at_start &= from == 0.0;
                return (Some(hit), steps);
            }
        }
        (None, steps)
    }

    fn distance(&self, p: Vec3) -> f32 {
        let (level, p) = self.at(p);
        level.field.distance(p)
    }

    fn distance_guess(&self, p: Vec3, distance: f32) -> f32 {
        let (level, p) = self.at(p);
        level.field.distance_guess(p, distance)
    }

    fn may_exceed_distance(&self) -> bool {
        self.levels.iter().any(|level| level.field.may_exceed_distance())
    }

    fn gradient(&self, p: Vec3) -> Vec3 {
        let (level, p) = self.at(p);
        level.field.gradient(p)
    }

    fn append_to(&self, tables: &mut DeviceFields<'_>) -> Result<bool, DeviceError> {
        let mut numbers = Vec::new();
        for level in &self.levels {
            if !level.field.append_to(tables)? {
                return Ok(false);
            }
            let [lower, upper] = level.region;
            numbers.extend([level.scale, level.offset, lower, upper].into_iter().flat_map(|triple| triple.to_array()));
        }
        tables.add_nested(self.levels.len(), &numbers)?;
        Ok(true)
    }
}
