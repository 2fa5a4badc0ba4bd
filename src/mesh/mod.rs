//! Triangles, checked once when the mesh is made.
//!
//! Positions are stored twice: the float64 *world* positions of the input, and float32 *local* coordinates for searches
//! and bakes. Local coordinates are offsets from a point near the centre of the mesh's box, divided by a power of two
//! that brings the longest side to between 1/2 and 1. A mesh of size 1e-6, or one a million units from the origin,
//! therefore keeps its relative accuracy (3e-8: half an ulp of coordinates below 1), squares neither overflow nor
//! vanish, and the division is exact: `world = center + scale * local`, except for the rounding of `local` to float32.
//!
//! The origin of local coordinates is the centre of the box, rounded to multiples of [`CENTER_STEP`] times `scale`.
//! Small motions of the vertices therefore leave the local coordinates of all other vertices unchanged, to the bit.
//!
//! Two vertices are one if their float64 positions in the input are equal (-0 equals 0); local coordinates never decide
//! that. A face with three different positions, of any area, is a face of the mesh: it belongs to [`topology`], to rays
//! and to windings, so a closed surface is closed in every function. A face whose corners lie on a line is a line
//! segment for distances. Faces with a repeated position, whose boundary is empty, and unused vertices that are not
//! finite are dropped and counted.

pub(crate) mod derived;
pub(crate) mod disjoint_sets;
mod half_edges;
mod polygon;
#[cfg(test)]
pub(crate) mod random;
mod stl;
pub(crate) mod topology;
pub(crate) mod wavefront;

use crate::error::MeshError;
use crate::geometry::{is_needle, is_on_a_line};
use derived::DerivedTables;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use std::sync::OnceLock;
use topology::Topology;

/// A checked triangle mesh with at least one face of positive area.
#[derive(Debug)]
pub struct Mesh {
    center: DVec3,
    scale: f64,
    /// `1 / scale`, exact since both are powers of two.
    inverse_scale: f64,
    /// Lower and upper corner of the kept faces, world units.
    bounds: [DVec3; 2],
    world: Vec<[f64; 3]>,
    positions: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    /// The faces whose corners lie on a line, in increasing order.
    flat_faces: Vec<u32>,
    /// Faces with a repeated position.
    repeated: Vec<[u32; 3]>,
    /// Input rows of the kept vertices and faces, if some were dropped.
    source_vertices: Option<Vec<u32>>,
    source_faces: Option<Vec<u32>>,
    dropped_vertices: usize,
    topology: OnceLock<Topology>,
    has_needles: OnceLock<bool>,
    tables: DerivedTables,
}

/// Number of vertices or faces from which they are checked on the threads of the current rayon pool.
pub const PARALLEL_ITEMS: usize = 1 << 15;
/// Number of items of a part that one thread checks at a time.
const PART: usize = 1 << 14;
/// The child index of the tree has 31 bits, and faces times three must fit in u32.
const MAX_FACES: usize = 1 << 30;
/// Largest local coordinate of a query. The sum of three squared differences stays below 3e38.
const MAX_REACH: f64 = 1e18;
/// World distances are float32. Distances in a grid a thousand times as large as the mesh, and a millionth of its size,
/// must be normal numbers.
const EXTENT_RANGE: (f64, f64) = (1e-30, 1e34);
/// Step to which the origin of local coordinates is rounded, local units, a power of two. Local coordinates reach 1/2
/// plus half a step and must stay below 1, where the rounding to float32 is still 3e-8.
const CENTER_STEP: f64 = 0.25;

impl Mesh {
    /// Checks and recentres a mesh. Indices are signed, so that a negative one can be reported.
    pub fn new(vertices: &[[f64; 3]], faces: &[[i64; 3]]) -> Result<Self, MeshError> {
        Self::of(vertices, faces)
    }

