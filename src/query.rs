//! Closest points and signed distances at arbitrary positions.
//!
//! *Theory.* Many points are processed along a space-filling curve (Morton order of their positions), so that
//! neighbouring points share work: the nodes of the tree are in the cache, the distance to the previous point's closest
//! point bounds the next search, and the side can be carried over by the shell lemma. No surface lies within the
//! distance of p, so every point there is on the same side as p. For open meshes this holds in the part of that ball
//! that does not intersect the cones that close the openings.
//!
//! On a graphics device, the nearest faces of all points are searched at once ([`device`]), and so are the faces that
//! rays may hit ([`device_rays`]).
//!
//! [`signed_distances`] uses the nearest face of the float32 search. [`nearest`] compares in float64 and returns all
//! properties of the nearest point.
//!
//! The order is cut into chunks of fixed size, so the result does not depend on the number of threads.

mod clouds;
mod device;
mod device_rays;
mod inside;
mod nearest;
mod precise;
mod ray_list;
mod rays;
mod surface;
mod thickness;

pub use clouds::{CloudQuery, cloud_contains, cloud_winding_numbers, query_cloud};
pub use inside::{contains, derive_winding_tables, winding_numbers};
pub use nearest::{ClosestPoints, Nearest, Query, Search, closest_points, query};
pub use precise::{precise_signed_distances, refined};
pub use ray_list::Rays;
pub use rays::{Intersections, RayHits, all_intersections, cast_rays, count_intersections, occluded};
pub use surface::{SurfaceSamples, sample_surface};
pub use thickness::thickness;

use crate::bvh::nearest::closest::ClosestPoint;
use crate::error::{ArgumentError, Error};
use crate::geometry::morton_code;
use crate::gpu::{self, Place};
use crate::memory::{prefetch, space_for, zeroed_rows};
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SideWalk, SignChoice, SignMethod, SignRule};
use glam::DVec3;
use rayon::prelude::*;
use std::mem::MaybeUninit;
use std::ops::Deref;

/// Number of points of a task.
pub(crate) const CHUNK: usize = 1024;
/// Number of rows from a prefetch to its use.
const AHEAD: usize = 8;
/// Largest number of points that are processed in their own order, by the calling thread.
const FEW: usize = 64;
/// Largest number of keys that are sorted without a check of the progress, and the number of parts of a longer list.
const SORTED_AT_ONCE: usize = 1 << 21;
const SORTED_PARTS: usize = 256;
/// Number of bits of the Morton code for each axis.
const MORTON_BITS: u32 = 21;
/// Fewest points or rays that `device="auto"` sends to a device. The CPU searches fewer in a few milliseconds, in which
/// a device does not start.
const DEVICE_ROWS: usize = 4096;
/// Largest number of vertices for each point or ray that `device="auto"` sends to a device, which copies the mesh
/// first.
const VERTICES_PER_ROW: usize = 8;
/// Slack for the float32 rounding of a bound, relative and in local units: ten times the rounding.
const SLACK: (f64, f64) = (1e-5, 1e-6);

/// Signed distance of each world position, world units, negative inside.
pub fn signed_distances(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    method: SignMethod,
    progress: &Progress,
) -> Result<Vec<f32>, Error> {
    check_points(mesh, points)?;
    let choice = prepare(mesh, method);
    let ordered = evaluate_in_order(place, mesh, points, progress, |walk, p, row| {
        let closest = walk.closest_point(p, row);
        let inside = walk.is_inside(&choice.rule, p, &closest);
        let unsigned = closest.distance * mesh.scale();
        (if inside && unsigned > 0.0 { -unsigned } else { unsigned }) as f32
    })?;
    ordered.into_rows(progress)
}

/// Replaces "auto" by "cpu" if `rows` points or rays are too few for a device. Other names are returned unchanged, and
/// so is "auto" if the environment names a device.
pub fn device_for<'a>(device: &'a str, mesh: &Mesh, rows: usize) -> &'a str {
    if device == "auto" && are_few(mesh, rows) && !gpu::is_overridden() { "cpu" } else { device }
}

fn are_few(mesh: &Mesh, rows: usize) -> bool {
    rows < DEVICE_ROWS || VERTICES_PER_ROW * rows < mesh.positions().len()
}

/// Results along the curve.
struct OrderedResults<T> {
    /// The row of each result.
    order: Vec<u32>,
    results: Vec<T>,
}

