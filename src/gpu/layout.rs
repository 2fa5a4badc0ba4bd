//! Structs that cross the border, each the twin of the WGSL struct of the same name.
//!
//! Fields are ordered so that no padding is needed: a three-component vector is followed by a scalar. A test parses
//! the WGSL and compares names, offsets and sizes.

use bytemuck::{Pod, Zeroable};

/// A node of the binary tree; `shaders/shared/bvh.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Node {
    pub left_min: [f32; 3],
    /// A child: the index of a node, or a leaf (see `bvh::binary`).
    pub left: u32,
    pub left_max: [f32; 3],
    pub right: u32,
    pub right_min: [f32; 3],
    pub pad_0: u32,
    pub right_max: [f32; 3],
    pub pad_1: u32,
}

/// A triangle in its own frame; `shaders/shared/triangle.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Triangle {
    pub a: [f32; 3],
    pub face: u32,
    pub u: [f32; 3],
    pub length: f32,
    pub v: [f32; 3],
    pub left_length: f32,
    pub n: [f32; 3],
    pub right_length: f32,
    pub left: [f32; 2],
    pub right: [f32; 2],
}

/// `shaders/atlas_pack.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PackParams {
    pub corner: [u32; 2],
    pub tile: [u32; 2],
    pub shape: [u32; 3],
    pub gutter: u32,
    pub columns: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub row_words: u32,
    pub word_texels: u32,
    pub steps: u32,
    pub scale: f32,
    pub pad_0: u32,
}

/// `shaders/bake_distance.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct DistanceParams {
    pub shape: [u32; 3],
    pub first_block: u32,
    pub coarse_shape: [u32; 3],
    pub stride: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub pad_0: u32,
    pub limit_squared: f32,
}

/// `shaders/bake_finish.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct FinishParams {
    pub shape: [u32; 3],
    pub first_plane: u32,
    pub coarse_shape: [u32; 3],
    pub planes: u32,
    pub spacing_squared: [f32; 3],
    pub scale: f32,
    pub width: f32,
    pub half_thickness: f32,
    pub words_per_row: u32,
    pub stride: u32,
}

/// `shaders/bake_brute.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BruteParams {
    pub shape: [u32; 3],
    pub first_triangle: u32,
    pub triangle_count: u32,
    pub first_sample: u32,
    pub sample_count: u32,
    pub sign_rule: u32,
}

/// What a sample of the brute-force bake knows so far; `shaders/bake_brute.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BruteState {
    pub squared: f32,
    pub nudged_squared: f32,
    pub behind: u32,
    pub crossings: u32,
}

/// `shaders/query_points.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QueryParams {
    pub first: u32,
    pub count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/field_to_texture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TextureParams {
    pub width: u32,
    pub height: u32,
    pub first_plane: u32,
    pub planes: u32,
    pub words_per_row: u32,
    pub per_voxel: f32,
    pub workgroups_across: u32,
    pub pad_0: u32,
}

/// `shaders/shared/picture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MarchParams {
    pub shape: [u32; 3],
    pub light_count: u32,
    pub start: [f32; 3],
    pub width: u32,
    pub start_right: [f32; 3],
    pub height: u32,
    pub start_up: [f32; 3],
    pub first_row: u32,
    pub forward: [f32; 3],
    pub ambient: f32,
    pub right: [f32; 3],
    pub specular: f32,
    pub up: [f32; 3],
    pub shininess: f32,
    pub world_forward: [f32; 3],
    pub pixel: f32,
    pub world_right: [f32; 3],
    pub shadows: u32,
    pub world_up: [f32; 3],
    pub band_start: u32,
    pub color: [f32; 3],
    pub band_end: u32,
    pub relative_spacing: [f32; 3],
    pub pad_0: u32,
    pub background: [f32; 4],
}

/// `shaders/shared/samples_encoded.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct StoredParams {
    pub encoding: u32,
    pub scale: f32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/bricks.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SparseParams {
    pub bricks: [u32; 3],
    pub floor: f32,
    pub node_step: [f32; 3],
    pub longest_step: f32,
}

/// `shaders/shared/light.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Light {
    pub direction: [f32; 3],
    pub pad_0: u32,
    pub color: [f32; 3],
    pub pad_1: u32,
}

