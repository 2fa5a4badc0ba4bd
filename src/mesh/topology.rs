//! Connectivity of the faces of a mesh: openings, flipped and duplicate faces, and the oriented surface that determines
//! the sign.
//!
//! Corners with equal positions count as one vertex (texture seams split them). Three repairs are made for the sign
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
use crate::memory::with_room;
use glam::{DVec3, Vec3};
use rayon::prelude::*;
use rustc_hash::{FxBuildHasher, FxHashMap, FxHashSet};

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
    /// Enclosed volume in local units, negative if the mesh is inside out. Defined for a closed mesh.
    pub signed_volume: f64,
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
}

/// A patch whose two directions differ in area by less than this fraction is oriented to positive volume.
const MAJORITY: f64 = 0.6;

/// A directed edge of a face, its vertices sorted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct HalfEdge {
    low: u32,
    high: u32,
    face: u32,
    /// Whether the face traverses the edge from the higher to the lower vertex.
    reversed: bool,
}

impl Topology {
    pub fn of(mesh: &Mesh) -> Self {
        let welded = weld(mesh);
        // Degenerate faces close the surface around them. After welding they must still have three corners.
        let mut faces: Vec<[u32; 3]> = with_room(mesh.faces().len() + mesh.degenerate_faces().len());
        faces.extend(mesh.faces().iter().chain(mesh.degenerate_faces()).map(|face| face.map(|v| welded[v as usize])));
        let mut orientation = vec![Orientation::Kept; faces.len()];
        let duplicate_faces = skip_duplicates(welded.len(), &faces, &mut orientation);

        let half_edges = half_edges(welded.len(), &faces, &orientation);
        // Most edges have two faces.
        let mut edges: Vec<&[HalfEdge]> = with_room(half_edges.len() / 2);
        edges.extend(half_edges.chunk_by(|a, b| (a.low, a.high) == (b.low, b.high)));
        let boundary_edges = edges.iter().filter(|edge| edge.len() == 1).count();
        let nonmanifold_edges = edges.iter().filter(|edge| edge.len() > 2).count();

        let mut bodies = DisjointSets::new(faces.len());
        let mut patches = DisjointSets::new(faces.len());
        for edge in &edges {
            for pair in edge.windows(2) {
                bodies.join(pair[0].face, pair[1].face, false);
            }
            if let [a, b] = edge {
                // Two faces agree if they traverse their common edge in opposite directions.
                patches.join(a.face, b.face, a.reversed == b.reversed);
            }
        }
        let components = (0..faces.len() as u32)
            .filter(|&f| orientation[f as usize] != Orientation::Skipped && bodies.root(f).0 == f)
            .count();
        let unorientable_patches = patches.conflicts.len();
        let (flipped_faces, is_weighed) = orient(mesh, &faces, &edges, &mut patches, &mut orientation);

        // The unbalanced edges are the rim of the openings.
        let mut rim = Vec::new();
        for edge in &edges {
            let net: i32 = edge
                .iter()
                .map(|e| if e.reversed != (orientation[e.face as usize] == Orientation::Flipped) { -1 } else { 1 })
                .sum();
            let HalfEdge { low, high, .. } = edge[0];
            let walked = if net > 0 { [low, high] } else { [high, low] };
            rim.extend(std::iter::repeat_n(walked, net.unsigned_abs() as usize));
        }
        orientation.truncate(mesh.faces().len());
        let body = (0..orientation.len() as u32).map(|f| bodies.root(f).0).collect();

        Self {
            boundary_edges,
            nonmanifold_edges,
            flipped_faces,
            duplicate_faces,
            unorientable_patches,
            components,
            closed: rim.is_empty(),
            signed_volume: signed_volume(mesh, &orientation),
            rim,
            welded,
            orientation,
            body,
            is_weighed,
        }
    }

