//! The first voxel on a ray whose sample is <= 0.
//!
//! The field of the nearest samples is constant in each voxel, so the solid is a union of voxels. The ray visits the
//! voxels on its way (Amanatides and Woo 1987), and a hit is the face through which it enters a voxel of the solid.

use super::blocks::Blocks;
use super::marcher::{FieldHit, GridRay, March, MarchLine, Marcher, each_axis, first_axis, floor};
use crate::picture::Filter;
use glam::IVec3;

impl<F: Blocks> Marcher<F> {
    /// Traces a ray to its first hit with the field of a filter.
    pub(crate) fn trace(&self, ray: &GridRay, filter: Filter) -> March {
        if filter == Filter::Nearest { march(self, ray) } else { self.march(ray) }
    }
}

/// Traces a ray to the first voxel of the solid.
fn march<F: Blocks>(marcher: &Marcher<F>, ray: &GridRay) -> March {
    let shape = marcher.field.grid().shape;
    let last = each_axis(|axis| shape[axis] as i32 - 1);
    let line = MarchLine::new(ray);
    let (mut t, mut face) = (ray.t_min, None);
    let mut voxel = each_axis(|axis| floor(line.origin[axis] + t * line.direction[axis] + 0.5).clamp(0, last[axis]));
    // Every step moves to another voxel, and never back along an axis.
    let max_steps = shape.iter().sum::<usize>() as u32;
    for steps in 1..=max_steps {
        if is_solid(marcher, voxel) {
            return March { hit: Some(FieldHit { t, at_start: face.is_none() && t == 0.0, face }), steps };
        }
        let side = |axis: usize| if line.forward[axis] { 0.5 } else { -0.5 };
        let t_faces = each_axis(|axis| line.t_at_plane(axis, voxel[axis] as f32 + side(axis)));
        let (next, t_face) = first_axis(&t_faces);
        t = t.max(t_face);
        voxel[next] += if line.forward[next] { 1 } else { -1 };
        if t >= ray.t_max || !(0..=last[next]).contains(&voxel[next]) {
            return March { hit: None, steps };
        }
        face = Some(next);
    }
    March { hit: None, steps: max_steps }
}

/// Whether the sample of a voxel is <= 0. Empty blocks have no such sample.
#[inline]
fn is_solid<F: Blocks>(marcher: &Marcher<F>, voxel: [i32; 3]) -> bool {
    if marcher.empty().distance(voxel.map(F::block_of)) > 0 {
        return false;
    }
    marcher.field.at_voxel(IVec3::from(voxel)) <= 0.0
}
