//! Level sets of shapes as surfaces: the cells of a grid that they cross, and their exact tangent planes.
//!
//! Blocks whose centre is farther from the level than the Lipschitz constant times their half diagonal contain no part
//! of the surface; the samples of all other blocks are evaluated. The same division of a grid for fields of meshes is
//! in `python/fieldbake/volumes/level_set_blocks.py`.
//!
//! A tangent plane comes from one evaluation with [`Dual`] numbers: the field is replaced by its linear function there,
//! and the plane is the level set of this function. On the flat side of a crease the plane is therefore exact even
//! where the point lies off the surface.

use super::between_samples::{
    SIDE, Side, axes_across_joints, count_missed, edges_across, joint_depth, suspected_joints,
};
use crate::csg::evaluation::active_operands::ActiveTokens;
use crate::csg::evaluation::dual::{ASIDE, Dual};
use crate::csg::evaluation::program::{Program, Stack};
use crate::csg::parts::pruning::{Ball, NearTokens, Pruning};
use crate::csg::parts::solid::{LANES, Solid, run_wide};
use crate::error::Error;
use crate::grid::Grid;
use crate::memory::require;
use crate::progress::Progress;
use crate::surface::probes::{NEAR_STEP, PROBES, Place, around};
use crate::surface::{CrossedEdge, Crossing, ExtraPlanes, LevelSurface, SurfaceBlocks};
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Relative margin of the bound of a block, which covers the rounding of values to float32.
const ROUNDING: f64 = 1e-5;

/// Number of crossings between two checks of the progress.
const CHUNK: usize = 1024;

/// Number of points at which the gradient is evaluated together: the probes of a vertex, and one more.
const POINTS: usize = 8;

/// Largest number of steps of the search for a crossing. Every third step halves the interval.
const ROOT_STEPS: usize = 48;

/// A crossing is found once a step is at most this fraction of an edge, a tenth of the resolution of the vertices.
const ROOT_SHARE: f64 = 1e-5;

/// A sample has either sign if a step of Newton's method from it is at most this fraction of an edge. Samples are
/// float32, so their error is about 1e-7 of the size of the grid, 4e-4 of an edge with 4096 voxels a side.
const SIGN_SHARE: f64 = 1e-3;

/// Length of a step aside, local units.
const BESIDE: f64 = 1e-7;

/// The square of the smallest gradient that has a direction.
const LEAST_SQUARE: f64 = 1e-12;

/// Number of grids that are tried until no sample lies on a joint.
const MOST_GRIDS: usize = 4;

/// The level set of a shape on a grid.
#[derive(Debug)]
pub struct ShapeSurface {
    /// The surface between samples of both signs.
    pub surface: LevelSurface,
    /// Number of parallel edges of the grid that cross a wall without a sample inside, or a gap without a sample
    /// outside: the walls and gaps that the surface lacks have this many squares of a voxel, seen along the edges.
    pub missed: usize,
}

/// The level set of a shape on a grid. A joint is a place inside the solid where parts that touch have the value of the
/// level, as on the common face of two boxes. Samples on a joint would count as outside, and divide the solid. The grid
/// has one voxel more then along the axes across the joint.
pub fn level_surface(solid: &Solid, grid: &Grid, level: f32, progress: &Progress) -> Result<ShapeSurface, Error> {
    let mut grid = *grid;
    for _ in 1..MOST_GRIDS {
        let (surface, across) = level_surface_and_joints(solid, &grid, level, progress)?;
        if across == [false; 3] {
            return Ok(surface);
        }
        (0..3).for_each(|axis| grid.shape[axis] += usize::from(across[axis]));
    }
    Ok(level_surface_and_joints(solid, &grid, level, progress)?.0)
}

