//! Vertices moved onto the source, and edges divided where the source is curved between their ends.
//!
//! A vertex stays off the source where its best place lies outside its cell, or where the planes of a strongly curved
//! part meet outside it. A straight edge of one voxel on a surface with a radius of curvature of one voxel is an eighth
//! of a voxel off in its middle, and an edge that cuts off a crease is farther off. Such vertices move to the point of
//! the source nearest to them, and such edges are divided at the point nearest to their middle, with their two faces.
//! A change is taken back where a face would turn, become slender, or cross another face. Without any change the mesh
//! does not cross itself.

use super::Crossing;
use super::LevelSurface;
use super::division::Corner;
use super::probes::{NearInstances, Place};
use crate::error::Error;
use crate::geometry::triangles_cross;
use crate::progress::Progress;
use glam::{DVec3, IVec3};
use rayon::prelude::*;
use std::collections::HashSet;

/// The places that each pass changes: vertices, then edges twice. Each division quarters the error on smooth parts.
const PASSES: [Kind; 3] = [Kind::Vertices, Kind::Edges, Kind::Edges];

/// A place is changed if it is farther from the source, voxels.
const LEAST_ERROR: f64 = 0.06;

/// Largest change of a place, voxels. Farther parts of the source belong to another feature.
const FARTHEST: f64 = 1.0;

/// The search for the source ends with a step of this length or less, voxels.
const LAST_STEP: f64 = 0.02;

/// Number of steps of the search for the source.
const STEPS: usize = 3;

/// Smallest cosine between the normals of a face before and after the change.
const LEAST_COSINE: f64 = 0.05;

/// Smallest height of a part of a face, voxels.
const LEAST_HEIGHT: f64 = 0.004;

/// Number of edges or faces that one task processes.
const CHUNK: usize = 1 << 8;

/// Side of the cells in which faces are compared, voxels.
const SIDE: f64 = 2.0;

/// Most parts of a divided face.
const MOST_PARTS: usize = 4;

/// The kind of places that a pass changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    /// Vertices move.
    Vertices,
    /// Edges are divided.
    Edges,
}