    /// As [`Self::new`], with indices of any type.
    pub fn of<I: Copy + Sync + Into<i64>>(vertices: &[[f64; 3]], faces: &[[I; 3]]) -> Result<Self, MeshError> {
        for (what, count, limit) in [("vertices", vertices.len(), u32::MAX as usize), ("faces", faces.len(), MAX_FACES)]
        {
            if count > limit {
                return Err(MeshError::TooLarge { what, count, limit });
            }
        }
        if vertices.is_empty() || faces.is_empty() {
            return Err(MeshError::Empty { vertices: vertices.len(), faces: faces.len() });
        }
        let mut corners = vec![[0; 3]; faces.len()];
        let checked = checked_faces(vertices, faces, &mut corners)?;
        let is_finite = |vertex: &[f64; 3]| vertex.iter().all(|x| x.is_finite());
        if in_parts(vertices, |_, part| part.iter().all(is_finite)).into_iter().all(|all| all) {
            return Self::assemble(vertices.to_vec(), None, corners, checked);
        }
        // Keeps every finite vertex, in order.
        let mut kept_row = vec![u32::MAX; vertices.len()];
        let mut source_vertices = Vec::with_capacity(vertices.len());
        for (row, _) in vertices.iter().enumerate().filter(|(_, vertex)| is_finite(vertex)) {
            kept_row[row] = source_vertices.len() as u32;
            source_vertices.push(row as u32);
        }
        corners.as_flattened_mut().par_iter_mut().for_each(|corner| *corner = kept_row[*corner as usize]);
        let world = source_vertices.iter().map(|&row| vertices[row as usize]).collect();
        let dropped = vertices.len() - source_vertices.len();
        Self::assemble(world, Some((source_vertices, dropped)), corners, checked)
    }

    /// A mesh of finite vertices and checked faces. `sources` has the input rows of the vertices and the number of
    /// dropped ones, if some were dropped.
    fn assemble(
        world: Vec<[f64; 3]>,
        sources: Option<(Vec<u32>, usize)>,
        mut faces: Vec<[u32; 3]>,
        CheckedFaces { mut bounds, unusual }: CheckedFaces,
    ) -> Result<Self, MeshError> {
        // The box of the vertices that faces use. Stray vertices must not reduce precision.
        let [lower, upper] = bounds;
        let extent = (upper - lower).max_element();
        if extent > EXTENT_RANGE.1 || (extent > 0.0 && extent < EXTENT_RANGE.0) {
            return Err(MeshError::Extent { extent, min: EXTENT_RANGE.0, max: EXTENT_RANGE.1 });
        }
        let scale = power_of_two_above(extent);
        let center = rounded_center(lower, upper, scale);
        let inverse_scale = scale.recip();
        let local = |&p: &[f64; 3]| ((DVec3::from_array(p) - center) * inverse_scale).as_vec3();
        let mut positions = vec![Vec3::ZERO; world.len()];
        in_parts_of(&world, &mut positions, |_, world, positions| {
            positions.iter_mut().zip(world).for_each(|(position, world)| *position = local(world));
        });

        let count = faces.len();
        let mut source_faces = None;
        let mut repeated = Vec::new();
        let mut flat_faces = Vec::new();
        for (row, is_repeated) in unusual {
            if is_repeated {
                repeated.push(faces[row as usize]);
                let rows = source_faces.get_or_insert_with(|| (0..count as u32).collect::<Vec<u32>>());
                rows[row as usize] = u32::MAX;
            } else {
                flat_faces.push(row - repeated.len() as u32);
            }
        }
        if let Some(rows) = &mut source_faces {
            rows.retain(|&row| row != u32::MAX);
            faces = rows.iter().map(|&row| faces[row as usize]).collect();
            bounds = bounds_of(&world, &faces);
        }
        if faces.len() == flat_faces.len() {
            return Err(MeshError::AllDegenerate { faces: count });
        }

        Ok(Self {
            center,
            scale,
            inverse_scale,
            bounds,
            world,
            positions,
            faces,
            flat_faces,
            repeated,
            dropped_vertices: sources.as_ref().map_or(0, |sources| sources.1),
            source_vertices: sources.map(|sources| sources.0),
            source_faces,
            topology: OnceLock::new(),
            has_needles: OnceLock::new(),
            tables: DerivedTables::default(),
        })
    }

    /// Origin of local coordinates, near the centre of the box of all faces, world units.
    pub fn center(&self) -> DVec3 {
        self.center
    }

    /// World units per local unit, a power of two.
    #[inline]
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Local coordinates of a world position.
    #[inline]
    pub fn local_from_world(&self, p_world: DVec3) -> DVec3 {
        (p_world - self.center) * self.inverse_scale
    }

    /// Whether float32 can square the distance from a world position to the mesh. The limit is 1e18 mesh sizes.
    pub fn can_reach(&self, p_world: DVec3) -> bool {
        self.local_from_world(p_world).abs().cmplt(DVec3::splat(MAX_REACH)).all()
    }

    /// World position of local coordinates.
    pub fn world_from_local(&self, p: DVec3) -> DVec3 {
        self.center + p * self.scale
    }

    /// World positions of the vertices, equal to the input.
    pub fn world_positions(&self) -> &[[f64; 3]] {
        &self.world
    }

    /// Local positions of the vertices, rounded to float32.
    pub fn positions(&self) -> &[Vec3] {
        &self.positions
    }

