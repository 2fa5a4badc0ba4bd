//! The bake of the articles on a graphics device: every sample visits every triangle (`shaders/mesh/bake_brute.wgsl`).
//!
//! It is a reference for tests and for readers. Its cost is samples times triangles. All arithmetic is float32, so a
//! sign may be wrong where a ray grazes an edge; [`crate::sign`] has the exact rules.

use super::gpu::positions;
use super::{Bake, LocalGrid, Report};
use crate::bvh::pack::TriangleFrame;
use crate::error::{ArgumentError, Error};
use crate::geometry::triangle_cross;
use crate::gpu::Context;
use crate::gpu::constants::bake_brute::{MAX_TRIANGLES, NORMAL, PARITY, WORKGROUPS_PER_ROW};
use crate::gpu::constants::bvh::FAR;
use crate::gpu::layout::{BruteParams, BruteState, Triangle};
use crate::gpu::pace::in_pieces;
use crate::grid::Grid;
use crate::memory::allocate_samples;
use crate::mesh::Mesh;
use crate::progress::Progress;
use crate::sign::{SignChoice, SignMethod};
use glam::DVec3;
use std::sync::Arc;
use std::time::Instant;

/// Number of workgroups of 64 samples in the first dispatch, and largest number in any.
const WORKGROUPS: (u64, u64) = (16, WORKGROUPS_PER_ROW);

/// Bake by brute force. `sign` is `Normal` (article 001), `Parity` (article 003) or `Unsigned`.
pub fn bake_brute(
    context: &Arc<Context>,
    mesh: &Mesh,
    grid: &Grid,
    sign: SignMethod,
    progress: &Progress,
) -> Result<Bake, Error> {
    let sign_rule = match sign {
        SignMethod::Unsigned => 0,
        SignMethod::Normal => NORMAL,
        SignMethod::Parity => PARITY,
        _ => {
            let problem = "brute force knows \"normal\", \"parity\" and \"unsigned\" only";
            return Err(ArgumentError::new("sign", problem).into());
        }
    };
    let start = Instant::now();
    let what = format!("a field of {} x {} x {} samples", grid.shape[0], grid.shape[1], grid.shape[2]);
    let mut distances = allocate_samples(&what, grid.len(), size_of::<BruteState>() * grid.len())?;
    context.check_size(&what, (size_of::<BruteState>() * grid.len()) as u64)?;

    let local = LocalGrid::new(grid, mesh);
    // Faces without area in float32 have no normal.
    let has_area = |face: &u32| triangle_cross(mesh.triangle(*face)) != DVec3::ZERO;
    let faces: Vec<u32> = (0..mesh.faces().len() as u32).filter(has_area).collect();
    let triangles: Vec<Triangle> =
        faces.iter().map(|&face| TriangleFrame::new(mesh.triangle(face)).for_device(face)).collect();
    let corners: Vec<[f32; 4]> = faces
        .iter()
        .flat_map(|&face| mesh.triangle(face))
        .map(|corner| corner.as_vec3().extend(0.0).to_array())
        .collect();
    let nothing = BruteState { squared: FAR, nudged_squared: FAR, ..BruteState::default() };
    let state = context.upload("brute force state", &vec![nothing; grid.len()])?;
    let corners = context.upload("corners", &corners)?;
    let frames = context.upload("triangles", &triangles)?;
    let axes = context.upload("sample positions", &positions(&local))?;
    let out = context.storage(&what, 4 * grid.len() as u64)?;
    let mut params = BruteParams { shape: grid.shape.map(|n| n as u32), sign_rule, ..BruteParams::default() };
    let uniform = context.uniform("brute force parameters", &params)?;
    let kernel = context.kernel("bake_brute", "main")?;
    let buffers = [(0, &uniform), (1, &corners), (2, &frames), (3, &axes), (4, &state), (5, &out)];
    let group = context.bind("brute force", &kernel, &buffers)?;

    let workgroups = (grid.len() as u64).div_ceil(64);
    progress.set_total(workgroups * triangles.len().div_ceil(MAX_TRIANGLES) as u64);
    for first_triangle in (0..triangles.len()).step_by(MAX_TRIANGLES) {
        params.first_triangle = first_triangle as u32;
        params.triangle_count = MAX_TRIANGLES.min(triangles.len() - first_triangle) as u32;
        in_pieces(
            context,
            "the brute force kernel",
            workgroups,
            WORKGROUPS.0,
            WORKGROUPS.1,
            progress,
            |first, count| {
                params.first_sample = 64 * first as u32;
                params.sample_count = (64 * count as u32).min(grid.len() as u32 - params.first_sample);
                context.write("brute force parameters", &uniform, 0, &[params])?;
                progress.advance(count)?;
                Ok(context.dispatch("brute force", &kernel, &group, [count as u32, 1, 1])?)
            },
        )?;
    }
    context.read("read back a field", &out, &mut distances, progress)?;
    let scale = mesh.scale() as f32;
    distances.iter_mut().for_each(|distance| *distance *= scale);

    let mut report = Report::new(mesh, mesh.topology(), &SignChoice::new(mesh, sign));
    report.finish(distances.iter().filter(|distance| **distance < 0.0).count(), 0, None, grid);
    report.device = context.label();
    report.seconds = vec![("brute force", start.elapsed().as_secs_f64())];
    Ok(Bake { distances, report })
}
