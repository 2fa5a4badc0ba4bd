//! Quadric surfaces: every point `x = (p, 1)` with `x^T A x = 0` that lies in a trim sphere.
//!
//! # Theory
//!
//! O. Lawlor, *Storing raytraced geometry in textures* (CS 481, University of Alaska Fairbanks, 2010): a symmetric 4x4
//! matrix represents a sphere, an ellipsoid, a cylinder, a cone, a paraboloid, a hyperboloid or a pair of planes. A
//! trim sphere limits it to a finite size. A record has six texels: four for the matrix, one for the centre and radius
//! of the trim sphere, one for the reflectance and opacity.
//!
//! Two changes are made here. First, the arithmetic is done in the frame of the trim sphere, where the trim sphere is
//! the unit ball and the largest entry of the matrix is 1 ([`local`]). About the world's origin the entries for a small
//! sphere far away cancel; in its own frame they do not, at any offset and scale. Second, shadows multiply: light that
//! crosses several quadrics of opacity `k` arrives with the product of their `1 - k`, where the article uses the
//! largest `k`.
//!
//! A quadric is a sheet without an inside. Each counts once per shadow ray, however often the ray crosses it. The
//! picture shows the nearest sheet; opacity applies to shadows only.
//!
//! # Practice
//!
//! [`Quadrics`] holds any number of quadrics with a tree over their trim boxes, in f64. It computes bounds, first hits,
//! transmittance, and a lower bound on the distance. [`draw`] makes a picture on the CPU, [`gpu`] the same picture on a
//! device, in float32 from records in a texture. Up to [`LINEAR_UP_TO`] quadrics are tried one by one, more are
//! searched through the tree.

pub(crate) mod draw;
pub(crate) mod gpu;
pub(crate) mod local;
mod picture;

use crate::bvh::boxes::BoxTree;
use crate::error::{ArgumentError, Error};
use crate::progress::Progress;
use glam::{DMat4, DVec3, Vec3};
use local::{Local, LocalRay};
use rayon::prelude::*;

/// Up to this number of quadrics, trying all of them is as fast as searching a tree.
pub const LINEAR_UP_TO: usize = 64;

/// Number of points of a batch between two checks of the progress: a few milliseconds.
const CHUNK_POINTS: usize = 1024;

/// A quadric surface in world space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Quadric {
    /// Symmetric matrix of any scale.
    pub matrix: DMat4,
    /// Centre of the trim sphere.
    pub center: DVec3,
    /// Radius of the trim sphere, world units.
    pub radius: f64,
    /// Linear RGB.
    pub reflectance: Vec3,
    /// Fraction of the light that one crossing blocks, 0 to 1.
    pub opacity: f32,
}

/// First intersection of a ray with a quadric.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct QuadricHit {
    /// Distance in multiples of the ray's direction.
    pub t: f64,
    /// Index of the quadric.
    pub quadric: u32,
    /// Unit normal in world space, on the side of the ray's origin.
    pub normal: DVec3,
}

/// Many quadrics prepared for rays, in the order of the tree.
#[derive(Debug, Clone)]
pub struct Quadrics {
    records: Vec<Quadric>,
    locals: Vec<Local>,
    tree: BoxTree,
    /// Position of each quadric in the order of the tree.
    places: Vec<u32>,
}

impl Quadrics {
    /// Fails for a quadric that is not finite, whose matrix is zero, or whose trim sphere has no radius.
    pub fn new(quadrics: &[Quadric]) -> Result<Self, Error> {
        for (i, quadric) in quadrics.iter().enumerate() {
            if let Err(problem) = quadric.check() {
                return Err(ArgumentError::new("quadrics", format!("[{i}]: {problem}")).into());
            }
        }
        let boxes: Vec<_> = quadrics.iter().map(Quadric::bounds).collect();
        let tree = BoxTree::new(&boxes);
        let records: Vec<_> = tree.order.iter().map(|&i| quadrics[i as usize]).collect();
        let locals = records.iter().map(Local::new).collect();
        let mut places = vec![0; records.len()];
        for (place, &i) in tree.order.iter().enumerate() {
            places[i as usize] = place as u32;
        }
        Ok(Self { records, locals, tree, places })
    }

    /// Number of quadrics.
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there are no quadrics.
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// The quadrics in the order of the tree.
    pub fn records(&self) -> &[Quadric] {
        &self.records
    }

    /// The matrices of the quadrics in the frames of their trim spheres, in the same order.
    pub fn locals(&self) -> &[Local] {
        &self.locals
    }

    /// The tree over the boxes of the quadrics.
    pub fn tree(&self) -> &BoxTree {
        &self.tree
    }

    /// Linear RGB of a quadric by its index.
    pub fn reflectance(&self, quadric: u32) -> Vec3 {
        self.records[self.places[quadric as usize] as usize].reflectance
    }

