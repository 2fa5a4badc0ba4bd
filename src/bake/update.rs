//! The bake of a mesh whose vertices moved, from the field of the mesh before the motion.
//!
//! *Distances.* Only the blocks of samples that a changed triangle can reach are computed again
//! ([`dense::Changes`] has the criterion and its proof).
//!
//! *Signs.* A winding number is the sum of the contributions of all triangles ([`crate::sign::crossing`]). It changes
//! by the contributions of the changed triangles at their new positions minus those at their old positions. Where these
//! cancel, the side stays. Elsewhere a sample outside before is inside now, and a sample inside before is decided anew
//! by a ray. This holds as long as the orientation of the faces and the caps of the openings are the same. Otherwise,
//! and for rules that do not count crossings, all signs are computed again.
//!
//! *Whole bakes.* Everything is computed again if the faces differ, if the origin or the scale of local coordinates
//! changed, because every position is then rounded differently, if most faces changed, in a band, and for the rules
//! that need the closest point.

use super::cpu::Job;
use super::signs::Counts;
use super::{Bake, BakeOptions, LocalGrid, cpu, dense};
use crate::bvh::{Bvh, FAR};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::crossing::{Axes, Samples, mark_row, sum_marks};
use crate::sign::openings::Openings;
use crate::sign::{SignMethod, SignRule};
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::ops::Range;
use std::time::Instant;

/// Share of changed faces above which a whole bake is cheaper.
const MOST_CHANGED: f64 = 0.5;

/// A finished bake on the CPU.
#[derive(Debug, Clone, Copy)]
pub struct Before<'a> {
    /// The mesh of the earlier bake.
    pub mesh: &'a Mesh,
    /// Distances in world units, x fastest.
    pub distances: &'a [f32],
    /// Number of undecided samples in its report.
    pub undecided: usize,
}

/// Bakes `mesh` on the CPU. `before` must be the bake of another mesh on the same grid with the same options. The
/// result has the bits of [`super::bake`].
pub fn update(
    before: &Before<'_>,
    mesh: &Mesh,
    grid: &Grid,
    options: &BakeOptions,
    progress: &Progress,
) -> Result<Bake, Error> {
    options.check(mesh, grid)?;
    let local = LocalGrid::new(grid, mesh);
    let has_samples = before.distances.len() == grid.len();
    let whole = || cpu::bake(mesh, grid, options, progress);
    if !has_samples || !is_comparable(before.mesh, mesh, options) || dense::reach(&local) > FAR {
        return whole();
    }
    let changed = changed_faces(before.mesh, mesh);
    if changed.len() as f64 > MOST_CHANGED * mesh.faces().len() as f64 {
        return whole();
    }
    partial(before, mesh, grid, local, options, &changed, progress)
}

/// Whether unchanged faces have the same local coordinates in both meshes, and the rule has partial updates.
fn is_comparable(before: &Mesh, mesh: &Mesh, options: &BakeOptions) -> bool {
    let by_closest = matches!(options.sign, SignMethod::Pseudonormal | SignMethod::Normal);
    before.center() == mesh.center()
        && before.scale() == mesh.scale()
        && before.has_faces_of(mesh)
        && options.band.is_none()
        && (options.thickness.is_some() || !by_closest)
}

/// Faces with a corner whose position differs.
fn changed_faces(before: &Mesh, mesh: &Mesh) -> Vec<u32> {
    let moved: Vec<bool> = before.world_positions().iter().zip(mesh.world_positions()).map(|(a, b)| a != b).collect();
    let is_changed = |face: &u32| mesh.faces()[*face as usize].iter().any(|&v| moved[v as usize]);
    (0..mesh.faces().len() as u32).filter(is_changed).collect()
}

