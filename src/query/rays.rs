//! Arbitrary rays against a mesh: first hits, occlusion, counts and lists of all intersections.
//!
//! Rays come in any order. Streams of neighbouring rays (pictures, scans) share cached parts of the tree. Other rays
//! are sorted by origin and direction first if the tree is larger than the cache.

use super::nearest::unit_normal;
use crate::bvh::watertight::{FaceHit, Ray};
use crate::error::{ArgumentError, Error};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;

/// Number of rays between two checks of the progress.
const CHUNK: usize = 1024;
/// Size of a tree that stays in the cache at any order of the rays, bytes.
const CACHE: usize = 1 << 20;

/// World-space rays: as many origins as directions, and the common range of `t` in lengths of the direction.
#[derive(Debug, Clone, Copy)]
pub struct Rays<'a> {
    pub origins: &'a [[f64; 3]],
    pub directions: &'a [[f64; 3]],
    pub t_min: f64,
    pub t_max: f64,
}

/// First hits, one entry per ray.
#[derive(Debug, Clone, Default)]
pub struct RayHits {
    /// Infinite for a miss.
    pub t: Vec<f64>,
    /// -1 for a miss.
    pub faces: Vec<i64>,
    pub barycentric: Vec<[f64; 3]>,
    /// Unit normals of the faces by their own winding; zero for a miss.
    pub normals: Vec<[f64; 3]>,
}

/// All intersections, sorted by ray and then `t`.
#[derive(Debug, Clone, Default)]
pub struct Intersections {
    pub rays: Vec<i64>,
    pub t: Vec<f64>,
    pub faces: Vec<i64>,
    pub barycentric: Vec<[f64; 3]>,
}

/// Result of a ray without a hit.
const MISS: FaceHit = FaceHit { t: f64::INFINITY, face: 0, weights: [0.0; 3], zeros: 0, is_front: false };

