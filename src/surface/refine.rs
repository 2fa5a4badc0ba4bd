//! Vertices moved onto the source, and edges flipped or divided where the source is curved between their ends.
//!
//! A vertex stays off the source where its best place lies outside its cell, or where the planes of a strongly curved
//! part meet outside it. A straight edge of one voxel on a surface with a radius of curvature of one voxel is an eighth
//! of a voxel off in its middle, and an edge that cuts off a crease is farther off. Such vertices move to the point of
//! the source nearest to them. If the other diagonal of the two faces beside such an edge is much closer to the
//! source, it replaces the edge: the edge is flipped. Other edges are divided at the point nearest to their middle,
//! with their two faces. A change is taken back where a face would turn, become slender, or cross another face.
//! Without any change the mesh does not cross itself.

use super::Crossing;
use super::LevelSurface;
use super::division::Corner;
use super::probes::{NearInstances, Place};
use crate::error::Error;
use crate::geometry::triangles_cross;
use crate::progress::Progress;
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// The places that each pass changes. Each division of an edge quarters the error on smooth parts.
const PASSES: [Kind; 5] = [Kind::Vertices, Kind::Edges, Kind::Edges, Kind::Edges, Kind::Edges];

/// A place is changed if it is farther from the source, voxels.
const LEAST_ERROR: f64 = 0.06;

/// The source is evaluated at edges whose normals state at least this distance of their middle from it, voxels.
const LEAST_SAGITTA: f64 = 0.5 * LEAST_ERROR;

/// An edge is flipped if the middle of the other diagonal is closer to the source by this factor.
const FLIP_RATIO: f64 = 0.7;

/// Largest change of a place, voxels. Farther parts of the source belong to another feature.
const FARTHEST: f64 = 1.0;

/// The search for the source ends with a step of this length or less, voxels.
const LAST_STEP: f64 = 0.02;

/// Number of steps of the search for the source.
const STEPS: usize = 3;

/// Smallest cosine between the normal of a changed face and the mean normal at its corners.
const LEAST_COSINE: f64 = 0.05;

/// Smallest height of a part of a face, voxels.
const LEAST_HEIGHT: f64 = 0.004;

/// Number of edges or faces that one task processes.
const CHUNK: usize = 1 << 8;

/// Side of the cells in which faces are compared, voxels.
const SIDE: f64 = 1.0;

/// Most parts of a divided face.
const MOST_PARTS: usize = 4;

/// The kind of places that a pass changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Vertices move.
    Vertices,
    /// Edges are flipped or divided.
    Edges,
}

/// A change of the mesh.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Action {
    /// A vertex moves.
    Move(u32),
    /// An edge is replaced by one with these ends.
    Flip([u32; 2]),
    /// An edge is divided.
    Divide,
}

/// A new place of a vertex or of the middle of an edge, or a flip of the edge, unless that is taken back.
#[derive(Debug, Clone, Copy)]
struct Change {
    action: Action,
    /// A point of the source, world units.
    place: DVec3,
    /// Normal of the source there.
    normal: DVec3,
    /// Distance from the place before, voxels.
    length: f64,
    is_kept: bool,
}

impl Change {
    /// Whether the distance from the source exceeds the tolerance, and is small enough that both are on one feature.
    fn is_far(&self) -> bool {
        self.is_kept && self.length > LEAST_ERROR && self.length <= FARTHEST
    }
}

/// A face with changes.
#[derive(Debug, Clone, Copy)]
struct ChangedFace {
    face: u32,
    /// The changes of its corners, or of the edges from each of its corners to the next one.
    changes: [Option<u32>; 3],
    /// Whether its parts were not compared yet.
    is_new: bool,
}

/// A triangle in the search for crossings.
#[derive(Debug, Clone, Copy)]
struct Item {
    /// The entry of `Refinement::faces` of which it is a part, or the unchanged face after all entries.
    owner: u32,
    corners: [u32; 3],
    /// Its box, world units.
    extent: [DVec3; 2],
}

