//! The structs compared with the shaders that read them.

use super::*;
use crate::gpu::tests::source;
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
            rays,
            shape,
            band_start,
            color,
            band_end,
            relative_spacing,
            ambient,
            background,
            specular,
            shininess,
            pad_0,
            pad_1
        }
    );
    assert_twin!(
        "field_to_texture",
        TextureParams { width, height, first_plane, planes, words_per_row, per_voxel, workgroups_across, pad_0 }
    );
    assert_twin!("raymarch", Light { direction, pad_0, color, pad_1 });
    assert_twin!("raymarch", Pixel { color, normal, depth, steps, is_hit, pad_0, pad_1 });
    assert_twin!("raymarch_encoded", StoredParams { encoding, scale, pad_0, pad_1 });
    assert_twin!("raymarch_nested", NestedLevel { shape, first_sample, offset, scale });
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
            field,
            normal_y,
            casts_shadow,
            normal_z,
            voxel,
            box_min,
            prefers_rays,
            box_max,
            pad_1,
            surface_lower,
            surface_radius,
            surface_upper,
            pad_2,
            field_extent,
            pad_3
        }
    );
    assert_twin!("scene_beams", SceneField { shape, first_sample, spacing, first_block, blocks, kind });
    assert_twin!(
        "scene_beams",
        Beam { p, t_max, direction, slope, normal, bias_voxels, own, is_coarse, skips_own, pad_0 }
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
            scale_exponent
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