fn partial(
    before: &Before<'_>,
    mesh: &Mesh,
    grid: &Grid,
    local: LocalGrid,
    options: &BakeOptions,
    changed: &[u32],
    progress: &Progress,
) -> Result<Bake, Error> {
    let what = format!("a field of {} x {} x {} samples", grid.shape[0], grid.shape[1], grid.shape[2]);
    let mut distances = allocate_samples(&what, grid.len(), 0)?;
    let mut seconds = Vec::new();
    let mut stage = |name, since: Instant| seconds.push((name, since.elapsed().as_secs_f64()));
    progress.set_total(2 * grid.len() as u64);

    let start = Instant::now();
    rayon::join(|| mesh.bvh(), || mesh.topology());
    progress.check()?;
    stage("tree and topology", start);

    let start = Instant::now();
    let (choice, mut report) = options.choose_sign(mesh);
    progress.check()?;
    stage("sign rule", start);

    let start = Instant::now();
    distances.copy_from_slice(before.distances);
    if !changed.is_empty() {
        let triangles = triangles_of(before.mesh, mesh, changed);
        let half = options.thickness.map(|thickness| 0.5 * thickness);
        let changes = dense::Changes::new(&triangles, &local, before.distances, mesh.scale(), half);
        // The scale is a power of two, so the product is exact.
        let scale = mesh.scale() as f32;
        match half {
            Some(half) => dense::update(mesh, &local, &changes, progress, &mut distances, |to, distance| {
                *to = (f64::from(distance * scale) - half) as f32;
            })?,
            None => dense::update(mesh, &local, &changes, progress, &mut distances, |to, distance| {
                *to = (distance * scale).copysign(*to);
            })?,
        }
    }
    stage("distance", start);

    let start = Instant::now();
    let counts = match &choice.rule {
        SignRule::Unsigned => {
            progress.advance(grid.len() as u64)?;
            let inside = if options.thickness.is_some() { count(&distances, |d| d < 0.0) } else { 0 };
            Counts { inside, undecided: 0 }
        }
        SignRule::Counted(openings) if has_sides_of(before.mesh, mesh, openings) => {
            let surface = [before.mesh, mesh].map(|of| oriented(of, changed));
            let pass = WindingChanges { mesh, local: &local, rule: &choice.rule, surface: &surface };
            pass.apply(&mut distances, progress)?;
            Counts { inside: count(&distances, f32::is_sign_negative), undecided: before.undecided }
        }
        rule => {
            distances.par_iter_mut().for_each(|d| *d = d.abs());
            Job { mesh, local, rule, progress }.signs(&mut distances, Counts::default())?
        }
    };
    report.finish(counts.inside, counts.undecided, options.thickness, grid);
    stage("sign", start);

    report.device = "cpu".into();
    report.peak_bytes = size_of_val(&distances[..]) + mesh.bytes();
    report.seconds = seconds;
    Ok(Bake { distances, report })
}

/// The changed faces before and after the motion.
fn triangles_of(before: &Mesh, mesh: &Mesh, changed: &[u32]) -> Bvh {
    let corners_of = |of: &Mesh, face: u32| of.faces()[face as usize].map(|v| of.positions()[v as usize]);
    let corners: Vec<[Vec3; 3]> =
        [before, mesh].into_iter().flat_map(|of| changed.iter().map(move |&face| corners_of(of, face))).collect();
    let faces: Vec<[u32; 3]> = (0..corners.len() as u32).map(|face| [0, 1, 2].map(|i| 3 * face + i)).collect();
    Bvh::build(corners.as_flattened(), &faces)
}

fn count(samples: &[f32], holds: impl Fn(f32) -> bool + Sync) -> usize {
    samples.par_iter().filter(|&&sample| holds(sample)).count()
}

/// Whether both meshes have the same orientation of faces and the same caps. `openings` belong to `mesh`.
fn has_sides_of(before: &Mesh, mesh: &Mesh, openings: &Openings) -> bool {
    before.topology().orientation == mesh.topology().orientation
        && before.topology().rim == mesh.topology().rim
        && (openings.caps.is_empty() || Openings::of(before).caps == openings.caps)
}

/// Corners of the changed faces that determine the sign, oriented.
fn oriented(mesh: &Mesh, changed: &[u32]) -> Vec<[DVec3; 3]> {
    let corners = |&face: &u32| mesh.topology().oriented_face(mesh, face);
    let position = |v: u32| mesh.exact_position(v);
    changed.iter().filter_map(corners).map(|corners| corners.map(position)).collect()
}

/// The changes of winding numbers by changed triangles.
struct WindingChanges<'a> {
    mesh: &'a Mesh,
    local: &'a LocalGrid,
    rule: &'a SignRule,
    /// The changed triangles at their old and at their new positions.
    surface: &'a [Vec<[DVec3; 3]>; 2],
}