/// The level set on a grid, and the axes across joints with samples on them.
fn level_surface_and_joints(
    solid: &Solid,
    grid: &Grid,
    level: f32,
    progress: &Progress,
) -> Result<(ShapeSurface, [bool; 3]), Error> {
    let mut blocks = SurfaceBlocks::new(*grid, level)?;
    let shape = IVec3::from_array(grid.shape.map(|n| n as i32));
    // Cells run from -1 to n - 1, so there are n + 1 along each axis.
    let mut side = SIDE as i32;
    // The shape is below 2^30, as `SurfaceBlocks::new` has checked, so the side is at most 2^30.
    while side <= shape.max_element() {
        side *= 2;
    }
    let mut origins = vec![IVec3::NEG_ONE];
    loop {
        let half = 0.5 * f64::from(side);
        let center = |origin: &IVec3| grid.lower + (origin.as_dvec3() + half + 0.5) * grid.spacing();
        let centers: Vec<DVec3> = origins.iter().map(center).collect();
        let values = solid.distances(&centers, progress)?;
        let reach = solid.model.lipschitz * half * grid.spacing().length() * (1.0 + ROUNDING);
        let mut values = values.into_iter().map(|value| f64::from(value) - f64::from(level));
        origins.retain(|origin| {
            let value = values.next().unwrap_or(0.0);
            // The box cuts the solid in blocks that are inside everywhere.
            let is_at_box = origin.cmplt(IVec3::ZERO).any() || (*origin + side).cmpge(shape).any();
            value.abs() <= reach || (value < 0.0 && is_at_box)
        });
        if side == SIDE as i32 {
            break;
        }
        side /= 2;
        // A block has an origin, a centre and a value, and the vectors grow by doubling.
        require("the blocks around a surface", (8 * origins.len() * 128) as u64, 0)?;
        let corner = |i: i32| side * IVec3::new(i & 1, i >> 1 & 1, i >> 2);
        let children = origins.iter().flat_map(|&origin| (0..8).map(move |i| origin + corner(i)));
        origins = children.filter(|origin| origin.cmplt(shape).all()).collect();
    }
    let origins: Vec<[i32; 3]> = origins.into_iter().map(IVec3::into).collect();
    let (suspects, crossed) = (Mutex::default(), Mutex::default());
    let pruning = Pruning::new(solid);
    let near = || NearTokens::new(grid.spacing().max_element() / solid.frame.scale);
    let half = 0.5 * SIDE as f64;
    let radius = half * grid.spacing().length() / solid.frame.scale;
    let fill = |(stack, near): &mut (Stack<f64, LANES>, NearTokens), origin: [i32; 3], samples: &mut [f32]| {
        let middle = grid.lower + (IVec3::from(origin).as_dvec3() + half + 0.5) * grid.spacing();
        let tokens = near.find_alone(&pruning, solid, Ball { middle: solid.frame.local(middle), radius });
        solid.samples_of_block(tokens, grid, SIDE, origin, stack, samples);
        // As in the block, a place outside the grid is moved to the nearest sample of the grid.
        let most = (shape - 1).as_dvec3();
        let nearest = |index: DVec3| (IVec3::from(origin).as_dvec3() + index).clamp(DVec3::ZERO, most);
        let place = |(index, axis)| (grid.lower + (nearest(index) + 0.5) * grid.spacing(), axis);
        let joints = suspected_joints(samples, level, joint_depth(grid));
        append(&suspects, joints.into_iter().map(place).collect());
        for side in [Side::Inside, Side::Outside] {
            let edges = edges_across(side, samples, level, solid.model.lipschitz, grid.spacing());
            append(&crossed, edges.into_iter().map(place).map(|(place, axis)| (place, axis, side)).collect());
        }
    };
    blocks.add_evaluated(SIDE, &origins, || (Stack::default(), near()), fill, progress)?;
    let crossed: Vec<_> = crossed.into_inner().unwrap_or_else(PoisonError::into_inner);
    let suspects: Vec<_> = suspects.into_inner().unwrap_or_else(PoisonError::into_inner);
    let missed = count_missed(solid, grid, level, &crossed, progress)?;
    let across = axes_across_joints(solid, grid, level, &suspects, progress)?;
    Ok((ShapeSurface { surface: blocks.surface(), missed }, across))
}

/// Appends to a list that threads share.
fn append<T>(list: &Mutex<Vec<T>>, found: Vec<T>) {
    if !found.is_empty() {
        list.lock().unwrap_or_else(PoisonError::into_inner).extend(found);
    }
}

