//! Connectivity of the faces of a mesh: openings, flipped and duplicate faces, and the oriented surface that determines
//! the sign.
//!
//! Corners of equal float64 positions are one vertex (texture seams split them). Three repairs are made for the sign
//! only, never for the distance, and each is counted:
//! - a face that repeats another one, in either direction, is ignored;
//! - faces joined by a manifold edge (two faces) are flipped to agree; the side that covers the larger area keeps its
//!   direction, unless the two areas are close (40 %) and the patch is closed: then the direction of positive volume is
//!   used;
//! - a patch that cannot be oriented consistently (a Moebius strip) keeps the directions of the input.
//!
//! The mesh is *closed* if every edge is then traversed equally often in both directions. This is the exact condition
//! for an integer winding number everywhere. It allows nested, hollow, touching and self-intersecting surfaces.

use super::Mesh;
use super::disjoint_sets::DisjointSets;
use super::half_edges::{Edge, HalfEdge, HalfEdges};
use crate::memory::with_room;
use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};
use std::borrow::Cow;
use std::sync::OnceLock;

/// Contribution of a face to the winding number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Orientation {
    Kept,
    Flipped,
    /// Ignored: a repetition of another face.
    Skipped,
}

/// Properties of a surface; see the module documentation.
#[derive(Debug, Clone)]
pub struct Topology {
    /// Number of edges of a single face.
    pub boundary_edges: usize,
    /// Number of edges of more than two faces.
    pub nonmanifold_edges: usize,
    /// Number of faces flipped to agree with their neighbours.
    pub flipped_faces: usize,
    /// Number of faces that repeat another one.
    pub duplicate_faces: usize,
    /// Number of patches that cannot be oriented.
    pub unorientable_patches: usize,
    /// Number of components: sets of faces connected through edges.
    pub components: usize,
    /// Whether there is no opening: the winding number is an integer everywhere.
    pub closed: bool,
    /// Net directed edges of the openings, as vertex pairs in the direction in which the faces traverse them, with
    /// repetition.
    pub rim: Vec<[u32; 2]>,
    /// Welded vertex of each vertex: the lowest index with the same position.
    pub welded: Vec<u32>,
    /// Orientation of each face.
    pub orientation: Vec<Orientation>,
    /// Component of each face, the index of one of its faces.
    body: Vec<u32>,
    /// Whether the areas or the volume of a patch decided its direction. If not, the orientation follows from the
    /// connectivity alone.
    is_weighed: bool,
    signed_volume: OnceLock<f64>,
}

/// A patch whose two directions differ in area by less than this fraction is oriented to positive volume.
const MAJORITY: f64 = 0.6;

impl Topology {
    pub fn of(mesh: &Mesh) -> Self {
        let welded = weld(mesh.world_positions());
        let faces = welded_faces(mesh, &welded);
        let mut orientation = vec![Orientation::Kept; faces.len()];
        let mut duplicate_faces = 0;
        let mut half_edges = HalfEdges::of(welded.len(), &faces, |_| false);
        if half_edges.may_repeat {
            duplicate_faces = skip_duplicates(&faces, &mut orientation);
            half_edges = HalfEdges::of(welded.len(), &faces, |f| orientation[f as usize] == Orientation::Skipped);
        }

        let (mut boundary_edges, mut nonmanifold_edges) = (0, 0);
        let mut patches = DisjointSets::new(faces.len());
        // The edges without exactly two faces. All others are balanced once their patch is oriented.
        let mut uneven = Vec::new();
        for edge in half_edges.edges() {
            if let [a, b] = half_edges.items[edge.range()] {
                // Two faces agree if they traverse their common edge in opposite directions.
                patches.join(a.face(), b.face(), a.is_reversed() == b.is_reversed());
                continue;
            }
            boundary_edges += usize::from(edge.range().len() == 1);
            nonmanifold_edges += usize::from(edge.range().len() > 2);
            uneven.push(edge);
        }
        let unorientable_patches = patches.conflicts.len();
        let sides: Vec<(u32, bool)> = (0..faces.len() as u32).map(|f| patches.root(f)).collect();
        let (flipped_faces, is_weighed) =
            orient(mesh, &half_edges, &uneven, &sides, &patches.conflicts, &mut orientation);

        // The unbalanced edges are the rim of the openings.
        let mut rim = Vec::new();
        let all_edges: Vec<Edge>;
        let candidates = if unorientable_patches > 0 {
            all_edges = half_edges.edges().collect();
            &all_edges
        } else {
            &uneven
        };
        for edge in candidates {
            let items = &half_edges.items[edge.range()];
            let is_reversed =
                |e: &HalfEdge| e.is_reversed() != (orientation[e.face() as usize] == Orientation::Flipped);
            let net: i32 = items.iter().map(|e| if is_reversed(e) { -1 } else { 1 }).sum();
            let (low, high) = (edge.low, items[0].high());
            let walked = if net > 0 { [low, high] } else { [high, low] };
            rim.extend(std::iter::repeat_n(walked, net.unsigned_abs() as usize));
        }

        // Faces at an edge of more than two faces belong to one component, but not to one patch.
        let mut bodies = patches;
        for edge in &uneven {
            for pair in half_edges.items[edge.range()].windows(2) {
                bodies.join(pair[0].face(), pair[1].face(), false);
            }
        }
        let is_first = |&f: &u32| orientation[f as usize] != Orientation::Skipped && bodies.root(f).0 == f;
        let components = (0..faces.len() as u32).filter(is_first).count();
        let body = (0..orientation.len() as u32).map(|f| bodies.root(f).0).collect();

        Self {
            boundary_edges,
            nonmanifold_edges,
            flipped_faces,
            duplicate_faces,
            unorientable_patches,
            components,
            closed: rim.is_empty(),
            rim,
            welded,
            orientation,
            body,
            is_weighed,
            signed_volume: OnceLock::new(),
        }
    }

