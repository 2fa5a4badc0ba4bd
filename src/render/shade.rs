//! Colour of a hit: the reflection of directional lights and ambient light, with hard shadows.
//!
//! The normal is the gradient of the trilinear field averaged over a voxel around the hit (a central difference of half
//! a voxel is that average along its axis), transformed to world space, so it is right for oblong voxels. The gradient
//! at the point itself jumps from cell to cell and would show the grid on every smooth surface; the average is
//! continuous. Where the ray enters the solid through a face of the box, the visible surface is the cut, and it has the
//! normal of the face.
//!
//! A shadow ray is traced like any other ([`crate::march::marcher`]). It starts [`crate::picture::Filter::bias_voxels`]
//! above the surface, along the normal. The bias is in voxels, because it must clear the facets of the trilinear
//! surface, which have the size of a voxel. A side that faces away from a light receives none of it.

use crate::march::blocks::Blocks;
use crate::march::marcher::{Marcher, clip_to_box, each_axis, floor};
use crate::picture::{DirectionalLight, LitPoint, RaymarchOptions, Shadows};
use crate::volume::trilinear;
use glam::{DVec3, IVec3, Vec3};

/// Intersection of the ray of a pixel with the surface.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelHit {
    pub p_grid: Vec3,
    /// Unit normal in world space, outward.
    pub normal: Vec3,
    /// Unit direction towards the eye, world space.
    pub to_eye: Vec3,
}

/// Linear RGB of a surface under lights with unit directions. Writes the fraction of each light that arrives; for hard
/// shadows `share_that_arrives` computes it.
pub(crate) fn lit(
    point: &LitPoint,
    options: &RaymarchOptions,
    lights: &[DirectionalLight],
    shadow: &mut [f32],
    mut share_that_arrives: impl FnMut(Vec3) -> f32,
) -> Vec3 {
    let mut color = options.ambient * point.color;
    for (light, share) in lights.iter().zip(shadow) {
        let to_light = -light.direction;
        *share = match options.shadows {
            Shadows::None => 1.0,
            Shadows::Hard => share_that_arrives(to_light),
        };
        if *share > 0.0 {
            color += *share * light.color * point.reflected(to_light);
        }
    }
    color
}

/// Data shared by all pixels.
#[derive(Debug, Clone)]
pub(super) struct Shader<'a, F: Blocks> {
    marcher: &'a Marcher<F>,
    options: &'a RaymarchOptions,
    lights: &'a [DirectionalLight],
    shape: DVec3,
    /// Upper corner of the box in grid space.
    last_point: Vec3,
    /// Voxel size divided by its smallest side. A scale of the world cancels in all formulas below.
    relative_spacing: Vec3,
}

impl<'a, F: Blocks> Shader<'a, F> {
    /// `lights` must have unit directions.
    pub(super) fn new(marcher: &'a Marcher<F>, options: &'a RaymarchOptions, lights: &'a [DirectionalLight]) -> Self {
        let spacing = marcher.field.grid().spacing();
        Self {
            marcher,
            options,
            lights,
            shape: marcher.field.shape(),
            last_point: (marcher.field.shape() - 0.5).as_vec3(),
            relative_spacing: (spacing / spacing.min_element()).as_vec3(),
        }
    }

    /// World normal at a hit. Returns `fallback` where the gradient is zero.
    pub(super) fn normal(&self, p_grid: Vec3, fallback: Vec3) -> Vec3 {
        let across = |half: Vec3| self.field_at(p_grid + half) - self.field_at(p_grid - half);
        let per_voxel = Vec3::new(across(0.5 * Vec3::X), across(0.5 * Vec3::Y), across(0.5 * Vec3::Z));
        // Dividing by the largest component first keeps squares in the range of f32.
        let largest = per_voxel.abs().max_element();
        if largest == 0.0 {
            return fallback;
        }
        (per_voxel / largest / self.relative_spacing).normalize_or(fallback)
    }

    /// The trilinear field at a point of grid space.
    fn field_at(&self, p_grid: Vec3) -> f32 {
        let p_grid = p_grid.clamp(Vec3::splat(-0.5), self.last_point);
        let cell = self.marcher.field.cell(IVec3::from(each_axis(|axis| floor(p_grid[axis]))));
        // The difference from the first corner is exact between samples.
        trilinear(&cell.corners, (p_grid - cell.first.as_vec3()) / cell.size as f32)
    }

    /// Linear RGB of a surface. Writes the fraction of each light that arrives.
    pub(super) fn shade(&self, surface: &PixelHit, shadow: &mut [f32]) -> Vec3 {
        let point = self.options.lit_point(surface.normal, surface.to_eye, self.options.color);
        lit(&point, self.options, self.lights, shadow, |to_light| self.share_that_arrives(surface, to_light))
    }

    /// 0 if the field occludes the light, else 1.
    fn share_that_arrives(&self, surface: &PixelHit, to_light: Vec3) -> f32 {
        if surface.normal.dot(to_light) <= 0.0 {
            return 0.0;
        }
        // The bias is the extent of a voxel along the normal.
        let voxel = (surface.normal * self.relative_spacing).length();
        let bias = self.options.filter.bias_voxels() * voxel * surface.normal / self.relative_spacing;
        let origin = surface.p_grid + bias;
        let direction = to_light / self.relative_spacing;
        match clip_to_box(origin.as_dvec3(), direction.as_dvec3(), self.shape) {
            Some(clipped) if self.marcher.trace(&clipped.ray, self.options.filter).hit.is_some() => 0.0,
            _ => 1.0,
        }
    }
}