/// Buffers of evaluations.
struct Scratch {
    stack: Stack<Dual, POINTS>,
    near: NearTokens,
    deciding: ActiveTokens<POINTS>,
}

impl Scratch {
    /// `voxel` is the length of a voxel, local units.
    fn new(voxel: f64) -> Self {
        Self { stack: Stack::default(), near: NearTokens::new(voxel), deciding: ActiveTokens::default() }
    }
}

/// Buffers of one thread. When they are dropped, they return to the unused ones, so that later evaluations find their
/// tokens.
struct Borrowed<'a> {
    tangents: &'a Tangents,
    scratch: Scratch,
}

impl Deref for Borrowed<'_> {
    type Target = Scratch;

    fn deref(&self) -> &Scratch {
        &self.scratch
    }
}

impl DerefMut for Borrowed<'_> {
    fn deref_mut(&mut self) -> &mut Scratch {
        &mut self.scratch
    }
}

impl Drop for Borrowed<'_> {
    fn drop(&mut self) {
        let scratch = std::mem::replace(&mut self.scratch, Scratch::new(self.tangents.voxel));
        self.tangents.unused().push(scratch);
    }
}

/// A shape whose tangent planes are evaluated.
struct Tangents {
    solid: Arc<Solid>,
    program: Program<Dual>,
    pruning: Pruning,
    level: f64,
    /// Longest side of a voxel, local units.
    voxel: f64,
    /// Buffers that no thread uses at the moment, with the tokens that they have found.
    unused: Mutex<Vec<Scratch>>,
}

impl Tangents {
    /// `spacing` is the size of a voxel, world units.
    fn new(solid: &Arc<Solid>, level: f64, spacing: DVec3) -> Self {
        let program = Program::new(&solid.model, solid.frame);
        let voxel = spacing.max_element() / solid.frame.scale;
        let pruning = Pruning::new(solid);
        Self { solid: Arc::clone(solid), program, pruning, level, voxel, unused: Mutex::default() }
    }

