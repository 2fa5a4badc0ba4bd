//! The instances whose triangles block cones of light: open, flat, thin and alpha-textured meshes.

use super::instance::Instance;
use super::tree::Tree;
use crate::geometry::Aabb;

/// The instances whose triangles cones of light intersect, and a tree over their boxes.
#[derive(Debug, Default)]
pub struct Sheets {
    /// Index of each sheet among the scene's instances.
    pub instances: Vec<u32>,
    pub tree: Option<Tree>,
}

impl Sheets {
    pub fn new(instances: &[Instance], boxes: &[Aabb]) -> Self {
        let casts = |instance: &Instance| instance.is_sheet && instance.casting_triangles().is_some();
        let found: Vec<u32> = (0..instances.len() as u32).filter(|&i| casts(&instances[i as usize])).collect();
        let boxes: Vec<Aabb> = found.iter().map(|&i| boxes[i as usize]).collect();
        let tree = (!found.is_empty()).then(|| Tree::new(&boxes));
        Self { instances: found, tree }
    }

    pub fn len(&self) -> usize {
        self.instances.len()
    }

    pub fn is_empty(&self) -> bool {
        self.instances.is_empty()
    }
}
