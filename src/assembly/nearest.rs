//! The smallest signed distance of a point over all bodies, for many configurations.
//!
//! *Theory.* Outside the box of a closed geometry the distance is at least the distance from the box. The geometries
//! of a point are searched in the order of these bounds, and each search starts with the smallest distance found so
//! far, so most points search one geometry. Where the point lies in a box, the side is determined before a geometry is
//! left out, because inside its distance is negative.
//!
//! Points are processed along a space-filling curve, as for a single mesh ([`crate::query`]). One curve serves all
//! configurations that share the points. The state of the search begins anew with each configuration, so a batch
//! returns the same bits as its configurations one by one, on any number of threads.

use super::{Bodies, Geometry, Similarity};
use crate::csg::parts::closed_form::Scratch;
use crate::error::{ArgumentError, Error};
use crate::memory::zeroed_rows;
use crate::progress::Progress;
use crate::query::{CHUNK, Search, curve};
use bytemuck::Zeroable;
use glam::DVec3;
use rayon::prelude::*;

/// The nearest point of one position over all bodies.
#[derive(Debug, Clone, Copy, Zeroable)]
pub struct Found {
    /// Negative inside, world units; infinite if no body has geometry.
    pub distance: f64,
    /// Unit gradient of the signed distance; zero if no body has geometry.
    pub gradient: [f64; 3],
    /// The nearest surface point, world position.
    pub point: [f64; 3],
    /// Weights of the corners of the face; zero for closed forms.
    pub weights: [f64; 3],
    /// The geometry, -1 if there is none.
    pub element: i64,
    /// Index into the faces of the mesh, -1 for closed forms.
    pub face: i64,
}

impl Found {
    const NONE: Self = Self {
        distance: f64::INFINITY,
        gradient: [0.0; 3],
        point: [f64::NAN; 3],
        weights: [0.0; 3],
        element: -1,
        face: -1,
    };
}

/// Configurations and points of one call.
#[derive(Debug, Clone, Copy)]
pub struct Request<'a> {
    /// World-from-body poses, row-major: the poses of all bodies, configuration by configuration.
    pub poses: &'a [[[f64; 4]; 4]],
    /// Number of configurations.
    pub configurations: usize,
    /// The points of all configurations, or the points of the first configuration, the second one and so on.
    pub points: &'a [[f64; 3]],
    /// Whether each configuration has its own points.
    pub is_paired: bool,
    /// The geometries that are searched.
    pub searched: &'a [bool],
}

impl Request<'_> {
    /// Number of points of a configuration.
    fn rows(&self) -> usize {
        if self.is_paired { self.points.len().checked_div(self.configurations).unwrap_or(0) } else { self.points.len() }
    }
}

/// Results in the order of the search, and the place of each row among them.
#[derive(Debug)]
pub struct NearestResults<T> {
    results: Vec<T>,
    places: Vec<u32>,
    rows: usize,
    is_paired: bool,
}

impl<T: Copy + Sync> NearestResults<T> {
    /// One value of each result, in the order of configurations and points.
    pub fn column<V: Zeroable + Copy + Send>(&self, value: impl Fn(&T) -> V + Sync) -> Result<Vec<V>, Error> {
        let mut column = zeroed_rows("results", self.results.len())?;
        column.par_iter_mut().enumerate().for_each(|(i, out)| {
            let first = i - i % self.rows;
            let place = self.places[if self.is_paired { i } else { i - first }] as usize;
            *out = value(&self.results[first + place]);
        });
        Ok(column)
    }
}

/// Finds the nearest point of every position in every configuration. `keep` selects the part of a result that is
/// stored.
pub fn nearest<T: Zeroable + Copy + Send + Sync>(
    bodies: &Bodies,
    request: &Request<'_>,
    keep: impl Fn(Found) -> T + Sync,
    progress: &Progress,
) -> Result<NearestResults<T>, Error> {
    let rows = request.rows();
    if u32::try_from(rows).is_err() {
        let problem = format!("at most {} at a time, got {rows}", u32::MAX);
        return Err(ArgumentError::new("points", problem).into());
    }
    for element in &bodies.elements {
        if let Geometry::Mesh(mesh) = &element.geometry {
            mesh.bvh();
            mesh.winding_choice().rule.prepare(mesh);
        }
    }
    let total = rows * request.configurations;
    progress.set_total(total as u64);
    let orders = if request.is_paired {
        request.points.chunks(rows.max(1)).map(|points| curve(points, progress)).collect::<Result<Vec<_>, _>>()?
    } else {
        vec![curve(request.points, progress)?]
    };
    let mut results: Vec<T> = zeroed_rows("results", total)?;
    // A task is a part of one configuration, or several small configurations.
    let whole = (CHUNK / rows.max(1)).max(1);
    let mut tasks = Vec::new();
    let mut rest = &mut results[..];
    for first in (0..request.configurations).step_by(whole) {
        let mut own = rest.split_off_mut(..rows * whole.min(request.configurations - first)).unwrap_or_default();
        let mut start = 0;
        while !own.is_empty() {
            let count = if whole > 1 { own.len() } else { own.len().min(CHUNK) };
            tasks.push((first, start, own.split_off_mut(..count).unwrap_or_default()));
            start += count;
        }
    }
    let search_part = |(configuration, start, out): (usize, usize, &mut [T])| -> Result<(), Error> {
        let mut state = State::new(bodies);
        let count = out.len();
        for (number, out) in out.chunks_mut(if whole > 1 { rows } else { count }).enumerate() {
            let configuration = configuration + number;
            state.pose(request, configuration);
            let order = &orders[if request.is_paired { configuration } else { 0 }][start..start + out.len()];
            let points = if request.is_paired { &request.points[configuration * rows..] } else { request.points };
            for (&row, out) in order.iter().zip(out) {
                *out = keep(state.nearest(DVec3::from_array(points[row as usize]), row)?);
                progress.check()?;
            }
        }
        progress.advance(count as u64)
    };
    if total <= CHUNK {
        tasks.into_iter().try_for_each(search_part)?;
    } else {
        tasks.into_par_iter().try_for_each(search_part)?;
    }
    let mut places: Vec<u32> = zeroed_rows("rows", request.points.len())?;
    for (order, places) in orders.iter().zip(places.chunks_mut(rows.max(1))) {
        order.iter().enumerate().for_each(|(place, &row)| places[row as usize] = place as u32);
    }
    Ok(NearestResults { results, places, rows: rows.max(1), is_paired: request.is_paired })
}

