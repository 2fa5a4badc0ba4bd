//! Arbitrary rays against a mesh: first hits, occlusion, counts and lists of all intersections.
//!
//! Rays come in any order. Neighbouring rays (pictures, scans) are searched in packets, other rays in turns. The
//! results do not depend on the choice, which a few samples of the rays decide.
//!
//! A graphics device searches all rays at once for the faces that they may hit ([`super::device_rays`]). The CPU then
//! computes the hits of these faces.

use super::device_rays::{Candidates, Search, candidates};
use super::nearest::unit_normal;
use super::ray_list::{CHUNK, Rays};
use crate::bvh::rays::watertight::{FaceHit, Ray};
use crate::error::{ArgumentError, Error};
use crate::gpu::Place;
use crate::memory::{require_rows, space_for, zeroed_rows};
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of intersections that are found between two comparisons with the free memory.
const HITS_PER_CHECK: usize = 1 << 18;

/// First hits, one entry per ray.
#[derive(Debug, Clone, Default)]
pub struct RayHits {
    /// Infinite for a miss.
    pub t: Vec<f64>,
    /// -1 for a miss.
    pub faces: Vec<i64>,
    /// Weights of the corners of the face.
    pub barycentric: Vec<[f64; 3]>,
    /// Unit normals of the faces by their own winding; zero for a miss.
    pub normals: Vec<[f64; 3]>,
}

/// All intersections, sorted by ray and then `t`.
#[derive(Debug, Clone, Default)]
pub struct Intersections {
    /// Index of the ray of each hit.
    pub rays: Vec<i64>,
    /// Parameter of each hit, lengths of the direction.
    pub t: Vec<f64>,
    /// Face of each hit.
    pub faces: Vec<i64>,
    /// Weights of the corners of the face.
    pub barycentric: Vec<[f64; 3]>,
}

