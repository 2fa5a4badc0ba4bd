//! A scene prepared for drawing.

use super::instance::{Instance, InstanceInput, world_box};
use super::material::Material;
use super::sheets::Sheets;
use super::texture::Texture;
use super::tree::Tree;
use crate::error::{Error, SceneError};
use crate::geometry::Aabb;
use glam::{DAffine3, DVec3};
use std::sync::Arc;

/// Instances, materials and textures, prepared for drawing.
pub struct Scene {
    /// Middle of the scene, world units.
    pub center: DVec3,
    /// Number of world units in a scene unit.
    pub scale: f64,
    /// The instances, in the order of their inputs.
    pub instances: Vec<Instance>,
    /// Materials of all instances.
    pub materials: Vec<Material>,
    /// Textures of the materials.
    pub textures: Vec<Arc<Texture>>,
    /// Tree over the boxes of the instances.
    pub tree: Tree,
    /// Scene boxes of the instances.
    pub boxes: Vec<Aabb>,
    /// Box around all instances, world units.
    bounds: [DVec3; 2],
    /// The instances whose triangles block cones of light.
    pub sheets: Sheets,
    /// Whether triangles of any instance block rays of light.
    pub has_faces: bool,
    /// Whether the field of any instance without triangles blocks rays of light.
    pub has_fields: bool,
    /// The inputs of the scene, for [`Scene::moved`].
    inputs: Vec<InstanceInput>,
}

/// Largest number of instances.
const MAX_INSTANCES: usize = 1 << 24;

impl Scene {
    /// Prepares instances for drawing. Fails if an input is invalid.
    pub fn new(
        inputs: Vec<InstanceInput>,
        materials: Vec<Material>,
        textures: Vec<Arc<Texture>>,
    ) -> Result<Self, Error> {
        if inputs.is_empty() || inputs.len() > MAX_INSTANCES {
            let problem = format!("a scene needs 1 to {MAX_INSTANCES} instances, got {}", inputs.len());
            return Err(SceneError::new("instances", problem).into());
        }
        let world_boxes =
            inputs.iter().enumerate().map(|(i, input)| world_box(i, input)).collect::<Result<Vec<_>, _>>()?;
        let lower = world_boxes.iter().fold(DVec3::INFINITY, |lower, b| lower.min(b[0]));
        let upper = world_boxes.iter().fold(DVec3::NEG_INFINITY, |upper, b| upper.max(b[1]));
        let center = lower * 0.5 + upper * 0.5;
        let scale = (upper - lower).max_element().max(f64::MIN_POSITIVE).log2().ceil().exp2();
        let boxes: Vec<Aabb> = world_boxes
            .iter()
            .map(|b| Aabb { min: ((b[0] - center) / scale).as_vec3(), max: ((b[1] - center) / scale).as_vec3() })
            .collect();
        let make = |(i, input)| Instance::new(i, input, center, scale, &materials);
        let instances: Vec<Instance> = inputs.iter().enumerate().map(make).collect::<Result<_, _>>()?;
        let tree = Tree::new(&boxes);
        let all = boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
        let bounds = [all.min, all.max].map(|corner| center + corner.as_dvec3() * scale);
        let sheets = Sheets::new(&instances, &boxes);
        let has_faces = instances.iter().any(|instance| instance.casting_triangles().is_some());
        let has_fields = instances.iter().any(Instance::casts_by_field);
        Ok(Self {
            center,
            scale,
            instances,
            materials,
            textures,
            tree,
            boxes,
            bounds,
            sheets,
            has_faces,
            has_fields,
            inputs,
        })
    }

    /// The same instances with other transforms, world from local, one for each instance. All objects are shared. The
    /// scene is the one that [`Scene::new`] makes of these transforms.
    pub fn moved(&self, world_from_local: &[DAffine3]) -> Result<Self, Error> {
        if world_from_local.len() != self.inputs.len() {
            let problem = format!("{} for {} instances", world_from_local.len(), self.inputs.len());
            return Err(SceneError::new("transforms", problem).into());
        }
        let place = |(input, &world_from_local): (&InstanceInput, &DAffine3)| InstanceInput {
            world_from_local,
            ..input.clone()
        };
        let inputs = self.inputs.iter().zip(world_from_local).map(place).collect();
        Self::new(inputs, self.materials.clone(), self.textures.clone())
    }

    /// Scene coordinates of a world position.
    pub fn scene_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.scale
    }

    /// Box around all instances, world units.
    pub fn bounds(&self) -> [DVec3; 2] {
        self.bounds
    }
}
