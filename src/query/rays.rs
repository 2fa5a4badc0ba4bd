//! Arbitrary rays against a mesh: first hits, occlusion, counts and lists of all intersections.
//!
//! Rays come in any order. Streams of neighbouring rays (pictures, scans) share cached parts of the tree. Other rays
//! are sorted by origin and direction first if the tree is larger than the cache.

use super::nearest::unit_normal;
use crate::bvh::watertight::{FaceHit, Ray};
use crate::error::{ArgumentError, Error};
use crate::memory::zeroed_result;
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::progress::Progress;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::Range;

/// Number of rays between two checks of the progress.
const CHUNK: usize = 1024;
/// Size of a tree that stays in the cache at any order of the rays, bytes.
const CACHE: usize = 1 << 20;

/// Largest number of rays of a task. Longer tasks have more neighbours to sort, shorter ones stay in the cache.
const LARGEST_TASK: usize = 1 << 17;

/// Half the number of bits of a key of [`order_of`].
const DIGIT_BITS: u32 = 9;
/// Bits of a number of four bits, with two empty bits after each.
const SPREAD: [usize; 16] = {
    let mut table = [0; 16];
    let mut x = 0;
    while x < 16 {
        table[x] = x & 1 | (x & 2) << 2 | (x & 4) << 4 | (x & 8) << 6;
        x += 1;
    }
    table
};

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
pub fn cast_rays(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<RayHits, Error> {
    let count = rays.origins.len();
    let mut hits = RayHits {
        t: zeroed_result(count),
        faces: zeroed_result(count),
        barycentric: zeroed_result(count),
        normals: zeroed_result(count),
    };
    let size = task_size(count);
    let columns = hits.t.chunks_mut(size).zip(hits.faces.chunks_mut(size));
    let columns = columns.zip(hits.barycentric.chunks_mut(size)).zip(hits.normals.chunks_mut(size));
    trace(mesh, rays, progress, columns, |batch, (((t, faces), barycentric), normals), found| {
        mesh.first_hits(batch.rays, batch.near, found);
        for (&row, hit) in batch.rows.iter().zip(found) {
            let row = row as usize;
            match hit {
                Some(hit) => {
                    t[row] = hit.t;
                    faces[row] = hit.face.into();
                    barycentric[row] = hit.weights;
                    normals[row] = unit_normal(mesh, mesh.exact_triangle(hit.face), hit.face).to_array();
                }
                // The other columns contain zeros.
                None => (t[row], faces[row]) = (f64::INFINITY, -1),
            }
        }
    })?;
    Ok(hits)
}

/// Whether each ray hits anything.
pub fn occluded(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<bool>, Error> {
    let mut occluded = vec![false; rays.origins.len()];
    let columns = occluded.chunks_mut(task_size(rays.origins.len()));
    trace(mesh, rays, progress, columns, |batch, column, found| {
        mesh.are_occluded(batch.rays, batch.near, found);
        batch.rows.iter().zip(found).for_each(|(&row, &mut found)| column[row as usize] = found);
    })?;
    Ok(occluded)
}

/// The number of intersections of each ray; an edge or a vertex that several faces share counts once.
pub fn count_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<i64>, Error> {
    mesh.topology();
    let mut counts = vec![0; rays.origins.len()];
    let columns = counts.chunks_mut(task_size(rays.origins.len()));
    trace(mesh, rays, progress, columns, |batch, column, found| {
        for (&row, ray) in batch.rows.iter().zip(batch.rays) {
            mesh.cast_all(ray, found);
            column[row as usize] = found.len() as i64;
        }
    })?;
    Ok(counts)
}

/// All intersections of all rays.
pub fn all_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Intersections, Error> {
    mesh.topology();
    let mut lists = vec![Vec::new(); rays.origins.len()];
    let columns = lists.chunks_mut(task_size(rays.origins.len()));
    trace(mesh, rays, progress, columns, |batch, column, found: &mut Vec<FaceHit>| {
        for (&row, ray) in batch.rows.iter().zip(batch.rays) {
            mesh.cast_all(ray, found);
            column[row as usize] = found.clone();
        }
    })?;
    let mut all = Intersections::default();
    for (row, hits) in lists.iter().enumerate() {
        for hit in hits {
            all.rays.push(row as i64);
            all.t.push(hit.t);
            all.faces.push(i64::from(hit.face));
            all.barycentric.push(hit.weights);
        }
    }
    Ok(all)
}

/// Number of rays of a task. The result does not depend on it.
fn task_size(count: usize) -> usize {
    if count <= CHUNK { CHUNK } else { (count / (4 * rayon::current_num_threads())).clamp(CHUNK, LARGEST_TASK) }
}

/// Rays that are searched after each other.
struct Batch<'a> {
    rays: &'a [Ray],
    /// Rows of the rays in their task.
    rows: &'a [u32],
    /// Whether consecutive rays are near each other.
    near: bool,
}

/// Processes every ray. `columns` are the parts of the result, one for each task of [`task_size`] rays. `answer` gets a
/// batch of rays, the part of their task, and reusable memory.
fn trace<C: Send, S: Default>(
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
    columns: impl Iterator<Item = C>,
    answer: impl Fn(&Batch<'_>, &mut C, &mut S) + Sync,
) -> Result<(), Error> {
    check(rays)?;
    let count = rays.origins.len();
    progress.set_total(count as u64);
    mesh.bvh();
    mesh.ray_packs();
    let scale = mesh.scale().recip();
    let near = !is_scattered(mesh, rays);
    let sorts = !near && count > CHUNK && mesh.bvh().bytes() > CACHE;
    let size = task_size(count);
    let answer_task = |(task, mut column): (usize, C)| {
        let first = task * size;
        let rows = first..count.min(first + size);
        let order = if sorts { order_of(mesh, rays, rows) } else { (0..rows.len() as u32).collect() };
        let (mut rays_of_batch, mut scratch) = (Vec::with_capacity(CHUNK), S::default());
        for rows in order.chunks(CHUNK) {
            // Rays are read first: a loop that does nothing else waits for several of them at once.
            rays_of_batch.clear();
            rays_of_batch.extend(rows.iter().map(|&row| Ray {
                origin: mesh.local_from_world(DVec3::from_array(rays.origins[first + row as usize])),
                direction: DVec3::from_array(rays.directions[first + row as usize]) * scale,
                t_min: rays.t_min,
                t_max: rays.t_max,
            }));
            answer(&Batch { rays: &rays_of_batch, rows, near }, &mut column, &mut scratch);
            progress.advance(rows.len() as u64)?;
        }
        Ok(())
    };
    let tasks: Vec<(usize, C)> = columns.enumerate().collect();
    if count <= CHUNK {
        // A few rays are processed without the worker threads.
        return tasks.into_iter().try_for_each(answer_task);
    }
    tasks.into_par_iter().try_for_each(answer_task)
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

/// Rows of a task by the cell of the origin (16 to a side, along the Morton curve), then by the cell of the direction (8
/// to a side of the octahedral map). Rows with equal keys keep their order.
fn order_of(mesh: &Mesh, rays: &Rays<'_>, rows: Range<usize>) -> Vec<u32> {
    let key = |row: usize| {
        let origin = (mesh.local_from_world(DVec3::from_array(rays.origins[row])) + 1.0) * 8.0;
        let direction = DVec3::from_array(rays.directions[row]);
        let direction = direction / direction.abs().element_sum();
        let (u, v) = if direction.z < 0.0 {
            let folded = |x: f64, y: f64| (1.0 - y.abs()).copysign(x);
            (folded(direction.x, direction.y), folded(direction.y, direction.x))
        } else {
            (direction.x, direction.y)
        };
        // Casts saturate: origins outside the box share its outer cells. NaN becomes 0.
        let cell = |x: f64, cells: usize| (x as usize).min(cells - 1);
        let curve = SPREAD[cell(origin.x, 16)] << 2 | SPREAD[cell(origin.y, 16)] << 1 | SPREAD[cell(origin.z, 16)];
        (curve << 6 | cell(4.0 * u + 4.0, 8) << 3 | cell(4.0 * v + 4.0, 8)) as u32
    };
    let first = rows.start;
    let mut order: Vec<(u32, u32)> = rows.map(|row| (key(row), (row - first) as u32)).collect();
    let mut sorted = vec![(0, 0); order.len()];
    // Two passes of a counting sort, each by half of the bits.
    for shift in [0, DIGIT_BITS] {
        let digit = |key: u32| (key >> shift) as usize % (1 << DIGIT_BITS);
        let mut places = [0; 1 << DIGIT_BITS];
        order.iter().for_each(|&(key, _)| places[digit(key)] += 1);
        let mut start = 0;
        for place in &mut places {
            start += std::mem::replace(place, start);
        }
        for &(key, row) in &order {
            let place = &mut places[digit(key)];
            sorted[*place] = (key, row);
            *place += 1;
        }
        std::mem::swap(&mut order, &mut sorted);
    }
    order.into_iter().map(|(_, row)| row).collect()
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
