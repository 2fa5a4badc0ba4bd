//! Scenes: instances of objects under any affine transform, viewed by a camera and lit through distance fields.
//!
//! # Theory
//!
//! A picture is made in two passes that communicate by a G-buffer. The *primary* pass ([`primary`]) finds the visible
//! surfaces of each pixel: triangles exactly, as a rasteriser would at pixel centres, or the root of a field. The
//! *light* pass ([`light`]) evaluates the scene's distance fields ([`field`], [`shadow`]): the fraction of each light
//! that arrives, the open part of the hemisphere, and the length of material behind the surface. Both search a tree
//! over the boxes of the instances ([`tree`]).
//!
//! Spaces: *world*, the user's; *scene*, `(world - center) / scale` with a power of two, where the scene spans about 1
//! and float32 is accurate; *local*, the coordinates of the object of an instance; *field*, see [`field`]. Matrices are
//! named target-from-source. A distance `d` of an instance allows a step of `d / |L r|` along a scene ray `r`, where
//! `L` maps scene to local: valid for any affine transform, as the local ball around a point is an ellipsoid in the
//! scene.
//!
//! # Practice
//!
//! Build a [`Scene`] once and draw it any number of times by a [`Renderer`](renderer::Renderer). Objects are shared: a
//! forest of one tree has one field, and [`Scene::moved`] shares them all. A new kind of object casts shadows if it
//! implements [`field::Field`].

pub mod article;
pub mod cone;
pub mod device_fields;
pub mod device_light;
pub mod far;
pub mod field;
pub mod gpu;
pub mod kinds;
pub mod known;
pub mod light;
pub mod nested;
pub mod occlusion;
pub mod primary;
pub mod raster;
pub mod rasterizer;
pub mod renderer;
pub mod shadow;
pub mod sheets;
pub mod texture;
pub mod thin;
pub mod things;
pub mod transmission;
pub mod tree;
pub mod triangles;

use crate::error::{Error, SceneError};
use crate::geometry::Aabb;
use far::FarField;
use field::Field;
use glam::{DAffine3, DMat3, DVec3, Mat3, Vec3};
use occlusion::Ball;
use sheets::Sheets;
use std::sync::{Arc, OnceLock};
use texture::Texture;
use tree::Tree;
use triangles::Triangles;

/// Appearance of a surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Material {
    /// Linear RGB and opacity; a factor of the texture.
    pub color: [f32; 4],
    /// Index of a texture of the scene.
    pub texture: Option<u32>,
    /// Linear RGB that the surface emits; a factor of its texture.
    pub emission: [f32; 3],
    /// Index of a texture of the scene.
    pub emission_texture: Option<u32>,
    /// Whether the colour is shown unchanged, without lighting.
    pub unlit: bool,
    pub specular: f32,
    pub shininess: f32,
    pub alpha: Alpha,
    /// Whether the back of faces is visible too.
    pub two_sided: bool,
    /// Length inside the object after which 1/e of the light remains, world units, for each of RGB; 0 if light does not
    /// enter.
    pub scattering: [f32; 3],
}

/// Use of opacity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Alpha {
    Opaque,
    /// Cut out where the opacity is below this.
    Mask(f32),
    Blend,
}

/// An object and its transform, from the caller.
#[derive(Clone)]
pub struct InstanceInput {
    pub triangles: Option<Arc<Triangles>>,
    pub field: Option<Arc<dyn Field>>,
    pub world_from_local: DAffine3,
    /// Index of the first of the object's materials in the scene's list.
    pub first_material: u32,
    /// Whether the object's own colours replace the material's, where it has any.
    pub own_colors: bool,
    pub opacity: f32,
    pub casts_shadow: bool,
    pub visible: bool,
    /// Identifier in the picture; several instances may be one object.
    pub object: u32,
    /// Whether light intersects its triangles instead of its field ([`sheets`]).
    pub is_sheet: bool,
}

