//! Instances: objects under affine transforms.

use super::material::{Alpha, Material};
use super::triangles::Triangles;
use crate::error::{Error, SceneError};
use crate::scene::fields::field::Field;
use glam::{DAffine3, DMat3, DVec3, Mat3, Vec3};
use std::sync::Arc;

/// An object and its transform, from the caller.
#[derive(Clone)]
pub struct InstanceInput {
    /// Its triangles, if it is a mesh.
    pub triangles: Option<Arc<Triangles>>,
    /// Its distances, if it casts shadows or has no triangles.
    pub field: Option<Arc<dyn Field>>,
    /// Transform of the object.
    pub world_from_local: DAffine3,
    /// Index of the first of the object's materials in the scene's list.
    pub first_material: u32,
    /// Whether the object's own colours replace the material's, where it has any.
    pub own_colors: bool,
    /// Fraction of the background that it hides.
    pub opacity: f32,
    /// Whether it blocks light.
    pub casts_shadow: bool,
    /// Whether it is visible to the camera.
    pub visible: bool,
    /// Identifier in the picture; several instances may be one object.
    pub object: u32,
    /// Whether cones of light intersect its triangles instead of its field ([`crate::scene::light::past_sheets`]).
    pub is_sheet: bool,
    /// Whether it blocks its fraction of the light once, however many of its faces a ray crosses.
    pub is_solid: bool,
}

/// An instance with the data for rays.
pub struct Instance {
    /// Its triangles, if it is a mesh.
    pub triangles: Option<Arc<Triangles>>,
    /// Its distances, if it casts shadows or has no triangles.
    pub field: Option<Arc<dyn Field>>,
    /// Index of the first of the object's materials in the scene's list.
    pub first_material: u32,
    /// Whether the object's own colours replace the material's, where it has any.
    pub own_colors: bool,
    /// Fraction of the background that it hides.
    pub opacity: f32,
    /// Fraction of the light that it blocks.
    pub shade: f32,
    /// Whether it blocks light.
    pub casts_shadow: bool,
    /// Whether it is visible to the camera.
    pub visible: bool,
    /// Whether a mask depends on colours of vertices or faces, which devices do not read.
    pub has_colored_mask: bool,
    /// Identifier in the picture.
    pub object: u32,
    /// Whether cones of light intersect its triangles instead of its field ([`crate::scene::light::past_sheets`]).
    pub is_sheet: bool,
    /// Fraction of the light that a ray loses if it hits any of its faces; None if that depends on the hits.
    pub face_shade: Option<f32>,
    /// Transform from scene space to the local coordinates of the mesh's tree (`Mesh::local_from_world`).
    pub tree_from_scene: DAffine3,
    /// Map of normals from the object's own axes to scene space. Only the direction is used: the largest entry is 1, so
    /// that no length overflows in float32 in any units.
    pub scene_from_normal: Mat3,
    /// Transform from scene space to the space of its field.
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
    /// Prepares instance `index` for the scene space of a centre and a scale in world units. The transform must be
    /// invertible, and the materials must exist.
    pub(crate) fn new(
        index: usize,
        input: &InstanceInput,
        center: DVec3,
        scale: f64,
        materials: &[Material],
    ) -> Result<Self, Error> {
        let mut made = Self::placed(index, input, center, scale, materials.len())?;
        made.shade *= made.blend_opacity(materials);
        let has_opacity = || made.triangles.as_ref().is_some_and(|triangles| triangles.has_opacity());
        let is_mask = |material: &Material| matches!(material.alpha, Alpha::Mask(_));
        let is_opaque = |material: &Material| matches!(material.alpha, Alpha::Opaque);
        let is_plain = made.opacity >= 1.0 && made.own_materials(materials).iter().all(is_opaque);
        made.face_shade = (input.is_solid || is_plain).then_some(made.shade);
        made.has_colored_mask = made.own_materials(materials).iter().any(is_mask) && has_opacity();
        Ok(made)
    }

    /// As [`Instance::new`], without the opacity of materials; `material_count` is the length of the scene's list.
    pub(crate) fn placed(
        index: usize,
        input: &InstanceInput,
        center: DVec3,
        scale: f64,
        material_count: usize,
    ) -> Result<Self, Error> {
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
        let own_count = input.triangles.as_ref().map_or(1, |triangles| triangles.material_count());
        if input.first_material as usize + own_count > material_count {
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
        Ok(Self {
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
            face_shade: None,
            object: input.object,
            is_sheet: input.is_sheet,
        })
    }

    /// Its rows of the scene's materials.
    pub fn own_materials<'a>(&self, materials: &'a [Material]) -> &'a [Material] {
        let count = self.triangles.as_ref().map_or(1, |triangles| triangles.material_count());
        &materials[self.first_material as usize..][..count]
    }

    /// The triangles that rays of light intersect: the triangles of a mesh that blocks light.
    pub fn casting_triangles(&self) -> Option<&Triangles> {
        self.triangles.as_deref().filter(|_| self.casts_shadow && self.opacity > 0.0)
    }

    /// The field that cones of light intersect, if it blocks light.
    pub fn casting_field(&self) -> Option<&dyn Field> {
        self.field.as_deref().filter(|_| !self.is_sheet && self.casts_shadow && self.shade > 0.0)
    }

    /// Whether rays of light intersect its field, because it has no triangles.
    pub fn casts_by_field(&self) -> bool {
        self.casting_triangles().is_none() && self.casting_field().is_some()
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

/// Box of an instance, world units.
pub(crate) fn world_box(index: usize, input: &InstanceInput) -> Result<[DVec3; 2], Error> {
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

/// Largest magnitude of an entry.
fn largest_entry(m: DMat3) -> f64 {
    m.to_cols_array().iter().fold(0.0, |largest, x| largest.max(x.abs()))
}

/// Square of the relative size of an entry beside the diagonal that counts as zero.
const NEGLIGIBLE: f64 = 1e-34;

/// Smallest and largest singular value, by the eigenvalues of `m^T m` (Jacobi rotations).
pub(crate) fn singular_values(m: DMat3) -> [f64; 2] {
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