/// `shaders/shared/picture.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Pixel {
    pub color: [f32; 4],
    pub normal: [f32; 3],
    pub depth: f32,
    pub steps: u32,
    pub is_hit: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// A node of the tree over a scene's instances; `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct SceneNode {
    pub min: [f32; 3],
    /// First item of a leaf, or left child; the right one follows it.
    pub first: u32,
    pub max: [f32; 3],
    /// Items of a leaf; 0 for an inner node.
    pub count: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SceneInstance {
    pub field_x: [f32; 4],
    pub field_y: [f32; 4],
    pub field_z: [f32; 4],
    pub local_x: [f32; 3],
    pub opacity: f32,
    pub local_y: [f32; 3],
    pub least_stretch: f32,
    pub local_z: [f32; 3],
    pub largest_stretch: f32,
    pub normal_x: [f32; 3],
    pub grid: u32,
    pub normal_y: [f32; 3],
    pub casts_shadow: u32,
    pub normal_z: [f32; 3],
    pub voxel: f32,
    pub box_min: [f32; 3],
    pub pad_1: u32,
    pub box_max: [f32; 3],
    pub pad_2: u32,
    pub surface_lower: [f32; 3],
    pub pad_3: u32,
    pub surface_upper: [f32; 3],
    pub pad_4: u32,
    pub field_extent: [f32; 3],
    pub pad_5: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct SceneGrid {
    pub shape: [u32; 3],
    pub first_sample: u32,
    pub spacing: [f32; 3],
    pub first_block: u32,
    pub blocks: [u32; 3],
    pub pad_0: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Beam {
    pub p: [f32; 3],
    pub t_max: f32,
    pub direction: [f32; 3],
    pub slope: f32,
    pub normal: [f32; 3],
    pub bias_voxels: f32,
    pub own: u32,
    pub is_coarse: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct Answer {
    pub value: f32,
    pub is_proven: u32,
    pub steps: u32,
    pub is_complete: u32,
    pub is_far: u32,
}

/// `shaders/scene_beams.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct BeamParams {
    pub first: u32,
    pub count: u32,
    pub far: u32,
    pub far_levels: u32,
    pub far_holds_all: u32,
    pub far_distance: f32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/scene_view.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RasterInstance {
    pub clip_x: [f32; 4],
    pub clip_y: [f32; 4],
    pub clip_w: [f32; 4],
    pub eye: [f32; 3],
    pub index: u32,
    pub ray: [f32; 3],
    pub first_face: u32,
    pub ray_x: [f32; 3],
    pub first_material: u32,
    pub ray_y: [f32; 3],
    pub is_mirrored: u32,
    pub middle: [f32; 2],
    pub pixel: f32,
    pub pad_0: u32,
}

/// `shaders/scene_triangles.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct RasterMaterial {
    pub kind: u32,
    pub two_sided: u32,
    pub cutoff: f32,
    pub opacity: f32,
    pub first_level: u32,
    pub levels: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/scene_triangles.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct TextureLevel {
    pub first: u32,
    pub width: u32,
    pub height: u32,
    pub pad_0: u32,
}

/// A node of the tree over placed fields; `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeNode {
    pub min: [f32; 3],
    pub first: u32,
    pub max: [f32; 3],
    pub count: u32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeField {
    pub row_x: [f32; 4],
    pub row_y: [f32; 4],
    pub row_z: [f32; 4],
    pub center: [f32; 3],
    pub grid: u32,
    pub lower: [f32; 3],
    pub sigma_min: f32,
    pub upper: [f32; 3],
    pub sigma_max: f32,
    pub inner_lower: [f32; 3],
    pub error: f32,
    pub inner_upper: [f32; 3],
    pub is_known: u32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeGrid {
    pub shape: [u32; 3],
    pub first_sample: u32,
    pub spacing: [f32; 3],
    pub inverse_unit: f32,
}

/// `shaders/merge_owners.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct MergeParams {
    pub shape: [u32; 3],
    pub first: u32,
    pub first_plane: u32,
    pub count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/shared/picture_rays.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct PictureRays {
    pub start: [f32; 3],
    pub width: u32,
    pub start_right: [f32; 3],
    pub height: u32,
    pub start_up: [f32; 3],
    pub first_row: u32,
    pub forward: [f32; 3],
    pub pixel: f32,
    pub right: [f32; 3],
    pub light_count: u32,
    pub up: [f32; 3],
    pub shadows: u32,
}

/// `shaders/quadrics.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QuadricParams {
    pub rays: PictureRays,
    pub background: [f32; 4],
    pub ambient: f32,
    pub specular: f32,
    pub shininess: f32,
    pub quadric_count: u32,
    pub node_count: u32,
    pub texels_per_row: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/quadrics.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct QuadricPixel {
    pub color: [f32; 4],
    pub normal: [f32; 3],
    pub depth: f32,
    pub quadric: u32,
    pub steps: u32,
    pub state: u32,
    pub pad_0: u32,
}

/// A placed leaf or warp; `shaders/shared/csg_interpreter.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgLeaf {
    pub row_x: [f32; 3],
    pub shift_x: f32,
    pub row_y: [f32; 3],
    pub shift_y: f32,
    pub row_z: [f32; 3],
    pub shift_z: f32,
    pub a: [f32; 4],
    pub b: [f32; 2],
    pub kind: u32,
    pub first: u32,
}

/// `shaders/csg_points.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgPointParams {
    pub first: u32,
    pub count: u32,
    pub token_count: u32,
    pub pad_0: u32,
}

/// `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgDrawParams {
    pub rays: PictureRays,
    pub inverse_lipschitz: f32,
    pub node_count: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// A node or a box; `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgBox {
    pub lower: [f32; 3],
    pub first: u32,
    pub upper: [f32; 3],
    pub count: u32,
    pub form: u32,
    pub parameters: u32,
    pub pad_0: u32,
    pub pad_1: u32,
}

/// `shaders/csg_draw.wgsl`.
#[derive(Debug, Clone, Copy, Default, Pod, Zeroable)]
#[repr(C)]
pub struct CsgPixel {
    pub normal: [f32; 3],
    pub t: f32,
    pub cell: u32,
    pub state: u32,
    pub steps: u32,
    pub tokens: u32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::shader::source;
    use std::mem::offset_of;
    use wgpu::naga;

    /// Names and offsets of a WGSL struct, and its size.
    fn wgsl_struct(kernel: &str, name: &str) -> (Vec<(String, u32)>, u32) {
        let module = naga::front::wgsl::parse_str(&source(kernel).unwrap()).unwrap();
        let (_, ty) = module.types.iter().find(|(_, ty)| ty.name.as_deref() == Some(name)).unwrap();
        let naga::TypeInner::Struct { members, span } = &ty.inner else { panic!("{name} is not a struct") };
        (members.iter().map(|m| (m.name.clone().unwrap(), m.offset)).collect(), *span)
    }

    macro_rules! assert_twin {
        ($kernel:literal, $name:ident { $($field:ident),* }) => {
            let (members, span) = wgsl_struct($kernel, stringify!($name));
            let ours = vec![$((stringify!($field).to_owned(), offset_of!($name, $field) as u32)),*];
            assert_eq!((members, span), (ours, size_of::<$name>() as u32), stringify!($name));
        };
    }

    #[test]
    fn structs_have_the_layout_that_the_shaders_read() {
        assert_twin!("bake_distance", Node { left_min, left, left_max, right, right_min, pad_0, right_max, pad_1 });
        assert_twin!("bake_distance", Triangle { a, face, u, length, v, left_length, n, right_length, left, right });
        assert_twin!(
            "bake_distance",
            DistanceParams { shape, first_block, coarse_shape, stride, first_plane, planes, pad_0, limit_squared }
        );
        assert_twin!(
            "bake_finish",
            FinishParams {
                shape,
                first_plane,
                coarse_shape,
                planes,
                spacing_squared,
                scale,
                width,
                half_thickness,
                words_per_row,
                stride
            }
        );
        assert_twin!(
            "bake_brute",
            BruteParams { shape, first_triangle, triangle_count, first_sample, sample_count, sign_rule }
        );
        assert_twin!("bake_brute", BruteState { squared, nudged_squared, behind, crossings });
        assert_twin!(
            "raymarch",
            MarchParams {
                shape,
                light_count,
                start,
                width,
                start_right,
                height,
                start_up,
                first_row,
                forward,
                ambient,
                right,
                specular,
                up,
                shininess,
                world_forward,
                pixel,
                world_right,
                shadows,
                world_up,
                band_start,
                color,
                band_end,
                relative_spacing,
                pad_0,
                background
            }
        );
        assert_twin!(
            "field_to_texture",
            TextureParams { width, height, first_plane, planes, words_per_row, per_voxel, workgroups_across, pad_0 }
        );
        assert_twin!("raymarch", Light { direction, pad_0, color, pad_1 });
        assert_twin!("raymarch", Pixel { color, normal, depth, steps, is_hit, pad_0, pad_1 });
        assert_twin!("raymarch_encoded", StoredParams { encoding, scale, pad_0, pad_1 });
        assert_twin!("raymarch_sparse", SparseParams { bricks, floor, node_step, longest_step });
        assert_twin!("scene_beams", SceneNode { min, first, max, count });
        assert_twin!(
            "scene_beams",
            SceneInstance {
                field_x,
                field_y,
                field_z,
                local_x,
                opacity,
                local_y,
                least_stretch,
                local_z,
                largest_stretch,
                normal_x,
                grid,
                normal_y,
                casts_shadow,
                normal_z,
                voxel,
                box_min,
                pad_1,
                box_max,
                pad_2,
                surface_lower,
                pad_3,
                surface_upper,
                pad_4,
                field_extent,
                pad_5
            }
        );
        assert_twin!("scene_beams", SceneGrid { shape, first_sample, spacing, first_block, blocks, pad_0 });
        assert_twin!(
            "scene_beams",
            Beam { p, t_max, direction, slope, normal, bias_voxels, own, is_coarse, pad_0, pad_1 }
        );
        assert_twin!("scene_beams", Answer { value, is_proven, steps, is_complete, is_far });
        assert_twin!(
            "scene_beams",
            BeamParams { first, count, far, far_levels, far_holds_all, far_distance, pad_0, pad_1 }
        );
        assert_twin!(
            "scene_fields",
            RasterInstance {
                clip_x,
                clip_y,
                clip_w,
                eye,
                index,
                ray,
                first_face,
                ray_x,
                first_material,
                ray_y,
                is_mirrored,
                middle,
                pixel,
                pad_0
            }
        );
        assert_twin!(
            "scene_triangles",
            RasterMaterial { kind, two_sided, cutoff, opacity, first_level, levels, pad_0, pad_1 }
        );
        assert_twin!("scene_triangles", TextureLevel { first, width, height, pad_0 });
        assert_twin!(
            "atlas_pack",
            PackParams {
                corner,
                tile,
                shape,
                gutter,
                columns,
                first_plane,
                planes,
                row_words,
                word_texels,
                steps,
                scale,
                pad_0
            }
        );
        assert_twin!("merge_owners", MergeNode { min, first, max, count });
        assert_twin!(
            "merge_owners",
            MergeField {
                row_x,
                row_y,
                row_z,
                center,
                grid,
                lower,
                sigma_min,
                upper,
                sigma_max,
                inner_lower,
                error,
                inner_upper,
                is_known
            }
        );
        assert_twin!("merge_owners", MergeGrid { shape, first_sample, spacing, inverse_unit });
        assert_twin!("merge_owners", MergeParams { shape, first, first_plane, count, pad_0, pad_1 });
        assert_twin!(
            "quadrics",
            QuadricParams {
                rays,
                background,
                ambient,
                specular,
                shininess,
                quadric_count,
                node_count,
                texels_per_row,
                pad_0,
                pad_1
            }
        );
        assert_twin!("quadrics", QuadricPixel { color, normal, depth, quadric, steps, state, pad_0 });
        assert_twin!("csg_points", CsgLeaf { row_x, shift_x, row_y, shift_y, row_z, shift_z, a, b, kind, first });
        assert_twin!("csg_points", CsgPointParams { first, count, token_count, pad_0 });
        assert_twin!("csg_draw", CsgDrawParams { rays, inverse_lipschitz, node_count, pad_0, pad_1 });
        assert_twin!(
            "csg_draw",
            PictureRays {
                start,
                width,
                start_right,
                height,
                start_up,
                first_row,
                forward,
                pixel,
                right,
                light_count,
                up,
                shadows
            }
        );
        assert_twin!("csg_draw", CsgBox { lower, first, upper, count, form, parameters, pad_0, pad_1 });
        assert_twin!("csg_draw", CsgPixel { normal, t, cell, state, steps, tokens });
        assert_twin!("query_points", QueryParams { first, count, pad_0, pad_1 });
    }
}