/// An instance with the data for rays.
pub struct Instance {
    pub triangles: Option<Arc<Triangles>>,
    pub field: Option<Arc<dyn Field>>,
    pub first_material: u32,
    pub own_colors: bool,
    /// Fraction of the background that it hides.
    pub opacity: f32,
    /// Fraction of the light that it blocks.
    pub shade: f32,
    pub casts_shadow: bool,
    pub visible: bool,
    /// Whether a mask depends on colours of vertices or faces, which devices do not read.
    pub has_colored_mask: bool,
    pub object: u32,
    /// Whether light intersects its triangles instead of its field ([`sheets`]).
    pub is_sheet: bool,
    /// Transform from scene space to the local coordinates of the mesh's tree (`Mesh::local_from_world`).
    pub tree_from_scene: DAffine3,
    /// Map of normals from the object's own axes to scene space. Only the direction is used: the largest entry is 1, so
    /// that no length overflows in float32 in any units.
    pub scene_from_normal: Mat3,
    pub field_from_scene: DAffine3,
    /// Map of directions from scene to local space.
    pub local_from_scene: Mat3,
    /// Map of normals from scene to field space. The length of the image of a unit normal is the distance by which a
    /// plane must move to be one voxel away.
    pub field_normal_from_scene: Mat3,
    /// Number of field units in a scene unit along each axis.
    pub field_extent: Vec3,
    /// Smallest and largest number of scene units in a local unit, over the directions.
    pub stretch: [f32; 2],
}

impl Instance {
    /// Its rows of the scene's materials.
    pub fn own_materials<'a>(&self, materials: &'a [Material]) -> &'a [Material] {
        let count = self.triangles.as_ref().map_or(1, |triangles| triangles.material_count());
        &materials[self.first_material as usize..][..count]
    }

    /// Whether distances describe all its effects on light: it is neither translucent nor tested by thin rays.
    pub fn is_opaque_solid(&self) -> bool {
        !self.is_sheet && self.shade >= 1.0 && !self.field.as_ref().is_some_and(|field| field.prefers_rays())
    }

    /// The common opacity of all its materials, if they blend without a texture; else 1.
    fn blend_opacity(&self, materials: &[Material]) -> f32 {
        let of = |material: &Material| match (material.alpha, material.texture) {
            (Alpha::Blend, None) => material.color[3],
            _ => 1.0,
        };
        let first = of(&materials[self.first_material as usize]);
        let is_common = |&material: &u32| of(&materials[(self.first_material + material) as usize]) == first;
        match &self.triangles {
            Some(triangles) if !triangles.used_materials().iter().all(is_common) => 1.0,
            _ => first,
        }
    }

    /// Whether a transform preserves shapes, so that one factor converts local distances to scene distances.
    pub fn is_uniform(&self) -> bool {
        self.stretch[1] <= self.stretch[0] * 1.0001
    }
}

/// A light in world units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Light {
    /// `direction` is that in which the light travels, of any length; `slope` is the tangent of half its angle.
    Directional {
        direction: DVec3,
        color: Vec3,
        slope: f32,
    },
    Point {
        position: DVec3,
        color: Vec3,
        radius: f64,
    },
}

/// Largest number of lights of a scene.
pub const MAX_LIGHTS: usize = 16;

/// Instances, materials and textures, prepared for drawing.
pub struct Scene {
    pub center: DVec3,
    /// Number of world units in a scene unit.
    pub scale: f64,
    pub instances: Vec<Instance>,
    pub materials: Vec<Material>,
    pub textures: Vec<Arc<Texture>>,
    pub tree: Tree,
    /// Scene boxes of the instances.
    pub boxes: Vec<Aabb>,
    pub sheets: Sheets,
    /// A ball around each instance, computed for the first picture with occlusion.
    balls: OnceLock<Vec<Ball>>,
    /// The inputs of the scene, for [`Scene::moved`].
    inputs: Vec<InstanceInput>,
}

/// Method for the first surface of a pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Primary {
    /// Triangles if there are any, else the field.
    #[default]
    Auto,
    Raster,
    Raymarch,
}

/// Kind of shadows.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum SceneShadows {
    None,
    Hard,
    #[default]
    Soft,
    /// This number of rays to each light: the reference for soft shadows.
    Area(u32),
    /// The march of the article, with its constants in world units.
    Article,
}