/// One searched geometry in the current configuration.
struct Posed<'a> {
    element: usize,
    /// World from geometry.
    place: Similarity,
    /// The search of a mesh; none for closed forms.
    search: Option<Search<'a>>,
}

/// State of the search in one configuration.
struct State<'a> {
    bodies: &'a Bodies,
    posed: Vec<Posed<'a>>,
    /// Lower bounds of the distances that are not known yet, and indices in `posed`.
    waiting: Vec<(f64, usize)>,
    scratch: Scratch,
}

impl<'a> State<'a> {
    fn new(bodies: &'a Bodies) -> Self {
        Self { bodies, posed: Vec::new(), waiting: Vec::new(), scratch: Scratch::default() }
    }

    /// Begins a configuration.
    fn pose(&mut self, request: &Request<'_>, configuration: usize) {
        let poses = &request.poses[configuration * self.bodies.count..];
        self.posed.clear();
        for (i, element) in self.bodies.elements.iter().enumerate().filter(|&(i, _)| request.searched[i]) {
            let place = Similarity::from_rows(&poses[element.body], 1.0).after(&element.place);
            let search = match &element.geometry {
                Geometry::Mesh(mesh) => Some(Search::new(mesh)),
                Geometry::Shape(_) => None,
            };
            self.posed.push(Posed { element: i, place, search });
        }
    }

    /// The nearest point of a world position; `row` is its index, for errors.
    fn nearest(&mut self, p: DVec3, row: u32) -> Result<Found, Error> {
        self.waiting.clear();
        for (i, posed) in self.posed.iter().enumerate() {
            let bound = self.bodies.elements[posed.element].bounds.map_or(f64::NEG_INFINITY, |[lower, upper]| {
                let local = posed.place.inverse_point(p);
                let away = (lower - local).max(local - upper).max(DVec3::ZERO).length();
                // The inside may have any depth in the box.
                if away > 0.0 { away * posed.place.scale } else { f64::NEG_INFINITY }
            });
            self.waiting.push((bound, i));
        }
        let mut best = Found::NONE;
        loop {
            let least = (0..self.waiting.len()).min_by(|&a, &b| self.waiting[a].0.total_cmp(&self.waiting[b].0));
            let Some(least) = least.filter(|&i| self.waiting[i].0 <= best.distance) else { break };
            let (_, i) = self.waiting.swap_remove(least);
            let found = self.search(i, p, row, best.distance)?;
            // Among equal distances the lowest row is the result, in any order of the search.
            if found.is_some_and(|found| {
                found.distance < best.distance || (found.distance == best.distance && found.element < best.element)
            }) {
                best = found.unwrap_or(best);
            }
        }
        if let Some(Geometry::Shape(shape)) = self.bodies.elements.get(best.element as usize).map(|e| &e.geometry) {
            let posed = self.posed.iter().find(|posed| posed.element == best.element as usize);
            if let Some(posed) = posed {
                let local = posed.place.inverse_point(p);
                let gradient = posed.place.rotation * shape.tangent(local, &mut self.scratch).gradient;
                best.gradient = gradient.to_array();
                best.point = (p - best.distance * gradient).to_array();
            }
        }
        Ok(best)
    }

    /// The nearest point of one geometry; none if its distance certainly exceeds `limit`.
    fn search(&mut self, i: usize, p: DVec3, row: u32, limit: f64) -> Result<Option<Found>, Error> {
        let posed = &mut self.posed[i];
        let (place, element) = (posed.place, posed.element as i64);
        let local = place.inverse_point(p);
        match &self.bodies.elements[posed.element].geometry {
            Geometry::Shape(shape) => {
                let distance = shape.distance(local, &mut self.scratch) * place.scale;
                Ok(Some(Found { distance, element, ..Found::NONE }))
            }
            Geometry::Mesh(mesh) => {
                if !mesh.can_reach(local) {
                    let problem = format!("points[{row}] is too far from a body for float32 distances");
                    return Err(ArgumentError::new("points", problem).into());
                }
                let Some(search) = &mut posed.search else { return Ok(None) };
                Ok(search.nearest(local, limit / place.scale).map(|found| Found {
                    distance: found.distance * place.scale,
                    gradient: (place.rotation * found.gradient).to_array(),
                    point: place.point(found.point).to_array(),
                    weights: found.weights,
                    element,
                    face: found.face.into(),
                }))
            }
        }
    }
}