impl<T: Copy + Sync> OrderedResults<T> {
    /// Passes every result to `write` with its part of the columns and its index in that part. `columns` are the parts
    /// of the output, one for each [`CHUNK`] of rows. Reading the results out of order touches less memory than writing
    /// several arrays out of order.
    fn write_rows<C: Send>(
        &self,
        progress: &Progress,
        columns: impl Iterator<Item = C>,
        write: impl Fn(&mut C, usize, &T) + Sync,
    ) -> Result<(), Error> {
        let mut places: Vec<u32> = zeroed_rows("rows", self.order.len())?;
        for (place, &row) in self.order.iter().enumerate() {
            places[row as usize] = place as u32;
        }
        let result = |place: u32| &self.results[place as usize];
        let write_part = |(places, mut column): (&[u32], C)| -> Result<(), Error> {
            for (i, &place) in places.iter().enumerate() {
                if let Some(&later) = places.get(i + AHEAD) {
                    prefetch(result(later));
                }
                write(&mut column, i, result(place));
            }
            progress.check()
        };
        let parts: Vec<_> = places.chunks(CHUNK).zip(columns).collect();
        if parts.len() <= 1 {
            // A few rows are written without the worker threads.
            return parts.into_iter().try_for_each(write_part);
        }
        parts.into_par_iter().try_for_each(write_part)
    }
}

impl<T: Copy + Sync + Send + bytemuck::Zeroable> OrderedResults<T> {
    /// The results in the order of the points.
    fn into_rows(self, progress: &Progress) -> Result<Vec<T>, Error> {
        let mut rows = zeroed_rows("results", self.order.len())?;
        self.write_rows(progress, rows.chunks_mut(CHUNK), |column, i, &result| column[i] = result)?;
        Ok(rows)
    }
}

/// Builds the tree and the tables of the sign method. If the mesh has both, no worker thread is used.
fn prepare(mesh: &Mesh, method: SignMethod) -> Choice<'_> {
    if !mesh.is_prepared() {
        rayon::join(|| mesh.bvh(), || mesh.topology());
    }
    let choice = match method {
        SignMethod::Auto | SignMethod::Winding => Choice::Kept(mesh.winding_choice()),
        _ => Choice::Made(SignChoice::new(mesh, method)),
    };
    choice.rule.prepare(mesh);
    choice
}

/// A rule that the mesh keeps, or one made for this call.
enum Choice<'a> {
    Kept(&'a SignChoice),
    Made(SignChoice),
}

impl Deref for Choice<'_> {
    type Target = SignChoice;

    fn deref(&self) -> &SignChoice {
        match self {
            Self::Kept(choice) => choice,
            Self::Made(choice) => choice,
        }
    }
}

/// State of one pass along the curve, from the previous points.
struct Walk<'a> {
    mesh: &'a Mesh,
    /// The nearest face of each point if a device has searched; else empty.
    faces: &'a [u32],
    /// The closest point of the previous point.
    last: Option<DVec3>,
    sides: SideWalk,
}

impl Walk<'_> {
    fn closest_point(&mut self, p: DVec3, row: u32) -> ClosestPoint {
        if let Some(face) = self.face_of_device(row) {
            return self.mesh.closest_point_on_face(face, p);
        }
        let bound = self.bound(p);
        let found = self.mesh.closest_point_within(p, (bound * bound) as f32);
        let closest = found.unwrap_or_else(|| self.mesh.closest_point(p));
        self.last = Some(closest.on_triangle.point);
        closest
    }

    /// The closest point of the mesh's own float64 positions, the face chosen in float64.
    fn exact_closest_point(&mut self, p: DVec3, row: u32) -> ClosestPoint {
        if let Some(face) = self.face_of_device(row) {
            return self.mesh.exact_point_on_face(face, p);
        }
        let closest = self.mesh.exact_closest_point(p, self.bound(p));
        self.last = Some(closest.on_triangle.point);
        closest
    }

    fn face_of_device(&self, row: u32) -> Option<u32> {
        self.faces.get(row as usize).copied().filter(|&face| face != device::UNFINISHED)
    }

    /// An upper bound on the distance at `p`: that to the closest point of the previous point.
    fn bound(&self, p: DVec3) -> f64 {
        let bound = self.last.map_or(f64::INFINITY, |closest| p.distance(closest));
        bound * (1.0 + SLACK.0) + SLACK.1
    }

    fn is_inside(&mut self, rule: &SignRule, p: DVec3, closest: &ClosestPoint) -> bool {
        self.sides.is_inside(rule, self.mesh, p, closest)
    }
}

