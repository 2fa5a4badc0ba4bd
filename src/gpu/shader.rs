//! WGSL sources and the rule for joining them.
//!
//! A file in `shaders/` is plain WGSL, except that a line `#import name` is replaced by the text of the file NAME of
//! `shaders/shared/` and of its own imports, each once, before the file that needs it. Names are not mangled: the
//! joined text is readable, is the text that the driver compiles, and can be pasted into another WebGPU program.

use super::constants::declarations;
use std::borrow::Cow;
use std::fmt::Write;
use std::sync::LazyLock;

/// Every kernel by name, and its file.
pub(crate) const KERNELS: &[(&str, &str)] = &[
    ("atlas_pack", include_str!("../../shaders/atlas/atlas_pack.wgsl")),
    ("bake_brute", include_str!("../../shaders/mesh/bake_brute.wgsl")),
    ("bake_distance", include_str!("../../shaders/mesh/bake_distance.wgsl")),
    ("bake_finish", include_str!("../../shaders/mesh/bake_finish.wgsl")),
    ("cast_rays", include_str!("../../shaders/mesh/cast_rays.wgsl")),
    ("field_cells", include_str!("../../shaders/field/field_cells.wgsl")),
    ("merge_owners", include_str!("../../shaders/field/merge_owners.wgsl")),
    ("csg_draw", include_str!("../../shaders/csg/csg_draw.wgsl")),
    ("csg_points", include_str!("../../shaders/csg/csg_points.wgsl")),
    ("scene_beams", include_str!("../../shaders/scene/scene_beams.wgsl")),
    ("scene_cuts", include_str!("../../shaders/scene/scene_cuts.wgsl")),
    ("scene_fields", include_str!("../../shaders/scene/scene_fields.wgsl")),
    ("scene_stages", include_str!("../../shaders/scene/scene_stages.wgsl")),
    ("scene_surfaces", include_str!("../../shaders/scene/scene_surfaces.wgsl")),
    ("scene_triangles", include_str!("../../shaders/scene/scene_triangles.wgsl")),
    ("query_points", include_str!("../../shaders/mesh/query_points.wgsl")),
    ("viewer", include_str!("../../shaders/viewer/view.wgsl")),
    ("viewer_mesh", include_str!("../../shaders/viewer/mesh.wgsl")),
    ("viewer_triangles", include_str!("../../shaders/viewer/triangles.wgsl")),
];

const SHARED: &[(&str, &str)] = &[
    ("bricks", include_str!("../../shaders/shared/field/bricks.wgsl")),
    ("bricks_march", include_str!("../../shaders/shared/field/bricks_march.wgsl")),
    ("bvh", include_str!("../../shaders/shared/mesh/bvh.wgsl")),
    ("clip", include_str!("../../shaders/shared/field/clip.wgsl")),
    ("cubic", include_str!("../../shaders/shared/field/cubic.wgsl")),
    ("csg_chord", include_str!("../../shaders/shared/csg/csg_chord.wgsl")),
    ("csg_field", include_str!("../../shaders/shared/csg/csg_field.wgsl")),
    ("csg_interpreter", include_str!("../../shaders/shared/csg/csg_interpreter.wgsl")),
    ("csg_leaves", include_str!("../../shaders/shared/csg/csg_leaves.wgsl")),
    ("csg_needs", include_str!("../../shaders/shared/csg/csg_needs.wgsl")),
    ("csg_part", include_str!("../../shaders/shared/csg/csg_part.wgsl")),
    ("csg_root", include_str!("../../shaders/shared/csg/csg_root.wgsl")),
    ("csg_tables", include_str!("../../shaders/shared/csg/csg_tables.wgsl")),
    ("decode", include_str!("../../shaders/shared/field/decode.wgsl")),
    ("grid", include_str!("../../shaders/shared/field/grid.wgsl")),
    ("light", include_str!("../../shaders/viewer/light.wgsl")),
    ("picture_rays", include_str!("../../shaders/shared/picture/picture_rays.wgsl")),
    ("quadric", include_str!("../../shaders/shared/quadric/quadric.wgsl")),
    ("scene_cases", include_str!("../../shaders/shared/scene/variants/scene_cases.wgsl")),
    ("scene_counts", include_str!("../../shaders/shared/scene/scene_counts.wgsl")),
    ("scene_beam", include_str!("../../shaders/shared/scene/scene_beam.wgsl")),
    ("scene_occluders", include_str!("../../shaders/shared/scene/scene_occluders.wgsl")),
    ("scene_dense", include_str!("../../shaders/shared/scene/scene_dense.wgsl")),
    ("scene_field", include_str!("../../shaders/shared/scene/scene_field.wgsl")),
    ("scene_levels", include_str!("../../shaders/shared/scene/variants/scene_levels.wgsl")),
    ("scene_nested", include_str!("../../shaders/shared/scene/variants/scene_nested.wgsl")),
    ("scene_quadric", include_str!("../../shaders/shared/scene/variants/scene_quadric.wgsl")),
    ("scene_sampled", include_str!("../../shaders/shared/scene/scene_sampled.wgsl")),
    ("scene_samples", include_str!("../../shaders/shared/scene/variants/scene_samples.wgsl")),
    ("scene_shape", include_str!("../../shaders/shared/scene/variants/scene_shape.wgsl")),
    ("scene_solids", include_str!("../../shaders/shared/scene/variants/scene_solids.wgsl")),
    ("scene_sparse", include_str!("../../shaders/shared/scene/variants/scene_sparse.wgsl")),
    ("scene_structures", include_str!("../../shaders/shared/scene/variants/scene_structures.wgsl")),
    ("scene_objects", include_str!("../../shaders/shared/scene/variants/scene_objects.wgsl")),
    ("scene_tree", include_str!("../../shaders/shared/scene/scene_tree.wgsl")),
    ("scene_view", include_str!("../../shaders/shared/scene/scene_view.wgsl")),
    ("samples", include_str!("../../shaders/shared/field/samples.wgsl")),
    ("sampling", include_str!("../../shaders/shared/field/sampling.wgsl")),
    ("tree", include_str!("../../shaders/shared/mesh/tree.wgsl")),
    ("triangle", include_str!("../../shaders/shared/mesh/triangle.wgsl")),
    ("viewer_corner", include_str!("../../shaders/viewer/corner.wgsl")),
    ("viewer_data", include_str!("../../shaders/viewer/data.wgsl")),
    ("viewer_hits", include_str!("../../shaders/viewer/hits.wgsl")),
    ("viewer_needs", include_str!("../../shaders/viewer/needs.wgsl")),
    ("viewer_table", include_str!("../../shaders/viewer/table.wgsl")),
    ("viewer_shapes", include_str!("../../shaders/viewer/shapes.wgsl")),
];

