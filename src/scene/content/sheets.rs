//! The instances whose triangles block light: open, flat and alpha-textured meshes.

use super::instance::Instance;
use super::tree::Tree;
use crate::geometry::Aabb;

/// Largest distance of a flat mesh from its plane, relative to its size: half the distance at which rays start off
/// their own surface. Float32 vertices of coplanar faces differ by an eighth of it.
pub(crate) const FLATNESS: f64 = 5e-7;

/// The instances whose triangles light intersects, and a tree over their boxes.
#[derive(Debug, Default)]
pub struct Sheets {
    /// Index of each sheet among the scene's instances.
    pub instances: Vec<u32>,
    /// Whether each sheet lies in a plane, so that it does not occlude itself.
    pub is_flat: Vec<bool>,
    pub tree: Option<Tree>,
}

impl Sheets {
    pub fn new(instances: &[Instance], boxes: &[Aabb]) -> Self {
        let casts = |instance: &Instance| instance.is_sheet && instance.casts_shadow && instance.opacity > 0.0;
        let found: Vec<u32> = (0..instances.len() as u32).filter(|&i| casts(&instances[i as usize])).collect();
        let boxes: Vec<Aabb> = found.iter().map(|&i| boxes[i as usize]).collect();
        let tree = (!found.is_empty()).then(|| Tree::new(&boxes));
        // Trees and topologies are built here in parallel. If they were built at the first ray, inside a parallel loop,
        // a worker could wait for work that is queued behind its own.
        for triangles in found.iter().filter_map(|&i| instances[i as usize].triangles.as_ref()) {
            triangles.mesh.bvh();
            triangles.mesh.topology();
        }
        let flat =
            |&i: &u32| instances[i as usize].triangles.as_ref().is_some_and(|triangles| triangles.is_flat(FLATNESS));
        Self { is_flat: found.iter().map(flat).collect(), instances: found, tree }
    }

    pub fn len(&self) -> usize {
        self.instances.len()
    }

    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }
}