impl WindingChanges<'_> {
    /// Sets the signs of the samples whose winding number changes.
    fn apply(&self, distances: &mut [f32], progress: &Progress) -> Result<(), Error> {
        let [nx, ny, nz] = self.local.shape();
        // The triangles of each plane, and the range of lines along x that they may cover.
        let mut planes = vec![(Vec::new(), ny..0); nz];
        for (age, triangles) in self.surface.iter().enumerate() {
            for (index, corners) in triangles.iter().enumerate() {
                let [lines, covered] = [1, 2].map(|axis| samples_between(&self.local.axes[axis], corners, axis));
                for (members, range) in &mut planes[covered] {
                    members.push((age, index));
                    *range = range.start.min(lines.start)..range.end.max(lines.end);
                }
            }
        }
        distances.par_chunks_mut(nx * ny).zip(&planes).enumerate().try_for_each(|(z, (samples, (members, lines)))| {
            if !lines.is_empty() {
                self.apply_to_lines(&mut samples[nx * lines.start..nx * lines.end], z, lines.start, members);
            }
            progress.advance((nx * ny) as u64)
        })
    }

    /// Sets the signs of some lines of plane `z`, from line `first` on. `members` are the age and the index of the
    /// triangles of that plane.
    fn apply_to_lines(&self, samples: &mut [f32], z: usize, first: usize, members: &[(usize, usize)]) {
        let [along, columns, rows] = self.local.axes;
        let nx = along.count;
        let columns = Samples { start: first, count: samples.len() / nx, ..columns };
        let mut changes = vec![0i16; samples.len()];
        for &(age, index) in members {
            let weight = if age == 0 { -1 } else { 1 };
            mark_row(self.surface[age][index], Axes::X, rows.at(z), &columns, &along, weight, &mut changes);
        }
        sum_marks(&along, &mut changes);
        for (i, (sample, change)) in samples.iter_mut().zip(changes).enumerate() {
            if change != 0 {
                let p = self.local.at([i % nx, first + i / nx, z]);
                let was_inside = sample.is_sign_negative();
                let is_inside = !was_inside || self.rule.is_inside_without_distance(self.mesh, p);
                *sample = if is_inside { -sample.abs() } else { sample.abs() };
            }
        }
    }
}