    fn unused(&self) -> MutexGuard<'_, Vec<Scratch>> {
        self.unused.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Buffers of earlier evaluations, or new ones.
    fn scratch(&self) -> Borrowed<'_> {
        let unused = self.unused().pop();
        Borrowed { tangents: self, scratch: unused.unwrap_or_else(|| Scratch::new(self.voxel)) }
    }

    /// The linear functions at up to [`POINTS`] world positions: the field minus the level at the position, and its
    /// gradient. With fewer positions, the remaining entries repeat the last one. Where the field has no gradient, the
    /// function of a point beside the position is returned.
    fn evaluate(&self, points: &[DVec3], scratch: &mut Scratch) -> [(f64, DVec3); POINTS] {
        let points: [DVec3; POINTS] = std::array::from_fn(|i| points[i.min(points.len() - 1)]);
        let found = self.values(&points, scratch);
        let is_flat = found.map(|(_, slope)| slope.length_squared() <= LEAST_SQUARE);
        if !is_flat.contains(&true) {
            return found;
        }
        // Lengths have no gradient where they are zero, as on the surface of a cone.
        let aside = self.solid.frame.scale * BESIDE * ASIDE;
        let beside = self.values(&points.map(|point| point + aside), scratch);
        std::array::from_fn(|i| {
            let (value, slope) = beside[i];
            if is_flat[i] { (value - slope.dot(aside), slope) } else { found[i] }
        })
    }

    /// The linear functions at the positions, also where the field has no gradient.
    fn values(&self, points: &[DVec3; POINTS], scratch: &mut Scratch) -> [(f64, DVec3); POINTS] {
        let apart = scratch.near.small_radius() * self.solid.frame.scale;
        let is_near = |a: DVec3, b: DVec3| a.distance(b) <= apart;
        if !self.pruning.has_many_leaves() || points.iter().all(|&point| is_near(point, points[0])) {
            return self.values_together(points, scratch);
        }
        // Positions near each other have few tokens. The results do not depend on the other positions.
        let mut found = [None; POINTS];
        while let Some(first) = found.iter().position(Option::is_none) {
            let group = points.map(|point| if is_near(point, points[first]) { point } else { points[first] });
            let values = self.values_together(&group, scratch);
            for (i, value) in values.into_iter().enumerate() {
                if i == first || is_near(points[i], points[first]) {
                    found[i].get_or_insert(value);
                }
            }
        }
        found.map(Option::unwrap_or_default)
    }

    /// [`Self::values`] with one list of tokens for all positions.
    fn values_together(&self, points: &[DVec3; POINTS], scratch: &mut Scratch) -> [(f64, DVec3); POINTS] {
        let (mut places, mut at) = ([[0.0; POINTS]; 3], [[Dual::default(); POINTS]; 3]);
        let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (i, &point) in points.iter().enumerate() {
            let local = self.solid.frame.local(point);
            (lower, upper) = (lower.min(local), upper.max(local));
            let dual = Dual::position(local);
            (0..3).for_each(|axis| (places[axis][i], at[axis][i]) = (local[axis], dual[axis]));
        }
        let Scratch { stack, near, deciding } = scratch;
        let mut tokens = near.find(&self.pruning, &self.solid, Ball::around(lower, upper));
        if !self.program.combines.is_empty() {
            tokens = deciding.find(self.solid.precise(), tokens, &places);
        }
        let values = run_wide(&self.program, tokens, &at, stack);
        // The gradient is the same in local units, since values and positions are scaled alike.
        values.map(|dual| (dual.value * self.solid.frame.scale - self.level, DVec3::from_array(dual.slope)))
    }

    /// The tangent planes next to up to [`POINTS`] world positions: a point and a normal of any length. None where the
    /// field has no gradient, or where a step of Newton's method leads away from the level.
    fn planes(&self, points: &[DVec3], scratch: &mut Scratch) -> [Option<(DVec3, DVec3)>; POINTS] {
        let first = self.evaluate(points, scratch);
        let moved: [Option<DVec3>; POINTS] =
            std::array::from_fn(|i| points.get(i).and_then(|&point| foot(point, first[i])));
        let second = self.evaluate(&moved.map(|point| point.unwrap_or(points[0])), scratch);
        std::array::from_fn(|i| {
            let point =
                moved[i].filter(|_| second[i].0.abs() <= first[i].0.abs() + f64::EPSILON * self.solid.frame.scale)?;
            Some((foot(point, second[i])?, second[i].1))
        })
    }

    /// Moves the crossings of some edges, from the edge with the index `first` on, to the roots of the field, and uses
    /// the planes there. Newton's method with bisection, so that every root is found. A crossing stays as it was where
    /// the field has no root, for instance if it belongs to another shape that is merged into the samples.
    fn cross(&self, surface: &LevelSurface, first: usize, crossings: &mut [Crossing]) {
        let mut scratch = self.scratch();
        let mut searches: Vec<Search> = Vec::with_capacity(crossings.len());
        searches.extend(crossings.iter().enumerate().filter(|(_, crossing)| !crossing.on_box).map(|(i, crossing)| {
            let along = surface.edge(first + i).along;
            let share = f64::from(crossing.share).clamp(0.0, 1.0);
            Search { edge: i, low: 0.0, high: 1.0, share, rises: crossing.normal.dot(along) > 0.0 }
        }));
        for step in 0..ROOT_STEPS {
            let is_last = step + 1 == ROOT_STEPS;
            let mut kept = 0;
            for start in (0..searches.len()).step_by(POINTS) {
                let group = start..(start + POINTS).min(searches.len());
                let edges: [_; POINTS] =
                    std::array::from_fn(|i| surface.edge(first + searches[(start + i).min(group.end - 1)].edge));
                let places: [DVec3; POINTS] = std::array::from_fn(|i| {
                    edges[i].start + edges[i].along * searches[(start + i).min(group.end - 1)].share
                });
                let found = self.evaluate(&places, &mut scratch);
                for (i, at) in group.enumerate() {
                    let mut search = searches[at];
                    let (value, slope) = found[i];
                    let rate = slope.dot(edges[i].along);
                    let next = search.step(value, rate, step % 3 == 2);
                    if !is_last && (next - search.share).abs() > ROOT_SHARE {
                        search.share = next;
                        searches[kept] = search;
                        kept += 1;
                        continue;
                    }
                    // The crossing of the samples may be a root already.
                    let is_known = step == 0 && is_root(value, rate, ROOT_SHARE);
                    if !is_known && search.is_open() && !self.changes_sign(&edges[i], search.rises, &mut scratch) {
                        continue;
                    }
                    let crossing = &mut crossings[search.edge];
                    crossing.share = next.clamp(0.0, 1.0) as f32;
                    let plane = foot(places[i], found[i]).zip(slope.try_normalize());
                    if let Some((point, normal)) = plane {
                        crossing.set_plane(edges[i].at(crossing.share), point, normal);
                    }
                }
            }
            searches.truncate(kept);
        }
    }

    /// Whether the field changes its sign along an edge, from negative to positive if it `rises`. An end that nearly
    /// is a root has either sign; see [`SIGN_SHARE`].
    fn changes_sign(&self, edge: &CrossedEdge, rises: bool, scratch: &mut Scratch) -> bool {
        let ends = self.evaluate(&[edge.start, edge.start + edge.along], scratch);
        let is_negative = [rises, !rises];
        (0..2).all(|end| {
            let (value, slope) = ends[end];
            (value < 0.0) == is_negative[end] || is_root(value, slope.dot(edge.along), SIGN_SHARE)
        })
    }
}