/// A new place of a vertex, or of the middle of an edge, unless that is taken back.
#[derive(Debug, Clone, Copy)]
struct Change {
    /// The vertex that moves; `u32::MAX` for the middle of an edge.
    vertex: u32,
    /// A point of the source, world units.
    place: DVec3,
    /// Normal of the source there.
    normal: DVec3,
    /// Distance from the place before, voxels.
    length: f64,
    is_kept: bool,
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

/// A face or its parts in the search for crossings: the entry of `Refinement::faces`, or the unchanged face after all
/// entries, and its box.
type Item = (u32, [DVec3; 2]);

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

/// Moves vertices and divides edges of a mesh, vertices and faces, where they are far from the source. `normals` has
/// the normals of the vertices. All places stay `within` a box.
pub(super) fn refine(
    mesh: (&mut Vec<DVec3>, &mut Vec<[u32; 3]>),
    mut normals: Vec<DVec3>,
    nearby: &NearInstances,
    spacing: DVec3,
    within: [DVec3; 2],
    progress: &Progress,
) -> Result<(), Error> {
    for kind in PASSES {
        let mut refinement = Refinement::new((&mut *mesh.0, &mut *mesh.1), &normals, kind, nearby, spacing, within);
        if refinement.is_flat {
            return Ok(());
        }
        if !refinement.changes.is_empty() {
            refinement.take_back(progress)?;
            let added = refinement.finish();
            added.into_iter().for_each(|(vertex, normal)| {
                normals.resize(normals.len().max(vertex as usize + 1), normal);
                normals[vertex as usize] = normal;
            });
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
    /// Whether the surface is curved nowhere.
    is_flat: bool,
    spacing: DVec3,
    changes: Vec<Change>,
    /// Sorted by face.
    faces: Vec<ChangedFace>,
}

impl<'a> Refinement<'a> {
    fn new(
        (vertices, corners): (&'a mut Vec<DVec3>, &'a mut Vec<[u32; 3]>),
        normals: &'a [DVec3],
        kind: Kind,
        nearby: &NearInstances,
        spacing: DVec3,
        within: [DVec3; 2],
    ) -> Self {
        let sides = curved_sides(vertices, corners, normals, kind, spacing);
        let keys: Vec<[u32; 2]> = sides.chunk_by(|a, b| a.0 == b.0).map(|sides| sides[0].0).collect();
        let place = |&[a, b]: &[u32; 2]| 0.5 * (vertices[a as usize] + vertices[b as usize]);
        let places: Vec<DVec3> = keys.par_iter().map(place).collect();
        let found: Vec<Option<Change>> = places
            .par_chunks(CHUNK)
            .flat_map_iter(|places| points_of_source(places, nearby, spacing, within))
            .collect();
        let mut changes = Vec::new();
        let mut of_faces: Vec<(u32, u32)> = Vec::new();
        for (sides, found) in sides.chunk_by(|a, b| a.0 == b.0).zip(found) {
            if let Some(found) = found {
                of_faces.extend(sides.iter().map(|&(_, side)| (side, changes.len() as u32)));
                let [a, b] = sides[0].0;
                changes.push(Change { vertex: if a == b { a } else { u32::MAX }, ..found });
            }
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
            |face: u32| self.cells(self.extent(&[self.corners[face as usize]])).any(|cell| cells.contains(&cell));
        all.filter(|&face| !is_changed[face as usize] && is_near(face)).collect()
    }

    /// Takes back the largest change of each of some entries of `faces`.
    fn undo(&mut self, faces: &[u32]) {
        for &i in faces {
            let length = |&change: &u32| self.changes[change as usize].length;
            let changes = self.faces[i as usize].changes.into_iter().flatten();
            if let Some(change) = changes.max_by(|a, b| length(a).total_cmp(&length(b))) {
                self.changes[change as usize].is_kept = false;
            }
        }
        if !faces.is_empty() {
            for face in &mut self.faces {
                for change in &mut face.changes {
                    if change.is_some_and(|change| !self.changes[change as usize].is_kept) {
                        (*change, face.is_new) = (None, true);
                    }
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
        let normal = corners.iter().map(|&corner| self.normals[corner as usize] * self.spacing).sum::<DVec3>();
        let normal = normal.normalize_or(before);
        // A face that is turned already may stay so.
        let least = before.dot(normal).min(LEAST_COSINE);
        let (parts, count) = self.parts(face);
        parts[..count].iter().any(|&corners| {
            let places = scaled(corners);
            let area = cross(places);
            let longest = (0..3).map(|i| places[i].distance(places[(i + 1) % 3])).fold(0.0, f64::max);
            !(area.dot(normal) >= least * area.length() && area.length() >= LEAST_HEIGHT * longest)
        })
    }

    fn place(&self, corner: u32) -> DVec3 {
        let (corner, count) = (corner as usize, self.vertices.len());
        if corner < count { self.vertices[corner] } else { self.changes[corner - count].place }
    }

    /// The parts of a face with its changes, in its orientation.
    fn parts(&self, face: &ChangedFace) -> Parts {
        let corners = self.corners[face.face as usize];
        let count = self.vertices.len() as u32;
        let changed = face.changes.map(|change| change.map(|change| count + change));
        if self.kind == Kind::Vertices {
            return ([std::array::from_fn(|i| changed[i].unwrap_or(corners[i])); MOST_PARTS], 1);
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

    /// The box of some triangles.
    fn extent(&self, triangles: &[[u32; 3]]) -> [DVec3; 2] {
        let places = triangles.as_flattened().iter().map(|&corner| self.place(corner));
        places.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[lower, upper], p| [lower.min(p), upper.max(p)])
    }

    fn extent_of_changed(&self, face: &ChangedFace) -> [DVec3; 2] {
        let (parts, count) = self.parts(face);
        self.extent(&parts[..count])
    }

    /// The cells that a box overlaps.
    fn cells(&self, extent: [DVec3; 2]) -> impl Iterator<Item = IVec3> + use<> {
        let [low, high] = extent.map(|place| (place / (SIDE * self.spacing)).floor().as_ivec3());
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
        let changed = (0..first).into_par_iter().map(|i| (i, self.extent_of_changed(&self.faces[i as usize])));
        let others = unchanged.par_iter().map(|&face| (first + face, self.extent(&[self.corners[face as usize]])));
        let items: Vec<Item> = changed.chain(others).collect();
        let in_cells = |(i, item): (usize, &Item)| {
            let own = self.cells(item.1).filter(|cell| cells.contains(cell));
            own.map(move |cell| (cell.to_array(), i as u32))
        };
        let mut entries: Vec<([i32; 3], u32)> = items.par_iter().enumerate().flat_map_iter(in_cells).collect();
        entries.par_sort_unstable();
        let groups: Vec<&[([i32; 3], u32)]> = entries.chunk_by(|a, b| a.0 == b.0).collect();
        let found = groups.par_iter().with_min_len(CHUNK).map(|group| {
            let mut found = Vec::new();
            for (at, &(_, i)) in group.iter().enumerate() {
                // Unchanged faces come after all others.
                if i >= first {
                    break;
                }
                let (own, [lower, upper]) = items[i as usize];
                let is_new = self.faces[own as usize].is_new;
                for &(_, j) in &group[at + 1..] {
                    let (other, [low, high]) = items[j as usize];
                    let overlap = lower.cmple(high).all() && low.cmple(upper).all();
                    let is_either_new = is_new || self.faces.get(j as usize).is_some_and(|face| face.is_new);
                    if overlap && is_either_new && self.cross(own, other) {
                        found.extend([own, other].into_iter().filter(|&i| i < first));
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

    /// Whether parts of two items cross.
    fn cross(&self, i: u32, j: u32) -> bool {
        let parts = |i: u32| match self.faces.get(i as usize) {
            Some(face) => self.parts(face),
            None => ([self.corners[i as usize - self.faces.len()]; MOST_PARTS], 1),
        };
        let ((first, count), (second, others)) = (parts(i), parts(j));
        first[..count].iter().any(|a| {
            let [lower, upper] = self.extent(&[*a]);
            second[..others].iter().any(|b| {
                let [low, high] = self.extent(&[*b]);
                lower.cmple(high).all()
                    && low.cmple(upper).all()
                    && a.iter().filter(|corner| b.contains(corner)).count() < 2
                    && triangles_cross(a.map(|corner| self.place(corner)), b.map(|corner| self.place(corner)))
            })
        })
    }

    /// Changes the mesh. Returns the vertices that are new or have moved, in ascending order if new, and their normals.
    fn finish(self) -> Vec<(u32, DVec3)> {
        let first = self.vertices.len() as u32;
        let mut next = first;
        let number = |change: &Change| {
            let is_added = change.is_kept && change.vertex == u32::MAX;
            next += u32::from(is_added);
            if is_added { next - 1 } else { change.vertex }
        };
        let numbers: Vec<u32> = self.changes.iter().map(number).collect();
        let renumbered = |corner: u32| if corner < first { corner } else { numbers[(corner - first) as usize] };
        let parts: Vec<(u32, Parts)> = self.faces.iter().map(|face| (face.face, self.parts(face))).collect();
        for (face, (parts, count)) in parts {
            self.corners[face as usize] = parts[0].map(renumbered);
            self.corners.extend(parts[1..count].iter().map(|part| part.map(renumbered)));
        }
        let kept = self.changes.iter().zip(numbers).filter(|(change, _)| change.is_kept);
        kept.map(|(&Change { place, normal, .. }, vertex)| {
            self.vertices.resize(self.vertices.len().max(vertex as usize + 1), place);
            self.vertices[vertex as usize] = place;
            (vertex, normal)
        })
        .collect()
    }
}

/// The places of a kind at curved parts of the surface, sorted, with each face that has them: the ends of the edge, or
/// twice the vertex, and three times the face plus the number of its side or corner.
fn curved_sides(
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    normals: &[DVec3],
    kind: Kind,
    spacing: DVec3,
) -> Vec<([u32; 2], u32)> {
    let is_curved = |[a, b]: [u32; 2]| {
        let length = ((vertices[b as usize] - vertices[a as usize]) / spacing).length();
        // The arc of a circle with these normals at its ends is an eighth of the length times the angle high.
        let angle = (normals[b as usize] - normals[a as usize]).length();
        length * angle > 8.0 * LEAST_ERROR
    };
    let numbered = faces.par_iter().enumerate().with_min_len(CHUNK);
    let mut sides: Vec<([u32; 2], u32)> = numbered
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

/// The points of the source at some places, where those are far from it.
fn points_of_source(
    places: &[DVec3],
    nearby: &NearInstances,
    spacing: DVec3,
    [lower, upper]: [DVec3; 2],
) -> Vec<Option<Change>> {
    let start = |&place: &DVec3| Change { vertex: u32::MAX, place, normal: DVec3::ZERO, length: 0.0, is_kept: false };
    let mut found: Vec<Change> = places.iter().map(start).collect();
    for _ in 0..STEPS {
        let starts: Vec<Place> = found.iter().map(|at| Place { point: at.place, is_sharp: false }).collect();
        found.iter_mut().for_each(|at| at.is_kept = false);
        nearby(&starts, &mut |i, point, normal| {
            let place = point.max(lower).min(upper);
            let step = ((place - starts[i].point) / spacing).length();
            found[i] = Change { place, normal: normal.normalize_or_zero(), is_kept: step <= LAST_STEP, ..found[i] };
        });
    }
    let far = found.into_iter().zip(places).map(|(at, &start)| {
        let length = ((at.place - start) / spacing).length();
        (at.is_kept && length > LEAST_ERROR && length <= FARTHEST).then_some(Change { length, ..at })
    });
    far.collect()
}
