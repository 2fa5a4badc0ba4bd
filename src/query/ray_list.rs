//! The rays of a query.

use crate::bvh::rays::watertight::Ray;
use crate::mesh::Mesh;
use glam::DVec3;
use std::ops::Range;

/// Number of rays of a task, between two checks of the progress.
pub(super) const CHUNK: usize = 1024;

/// World-space rays: as many origins as directions, and the common range of `t` in lengths of the direction.
#[derive(Debug, Clone, Copy)]
pub struct Rays<'a> {
    /// Start of each ray, world units.
    pub origins: &'a [[f64; 3]],
    /// Direction of each ray, any length except 0.
    pub directions: &'a [[f64; 3]],
    /// Smallest parameter of a hit, lengths of the direction.
    pub t_min: f64,
    /// Largest parameter of a hit, lengths of the direction.
    pub t_max: f64,
}

impl Rays<'_> {
    /// Some rows in local coordinates.
    pub(super) fn local(&self, mesh: &Mesh, rows: Range<usize>) -> impl ExactSizeIterator<Item = Ray> {
        let scale = mesh.scale().recip();
        self.origins[rows.clone()].iter().zip(&self.directions[rows]).map(move |(&origin, &direction)| Ray {
            origin: mesh.local_from_world(DVec3::from_array(origin)),
            direction: DVec3::from_array(direction) * scale,
            t_min: self.t_min,
            t_max: self.t_max,
        })
    }
}