/// Options of a picture.
#[derive(Debug, Clone)]
pub struct RenderOptions {
    pub size: [u32; 2],
    pub primary: Primary,
    pub shadows: SceneShadows,
    pub lights: Vec<Light>,
    /// Ambient light, as a fraction of a light of colour 1.
    pub ambient: f32,
    /// Range of occlusion of the ambient light, world units; None without occlusion.
    pub occlusion: Option<f64>,
    /// Far field for rays beyond a distance; without it the instances are evaluated everywhere.
    pub far: Option<FarField>,
    /// Linear RGBA of pixels without a hit.
    pub background: [f32; 4],
    pub exposure: f32,
    /// Number of rays per pixel for its colour; 1, or a square number.
    pub samples: u32,
    /// Light is evaluated at every `light_scale`-th pixel along each side: 1 or 2; see [`known`].
    pub light_scale: u32,
}

/// Largest number of instances.
const MAX_INSTANCES: usize = 1 << 24;

impl Scene {
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
        let make = |(i, input)| {
            let mut made = instance(i, input, center, scale, materials.len())?;
            made.shade *= made.blend_opacity(&materials);
            let has_opacity = || made.triangles.as_ref().is_some_and(|triangles| triangles.has_opacity());
            let is_mask = |material: &Material| matches!(material.alpha, Alpha::Mask(_));
            made.has_colored_mask = made.own_materials(&materials).iter().any(is_mask) && has_opacity();
            Ok::<_, Error>(made)
        };
        let instances: Vec<Instance> = inputs.iter().enumerate().map(make).collect::<Result<_, _>>()?;
        let tree = Tree::new(&boxes);
        let sheets = Sheets::new(&instances, &boxes);
        Ok(Self { center, scale, instances, materials, textures, tree, boxes, sheets, balls: OnceLock::new(), inputs })
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

    pub fn scene_from_world(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.scale
    }

    /// A ball around the surface of each instance.
    pub fn balls(&self) -> &[Ball] {
        self.balls.get_or_init(|| Ball::of(&self.instances))
    }

    /// Box around all instances, world units.
    pub fn bounds(&self) -> [DVec3; 2] {
        let all = self.boxes.iter().fold(Aabb::EMPTY, |all, &b| all.union(b));
        [all.min, all.max].map(|corner| self.center + corner.as_dvec3() * self.scale)
    }
}

/// Box of an instance, world units.
fn world_box(index: usize, input: &InstanceInput) -> Result<[DVec3; 2], Error> {
    let (mut lower, mut upper) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut grow = |corners: [DVec3; 2], world_from: DAffine3| {
        for i in 0..8 {
            let pick = |axis: usize| corners[i >> axis & 1][axis];
            let p = world_from.transform_point3(DVec3::new(pick(0), pick(1), pick(2)));
            lower = lower.min(p);
            upper = upper.max(p);
        }
    };
    if let Some(triangles) = &input.triangles {
        grow(triangles.mesh.bounds(), input.world_from_local);
    }
    if let Some(field) = &input.field {
        let corners = field.surface_bounds().map(|corner| corner.as_dvec3());
        grow(corners, input.world_from_local * field.field_from_local().inverse());
    }
    let what = || format!("instances[{index}]");
    if input.triangles.is_none() && input.field.is_none() {
        return Err(SceneError::new(what(), "has neither triangles nor a field").into());
    }
    let extent = (upper - lower).max_element();
    if !(extent.is_finite() && lower.is_finite() && upper.is_finite() && extent < 1e30) {
        return Err(SceneError::new(what(), format!("spans {lower} to {upper}, which is too large to draw")).into());
    }
    Ok([lower, upper])
}

/// Ratio of the largest to the smallest singular value above which a transform counts as singular.
const LARGEST_CONDITION: f64 = 1e9;