    /// The connectivity of `mesh`, which has the same faces at moved vertices. None if it may differ from this one:
    /// other vertices coincide, or areas decide the direction of a patch.
    pub fn follow(&self, mesh: &Mesh) -> Option<Self> {
        let is_equal = !self.is_weighed && weld(mesh.world_positions()) == self.welded;
        is_equal.then(|| Self { signed_volume: OnceLock::new(), ..self.clone() })
    }

    /// Volume that the oriented faces enclose, local units; negative if the mesh is inside out. Defined for a closed
    /// mesh.
    pub fn signed_volume(&self, mesh: &Mesh) -> f64 {
        let volume = |f: usize| direction(self.orientation[f]) * volume_under(mesh, f);
        *self.signed_volume.get_or_init(|| (0..mesh.faces().len()).map(volume).sum())
    }

    /// Whether the faces of a component, in the directions of the input, enclose a negative volume. The mesh is closed.
    /// A volume within the rounding of its terms counts as zero.
    pub fn has_reversed_body(&self, mesh: &Mesh) -> bool {
        let mut volumes = FxHashMap::<u32, [f64; 2]>::default();
        for (f, &body) in self.body.iter().enumerate() {
            if self.orientation[f] != Orientation::Skipped {
                let volume = volume_under(mesh, f);
                let [sum, magnitude] = volumes.entry(body).or_default();
                *sum += volume;
                *magnitude += volume.abs();
            }
        }
        volumes.values().any(|[sum, magnitude]| *sum < -1e-9 * magnitude)
    }

    /// Corners of a face that determines the sign, in its final orientation: indices into the positions of the mesh.
    pub fn oriented_face(&self, mesh: &Mesh, face: u32) -> Option<[u32; 3]> {
        let [a, b, c] = mesh.faces()[face as usize];
        match self.orientation[face as usize] {
            Orientation::Kept => Some([a, b, c]),
            Orientation::Flipped => Some([a, c, b]),
            Orientation::Skipped => None,
        }
    }

    pub fn bytes(&self) -> usize {
        size_of_val(&self.rim[..])
            + size_of_val(&self.welded[..])
            + size_of_val(&self.orientation[..])
            + size_of_val(&self.body[..])
    }
}

/// Factor of a face's area vector.
pub(crate) fn direction(orientation: Orientation) -> f64 {
    match orientation {
        Orientation::Kept => 1.0,
        Orientation::Flipped => -1.0,
        Orientation::Skipped => 0.0,
    }
}

/// The lowest index of a vertex with the same position, for each vertex.
fn weld(positions: &[[f64; 3]]) -> Vec<u32> {
    const FREE: u32 = u32::MAX;
    // A table of the first vertex at each position, at most half full. A position is found at the place of its hash, or
    // behind it.
    let size = (2 * positions.len()).next_power_of_two().max(2);
    let mut table = vec![FREE; size];
    let first_at = |(p, v): (&[f64; 3], u32)| {
        let mut place = (position_hash(p) >> (u64::BITS - size.trailing_zeros())) as usize;
        loop {
            let first = table[place];
            if first == FREE {
                table[place] = v;
                return v;
            }
            if positions[first as usize] == *p {
                return first;
            }
            place = (place + 1) % size;
        }
    };
    positions.iter().zip(0..).map(first_at).collect()
}