    /// The connectivity of `mesh`, which has the same faces at moved vertices. None if it may differ from this one:
    /// other vertices coincide, or areas decide the direction of a patch.
    pub fn follow(&self, mesh: &Mesh) -> Option<Self> {
        if self.is_weighed || !is_welded(mesh, &self.welded) {
            return None;
        }
        Some(Self { signed_volume: signed_volume(mesh, &self.orientation), ..self.clone() })
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

/// For each vertex the lowest index with the same position, where -0 equals 0.
fn weld(mesh: &Mesh) -> Vec<u32> {
    // Keys stored beside their rows sort several times faster than keys that are looked up.
    let mut order: Vec<([u32; 3], u32)> = with_room(mesh.positions().len());
    order.extend(mesh.positions().iter().map(position_key).zip(0..));
    order.par_sort_unstable();
    let mut welded = vec![0; order.len()];
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, v) in group {
            welded[v as usize] = group[0].1;
        }
    }
    welded
}

/// A key that equal positions share, where -0 equals 0.
fn position_key(p: &Vec3) -> [u32; 3] {
    [(p.x + 0.0).to_bits(), (p.y + 0.0).to_bits(), (p.z + 0.0).to_bits()]
}

/// Whether `welded` is the result of [`weld`], in linear time.
fn is_welded(mesh: &Mesh, welded: &[u32]) -> bool {
    let positions = mesh.positions();
    let mut seen = FxHashSet::with_capacity_and_hasher(positions.len(), FxBuildHasher);
    welded.iter().enumerate().all(|(v, &first)| {
        if first as usize == v {
            seen.insert(position_key(&positions[v]))
        } else {
            positions[v] == positions[first as usize]
        }
    })
}

/// Marks every face with the same three corners as an earlier one.
fn skip_duplicates(vertices: usize, faces: &[[u32; 3]], orientation: &mut [Orientation]) -> usize {
    let corners = |face: &[u32; 3]| {
        let mut corners = *face;
        corners.sort_unstable();
        corners
    };
    let order = sort_by_vertex(vertices, faces.iter().map(corners).zip(0..), |(corners, _)| corners[0]);
    let mut duplicates = 0;
    for group in order.chunk_by(|a, b| a.0 == b.0) {
        for &(_, f) in &group[1..] {
            orientation[f as usize] = Orientation::Skipped;
            duplicates += 1;
        }
    }
    // Faces that lost a corner to welding have no orientation.
    for (f, &[a, b, c]) in faces.iter().enumerate() {
        if a == b || b == c || c == a {
            orientation[f] = Orientation::Skipped;
        }
    }
    duplicates
}

fn half_edges(vertices: usize, faces: &[[u32; 3]], orientation: &[Orientation]) -> Vec<HalfEdge> {
    let of_face = |(f, &[a, b, c]): (usize, &[u32; 3])| {
        [(a, b), (b, c), (c, a)].map(|(from, to)| HalfEdge {
            low: from.min(to),
            high: from.max(to),
            face: f as u32,
            reversed: from > to,
        })
    };
    let taking_part = faces.iter().enumerate().filter(|(f, _)| orientation[*f] != Orientation::Skipped);
    sort_by_vertex(vertices, taking_part.flat_map(of_face), |half_edge| half_edge.low)
}

/// Sorts items by the vertex that comes first in them: distributes them to the vertices, then sorts the items of each.
fn sort_by_vertex<T: Copy + Ord>(
    vertices: usize,
    items: impl Iterator<Item = T> + Clone,
    vertex: impl Fn(&T) -> u32,
) -> Vec<T> {
    // Start of the items of each vertex. Filling advances each start to that of the next vertex.
    let mut starts = vec![0u32; vertices + 1];
    items.clone().for_each(|item| starts[vertex(&item) as usize + 1] += 1);
    for v in 0..vertices {
        starts[v + 1] += starts[v];
    }
    let Some(any) = items.clone().next() else { return Vec::new() };
    let mut sorted = with_room(starts[vertices] as usize);
    sorted.resize(starts[vertices] as usize, any);
    for item in items {
        let place = &mut starts[vertex(&item) as usize];
        sorted[*place as usize] = item;
        *place += 1;
    }
    sorted.chunk_by_mut(|a, b| vertex(a) == vertex(b)).for_each(<[T]>::sort_unstable);
    sorted
}