fn instance(
    index: usize,
    input: &InstanceInput,
    center: DVec3,
    scale: f64,
    materials: usize,
) -> Result<Instance, Error> {
    let what = || format!("instances[{index}]");
    let world_from_local = input.world_from_local;
    let linear = world_from_local.matrix3;
    let singular = singular_values(linear);
    if !(singular[0] > 0.0 && singular[1].is_finite() && singular[1] / singular[0] < LARGEST_CONDITION) {
        return Err(SceneError::new(what(), "transform cannot be undone: it is singular or not finite").into());
    }
    if !(0.0..=1.0).contains(&input.opacity) {
        return Err(SceneError::new(what(), format!("opacity must lie from 0 to 1, got {}", input.opacity)).into());
    }
    let of_thing = input.triangles.as_ref().map_or(1, |triangles| triangles.material_count());
    if input.first_material as usize + of_thing > materials {
        return Err(SceneError::new(what(), "refers to a material that the scene does not have").into());
    }
    let world_from_scene = DAffine3::from_mat3_translation(DMat3::from_diagonal(DVec3::splat(scale)), center);
    let local_from_scene = world_from_local.inverse() * world_from_scene;
    let tree_from_local = input.triangles.as_ref().map_or(DAffine3::IDENTITY, |triangles| {
        let mesh = &triangles.mesh;
        DAffine3::from_mat3_translation(
            DMat3::from_diagonal(DVec3::splat(1.0 / mesh.scale())),
            -mesh.center() / mesh.scale(),
        )
    });
    let field_from_local = input.field.as_ref().map_or(DAffine3::IDENTITY, |field| field.field_from_local());
    let field_from_scene = field_from_local * local_from_scene;
    let rows = field_from_scene.matrix3.transpose();
    Ok(Instance {
        tree_from_scene: tree_from_local * local_from_scene,
        scene_from_normal: (local_from_scene.matrix3 * (1.0 / largest_entry(local_from_scene.matrix3)))
            .transpose()
            .as_mat3(),
        field_from_scene,
        local_from_scene: local_from_scene.matrix3.as_mat3(),
        field_normal_from_scene: field_from_scene.matrix3.inverse().transpose().as_mat3(),
        field_extent: DVec3::new(rows.x_axis.length(), rows.y_axis.length(), rows.z_axis.length()).as_vec3(),
        stretch: [(singular[0] / scale) as f32, (singular[1] / scale) as f32],
        shade: input.opacity * input.field.as_ref().map_or(1.0, |field| field.opacity()),
        triangles: input.triangles.clone(),
        field: input.field.clone(),
        first_material: input.first_material,
        own_colors: input.own_colors,
        opacity: input.opacity,
        casts_shadow: input.casts_shadow,
        visible: input.visible,
        has_colored_mask: false,
        object: input.object,
        is_sheet: input.is_sheet,
    })
}

/// Largest magnitude of an entry.
fn largest_entry(m: DMat3) -> f64 {
    m.to_cols_array().iter().fold(0.0, |largest, x| largest.max(x.abs()))
}

/// Square of the relative size of an entry beside the diagonal that counts as zero.
const NEGLIGIBLE: f64 = 1e-34;

/// Smallest and largest singular value, by the eigenvalues of `m^T m` (Jacobi rotations).
fn singular_values(m: DMat3) -> [f64; 2] {
    let size = largest_entry(m);
    if !(size > 0.0 && size.is_finite()) {
        return [0.0, size];
    }
    let m = m * (1.0 / size);
    let mut a = (m.transpose() * m).to_cols_array_2d();
    for _ in 0..30 {
        let mut is_done = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            // A smaller entry changes the eigenvalues by less than their rounding.
            if a[p][q] * a[p][q] <= NEGLIGIBLE * a[p][p] * a[q][q] {
                continue;
            }
            is_done = false;
            let theta = 0.5 * (2.0 * a[p][q]).atan2(a[q][q] - a[p][p]);
            let (s, c) = theta.sin_cos();
            let mut turn = DMat3::IDENTITY.to_cols_array_2d();
            (turn[p][p], turn[q][q], turn[p][q], turn[q][p]) = (c, c, -s, s);
            let turn = DMat3::from_cols_array_2d(&turn);
            a = (turn.transpose() * DMat3::from_cols_array_2d(&a) * turn).to_cols_array_2d();
        }
        if is_done {
            break;
        }
    }
    let values = [a[0][0], a[1][1], a[2][2]].map(|value| value.max(0.0).sqrt() * size);
    [values.into_iter().fold(f64::INFINITY, f64::min), values.into_iter().fold(0.0, f64::max)]
}

#[cfg(test)]
mod tests;