/// Whether a step of Newton's method from a place with this value, and this derivative along its edge, is at most
/// `share` of the edge.
fn is_root(value: f64, rate: f64, share: f64) -> bool {
    value.abs() <= share * rate.abs()
}

/// The search for the crossing of one edge.
#[derive(Clone, Copy)]
struct Search {
    /// Index of the edge.
    edge: usize,
    /// The interval of the crossing, and the place of the next evaluation, as fractions of the edge.
    low: f64,
    high: f64,
    share: f64,
    /// Whether the field rises along the edge.
    rises: bool,
}

impl Search {
    /// Shrinks the interval by the value of the field at `share`. Returns the next place: a step of Newton's method
    /// with the derivative `rate` along the edge, or the middle of the interval if `bisect` is set or the step leaves
    /// the interval.
    fn step(&mut self, value: f64, rate: f64, bisect: bool) -> f64 {
        let end = if (value < 0.0) == self.rises { &mut self.low } else { &mut self.high };
        *end = self.share;
        let next = self.share - value / rate;
        let is_within = next >= self.low - ROOT_SHARE && next <= self.high + ROOT_SHARE;
        let is_found = (next - self.share).abs() <= ROOT_SHARE;
        if is_within && (is_found || !bisect) { next } else { 0.5 * (self.low + self.high) }
    }

    /// Whether the interval still has an end of the edge, so that the sign of the field there may be unknown.
    fn is_open(&self) -> bool {
        self.low == 0.0 || self.high == 1.0
    }
}

/// The point of the level set of the linear function with a value and a gradient at `point` that is nearest to it.
fn foot(point: DVec3, (value, slope): (f64, DVec3)) -> Option<DVec3> {
    let square = slope.length_squared();
    (square > LEAST_SQUARE).then(|| point - slope * (value / square)).filter(|point| point.is_finite())
}

/// Replaces the planes of `crossings` by tangent planes of the level set of a shape.
pub fn planes_of_shape(
    surface: &LevelSurface,
    crossings: &mut [Crossing],
    solid: &Arc<Solid>,
    level: f64,
    progress: &Progress,
) -> Result<(), Error> {
    let tangents = Tangents::new(solid, level, surface.spacing());
    progress.set_total(crossings.len() as u64);
    crossings.par_chunks_mut(CHUNK).enumerate().try_for_each(|(i, chunk)| {
        tangents.cross(surface, i * CHUNK, chunk);
        progress.advance(chunk.len() as u64)
    })
}