/// Flips the faces of each patch to agree. Returns the number of flipped faces, and whether areas or volumes decided.
fn orient(
    mesh: &Mesh,
    faces: &[[u32; 3]],
    edges: &[&[HalfEdge]],
    patches: &mut DisjointSets,
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
    let mut patch_of = vec![0u32; faces.len()];
    let mut found = Vec::new();
    for f in 0..faces.len() {
        if patches.root(f as u32).0 as usize == f {
            patch_of[f] = found.len() as u32;
            found.push(Patch::default());
        }
    }
    for edge in edges {
        if edge.len() != 2 {
            for half_edge in *edge {
                found[patch_of[patches.root(half_edge.face).0 as usize] as usize].open = true;
            }
        }
    }
    for f in 0..faces.len() {
        if orientation[f] == Orientation::Skipped {
            continue;
        }
        let (root, turned) = patches.root(f as u32);
        let patch = &mut found[patch_of[root as usize] as usize];
        patch.faces[usize::from(turned)] += 1;
        if f < mesh.faces().len() {
            let side = if turned { -1.0 } else { 1.0 };
            patch.area[usize::from(turned)] += crate::geometry::triangle_cross(mesh.triangle(f as u32)).length();
            patch.volume += side * volume_under(mesh, f);
        }
    }

    let (mut flipped, mut is_weighed) = (0, false);
    for f in 0..faces.len() {
        let (root, turned) = patches.root(f as u32);
        let patch = &found[patch_of[root as usize] as usize];
        if orientation[f] == Orientation::Skipped || patches.conflicts.contains(&root) || patch.faces.contains(&0) {
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

/// Volume that the oriented faces enclose, local units.
fn signed_volume(mesh: &Mesh, orientation: &[Orientation]) -> f64 {
    (0..mesh.faces().len()).map(|f| direction(orientation[f]) * volume_under(mesh, f)).sum()
}

/// Signed volume of the tetrahedron that a face spans with the centre of the mesh.
fn volume_under(mesh: &Mesh, face: usize) -> f64 {
    let [a, b, c]: [DVec3; 3] = mesh.triangle(face as u32);
    a.dot(b.cross(c)) / 6.0
}

/// Union-find that also stores, for each element, whether it is flipped relative to its root.
struct DisjointSets {
    parent: Vec<u32>,
    turned: Vec<bool>,
    size: Vec<u32>,
    /// Roots of sets that were joined to themselves with opposite orientation.
    conflicts: std::collections::HashSet<u32>,
}

impl DisjointSets {
    fn new(n: usize) -> Self {
        Self {
            parent: (0..n as u32).collect(),
            turned: vec![false; n],
            size: vec![1; n],
            conflicts: std::collections::HashSet::new(),
        }
    }

    /// The root of `x`, and whether `x` is flipped relative to it. Halves the path.
    fn root(&mut self, mut x: u32) -> (u32, bool) {
        let mut turned = false;
        while self.parent[x as usize] != x {
            let parent = self.parent[x as usize];
            let grand = self.parent[parent as usize];
            if grand != parent {
                self.turned[x as usize] ^= self.turned[parent as usize];
                self.parent[x as usize] = grand;
            }
            turned ^= self.turned[x as usize];
            x = self.parent[x as usize];
        }
        (x, turned)
    }

    /// Joins two sets; `turned` tells whether `b` is flipped relative to `a`.
    fn join(&mut self, a: u32, b: u32, turned: bool) {
        let ((root_a, turned_a), (root_b, turned_b)) = (self.root(a), self.root(b));
        let relative = turned_a ^ turned_b ^ turned;
        if root_a == root_b {
            if relative {
                self.conflicts.insert(root_a);
            }
            return;
        }
        let (parent, child) =
            if self.size[root_a as usize] >= self.size[root_b as usize] { (root_a, root_b) } else { (root_b, root_a) };
        self.parent[child as usize] = parent;
        self.turned[child as usize] = relative;
        self.size[parent as usize] += self.size[child as usize];
        if self.conflicts.remove(&child) {
            self.conflicts.insert(parent);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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

    #[test]
    fn a_cube_is_closed() {
        let (vertices, faces) = cube();
        let found = topology(&vertices, &faces);
        assert!(found.closed);
        assert_eq!((found.boundary_edges, found.flipped_faces, found.components), (0, 0, 1));
        assert!((found.signed_volume - 1.0).abs() < 1e-12);
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
        assert!((found.signed_volume - 1.0).abs() < 1e-12);
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
        assert!((found.signed_volume - 1.0).abs() < 1e-12);
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
