//! Points on the surface, uniform by area.
//!
//! Sample i depends on the seed and i only (a counter through the finaliser of SplitMix64, Steele, Lea and Flood 2014),
//! so the points are the same on any number of threads. Only additions, products, quotients and square roots are used,
//! which every platform rounds in the same way.

use super::nearest::unit_normal;
use crate::error::Error;
use crate::geometry::triangle_cross;
use crate::mesh::Mesh;
use crate::progress::Progress;
use glam::DVec3;
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
    let areas = Areas::of(mesh);
    let mut samples = SurfaceSamples {
        points: vec![[0.0; 3]; count],
        normals: vec![[0.0; 3]; count],
        faces: vec![0; count],
        barycentric: vec![[0.0; 3]; count],
    };
    let key = mix(seed);
    samples
        .points
        .par_chunks_mut(CHUNK)
        .zip(samples.normals.par_chunks_mut(CHUNK))
        .zip(samples.faces.par_chunks_mut(CHUNK))
        .zip(samples.barycentric.par_chunks_mut(CHUNK))
        .enumerate()
        .try_for_each(|(chunk, (((points, normals), faces), barycentric))| {
            // Loops of one memory access per sample wait for several samples at once.
            for start in (0..points.len()).step_by(BLOCK) {
                let block = start..points.len().min(start + BLOCK);
                let (mut members, mut corners) = ([0u32; BLOCK], [[DVec3::ZERO; 3]; BLOCK]);
                for i in block.clone() {
                    members[i - start] = areas.face_at(unit(key, 3 * (chunk * CHUNK + i) as u64));
                }
                for i in block.clone() {
                    corners[i - start] = mesh.exact_triangle(members[i - start]);
                }
                for i in block {
                    let first = 3 * (chunk * CHUNK + i) as u64;
                    let (v, w) = (unit(key, first + 1), unit(key, first + 2));
                    let (face, [a, b, c]) = (members[i - start], corners[i - start]);
                    let root = v.sqrt();
                    let weights = [1.0 - root, root * (1.0 - w), root * w];
                    points[i] = mesh.world_from_local(a * weights[0] + b * weights[1] + c * weights[2]).to_array();
                    normals[i] = unit_normal(mesh, [a, b, c], face).to_array();
                    faces[i] = i64::from(face);
                    barycentric[i] = weights;
                }
            }
            progress.advance(points.len() as u64)
        })?;
    Ok(samples)
}

/// Table of the faces by their fraction of the area.
struct Areas {
    /// Sum of the areas up to and including each face.
    sums: Vec<f64>,
    /// For each equal part of the total area, the first face that overlaps it: one look-up per sample instead of a
    /// search.
    first: Vec<u32>,
}

impl Areas {
    fn of(mesh: &Mesh) -> Self {
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

    /// The face that contains a fraction of the area, 0 to 1.
    fn face_at(&self, share: f64) -> u32 {
        let count = self.sums.len();
        let reached = share * self.sums[count - 1];
        let mut face = self.first[((share * count as f64) as usize).min(count - 1)] as usize;
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