/// The first hit of every ray.
pub fn cast_rays(place: &Place, mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<RayHits, Error> {
    let count = rays.origins.len();
    let mut hits = RayHits {
        t: zeroed_rows("results", count)?,
        faces: zeroed_rows("results", count)?,
        barycentric: zeroed_rows("results", count)?,
        normals: zeroed_rows("results", count)?,
    };
    let columns = hits.t.chunks_mut(CHUNK).zip(hits.faces.chunks_mut(CHUNK));
    let columns = columns.zip(hits.barycentric.chunks_mut(CHUNK)).zip(hits.normals.chunks_mut(CHUNK));
    trace(
        place,
        Search::First,
        mesh,
        rays,
        progress,
        columns,
        |batch, (((t, faces), barycentric), normals), _: &mut ()| {
            batch.first_hits(mesh, |i, hit| match hit {
                Some(hit) => {
                    t[i] = hit.t;
                    faces[i] = hit.face.into();
                    barycentric[i] = hit.weights;
                    normals[i] = unit_normal(mesh, hit.cross, hit.face).to_array();
                }
                // The other columns contain zeros.
                None => (t[i], faces[i]) = (f64::INFINITY, -1),
            });
            Ok(())
        },
    )?;
    Ok(hits)
}

/// Whether each ray hits anything.
pub fn occluded(place: &Place, mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<bool>, Error> {
    let mut occluded: Vec<bool> = zeroed_rows("results", rays.origins.len())?;
    trace(place, Search::Any, mesh, rays, progress, occluded.chunks_mut(CHUNK), |batch, column, _: &mut ()| {
        batch.are_occluded(mesh, |i, found| column[i] = found);
        Ok(())
    })?;
    Ok(occluded)
}

/// The number of intersections of each ray; an edge or a vertex that several faces share counts once.
pub fn count_intersections(
    place: &Place,
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
) -> Result<Vec<i64>, Error> {
    mesh.topology();
    let mut counts = zeroed_rows("results", rays.origins.len())?;
    trace(place, Search::All, mesh, rays, progress, counts.chunks_mut(CHUNK), |batch, column, lists| {
        batch.all_hits(mesh, lists);
        column.iter_mut().zip(lists).for_each(|(count, hits)| *count = hits.len() as i64);
        Ok(())
    })?;
    Ok(counts)
}

/// All intersections of all rays.
pub fn all_intersections(
    place: &Place,
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
) -> Result<Intersections, Error> {
    mesh.topology();
    let mut lists: Vec<Vec<(usize, FaceHit)>> = Vec::new();
    lists.resize_with(rays.origins.len().div_ceil(CHUNK), Vec::new);
    let count = AtomicUsize::new(0);
    trace(place, Search::All, mesh, rays, progress, lists.iter_mut(), |batch, list, found| {
        batch.all_hits(mesh, found);
        let rows = batch.rows.clone().zip(found.iter());
        list.extend(rows.flat_map(|(row, hits)| hits.iter().map(move |&hit| (row, hit))));
        list.shrink_to_fit();
        // The number of hits is unknown before, so the free memory is compared from time to time.
        let before = count.fetch_add(list.len(), Ordering::Relaxed);
        if before / HITS_PER_CHECK == (before + list.len()) / HITS_PER_CHECK {
            return Ok(());
        }
        require_rows::<(usize, FaceHit)>("intersections", 2 * HITS_PER_CHECK)
    })?;
    let count = count.into_inner();
    let mut all = Intersections {
        rays: space_for("intersections", count)?,
        t: space_for("intersections", count)?,
        faces: space_for("intersections", count)?,
        barycentric: space_for("intersections", count)?,
    };
    for list in lists {
        for (row, hit) in list {
            all.rays.push(row as i64);
            all.t.push(hit.t);
            all.faces.push(i64::from(hit.face));
            all.barycentric.push(hit.weights);
        }
        progress.check()?;
    }
    Ok(all)
}

/// Rays that are searched together.
struct Batch<'a> {
    rays: &'a Rays<'a>,
    rows: Range<usize>,
    /// Whether consecutive rays are near each other. The search by a device does not use this.
    near: bool,
    /// The faces that a device found for each ray; None if the CPU searches.
    found: Option<&'a [Candidates]>,
}

impl Batch<'_> {
    fn local(&self, mesh: &Mesh) -> impl ExactSizeIterator<Item = Ray> {
        self.rays.local(mesh, self.rows.clone())
    }

    /// Passes the index of each ray in the batch and its first hit to `finish`, in no particular order.
    fn first_hits(&self, mesh: &Mesh, mut finish: impl FnMut(usize, Option<FaceHit>)) {
        let Some(found) = self.found else { return mesh.first_hits(self.local(mesh), self.near, finish) };
        for (i, (ray, found)) in self.local(mesh).zip(found).enumerate() {
            let hit = match found.faces() {
                Some(faces) => mesh.first_hit_of_faces(faces, &ray),
                None => mesh.first_hit(&ray, |_| true),
            };
            finish(i, hit);
        }
    }

    /// Passes the index of each ray in the batch and whether it hits anything to `finish`, in no particular order.
    fn are_occluded(&self, mesh: &Mesh, mut finish: impl FnMut(usize, bool)) {
        let Some(found) = self.found else { return mesh.are_occluded(self.local(mesh), self.near, finish) };
        for (i, (ray, found)) in self.local(mesh).zip(found).enumerate() {
            let by_faces = || found.faces().map(|faces| mesh.is_occluded_by_faces(faces, &ray));
            finish(i, found.is_certain() || by_faces().unwrap_or_else(|| mesh.is_occluded(&ray)));
        }
    }

    fn all_hits(&self, mesh: &Mesh, lists: &mut Vec<Vec<FaceHit>>) {
        let Some(found) = self.found else { return mesh.all_hits(self.local(mesh), self.near, lists) };
        lists.resize_with(self.rows.len(), Vec::new);
        for (list, (ray, found)) in lists.iter_mut().zip(self.local(mesh).zip(found)) {
            match found.faces() {
                Some(faces) => mesh.cast_at_faces(faces, &ray, list),
                None => mesh.cast_all(&ray, list),
            }
        }
    }
}