    /// Box around all trim spheres; `None` without quadrics.
    pub fn bounds(&self) -> Option<[DVec3; 2]> {
        self.records.iter().map(Quadric::bounds).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }

    /// The first quadric that `origin + t direction` crosses at a `t` in the range, and the number of quadrics and
    /// boxes tried.
    pub fn first_hit(&self, origin: DVec3, direction: DVec3, range: [f64; 2]) -> (Option<QuadricHit>, u32) {
        let mut nearest: Option<(f64, usize)> = None;
        let mut tried = 0;
        let visit = |place: usize, range: &mut [f64; 2]| {
            tried += 1;
            let Some(ray) = LocalRay::new(&self.locals[place], origin, direction) else { return };
            for t in ray.roots().into_iter().flatten().map(|root| ray.t(root)) {
                if t >= range[0] && t < range[1] {
                    nearest = Some((t, place));
                    range[1] = t;
                }
            }
        };
        let boxes = self.along(origin, direction, range, visit);
        let hit = nearest.map(|(t, place)| {
            let normal = self.locals[place].normal(origin + t * direction, direction);
            QuadricHit { t, quadric: self.tree.order[place], normal }
        });
        (hit, tried + boxes)
    }

    /// Fraction of the light that passes from `origin` along `direction` up to `t_max`, in multiples of the direction.
    /// `from` is the quadric on which the ray starts: the crossing at the origin is ignored, another crossing of the
    /// same quadric is not.
    pub fn transmittance(&self, origin: DVec3, direction: DVec3, t_max: f64, from: Option<u32>) -> f32 {
        let mut share = 1.0f32;
        self.along(origin, direction, [0.0, t_max], |place, range| {
            let Some(ray) = LocalRay::new(&self.locals[place], origin, direction) else { return };
            let mut roots = ray.roots();
            if from == Some(self.tree.order[place]) {
                ray.forget_start(&mut roots);
            }
            if roots.into_iter().flatten().map(|root| ray.t(root)).any(|t| t > 0.0 && t < t_max) {
                share *= 1.0 - self.records[place].opacity;
                if share == 0.0 {
                    // No light is left: an empty range ends the search.
                    range[1] = f64::NEG_INFINITY;
                }
            }
        });
        share
    }

    /// Lower bound on the distance from a point to the nearest quadric; infinite without quadrics.
    pub fn distance_bound(&self, p: DVec3) -> f64 {
        let mut least = f64::INFINITY;
        self.tree.around([p, p], f64::INFINITY, |place, limit| {
            least = least.min(self.locals[place].distance_bound(p));
            *limit = least;
        });
        least
    }

    /// [`Quadrics::distance_bound`] at many points.
    pub fn distance_bounds(&self, points: &[DVec3], progress: &Progress) -> Result<Vec<f64>, Error> {
        progress.set_total(points.len() as u64);
        let mut bounds = vec![0.0; points.len()];
        bounds.par_chunks_mut(CHUNK_POINTS).zip(points.par_chunks(CHUNK_POINTS)).try_for_each(|(bounds, points)| {
            for (bound, &p) in bounds.iter_mut().zip(points) {
                *bound = self.distance_bound(p);
            }
            progress.advance(points.len() as u64)
        })?;
        Ok(bounds)
    }

    /// Searches through the tree if there are enough quadrics.
    fn along(
        &self,
        origin: DVec3,
        direction: DVec3,
        mut range: [f64; 2],
        mut visit: impl FnMut(usize, &mut [f64; 2]),
    ) -> u32 {
        if self.len() > LINEAR_UP_TO {
            return self.tree.along_ray(origin, direction, range, visit);
        }
        for place in 0..self.len() {
            visit(place, &mut range);
        }
        0
    }
}

impl Quadric {
    /// Box of the trim sphere.
    pub fn bounds(&self) -> [DVec3; 2] {
        let radius = self.radius * (1.0 + Local::slack(self));
        [self.center - radius, self.center + radius]
    }

    fn check(&self) -> Result<(), String> {
        if !self.matrix.is_finite() || self.matrix == DMat4::ZERO {
            return Err(format!("matrix must be finite and not zero, got {}", self.matrix));
        }
        if !(self.center.is_finite() && self.radius.is_finite() && self.radius > 0.0) {
            return Err(format!(
                "center and radius must be finite, the radius above 0, got {}, {}",
                self.center, self.radius
            ));
        }
        if !(self.reflectance.is_finite() && (0.0..=1.0).contains(&self.opacity)) {
            let problem = format!(
                "reflectance must be finite, the opacity from 0 to 1, got {}, {}",
                self.reflectance, self.opacity
            );
            return Err(problem);
        }
        Ok(())
    }
}