/// Processes every point, with near points after each other.
fn evaluate_in_order<T: Copy + Send>(
    place: &Place,
    mesh: &Mesh,
    points: &[[f64; 3]],
    progress: &Progress,
    evaluate: impl Fn(&mut Walk<'_>, DVec3, u32) -> T + Sync,
) -> Result<OrderedResults<T>, Error> {
    progress.set_total(place.passes() * points.len() as u64);
    let faces = match place {
        Place::Cpu => Vec::new(),
        Place::Gpu(context) => device::nearest_faces(context, mesh, points, progress)?,
    };
    let answer_chunk = |(rows, results): (&[u32], &mut [MaybeUninit<T>])| -> Result<(), Error> {
        let mut walk = Walk { mesh, faces: &faces, last: None, sides: SideWalk::default() };
        for (i, (&row, result)) in rows.iter().zip(results).enumerate() {
            if let Some(&later) = rows.get(i + AHEAD) {
                prefetch(&points[later as usize]);
            }
            let p = mesh.local_from_world(DVec3::from_array(points[row as usize]));
            result.write(evaluate(&mut walk, p, row));
            // A point takes from a tenth of a microsecond to many milliseconds.
            progress.check()?;
        }
        progress.advance(rows.len() as u64)
    };
    let order = curve(points, progress)?;
    let mut results = space_for("results", order.len())?;
    let room = &mut results.spare_capacity_mut()[..order.len()];
    if order.len() <= CHUNK {
        answer_chunk((&order, room))?;
    } else {
        order.par_chunks(CHUNK).zip(room.par_chunks_mut(CHUNK)).try_for_each(answer_chunk)?;
    }
    // SAFETY: without an error each chunk has written one result for each of its rows, and the chunks cover all rows.
    unsafe { results.set_len(order.len()) };
    Ok(OrderedResults { order, results })
}

/// Rows in order of the Morton code, or in their own order if there are too few.
pub(crate) fn curve(points: &[[f64; 3]], progress: &Progress) -> Result<Vec<u32>, Error> {
    if points.len() <= FEW {
        return Ok((0..points.len() as u32).collect());
    }
    let (lower, upper) = points
        .par_iter()
        .map(|&p| (DVec3::from_array(p), DVec3::from_array(p)))
        .reduce(|| (DVec3::INFINITY, DVec3::NEG_INFINITY), |a, b| (a.0.min(b.0), a.1.max(b.1)));
    // A key is the code of a point above its row: half the memory of a pair. At most 32 bits of a row leave 10 bits of
    // the code for each axis.
    let row_bits = points.len().ilog2() + 1;
    let axis_bits = MORTON_BITS.min((u64::BITS - row_bits) / 3);
    // Halves are subtracted, because the difference of two finite numbers may overflow.
    let cells = f64::from(1u32 << axis_bits) - 1.0;
    let scale = cells * 0.5 / (upper * 0.5 - lower * 0.5).max(DVec3::splat(f64::MIN_POSITIVE));
    let key = |(row, &p): (usize, &[f64; 3])| {
        let cell = (DVec3::from_array(p) * 0.5 - lower * 0.5) * 2.0 * scale;
        // Casting saturates.
        morton_code(cell.to_array().map(|x| x as u64)) << row_bits | row as u64
    };
    let mut keys: Vec<u64> = space_for("points", points.len())?;
    points.par_iter().enumerate().map(key).collect_into_vec(&mut keys);
    let keys = sorted(keys, progress)?;
    let mut rows = space_for("rows", keys.len())?;
    keys.into_par_iter().map(|key| (key & ((1 << row_bits) - 1)) as u32).collect_into_vec(&mut rows);
    Ok(rows)
}

/// Sorts keys that differ from each other. A long list is divided into parts by some of its keys, and each part is
/// sorted on its own, so that the work can be cancelled.
fn sorted(mut keys: Vec<u64>, progress: &Progress) -> Result<Vec<u64>, Error> {
    if keys.len() <= SORTED_AT_ONCE {
        keys.par_sort_unstable();
        return Ok(keys);
    }
    // Keys at equal steps of the list, many for each part, divide it into parts of similar length.
    let mut sample: Vec<u64> = keys.iter().step_by(keys.len() / (64 * SORTED_PARTS)).copied().collect();
    sample.sort_unstable();
    let bounds: Vec<u64> = (1..SORTED_PARTS).map(|part| sample[part * sample.len() / SORTED_PARTS]).collect();
    // Each chunk is ordered by the parts of its keys.
    let part_of = |key: u64| bounds.partition_point(|&bound| bound <= key);
    let divide = |chunk: &mut [u64]| -> Result<Vec<usize>, Error> {
        let parts: Vec<u8> = chunk.iter().map(|&key| part_of(key) as u8).collect();
        let mut ends = vec![0; SORTED_PARTS + 1];
        parts.iter().for_each(|&part| ends[usize::from(part) + 1] += 1);
        (0..SORTED_PARTS).for_each(|part| ends[part + 1] += ends[part]);
        let (before, mut places) = (chunk.to_vec(), ends.clone());
        for (&key, part) in before.iter().zip(parts) {
            let place = &mut places[usize::from(part)];
            chunk[*place] = key;
            *place += 1;
        }
        progress.check().map(|()| ends)
    };
    let ends = keys.par_chunks_mut(1 << 16).map(divide).collect::<Result<Vec<_>, Error>>()?;
    let mut sorted: Vec<u64> = zeroed_rows("points", keys.len())?;
    let mut rest = &mut sorted[..];
    let mut parts = Vec::new();
    for part in 0..SORTED_PARTS {
        let count = ends.iter().map(|ends| ends[part + 1] - ends[part]).sum();
        parts.push(rest.split_off_mut(..count).unwrap_or_default());
    }
    parts.into_par_iter().enumerate().try_for_each(|(part, sorted)| {
        let mut filled = 0;
        for (chunk, ends) in keys.chunks(1 << 16).zip(&ends) {
            let piece = &chunk[ends[part]..ends[part + 1]];
            sorted[filled..filled + piece.len()].copy_from_slice(piece);
            filled += piece.len();
        }
        sorted.sort_unstable();
        progress.check()
    })?;
    Ok(sorted)
}

fn check_points(mesh: &Mesh, points: &[[f64; 3]]) -> Result<(), ArgumentError> {
    if u32::try_from(points.len()).is_err() {
        return Err(ArgumentError::new("points", format!("at most {} at a time, got {}", u32::MAX, points.len())));
    }
    // A coordinate that is not finite is out of reach too.
    let Some(row) = points.iter().position(|&point| !mesh.can_reach(DVec3::from_array(point))) else { return Ok(()) };
    let [x, y, z] = points[row];
    let finite = x.is_finite() && y.is_finite() && z.is_finite();
    let problem = if finite { "is too far from the mesh for float32 distances" } else { "is not finite" };
    Err(ArgumentError::new("points", format!("points[{row}] = ({x}, {y}, {z}) {problem}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mesh::random::uniform;

    /// A box without a lid, as a lattice of small faces on each side.
    fn open_box(n: i64) -> Mesh {
        let (mut vertices, mut faces) = (Vec::new(), Vec::new());
        let mut side = |at: &dyn Fn(f64, f64) -> [f64; 3]| {
            let first = vertices.len() as i64;
            for j in 0..=n {
                for i in 0..=n {
                    vertices.push(at(i as f64 / n as f64, j as f64 / n as f64));
                }
            }
            for j in 0..n {
                for i in 0..n {
                    let a = first + i + j * (n + 1);
                    faces.push([a, a + 1, a + n + 2]);
                    faces.push([a, a + n + 2, a + n + 1]);
                }
            }
        };
        side(&|u, v| [v, u, 0.0]);
        side(&|u, v| [u, 0.0, v]);
        side(&|u, v| [v, 1.0, u]);
        side(&|u, v| [0.0, v, u]);
        side(&|u, v| [1.0, u, v]);
        Mesh::new(&vertices, &faces).unwrap()
    }

    fn scattered(count: usize) -> Vec<[f64; 3]> {
        let mut uniform = uniform(17);
        let mut next = || 1.6 * uniform() - 0.3;
        (0..count).map(|_| [next(), next(), next()]).collect()
    }

    /// Carrying bounds and sides along the curve changes no side, and no distance beyond the module's bound of 1e-6.
    #[test]
    fn many_points_are_answered_as_one() {
        let mesh = open_box(12);
        let points = scattered(6000);
        let together = signed_distances(&Place::Cpu, &mesh, &points, SignMethod::Auto, &Progress::new()).unwrap();
        let closest = closest_points(&Place::Cpu, &mesh, &points, &Progress::new()).unwrap();
        for (i, &point) in points.iter().enumerate() {
            let alone = signed_distances(&Place::Cpu, &mesh, &[point], SignMethod::Auto, &Progress::new()).unwrap()[0];
            assert!((together[i] - alone).abs() <= 1e-6, "{point:?}: {} {alone}", together[i]);
            assert!((closest.distances[i] - f64::from(alone.abs())).abs() <= 1e-6, "{point:?}");
        }
    }

    #[test]
    fn the_curve_visits_every_point_once_and_near_ones_together() {
        let points = scattered(5000);
        let mut rows = curve(&points, &Progress::new()).unwrap();
        let at = |row: u32| DVec3::from_array(points[row as usize]);
        let along: f64 = rows.windows(2).map(|pair| at(pair[0]).distance(at(pair[1]))).sum();
        let as_given: f64 = (1..points.len() as u32).map(|row| at(row).distance(at(row - 1))).sum();
        assert!(along < 0.2 * as_given, "{along} {as_given}");
        rows.sort_unstable();
        assert!(rows.iter().enumerate().all(|(i, &row)| i as u32 == row));
    }

    /// Random keys, keys in order, and keys of which all but one share their high bits.
    #[test]
    fn long_lists_are_sorted_in_parts() {
        let count = SORTED_AT_ONCE + 12_345;
        let mut random = uniform(3);
        let mixed = (0..count as u64).map(|row| ((random() * 1e9) as u64) << 22 | row).collect::<Vec<_>>();
        let increasing = (0..count as u64).collect::<Vec<_>>();
        let clustered = increasing.iter().rev().copied().chain([1 << 60]).collect::<Vec<_>>();
        for keys in [mixed, increasing, clustered] {
            let mut expected = keys.clone();
            expected.sort_unstable();
            assert!(sorted(keys, &Progress::new()).unwrap() == expected);
        }
    }

    #[test]
    fn a_cancelled_query_ends_within_its_chunk() {
        let mesh = open_box(2);
        let progress = Progress::new();
        let points = scattered(CHUNK);
        let count = std::sync::atomic::AtomicUsize::new(0);
        let ordered = evaluate_in_order(&Place::Cpu, &mesh, &points, &progress, |_, _, _| {
            progress.cancel();
            count.fetch_add(1, std::sync::atomic::Ordering::Relaxed)
        });
        assert!(matches!(ordered, Err(Error::Cancelled)));
        assert_eq!(count.into_inner(), 1);
        assert!(matches!(sorted((0..SORTED_AT_ONCE as u64 + 1).collect(), &progress), Err(Error::Cancelled)));
    }

    #[test]
    fn few_points_stay_on_the_cpu() {
        let (small, large) = (open_box(2), open_box(90));
        let least = large.positions().len() / VERTICES_PER_ROW;
        assert!(least > DEVICE_ROWS);
        assert!(are_few(&small, DEVICE_ROWS - 1) && !are_few(&small, DEVICE_ROWS));
        assert!(are_few(&large, least - 1) && !are_few(&large, least + 1));
        // A device with a name is never replaced.
        assert_eq!(["gpu", "abacus"].map(|device| device_for(device, &small, 1)), ["gpu", "abacus"]);
    }

    #[test]
    fn points_that_are_not_finite_are_named() {
        let mesh = open_box(2);
        let points = [[0.0; 3], [0.0, f64::NAN, 0.0]];
        let error = closest_points(&Place::Cpu, &mesh, &points, &Progress::new()).unwrap_err().to_string();
        assert_eq!(error, "points: points[1] = (0, NaN, 0) is not finite");
        let error = closest_points(&Place::Cpu, &mesh, &[[0.0, 1e20, 0.0]], &Progress::new()).unwrap_err().to_string();
        assert!(error.ends_with("is too far from the mesh for float32 distances"), "{error}");
        assert!(closest_points(&Place::Cpu, &mesh, &[], &Progress::new()).unwrap().faces.is_empty());
    }
}