/// Processes every ray. `columns` are the parts of the result, one for each [`CHUNK`] of rays. `evaluate` gets a batch
/// of rays, their part of the result, and reusable memory.
fn trace<C: Send, S: Default>(
    place: &Place,
    search: Search,
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
    columns: impl Iterator<Item = C>,
    evaluate: impl Fn(&Batch<'_>, &mut C, &mut S) -> Result<(), Error> + Sync,
) -> Result<(), Error> {
    check(rays)?;
    let count = rays.origins.len();
    progress.set_total(place.passes() * count as u64);
    mesh.bvh();
    let (found, near) = match place {
        Place::Cpu => {
            mesh.ray_packs();
            (Vec::new(), !is_scattered(mesh, rays))
        }
        Place::Gpu(context) => (candidates(context, mesh, rays, search, progress)?, false),
    };
    let answer_task = |scratch: &mut S, (task, mut column): (usize, C)| {
        let rows = task * CHUNK..count.min((task + 1) * CHUNK);
        let items = rows.len() as u64;
        evaluate(&Batch { rays, rows: rows.clone(), near, found: found.get(rows) }, &mut column, scratch)?;
        progress.advance(items)
    };
    let mut tasks = columns.enumerate();
    if count <= CHUNK {
        // A few rays are processed without the worker threads.
        return tasks.try_for_each(|task| answer_task(&mut S::default(), task));
    }
    tasks.collect::<Vec<_>>().into_par_iter().try_for_each_init(S::default, answer_task)
}

/// Whether consecutive rays are far apart.
fn is_scattered(mesh: &Mesh, rays: &Rays<'_>) -> bool {
    let step = (rays.origins.len() / 64).max(1);
    let unit = |row: usize| DVec3::from_array(rays.directions[row]).normalize_or_zero();
    let local = |row: usize| mesh.local_from_world(DVec3::from_array(rays.origins[row]));
    let unlike = (0..rays.origins.len().saturating_sub(1))
        .step_by(step)
        .filter(|&row| unit(row).dot(unit(row + 1)) < 0.99 || local(row).distance(local(row + 1)) > 0.05);
    unlike.count() > 16
}

fn check(rays: &Rays<'_>) -> Result<(), ArgumentError> {
    let (origins, directions) = (rays.origins, rays.directions);
    if origins.len() != directions.len() {
        let problem = format!("as many as origins ({}), got {}", origins.len(), directions.len());
        return Err(ArgumentError::new("directions", problem));
    }
    if u32::try_from(origins.len()).is_err() {
        return Err(ArgumentError::new("origins", format!("at most {} at a time, got {}", u32::MAX, origins.len())));
    }
    let finite = |p: &[f64; 3]| p[0].is_finite() & p[1].is_finite() & p[2].is_finite();
    let has_length = |p: &[f64; 3]| p[0].abs().max(p[1].abs()).max(p[2].abs()) >= f64::MIN_POSITIVE;
    if let Some(row) = first_failure(origins, finite) {
        return Err(ArgumentError::new("origins", format!("origins[{row}] = {:?} is not finite", origins[row])));
    }
    if let Some(row) = first_failure(directions, |p| finite(p) & has_length(p)) {
        let problem = match &directions[row] {
            direction if !finite(direction) => "is not finite",
            [0.0, 0.0, 0.0] => "has no length",
            _ => "is too short: its largest component is below 2.3e-308",
        };
        return Err(ArgumentError::new("directions", format!("directions[{row}] = {:?} {problem}", directions[row])));
    }
    if rays.t_min > rays.t_max || rays.t_min.is_nan() || rays.t_max.is_nan() {
        let problem = format!("must be at most t_max ({}), got {}", rays.t_max, rays.t_min);
        return Err(ArgumentError::new("t_min", problem));
    }
    Ok(())
}

/// The first row that is not `sound`. Each chunk is checked without an early end, which wide registers can do.
fn first_failure(rows: &[[f64; 3]], sound: impl Fn(&[f64; 3]) -> bool) -> Option<usize> {
    let chunk = rows.chunks(CHUNK).position(|rows| !rows.iter().fold(true, |all, p| all & sound(p)))?;
    let first = chunk * CHUNK;
    rows[first..].iter().position(|p| !sound(p)).map(|i| first + i)
}
