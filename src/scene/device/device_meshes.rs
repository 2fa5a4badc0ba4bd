//! Triangles, materials and masks of a scene in device memory, for [`super::device_raster`].

use crate::error::Error;
use crate::gpu::Context;
use crate::gpu::layout::{RasterMaterial, TextureLevel};
use crate::gpu::table::Table;
use crate::scene::content::material::{Alpha, Material};
use crate::scene::content::model::Scene;
use crate::scene::content::texture::Texture;
use crate::scene::content::triangles::Triangles;
use glam::Vec3;
use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

/// The meshes and masks of a scene in device memory.
pub(crate) struct DeviceMeshes {
    /// Meshes by address, each with its range of corners.
    meshes: HashMap<usize, (Arc<Triangles>, Range<u32>)>,
    geometry: Geometry,
    materials: Table<RasterMaterial>,
    /// Textures of the masks by address, each with its first mip level.
    masks: HashMap<usize, (Arc<Texture>, u32)>,
    /// Levels and texels of the masks, in order of binding.
    texels: [wgpu::Buffer; 2],
}

impl DeviceMeshes {
    pub(crate) fn upload(context: &Context, scene: &Scene) -> Result<Self, Error> {
        let (meshes, geometry) = upload_meshes(context, scene)?;
        let (masks, texels) = upload_masks(context, scene)?;
        let materials = Table::new(context, "scene materials", material_rows(scene, &masks))?;
        Ok(Self { meshes, geometry, materials, masks, texels })
    }

    /// Brings the tables up to date with a scene. The meshes are uploaded again only if one of them is not in memory
    /// yet, and so are the masks. Returns whether buffers were replaced.
    pub(crate) fn update(&mut self, context: &Context, scene: &Scene) -> Result<bool, Error> {
        let mut has_replaced = false;
        if !scene_meshes(scene).all(|triangles| self.meshes.contains_key(&address(triangles))) {
            (self.meshes, self.geometry) = upload_meshes(context, scene)?;
            has_replaced = true;
        }
        if !mask_textures(scene).all(|texture| self.masks.contains_key(&address(texture))) {
            (self.masks, self.texels) = upload_masks(context, scene)?;
            has_replaced = true;
        }
        self.materials.set(context, material_rows(scene, &self.masks))?;
        Ok(has_replaced)
    }

    /// Range of corners of a mesh of the scene.
    pub(crate) fn span(&self, triangles: &Arc<Triangles>) -> Range<u32> {
        self.meshes[&address(triangles)].1.clone()
    }

    /// Three corners and three normals of each face, if they fit into one buffer.
    pub(crate) fn faces(&self) -> Option<&wgpu::Buffer> {
        self.geometry.faces.as_ref()
    }

    pub(crate) fn buffers(&self) -> impl Iterator<Item = &wgpu::Buffer> {
        self.geometry.buffers.iter().chain([self.materials.buffer()]).chain(&self.texels)
    }
}

fn scene_meshes(scene: &Scene) -> impl Iterator<Item = &Arc<Triangles>> {
    scene.instances.iter().filter_map(|instance| instance.triangles.as_ref())
}

/// Textures of the materials with an alpha mask: only they decide visibility.
fn mask_textures(scene: &Scene) -> impl Iterator<Item = &Arc<Texture>> {
    let masks = scene.materials.iter().filter(|material| matches!(material.alpha, Alpha::Mask(_)));
    masks.filter_map(|material| material.texture.map(|texture| &scene.textures[texture as usize]))
}

/// The faces of all meshes.
struct Geometry {
    /// Positions, corners, texture coordinates and materials of faces, in order of binding.
    buffers: [wgpu::Buffer; 4],
    faces: Option<wgpu::Buffer>,
}

type Meshes = HashMap<usize, (Arc<Triangles>, Range<u32>)>;
type Masks = HashMap<usize, (Arc<Texture>, u32)>;

fn upload_meshes(context: &Context, scene: &Scene) -> Result<(Meshes, Geometry), Error> {
    let mut spans = Meshes::new();
    let (mut positions, mut corners, mut coordinates) = (Vec::new(), Vec::new(), Vec::new());
    let mut faces: Vec<[[Vec3; 3]; 2]> = Vec::new();
    let mut face_materials = Vec::new();
    for triangles in scene_meshes(scene) {
        if spans.contains_key(&address(triangles)) {
            continue;
        }
        let (first_vertex, first_corner) = (positions.len() as u32, corners.len() as u32);
        positions.extend(triangles.mesh.positions().iter().map(|p| p.to_array()));
        corners.extend(triangles.mesh.faces().iter().flatten().map(|vertex| first_vertex + vertex));
        coordinates.extend(triangles.uv.iter().map(|uv| uv.to_array()));
        coordinates.resize(positions.len(), [0.0; 2]);
        face_materials.extend_from_slice(&triangles.material);
        let with_normals = |(corners, normals): (&[u32; 3], &[Vec3; 3])| {
            [corners.map(|vertex| triangles.mesh.positions()[vertex as usize]), *normals]
        };
        faces.extend(triangles.mesh.faces().iter().zip(&triangles.normals).map(with_normals));
        spans.insert(address(triangles), (triangles.clone(), first_corner..corners.len() as u32));
    }
    let buffers = [
        context.upload("mesh positions", &positions)?,
        context.upload("mesh corners", &corners)?,
        context.upload("mesh coordinates", &coordinates)?,
        context.upload("mesh materials", &face_materials)?,
    ];
    let fits = size_of_val(&faces[..]) as u64 <= context.max_binding();
    let faces = fits.then(|| context.upload("faces with normals", &faces)).transpose()?;
    Ok((spans, Geometry { buffers, faces }))
}

fn upload_masks(context: &Context, scene: &Scene) -> Result<(Masks, [wgpu::Buffer; 2]), Error> {
    let mut masks = Masks::new();
    let (mut levels, mut texels) = (Vec::new(), Vec::new());
    for texture in mask_textures(scene) {
        if masks.contains_key(&address(texture)) {
            continue;
        }
        masks.insert(address(texture), (texture.clone(), levels.len() as u32));
        let first = texels.len() as u32;
        levels.extend(texture.levels.iter().map(|level| TextureLevel {
            first: first + level.first,
            width: level.width,
            height: level.height,
            pad_0: 0,
        }));
        texels.extend_from_slice(&texture.texels);
    }
    Ok((masks, [context.upload("texture levels", &levels)?, context.upload("texels", &texels)?]))
}

/// Key of a shared object: its address. Callers keep the object beside the key, so that no other object gets the
/// address.
fn address<T>(object: &Arc<T>) -> usize {
    Arc::as_ptr(object).addr()
}

fn material_rows(scene: &Scene, masks: &Masks) -> Vec<RasterMaterial> {
    let row = |material: &Material| {
        let mut row = RasterMaterial {
            two_sided: u32::from(material.two_sided),
            opacity: material.color[3],
            ..RasterMaterial::default()
        };
        match material.alpha {
            Alpha::Blend => {}
            Alpha::Opaque => row.kind = 1,
            Alpha::Mask(cutoff) => {
                (row.kind, row.cutoff) = (2, cutoff);
                if let Some(texture) = material.texture.map(|texture| &scene.textures[texture as usize]) {
                    row.first_level = masks[&address(texture)].1;
                    row.levels = texture.levels.len() as u32;
                }
            }
        }
        row
    };
    scene.materials.iter().map(row).collect()
}