/// The place of a change and a face that has it: the ends of the edge, or twice the vertex, and three times the face
/// plus the number of its side or corner.
type Side = ([u32; 2], u32);

/// Triangles as indices of vertices; change `i` has the index of the vertex that follows after all others and `i` more.
type Parts = ([[u32; 3]; MOST_PARTS], usize);

impl LevelSurface {
    /// Unit normals of the vertices of patches, means of the normals at their crossings.
    pub(super) fn patch_normals(&self, crossings: &[Crossing]) -> Vec<DVec3> {
        let normal = |id| self.crossings_of(id, crossings).map(|crossing| crossing.normal).sum::<DVec3>();
        (0..self.cells.patch_count() as u32).into_par_iter().map(|id| normal(id).normalize_or_zero()).collect()
    }
}

/// The normal of a vertex of a divided mesh from the normals of all patches.
pub(super) fn corner_normal(corner: Corner, patches: &[DVec3], crossings: &[Crossing]) -> DVec3 {
    match corner {
        Corner::Patch(id) => patches[id as usize],
        Corner::Edge(edge) => crossings[edge as usize].normal,
        Corner::Face(a, b) => (patches[a as usize] + patches[b as usize]).normalize_or_zero(),
    }
}

/// Moves vertices, and flips or divides edges of a mesh, vertices and faces, where they are far from the source.
/// `normals` has the normals of the vertices. All places stay `within` a box.
pub(super) fn refine(
    mesh: (&mut Vec<DVec3>, &mut Vec<[u32; 3]>),
    mut normals: Vec<DVec3>,
    nearby: &NearInstances,
    spacing: DVec3,
    within: [DVec3; 2],
    progress: &Progress,
) -> Result<(), Error> {
    // A pass evaluates edges with one of these ends: any vertex, then the corners of faces that the last pass changed.
    let mut is_changed = vec![true; mesh.0.len()];
    for kind in PASSES {
        let parts = (&mut *mesh.0, &mut *mesh.1);
        let mut refinement = Refinement::new(parts, (&normals, &is_changed), kind, nearby, spacing, within);
        if refinement.is_flat {
            return Ok(());
        }
        refinement.take_back(progress)?;
        let (placed, changed) = refinement.finish();
        for (vertex, normal) in placed {
            normals.resize(normals.len().max(vertex as usize + 1), normal);
            normals[vertex as usize] = normal;
        }
        if kind == Kind::Edges {
            is_changed.fill(false);
            is_changed.resize(mesh.0.len(), false);
            changed.into_iter().for_each(|corner| is_changed[corner as usize] = true);
        }
    }
    Ok(())
}

struct Refinement<'a> {
    vertices: &'a mut Vec<DVec3>,
    corners: &'a mut Vec<[u32; 3]>,
    /// Normals of the vertices.
    normals: &'a [DVec3],
    kind: Kind,
    /// Whether the surface is curved nowhere between its vertices.
    is_flat: bool,
    spacing: DVec3,
    changes: Vec<Change>,
    /// Sorted by face.
    faces: Vec<ChangedFace>,
}