/// A number that equal positions share, where -0 equals 0. Its upper bits depend on all bits of the position.
#[inline(always)]
fn position_hash(p: &[f64; 3]) -> u64 {
    /// Odd, with about as many ones as zeros: 2^64 divided by the golden ratio.
    const FACTOR: u64 = 0x9E37_79B9_7F4A_7C15;
    let mixed = |hash: u64, coordinate: f64| {
        let hash = (hash ^ (coordinate + 0.0).to_bits()).wrapping_mul(FACTOR);
        hash ^ hash >> 32
    };
    p.iter().fold(0, |hash, &coordinate| mixed(hash, coordinate)).wrapping_mul(FACTOR)
}

/// All faces with their welded vertices.
fn welded_faces<'a>(mesh: &'a Mesh, welded: &[u32]) -> Cow<'a, [[u32; 3]]> {
    if welded.iter().zip(0..).all(|(&first, v)| first == v) {
        return Cow::Borrowed(mesh.faces());
    }
    let mut faces: Vec<[u32; 3]> = with_room(mesh.faces().len());
    faces.extend(mesh.faces().iter().map(|face| face.map(|v| welded[v as usize])));
    Cow::Owned(faces)
}

/// Marks every face with the same three corners as an earlier one. Returns the number of these faces.
fn skip_duplicates(faces: &[[u32; 3]], orientation: &mut [Orientation]) -> usize {
    let mut seen = FxHashSet::default();
    let mut duplicates = 0;
    for (face, orientation) in faces.iter().zip(orientation) {
        let mut corners = *face;
        corners.sort_unstable();
        let is_new = seen.insert(corners);
        duplicates += usize::from(!is_new);
        if !is_new {
            *orientation = Orientation::Skipped;
        }
    }
    duplicates
}

/// Flips the faces of each patch to agree. `sides` are the patch of each face, and whether the face is turned relative
/// to it. Returns the number of flipped faces, and whether areas or volumes decided.
fn orient(
    mesh: &Mesh,
    half_edges: &HalfEdges,
    uneven: &[Edge],
    sides: &[(u32, bool)],
    conflicts: &FxHashSet<u32>,
    orientation: &mut [Orientation],
) -> (usize, bool) {
    #[derive(Clone, Copy, Default)]
    struct Patch {
        area: [f64; 2],
        volume: f64,
        faces: [usize; 2],
        open: bool,
    }
    // A mesh has few patches, so that a table of all faces would consist of unused pages.
    let mut patch_of = vec![0u32; sides.len()];
    let mut found = Vec::new();
    for (f, &(root, _)) in sides.iter().enumerate() {
        if root as usize == f {
            patch_of[f] = found.len() as u32;
            found.push(Patch::default());
        }
    }
    for (f, &(root, turned)) in sides.iter().enumerate() {
        if orientation[f] != Orientation::Skipped {
            found[patch_of[root as usize] as usize].faces[usize::from(turned)] += 1;
        }
    }
    // Patches whose faces agree, the most frequent ones, stay as they are.
    if !found.iter().any(|patch| patch.faces[0] > 0 && patch.faces[1] > 0) {
        return (0, false);
    }
    for edge in uneven {
        for half_edge in &half_edges.items[edge.range()] {
            found[patch_of[sides[half_edge.face() as usize].0 as usize] as usize].open = true;
        }
    }
    for f in 0..mesh.faces().len() {
        if orientation[f] == Orientation::Skipped {
            continue;
        }
        let (root, turned) = sides[f];
        let patch = &mut found[patch_of[root as usize] as usize];
        let side = if turned { -1.0 } else { 1.0 };
        patch.area[usize::from(turned)] += crate::geometry::triangle_cross(mesh.triangle(f as u32)).length();
        patch.volume += side * volume_under(mesh, f);
    }

    let (mut flipped, mut is_weighed) = (0, false);
    for (f, &(root, turned)) in sides.iter().enumerate() {
        let patch = &found[patch_of[root as usize] as usize];
        if orientation[f] == Orientation::Skipped || conflicts.contains(&root) || patch.faces.contains(&0) {
            continue;
        }
        is_weighed = true;
        let total = patch.area[0] + patch.area[1];
        let majority_is_turned = patch.area[1] > patch.area[0];
        let clear = patch.area[usize::from(majority_is_turned)] >= MAJORITY * total;
        let turned_is_right = if clear || patch.open { majority_is_turned } else { patch.volume < 0.0 };
        if turned != turned_is_right {
            orientation[f] = Orientation::Flipped;
            flipped += 1;
        }
    }
    (flipped, is_weighed)
}