/// Kernels and shared files, each with the constants of its group in front.
static TEXTS: LazyLock<[Vec<(&str, String)>; 2]> = LazyLock::new(|| {
    [KERNELS, SHARED].map(|files| {
        let with_constants = |&(name, text)| {
            let declarations = declarations(name);
            let gap = if declarations.is_empty() { "" } else { "\n" };
            (name, format!("{declarations}{gap}{text}"))
        };
        files.iter().map(with_constants).collect()
    })
});

/// The text of a shared file, for kernels generated at run time.
pub(crate) fn shared(name: &str) -> Option<&'static str> {
    find(&TEXTS[1], name)
}

/// The whole text of a kernel, with overrides of imported files by name.
pub(crate) fn source_with(kernel: &str, instead: &[(&str, &str)]) -> Result<String, String> {
    let text = find(&TEXTS[0], kernel).ok_or_else(|| format!("there is no kernel '{kernel}'"))?;
    let mut joined = String::new();
    let mut visited = Vec::new();
    join(kernel, text, instead, &mut visited, &mut joined)?;
    Ok(joined)
}

/// The name of an import, and the text that replaces it.
pub(crate) type Instead = (&'static str, Cow<'static, str>);

/// The whole text of a kernel, with overrides of some files that it imports.
pub(crate) fn source_instead(kernel: &str, instead: &[Instead]) -> Result<String, String> {
    source_with(kernel, &instead.iter().map(|(name, text)| (*name, text.as_ref())).collect::<Vec<_>>())
}

fn find<'a, T: AsRef<str>>(files: &'a [(&str, T)], name: &str) -> Option<&'a str> {
    files.iter().find(|(file, _)| *file == name).map(|(_, text)| text.as_ref())
}

/// Appends `text` after its imports.
fn join<'a>(
    name: &str,
    text: &'a str,
    instead: &'a [(&str, &str)],
    visited: &mut Vec<&'a str>,
    joined: &mut String,
) -> Result<(), String> {
    for line in text.lines() {
        let Some(import) = line.trim().strip_prefix("#import ") else { continue };
        let import = import.trim();
        if !visited.contains(&import) {
            visited.push(import);
            let shared = find(instead, import)
                .or_else(|| find(&TEXTS[1], import))
                .ok_or_else(|| format!("{name} imports '{import}', which does not exist"))?;
            join(import, shared, instead, visited, joined)?;
        }
    }
    // Writing to a string cannot fail.
    let _ = writeln!(joined, "// ---- {name}.wgsl ----");
    for line in text.lines().filter(|line| !line.trim().starts_with("#import ")) {
        joined.push_str(line);
        joined.push('\n');
    }
    Ok(())
}
