//! Triangles that close the openings of a mesh.
//!
//! The rim of an opening is divided into closed walks. A short walk is closed by a cone to one apex. The cone of a long
//! walk would consist of slivers as long as the opening, and no sum over a tree of such slivers is fast. A long walk is
//! therefore cut into runs of [`RUN`] edges; a small cone closes each run and its chord, and the chords make a shorter
//! walk. Most triangles are then no longer than such a run, and lie close to the rim. Beside a straight rim they are
//! still slivers, because the run and its chord coincide.

use crate::mesh::Mesh;
use glam::DVec3;
use std::collections::{BTreeMap, HashMap};

/// A triangle whose first two corners are an edge of the rim or a chord.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cap {
    pub corners: [DVec3; 3],
    /// Whether the edge belongs to the rim. The two triangles at a chord traverse it in opposite directions, so chords
    /// cancel in every integral over the boundary.
    pub is_on_rim: bool,
    /// The walk that the triangle closes, and the mean of its vertices.
    pub walk: u32,
    pub center: DVec3,
}

/// Offset of an apex from the centre of its edges, in sizes of their box. It points away from the planes of typical
/// grids and models, so that no sample lies on a cone by symmetry.
const APEX_OFFSET: DVec3 = DVec3::new(0.003_69, 0.005_37, 0.007_58);
/// A walk with more edges is cut into runs.
const LONGEST_CONE: usize = 64;
/// Number of edges of a run.
const RUN: usize = 8;

/// The rims of all openings: edges by opening, the lowest opening first. Rim edges that share vertices belong to one
/// opening.
pub(super) fn rims(rim: &[[u32; 2]]) -> Vec<Vec<[u32; 2]>> {
    let mut opening_of: HashMap<u32, u32> = HashMap::new();
    fn root(opening_of: &mut HashMap<u32, u32>, mut v: u32) -> u32 {
        loop {
            let parent = *opening_of.entry(v).or_insert(v);
            if parent == v {
                return v;
            }
            let grand = opening_of[&parent];
            opening_of.insert(v, grand);
            v = grand;
        }
    }
    for &[from, to] in rim {
        let (a, b) = (root(&mut opening_of, from), root(&mut opening_of, to));
        opening_of.insert(a.max(b), a.min(b));
    }
    let mut by_opening: BTreeMap<u32, Vec<[u32; 2]>> = BTreeMap::new();
    for &edge in rim {
        by_opening.entry(root(&mut opening_of, edge[0])).or_default().push(edge);
    }
    by_opening.into_values().collect()
}

/// The caps over all openings of a mesh, local units.
pub(super) fn caps(mesh: &Mesh) -> Vec<Cap> {
    let position = |v: u32| mesh.exact_position(v);
    let edges = |walk: &[[u32; 2]]| -> Vec<Edge> {
        walk.iter().map(|edge| Edge { ends: edge.map(position), is_on_rim: true }).collect()
    };
    let mut caps = Vec::new();
    let mut count = 0;
    for rim in rims(&mesh.topology().rim) {
        // A cone closes several walks as well as one.
        let walks = if rim.len() <= LONGEST_CONE { vec![rim] } else { walks(&rim) };
        for walk in walks {
            let edges = edges(&walk);
            let center = edges.iter().map(|edge| edge.ends[0]).sum::<DVec3>() / edges.len() as f64;
            let first = caps.len();
            close_walk(edges, &mut caps);
            caps[first..].iter_mut().for_each(|cap: &mut Cap| (cap.walk, cap.center) = (count, center));
            count += 1;
        }
    }
    caps
}

/// An edge that the closing triangles traverse backwards.
#[derive(Clone, Copy)]
struct Edge {
    ends: [DVec3; 2],
    is_on_rim: bool,
}

/// Divides the rim of an opening into closed walks. Every vertex is the end of as many edges as it is the start.
fn walks(rim: &[[u32; 2]]) -> Vec<Vec<[u32; 2]>> {
    let mut leaving: HashMap<u32, Vec<u32>> = HashMap::new();
    for &[from, to] in rim {
        leaving.entry(from).or_default().push(to);
    }
    let mut walks = Vec::new();
    for &[start, _] in rim {
        let mut walk = Vec::new();
        let mut from = start;
        while let Some(to) = leaving.get_mut(&from).and_then(Vec::pop) {
            walk.push([from, to]);
            from = to;
            if from == start {
                break;
            }
        }
        if !walk.is_empty() {
            walks.push(walk);
        }
    }
    walks
}

/// Closes a walk, run by run until the chords fit into one cone.
fn close_walk(mut walk: Vec<Edge>, caps: &mut Vec<Cap>) {
    while walk.len() > LONGEST_CONE {
        let mut chords = Vec::with_capacity(walk.len().div_ceil(RUN));
        for run in walk.chunks(RUN) {
            let (Some(first), Some(last)) = (run.first(), run.last()) else { continue };
            let [start, end] = [first.ends[0], last.ends[1]];
            let mut closed = run.to_vec();
            closed.push(Edge { ends: [end, start], is_on_rim: false });
            close_by_cone(&closed, caps);
            chords.push(Edge { ends: [start, end], is_on_rim: false });
        }
        walk = chords;
    }
    close_by_cone(&walk, caps);
}

/// Adds a cone from closed walks to one apex near their centre.
fn close_by_cone(edges: &[Edge], caps: &mut Vec<Cap>) {
    // The mean over the starts of edges is the mean over the vertices.
    let starts = edges.iter().map(|edge| edge.ends[0]);
    let sum: DVec3 = starts.clone().sum();
    let (low, high) = starts.fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
    let apex = sum / edges.len() as f64 + APEX_OFFSET * (high - low).max_element();
    // The predicates are fastest with coordinates of few bits.
    let apex = apex.as_vec3().as_dvec3();
    caps.extend(edges.iter().map(|&Edge { ends: [from, to], is_on_rim }| Cap {
        corners: [to, from, apex],
        is_on_rim,
        walk: 0,
        center: apex,
    }));
}