    /// Vertices of each face.
    #[inline]
    pub fn faces(&self) -> &[[u32; 3]] {
        &self.faces
    }

    /// Number of faces with an area.
    pub fn faces_with_area(&self) -> usize {
        self.faces.len() - self.flat_faces.len()
    }

    /// The faces whose corners lie on a line, in increasing order.
    pub fn flat_faces(&self) -> &[u32] {
        &self.flat_faces
    }

    /// Whether float64 does not determine the plane of some face.
    pub(crate) fn has_needles(&self) -> bool {
        *self.has_needles.get_or_init(|| (0..self.faces.len() as u32).any(|face| is_needle(self.exact_triangle(face))))
    }

    /// Number of faces of the input without area: a repeated position, or corners on a line.
    pub fn degenerate_faces(&self) -> usize {
        self.flat_faces.len() + self.repeated.len()
    }

    /// Input row of each kept vertex; None if all were kept.
    pub fn source_vertices(&self) -> Option<&[u32]> {
        self.source_vertices.as_deref()
    }

    /// Input row of each kept face; None if all were kept.
    pub fn source_faces(&self) -> Option<&[u32]> {
        self.source_faces.as_deref()
    }

    /// Faces of the input in their order, dropped ones included, as indices of the kept vertices.
    pub fn input_faces(&self) -> Vec<[u32; 3]> {
        let Some(rows) = &self.source_faces else { return self.faces.clone() };
        let mut repeated = self.repeated.iter();
        let mut faces = Vec::with_capacity(self.faces.len() + self.repeated.len());
        for (face, &row) in self.faces.iter().zip(rows) {
            // The dropped faces fill the rows between the kept ones.
            faces.extend(repeated.by_ref().take(row as usize - faces.len()));
            faces.push(*face);
        }
        faces.extend(repeated);
        faces
    }

    /// This mesh with its kept vertices at other positions: equal to a new mesh of these positions and the faces of the
    /// input. The connectivity and the tables are carried over where they still hold. This mesh stays unchanged.
    pub fn moved(&self, vertices: &[[f64; 3]]) -> Result<Self, MeshError> {
        if vertices.len() != self.world.len() {
            return Err(MeshError::MovedCount { count: vertices.len(), vertices: self.world.len() });
        }
        if let Some(vertex) = vertices.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            let [x, y, z] = vertices[vertex];
            return Err(MeshError::MovedNotFinite { vertex, x, y, z });
        }
        let faces = self.input_faces();
        let mut corners = vec![[0; 3]; faces.len()];
        let checked = checked_faces(vertices, &faces, &mut corners)?;
        let sources = self.source_vertices.clone().map(|rows| (rows, self.dropped_vertices));
        let mut mesh = Self::assemble(vertices.to_vec(), sources, corners, checked)?;
        if mesh.has_faces_of(self) {
            let (topology, ()) = rayon::join(
                || self.topology.get().and_then(|topology| topology.follow(&mesh)),
                || self.tables.carry(self, &mesh),
            );
            if let Some(topology) = topology {
                mesh.topology = OnceLock::from(topology);
            }
        }
        Ok(mesh)
    }

    /// Whether both meshes have the same faces, and the same of them are dropped or flat.
    pub fn has_faces_of(&self, other: &Self) -> bool {
        self.faces == other.faces && self.repeated == other.repeated && self.flat_faces == other.flat_faces
    }

    /// Number of vertices dropped because they were unused and not finite.
    pub fn dropped_vertices(&self) -> usize {
        self.dropped_vertices
    }

    /// Local corners of a face in float32 precision, as searches compare them.
    pub fn triangle(&self, face: u32) -> [DVec3; 3] {
        let [a, b, c] = self.faces[face as usize];
        let corner = |v: u32| self.positions[v as usize].as_dvec3();
        [corner(a), corner(b), corner(c)]
    }

    /// Local position of a vertex in the precision of the float64 input.
    #[inline]
    pub fn exact_position(&self, vertex: u32) -> DVec3 {
        self.local_from_world(DVec3::from_array(self.world[vertex as usize]))
    }

    /// Local corners of a face in the precision of the float64 input.
    #[inline]
    pub fn exact_triangle(&self, face: u32) -> [DVec3; 3] {
        let [a, b, c] = self.faces[face as usize];
        [self.exact_position(a), self.exact_position(b), self.exact_position(c)]
    }

    /// Lower and upper corner of the kept faces, world units.
    pub fn bounds(&self) -> [DVec3; 2] {
        self.bounds
    }

    /// Whether the connectivity has been computed.
    pub fn has_topology(&self) -> bool {
        self.topology.get().is_some()
    }

    /// Connectivity, computed at the first call.
    pub fn topology(&self) -> &Topology {
        self.topology.get_or_init(|| Topology::of(self))
    }

    /// Memory in use, bytes: positions, faces, and the structures built from them so far.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.world[..])
            + size_of_val(&self.positions[..])
            + size_of_val(&self.faces[..])
            + size_of_val(&self.repeated[..])
            + size_of_val(&self.flat_faces[..])
            + [&self.source_vertices, &self.source_faces]
                .into_iter()
                .flatten()
                .map(|rows| size_of_val(&rows[..]))
                .sum::<usize>()
            + self.topology.get().map_or(0, Topology::bytes)
            + self.tables.bytes()
    }
}

