//! The appearance of surfaces at hits of rays: colour, emission and normal.

use crate::scene::content::instance::Instance;
use crate::scene::content::material::{Alpha, Material};
use crate::scene::content::model::Scene;
use crate::scene::content::triangles::Triangles;
use crate::scene::fields::field::SurfaceAppearance;
use glam::{Vec3, Vec4};

/// A point on a face of an instance with triangles.
pub(crate) struct FaceAppearance<'a> {
    scene: &'a Scene,
    instance: &'a Instance,
    triangles: &'a Triangles,
    face: u32,
    /// Weights of the face's corners.
    weights: [f32; 3],
}

impl<'a> FaceAppearance<'a> {
    pub(crate) fn new(
        scene: &'a Scene,
        instance: &'a Instance,
        triangles: &'a Triangles,
        face: u32,
        weights: [f64; 3],
    ) -> Self {
        Self { scene, instance, triangles, face, weights: weights.map(|w| w as f32) }
    }

    /// Index of its material in the scene's list.
    pub(crate) fn material_index(&self) -> u32 {
        self.instance.first_material + self.triangles.material[self.face as usize]
    }

    pub(crate) fn material(&self) -> &'a Material {
        &self.scene.materials[self.material_index() as usize]
    }

    /// Linear RGB and opacity. Textures are averaged over a square of the side `footprint`, in units of the mesh's
    /// tree.
    pub(crate) fn color(&self, footprint: impl FnOnce() -> f64) -> Vec4 {
        let material = self.material();
        let factor = Vec4::from_array(material.color) * self.triangles.color_at(self.face, self.weights);
        match material.texture {
            None => factor,
            Some(texture) => factor * self.texel(texture, footprint()),
        }
    }

    /// Opacity without the factor of the instance. A translucent solid is one layer: a ray counts where it enters.
    pub(crate) fn opacity(&self, is_front: bool) -> f32 {
        let material = self.material();
        let alpha = || {
            let texture = material.texture.map(|texture| &self.scene.textures[texture as usize]);
            let uv = || self.triangles.uv_at(self.face, self.weights);
            material.color[3] * texture.map_or(1.0, |texture| texture.opacity(uv()))
        };
        match material.alpha {
            Alpha::Opaque => 1.0,
            Alpha::Mask(cutoff) => f32::from(u8::from(alpha() >= cutoff)),
            Alpha::Blend if !material.two_sided && !is_front && self.triangles.mesh.topology().closed => 0.0,
            Alpha::Blend => alpha().clamp(0.0, 1.0),
        }
    }

    /// Linear RGB that the front emits; see [`Self::color`].
    pub(crate) fn emission(&self, footprint: impl FnOnce() -> f64) -> Vec3 {
        let material = self.material();
        let factor = Vec3::from_array(material.emission);
        match material.emission_texture {
            Some(texture) if factor != Vec3::ZERO => factor * self.texel(texture, footprint()).truncate(),
            _ => factor,
        }
    }

    /// Linear RGB and opacity of a texture.
    fn texel(&self, texture: u32, footprint: f64) -> Vec4 {
        let uv = self.triangles.uv_at(self.face, self.weights);
        let footprint = footprint as f32 * self.triangles.uv_density(self.face);
        self.scene.textures[texture as usize].sample(uv, footprint)
    }

    /// The smooth normal on the side from which a ray comes. At a silhouette it may point along the ray; the normal of
    /// the face is used there.
    pub(crate) fn normal_toward(&self, direction: Vec3, is_front: bool) -> Vec3 {
        let to_scene = self.instance.scene_from_normal;
        let on_side = |normal: Vec3| if is_front { normal } else { -normal };
        let normal = on_side((to_scene * self.triangles.normal_at(self.face, self.weights)).normalize_or_zero());
        if normal.dot(direction) < 0.0 {
            return normal;
        }
        let [a, b, c] = self.triangles.mesh.triangle(self.face);
        on_side((to_scene * (b - a).cross(c - a).normalize_or_zero().as_vec3()).normalize_or_zero())
    }
}

/// Linear RGB of a field at a hit.
pub(crate) fn field_color(instance: &Instance, material: &Material, appearance: &SurfaceAppearance) -> Vec3 {
    let own = appearance.color.filter(|_| instance.own_colors);
    Vec3::from_array(own.unwrap_or([material.color[0], material.color[1], material.color[2]]))
}

/// Linear RGB that a field emits. Fields have no texture coordinates.
pub(crate) fn field_emission(material: &Material) -> Vec3 {
    if material.emission_texture.is_none() { Vec3::from_array(material.emission) } else { Vec3::ZERO }
}