/// The first hit of every ray.
pub fn cast_rays(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<RayHits, Error> {
    let found = for_each_ray(mesh, rays, progress, |ray, _| {
        let hit = mesh.first_hit(ray, |_| true)?;
        Some((hit, unit_normal(mesh, mesh.exact_triangle(hit.face), hit.face)))
    })?;
    let count = found.len();
    let mut hits = RayHits {
        t: Vec::with_capacity(count),
        faces: Vec::with_capacity(count),
        barycentric: Vec::with_capacity(count),
        normals: Vec::with_capacity(count),
    };
    for hit in found {
        let (hit, normal) = hit.unwrap_or((MISS, DVec3::ZERO));
        hits.t.push(hit.t);
        hits.faces.push(if hit.t == f64::INFINITY { -1 } else { i64::from(hit.face) });
        hits.barycentric.push(hit.weights);
        hits.normals.push(normal.to_array());
    }
    Ok(hits)
}

/// Whether each ray hits anything.
pub fn occluded(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<bool>, Error> {
    for_each_ray(mesh, rays, progress, |ray, _| mesh.is_occluded(ray))
}

/// The number of intersections of each ray; an edge or a vertex that several faces share counts once.
pub fn count_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<i64>, Error> {
    mesh.topology();
    for_each_ray(mesh, rays, progress, |ray, scratch| {
        mesh.cast_all(ray, scratch);
        scratch.len() as i64
    })
}

/// All intersections of all rays.
pub fn all_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Intersections, Error> {
    mesh.topology();
    let found = for_each_ray(mesh, rays, progress, |ray, scratch| {
        mesh.cast_all(ray, scratch);
        scratch.clone()
    })?;
    let mut all = Intersections::default();
    for (row, hits) in found.iter().enumerate() {
        for hit in hits {
            all.rays.push(row as i64);
            all.t.push(hit.t);
            all.faces.push(i64::from(hit.face));
            all.barycentric.push(hit.weights);
        }
    }
    Ok(all)
}

/// Processes every ray and returns the results in the given order. `answer` also receives a reusable list of hits.
fn for_each_ray<T: Send + Default + Clone>(
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
    answer: impl Fn(&Ray, &mut Vec<FaceHit>) -> T + Sync,
) -> Result<Vec<T>, Error> {
    check(rays)?;
    let count = rays.origins.len();
    progress.set_total(count as u64);
    mesh.bvh();
    mesh.ray_packs();
    let local = |row: usize| Ray {
        origin: mesh.local_from_world(DVec3::from_array(rays.origins[row])),
        direction: DVec3::from_array(rays.directions[row]) / mesh.scale(),
        t_min: rays.t_min,
        t_max: rays.t_max,
    };
    let answer_chunk = |rows: &mut dyn Iterator<Item = usize>, answers: &mut [T]| -> Result<(), Error> {
        let mut scratch = Vec::new();
        for (row, slot) in rows.zip(answers.iter_mut()) {
            *slot = answer(&local(row), &mut scratch);
        }
        progress.advance(answers.len() as u64)
    };
    let mut answers = vec![T::default(); count];
    if count <= CHUNK {
        answer_chunk(&mut (0..count), &mut answers)?;
        return Ok(answers);
    }
    let order = if is_scattered(mesh, rays) { Some(order_of(mesh, rays)) } else { None };
    answers.par_chunks_mut(CHUNK).enumerate().try_for_each(|(chunk, answers)| {
        let rows = chunk * CHUNK..chunk * CHUNK + answers.len();
        match &order {
            Some(order) => answer_chunk(&mut order[rows].iter().map(|&(_, row)| row as usize), answers),
            None => answer_chunk(&mut rows.into_iter(), answers),
        }
    })?;
    let Some(order) = order else { return Ok(answers) };
    let mut in_rows = vec![T::default(); count];
    for ((_, row), value) in order.into_iter().zip(answers) {
        in_rows[row as usize] = value;
    }
    Ok(in_rows)
}

/// Whether sorting is worthwhile: the tree is larger than the cache, and consecutive rays are far apart.
fn is_scattered(mesh: &Mesh, rays: &Rays<'_>) -> bool {
    if mesh.bvh().bytes() < CACHE {
        return false;
    }
    let step = (rays.origins.len() / 64).max(1);
    let unit = |row: usize| DVec3::from_array(rays.directions[row]).normalize_or_zero();
    let local = |row: usize| mesh.local_from_world(DVec3::from_array(rays.origins[row]));
    let unlike = (0..rays.origins.len() - 1)
        .step_by(step)
        .filter(|&row| unit(row).dot(unit(row + 1)) < 0.99 || local(row).distance(local(row + 1)) > 0.05);
    unlike.count() > 16
}

/// Rows by the cell of the origin (32 to a side), then by the direction's octant and its cells (8 to a side).
fn order_of(mesh: &Mesh, rays: &Rays<'_>) -> Vec<(u32, u32)> {
    let key = |row: usize| {
        let origin = mesh.local_from_world(DVec3::from_array(rays.origins[row]));
        let direction = DVec3::from_array(rays.directions[row]).normalize_or_zero();
        // Casts saturate: origins outside the box share its outer cells.
        let cell = |x: f64, cells: f64| ((x + 1.0) * 0.5 * cells).clamp(0.0, cells - 1.0) as u32;
        let interleave = |p: DVec3, bits: u32| {
            let cells = f64::from(1u32 << bits);
            (0..bits).rev().fold(0u32, |code, bit| {
                let bit_of = |x: f64| (cell(x, cells) >> bit) & 1;
                code << 3 | bit_of(p.x) << 2 | bit_of(p.y) << 1 | bit_of(p.z)
            })
        };
        interleave(origin, 5) << 9 | interleave(direction, 3)
    };
    let mut order: Vec<(u32, u32)> =
        (0..rays.origins.len()).into_par_iter().map(|row| (key(row), row as u32)).collect();
    order.par_sort_unstable();
    order
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
    let finite = |p: &[f64; 3]| p.iter().all(|x| x.is_finite());
    if let Some(row) = origins.iter().position(|p| !finite(p)) {
        return Err(ArgumentError::new("origins", format!("origins[{row}] = {:?} is not finite", origins[row])));
    }
    if let Some(row) = directions.iter().position(|p| !finite(p) || *p == [0.0; 3]) {
        let problem = if finite(&directions[row]) { "has no length" } else { "is not finite" };
        return Err(ArgumentError::new("directions", format!("directions[{row}] = {:?} {problem}", directions[row])));
    }
    if rays.t_min > rays.t_max || rays.t_min.is_nan() || rays.t_max.is_nan() {
        let problem = format!("must be at most t_max ({}), got {}", rays.t_max, rays.t_min);
        return Err(ArgumentError::new("t_min", problem));
    }
    Ok(())
}