impl<'a> Refinement<'a> {
    fn new(
        (vertices, corners): (&'a mut Vec<DVec3>, &'a mut Vec<[u32; 3]>),
        (normals, is_changed): (&'a [DVec3], &[bool]),
        kind: Kind,
        nearby: &NearInstances,
        spacing: DVec3,
        within: [DVec3; 2],
    ) -> Self {
        let sides = curved_sides(vertices, corners, (normals, is_changed), kind, spacing);
        let places: Vec<&[Side]> = sides.chunk_by(|a, b| a.0 == b.0).collect();
        let middles = |ends: &[[u32; 2]]| -> Vec<DVec3> {
            ends.iter().map(|&[a, b]| 0.5 * (vertices[a as usize] + vertices[b as usize])).collect()
        };
        let measure = |ends: &[[u32; 2]]| -> Vec<Change> {
            let chunks = ends.par_chunks(CHUNK);
            chunks.flat_map_iter(|ends| points_of_source(&middles(ends), nearby, spacing, within)).collect()
        };
        let found = measure(&places.iter().map(|sides| sides[0].0).collect::<Vec<_>>());
        let flips = if kind == Kind::Edges { flips(corners, &places, &found, measure) } else { HashMap::new() };
        let flipped: HashSet<u32> = flips.keys().flat_map(|&i| places[i]).map(|side| side.1 / 3).collect();
        let mut changes = Vec::new();
        let mut of_faces: Vec<(u32, u32)> = Vec::new();
        for (i, (&sides, found)) in places.iter().zip(found).enumerate().filter(|(_, (_, found))| found.is_far()) {
            let action = match (flips.get(&i), sides[0].0) {
                (Some(&ends), _) => Action::Flip(ends),
                // A face with a flip has no other change.
                _ if sides.iter().any(|side| flipped.contains(&(side.1 / 3))) => continue,
                (_, [a, b]) if a == b => Action::Move(a),
                _ => Action::Divide,
            };
            of_faces.extend(sides.iter().map(|&(_, side)| (side, changes.len() as u32)));
            changes.push(Change { action, ..found });
        }
        of_faces.par_sort_unstable();
        let faces = of_faces.chunk_by(|a, b| a.0 / 3 == b.0 / 3).map(|sides| {
            let mut changes = [None; 3];
            sides.iter().for_each(|&(side, change)| changes[side as usize % 3] = Some(change));
            ChangedFace { face: sides[0].0 / 3, changes, is_new: true }
        });
        let faces = faces.collect();
        Self { vertices, corners, normals, kind, is_flat: sides.is_empty(), spacing, changes, faces }
    }

    /// Takes changes back until no part of a face is folded or slender, and none crosses another face.
    fn take_back(&mut self, progress: &Progress) -> Result<(), Error> {
        let mut unchanged: Option<Vec<u32>> = None;
        loop {
            self.take_back_folds();
            let new: Vec<&ChangedFace> = self.faces.iter().filter(|face| face.is_new).collect();
            if new.is_empty() {
                return Ok(());
            }
            let cells: HashSet<IVec3> = new.iter().flat_map(|face| self.cells(self.extent_of_changed(face))).collect();
            let unchanged = unchanged.get_or_insert_with(|| self.unchanged_faces(&cells));
            let crossing = self.crossing_faces(unchanged, &cells, progress)?;
            self.faces.iter_mut().for_each(|face| face.is_new = false);
            self.undo(&crossing);
        }
    }

    /// The faces without a change in some cells.
    fn unchanged_faces(&self, cells: &HashSet<IVec3>) -> Vec<u32> {
        let mut is_changed = vec![false; self.corners.len()];
        self.faces.iter().for_each(|face| is_changed[face.face as usize] = true);
        let all = (0..self.corners.len() as u32).into_par_iter().with_min_len(CHUNK);
        let is_near =
            |face: u32| self.cells(self.extent(self.corners[face as usize])).any(|cell| cells.contains(&cell));
        all.filter(|&face| !is_changed[face as usize] && is_near(face)).collect()
    }

    /// Takes back the largest change of each of some entries of `faces`. An edge whose flip is taken back is divided.
    fn undo(&mut self, faces: &[u32]) {
        let length = |&change: &u32| self.changes[change as usize].length;
        let largest = |&face: &u32| {
            let changes = self.faces[face as usize].changes.into_iter().flatten();
            changes.max_by(|a, b| length(a).total_cmp(&length(b)))
        };
        let undone: HashSet<u32> = faces.iter().filter_map(largest).collect();
        for &i in &undone {
            let change = &mut self.changes[i as usize];
            match change.action {
                Action::Flip(_) => change.action = Action::Divide,
                Action::Move(_) | Action::Divide => change.is_kept = false,
            }
        }
        for face in &mut self.faces {
            for change in &mut face.changes {
                if change.is_some_and(|change| undone.contains(&change)) {
                    face.is_new = true;
                    *change = change.filter(|&change| self.changes[change as usize].is_kept);
                }
            }
        }
    }

    fn take_back_folds(&mut self) {
        loop {
            let faces = (0..self.faces.len() as u32).into_par_iter().with_min_len(CHUNK);
            let folded: Vec<u32> = faces.filter(|&i| self.is_folded(&self.faces[i as usize])).collect();
            if folded.is_empty() {
                return;
            }
            self.undo(&folded);
        }
    }

    fn is_folded(&self, face: &ChangedFace) -> bool {
        if !face.is_new || face.changes == [None; 3] {
            return false;
        }
        let scaled = |corners: [u32; 3]| corners.map(|corner| self.place(corner) / self.spacing);
        let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let corners = self.corners[face.face as usize];
        let before = cross(scaled(corners)).normalize_or_zero();
        let normal = |corners: [u32; 3]| {
            let sum = corners.iter().map(|&corner| self.normal(corner) * self.spacing).sum::<DVec3>();
            sum.normalize_or(before)
        };
        // A face that is turned already may stay so.
        let least = before.dot(normal(corners)).min(LEAST_COSINE);
        let (parts, count) = self.parts(face);
        parts[..count].iter().any(|&corners| {
            let (places, normal) = (scaled(corners), normal(corners));
            let area = cross(places);
            let longest = (0..3).map(|i| places[i].distance(places[(i + 1) % 3])).fold(0.0, f64::max);
            !(area.dot(normal) >= least * area.length() && area.length() >= LEAST_HEIGHT * longest)
        })
    }

    fn place(&self, corner: u32) -> DVec3 {
        let (corner, count) = (corner as usize, self.vertices.len());
        if corner < count { self.vertices[corner] } else { self.changes[corner - count].place }
    }

    fn normal(&self, corner: u32) -> DVec3 {
        let (corner, count) = (corner as usize, self.vertices.len());
        if corner < count { self.normals[corner] } else { self.changes[corner - count].normal }
    }

    /// The parts of a face with its changes, in its orientation.
    fn parts(&self, face: &ChangedFace) -> Parts {
        let corners = self.corners[face.face as usize];
        let count = self.vertices.len() as u32;
        let changed = face.changes.map(|change| change.map(|change| count + change));
        if self.kind == Kind::Vertices {
            return ([std::array::from_fn(|i| changed[i].unwrap_or(corners[i])); MOST_PARTS], 1);
        }
        for (side, change) in face.changes.into_iter().enumerate() {
            if let Some(Action::Flip([a, b])) = change.map(|change| self.changes[change as usize].action) {
                // The second end of the side is replaced by the opposite corner of the other face.
                let mut flipped = corners;
                flipped[(side + 1) % 3] = if corners.contains(&a) { b } else { a };
                return ([flipped; MOST_PARTS], 1);
            }
        }
        let mut parts = [corners; MOST_PARTS];
        let divided = changed.iter().flatten().count();
        // The divided edges begin at this corner.
        let first = (0..3).find(|&i| changed[i].is_some() && changed[(i + 2) % 3].is_none()).unwrap_or(0);
        let [a, b, c] = [0, 1, 2].map(|i| corners[(first + i) % 3]);
        let [ab, bc, ca] = [0, 1, 2].map(|i| changed[(first + i) % 3].unwrap_or(0));
        match divided {
            0 => {}
            1 => (parts[0], parts[1]) = ([a, ab, c], [ab, b, c]),
            2 => {
                let length = |a, b| (self.place(a) - self.place(b)).length_squared();
                let is_shorter = length(a, bc) <= length(ab, c);
                parts[0] = [ab, b, bc];
                (parts[1], parts[2]) = if is_shorter { ([a, ab, bc], [a, bc, c]) } else { ([a, ab, c], [ab, bc, c]) };
            }
            _ => parts = [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]],
        }
        (parts, divided + 1)
    }

