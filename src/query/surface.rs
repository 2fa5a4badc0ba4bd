//! Points on the surface, uniform by area.
//!
//! Sample i depends on the seed and i only (a counter through the finaliser of SplitMix64, Steele, Lea and Flood 2014),
//! so the points are the same on any number of threads. Only additions, products, quotients and square roots are used,
//! which every platform rounds in the same way.

use super::nearest::unit_normal;
use crate::error::Error;
use crate::geometry::triangle_cross;
use crate::memory::{prefetch, zeroed_rows};
use crate::mesh::Mesh;
use crate::mesh::derived::Derived;
use crate::progress::Progress;
use rayon::prelude::*;

/// Number of samples between two checks of the progress.
const CHUNK: usize = 1 << 14;
/// Number of samples that are computed side by side.
const BLOCK: usize = 64;

/// Samples of a surface, one entry per sample.
#[derive(Debug, Clone, Default)]
pub struct SurfaceSamples {
    /// World positions.
    pub points: Vec<[f64; 3]>,
    /// Unit normals of the faces.
    pub normals: Vec<[f64; 3]>,
    /// Face of each point.
    pub faces: Vec<i64>,
    /// Weights of the corners of the face.
    pub barycentric: Vec<[f64; 3]>,
}

/// `count` points, uniform by area.
pub fn sample_surface(mesh: &Mesh, count: usize, seed: u64, progress: &Progress) -> Result<SurfaceSamples, Error> {
    progress.set_total(count as u64);
    let areas: &Areas = mesh.derived();
    let mut samples = SurfaceSamples {
        points: zeroed_rows("samples", count)?,
        normals: zeroed_rows("samples", count)?,
        faces: zeroed_rows("samples", count)?,
        barycentric: zeroed_rows("samples", count)?,
    };
    let key = mix(seed);
    let columns = samples.points.par_chunks_mut(CHUNK).zip(samples.normals.par_chunks_mut(CHUNK));
    let columns = columns.zip(samples.faces.par_chunks_mut(CHUNK)).zip(samples.barycentric.par_chunks_mut(CHUNK));
    columns.enumerate().try_for_each(|(chunk, (((points, normals), faces), barycentric))| {
        let first = chunk * CHUNK;
        let order = order_of(key, first, points.len());
        // Every loop prefetches what the next one reads, so that the memory of several samples arrives at once.
        for block in order.chunks(BLOCK) {
            let mut members = [0u32; BLOCK];
            for &(share, _) in block {
                prefetch(&areas.first[areas.part(share)]);
            }
            for &(share, _) in block {
                prefetch(&areas.sums[areas.first[areas.part(share)] as usize]);
            }
            for (member, &(share, _)) in members.iter_mut().zip(block) {
                *member = areas.face_at(share);
                prefetch(&mesh.faces()[*member as usize]);
            }
            for &face in &members[..block.len()] {
                let corners = &mesh.faces()[face as usize];
                corners.iter().for_each(|&vertex| prefetch(&mesh.world_positions()[vertex as usize]));
            }
            for (&(_, i), &face) in block.iter().zip(&members) {
                let [a, b, c] = mesh.exact_triangle(face);
                let place = 3 * (first + i as usize) as u64;
                let (v, w) = (unit(key, place + 1), unit(key, place + 2));
                let root = v.sqrt();
                let weights = [1.0 - root, root * (1.0 - w), root * w];
                let i = i as usize;
                points[i] = mesh.world_from_local(a * weights[0] + b * weights[1] + c * weights[2]).to_array();
                normals[i] = unit_normal(mesh, triangle_cross([a, b, c]), face).to_array();
                faces[i] = i64::from(face);
                barycentric[i] = weights;
            }
        }
        progress.advance(points.len() as u64)
    })?;
    Ok(samples)
}

/// Number of equal parts of the area by which samples are sorted.
const PARTS: usize = 1 << 10;

/// The fractions of the area of consecutive samples, with their indices from `first`, nearly in increasing order: faces
/// that follow each other share vertices and pages of memory.
fn order_of(key: u64, first: usize, count: usize) -> Vec<(f64, u32)> {
    let shares: Vec<f64> = (first..first + count).map(|i| unit(key, 3 * i as u64)).collect();
    let part = |share: f64| (share * PARTS as f64) as usize % PARTS;
    let mut places = [0; PARTS];
    shares.iter().for_each(|&share| places[part(share)] += 1);
    let mut start = 0;
    for place in &mut places {
        start += std::mem::replace(place, start);
    }
    let mut order = vec![(0.0, 0); count];
    for (i, &share) in shares.iter().enumerate() {
        let place = &mut places[part(share)];
        order[*place] = (share, i as u32);
        *place += 1;
    }
    order
}

/// Table of the faces by their fraction of the area.
struct Areas {
    /// Sum of the areas up to and including each face.
    sums: Vec<f64>,
    /// For each equal part of the total area, the first face that overlaps it: one look-up per sample instead of a
    /// search.
    first: Vec<u32>,
}

impl Derived for Areas {
    fn derive(mesh: &Mesh) -> Self {
        let count = mesh.faces().len();
        let mut sum = 0.0;
        let sums: Vec<f64> = (0..count as u32)
            .map(|face| {
                sum += triangle_cross(mesh.exact_triangle(face)).length();
                sum
            })
            .collect();
        let mut first = Vec::with_capacity(count);
        let mut face = 0;
        for part in 0..count {
            let reached = sum * (part as f64 / count as f64);
            while face + 1 < count && sums[face] <= reached {
                face += 1;
            }
            first.push(face as u32);
        }
        Self { sums, first }
    }

    fn bytes(&self) -> usize {
        size_of_val(&self.sums[..]) + size_of_val(&self.first[..])
    }
}

impl Areas {
    /// Index in `first` of the part of the area that contains the fraction `share`, 0 to 1.
    fn part(&self, share: f64) -> usize {
        ((share * self.first.len() as f64) as usize).min(self.first.len() - 1)
    }

    /// The face that contains a fraction of the area, 0 to 1.
    fn face_at(&self, share: f64) -> u32 {
        let count = self.sums.len();
        let reached = share * self.sums[count - 1];
        let mut face = self.first[self.part(share)] as usize;
        // The product may round into the previous part.
        while face > 0 && self.sums[face - 1] > reached {
            face -= 1;
        }
        while face + 1 < count && self.sums[face] <= reached {
            face += 1;
        }
        face as u32
    }
}

/// The finaliser of SplitMix64.
fn mix(x: u64) -> u64 {
    let x = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ x >> 31
}

/// The number at an index of the stream of a key, from 0 to just below 1.
fn unit(key: u64, place: u64) -> f64 {
    (mix(key.wrapping_add(place.wrapping_mul(0x9e37_79b9_7f4a_7c15))) >> 11) as f64 / (1u64 << 53) as f64
}
