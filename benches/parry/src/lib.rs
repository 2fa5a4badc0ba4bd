//! parry3d behind a C interface, for `peers.py`.

use parry3d::math::Vector;
use parry3d::query::PointQuery;
use parry3d::shape::{TriMesh, TriMeshFlags};
use rayon::prelude::*;
use std::slice;

/// Build a mesh with the pseudonormals that its sign needs; null if parry refuses it.
///
/// # Safety
/// `vertices` points to `vertex_count` times three floats, `faces` to `face_count` times three indices.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parry_build(
    vertices: *const f32,
    vertex_count: usize,
    faces: *const u32,
    face_count: usize,
) -> *mut TriMesh {
    // SAFETY: by the contract above.
    let (vertices, faces) =
        unsafe { (slice::from_raw_parts(vertices, 3 * vertex_count), slice::from_raw_parts(faces, 3 * face_count)) };
    let vertices = vertices.chunks_exact(3).map(|v| Vector::new(v[0], v[1], v[2])).collect();
    let faces = faces.chunks_exact(3).map(|f| [f[0], f[1], f[2]]).collect();
    match TriMesh::with_flags(vertices, faces, TriMeshFlags::ORIENTED) {
        Ok(mesh) => Box::into_raw(Box::new(mesh)),
        Err(_) => std::ptr::null_mut(),
    }
}

/// Signed distances of points, on all cores.
///
/// # Safety
/// `mesh` comes from `parry_build`, `points` points to `count` times three floats, `out` to `count` floats.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parry_signed_distance(mesh: *const TriMesh, points: *const f32, count: usize, out: *mut f32) {
    // SAFETY: by the contract above.
    let (mesh, points, out) =
        unsafe { (&*mesh, slice::from_raw_parts(points, 3 * count), slice::from_raw_parts_mut(out, count)) };
    out.par_chunks_mut(1024).zip(points.par_chunks(3 * 1024)).for_each(|(out, points)| {
        for (distance, p) in out.iter_mut().zip(points.chunks_exact(3)) {
            let p = Vector::new(p[0], p[1], p[2]);
            let projection = mesh.project_local_point(p, false);
            let unsigned = (projection.point - p).length();
            *distance = if projection.is_inside { -unsigned } else { unsigned };
        }
    });
}

/// Free a mesh.
///
/// # Safety
/// `mesh` comes from `parry_build` and is not used again.
#[unsafe(no_mangle)]
pub unsafe extern "C" fn parry_free(mesh: *mut TriMesh) {
    // SAFETY: by the contract above.
    drop(unsafe { Box::from_raw(mesh) });
}