/// The tangent planes of the level set of a shape around the sharp vertices, and close to all vertices.
pub fn planes_around_of_shape(
    surface: &LevelSurface,
    crossings: &[Crossing],
    solid: &Arc<Solid>,
    level: f64,
    progress: &Progress,
) -> Result<ExtraPlanes, Error> {
    let tangents = Tangents::new(solid, level, surface.spacing());
    progress.set_total(surface.cell_count() as u64);
    let planes = surface.planes_around(
        crossings,
        || tangents.scratch(),
        |scratch, places: &[DVec3; PROBES], _, _, found| {
            found.extend(tangents.planes(places, scratch).into_iter().flatten());
        },
        progress,
    )?;
    let step = NEAR_STEP * surface.spacing();
    let nearby = move |places: &[Place], found: &mut dyn FnMut(usize, DVec3, DVec3)| {
        let mut scratch = tangents.scratch();
        let mut smooth = Vec::with_capacity(places.len());
        for (i, place) in places.iter().enumerate() {
            if place.is_sharp {
                let planes = tangents.planes(&around(place.point, step), &mut scratch);
                planes.into_iter().flatten().for_each(|(point, normal)| found(i, point, normal));
            } else {
                smooth.push((i, place.point));
            }
        }
        for group in smooth.chunks(POINTS) {
            let points: [DVec3; POINTS] = std::array::from_fn(|i| group[i.min(group.len() - 1)].1);
            for (&(i, point), linear) in group.iter().zip(tangents.evaluate(&points, &mut scratch)) {
                if let Some(on_plane) = foot(point, linear) {
                    found(i, on_plane, linear.1);
                }
            }
        }
    };
    Ok(planes.with_nearby(Box::new(nearby), false))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::csg::text::language::parse;

    /// A shape, turned so that no face is parallel to the grid, and a grid of 16 voxels a side around it.
    fn turned(text: &str) -> (Arc<Solid>, Grid) {
        let shape = parse(text).unwrap().changed("rotate", &[1.0, 2.0, 3.0, 40.0]).unwrap();
        let grid = Grid::new(DVec3::splat(-2.0), DVec3::splat(2.0), [16; 3]).unwrap();
        (Arc::new(Solid::new(&shape).unwrap()), grid)
    }

    #[test]
    fn grids_with_too_many_voxels_along_an_axis_are_refused() {
        let (solid, _) = turned("(box 2 2 2)");
        for n in [1 << 30, (1 << 31) - 2] {
            let grid = Grid::new(DVec3::splat(-2.0), DVec3::splat(2.0), [n, 1, 1]).unwrap();
            let error = level_surface(&solid, &grid, 0.0, &Progress::new()).unwrap_err().to_string();
            assert!(error.ends_with("voxels are too many for one mesh"), "{error}");
        }
    }

    #[test]
    fn walls_and_gaps_without_a_sample_are_counted() {
        let count = |text: &str| {
            let (solid, grid) = turned(text);
            level_surface(&solid, &grid, 0.0, &Progress::new()).unwrap().missed
        };
        // The normal of the plate has the component 0.92 along z, so 64 squares of a voxel are 59 seen along z, and 60
        // edges of this grid cross it. 2 of them have a sample inside, each of which excludes up to 9 edges.
        let plate = count("(box 2 2 0.01)");
        assert!((60 - 2 * 9..=60).contains(&plate), "{plate}");
        // The same plate as a gap in a ball with a radius of 1.8.
        let gap = count("(diff (sphere 3.6) (box 2 2 0.01))");
        assert!((60 - 2 * 9..=60).contains(&gap), "{gap}");
        assert_eq!([count("(box 2 2 2)"), count("(sphere 1.5)"), count("(torus 1.2 0.4)")], [0; 3]);
    }

    #[test]
    fn the_planes_of_a_cube_are_its_faces() {
        let (solid, grid) = turned("(box 2 2 2)");
        let progress = Progress::new();
        let surface = level_surface(&solid, &grid, 0.0, &progress).unwrap().surface;
        let mut crossings = surface.crossings();
        planes_of_shape(&surface, &mut crossings, &solid, 0.0, &progress).unwrap();
        let axis = DVec3::new(1.0, 2.0, 3.0).normalize();
        let faces = DVec3::AXES.map(|face| glam::DQuat::from_axis_angle(axis, 40f64.to_radians()) * face);
        for (i, crossing) in crossings.iter().enumerate() {
            let cosines = faces.map(|face| crossing.normal.dot(face).abs());
            let nearest = (0..3).max_by(|&a, &b| cosines[a].total_cmp(&cosines[b])).unwrap();
            let on_plane = surface.edge(i).at(crossing.share) + crossing.normal * crossing.height;
            assert!(cosines[nearest] >= 1.0 - 1e-12, "{i}");
            assert!((on_plane.dot(faces[nearest]).abs() - 1.0).abs() <= 1e-12, "{i}");
            // The crossing lies on the cube too.
            assert!(crossing.height.abs() <= 1e-5, "{i}");
        }
    }

    #[test]
    fn crossings_without_a_root_stay_as_they_were() {
        let (solid, grid) = turned("(box 2 2 2)");
        let progress = Progress::new();
        let surface = level_surface(&solid, &grid, 0.0, &progress).unwrap().surface;
        let before = surface.crossings();
        // Both lie more than a voxel off the surface of the box: one within it, the other around it.
        for text in ["(box 1 1 1)", "(box 3 3 3)"] {
            let mut crossings = before.clone();
            planes_of_shape(&surface, &mut crossings, &turned(text).0, 0.0, &progress).unwrap();
            assert!(crossings == before, "{text}");
        }
    }

    #[test]
    fn gradients_agree_with_differences() {
        let shapes = [
            "(blend union 0.2 (sphere 2) (torus 2.6 0.6))",
            "(diff (box 2 1 1.5) (cylinder 0.8 3))",
            "(twist 30 (cone 2 1.5))",
            "(ellipsoid 2 1.4 1)",
            "(inter (gyroid 1 0.2) (sphere 3))",
        ];
        for text in shapes {
            let (solid, _) = turned(text);
            let tangents = Tangents::new(&solid, 0.0, DVec3::splat(0.25));
            let mut random = crate::mesh::random::uniform(7);
            let points: Vec<DVec3> = (0..200).map(|_| DVec3::new(random(), random(), random()) * 2.0 - 1.0).collect();
            let values = solid.distances(&points, &Progress::new()).unwrap();
            let slopes = solid.gradients(&points, &Progress::new()).unwrap();
            let mut apart = 0;
            for (points, (values, slopes)) in
                points.chunks(POINTS).zip(values.chunks(POINTS).zip(slopes.chunks(POINTS)))
            {
                let found = tangents.evaluate(points, &mut tangents.scratch());
                for ((value, slope), (expected, difference)) in found.into_iter().zip(values.iter().zip(slopes)) {
                    assert!((value - f64::from(*expected)).abs() <= 1e-6, "{text}");
                    // Differences are means of both sides within their step of a crease.
                    apart += usize::from((slope.as_vec3() - glam::Vec3::from_array(*difference)).length() > 1e-4);
                }
            }
            assert!(apart <= 2, "{text}: {apart} of 200");
        }
    }

    #[test]
    fn points_where_lengths_vanish_have_the_gradient_beside_them() {
        // The distance to the side of a cone is a length that is zero on the surface; this cone is a cylinder.
        let (solid, _) = turned("(coninder 2 2 1)");
        let tangents = Tangents::new(&solid, 0.0, DVec3::splat(0.25));
        let axis = DVec3::new(1.0, 2.0, 3.0).normalize();
        let turn = glam::DQuat::from_axis_angle(axis, 40f64.to_radians());
        for angle in 0..64 {
            let (sine, cosine) = f64::from(angle).sin_cos();
            let (_, slope) = tangents.evaluate(&[turn * DVec3::new(cosine, sine, 0.0)], &mut tangents.scratch())[0];
            // The step aside is 1e-7 local units, 4e-7 world units.
            assert!((slope - turn * DVec3::new(cosine, sine, 0.0)).length() <= 1e-6, "{angle}");
        }
    }
}