/// Lower and upper corner of the vertices that faces use.
fn bounds_of(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> [DVec3; 2] {
    let join = |[lower, upper]: [DVec3; 2], [low, high]: [DVec3; 2]| [lower.min(low), upper.max(high)];
    let nothing = [DVec3::INFINITY, DVec3::NEG_INFINITY];
    let corners = |part: &[[u32; 3]]| {
        part.as_flattened()
            .iter()
            .map(|&v| DVec3::from_array(vertices[v as usize]))
            .fold(nothing, |b, p| join(b, [p; 2]))
    };
    in_parts(faces, |_, part| corners(part)).into_iter().fold(nothing, join)
}

/// The result of `work` for each part of the items, in order. `work` receives the index of the first item of the part.
/// Short lists are one part, on this thread.
fn in_parts<T: Sync, R: Send>(items: &[T], work: impl Fn(usize, &[T]) -> R + Sync) -> Vec<R> {
    if items.len() < PARALLEL_ITEMS {
        return vec![work(0, items)];
    }
    items.par_chunks(PART).enumerate().map(|(part, items)| work(part * PART, items)).collect()
}

/// As [`in_parts`], with the items of a list of the same length beside them.
fn in_parts_of<T: Sync, U: Send, R: Send>(
    items: &[T],
    others: &mut [U],
    work: impl Fn(usize, &[T], &mut [U]) -> R + Sync,
) -> Vec<R> {
    if items.len() < PARALLEL_ITEMS {
        return vec![work(0, items, others)];
    }
    let parts = items.par_chunks(PART).zip(others.par_chunks_mut(PART)).enumerate();
    parts.map(|(part, (items, others))| work(part * PART, items, others)).collect()
}

/// Results of one pass over the faces.
struct CheckedFaces {
    /// Lower and upper corner of the vertices that faces use, world units.
    bounds: [DVec3; 2],
    /// The rows of the faces that have a repeated position (true), or whose corners lie on a line (false).
    unusual: Vec<(u32, bool)>,
}

/// Copies the faces to `corners`. Every index must refer to a vertex, and that vertex must be finite.
fn checked_faces<I: Copy + Sync + Into<i64>>(
    vertices: &[[f64; 3]],
    faces: &[[I; 3]],
    corners: &mut [[u32; 3]],
) -> Result<CheckedFaces, MeshError> {
    let parts = in_parts_of(faces, corners, |first, faces, corners| {
        let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut unusual = Vec::new();
        for ((face, indices), corners) in (first..).zip(faces).zip(corners) {
            let mut places = [DVec3::ZERO; 3];
            for ((&index, corner), place) in indices.iter().zip(corners).zip(&mut places) {
                let index = index.into();
                let Some(&vertex) = usize::try_from(index).ok().and_then(|i| vertices.get(i)) else {
                    return Err(MeshError::IndexOutOfRange { face, index, vertices: vertices.len() });
                };
                *place = DVec3::from_array(vertex);
                if !place.is_finite() {
                    let [x, y, z] = vertex;
                    return Err(MeshError::NotFinite { vertex: index as usize, face, x, y, z });
                }
                *corner = index as u32;
                (lower, upper) = (lower.min(*place), upper.max(*place));
            }
            let [a, b, c] = places;
            let is_repeated = a == b || b == c || c == a;
            if is_repeated || is_on_a_line(places) {
                unusual.push((face as u32, is_repeated));
            }
        }
        Ok(CheckedFaces { bounds: [lower, upper], unusual })
    });
    let nothing = CheckedFaces { bounds: [DVec3::INFINITY, DVec3::NEG_INFINITY], unusual: Vec::new() };
    parts.into_iter().try_fold(nothing, |mut all, part| {
        let CheckedFaces { bounds: [lower, upper], unusual } = part?;
        all.bounds = [all.bounds[0].min(lower), all.bounds[1].max(upper)];
        all.unusual.extend(unusual);
        Ok(all)
    })
}

/// The centre of a box, rounded to multiples of [`CENTER_STEP`] times `scale`.
fn rounded_center(lower: DVec3, upper: DVec3, scale: f64) -> DVec3 {
    // Halves are added, because the sum of the corners of a finite box may overflow.
    let center = lower * 0.5 + upper * 0.5;
    let step = CENTER_STEP * scale;
    let rounded = (center / step).round() * step;
    // The quotient of a box without extent may overflow. Such a mesh has no face with an area.
    if rounded.is_finite() { rounded } else { center }
}

/// The power of two that brings `extent` to the interval (1/2, 1]; 1 for a single point.
fn power_of_two_above(extent: f64) -> f64 {
    if extent > 0.0 { extent.log2().ceil().exp2() } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: [[f64; 3]; 4] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];

    #[test]
    fn bad_indices_are_named() {
        let error = Mesh::new(&SQUARE, &[[0, 1, 2], [0, 2, 4]]).unwrap_err();
        assert_eq!(error, MeshError::IndexOutOfRange { face: 1, index: 4, vertices: 4 });
        let error = Mesh::new(&SQUARE, &[[0, -1, 2]]).unwrap_err();
        assert_eq!(error, MeshError::IndexOutOfRange { face: 0, index: -1, vertices: 4 });
    }

    #[test]
    fn a_used_vertex_must_be_finite_and_an_unused_one_is_dropped() {
        let mut vertices = SQUARE.to_vec();
        vertices.insert(0, [f64::NAN, 0.0, 0.0]);
        let error = Mesh::new(&vertices, &[[1, 2, 3], [1, 3, 0]]).unwrap_err();
        assert!(error.to_string().starts_with("vertices[0] = (NaN, 0, 0)"), "{error}");
        let mesh = Mesh::new(&vertices, &[[1, 2, 3]]).unwrap();
        assert_eq!((mesh.dropped_vertices(), mesh.faces()), (1, &[[0, 1, 2]][..]));
    }

    #[test]
    fn faces_with_a_repeated_position_are_dropped_and_faces_on_a_line_are_kept() {
        let mesh = Mesh::new(&SQUARE, &[[0, 1, 1], [0, 1, 2]]).unwrap();
        assert_eq!((mesh.faces().len(), mesh.degenerate_faces(), mesh.source_faces()), (1, 1, Some(&[1][..])));
        let mut split = SQUARE.to_vec();
        // The last vertex has the position of vertex 0, with the other zero.
        split.extend([[0.5, 0.0, 0.0], [0.5, 1e-15, 0.0], [-0.0, 0.0, 0.0]]);
        let mesh = Mesh::new(&split, &[[0, 4, 1], [0, 5, 1], [0, 6, 1], [0, 1, 2]]).unwrap();
        assert_eq!((mesh.degenerate_faces(), mesh.source_faces()), (2, Some(&[0, 1, 3][..])));
        for face in [[0, 1, 1], [0, 4, 1], [0, 6, 1]] {
            assert_eq!(Mesh::new(&split, &[face]).unwrap_err(), MeshError::AllDegenerate { faces: 1 });
        }
        assert_eq!(Mesh::new(&SQUARE, &[]).unwrap_err(), MeshError::Empty { vertices: 4, faces: 0 });
    }

    #[test]
    fn a_far_mesh_keeps_its_shape() {
        let far: Vec<_> = SQUARE.iter().map(|v| v.map(|x| x * 1e-3 + 1e6)).collect();
        let mesh = Mesh::new(&far, &[[0, 1, 2]]).unwrap();
        // float64 rounds 1e6 + 1e-3 by up to 6e-11, which is 1.2e-7 of the side of the square.
        let side = f64::from(mesh.positions()[1].distance(mesh.positions()[0])) * mesh.scale();
        assert!((side - 1e-3).abs() < 3e-7 * 1e-3, "{side}");
        assert_eq!(mesh.world_positions(), far);
        assert_eq!(mesh.bounds(), [far[0], far[2]].map(DVec3::from_array));
        // The centre and the local coordinates are rounded to float64, 1e-16 of 1e6 each.
        let corner = mesh.world_from_local(mesh.exact_triangle(0)[1]);
        assert!((corner - DVec3::from_array(far[1])).length() <= 3e-10, "{corner}");
    }

    #[test]
    fn sizes_that_float32_cannot_hold_are_refused() {
        let huge: Vec<_> = SQUARE.iter().map(|v| v.map(|x| x * 1e36)).collect();
        assert!(matches!(Mesh::new(&huge, &[[0, 1, 2]]), Err(MeshError::Extent { .. })));
    }
}