    /// The box of some corners.
    fn extent(&self, corners: impl IntoIterator<Item = u32>) -> [DVec3; 2] {
        let places = corners.into_iter().map(|corner| self.place(corner));
        places.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lower, upper], p| [lower.min(p), upper.max(p)])
    }

    /// The box of a face with its changes, whichever of them are taken back.
    fn extent_of_changed(&self, face: &ChangedFace) -> [DVec3; 2] {
        let (count, parts) = (self.vertices.len() as u32, self.parts(face).0);
        let changes = face.changes.into_iter().flatten().map(|change| count + change);
        self.extent(parts.into_iter().flatten().chain(self.corners[face.face as usize]).chain(changes))
    }

    fn cell(&self, place: DVec3) -> IVec3 {
        (place / (SIDE * self.spacing)).floor().as_ivec3()
    }

    /// The cells that a box overlaps.
    fn cells(&self, extent: [DVec3; 2]) -> impl Iterator<Item = IVec3> + use<> {
        let [low, high] = extent.map(|place| self.cell(place));
        let rows = (low.z..=high.z).flat_map(move |z| (low.y..=high.y).map(move |y| (y, z)));
        rows.flat_map(move |(y, z)| (low.x..=high.x).map(move |x| IVec3::new(x, y, z)))
    }

    /// The entries of `faces` with a part that crosses another face, of pairs of which one is new. `unchanged` has the
    /// faces without a change in the `cells` of new ones.
    fn crossing_faces(
        &self,
        unchanged: &[u32],
        cells: &HashSet<IVec3>,
        progress: &Progress,
    ) -> Result<Vec<u32>, Error> {
        let first = self.faces.len() as u32;
        let item = |owner: u32, corners: [u32; 3]| Item { owner, corners, extent: self.extent(corners) };
        let changed = (0..first).into_par_iter().flat_map_iter(|i| {
            let (parts, count) = self.parts(&self.faces[i as usize]);
            parts.into_iter().take(count).map(move |corners| item(i, corners))
        });
        let others = unchanged.par_iter().map(|&face| item(first + face, self.corners[face as usize]));
        let items: Vec<Item> = changed.chain(others).collect();
        let in_cells = |(i, item): (usize, &Item)| {
            let own = self.cells(item.extent).filter(|cell| cells.contains(cell));
            own.map(move |cell| (cell.to_array(), i as u32))
        };
        let mut entries: Vec<([i32; 3], u32)> = items.par_iter().enumerate().flat_map_iter(in_cells).collect();
        entries.par_sort_unstable();
        let groups: Vec<&[([i32; 3], u32)]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let found = groups.par_iter().with_min_len(CHUNK).map(|group| {
            let mut found = Vec::new();
            let mut items_of_cell = group.iter().map(|&(_, i)| &items[i as usize]);
            // Unchanged faces come after all others.
            while let Some(item) = items_of_cell.next().filter(|item| item.owner < first) {
                let is_new = self.faces[item.owner as usize].is_new;
                for other in items_of_cell.clone().filter(|other| other.owner != item.owner) {
                    let is_either_new = is_new || self.faces.get(other.owner as usize).is_some_and(|face| face.is_new);
                    if is_either_new && self.first_cell(item, other) == Some(group[0].0) && self.cross(item, other) {
                        found.extend([item.owner, other.owner].into_iter().filter(|&i| i < first));
                    }
                }
            }
            progress.check()?;
            Ok(found)
        });
        let mut found = found.collect::<Result<Vec<_>, Error>>()?.concat();
        found.sort_unstable();
        found.dedup();
        Ok(found)
    }

    /// The first cell that the boxes of two items share.
    fn first_cell(&self, item: &Item, other: &Item) -> Option<[i32; 3]> {
        let ([lower, upper], [low, high]) = (item.extent, other.extent);
        let overlap = lower.cmple(high).all() && low.cmple(upper).all();
        overlap.then(|| self.cell(lower.max(low)).to_array())
    }

    /// Whether two triangles cross. Triangles with a common edge do not.
    fn cross(&self, item: &Item, other: &Item) -> bool {
        item.corners.iter().filter(|corner| other.corners.contains(corner)).count() < 2
            && triangles_cross(item.corners.map(|i| self.place(i)), other.corners.map(|i| self.place(i)))
    }

    /// Changes the mesh. Returns the vertices that are new or have moved, in ascending order if new, with their
    /// normals, and the corners of all parts of changed faces.
    fn finish(self) -> (Vec<(u32, DVec3)>, Vec<u32>) {
        let first = self.vertices.len() as u32;
        let mut next = first;
        let number = |change: &Change| match change.action {
            Action::Move(vertex) => vertex,
            Action::Divide if change.is_kept => {
                next += 1;
                next - 1
            }
            Action::Divide | Action::Flip(_) => u32::MAX,
        };
        let numbers: Vec<u32> = self.changes.iter().map(number).collect();
        let renumbered = |corner: u32| if corner < first { corner } else { numbers[(corner - first) as usize] };
        let changed = self.faces.iter().filter(|face| face.changes != [None; 3]);
        let parts: Vec<(u32, Parts)> = changed.map(|face| (face.face, self.parts(face))).collect();
        let mut changed = Vec::new();
        for (face, (mut parts, count)) in parts {
            parts.iter_mut().flatten().for_each(|corner| *corner = renumbered(*corner));
            self.corners[face as usize] = parts[0];
            self.corners.extend(&parts[1..count]);
            changed.extend(parts[..count].as_flattened());
        }
        let is_placed = |change: &Change| change.is_kept && !matches!(change.action, Action::Flip(_));
        let kept = self.changes.iter().zip(numbers).filter(|(change, _)| is_placed(change));
        let place = |(&Change { place, normal, .. }, vertex): (&Change, u32)| {
            self.vertices.resize(self.vertices.len().max(vertex as usize + 1), place);
            self.vertices[vertex as usize] = place;
            (vertex, normal)
        };
        (kept.map(place).collect(), changed)
    }
}