/// Indices of the samples of an axis between the lowest and the highest corner, and one more on each side for the
/// rounding.
fn samples_between(samples: &Samples, corners: &[DVec3; 3], axis: usize) -> Range<usize> {
    let [low, high] = [corners[0].min(corners[1]).min(corners[2]), corners[0].max(corners[1]).max(corners[2])];
    let index = |corner: DVec3| (corner[axis] - samples.first) / samples.step;
    let clamped = |index: f64| index.clamp(0.0, samples.count as f64) as usize;
    let (start, end) = (clamped(index(low).floor() - 1.0), clamped(index(high).ceil() + 2.0));
    start..end.max(start)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::bake;
    use crate::mesh::random::{soup, uniform};
    use proptest::prelude::*;
    use std::collections::HashSet;

    /// A sphere of triangles with some faces removed, and a small lattice of other triangles beside it.
    fn ball(missing: usize) -> Mesh {
        let (rings, sectors) = (14, 18);
        let mut vertices = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]];
        for ring in 1..rings {
            let polar = std::f64::consts::PI * f64::from(ring) / f64::from(rings);
            for sector in 0..sectors {
                let around = std::f64::consts::TAU * f64::from(sector) / f64::from(sectors);
                vertices.push([polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()]);
            }
        }
        let at = |ring: i32, sector: i32| i64::from(2 + (ring - 1) * sectors + sector % sectors);
        let mut faces = Vec::new();
        for sector in 0..sectors {
            faces.push([0, at(1, sector), at(1, sector + 1)]);
            faces.push([1, at(rings - 1, sector + 1), at(rings - 1, sector)]);
            for ring in 1..rings - 1 {
                faces.push([at(ring, sector), at(ring + 1, sector), at(ring + 1, sector + 1)]);
                faces.push([at(ring, sector), at(ring + 1, sector + 1), at(ring, sector + 1)]);
            }
        }
        faces.drain(..missing);
        Mesh::new(&vertices, &faces).expect("the faces have areas")
    }

    /// Moves the vertices within `radius` of a random vertex.
    fn pushed(mesh: &Mesh, radius: f64, size: f64, seed: u64) -> Vec<[f64; 3]> {
        let mut next = uniform(seed);
        let vertices = mesh.world_positions();
        let center = DVec3::from_array(vertices[(next() * vertices.len() as f64) as usize % vertices.len()]);
        let mut push = |p: &[f64; 3]| {
            let is_near = DVec3::from_array(*p).distance(center) < radius;
            if is_near { p.map(|x| x + size * (2.0 * next() - 1.0)) } else { *p }
        };
        vertices.iter().map(&mut push).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(60))]
        /// An update has the bits of a whole bake, for motions of a few vertices and of many, and twice in a row.
        #[test]
        fn an_update_has_the_bits_of_a_bake(
            seed in any::<u64>(), missing in prop::sample::select(vec![0usize, 0, 3, 200]),
            radius in prop::sample::select(vec![0.1, 0.5, 0.5, 3.0]), size in prop::sample::select(vec![0.01, 0.2]),
            sign in prop::sample::select(SignMethod::NAMES.map(|(_, sign)| sign).to_vec()),
            thickness in prop::sample::select(vec![None, None, Some(0.15), Some(40.0)]),
            band in prop::sample::select(vec![None, None, None, Some(2.0)]), is_soup in prop::bool::weighted(0.2),
            (lower, upper) in prop::sample::select(vec![(-1.2, 1.3), (-1.2, 1.3), (0.5, 0.5 + 1e-6), (1.5, 4.0), (4.0, 7.5)]),
            columns in prop::sample::select(vec![33, 33, 1])
        ) {
            let grid = Grid::new(DVec3::splat(lower), DVec3::splat(upper), [columns, 29, 37]).expect("a grid");
            let options = BakeOptions { sign, band, thickness };
            let mut mesh = if is_soup { soup(300, 0.2, seed) } else { ball(missing) };
            let mut field = bake(&mesh, &grid, &options, &Progress::new()).expect("a bake");
            for step in 0..2 {
                let moved = mesh.moved(&pushed(&mesh, radius, size, seed ^ step)).expect("a mesh");
                let before =
                    Before { mesh: &mesh, distances: &field.distances, undecided: field.report.undecided_voxels };
                let updated = update(&before, &moved, &grid, &options, &Progress::new()).expect("an update");
                let faces: Vec<[i64; 3]> = moved.input_faces().iter().map(|face| face.map(i64::from)).collect();
                let fresh = Mesh::new(moved.world_positions(), &faces).expect("a mesh");
                let whole = bake(&fresh, &grid, &options, &Progress::new()).expect("a bake");
                for (i, (a, b)) in updated.distances.iter().zip(&whole.distances).enumerate() {
                    prop_assert_eq!(a.to_bits(), b.to_bits(), "sample {}", i);
                }
                let facts = |report: &super::super::Report| {
                    (report.inside_voxels, report.undecided_voxels, report.warnings.clone(), report.boundary_edges)
                };
                prop_assert_eq!(facts(&updated.report), facts(&whole.report));
                (mesh, field) = (moved, updated);
            }
        }
    }

    #[test]
    fn few_blocks_are_computed_in_vain() {
        let grid = Grid::new(DVec3::splat(-1.2), DVec3::splat(1.2), [64; 3]).expect("a grid");
        let options = BakeOptions::default();
        let mesh = ball(0);
        let field = bake(&mesh, &grid, &options, &Progress::new()).expect("a bake");
        let moved = mesh.moved(&pushed(&mesh, 0.3, 0.02, 4)).expect("a mesh");
        let changed = changed_faces(&mesh, &moved);
        assert!(!changed.is_empty() && is_comparable(&mesh, &moved, &options));
        let local = LocalGrid::new(&grid, &moved);
        let triangles = triangles_of(&mesh, &moved, &changed);
        let changes = dense::Changes::new(&triangles, &local, &field.distances, mesh.scale(), None);
        let mut computed = vec![0.0; grid.len()];
        let put = |to: &mut f32, _| *to = 1.0;
        dense::update(&moved, &local, &changes, &Progress::new(), &mut computed, put).expect("an update");
        let after = bake(&moved, &grid, &options, &Progress::new()).expect("a bake");
        // The blocks of 4^3 samples that have another distance after the motion.
        let block_of = |i: usize| [i % 64, i / 64 % 64, i / (64 * 64)].map(|index| index / 4);
        let is_other = |&i: &usize| field.distances[i].abs() != after.distances[i].abs();
        let blocks = |holds: &dyn Fn(&usize) -> bool| -> HashSet<[usize; 3]> {
            (0..grid.len()).filter(holds).map(block_of).collect()
        };
        let (needed, computed) = (blocks(&is_other), blocks(&|&i| computed[i] == 1.0));
        assert!(!needed.is_empty() && needed.is_subset(&computed));
        // A tangent lies below the distance, so that some blocks beside these are computed in vain: on the bunny a
        // tenth.
        assert!(computed.len() <= needed.len() * 6 / 5, "{} blocks, not {}", computed.len(), needed.len());
    }
}