/// Signed volume of the tetrahedron that a face spans with the centre of the mesh.
fn volume_under(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c]: [DVec3; 3] = mesh.triangle(face as u32);
    a.dot(b.cross(c)) / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Points of a small grid, where many coincide, and both zeros occur.
        #[test]
        fn welding_finds_the_first_vertex_at_each_position(grid in prop::collection::vec(0u32..64, 0..100)) {
            let coordinate = |i: u32| if i == 3 { -0.0 } else { f64::from(i) * 1e-20 };
            let at = |&i: &u32| [i, i / 4, i / 16].map(|i| coordinate(i % 4));
            let positions: Vec<[f64; 3]> = grid.iter().map(at).collect();
            let first = |p| positions.iter().position(|q| q == p).map(|first| first as u32);
            let brute: Vec<Option<u32>> = positions.iter().map(first).collect();
            prop_assert_eq!(weld(&positions).into_iter().map(Some).collect::<Vec<_>>(), brute);
        }
    }

    /// A unit cube from eight corners, twelve outward faces.
    fn cube() -> (Vec<[f64; 3]>, Vec<[i64; 3]>) {
        let vertices = (0..8).map(|i| [(i & 1) as f64, (i >> 1 & 1) as f64, (i >> 2) as f64]).collect();
        let quads = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let faces = quads.iter().flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        (vertices, faces)
    }

    fn topology(vertices: &[[f64; 3]], faces: &[[i64; 3]]) -> Topology {
        Topology::of(&Mesh::new(vertices, faces).unwrap())
    }

    fn volume(vertices: &[[f64; 3]], faces: &[[i64; 3]]) -> f64 {
        let mesh = Mesh::new(vertices, faces).unwrap();
        mesh.topology().signed_volume(&mesh)
    }

    #[test]
    fn a_cube_is_closed() {
        let (vertices, faces) = cube();
        let found = topology(&vertices, &faces);
        assert!(found.closed);
        assert_eq!((found.boundary_edges, found.flipped_faces, found.components), (0, 0, 1));
        assert!((volume(&vertices, &faces) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn split_vertices_are_welded() {
        let (vertices, faces) = cube();
        let soup: Vec<[f64; 3]> = faces.iter().flatten().map(|&i| vertices[i as usize]).collect();
        let own: Vec<[i64; 3]> = (0..12).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        assert!(topology(&soup, &own).closed);
    }

    #[test]
    fn a_missing_lid_leaves_a_rim_in_the_faces_direction() {
        let (vertices, faces) = cube();
        let found = topology(&vertices, &faces[2..]);
        assert!(!found.closed);
        assert_eq!((found.boundary_edges, found.rim.len()), (4, 4));
        // The removed faces traversed 0-2-3-1, their neighbours traverse it backwards.
        assert!(found.rim.contains(&[2, 0]));
    }

    #[test]
    fn flipped_faces_are_turned_back() {
        let (vertices, mut faces) = cube();
        faces[3].swap(0, 1);
        faces[8].swap(0, 1);
        let found = topology(&vertices, &faces);
        assert!(found.closed);
        assert_eq!(found.flipped_faces, 2);
        assert!((volume(&vertices, &faces) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_repeated_face_counts_once_in_either_direction() {
        let (vertices, mut faces) = cube();
        let mut reversed = faces.clone();
        reversed.iter_mut().for_each(|face| face.swap(0, 2));
        faces.extend(reversed);
        let found = topology(&vertices, &faces);
        assert!(found.closed);
        assert_eq!((found.duplicate_faces, found.nonmanifold_edges), (12, 0));
        assert!((volume(&vertices, &faces) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_degenerate_face_closes_the_surface_around_it() {
        // The edge 0-1 of the bottom is split at its middle on one side only; a sliver face joins the two sides.
        let (mut vertices, mut faces) = cube();
        vertices.push([0.5, 0.0, 0.0]);
        let split = faces.iter().position(|f| f.contains(&0) && f.contains(&1) && f.contains(&5)).unwrap();
        faces.splice(split..=split, [[0, 8, 5], [8, 1, 5], [0, 1, 8]]);
        let found = topology(&vertices, &faces);
        assert!(found.closed, "{:?}", found.rim);
    }

    #[test]
    fn a_moebius_strip_is_reported() {
        let n = 8i64;
        let vertices: Vec<[f64; 3]> = (0..n)
            .flat_map(|i| {
                let angle = std::f64::consts::TAU * i as f64 / n as f64;
                [-0.3, 0.3].map(|w: f64| {
                    let r = 1.0 + w * (angle / 2.0).cos();
                    [r * angle.cos(), r * angle.sin(), w * (angle / 2.0).sin()]
                })
            })
            .collect();
        let faces: Vec<[i64; 3]> = (0..n)
            .flat_map(|i| {
                let (a, b) = (2 * i, 2 * i + 1);
                let (c, d) = if i + 1 < n { (a + 2, b + 2) } else { (1, 0) };
                [[a, c, b], [b, c, d]]
            })
            .collect();
        let found = topology(&vertices, &faces);
        assert_eq!((found.unorientable_patches, found.components, found.closed), (1, 1, false));
    }
}
