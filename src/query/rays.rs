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
use std::ops::Range;

/// Number of rays between two checks of the progress.
const CHUNK: usize = 1024;
/// Size of a tree that stays in the cache at any order of the rays, bytes.
const CACHE: usize = 1 << 20;

/// Number of different keys of [`order_of`].
const KEYS: usize = 1 << 18;
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

/// The first hit of one ray, as it is stored in [`RayHits`].
#[derive(Debug, Clone, Copy)]
struct RayHit {
    t: f64,
    face: i64,
    weights: [f64; 3],
    normal: [f64; 3],
}

/// Result of a ray without a hit.
const MISS: RayHit = RayHit { t: f64::INFINITY, face: -1, weights: [0.0; 3], normal: [0.0; 3] };

/// The first hit of every ray.
pub fn cast_rays(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<RayHits, Error> {
    let found = trace(mesh, rays, progress, |ray, _| {
        let Some(hit) = mesh.first_hit(ray, |_| true) else { return MISS };
        let normal = unit_normal(mesh, mesh.exact_triangle(hit.face), hit.face).to_array();
        RayHit { t: hit.t, face: hit.face.into(), weights: hit.weights, normal }
    })?;
    let count = rays.origins.len();
    let mut hits = RayHits {
        t: vec![0.0; count],
        faces: vec![0; count],
        barycentric: vec![[0.0; 3]; count],
        normals: vec![[0.0; 3]; count],
    };
    let columns = (
        hits.t.par_chunks_mut(CHUNK),
        hits.faces.par_chunks_mut(CHUNK),
        hits.barycentric.par_chunks_mut(CHUNK),
        hits.normals.par_chunks_mut(CHUNK),
    );
    columns.into_par_iter().enumerate().for_each(|(chunk, (t, faces, barycentric, normals))| {
        for (i, hit) in found.rows(chunk * CHUNK..chunk * CHUNK + t.len()).enumerate() {
            (t[i], faces[i], barycentric[i], normals[i]) = (hit.t, hit.face, hit.weights, hit.normal);
        }
    });
    Ok(hits)
}

/// Whether each ray hits anything.
pub fn occluded(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<bool>, Error> {
    Ok(trace(mesh, rays, progress, |ray, _| mesh.is_occluded(ray))?.rows(0..rays.origins.len()).copied().collect())
}

/// The number of intersections of each ray; an edge or a vertex that several faces share counts once.
pub fn count_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Vec<i64>, Error> {
    mesh.topology();
    let counts = trace(mesh, rays, progress, |ray, scratch| {
        mesh.cast_all(ray, scratch);
        scratch.len() as i64
    })?;
    Ok(counts.rows(0..rays.origins.len()).copied().collect())
}

/// All intersections of all rays.
pub fn all_intersections(mesh: &Mesh, rays: &Rays<'_>, progress: &Progress) -> Result<Intersections, Error> {
    mesh.topology();
    let found = trace(mesh, rays, progress, |ray, scratch| {
        mesh.cast_all(ray, scratch);
        scratch.clone()
    })?;
    let mut all = Intersections::default();
    for (row, hits) in found.rows(0..rays.origins.len()).enumerate() {
        for hit in hits {
            all.rays.push(row as i64);
            all.t.push(hit.t);
            all.faces.push(i64::from(hit.face));
            all.barycentric.push(hit.weights);
        }
    }
    Ok(all)
}

/// Results in the order in which the rays were traced, in chunks of [`CHUNK`].
struct Traced<T> {
    chunks: Vec<Vec<T>>,
    /// The place of each row in that order; None if the rays were traced in the order of the rows.
    places: Option<Vec<u32>>,
}

impl<T> Traced<T> {
    /// The results of these rows. Reading out of order touches less memory than writing several arrays out of order.
    fn rows(&self, rows: Range<usize>) -> impl Iterator<Item = &T> {
        rows.map(|row| {
            let place = self.places.as_ref().map_or(row, |places| places[row] as usize);
            &self.chunks[place / CHUNK][place % CHUNK]
        })
    }
}

/// Processes every ray. `answer` also receives a reusable list of hits.
fn trace<T: Send + Sync>(
    mesh: &Mesh,
    rays: &Rays<'_>,
    progress: &Progress,
    answer: impl Fn(&Ray, &mut Vec<FaceHit>) -> T + Sync,
) -> Result<Traced<T>, Error> {
    check(rays)?;
    let count = rays.origins.len();
    progress.set_total(count as u64);
    mesh.bvh();
    mesh.ray_packs();
    let scale = mesh.scale().recip();
    let local = |row: usize| Ray {
        origin: mesh.local_from_world(DVec3::from_array(rays.origins[row])),
        direction: DVec3::from_array(rays.directions[row]) * scale,
        t_min: rays.t_min,
        t_max: rays.t_max,
    };
    let order = if count > CHUNK && is_scattered(mesh, rays) { Some(order_of(mesh, rays)) } else { None };
    let answer_chunk = |chunk: usize| {
        let mut scratch = Vec::new();
        let places = chunk * CHUNK..count.min((chunk + 1) * CHUNK);
        // Rays out of order are read first: a loop that does nothing else waits for several of them at once.
        let rays: Vec<Ray> = match &order {
            Some(order) => order[places].iter().map(|&row| local(row as usize)).collect(),
            None => places.map(local).collect(),
        };
        let answers: Vec<T> = rays.iter().map(|ray| answer(ray, &mut scratch)).collect();
        progress.advance(answers.len() as u64)?;
        Ok(answers)
    };
    if count <= CHUNK {
        // A few rays are processed without the worker threads.
        return Ok(Traced { chunks: vec![answer_chunk(0)?], places: None });
    }
    let chunks = (0..count.div_ceil(CHUNK)).into_par_iter().map(answer_chunk).collect::<Result<_, Error>>()?;
    let places = order.map(|order| {
        let mut places = vec![0u32; count];
        for (place, row) in order.into_iter().enumerate() {
            places[row as usize] = place as u32;
        }
        places
    });
    Ok(Traced { chunks, places })
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

/// Rows by the cell of the origin (16 to a side, along the Morton curve), then by the cell of the direction (8 to a side
/// of the octahedral map). Rows with equal keys keep their order.
fn order_of(mesh: &Mesh, rays: &Rays<'_>) -> Vec<u32> {
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
    let keys: Vec<u32> = (0..rays.origins.len()).into_par_iter().map(key).collect();
    let mut starts = vec![0u32; KEYS + 1];
    keys.iter().for_each(|&key| starts[key as usize + 1] += 1);
    for key in 0..KEYS {
        starts[key + 1] += starts[key];
    }
    let mut order = vec![0u32; keys.len()];
    for (row, &key) in keys.iter().enumerate() {
        let place = &mut starts[key as usize];
        order[*place as usize] = row as u32;
        *place += 1;
    }
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