/// The edges to flip: the index in `edges`, and the ends of the new edge. `edges` has the sides of each edge, and
/// `found` the change of its middle. `measure` computes the changes of the middles of other edges. A flip never creates
/// an edge that exists already. Of several flips of one face, the one with the largest gain is made.
fn flips(
    corners: &[[u32; 3]],
    edges: &[&[Side]],
    found: &[Change],
    measure: impl Fn(&[[u32; 2]]) -> Vec<Change>,
) -> HashMap<usize, [u32; 2]> {
    let ordered = |a: u32, b: u32| [a.min(b), a.max(b)];
    let diagonal = |i: usize| match *edges[i] {
        [(_, first), (_, second)] if found[i].is_far() => {
            let [a, b] = [first, second].map(|side| corners[side as usize / 3][(side as usize % 3 + 2) % 3]);
            (a != b).then(|| (i, ordered(a, b)))
        }
        _ => None,
    };
    let candidates: Vec<(usize, [u32; 2])> = (0..edges.len()).filter_map(diagonal).collect();
    let measured = measure(&candidates.iter().map(|candidate| candidate.1).collect::<Vec<_>>());
    let gain = |(&(i, ends), new): (&(usize, [u32; 2]), Change)| {
        let is_better = new.is_kept && new.length < FLIP_RATIO * found[i].length;
        is_better.then(|| (found[i].length - new.length, i, ends))
    };
    let mut gains: Vec<(f64, usize, [u32; 2])> = candidates.iter().zip(measured).filter_map(gain).collect();
    gains.sort_by(|a, b| b.0.total_cmp(&a.0));
    let new: HashSet<[u32; 2]> = gains.iter().map(|&(_, _, ends)| ends).collect();
    let sides = corners.par_iter().with_min_len(CHUNK).flat_map_iter(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let mut existing: HashSet<[u32; 2]> = sides.map(|(a, b)| ordered(a, b)).filter(|ends| new.contains(ends)).collect();
    let mut used = HashSet::new();
    let is_apart = |&(_, i, ends): &(f64, usize, [u32; 2])| {
        let faces = || edges[i].iter().map(|side| side.1 / 3);
        let is_apart = !faces().any(|face| used.contains(&face)) && existing.insert(ends);
        if is_apart {
            used.extend(faces());
        }
        is_apart
    };
    gains.into_iter().filter(is_apart).map(|(_, i, ends)| (i, ends)).collect()
}

/// The places of a kind at curved parts of the surface, sorted, with each face that has them. At least one end of each
/// edge has changed.
fn curved_sides(
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    (normals, is_changed): (&[DVec3], &[bool]),
    kind: Kind,
    spacing: DVec3,
) -> Vec<Side> {
    let is_curved = |[a, b]: [u32; 2]| {
        if !is_changed[a as usize] && !is_changed[b as usize] {
            return false;
        }
        let length = ((vertices[b as usize] - vertices[a as usize]) / spacing).length();
        // The arc of a circle with these normals at its ends is an eighth of the length times the angle high.
        let angle = (normals[b as usize] - normals[a as usize]).length();
        length * angle > 8.0 * LEAST_SAGITTA
    };
    let numbered = faces.par_iter().enumerate().with_min_len(CHUNK);
    let mut sides: Vec<Side> = numbered
        .flat_map_iter(|(face, corners)| {
            let side = move |i: usize| {
                let [a, b] = [corners[i], corners[(i + 1) % 3]];
                ([a.min(b), a.max(b)], 3 * face as u32 + i as u32)
            };
            [0, 1, 2].map(side).into_iter().filter(|&(ends, _)| is_curved(ends))
        })
        .collect();
    if kind == Kind::Vertices {
        let mut is_end = vec![false; vertices.len()];
        sides.iter().flat_map(|side| side.0).for_each(|vertex| is_end[vertex as usize] = true);
        let corners = faces.as_flattened().par_iter().enumerate().with_min_len(CHUNK);
        let corners = corners.filter(|&(_, &vertex)| is_end[vertex as usize]);
        sides = corners.map(|(number, &vertex)| ([vertex; 2], number as u32)).collect();
    }
    sides.par_sort_unstable();
    sides
}

/// The points of the source nearest to some places. Those that were not found are not kept.
fn points_of_source(
    places: &[DVec3],
    nearby: &NearInstances,
    spacing: DVec3,
    [lower, upper]: [DVec3; 2],
) -> Vec<Change> {
    let start =
        |&place: &DVec3| Change { action: Action::Divide, place, normal: DVec3::ZERO, length: 0.0, is_kept: false };
    let mut found: Vec<Change> = places.iter().map(start).collect();
    for _ in 0..STEPS {
        let starts: Vec<Place> = found.iter().map(|at| Place { point: at.place, is_sharp: false }).collect();
        found.iter_mut().for_each(|at| at.is_kept = false);
        nearby(&starts, &mut |i, point, normal| {
            let place = point.max(lower).min(upper);
            let step = ((place - starts[i].point) / spacing).length();
            let length = ((place - places[i]) / spacing).length();
            let is_kept = step <= LAST_STEP;
            found[i] = Change { place, normal: normal.normalize_or_zero(), length, is_kept, ..found[i] };
        });
    }
    found
}
